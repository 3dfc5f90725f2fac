"""Who waits for a lifeline is told that its holder has died, however much its end has to clear away."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading

import pytest

from rig.bench.lifeline import Lifeline

HOLDER = """
import sys
from rig.bench.lifeline import Lifeline
line = Lifeline(int(sys.argv[1]))
line.hold()
print("held", flush=True)
sys.stdin.read()
line.let_go()
print("let go", flush=True)
sys.stdin.read()
"""


def held(line: Lifeline) -> subprocess.Popen[bytes]:
    """A process that holds it until its standard input is closed."""
    command, pipes = [sys.executable, "-c", HOLDER, str(line.descriptor)], {"stdin": -1, "stdout": -1}
    holder = subprocess.Popen(command, pass_fds=[line.descriptor], **pipes)  # type: ignore[call-overload]
    assert holder.stdout.readline() == b"held\n"
    assert isinstance(holder, subprocess.Popen)
    return holder


def new() -> Lifeline:
    line = Lifeline.new()
    if line is None:
        pytest.skip("no robust mutexes here")
    return line


def asked(line: Lifeline) -> tuple[threading.Thread, list[bool]]:
    said: list[bool] = []
    waiting = threading.Thread(target=lambda: said.append(line.broken()), daemon=True)
    waiting.start()
    return waiting, said


def test_a_holder_that_was_killed_has_broken_it() -> None:
    line = new()
    with held(line) as holder:
        waiting, said = asked(line)
        waiting.join(0.2)
        assert said == []  # while it lives nothing is said
        holder.send_signal(signal.SIGKILL)
        waiting.join(60.0)
        assert said == [True]


def test_a_holder_that_has_let_go_has_not() -> None:
    line = new()
    with held(line) as holder:
        waiting, said = asked(line)
        assert holder.stdin is not None
        holder.stdin.close()
        waiting.join(60.0)
        assert said == [False]


def test_one_that_was_broken_before_anybody_asked_says_so() -> None:
    line = new()
    with held(line) as holder:
        holder.kill()
    assert line.broken()
