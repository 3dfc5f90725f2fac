"""Names of channels decide nothing: other names give the same numbers, and one accelerometer and one gyro are enough.

Benches of the same world under other names are measured without sockets into an archive; commands do the rest.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fast_bench
import pytest
import yaml
from click.testing import CliRunner

from rig.archive.runs import Runs
from rig.bench import control
from rig.bench.assembly import state_folder
from rig.bench.benchfile import describe
from rig.cli import cli
from rig.errors import BadInput
from rig.yaml.config import shipped

SEED = 7
CUBIC = {"name": "cubic", "parameters": {"quantity": "acceleration", "coefficient": 3e-4}}
DOCUMENTS: tuple[dict[str, Any], ...] = (
    {"procedure": "frequency_sweep", "axis": "x", "points": 4, "static": "5 s"},
    {"procedure": "turntable", "axis": "yaw", "revolutions": 4, "rest": "5 s"},
    {"procedure": "noise", "length": "10 s", "cables": "turntable"},
    {"procedure": "tumble", "poses": 12, "record": "1 s"},
)
CUBE: dict[str, Any] = yaml.safe_load(shipped("sensors/simulated_cube.yaml").read_text(encoding="utf-8"))
SIGNALS = {"ldv": "laser", "supply": "battery", "temperature": "heat", "tag": "pilot", "quiet": "blank"}
ENCODER = {"a": "encoder_a", "b": "encoder_b", "index": "encoder_index"}
UNITS = {"unit_a": "near", "unit_b": "far side", "unit_c": "rough", "gyro": "Kreisel", "backup": "zweite"}
OTHER = {
    **{name: f"alpha{n}" if row["quantity"] == "acceleration" else f"ω-left{n}"
       for n, (name, row) in enumerate(CUBE["channels"].items(), start=1)},
    **SIGNALS, **{name: name.replace("encoder", "Scheibe") for name in ENCODER.values()},
}  # fmt: skip
ALONE = ("unit_a_x", "gyro_yaw")


@dataclass(frozen=True)
class Measured:
    """Runs of one bench and where they are; `names` maps its names to the shipped ones."""

    runs: Path
    names: Mapping[str, str]
    swept: str
    turned: str
    others: tuple[str, ...]

    @property
    def all(self) -> tuple[str, ...]:
        return (self.swept, self.turned, *self.others)

    def said(self, *words: str) -> str:
        """What a command prints; raises what it raises."""
        words = (*words, "--runs", str(self.runs))
        return CliRunner().invoke(cli, words, catch_exceptions=False, standalone_mode=False).stdout

    def asked(self, *words: str) -> Any:
        """What it prints as JSON, with the shipped names, without paths and names of runs."""
        text = self.said(*words, "--json").replace(str(self.runs), "RUNS")
        for number, run in enumerate(self.all):
            text = text.replace(run, f"run {number}")
        known = sorted((re.escape(name) for name in self.names), key=len, reverse=True)
        return json.loads(re.sub(rf"(?<![\w-])(?:{'|'.join(known)})(?![\w-])", lambda m: self.names[m[0]], text))


def bench(folder: Path, channels: Mapping[str, Any], names: Mapping[str, str]) -> Path:
    """A bench file with these channels and names; units keep titles and colours. Other inputs are spare."""
    file = yaml.safe_load(shipped("benches/simulated.yaml").read_text(encoding="utf-8"))
    file["standards"] = [str(shipped(f"standards/{Path(one).name}")) for one in file["standards"]]
    file["simulated"]["world"] = str(shipped("worlds/clean.yaml"))
    kept = {row["unit"] for row in channels.values()}
    units = {UNITS[name]: one for name, one in CUBE["units"].items() if name in kept}
    sensor = {**CUBE, "units": units, "primary": UNITS["unit_a"]}
    sensor["channels"] = {names[name]: {**row, "unit": UNITS[row["unit"]]} for name, row in channels.items()}
    gone = CUBE["channels"].keys() - channels.keys()
    file["cables"] = {
        which: [f"spare {place}" if name in gone else names[name] for place, name in enumerate(wires)]
        for which, wires in file["cables"].items()
    }
    file["signals"] = {role: names[of] for role, of in (("reference", "ldv"), ("supply", "supply"))}
    file["signals"]["temperature"] = names["temperature"]
    file["instruments"]["encoder"] |= {output: names[of] for output, of in ENCODER.items()}
    file["instruments"]["recorder"]["tag"] = names["tag"]
    file["sensors"] = "sensor.yaml"
    folder.mkdir()
    for name, body in (("sensor.yaml", sensor), ("bench.yaml", file)):
        (folder / name).write_text(yaml.safe_dump(body, allow_unicode=True, sort_keys=False), encoding="utf-8")
    return folder / "bench.yaml"


def measured(folder: Path, file: Path, names: Mapping[str, str]) -> Measured:
    world = fast_bench.world(SEED, [CUBIC])
    found = [fast_bench.keep(one, world, folder / "runs", bench=file) for one in DOCUMENTS]
    units = {mine: shipped_name for shipped_name, mine in UNITS.items()} if names is not SHIPPED else {}
    back = {mine: shipped_name for shipped_name, mine in names.items()} | units
    return Measured(folder / "runs", back, found[0], found[1], tuple(found[2:]))


SHIPPED = {name: name for name in OTHER}


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    return measured(tmp_path_factory.mktemp("usual"), fast_bench.BENCH, SHIPPED)


@pytest.fixture(scope="module")
def renamed(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    folder = tmp_path_factory.mktemp("renamed")
    return measured(folder, bench(folder / "bench", CUBE["channels"], OTHER), OTHER)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    folder = tmp_path_factory.mktemp("alone")
    channels = {name: CUBE["channels"][name] for name in ALONE}
    return measured(folder, bench(folder / "bench", channels, OTHER), OTHER)


def differences(one: Any, other: Any, where: str = "") -> Iterator[str]:
    """Where two answers differ: numbers by more than 1e-9, anything else at all."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in [*one, *(key for key in other if key not in one)]:
            yield from differences(one.get(key), other.get(key), f"{where}/{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for place, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from differences(a, b, f"{where}/{place}")
    elif isinstance(one, float) and isinstance(other, float):
        if abs(one - other) > 1e-9 * max(abs(one), abs(other)):
            yield f"{where}: {one} and {other}"
    elif one != other:
        yield f"{where}: {one} and {other}"


def same(one: Any, other: Any) -> None:
    found = list(differences(one, other))
    assert not found, "\n".join(found[:20])


def test_a_calibration_has_the_same_numbers_under_other_names(usual: Measured, renamed: Measured) -> None:
    same(*(one.asked("calibrate", *one.all, "--name", "merged") for one in (usual, renamed)))
    for format in ("csv", "mat", "hdf5", "python"):
        assert renamed.asked("export", "merged", "--to", format)["files"]
    same(*(one.asked("compare-calibrations", "merged", "merged") for one in (usual, renamed)))


def test_comparing_diagnosing_and_repairing_give_the_same_numbers(usual: Measured, renamed: Measured) -> None:
    for words in (("compare",), ("diagnose",), ("add", "cubic", "--on", "acceleration")):
        # a model of its own: the unit's is what other tests calibrate by
        found = [
            one.asked(*words[:2], *one.all[:2], *words[2:], "--model", str(one.runs / "repaired.yaml"))
            for one in (usual, renamed)
        ]
        same(*found)


@pytest.mark.parametrize("which", ["renamed", "alone"])
def test_certificate_report_and_figures_are_made_under_any_names(which: str, request: pytest.FixtureRequest) -> None:
    one: Measured = request.getfixturevalue(which)
    assert Path(json.loads(one.said("certify", *one.all, "--name", "paper", "--json"))["dcc"]).exists()
    assert Path(json.loads(one.said("report", *one.all, "--json"))["report"]).exists()
    for run in one.all:
        assert "not calibrated" not in one.said("show", run)


def test_one_accelerometer_and_one_gyro_have_the_numbers_that_they_have_among_fifteen(
    usual: Measured, alone: Measured
) -> None:
    many, few = (
        {row["key"]: row for row in one.asked("calibrate", *one.all, "--name", "again")["results"]}
        for one in (usual, alone)
    )
    assert {key.partition(".")[0] for key in few} == set(ALONE)
    for key, row in few.items():
        mine = many[key]
        assert (row["status"], row["unit"], row["method"]) == (mine["status"], mine["unit"], mine["method"])
        if row["value"] is None:
            same(mine, row)
        elif row["method"].startswith("model fitted"):
            # among fifteen the others say something of the reference's noise; the direct estimate knows none of them
            assert abs(row["value"] - mine["value"]) < 0.6 * row["u"], key
            same(mine["check"]["value"], row["check"]["value"])
        else:  # noise is referred to the input by the sensitivity
            assert abs(row["value"] - mine["value"]) < 0.05 * row["u"], key
            assert row["u"] == pytest.approx(mine["u"], rel=1e-3)
    assert f"{ALONE[0]}.sensitivity_gravity" in few


def test_one_accelerometer_and_one_gyro_are_compared_and_diagnosed(alone: Measured) -> None:
    assert {group["channels"][0] for group in alone.asked("compare", *alone.all[:2])["groups"]} == set(ALONE)
    assert alone.asked("diagnose", *alone.all[:2])["verdict"]
    alone.said("add", "cubic", *alone.all[:2], "--on", "acceleration", "--model", str(alone.runs / "repaired.yaml"))


def test_what_needs_a_triad_says_so_and_the_rest_is_exported(alone: Measured) -> None:
    alone.said("calibrate", *alone.all, "--name", "few")
    for format in ("csv", "mat", "hdf5", "python"):
        alone.said("export", "few", "--to", format)
    with pytest.raises(BadInput, match="found near along x alone, wanted a triad"):
        alone.said("export", "few", "--to", "ros2")


def test_the_served_bench_knows_places_and_not_our_names(tmp_path: Path) -> None:
    file = bench(tmp_path / "bench", CUBE["channels"], OTHER)
    runs = tmp_path / "runs"
    words = ("sweep", "--axis", "z", "--points", "2", "--bench", str(file), "--runs", str(runs))
    try:
        CliRunner().invoke(cli, words, catch_exceptions=False, standalone_mode=False)
    finally:
        control.stop(state_folder(describe(file), runs))
    run = Runs(runs).open("last")
    asked = [e.body["settings"] for e in run.lines() if e.body.get("action") == "plug_analyzer"]
    assert asked == [{"input": 2, "slot": 4}]
    traces = next(e.body["meta"] for e in run.lines() if e.kind == "block" and e.body["meta"]["kind"] == "traces")
    assert traces["names"] == ["laser", *(OTHER[f"unit_a_{axis}"] for axis in "xyz")]
    response = next(e.body for e in run.lines() if e.kind == "point" and "response" in e.body)
    ratio = complex(*run.block(response["response"])[round(response["frequency"] / 2.5), 1:3])
    assert abs(ratio) > 0.01  # V of unit A z for one V of the vibrometer
