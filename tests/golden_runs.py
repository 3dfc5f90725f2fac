"""A few standard runs whose numbers are kept, made through the command line alone: what it prints and what it writes.

`SCENARIOS` gives every one of them by name: a function of an empty folder that measures or imports, asks every
command, and gives what was said by command. Nothing of the program is imported but its entry point, so that these
numbers outlive every move of its modules. Seeds are fixed and time is the bench's own.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any
from unittest import mock
from xml.etree import ElementTree

import foreign_data as foreign
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

CONFIGS = Path(__file__).parents[1] / "configs"
QUADRATIC = {"name": "quadratic", "parameters": {"quantity": "acceleration", "coefficient": 4e-3}}
ASYMMETRY = {"name": "asymmetry", "parameters": {"quantity": "rate", "ratio": 0.05}}
G = 9.80665
SI = "{https://ptb.de/si}"
SWEEP = ("sweep", "--axis", "x", "--points", "4")
TURNS = ("turntable", "--rpm", "45", "--revolutions", "4")


class Desk:
    """A folder of runs, and the program that works in it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.runs = folder / "runs"
        (self._program,) = entry_points(group="console_scripts", name="rig")

    def said(self, *words: str) -> str:
        """What a command prints; in this process, which saves a second each time. Raises ValueError if it fails."""
        out, wrong = io.StringIO(), io.StringIO()
        code: object = 0
        with (
            mock.patch.object(sys, "argv", ["rig", *words, "--runs", str(self.runs)]),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(wrong),
        ):
            try:
                self._program.load()()
            except SystemExit as end:
                code = end.code
        if code:
            raise ValueError(f"rig {' '.join(words)}: found exit code {code} ({wrong.getvalue()}), wanted 0")
        return out.getvalue()

    def asked(self, *words: str) -> Any:
        return json.loads(self.said(*words, "--json"))

    def taken(self) -> list[str]:
        """Names of the runs, in the order in which they were made."""
        made = {path.parent.name: _begun(path) for path in self.runs.glob("*/journal.jsonl")}
        return sorted(made, key=lambda name: made[name])

    def measure(self, hidden: Sequence[Mapping[str, Any]], seed: int, *commands: Sequence[str]) -> list[str]:
        """Carry these out, one straight after the other, on a bench that hides this; gives the runs' names."""
        bench = self._bench(hidden, seed)
        for words in commands:
            self.said(*words, "--bench", str(bench))
        return self.taken()

    def brought_in(self, manifest: str, files: Mapping[str, Mapping[str, foreign.Array]]) -> str:
        """Import these files; gives the run's name."""
        for name, columns in files.items():
            (self._folder / name).write_bytes(foreign.csv_bytes(columns))
        (self._folder / "manifest.yaml").write_text(manifest, encoding="utf-8")
        self.said("import", str(self._folder / "manifest.yaml"))
        return self.taken()[-1]

    def written(self, name: str) -> Path:
        """A place for a command to write."""
        return self._folder / name

    def _bench(self, hidden: Sequence[Mapping[str, Any]], seed: int) -> Path:
        """The bench file of the configurations with a world of its own."""
        world = yaml.safe_load((CONFIGS / "worlds" / "clean.yaml").read_text(encoding="utf-8"))
        text = yaml.safe_dump({**world, "hidden": list(hidden)}, allow_unicode=True)
        (self._folder / "world.yaml").write_text(text, encoding="utf-8")
        text = (CONFIGS / "benches" / "simulated.yaml").read_text(encoding="utf-8")
        text = text.replace("../worlds/clean.yaml", str(self._folder / "world.yaml")).replace(
            "seed: 1}", f"seed: {seed}}}"
        )
        path = self._folder / "bench.yaml"
        path.write_text(text.replace("../", f"{CONFIGS}/"), encoding="utf-8")
        return path


def _begun(journal: Path) -> float:
    """When a run began by the wall's clock."""
    with journal.open(encoding="utf-8") as lines:
        return float(json.loads(next(lines))["wall"])


# the bench's own runs


def clean(folder: Path) -> dict[str, Any]:
    """Shaker, platter in both senses, a record at rest and six poses of a unit with nothing hidden."""
    desk = Desk(folder)
    commands = (SWEEP, TURNS, (*TURNS, "--invert"), ("noise", "--length", "20 s"), ("tumble",))
    sweep, one, other, *_ = desk.measure([], 1, *commands)
    desk.said("calibrate", "all", "--name", "golden")
    return {
        "calibrate": read_yaml(desk.runs / "calibrations" / "golden.yaml"),
        "certify": certified(desk),
        "export": exported(desk),
        **investigated(desk, "all"),
        **{f"{key} sweep": value for key, value in seen(desk, sweep).items()},
        **{f"{key} turntable": value for key, value in seen(desk, one, other).items()},
    }


def hidden_shaker(folder: Path) -> dict[str, Any]:
    """A sweep of accelerometers with a quadratic nonlinearity."""
    desk = Desk(folder)
    desk.measure([QUADRATIC], 2, SWEEP)
    return {"calibrate": calibrated(desk), **investigated(desk, "all")}


def hidden_turntable(folder: Path) -> dict[str, Any]:
    """Both senses of turning with gyros that have another scale factor in each."""
    desk = Desk(folder)
    desk.measure([ASYMMETRY], 3, TURNS, (*TURNS, "--invert"))
    return {"calibrate": calibrated(desk), **investigated(desk, "all")}


def investigated(desk: Desk, *runs: str) -> dict[str, Any]:
    """What a model makes of runs, and the model."""
    desk.said("fit", *runs, "--model", str(desk.written("model.yaml")))
    return {**seen(desk, *runs), "fit": read_yaml(desk.written("model.yaml"))}


def seen(desk: Desk, *runs: str) -> dict[str, Any]:
    """`compare` and `diagnose`, from the data sheet's model."""
    model = ("--model", str(desk.written("none.yaml")))
    return {"compare": desk.asked("compare", *runs, *model), "diagnose": desk.asked("diagnose", *runs, *model)}


def calibrated(desk: Desk) -> list[dict[str, Any]]:
    """Results of a calibration of every run, without their budgets."""
    said = desk.asked("calibrate", "all", "--name", "golden")["results"]
    return [{key: one[key] for key in ("key", "value", "unit", "u", "k", "status", "verdict")} for one in said]


def certified(desk: Desk) -> list[dict[str, Any]]:
    """The numbers of the digital certificate, by label."""
    desk.said("certify", "all", "--name", "signed", "--out", str(desk.written("certificate")))
    tree = ElementTree.parse(desk.written("certificate") / "signed.xml")
    found = []
    for real in tree.iter(f"{SI}real"):
        label = real.findtext(f"{SI}label")
        leaves = {leaf.tag.removeprefix(SI): leaf.text for leaf in real.iter() if leaf.text and leaf.text.strip()}
        found.append({"key": label, **{name: number(text) for name, text in leaves.items() if name != "label"}})
    rest = [leaf for leaf in tree.iter() if leaf.tag.endswith("XMLList") and leaf.text]
    return [
        *found,
        *({"key": f"list {n}", "values": [number(x) for x in (one.text or "").split()]} for n, one in enumerate(rest)),
    ]


def exported(desk: Desk) -> dict[str, Any]:
    """Tables of a calibration, and the constants of its module."""
    for form in ("csv", "python"):
        desk.said("export", "golden", "--to", form, "--out", str(desk.written("export")))
    folder, names = desk.written("export"), {}
    exec(compile((folder / "golden_calibration.py").read_text(encoding="utf-8"), "exported", "exec"), names)
    constants = {key: value for key, value in names.items() if key.isupper() and key != "PROVENANCE"}
    shown = ("key", "shown_value", "shown_U", "shown_unit")
    results = [{key: row[key] for key in shown} for row in rows(folder / "golden.results.csv")]
    return {"module": constants, "results": results, "responses": rows(folder / "golden.responses.csv")}


def rows(path: Path) -> list[dict[str, Any]]:
    """A table with a header."""
    with path.open(encoding="utf-8", newline="") as lines:
        return [{key: number(text) for key, text in row.items()} for row in csv.DictReader(lines)]


def number(text: str | None) -> str | float | int | None:
    """A cell as the number that it is, else as it stands."""
    for kind in (int, float):
        with contextlib.suppress(ValueError, TypeError):
            return kind(text)  # type: ignore[arg-type]
    return text


def read_yaml(path: Path) -> Any:
    return yaml.load(path.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # safe either way


# other people's


def imported(
    folder: Path, manifest: Callable[[], str], files: Callable[[], Mapping[str, Mapping[str, foreign.Array]]]
) -> dict[str, Any]:
    """An import, and what a model makes of it."""
    desk = Desk(folder)
    return investigated(desk, desk.brought_in(manifest(), files()))


def shaken() -> dict[str, dict[str, foreign.Array]]:
    """A record at rest, and one frequency at three levels on a board with a quadratic nonlinearity."""
    random = np.random.default_rng(7)
    t = np.arange(6000) / 1000.0
    found = {}
    for name, level in LEVELS.items():
        base = level * np.sin(2.0 * math.pi * 5.172 * t)
        noise = 0.003 * random.normal(size=(2, len(t)))
        board = 1.96 / 2.0 * base + 0.004 * base**2
        found[name] = {"drive_V": 0.25 * base, "base": base + noise[0], "board": board + noise[1]}
    return found


LEVELS = {"rest": 0.0, "low": 1.0, "middle": 2.0, "high": 4.0}


def shaken_manifest() -> str:
    files = "".join(
        f"- {{path: {name}, label: {name}, settings: {{level: {name}{', frequency: 5.172 Hz' if level else ''}}}}}\n"
        for name, level in LEVELS.items()
    )
    head = foreign.HEAD.format(kind="sweep")
    columns = foreign.columns_text(foreign.SHAKEN)
    return f"{head}files:\n{files}reading: {{format: csv}}\ntime: {{rate: 1000 Hz}}\n{columns}"


def turning() -> dict[str, dict[str, foreign.Array]]:
    """A case on a shaft with an encoder; its gyro shows 0.5 % more one way round."""
    columns = foreign.turning(30.0, delay=0.0)
    return {"a.csv": {**columns, "gyro_z_dps": columns["gyro_z_dps"] + 0.005 * np.maximum(columns["gyro_z_dps"], 0.0)}}


def thrown() -> dict[str, dict[str, foreign.Array]]:
    """A device that is turned and moved before cameras; its gyros show 0.5 % more one way round."""
    random = np.random.default_rng(19)
    t = np.arange(4000) / 200.0
    place = np.stack([0.05 * _swing(t, 3.0 + k, k)[0] for k in range(3)])
    force = np.stack([0.05 * _swing(t, 3.0 + k, k)[1] for k in range(3)]) + np.array([[0.0], [0.0], [G]])
    turn, h = _attitude(t), 1e-4
    rate = (_attitude(t - h).inv() * _attitude(t + h)).as_rotvec() / (2.0 * h)
    rate = rate + 0.005 * np.maximum(rate, 0.0) + 0.002 * random.normal(size=rate.shape)
    felt = turn.inv().apply(force.T) + 0.02 * random.normal(size=rate.shape)
    quaternion = (turn * Rotation.from_rotvec(1e-4 * random.normal(size=rate.shape))).as_quat()
    columns = {"t": t}
    columns |= {f"gyro_{a}": rate[:, k] for k, a in enumerate("xyz")}
    columns |= {f"acc_{a}": felt[:, k] for k, a in enumerate("xyz")}
    columns |= {f"quat_{a}": quaternion[:, k] for k, a in enumerate("xyzw")}
    return {"a.csv": columns | {f"pos_{a}": place[k] + 1e-4 * random.normal(size=len(t)) for k, a in enumerate("xyz")}}


def _swing(t: foreign.Array, omega: float, phase: float) -> tuple[foreign.Array, foreign.Array]:
    """A swing with an overtone, and its second derivative."""
    waves = [(1.0, omega), (0.3, 2.7 * omega)]
    here = sum(size * np.sin(w * t + phase * w) for size, w in waves)
    return np.asarray(here), np.asarray(sum(-size * w * w * np.sin(w * t + phase * w) for size, w in waves))


def _attitude(t: foreign.Array) -> Rotation:
    """World from body."""
    return Rotation.from_euler("ZYX", np.stack([0.8 * _swing(t, 1.7 + 0.6 * k, k)[0] for k in range(3)], axis=1))


FACES = {f"{sign}{axis}": (k, 1.0 if sign == "+" else -1.0) for k, axis in enumerate("xyz") for sign in "+-"}
HELD, TURNED = 300, 400  # rows of a pose and of a turn, at 100 Hz


def posed() -> dict[str, dict[str, foreign.Array]]:
    """Six faces twice and a whole turn about each axis, with gains, zeros and an axis that is not square."""
    random = np.random.default_rng(11)
    up = [sign * np.eye(3)[k] for k, sign in FACES.values()] * 2
    force = np.repeat([*up, *np.eye(3)[[2, 0, 1]]], [HELD] * len(up) + [TURNED] * 3, axis=0) * G
    rate = np.zeros_like(force)
    for k in range(3):
        begin = HELD * len(up) + TURNED * k
        rate[begin + 50 : begin + 350, k] = 2.0 * math.pi / 3.0
    square = np.array([[1.0, 0.0, 0.0], [0.01, 1.0, 0.0], [0.0, 0.0, 1.0]])
    shown = force @ square.T * [1.02, 0.99, 1.005] + [0.03, -0.02, 0.01] + 0.02 * random.normal(size=force.shape)
    turned = rate * [1.03, 0.98, 1.01] + [0.004, -0.005, 0.006] + 0.002 * random.normal(size=rate.shape)
    return {"poses.csv": {**{f"acc_{a}": shown[:, k] for k, a in enumerate("xyz")},
                          **{f"gyro_{a}": turned[:, k] for k, a in enumerate("xyz")}}}  # fmt: skip


def posed_manifest() -> str:
    segments, first = "", 0
    for n, face in enumerate([*FACES] * 2):
        segments += f"- {{label: {face} {n}, first: {first + 20}, last: {first + HELD - 20}, up: {face}}}\n"
        first += HELD
    for axis in "xyz":
        turned = f"turn: {axis}, angle: 360 °, angle_uncertainty: 0.5 °"
        segments += f"- {{label: turn {axis}, first: {first}, last: {first + TURNED}, {turned}}}\n"
        first += TURNED
    head = foreign.HEAD.format(kind="poses")
    columns = {name: text for name, text in foreign.TRACKED.items() if name[:3] in ("acc", "gyr")}
    columns = {name: text.replace("3 %", "10 %") for name, text in columns.items()}
    return (
        f"{head}files: [{{path: poses.csv}}]\ntime: {{rate: 100 Hz}}\n"
        f"segments:\n{segments}{foreign.columns_text(columns)}"
    )


def responding() -> dict[str, dict[str, foreign.Array]]:
    """A table of a delay of 0.1 ms, three times over, with what its owner says of it."""
    random = np.random.default_rng(17)
    f = np.tile(np.geomspace(10.0, 250.0, 12), 3)
    errors = 1e-3 * (np.tile(random.normal(size=(2, 12)), 3) + random.normal(size=(2, 36)))
    stated = np.full(36, 1e-3)
    phase = -2.0 * math.pi * f * 1e-4 + errors[1]
    return {
        "a.csv": {"freqs": f, "mag": 1.02 * (1.0 + errors[0]), "maguncer": stated, "phase": phase, "phuncer": stated}
    }


def responding_manifest() -> str:
    columns = {**foreign.RESPONDING, "phase": "quantity: phase, unit: rad, uncertainty_column: phuncer"}
    return f"{foreign.HEAD.format(kind='response')}files: [{{path: a.csv}}]\n{foreign.columns_text(columns)}"


def still() -> dict[str, dict[str, foreign.Array]]:
    """Three minutes at rest of a gyro and an accelerometer."""
    noise = np.random.default_rng(13).normal(size=(2, 9000))
    return {
        "still.csv": {"gyro_z": 1.5 + 0.2 * noise[0], "acc_z": G + 0.02 * noise[1] + 0.002 * np.cumsum(noise[1]) / 30.0}
    }


def imported_static(folder: Path) -> dict[str, Any]:
    """A record at rest: its noise, which is all that it tells."""
    desk = Desk(folder)
    return {"show": desk.asked("show", desk.brought_in(still_manifest(), still()))}


def still_manifest() -> str:
    columns = {"gyro_z": "quantity: rate, unit: °/s, axis: z", "acc_z": "quantity: acceleration, unit: m/s², axis: z"}
    head = foreign.HEAD.format(kind="static")
    return f"{head}files: [{{path: still.csv}}]\ntime: {{rate: 50 Hz}}\n{foreign.columns_text(columns)}"


SCENARIOS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "clean": clean,
    "hidden_shaker": hidden_shaker,
    "hidden_turntable": hidden_turntable,
    "imported_response": partial(imported, manifest=responding_manifest, files=responding),
    "imported_sweep": partial(imported, manifest=shaken_manifest, files=shaken),
    "imported_rotation": partial(imported, manifest=lambda: foreign.turning_manifest("a.csv"), files=turning),
    "imported_motion": partial(imported, manifest=lambda: foreign.tracked_manifest("a.csv"), files=thrown),
    "imported_poses": partial(imported, manifest=posed_manifest, files=posed),
    "imported_static": imported_static,
}
