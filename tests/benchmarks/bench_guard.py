"""Fifty sweeps killed at moments spread over the whole run: nothing completed is lost, and the source is off."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

from rig.archive.runs import Runs
from rig.bench.control import Control, served

KILLS = 50
LONGEST = 6.0  # s; a default sweep is over by then
BAR = 0.100  # s from the kill to the source off


def test_fifty_kills_lose_no_point_and_leave_the_source_off(tmp_path: Path) -> None:
    rows = [_killed(tmp_path, 0.3 + (LONGEST - 0.3) * k / KILLS) for k in range(KILLS)]
    live = [row for row in rows if row[2] is not None]
    print(
        f"\n{KILLS} kills, {len(live)} while the source was on; points journalled before the kill and lost: "
        f"{sum(row[1] for row in rows)}; source off after the kill: median {_median(live) * 1e3:.0f} ms, "
        f"worst {max(row[2] for row in live) * 1e3:.0f} ms (bar {BAR * 1e3:.0f} ms)"
    )
    assert sum(row[1] for row in rows) == 0
    assert len(live) > KILLS // 3
    assert all(row[2] < BAR for row in live)


def _median(rows: list[tuple[int, int, float | None]]) -> float:
    return sorted(row[2] or 0.0 for row in rows)[len(rows) // 2]


def _killed(runs: Path, after: float) -> tuple[int, int, float | None]:
    """Points before the kill, how many of them are gone, and how long the source stayed on (s), if it was on."""
    before = {run.name for run in Runs(runs).list()} if runs.exists() else set()
    program = subprocess.Popen(
        [sys.executable, "-m", "rig", "sweep", "--axis", "x", "--runs", str(runs)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    threading.Event().wait(after)
    mine = [run for run in Runs(runs).list() if run.name not in before]
    points = len(mine[0].points()) if mine else 0
    killed = time.monotonic()
    program.send_signal(signal.SIGKILL)
    program.wait()
    stayed = _stayed_on(runs, killed)
    kept = len(mine[0].points()) if mine else 0
    assert not mine or mine[0].verify() == []
    return points, max(points - kept, 0), stayed


def _stayed_on(runs: Path, killed: float) -> float | None:
    """From the kill to the twin's own `source off`; None if it was off already, or nothing was connected yet."""
    addresses = served(runs / ".bench" / "simulated")
    if addresses is None:
        return None
    deadline = time.monotonic() + 15.0
    with Control(int(str(addresses["control"]))) as control:
        while True:
            events = [e for e in control.ask("log")["events"] if e["event"] == "source"]
            earlier = [e for e in events if e["wall"] <= killed]
            later = [e for e in events if e["wall"] > killed and not e["on"]]
            if not earlier or not earlier[-1]["on"]:
                return None
            if later:
                return float(later[0]["wall"]) - killed
            assert time.monotonic() < deadline, "the source is still on"
            threading.Event().wait(0.02)
