"""Every key of a manifest changes something: a number, a row, a finding, or what is said of the run.

For each key there is a manifest and a change of that key's value alone (of two where one asks for the other). What the
program makes of the data must differ before and after; a key that nobody reads fails here. Keys that would change
nothing for a kind of data are refused at their line.
"""

from __future__ import annotations

import copy
import functools
import typing
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import foreign_data as made
import numpy as np
import pytest
import yaml
from pydantic import BaseModel

from rig.archive.runs import Runs
from rig.cli.outcome import run_as_text
from rig.errors import BadInput, ConfigError
from rig.foreign import manifest
from rig.foreign.importing import Read, keep, open_manifest
from rig.foreign.manifest import KINDS, Manifest
from rig.foreign.manifest_file import load
from rig.parts.reading.imported import parts_of
from rig.parts.reading.rest import at_rest

Array = made.Array
Body = dict[str, Any]


# the data


def _turning() -> dict[str, Array]:
    data = made.turning(30.0)
    t = data["t_s"]
    data["late_s"], data["other_deg"], data["u_deg"] = 1.01 * t, 1.02 * data["encoder_deg"], 0.3 + 0.0 * t
    data["spiked_dps"] = np.where(np.isin(np.arange(len(t)), (300, 900)), -2000.0, data["gyro_x_dps"])
    data["uneven_s"] = t + 2e-3 * np.random.default_rng(8).uniform(-1.0, 1.0, size=len(t))
    return data


def _lines() -> dict[str, Array]:
    t = np.arange(0.0, 20.0, 0.0005)
    angle, rate = 1.5 * t + np.sin(1.1 * t), 1.5 + 1.1 * np.cos(1.1 * t)
    phase = np.mod(angle * 256.0 / (2.0 * np.pi), 1.0)
    a, b = (5.0 * (np.mod(phase - shift, 1.0) < 0.5) for shift in (0.0, 0.25))
    return {"t_s": t, "a": a, "b": b, "gyro_z": rate + 1e-3 * np.random.default_rng(1).normal(size=len(t))}


def _posed() -> dict[str, Array]:
    random = np.random.default_rng(4)
    faces = np.concatenate([np.eye(3), -np.eye(3), *(s * np.ones((1, 3)) / 3**0.5 for s in (1.0, -1.0))])
    force = np.repeat(9.81 * np.tile(faces, (3, 1)), 200, axis=0)
    rate = np.zeros_like(force)
    rate[-200:, 2] = np.pi  # one turn in the last two seconds
    values = np.concatenate([force, rate], axis=1) + 0.01 * random.normal(size=(len(force), 6))
    return dict(zip(("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z"), values.T, strict=True))


def _responding() -> dict[str, Array]:
    data = made.responding()
    return data | {"amp": np.full(len(data["mag"]), 10.0), "u_other": np.full(len(data["mag"]), 3e-3)}


def _resting() -> dict[str, Array]:
    return {"gyro_z": 0.01 * np.random.default_rng(6).normal(size=2000), "t_s": np.arange(2000) / 100.0}


DATA: Mapping[str, Callable[[], dict[str, Array]]] = {
    "rotation": _turning, "lines": _lines, "poses": _posed, "response": _responding, "static": _resting,
    "sweep": functools.partial(made.shaken, seconds=4.0), "motion": functools.partial(made.tracked, 20.0),
}  # fmt: skip


def base(kind: str) -> Body:
    """A manifest of this data, without anything that can be left out."""
    head = yaml.safe_load(made.HEAD.format(kind={"lines": "rotation"}.get(kind, kind)))
    body: Body = {**head, "files": [{"path": "d.csv"}]}
    columns: Mapping[str, str] = {
        "rotation": made.TURNING, "motion": made.TRACKED, "sweep": made.SHAKEN, "response": made.RESPONDING,
        "lines": {n: f"quantity: line_{n}, unit: V, role: reference" for n in "ab"} | _gyros("z"),
        "poses": {f"acc_{a}": f"quantity: acceleration, unit: m/s², axis: {a}" for a in "xyz"} | _gyros("xyz"),
        "static": _gyros("z"),
    }[kind]  # fmt: skip
    body["columns"] = [{"column": name, **yaml.safe_load(f"{{{rest}}}")} for name, rest in columns.items()]
    more: Mapping[str, Body] = {
        "rotation": {"rotation": {"axis": "z", "upright": True}, "time": {"column": "t_s", "unit": "s"}},
        "lines": {"rotation": {"axis": "z", "upright": True, "lines": 256}, "time": {"column": "t_s"}},
        "motion": {"pose": {}, "time": {"rate": "200 Hz"}}, "sweep": {"time": {"rate": "1000 Hz"}},
        "poses": {"time": {"rate": "100 Hz"}, "segments": SEGMENTS}, "static": {"time": {"rate": "100 Hz"}},
    }  # fmt: skip
    body |= copy.deepcopy(more.get(kind, {}))
    if kind == "sweep":
        body["files"][0]["settings"] = {"frequency": "5 Hz"}
    return body


def _gyros(axes: str) -> dict[str, str]:
    return {f"gyro_{a}": f"quantity: rate, unit: rad/s, axis: {a}" for a in axes}


SEGMENTS = [
    *({"first": 200 * k, "last": 200 * (k + 1)} for k in range(23)),
    {"first": 4600, "last": 4800, "turn": "z", "angle": "360 °", "angle_uncertainty": "1 °"},
]


# what is made of it


def numbers(read: Read) -> str:
    """All that a fit or a reader gets of the data, by value."""
    data = read.data
    seen: list[Any] = [one.in_words for one in read.found]
    seen += [(t.label, t.held_out, t.names, t.values.tobytes()) for t in data.tables]
    if data.manifest.kind == "static":
        return repr([*seen, list(at_rest(data))])
    parts, known = parts_of(data)
    for part in parts:
        motion, channels = part.reference, part.channels
        seen += [getattr(motion, name).tobytes() for name in ("force", "rate", "turning", "temperature", "along")]
        seen += [getattr(channels, name).tobytes() for name in ("rates", "axis", "slot", "sensitivity", "tolerance")]
        seen += [channels.pole.tobytes(), channels.names, part.target.tobytes(), part.held_out.tobytes()]
        seen += [
            np.asarray(part.observed).tobytes()
        ]  # a target is in units of the noise, which the record itself may tell
        seen += [part.allowance_of(name, mask) for name in part.row_names for mask in part.domains().values()]
        seen += [part.name, part.extra.tobytes(), getattr(part, "notes", ()), getattr(part.data, "level", ())]
    return repr([*seen, [(term.key, term.prior) for term in known]])


def outcome(folder: Path, body: Body, kind: str, view: str = "") -> str:
    """What comes of a manifest: `view` "said" is what a person is shown of the run, else the numbers."""
    path = folder / "m.yaml"
    path.write_text(yaml.safe_dump(body, allow_unicode=True, sort_keys=False), encoding="utf-8")
    data = DATA[kind]()
    slower = {name: 0.9 * values if name == "gyro_z_dps" else values for name, values in data.items()}
    written = {"d.csv": made.csv_bytes(data), "d.odd": made.csv_bytes(data), "e.csv": made.csv_bytes(slower)}
    written |= {"semi.csv": made.csv_bytes(data, ";", comma=True)}
    for name, raw in written.items():
        (folder / name).write_bytes(raw)
    try:
        read = open_manifest(path)
        if view == "said":
            runs = Runs(folder / "runs")
            return run_as_text(runs.open(keep(read, runs))).replace(str(folder), "")
        return numbers(read)
    except BadInput as error:
        return f"refused: {error}".replace(str(folder), "")


# one change for every key


def put(*path: str | int, to: Any) -> Callable[[Body], None]:
    """Sets one value."""

    def change(body: Body) -> None:
        here: Any = body
        for key in path[:-1]:
            here = here[key] if isinstance(key, int) else here.setdefault(key, {})
        here[path[-1]] = to

    return change


def both(*changes: Callable[[Body], None]) -> Callable[[Body], None]:
    def change(body: Body) -> None:
        for one in changes:
            one(body)

    return change


def column(its: str, /, **more: Any) -> Callable[[Body], None]:
    """Sets keys of one column."""

    def change(body: Body) -> None:
        next(one for one in body["columns"] if one["column"] == its).update(more)

    return change


def nothing(body: Body) -> None:
    pass


def swapped(body: Body) -> None:
    one, two = (next(c for c in body["columns"] if c["column"] == f"quat_{a}") for a in "xy")
    one["component"], two["component"] = "y", "x"


COUNTS = column("acc_x_g", sensitivity="1 counts per g", unit="")
SPIKED = column("gyro_x_dps", column="spiked_dps")
SHEET = column("gyro_z_dps", noise={"density": "0.03 (°/s)/√Hz"})
PLACED = put("rotation", "radius", to="100 mm")
LABELLED = put("segments", 0, "up", to="-x")
STANDARD = {"name": "encoder", "certificate": "7", "laboratory": "PTB"}
Change = tuple[str, Callable[[Body], None], Callable[[Body], None]]  # data, before, after
CHANGES: dict[tuple[str, str], Change] = {
    ("Manifest", "kind"): ("poses", nothing, both(put("kind", to="static"), lambda body: body.pop("segments"))),
    ("Manifest", "label"): ("static", nothing, put("label", to="other")),
    ("Manifest", "mains"): ("sweep", nothing, put("mains", to="60 Hz")),
    ("UnitUnderTest", "serial"): ("static", nothing, put("unit", "serial", to="B2")),
    ("UnitUnderTest", "model"): ("static", nothing, put("unit", "model", to="MPU")),
    ("UnitUnderTest", "maker"): ("static", nothing, put("unit", "maker", to="Inven")),
    ("Provenance", "source"): ("static", nothing, put("provenance", "source", to="a shelf")),
    ("Provenance", "licence"): ("static", nothing, put("provenance", "licence", to="MIT")),
    ("Provenance", "citation"): ("static", nothing, put("provenance", "citation", to="Somebody 2020")),
    ("Provenance", "note"): ("static", nothing, put("provenance", "note", to="mind the step")),
    ("Source", "path"): ("rotation", nothing, put("files", 0, "path", to="e.csv")),
    ("Source", "label"): ("rotation", nothing, put("files", 0, "label", to="first")),
    ("Source", "settings"): ("sweep", nothing, put("files", 0, "settings", "level", to="low")),
    ("Source", "held_out"): ("rotation", nothing, put("files", 0, "held_out", to=True)),
    ("Reading", "format"): ("rotation", put("files", 0, "path", to="d.odd"),
                            both(put("files", 0, "path", to="d.odd"), put("reading", "format", to="csv"))),
    ("Reading", "delimiter"): ("rotation", nothing, put("reading", "delimiter", to=";")),
    ("Reading", "comment"): ("rotation", nothing, put("reading", "comment", to="0")),
    ("Reading", "header"): ("rotation", nothing, put("reading", "header", to=False)),
    ("Reading", "skip"): ("rotation", nothing, put("reading", "skip", to=1)),
    ("Reading", "units"): ("rotation", nothing, put("reading", "units", to=True)),
    ("Reading", "decimal"): (
        "rotation", both(put("files", 0, "path", to="semi.csv"), put("reading", to={"delimiter": ";"})),
        both(put("files", 0, "path", to="semi.csv"), put("reading", to={"delimiter": ";", "decimal": ","}))),
    ("TimeBase", "column"): ("rotation", nothing, put("time", "column", to="late_s")),
    ("TimeBase", "unit"): (
        "static", put("time", to={"column": "t_s"}), put("time", to={"column": "t_s", "unit": "ms"})),
    ("TimeBase", "rate"): ("static", nothing, put("time", "rate", to="200 Hz")),
    ("TimeBase", "interval"): ("static", put("time", to={"interval": "10 ms"}), put("time", to={"interval": "5 ms"})),
    ("TimeBase", "jitter"): (
        "rotation", put("time", "column", to="uneven_s"), put("time", to={"column": "uneven_s", "jitter": "5 ms"})),
    ("Column", "column"): ("rotation", nothing, column("encoder_deg", column="other_deg")),
    ("Column", "name"): ("rotation", nothing, column("gyro_z_dps", name="other")),
    ("Column", "quantity"): ("rotation", nothing, column("gyro_x_dps", quantity="acceleration", unit="mg")),
    ("Column", "unit"): ("rotation", nothing, column("gyro_x_dps", unit="rad/s")),
    ("Column", "axis"): ("rotation", nothing, column("gyro_x_dps", axis="y")),
    ("Column", "component"): ("motion", nothing, swapped),
    ("Column", "role"): ("rotation", nothing, column("gyro_x_dps", role="drive")),
    ("Column", "sensitivity"): ("rotation", COUNTS, column("acc_x_g", sensitivity="2 counts per g", unit="")),
    ("Column", "zero"): ("rotation", nothing, column("acc_x_g", zero=0.1)),
    ("Column", "missing"): ("rotation", nothing, column("acc_x_g", missing=float(made.turning()["acc_x_g"][7]))),
    ("Column", "tolerance"): ("rotation", nothing, column("gyro_z_dps", tolerance="7 %")),
    ("Column", "bandwidth"): ("rotation", nothing, column("gyro_z_dps", bandwidth="40 Hz")),
    ("Column", "delay"): ("rotation", nothing, column("encoder_deg", delay="3 ms")),
    ("Column", "uncertainty"): ("rotation", nothing, column("encoder_deg", uncertainty="0.3 °")),
    ("Column", "gain_uncertainty"): ("rotation", nothing, column("encoder_deg", gain_uncertainty="2 %")),
    ("Column", "uncertainty_column"): ("response", nothing, column("mag", uncertainty_column="u_other")),
    ("Column", "coverage"): ("response", nothing, column("mag", coverage=2.0)),
    ("Column", "findings"): ("rotation", SPIKED, both(SPIKED, column("spiked_dps", findings="accepted"))),
    ("SheetNoise", "density"): ("rotation", SHEET, column("gyro_z_dps", noise={"density": "0.05 (°/s)/√Hz"})),
    ("SheetNoise", "tolerance"): (
        "rotation", SHEET, column("gyro_z_dps", noise={"density": "0.03 (°/s)/√Hz", "tolerance": "50 %"})),
    ("SheetNoise", "corner"): (
        "rotation", SHEET, column("gyro_z_dps", noise={"density": "0.03 (°/s)/√Hz", "corner": ["1 Hz", "3 Hz"]})),
    ("Rotation", "axis"): ("rotation", nothing, put("rotation", "axis", to="x")),
    ("Rotation", "upright"): ("rotation", nothing, put("rotation", "upright", to=False)),
    ("Rotation", "sense"): ("rotation", nothing, put("rotation", "sense", to=-1)),
    ("Rotation", "lines"): ("lines", nothing, put("rotation", "lines", to=128)),
    ("Rotation", "radius"): ("rotation", nothing, PLACED),
    ("Rotation", "radius_uncertainty"): (
        "rotation", PLACED, both(PLACED, put("rotation", "radius_uncertainty", to="1 mm"))),
    ("Rotation", "outward"): ("rotation", PLACED, both(PLACED, put("rotation", "outward", to="-y"))),
    ("Pose", "quaternion"): ("motion", nothing, put("pose", "quaternion", to="world_to_body")),
    ("Pose", "up"): ("motion", nothing, put("pose", "up", to="y")),
    ("Segment", "label"): ("poses", LABELLED, both(LABELLED, put("segments", 0, "label", to="face"))),
    ("Segment", "first"): ("poses", nothing, put("segments", 1, "first", to=210)),
    ("Segment", "last"): ("poses", nothing, put("segments", 1, "last", to=390)),
    ("Segment", "up"): ("poses", nothing, LABELLED),
    ("Segment", "turn"): ("poses", nothing, put("segments", 23, "turn", to="y")),
    ("Segment", "angle"): ("poses", nothing, put("segments", 23, "angle", to="350 °")),
    ("Segment", "angle_uncertainty"): ("poses", nothing, put("segments", 23, "angle_uncertainty", to="5 °")),
    ("Gravity", "value"): ("poses", nothing, put("gravity", "value", to="9.81 m/s²")),
    ("Gravity", "uncertainty"): ("poses", nothing, put("gravity", "uncertainty", to="0.001 m/s²")),
    **{("Standard", key): ("rotation", put("standard", to=STANDARD), put("standard", to={**STANDARD, key: value}))
       for key, value in {"name": "other", "certificate": "8", "laboratory": "NIST", "instrument": "8305",
                          "serial": "9", "due": "2028-01-01"}.items()},
    ("Compared", "rate_band"): ("rotation", nothing, put("compared", "rate_band", to="1 Hz")),
    ("Compared", "force_band"): ("rotation", nothing, put("compared", "force_band", to="0.5 Hz")),
    ("Compared", "held_out"): ("poses", nothing, put("compared", "held_out", to="10 %")),
}  # fmt: skip
SAID = {
    ("Manifest", "label"),
    *((owner, key) for owner, key in CHANGES if owner in ("UnitUnderTest", "Provenance", "Standard")),
}
ONE_VALUE = {("Manifest", "format")}
READING = {key for key in CHANGES if key[0] == "Reading"}  # a file that is read wrongly may be refused


def keys(model: type[BaseModel]) -> Iterator[tuple[str, str]]:
    """Keys with a value of their own, in a model and all within it."""
    for name, said in model.model_fields.items():
        inner = [one for one in _within(said.annotation) if isinstance(one, type) and issubclass(one, BaseModel)]
        for one in inner:
            yield from keys(one)
        if not inner:
            yield model.__name__, name


def _within(annotation: Any) -> Iterator[Any]:
    yield annotation
    for one in typing.get_args(annotation):
        yield from _within(one)


def test_there_is_a_change_for_every_key() -> None:
    assert set(CHANGES) | ONE_VALUE == set(keys(Manifest))


@pytest.mark.parametrize("key", CHANGES, ids=".".join)
def test_a_key_changes_something(tmp_path: Path, key: tuple[str, str]) -> None:
    kind, before, after = CHANGES[key]
    found = []
    for number, change in enumerate((before, after)):
        body = base(kind)
        change(body)
        folder = tmp_path / str(number)
        folder.mkdir()
        found.append(outcome(folder, body, kind, "said" if key in SAID else ""))
    assert found[0] != found[1]
    if key not in READING:
        assert not [one for one in found if one.startswith("refused")]


@pytest.mark.parametrize("kind", DATA)
def test_what_is_made_of_the_same_manifest_is_the_same(tmp_path: Path, kind: str) -> None:
    first, second = (outcome(tmp_path, base(kind), kind) for _ in range(2))
    assert first == second
    assert not first.startswith("refused")


# keys that say nothing here


REFUSED: dict[str, tuple[str, Callable[[Body], None], str]] = {
    "a gain of poses": ("poses", column("acc_x", gain_uncertainty="1 %"), "gravity.uncertainty says how well"),
    "a gain of a frequency": ("response", column("freqs", gain_uncertainty="1 %"), "it belongs to the excitation"),
    "a gain of a quaternion": ("motion", column("quat_w", gain_uncertainty="1 %"), "it belongs to the positions"),
    "a gain of lines": ("lines", column("a", gain_uncertainty="1 %"), "an encoder's lines close in a turn"),
    "a gain of a gyro": ("rotation", column("gyro_z_dps", gain_uncertainty="1 %"), "to the reference's angle"),
    "one gain of three": ("motion", column("pos_x", gain_uncertainty="1 %"), "wanted one for the whole reference"),
    "one delay of two": ("lines", column("b", delay="1 ms"), "found another delay than that of a"),
    "a delay of a response": ("response", column("mag", delay="1 ms"), "a response's phase has it already"),
    "a delay of poses": ("poses", column("acc_x", delay="1 ms"), "wanted nothing in a device column"),
    "a filter at rest": ("static", column("gyro_z", bandwidth="40 Hz"), "found 'bandwidth', wanted nothing"),
    "a tolerance of a reference": ("rotation", column("encoder_deg", tolerance="1 %"), "found 'tolerance'"),
    "an uncertainty of a gyro": ("rotation", column("gyro_z_dps", uncertainty="1 °/s"), "found 'uncertainty'"),
    "a coverage alone": ("rotation", column("encoder_deg", coverage=2.0), "wanted an uncertainty that it covers"),
    "noise of a reference": ("rotation", column("encoder_deg", noise={"density": "1 °/s"}), "found 'noise', wanted"),
    "findings at rest": ("static", column("gyro_z", findings="accepted"), "found 'findings', wanted nothing"),
    "noise of free motion": ("motion", column("gyro_x", noise={"density": "1 (°/s)/√Hz"}), "found 'noise', wanted"),
    "noise of no such unit": ("rotation", column("gyro_z_dps", noise={"density": "1 µg/√Hz"}), "gyro noise"),
    "a corner that falls": (
        "rotation", column("gyro_z_dps", noise={"density": "0.03 (°/s)/√Hz", "corner": ["3 Hz", "1 Hz"]}),
        "wanted one that rises"),
    "a pose of a rotation": ("rotation", put("pose", to={}), "found 'pose', wanted nothing for a rotation"),
    "a rotation of poses": ("poses", put("rotation", to={"axis": "z", "upright": True}), "found 'rotation'"),
    "segments of a motion": ("motion", put("segments", to=[{"first": 0, "last": 9, "up": "+x"}]), "found 'segments'"),
    "mains of a rotation": ("rotation", put("mains", to="50 Hz"), "found 'mains', wanted nothing for a rotation"),
    "a time of a response": ("response", put("time", to={"rate": "1 Hz"}), "found 'time', wanted nothing"),
    "gravity at rest": ("static", put("gravity", "value", to="9.81 m/s²"), "found 'gravity', wanted nothing"),
    "a gravity that is no reference": ("motion", put("gravity", "uncertainty", to="0.1 m/s²"), "found 'uncertainty'"),
    "a share of a sweep": ("sweep", put("compared", "held_out", to="10 %"), "`held_out: true` marks a file"),
    "a band of poses": ("poses", put("compared", "rate_band", to="1 Hz"), "found 'rate_band', wanted nothing"),
    "jitter of a rate": ("static", put("time", "jitter", to="1 ms"), "without a column of time stamps"),
    "outward nowhere": ("rotation", put("rotation", "outward", to="+x"), "without a radius, wanted one"),
    "outward along the axis": ("rotation", both(PLACED, put("rotation", "outward", to="+z")), "an axis across z"),
    "lines beside an angle": ("rotation", put("rotation", "lines", to=9), "found lines beside an angle"),
    "an axis that cannot be up": (
        "rotation", put("segments", to=[{"first": 0, "last": 9, "up": "+x"}]), "found '+x', wanted +z or -z"),
    "a turn in a rotation": (
        "rotation", put("segments", to=[{"first": 0, "last": 9, "up": "+z", "turn": "z", "angle": "9 °"}]),
        "found 'z', wanted nothing in a rotation"),
    "a standard at rest": ("static", put("standard", to=STANDARD), "found 'standard', wanted nothing for a static"),
    "segments of two files": (
        "poses", put("files", to=[{"path": "d.csv"}, {"path": "e.csv"}]), "found segments and 2 files"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_key_that_would_change_nothing_is_refused_where_it_stands(tmp_path: Path, name: str) -> None:
    kind, change, said = REFUSED[name]
    body, path = base(kind), tmp_path / "m.yaml"
    change(body)
    path.write_text(yaml.safe_dump(body, allow_unicode=True, sort_keys=False), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load(path)
    problem, *_ = [one for one in caught.value.problems if said in str(one)]
    assert str(problem).startswith(f"{path}:")
    assert problem.line > 0
    assert "found" in str(problem)
    assert "wanted" in str(problem)


def test_everything_that_a_kind_of_data_names_is_a_key() -> None:
    for kind in KINDS.values():
        assert set(kind.columns) <= set(manifest.Column.model_fields)
        for outer, _, inner in (key.partition(".") for key in kind.keys):
            known = Manifest.model_fields[outer].annotation
            assert not inner or inner in known.model_fields
    assert set(typing.get_args(manifest.Kind)) == set(KINDS)
