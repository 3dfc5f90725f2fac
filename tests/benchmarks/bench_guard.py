"""The bench's state is told truthfully, however a program ends: sixty kills with the source on, and every other end.

The source's own record is the twin's log. The time that a kill takes is compared with what a fresh connection needs to
switch the source off and read it back, in the same run.
"""

from __future__ import annotations

import importlib
import os
import random
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from driven import Driven, driving, on, plant, sources

from rig.archive.runs import Runs
from rig.bench.clock import SystemClock
from rig.bench.control import served
from rig.room import Room

KILLS = int(os.environ.get("RIG_KILLS", "60"))
EACH = int(os.environ.get("RIG_ENDS", "4"))  # times that each other end is tried
BAR = 0.100  # s from the kill to the source off
TIMES = 3.0  # of one fresh connection


def test_sixty_kills_lose_no_point_and_leave_the_source_off(tmp_path: Path) -> None:
    draws, rows, lost = random.Random(5), [], 0
    for k in range(KILLS):
        folder = tmp_path / str(k)
        folder.mkdir()
        with driving(folder) as one:
            one.until_on()
            threading.Event().wait(draws.uniform(0.0, 1.0))
            points = len(Runs(one.runs).list()[0].points())
            killed = time.monotonic()
            one.program.kill()
            one.ended()  # nobody asks the twin meanwhile
            off = one.off_after(killed) - killed
            run = Runs(one.runs).list()[0]
            lost += max(points - len(run.points()), 0) + len(run.verify())
            rows.append((off, _fresh(one)))
    offs, fresh = zip(*rows, strict=True)
    median, once = statistics.median(offs), statistics.median(fresh)
    print(
        f"\n{KILLS} kills with the source on: off after a median of {median * 1e3:.1f} ms, "
        f"worst {max(offs) * 1e3:.0f} ms; "
        f"a fresh connection with OUTP OFF;:OUTP? takes {once * 1e3:.1f} ms (ratio {median / once:.2f}); "
        f"points lost: {lost}"
    )
    assert lost == 0
    assert median <= TIMES * once
    assert max(offs) < BAR


def _fresh(one: Driven) -> float:
    """How long a fresh connection takes to switch the source off and read it back, s."""

    class Nobody:
        def ask(self, request: object) -> None:
            raise AssertionError(request)

    addresses = served(one.runs / ".bench" / "simulated")
    assert addresses is not None
    links = importlib.import_module("drivers.links")
    gateway = f"PRLGX-TCPIP0::127.0.0.1::{addresses['gpib']}::INTFC"
    begun = time.monotonic()
    link = links.VisaLink.open(
        "analyzer", "GPIB0::19::INSTR", gateway=gateway, timeout=3.0, room=Room(SystemClock(), Nobody())
    )
    assert link.query("OUTP OFF;:OUTP?").lstrip("+") == "0"
    took = time.monotonic() - begun
    link.close()
    return took


def _interrupt(number: signal.Signals) -> Callable[[Driven], None]:
    return lambda one: one.program.send_signal(number)


def _stop_and_go_on(one: Driven) -> None:
    one.program.send_signal(signal.SIGSTOP)
    one.off_after(time.monotonic())
    one.program.send_signal(signal.SIGCONT)


def _both(one: Driven) -> None:
    os.kill(one.guard, signal.SIGSTOP)
    one.program.kill()
    os.kill(one.guard, signal.SIGKILL)


def _silence(one: Driven) -> None:
    plant(one.runs, "gpib.silence", True)


def _silence_and_interrupt(one: Driven) -> None:
    plant(one.runs, "gpib.silence", True)
    one.program.send_signal(signal.SIGINT)


ENDS: dict[str, Callable[[Driven], None]] = {
    "Ctrl-C": _interrupt(signal.SIGINT),
    "SIGTERM": _interrupt(signal.SIGTERM),
    "SIGHUP": _interrupt(signal.SIGHUP),
    "SIGKILL": _interrupt(signal.SIGKILL),
    "SIGSTOP": _stop_and_go_on,
    "guard killed": lambda one: os.kill(one.guard, signal.SIGKILL),
    "both killed": _both,
    "gateway hung": _silence,
    "gateway hung, Ctrl-C": _silence_and_interrupt,
}


@pytest.mark.parametrize("end", ENDS)
def test_off_is_never_said_while_the_source_is_on(end: str, tmp_path: Path) -> None:
    draws, lies, said_off, left_on = random.Random(end), 0, 0, 0
    for k in range(EACH):
        folder = tmp_path / str(k)
        folder.mkdir()
        with driving(folder) as one:
            one.until_on()
            threading.Event().wait(draws.uniform(0.0, 1.0))
            ENDS[end](one)
            code, said = one.ended()
            next_one = _asked(folder, "bench", "check")
            is_on = on(sources(one.runs))
            claims = "off, read back" in said or next_one.returncode == 0
            tells = "NOT SAFE" in said + next_one.stderr and code != 0
            left_on, said_off, lies = (
                left_on + is_on,
                said_off + claims,
                lies + (claims and is_on) + (is_on and not tells),
            )
            if is_on:
                plant(one.runs, "gpib.silence", None)
                assert _asked(folder, "bench", "safe").returncode == 0
                assert not on(sources(one.runs))
    print(
        f"\n{end}: {EACH} times; source left on {left_on}, off said {said_off}, "
        f"off said while on, or on and not told: {lies}"
    )
    assert lies == 0


@pytest.mark.parametrize("loops", [0, 4])
def test_a_main_thread_that_hangs_is_off_within_five_seconds(loops: int, tmp_path: Path) -> None:
    with busy(loops), driving(tmp_path, deaf=True) as one:
        one.until_on()
        since = one.deaf_since()
        took = one.off_after(since) - since
    print(f"\nmain thread waits for ever, {loops} busy loops beside: off after {took:.2f} s")
    assert took < (5.0 if not loops else 6.0)


def test_a_busy_machine_does_not_trip_the_guard(tmp_path: Path) -> None:
    with busy(4):
        done = _asked(tmp_path, "sweep", "--axis", "x")
        turned = _asked(tmp_path, "turntable")
    logs = [path.read_text() for path in (tmp_path / "runs").glob("*/guard.jsonl")]
    print(f"\nfour busy loops beside: exit codes {done.returncode} and {turned.returncode}")
    assert (done.returncode, turned.returncode) == (0, 0), done.stderr + turned.stderr
    assert len(logs) == 2
    assert not any("acting" in log for log in logs)


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Programs that do nothing but keep the machine busy."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for one in others:
            one.kill()
            one.wait()


def _asked(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rig", *words, "--runs", str(folder / "runs")]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
