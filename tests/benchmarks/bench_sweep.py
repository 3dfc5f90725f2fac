"""How long a whole three-axes calibration sweep takes, where the time goes, and how quick `rig --help` is."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rig.bench.control import stop

SWEEP_BAR = 60.0  # s, real time, three axes of 48 points each
HELP_BAR = 6.0  # times a bare interpreter
TURNS = 21


def taken(*command: str) -> float:
    """Real time (s) of one program."""
    begun = time.perf_counter()
    subprocess.run([sys.executable, *command], check=True, capture_output=True)
    return time.perf_counter() - begun


@pytest.mark.timeout(300)
def test_three_axes_take_less_than_a_minute(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    begun = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "rig", "run", "three_axes.yaml", "--runs", str(runs), "--json"],
        check=True,
        capture_output=True,
        text=True,
    )
    wall = time.perf_counter() - begun
    found = json.loads(done.stdout)
    stop(runs / ".bench" / "simulated")
    shares = ", ".join(f"{name} {seconds / found['elapsed']:.0%}" for name, seconds in found["shares"].items())
    each = found["elapsed"] / found["points_done"]
    print(
        f"\nthree axes: {found['points_done']} points in {wall:.1f} s (bar {SWEEP_BAR:.0f} s), of which the run "
        f"{found['elapsed']:.1f} s, {each * 1e3:.0f} ms per point: {shares}"
    )
    assert (found["status"], found["points_done"]) == ("completed", 3 * 48)
    assert wall < SWEEP_BAR


def test_help_is_as_quick_as_a_shell_expects() -> None:
    pairs = [(taken("-m", "rig", "--help"), taken("-c", "pass")) for _ in range(TURNS)]
    with_help, bare = (statistics.median(times) for times in zip(*pairs, strict=True))
    print(f"\nrig --help: {with_help * 1e3:.0f} ms, bare interpreter {bare * 1e3:.0f} ms, ratio {with_help / bare:.1f}")
    assert with_help / bare <= HELP_BAR
