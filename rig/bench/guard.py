"""The guard: a small process that leaves the bench at rest when the program cannot.

It is started before anything is energised and holds the other end of a pipe. While heartbeats come in it does
nothing. When the pipe closes (the program was killed) or a heartbeat is overdue (the program hangs), it connects to
each instrument anew, through that instrument's own driver, and makes it safe. A program that has left the bench at rest
itself says so, and the guard ends without a word to the instruments.

On the pipe, one line each, from the program to the guard::

    {"instruments": [{"driver": "hp89410a", "name": "analyzer", "settings": {…}}], "within": 5.0, "log": "…"}
    beat 2.5        silence is allowed for 2.5 s from now, in real time
    disarm          the bench is at rest; nothing to do any more

The guard answers the first line with `armed`, or `failed <reason>`, and says nothing afterwards. What it does goes into
the log: JSON lines with `event` and `monotonic` (s, the machine's monotonic clock).
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata
import json
import multiprocessing
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Self

from rig.bench.clock import SystemClock
from rig.errors import RigError, WorkFailed
from rig.room import Confirmation, Request, Room

_TRY_FOR = 10.0  # s until the guard gives up
_ATTEMPT = 3.0  # s that one attempt at one instrument may take
_PAUSE = 0.02  # s between rounds of attempts
_ARM = 5.0  # s that arming may take


@dataclass(frozen=True)
class Charge:
    """One instrument to be made safe: its driver's name, its name on the bench, its settings from the bench file."""

    driver: str
    name: str
    settings: Mapping[str, Any]


class Guard:
    """The program's side. Leaving the `with` block without `disarm` lets the guard act, and waits until it has.

    >>> with Guard.start() as guard:                           # early: it starts up beside the program
    ...     guard.arm([Charge("hp89410a", "analyzer", {...})], within=5.0, log=run / "guard.jsonl")
    ...     guard.beat(within=2.0)                             # before anything that may take up to 2 s of silence
    ...     guard.disarm()                                     # the bench is at rest
    """

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    @classmethod
    def start(cls) -> Self:
        """Start the process without waiting for it; raises WorkFailed if it cannot be started."""
        try:
            process = subprocess.Popen(
                [sys.executable, "-m", "rig.bench.guard"],
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C at the terminal must not reach it
            )
        except OSError as error:
            raise WorkFailed(f"guard: cannot be started: {error}") from error
        return cls(process)

    @property
    def pid(self) -> int:
        """Process id of the guard."""
        return self._process.pid

    def arm(self, instruments: Sequence[Charge], *, within: float, log: Path) -> None:
        """Say what to make safe. Call it before anything is energised; the first beat is due `within` s from now.

        Raises WorkFailed if the guard cannot load a driver, or has not answered after 5 s.
        """
        order = {"instruments": [asdict(charge) for charge in instruments], "within": within, "log": str(log)}
        self._send(json.dumps(order))
        answer = self._answer(time.monotonic() + _ARM)
        if answer != "armed":
            raise WorkFailed(f"guard: found {answer!r}, wanted 'armed': nothing may be energised")

    def beat(self, within: float) -> None:
        """Promise another beat `within` s of real time; raises WorkFailed if the guard is gone or has acted."""
        self._send(f"beat {within:.3f}")

    def disarm(self) -> None:
        """Say that the bench is at rest, and wait until the guard has gone; raises WorkFailed if it had acted."""
        self._send("disarm")
        if self._process.wait(timeout=_ARM) != 0:
            raise WorkFailed("guard: it had acted before it was disarmed")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._process.wait(timeout=_TRY_FOR + 2 * _ATTEMPT)

    def _send(self, line: str) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line.encode() + b"\n")
        except (BrokenPipeError, ValueError) as error:
            raise WorkFailed("guard: it is gone or has acted already; the bench must be taken to be at rest") from error

    def _answer(self, until: float) -> str:
        assert self._process.stdout is not None
        received = b""
        while not received.endswith(b"\n"):
            if not select.select([self._process.stdout], [], [], max(until - time.monotonic(), 0.0))[0]:
                return "no answer"
            part = os.read(self._process.stdout.fileno(), 4096)
            if not part:
                return received.decode() or "a guard that has ended"
            received += part
        return received.decode().strip()


@dataclass(frozen=True)
class Log:
    """What the guard did, in JSON lines. A log that cannot be written never keeps the guard from acting."""

    path: Path

    def write(self, event: str, **details: object) -> None:
        line = json.dumps({"event": event, "monotonic": time.monotonic(), **details}) + "\n"
        with contextlib.suppress(OSError), self.path.open("a", encoding="utf-8") as file:
            file.write(line)


@dataclass(frozen=True)
class Duty:
    """One instrument with its driver loaded and its settings accepted."""

    name: str
    connect: Callable[[], Any]

    def act(self, log: Log) -> None:
        """Connect, make safe, close."""
        began = time.monotonic()
        try:
            driver = self.connect()
            driver.make_safe()
        except BaseException as error:
            log.write("attempt failed", instrument=self.name, error=f"{type(error).__name__}: {error}")
            raise
        log.write("made safe", instrument=self.name, took=time.monotonic() - began)
        driver.close()


class Pipe:
    """Lines from a file descriptor, with a time by which each must have come."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._received = descriptor, b""

    def line(self, until: float | None = None) -> str:
        """The next line. Raises TimeoutError when the monotonic clock passes `until`, EOFError when the pipe closes."""
        while b"\n" not in self._received:
            left = None if until is None else max(until - time.monotonic(), 0.0)
            if not select.select([self._descriptor], [], [], left)[0]:
                raise TimeoutError
            part = os.read(self._descriptor, 1 << 16)
            if not part:
                raise EOFError
            self._received += part
        line, self._received = self._received.split(b"\n", 1)
        return line.decode("utf-8", "replace")


class _Nobody:
    """The guard acts alone: nobody can be asked."""

    def ask(self, request: Request) -> Confirmation:
        raise WorkFailed(f"guard: nobody to ask: {request.text}")


def load_driver(name: str) -> ModuleType:
    """The driver module of this name: from `drivers`, else from an installed entry point of the group `rig.drivers`.

    Never an arbitrary dotted path: a YAML file must not be able to import code. Raises ImportError.
    """
    if not name.isidentifier():
        raise ImportError(f"found driver {name!r}, wanted a plain name such as 'hp89410a'")
    try:
        return importlib.import_module(f"drivers.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"drivers.{name}":
            raise
    for entry in importlib.metadata.entry_points(group="rig.drivers", name=name):
        module = entry.load()
        assert isinstance(module, ModuleType)
        return module
    raise ImportError(f"found no driver {name!r}, wanted a module of `drivers` or an entry point of `rig.drivers`")


def main() -> int:
    """Run the guard on standard input and output; 0 if it was disarmed, 1 if it had to act."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    _warm_up()
    pipe = Pipe(sys.stdin.fileno())
    try:
        duties, log, within = _orders(pipe.line())
    except EOFError:
        return 0  # the program ended, or thought better of it, before anything was energised
    except (RigError, ImportError, AttributeError, ValueError, TypeError, KeyError) as error:
        _say(f"failed {type(error).__name__}: {error}".replace("\n", "; "))
        return 1
    return _stand_guard(pipe, duties, log, within)


def _stand_guard(pipe: Pipe, duties: Sequence[Duty], log: Log, within: float) -> int:
    log.write("armed", instruments=[duty.name for duty in duties], pid=os.getpid())
    until = time.monotonic() + within
    _say("armed")
    because = _watch(pipe, until)
    if because is None:
        log.write("disarmed")
        return 0
    log.write("acting", because=because)
    _make_safe(duties, log)
    return 1


def _warm_up() -> None:
    """Import beforehand what is slow to import, so that acting takes milliseconds."""
    import pyvisa
    import serial  # noqa: F401

    pyvisa.ResourceManager("@py")


def _orders(line: str) -> tuple[list[Duty], Log, float]:
    order = json.loads(line)
    return [_duty(Charge(**item)) for item in order["instruments"]], Log(Path(order["log"])), float(order["within"])


def _duty(charge: Charge) -> Duty:
    module = load_driver(charge.driver)
    settings = module.Settings(**charge.settings)
    room = Room(SystemClock(), _Nobody())
    return Duty(charge.name, lambda: module.connect(charge.name, settings, room))


def _watch(pipe: Pipe, until: float) -> str | None:
    """Wait through heartbeats; why the guard must act, or None if it was disarmed."""
    while True:
        try:
            line = pipe.line(until)
        except EOFError:
            return "the program has gone"
        except TimeoutError:
            return "a heartbeat is overdue"
        if line == "disarm":
            return None
        beat = re.fullmatch(r"beat (\d{1,6}(?:\.\d+)?)", line)
        if beat is None:
            return f"received {line[:80]!r}, wanted a heartbeat"
        until = time.monotonic() + float(beat[1])


def _make_safe(duties: Sequence[Duty], log: Log) -> None:
    """Round after round over what is not safe yet, until all is or the time is up."""
    until = time.monotonic() + _TRY_FOR
    left = list(duties)
    while True:
        left = [duty for duty in left if not _attempted(duty, log)]
        if not left or time.monotonic() > until:
            break
        time.sleep(_PAUSE)
    log.write("gave up" if left else "done", **({"instruments": [duty.name for duty in left]} if left else {}))


def _attempted(duty: Duty, log: Log) -> bool:
    """One attempt, in a child process; whether the instrument is safe now.

    A link that hangs or a driver that crashes then costs one attempt, and no other instrument its safe state.
    """
    child = multiprocessing.get_context("fork").Process(target=duty.act, args=(log,))
    child.start()
    child.join(_ATTEMPT)
    if child.exitcode is None:
        log.write("attempt hung", instrument=duty.name)
        child.kill()
        child.join()
    return child.exitcode == 0


def _say(line: str) -> None:
    with contextlib.suppress(OSError):  # the program may be gone already; the pipe will say so
        os.write(sys.stdout.fileno(), line.encode() + b"\n")


if __name__ == "__main__":
    sys.exit(main())
