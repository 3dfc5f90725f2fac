"""A sweep stopped at any moment: completed points are kept, the source is off at once, and the run can be resumed."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from rig.archive.runs import Runs
from rig.bench.control import Control, served, stop

BAR = 0.100  # s, real time, from the signal to the twin's own `source off`


def events(runs: Path) -> list[dict[str, Any]]:
    addresses = served(runs / ".bench" / "simulated")
    assert addresses is not None
    with Control(int(str(addresses["control"]))) as control:
        return [event for event in control.ask("log")["events"] if event["event"] == "source"]


def until(ready: Any, deadline: float = 200.0) -> Any:
    over = time.monotonic() + deadline
    while not (found := ready()):
        assert time.monotonic() < over, "waited in vain"
        threading.Event().wait(0.005)
    return found


def points(runs: Path) -> int:
    found = Runs(runs).list() if runs.exists() else []
    return len(found[0].points()) if found else 0


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("after", [1, 5])
def test_a_killed_sweep_loses_nothing_ends_at_rest_and_goes_on(
    tmp_path: Path, number: signal.Signals, after: int
) -> None:
    runs = tmp_path / "runs"
    program = subprocess.Popen(
        [sys.executable, "-m", "rig", "sweep", "--axis", "x", "--points", "6", "--runs", str(runs)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    until(lambda: points(runs) >= after)
    before, sent = points(runs), time.monotonic()
    program.send_signal(number)
    _, said = program.communicate()
    off = until(lambda: [e for e in events(runs) if e["wall"] > sent and not e["on"]])
    assert off[0]["wall"] - sent < BAR
    assert program.returncode == (130 if number != signal.SIGKILL else -signal.SIGKILL)
    assert "Traceback" not in said
    assert number == signal.SIGKILL or "interrupted; analyzer: off, read back\n" in said
    assert points(runs) >= before
    run = Runs(runs).list()[0]
    assert run.status == "interrupted"
    assert run.verify() == []
    resumed = subprocess.run(
        [sys.executable, "-m", "rig", "resume", "last", "--runs", str(runs)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert resumed.returncode == 0, resumed.stderr
    assert run.status == "completed"
    assert len(run.points()) == 12
    assert run.verify() == []
    assert any(entry.kind == "repeated" for entry in run.lines())
    stop(runs / ".bench" / "simulated")
