"""A `rig` that drives the source of its own simulated bench, for tests that stop it: what the twin's log says of it.

`python driven.py deaf ARGUMENTS…` is `rig` whose main thread waits for ever once the source has been on for a while.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from rig.bench.control import Control, served, stop

T = TypeVar("T")
DEAF = "deaf since "
LONG = "procedure: frequency_sweep\naxis: x\npoints: 90\nstatic: 1 s\n"
"""A sweep that is not over before it is stopped."""


def until(ready: Callable[[], T], deadline: float = 120.0) -> T:
    """What `ready` gives as soon as it is something."""
    over = time.monotonic() + deadline
    while not (found := ready()):
        assert time.monotonic() < over, "waited in vain"
        threading.Event().wait(0.005)
    return found


@dataclass
class Driven:
    """A program at work on the bench of its own folder of runs, and its guard."""

    runs: Path
    program: subprocess.Popen[str]
    guard: int = 0

    def until_on(self) -> None:
        """Until the twin's source is on."""
        until(lambda: self.program.poll() is not None or on(sources(self.runs)))
        assert self.program.poll() is None, self.program.communicate()[1]
        children = Path(f"/proc/{self.program.pid}/task/{self.program.pid}/children").read_text().split()
        (self.guard,) = [int(pid) for pid in children if b"rig.bench.guard" in _command(pid)]

    def off_after(self, since: float) -> float:
        """When the source went off after `since` (monotonic clock, s), by the twin's log."""
        later = until(lambda: [one for one in sources(self.runs) if one["wall"] > since and not one["on"]])
        return float(later[0]["wall"])

    def deaf_since(self) -> float:
        """When its main thread began to wait for ever (monotonic clock, s)."""
        assert self.program.stderr is not None
        for line in self.program.stderr:
            if line.startswith(DEAF):
                return float(line.removeprefix(DEAF))
        raise AssertionError("it ended before")

    def ended(self) -> tuple[int, str]:
        """Its exit code and what it said on standard error, once its guard is gone too."""
        said = self.program.communicate()[1]
        until(lambda: not self.guard or not _command(self.guard))
        return self.program.returncode, said

    def end(self) -> None:
        """Kill what still lives; the bench ends when the guard has acted."""
        if self.program.poll() is None:
            self.program.kill()
        self.program.wait()
        until(lambda: not self.guard or not _command(self.guard))
        if self.runs.exists():
            stop(self.runs / ".bench" / "simulated")


def _command(pid: int | str) -> bytes:
    """Command line of a process; empty if it is gone."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def sources(runs: Path) -> list[dict[str, Any]]:
    """The twin's own record of its source."""
    addresses = served(runs / ".bench" / "simulated")
    if addresses is None:
        return []
    with Control(int(addresses["control"])) as control:
        return [event for event in control.ask("log")["events"] if event["event"] == "source"]


def plant(runs: Path, fault: str, value: object) -> None:
    """Plant a fault in the bench of this folder; None takes it out."""
    addresses = served(runs / ".bench" / "simulated")
    assert addresses is not None
    with Control(int(addresses["control"])) as control:
        control.ask("fault", name=fault, value=value)


def on(events: Sequence[dict[str, Any]]) -> bool:
    """Whether the source is on after these events."""
    return bool(events) and bool(events[-1]["on"])


@contextlib.contextmanager
def driving(folder: Path, *options: str, procedure: str = LONG, deaf: bool = False) -> Iterator[Driven]:
    """The program in this folder, with the bench of `runs` in it; both are ended afterwards."""
    (folder / "long.yaml").write_text(procedure)
    command = [sys.executable, "-m", "rig"] if not deaf else [sys.executable, __file__, "deaf"]
    program = subprocess.Popen(
        [*command, "run", "long.yaml", "--runs", str(folder / "runs"), *options],
        cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    driven = Driven(folder / "runs", program)
    try:
        yield driven
    finally:
        driven.end()


def _deaf_after(switchings: int) -> None:
    """Let the main thread wait for ever after the source was asked to move so many times, and say when it begins."""
    from drivers.hp89410a import HP89410A

    asked, left = HP89410A.set_sine, [switchings]

    def last(self: HP89410A, frequency: float, amplitude: float) -> None:
        asked(self, frequency, amplitude)
        left[0] -= 1
        if left[0] < 0:
            print(f"\n{DEAF}{time.monotonic()}", file=sys.stderr, flush=True)
            threading.Event().wait()

    HP89410A.set_sine = last  # type: ignore[method-assign]


if __name__ == "__main__":
    from rig.cli import main

    _deaf_after(20)
    sys.argv = ["rig", *sys.argv[2:]]
    main()
