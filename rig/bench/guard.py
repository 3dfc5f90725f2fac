"""The guard: a small process that leaves the bench at rest when the program cannot.

It is started before anything is energised and holds the other end of a pipe. While heartbeats come in and the program
gets on it does nothing. When the kernel says that a thread of the program has died (`rig.bench.lifeline`), when the
pipe closes (all of it has gone, and has sent its last byte), when no heartbeat comes (it was stopped, or all of it
hangs), or when they go on about the same thing for longer than that may take (its work hangs), the guard connects to
each instrument anew, through that instrument's own driver, and makes it safe. What it did before the pipe closed is
done once more, and only that counts. A program that has left the bench at rest itself says so, and the guard ends
without a word to the instruments.

On the pipe, one line each, from the program to the guard::

    {"instruments": [{"driver": "hp89410a", "name": "analyzer", "settings": {…}}], "log": "…", "armed": {…}}
    beat 17 2.5     work has come to its 17th token, and the next is due 2.5 s of real time after this one began
    disarm          the bench is at rest; nothing to do any more

The guard answers the first line with `armed`, or `failed <reason>`, and says nothing afterwards. What it does goes into
the run's log (`rig.archive.guard_log`). What may be energised stands in a file that outlives both (`rig.bench.armed`).

Exit codes: 0 it was disarmed, or never armed; 1 it had to act and has read back that all is off; 2 it had to act and
could not confirm that; 3 it could not be armed.
"""

from __future__ import annotations

import contextlib
import gc
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
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Self

from rig.archive.guard_log import GuardLog
from rig.bench.armed import Armed
from rig.bench.clock import SystemClock
from rig.bench.lifeline import Lifeline
from rig.bench.possession import Holder
from rig.bench.stopping import uninterrupted
from rig.errors import NotSafe, RigError, WorkFailed
from rig.room import Confirmation, Request, Room

SILENCE = 4.5  # s without a heartbeat; with the half second between two of them the bench is at rest within 5 s
PATIENCE = 3.8  # s that work may take between two signs of life, unless it says what it waits for
_BEAT = 0.5  # s between heartbeats
_LATE = 1.0  # s; a guard that wakes later than this was kept waiting itself, and knows nothing of the program
_TRY_FOR = 10.0  # s until the guard gives up
_ATTEMPT = 3.0  # s that one attempt at one instrument may take
_PAUSE = 0.02  # s between rounds of attempts
_ARM = 5.0  # s that arming, and disarming, may take
_GONE = 5.0  # s from the death of one thread to that of all
DYING = "the program is dying"
_DISARMED, _MADE_SAFE, _NOT_SAFE, _NOT_ARMED = range(4)  # exit codes


@dataclass(frozen=True)
class Charge:
    """One instrument to be made safe: its driver's name, its name on the bench, its settings from the bench file."""

    driver: str
    name: str
    settings: Mapping[str, Any]


class Guard:
    """The program's side. Leaving the `with` block without `disarm` lets the guard act, and waits until it has.

    A thread sends the heartbeats; what the program's main thread says with `beat` and `expect` is what they are about.

    >>> with Guard.start() as guard:                           # early: it starts up beside the program
    ...     guard.arm([Charge("hp89410a", "analyzer", {...})], log=run / "guard.jsonl")
    ...     guard.beat(within=60.0)                            # the next step takes 60 s at most
    ...     guard.expect(2.0)                                  # nothing may be heard from it for 2 s
    ...     guard.disarm()                                     # the bench is at rest
    """

    def __init__(self, process: subprocess.Popen[bytes], lifeline: Lifeline | None = None) -> None:
        self._process, self._lifeline = process, lifeline
        self._instruments: list[str] = []  # that are armed, or were
        self._confirmed = False  # the program itself has read back that they are off
        self._armed: Armed | None = None
        self._attended, self._worker = True, 0
        self._token, self._due, self._step_due = 0, 0.0, 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._beat_on, name="heartbeat", daemon=True)

    @classmethod
    def start(cls, holding: Sequence[int] = ()) -> Self:
        """Start the process without waiting for it; `holding` are descriptors that it keeps open, such as locks.

        Raises WorkFailed if it cannot be started.
        """
        lifeline = Lifeline.new()
        held = [] if lifeline is None else [lifeline.descriptor]
        try:
            process = subprocess.Popen(
                # -P: nothing of the working folder is imported
                [sys.executable, "-P", "-m", "rig.bench.guard", *map(str, held)],
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                pass_fds=[*holding, *held],
                start_new_session=True,  # Ctrl-C at the terminal must not reach it
            )
        except OSError as error:
            raise WorkFailed(f"guard: cannot be started: {error}") from error
        finally:
            if lifeline is not None:
                lifeline.close()
        return cls(process, lifeline)

    @property
    def pid(self) -> int:
        """Process id of the guard."""
        return self._process.pid

    def arm(
        self, instruments: Sequence[Charge], *, log: Path, within: float = PATIENCE, armed: Armed | None = None
    ) -> None:
        """Say what to make safe. Call it before anything is energised; the first sign of life is due in `within` s.

        Raises WorkFailed if the guard cannot load a driver, or has not answered after 5 s.
        """
        order = {"instruments": [asdict(charge) for charge in instruments], "log": str(log)}
        self._armed = armed
        if self._lifeline is not None:
            self._lifeline.hold()  # this thread, whose work it is
        self._send(json.dumps(order | {"armed": armed and armed.as_json()}))
        answer = self._answer(time.monotonic() + _ARM)
        if answer != "armed":
            if armed is not None:
                armed.clear()
            raise WorkFailed(f"guard: found {answer!r}, wanted 'armed': nothing may be energised")
        self._instruments = [charge.name for charge in instruments]
        self._worker = threading.get_ident()
        self.beat(within)
        self._thread.start()

    def beat(self, within: float) -> None:
        """What begins now takes at most `within` s of real time, as a whole.

        Raises WorkFailed if the guard is gone or has acted.
        """
        self._step_due = time.monotonic() + within
        self.expect(min(within, PATIENCE))

    def expect(self, within: float = PATIENCE) -> None:
        """A sign of life: work goes on, and the next sign is due within so many s of real time.

        Signs of other threads than the one that armed the guard say nothing of its work and are not heard. Raises
        WorkFailed if the guard is gone or has acted: then nothing may be sent to an instrument any more.
        """
        if threading.get_ident() != self._worker or not self._attended:
            return
        if self._process.poll() is not None:
            raise WorkFailed("guard: it is gone or has acted already, and nothing more may be asked of the bench")
        self._token, self._due = self._token + 1, time.monotonic() + within
        self._step_due = max(self._step_due, self._due if within > PATIENCE else 0.0)

    def leave(self) -> None:
        """The safe action begins; it, and the closing of links, are done even if the guard is gone."""
        self._attended = False
        self._token, self._due, self._step_due = self._token + 1, *2 * (time.monotonic() + PATIENCE,)

    def disarm(self) -> None:
        """Say that the bench was read back as being at rest, and wait until the guard has gone.

        Raises WorkFailed if it was gone before or had acted: what was measured since is not what it seems.
        """
        self._stop_beating()
        with contextlib.suppress(WorkFailed):
            self._send("disarm")
        try:
            code = self._process.wait(timeout=_ARM)
        except subprocess.TimeoutExpired:
            self._process.kill()  # it must not wake up and act upon the next run
            code = self._process.wait()
        if self._armed is not None:
            self._armed.clear()
        self._confirmed = True
        if code != _DISARMED:
            found = "it had acted" if code == _MADE_SAFE else f"it had ended ({code})"
            raise WorkFailed(f"guard: {found} before it was disarmed")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with uninterrupted():
            self._stop_beating()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    pipe.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=_TRY_FOR + 2 * _ATTEMPT)

    def how_left(self) -> str:
        """After the block: how what was armed was left, in words; empty if there was nothing.

        Raises NotSafe if it was left to the guard, and that could not read it back as off or has not said so.
        """
        names = ", ".join(self._instruments)
        if not names:
            return ""
        if self._confirmed:
            return f"{names}: off, read back"
        if self._process.returncode != _MADE_SAFE:
            how = {None: "does not answer", _NOT_SAFE: "could not confirm it"}
            why = how.get(self._process.returncode, f"has ended ({self._process.returncode})")
            raise NotSafe(f"{names}: not read back as off; the guard {why}")
        return f"{names}: off, read back by the guard"

    def _beat_on(self) -> None:
        """Until it is over, say every half second what work has come to; a main thread that hangs does not stop it."""
        while not self._over.is_set():
            token, due = self._token, min(self._due, self._step_due)
            with contextlib.suppress(WorkFailed):  # the next sign of life finds the guard gone
                self._send(f"beat {token} {due - time.monotonic():.3f}")
            self._over.wait(_BEAT)

    def _stop_beating(self) -> None:
        if self._lifeline is not None:
            self._lifeline.let_go()
        self._over.set()
        if self._thread.is_alive():
            self._thread.join(timeout=_BEAT)

    def _send(self, line: str) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line.encode() + b"\n")
        except (OSError, ValueError) as error:
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
class Duty:
    """One instrument with its driver loaded and its settings accepted."""

    name: str
    connect: Callable[[], Any]

    def act(self, log: GuardLog) -> None:
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


class Dying(Exception):
    """A thread of the program has died; others may still be about to."""


class Pipe:
    """Lines from a file descriptor, with a time by which each must have come."""

    def __init__(self, descriptor: int, lifeline: Lifeline | None = None) -> None:
        self._descriptor, self._received, self._lifeline = descriptor, b"", lifeline
        self._broken: int | None = None

    def line(self, until: float | None = None) -> str:
        """The next line. Raises TimeoutError when the monotonic clock passes `until`, EOFError when the pipe closes.

        Once the lifeline is watched, Dying when it breaks.
        """
        watched = [self._descriptor] if self._broken is None else [self._descriptor, self._broken]
        while b"\n" not in self._received:
            left = None if until is None else max(until - time.monotonic(), 0.0)
            ready = select.select(watched, [], [], left)[0]
            if self._broken in ready:
                raise Dying
            if not ready:
                raise TimeoutError
            part = os.read(self._descriptor, 1 << 16)
            if not part:
                raise EOFError
            self._received += part
        line, self._received = self._received.split(b"\n", 1)
        return line.decode("utf-8", "replace")

    def watch_lifeline(self) -> None:
        """From now on: the program holds it."""
        if self._lifeline is not None and self._broken is None:
            self._broken, told = os.pipe()
            threading.Thread(target=self._tell, args=(self._lifeline, told), daemon=True).start()

    def closed(self, until: float) -> bool:
        """Wait until it has closed, whatever comes before; False if that takes longer."""
        self._broken = None
        try:
            while True:
                self.line(until)
        except EOFError:
            return True
        except TimeoutError:
            return False

    def _tell(self, lifeline: Lifeline, told: int) -> None:
        if lifeline.broken():
            os.write(told, b"x")


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


@dataclass(frozen=True)
class Orders:
    """What to make safe, where to write what was done, and what to leave for the next program if it was not."""

    duties: Sequence[Duty]
    log: GuardLog
    armed: Armed | None

    @classmethod
    def of(cls, line: str) -> Self:
        """From the first line; the armed state is written. Raises what drivers raise, ValueError, KeyError, OSError."""
        order = json.loads(line)
        duties = [_duty(Charge(**item)) for item in order["instruments"]]
        armed = None
        if order.get("armed"):
            armed = replace(Armed.from_json(order["armed"]), guard=Holder.myself())
            armed.write()
        return cls(duties, GuardLog(Path(order["log"])), armed)

    def clear(self) -> None:
        if self.armed is not None:
            self.armed.clear()


def main() -> int:
    """Run the guard on standard input and output; the exit code is in this module's docstring."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN)
    _warm_up()
    pipe = Pipe(sys.stdin.fileno(), Lifeline(int(sys.argv[1])) if sys.argv[1:] else None)
    try:
        orders = Orders.of(pipe.line())
    except EOFError:
        return _DISARMED  # the program ended, or thought better of it, before anything was energised
    except (RigError, ImportError, AttributeError, ValueError, TypeError, KeyError, OSError) as error:
        _say(f"failed {type(error).__name__}: {error}".replace("\n", "; "))
        return _NOT_ARMED
    return _stand_guard(pipe, orders)


def _stand_guard(pipe: Pipe, orders: Orders) -> int:
    log = orders.log
    pipe.watch_lifeline()
    standby = Standby(orders.duties, log)
    log.write("armed", instruments=[duty.name for duty in orders.duties], pid=os.getpid())
    _say("armed")
    because = _watch(pipe)
    if because is None:
        standby.dismiss()
        orders.clear()
        log.write("disarmed")
        return _DISARMED
    standby.go()
    log.write("acting", because=because)
    not_yet = standby.left()
    if because == DYING:  # what its other threads had begun to send has gone out when the pipe has closed
        log.write("gone" if pipe.closed(time.monotonic() + _GONE) else "not gone")
        not_yet = list(orders.duties)
    left = _make_safe(not_yet, log)
    if left:
        if orders.armed is not None:
            with contextlib.suppress(OSError):  # what was written before says enough
                replace(orders.armed, instruments=tuple(left), reason="the guard could not read it back as off").write()
        log.write("gave up", instruments=left)
        return _NOT_SAFE
    orders.clear()
    log.write("done")
    return _MADE_SAFE


def _warm_up() -> None:
    """Load beforehand what the first link loads, and go before others, so that acting takes milliseconds."""
    _rehearse()
    gc.freeze()  # nothing of it is looked through again, which would copy all of it in every attempt
    with contextlib.suppress(OSError):  # where the system lets us
        os.setpriority(os.PRIO_PROCESS, 0, -10)
    with contextlib.suppress(OSError, AttributeError):  # it sleeps, but for milliseconds that matter
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))


def _rehearse() -> None:
    """Have a link with nobody: what the first one loads, and the memory that a new process has to make its own."""
    importlib.import_module("drivers.links").rehearse(Room(SystemClock(), _Nobody()))


def _duty(charge: Charge) -> Duty:
    module = load_driver(charge.driver)
    settings = module.Settings(**charge.settings)
    room = Room(SystemClock(), _Nobody())
    return Duty(charge.name, lambda: module.connect(charge.name, settings, room))


def _watch(pipe: Pipe) -> str | None:
    """Wait through heartbeats; why the guard must act, or None if it was disarmed.

    A token's time is counted from its first heartbeat, which may come half a second after it began, as may that of the
    next one.
    """
    token, due = "", time.monotonic() + SILENCE
    until = due
    while True:
        try:
            line = pipe.line(until)
        except Dying:
            return DYING
        except EOFError:
            return "the program has gone"
        except TimeoutError:
            if time.monotonic() - until > _LATE:
                due = until = time.monotonic() + SILENCE
                continue
            return f"work has not got on from token {token} in time" if until == due else "a heartbeat is overdue"
        if line == "disarm":
            return None
        beat = re.fullmatch(r"beat (\d{1,20}) (-?\d{1,9}\.\d+)", line)
        if beat is None:
            return f"received {line[:80]!r}, wanted a heartbeat"
        if beat[1] != token:
            token, due = beat[1], time.monotonic() + float(beat[2]) + _BEAT
        until = min(due, time.monotonic() + SILENCE)


def _make_safe(duties: Sequence[Duty], log: GuardLog) -> list[str]:
    """Round after round over what is not safe yet, until all is or time is up; what is left."""
    until = time.monotonic() + _TRY_FOR
    left = list(duties)
    while left and time.monotonic() < until:
        time.sleep(_PAUSE)
        left = [duty for duty in left if not _ended_well(duty, _attempt(duty.act, log), time.monotonic(), log)]
    return [duty.name for duty in left]


class Standby:
    """The first attempt at each instrument, as a child process that waits to begin: making one takes longer.

    An attempt is a process of its own, so that a link that hangs or a driver that crashes costs that attempt, and no
    other instrument its safe state.
    """

    def __init__(self, duties: Sequence[Duty], log: GuardLog) -> None:
        self._duties, self._log, self._begun = duties, log, 0.0
        pipes = [os.pipe() for _ in duties]
        self._go = [write for _, write in pipes]
        self._children = [_attempt(self._wait, read, duty) for duty, (read, _) in zip(duties, pipes, strict=True)]
        for read, _ in pipes:
            os.close(read)

    def go(self) -> None:
        """Begin, all at once."""
        self._begun = time.monotonic()
        for write in self._go:
            with contextlib.suppress(OSError):  # one that died waiting counts as a failed attempt
                os.write(write, b"go")

    def left(self) -> list[Duty]:
        """What is not safe when all have ended."""
        attempts = zip(self._duties, self._children, strict=True)
        return [duty for duty, child in attempts if not _ended_well(duty, child, self._begun, self._log)]

    def dismiss(self) -> None:
        """There is nothing to do for them."""
        self._close()
        for child in self._children:
            child.join()

    def _close(self) -> None:
        for write in self._go:
            os.close(write)

    def _wait(self, read: int, duty: Duty) -> None:
        self._close()  # of our own copies, or the end of the guard would not be seen
        gc.disable()
        _rehearse()
        if os.read(read, 2):
            duty.act(self._log)


def _attempt(act: Callable[..., None], *words: object) -> BaseProcess:
    """A child process that does this."""
    child = multiprocessing.get_context("fork").Process(target=act, args=words)
    child.start()
    return child


def _ended_well(duty: Duty, child: BaseProcess, begun: float, log: GuardLog) -> bool:
    """Whether an attempt that began then has made its instrument safe; it is given up after a while."""
    child.join(max(begun + _ATTEMPT - time.monotonic(), 0.0))
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
