"""A run of several procedures is read as its experiments: each gives what it would give as a run of its own."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import fast_bench
import numpy as np
import pytest

from rig.archive.records import experiments
from rig.bench import resuming
from rig.bench.steps import AlignBeam, Ask, Sine, Spin, Static, Step
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration
from rig.fit.evidence import evidence_of
from rig.report.run_figures import draw

SWEEP = {"procedure": "frequency_sweep", "points": 3, "static": "1 s"}
TURNTABLE = {"procedure": "turntable", "revolutions": 6, "rest": "2 s"}
SEQUENCE: Mapping[str, Any] = {
    "title": "Everything, in an order that remounts the cube between any two",
    "steps": [
        {**TURNTABLE, "axis": "pitch", "all": True},
        {**SWEEP, "axis": "x", "static": "0 s"},  # straight from the turntable's cables, with no record at rest before
        {"prompt": "Is the cube still warm?"},
        {"procedure": "tumble", "poses": 6, "record": "1 s"},
        {**SWEEP, "axis": "y"},
        {"wait": "10 s"},
        {"procedure": "noise", "length": "20 s", "cables": "turntable"},
        {**TURNTABLE, "axis": "yaw"},
        {**SWEEP, "axis": "z"},
        {**SWEEP, "axis": "x"},
    ],
}
COUNT = 8


@pytest.fixture(scope="module")
def mixed() -> fast_bench.MemoryRecords:
    return fast_bench.measure(SEQUENCE, fast_bench.world(5))


@pytest.fixture(scope="module")
def apart(mixed: fast_bench.MemoryRecords) -> list[fast_bench.MemoryRecords]:
    """The same records as runs of one procedure each: the journal cut where the operator was asked for cables."""
    common = [entry for entry in mixed.lines if entry.kind in ("header", "settings")]
    cuts = [n for n, e in enumerate(mixed.lines) if e.kind == "confirmed" and e.body["action"] == "cables"]
    header = {key: value for key, value in mixed.header.items() if key not in ("experiments", "steps")}
    found = []
    for first, end in itertools.pairwise([*cuts, len(mixed.lines)]):
        lines = [*common, *mixed.lines[first:end]]
        points = {int(e.body["index"]): e.body for e in lines if e.kind == "point"}
        name = f"{mixed.name}-{len(found) + 1}"
        found.append(replace(mixed, name=name, header=header, lines=lines, points=points))
    return found


@pytest.fixture(scope="module")
def whole(mixed: fast_bench.MemoryRecords) -> Calibration:
    return calibrate([mixed], "one")


def everything(made: Calibration) -> str:
    """All that was concluded, whatever the runs are called."""
    called = re.sub(r"(seed-5-sequence)-\d", r"\1", repr((made.results, made.responses, made.paper, made.conditions)))
    return re.sub(r"(seed-5-sequence)(, \1)+( and \d+ more \(\w+\))?", r"\1", called)


def test_a_mixed_run_gives_the_same_calibration_as_its_experiments_as_runs_of_their_own(
    whole: Calibration, apart: list[fast_bench.MemoryRecords]
) -> None:
    pieces = calibrate(apart, "one")
    assert everything(whole) == everything(pieces)
    for key in ("unit_a_x.sensitivity", "unit_c_z.sensitivity", "unit_b_y.sensitivity_gravity", "unit_a_x.offset",
                "gyro_pitch.asymmetry", "backup_yaw.sensitivity", "gyro_yaw.deviation_in_motion"):  # fmt: skip
        assert whole.result(key).value is not None, key


def test_models_are_compared_with_the_same_parts(
    mixed: fast_bench.MemoryRecords, apart: list[fast_bench.MemoryRecords]
) -> None:
    whole, pieces = evidence_of([mixed]), evidence_of(apart)
    assert [part.mounting for part in whole.parts][:4] == ["x", "y", "z", "x"]
    compared, noise = ([one for one in whole.parts if one.calibrates is both] for both in (True, False))
    assert [part.experiment for part in compared][4:] == ["turntable"] * 2 + ["poses"] * 5
    assert [part.experiment for part in noise] == ["turntable"]  # sweeps rest too shortly
    assert len({part.name for part in whole.parts}) == len(whole.parts)
    for mine, its in zip(whole.parts, pieces.parts, strict=True):
        np.testing.assert_array_equal(mine.target, its.target)
    assert [term.prior for term in whole.nuisances] == [term.prior for term in pieces.nuisances]


def test_every_experiment_has_its_own_lines_and_prompts_and_waits_belong_to_none(
    mixed: fast_bench.MemoryRecords, apart: list[fast_bench.MemoryRecords]
) -> None:
    found = experiments(mixed)
    assert [set(one.points) for one in found] == [set(one.points) for one in apart]
    assert [sum(e.kind == "settings" for e in one.lines) for one in found] == [
        sum(e.kind == "settings" for e in mixed.lines)
    ] * COUNT
    actions = [[e.body["action"] for e in one.lines if e.kind == "confirmed"] for one in found]
    assert all(one[0] == "cables" and "confirm" not in one for one in actions)


def test_a_run_written_before_experiments_were_on_record_is_read_the_same(mixed: fast_bench.MemoryRecords) -> None:
    older = {key: value for key, value in mixed.header.items() if key != "experiments"}
    found = experiments(replace(mixed, header=older))
    assert [set(one.points) for one in found] == [set(one.points) for one in experiments(mixed)]


def test_every_experiment_is_drawn(mixed: fast_bench.MemoryRecords, whole: Calibration, tmp_path: Any) -> None:
    drawn = draw(mixed, whole, tmp_path)  # type: ignore[arg-type]
    assert [path.stem for path in drawn] == ["response", "rotation", "rotation-2", "noise", "poses"]


ORDER: list[Step] = [
    Ask("cables"), Ask("mount"), AlignBeam("beam"), Sine("one"), Sine("two"), Static("after"),
    Ask("cables"), Ask("mount"), Static("rest", point=True), Spin("up", phase="spin_up"), Spin("hold"),
    Spin("down", phase="coast_down"), Ask("mount"), Static("rest", point=True),
]  # fmt: skip


@pytest.mark.parametrize(
    ("done", "wanted"),
    [
        (0, None), (2, None), (3, None),  # nothing measured in this mounting
        (4, ("repeated", 3)), (5, ("repeated", 4)),  # in the sweep
        (6, None), (7, None),  # a request is open: the cube may stand anywhere
        (8, None),  # at rest on the platter
        (9, ("prepared", 9)), (10, ("repeated", 9)), (11, ("repeated", 9)),  # turning, or not
        (12, None), (13, None), (14, None),
    ],
)  # fmt: skip
def test_only_what_the_mounting_permits_is_repeated(done: int, wanted: tuple[str, int] | None) -> None:
    found = resuming.again(ORDER, range(done))
    assert (None if found is None else (found.kind, found.index)) == wanted
    if found is not None and found.kind == "prepared":
        assert isinstance(found.step, Spin)
        assert found.step.phase == "coast_down"
