"""Long work says what it is at, to a terminal alone, and Ctrl-C ends it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import imported_runs
import imported_worlds as worlds
import pytest
from imported_worlds import Unit

from rig.diagnose.diagnose import diagnose


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder with a log of two minutes."""
    folder = tmp_path / "runs"
    imported_runs.kept(worlds.rotation(Unit(), 3, seconds=120.0), folder)
    return folder


def diagnosing(runs: Path, stderr: int) -> subprocess.Popen[bytes]:
    line = [sys.executable, "-m", "rig", "diagnose", "last", "--runs", str(runs)]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=stderr, cwd=runs.parent)


def read_until(terminal: int, words: bytes) -> bytes:
    """What a terminal shows up to these words."""
    seen = b""
    while words not in seen:
        seen += os.read(terminal, 4096)
    return seen


def test_a_diagnosis_says_what_it_is_at_and_ctrl_c_ends_it_with_130(runs: Path) -> None:
    terminal, other = os.openpty()
    process = diagnosing(runs, other)
    os.close(other)
    seen = read_until(terminal, b"looking for effect 1")
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    os.close(terminal)
    assert b"reading the runs" in seen
    assert process.returncode == 130
    assert b"verdict" not in out


def test_without_a_terminal_nothing_is_said_of_it(runs: Path) -> None:
    process = diagnosing(runs, subprocess.PIPE)
    out, error = process.communicate(timeout=60)
    assert process.returncode == 0
    assert b"verdict" in out
    assert b"looking" not in error


def test_who_waits_hears_of_every_effect_found() -> None:
    log = worlds.changed(
        worlds.rotation(Unit(), 3, seconds=30.0, channels="r"), "gyro_z", lambda rate: rate + 0.02 * rate**2
    )
    heard: list[str] = []
    found = diagnose(worlds.evidence(log), told=heard.append)
    assert found.named
    assert heard[0] == "fitting the model as it is"
    assert any(said.startswith("looking for effect 2") and found.named[0] in said for said in heard)
