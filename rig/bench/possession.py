"""One bench, one driver: who has a bench, so that nobody else sends a byte to it.

Everything that bytes go through to reach a bench (a gateway, a serial port, the DAQ service, the simulated bench) has a
lock file on this machine, named by its address. A program has them from before the first byte until it ends, and its
guard has them too, so that nobody comes between while the guard acts. What a lock file says tells a second program who
has the bench since when; that it is held is said by the kernel alone, and ends with the last process that holds it.

The files stand in `$XDG_RUNTIME_DIR/rig`, else in `/run/lock/rig` or `rig` of the temporary folder: they belong to the
instruments and not to a folder of runs. Another computer on the same gateway does not see them.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from rig.errors import BenchHeld, WorkFailed

_GUARD_ACTS = 15.0  # s of real time that the guard of a dead program may still need
_SAYS = 1.0  # s within which the holder of a lock says who it is
_OVER_TCP = re.compile(r"(?:PRLGX-TCPIP\d*::|TCPIP\d*::|socket://)?([^:/\s]+):{1,2}(\d+)(?:::(?:INTFC|SOCKET))?", re.I)
_DEVICE = re.compile(r"(/[^:]+)")


def folder() -> Path:
    """Where locks and armed states of this machine's benches are."""
    for place in (os.environ.get("XDG_RUNTIME_DIR"), "/run/lock"):
        if place and os.path.isdir(place) and os.access(place, os.W_OK | os.X_OK):
            return Path(place) / "rig"
    return Path(tempfile.gettempdir()) / "rig"


def place(address: str) -> str:
    """What stands at an address, the same for every spelling of it: `host:port`, a device node, else as given.

    The number of a gateway's board is a name inside one program and is left out; links to device nodes are followed.
    """
    if found := _OVER_TCP.fullmatch(address.strip()):
        host = found[1].lower()
        return f"{'127.0.0.1' if host == 'localhost' else host}:{found[2]}"
    if found := _DEVICE.search(address):
        return os.path.realpath(found[1])
    return address.strip().lower()


@dataclass(frozen=True)
class Holder:
    """A program that has a bench. `boot` and `started` tell it from a later process of the same number."""

    pid: int
    boot: str
    started: str
    since: float
    command: str

    @classmethod
    def myself(cls) -> Holder:
        """This process, from now on."""
        name = os.path.basename(sys.argv[0])
        words = ["rig" if name == "__main__.py" else name, *sys.argv[1:]]  # `python -m rig` is rig too
        _, started = _process(os.getpid())
        return cls(os.getpid(), _boot(), started, time.time(), " ".join(words)[:200])

    @property
    def state(self) -> Literal["alive", "stopped", "dead"]:
        """Whether the process still lives, and whether it runs."""
        state, started = _process(self.pid)
        if self.boot != _boot() or started != self.started or state in ("", "Z", "X"):
            return "dead"
        return "stopped" if state in ("T", "t") else "alive"

    def __str__(self) -> str:
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.since))
        mark = {"alive": "", "stopped": ", which is stopped", "dead": ", which has ended"}[self.state]
        return f"process {self.pid} ({self.command}){mark}, since {since}"


@dataclass
class Possession:
    """The locks of one bench; `armed` are the files that say what was left energised on it (see `rig.bench.armed`)."""

    bench: str
    holder: Holder
    armed: tuple[Path, ...] = ()
    descriptors: list[int] = field(default_factory=list)
    passed: list[str] = field(default_factory=list)
    locks: list[Path] = field(default_factory=list)

    def release(self) -> None:
        """Let go; the files go too, unless they are still to tell who left the bench armed."""
        armed = any(path.exists() for path in self.armed)
        for path, descriptor in zip(self.locks, self.descriptors, strict=True):
            if not armed:
                with contextlib.suppress(OSError):  # another user's file stays, and says nothing while nobody holds it
                    path.unlink()
            os.close(descriptor)
        self.locks, self.descriptors = [], []


@contextlib.contextmanager
def possessed(bench: str, addresses: Sequence[str], *, passing: bool = False) -> Iterator[Possession]:
    """Have the bench whose parts stand at these addresses (see `place`) to oneself.

    With `passing`, a holder that has ended (its guard may be acting still and is waited for) or is stopped is passed
    over, and `passed` says why. Raises BenchHeld with who has it since when, WorkFailed if there can be no lock.
    """
    try:
        where = _made(folder())
        stems = [where / _stem(one) for one in sorted({place(address) for address in addresses})]
        taken = Possession(bench, Holder.myself(), tuple(stem.with_suffix(".armed") for stem in stems))
        try:
            for stem in stems:
                _take(taken, stem.with_suffix(".lock"), passing)
        except BaseException:
            taken.release()
            raise
    except OSError as error:
        raise WorkFailed(
            f"bench {bench}: found no place for its lock ({error}), wanted one to be its only driver"
        ) from error
    try:
        yield taken
    finally:
        taken.release()


def _take(taken: Possession, path: Path, passing: bool) -> None:
    descriptor = _locked(path)
    if descriptor is None and passing:
        descriptor = _passed(taken, path)
        if descriptor is None:
            return
    if descriptor is None:
        raise _held(taken, _holder_soon(path))
    taken.locks.append(path)
    taken.descriptors.append(descriptor)
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, json.dumps(asdict(taken.holder)).encode(), 0)


def _held(taken: Possession, holder: Holder | None) -> BenchHeld:
    found = f"bench {taken.bench}: found it held by {holder or 'another program'}"
    if holder is not None and holder.state == "dead":
        found += "; its guard still acts"
    if holder is not None and holder.state == "stopped":
        return BenchHeld(f"{found}; wanted it free: let that one go on and end, `rig bench safe` passes it over")
    return BenchHeld(f"{found}; wanted it free")


def _passed(taken: Possession, path: Path) -> int | None:
    """The lock after all, if only the guard of a dead program had it; None if its holder is passed over without it."""
    holder = _holder(path)
    if holder is None or holder.state == "alive":
        raise _held(taken, holder)
    until = time.monotonic() + _GUARD_ACTS
    while holder.state == "dead" and time.monotonic() < until:
        if (descriptor := _locked(path)) is not None:
            return descriptor
        time.sleep(0.05)
    taken.passed.append(f"passed over {holder}")
    return None


def _locked(path: Path) -> int | None:
    """Descriptor of the lock file under this name, locked; None if somebody has it."""
    while True:
        descriptor = _opened(path)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return None
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), os.stat(path)):
                return descriptor
        os.close(descriptor)  # its last holder removed it between our two steps


def _opened(path: Path) -> int:
    """The file open for writing, whoever made it: on a folder that all share, each may write the others' files."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC
    while True:
        with contextlib.suppress(FileNotFoundError):
            return os.open(path, flags)
        with contextlib.suppress(FileExistsError):
            descriptor = os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o666)
            os.fchmod(descriptor, 0o666)
            return descriptor


def _made(where: Path) -> Path:
    """The folder, made for every user of this machine."""
    with contextlib.suppress(FileExistsError):
        where.mkdir()
        where.chmod(0o1777)
    return where


def _holder_soon(path: Path) -> Holder | None:
    """Who has a lock, waited for over the instant between taking it and saying so, which a busy machine stretches."""
    until = time.monotonic() + _SAYS
    while (holder := _holder(path)) is None and time.monotonic() < until:
        time.sleep(0.01)
    return holder


def _holder(path: Path) -> Holder | None:
    """Who says to have a lock; None if nothing readable is said, as in the instant of taking it."""
    try:
        return Holder(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def _stem(where: str) -> str:
    """A file's name for a place: to be read, and one for each place."""
    words = re.sub(r"[^A-Za-z0-9]+", "-", where).strip("-")[-60:]
    return f"{words}-{hashlib.sha256(where.encode()).hexdigest()[:12]}"


def _boot() -> str:
    """Which start of the machine this is; empty where the system does not say."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _process(pid: int) -> tuple[str, str]:
    """State letter and start time (clock ticks since boot) of a process; empty if there is none."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    except OSError:
        return "", ""
    return fields[0], fields[19]
