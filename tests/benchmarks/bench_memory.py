"""Anonymous memory while a long record of sixteen channels is concluded: a quarter of an hour, and an hour.

The records are written by the bench in this process (four minutes of processor time); what is watched is each command
as a process of its own. Mapped files do not count: they can be given back at any moment.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fast_bench
import pytest

MINUTES = (15, 60)
MOST = 300.0  # MB
GROWTH = 1.1  # of the quarter of an hour
OFTEN = 0.003  # s between two looks
DOCUMENTS: dict[str, Callable[[int], dict[str, Any]]] = {
    "noise": lambda minutes: {"procedure": "noise", "length": f"{60 * minutes} s"},
    "turntable": lambda minutes: {
        "procedure": "turntable", "speed": "45 rpm", "axis": "yaw", "revolutions": 45 * minutes
    },
}  # fmt: skip


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_an_hour_is_concluded_with_no_more_memory_than_a_quarter_of_it(kind: str, tmp_path: Path) -> None:
    most: dict[str, list[float]] = {"show": [], "calibrate": []}
    for minutes in MINUTES:
        runs = tmp_path / str(minutes)
        fast_bench.keep(DOCUMENTS[kind](minutes), fast_bench.world(1), runs)
        for command, found in most.items():
            shutil.rmtree(runs / ".cache", ignore_errors=True)
            found.append(_anonymous([sys.executable, "-m", "rig", command, "last", "--runs", str(runs)]))
            print(f"\n{minutes} min of {kind}: {command} takes {found[-1]:.0f} MB of anonymous memory")
        shutil.rmtree(runs)
    for quarter, hour in most.values():
        assert hour <= MOST
        assert hour <= GROWTH * quarter


def _anonymous(command: list[str]) -> float:
    """Most anonymous memory of a process at any moment, MB."""
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    most, status = 0, Path(f"/proc/{child.pid}/status")
    while child.poll() is None:
        said = re.search(r"RssAnon:\s+(\d+)", status.read_text())
        most = max(most, int(said[1]) if said else 0)
        time.sleep(OFTEN)
    assert child.returncode == 0
    return most / 1024.0
