"""One run on the shaker and on the turntable: killed at any place it goes on, and is read as the experiments it was."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.archive.runs import Runs
from rig.bench.control import stop

G = 9.80665  # m/s²
DEGREE = 3.14159265 / 180.0
KILLED = Path(__file__).parent / "killed.py"
MIXED = """
title: A sweep and both senses of the turntable
steps:
  - {procedure: frequency_sweep, axis: x, points: 2, levels: [full], static: 1 s}
  - {procedure: turntable, axis: yaw, revolutions: 6, rest: 2 s}
  - {procedure: turntable, axis: yaw, revolutions: 6, rest: 2 s, inverted: true}
"""
# Where the run is killed: after which line of the journal. What the next attempt carries out first: kind and step.
PLACES = [
    ("point", '"frequency"', ("repeated", "Sine")),
    ("confirmed", '"set": "turntable"', None),
    ("confirmed", '"mount_on_turntable"', None),
    ("confirmed", '"rpm": 45.0', ("prepared", "Spin")),
    ("point", '"spin_up"', ("repeated", "Spin")),
    ("point", '"hold"', ("repeated", "Spin")),
    ("confirmed", '"inverted": true', None),
]


class Bench:
    """A runs folder with its simulated bench, and the command as a technician gives it."""

    def __init__(self, runs: Path) -> None:
        self.runs = runs

    def rig(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return _carried_out(["-m", "rig", *arguments, "--runs", str(self.runs)], 0)

    def killed(self, line: str, holding: str, *arguments: str) -> None:
        _carried_out([str(KILLED), line, holding, *arguments, "--runs", str(self.runs)], -signal.SIGKILL)


def _carried_out(arguments: list[str], wanted: int) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
    )
    assert done.returncode == wanted, (done.returncode, done.stdout[-2000:], done.stderr[-2000:])
    assert "Traceback" not in done.stderr
    return done


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path / "runs")
    yield made
    stop(made.runs / ".bench" / "simulated")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_mixed_sequence_killed_at_every_kind_of_place_is_completed_and_calibrates(
    bench: Bench, tmp_path: Path
) -> None:
    procedure = tmp_path / "mixed.yaml"
    procedure.write_text(MIXED, encoding="utf-8")
    command: tuple[str, ...] = ("run", str(procedure))
    for line, holding, _ in PLACES:
        bench.killed(line, holding, *command)
        command = ("resume", "last")
        assert Runs(bench.runs).open("last").status == "interrupted"
    bench.rig(*command)
    run = Runs(bench.runs).open("last")
    assert (run.status, len(run.points()), run.verify()) == ("completed", run.header["points_total"], [])
    assert _first_of_every_attempt(run) == [first for _, _, first in PLACES]
    _knows_both_experiments(bench)


def _first_of_every_attempt(run: Any) -> list[tuple[str, str] | None]:
    """What every resumed attempt carried out before it went on, and the kind of that step."""
    found: list[tuple[str, str] | None] = []
    for entry in run.lines():
        if entry.kind == "resumed":
            found.append(None)
        elif entry.kind in ("repeated", "prepared"):
            assert found[-1] is None, "one attempt repeats one step"
            found[-1] = (entry.kind, run.header["steps"][entry.body["index"]]["kind"])
    return found


def _knows_both_experiments(bench: Bench) -> None:
    shown = bench.rig("show", "last").stdout
    for channel in ("unit_a_x", "unit_b_x", "unit_c_x", "gyro_yaw", "backup_yaw"):
        assert channel in shown
    made = json.loads(bench.rig("calibrate", "last", "--json").stdout)
    values = {row["key"]: row["value"] for row in made["results"]}
    # 0.5 % scatter of the sensors, 1 % (k = 2) of the vibrometer's gain
    assert values["unit_a_x.sensitivity"] * G == pytest.approx(0.650, rel=0.03)
    assert values["gyro_yaw.sensitivity"] * DEGREE == pytest.approx(3.71e-3, rel=0.03)
    assert values["gyro_yaw.asymmetry"] == pytest.approx(0.0, abs=0.01)
