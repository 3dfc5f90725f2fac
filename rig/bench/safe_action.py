"""The safe action by hand: whatever became of program and guard, every instrument that energises something is off.

For a bench that nobody drives any more. Each instrument is connected to by itself, so that one that hangs keeps no
other from its safe state; what was read back is said of each. Then the bench is free again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from rig.archive.guard_log import GUARD_LOG, GuardLog
from rig.archive.runs import Runs
from rig.bench.armed import Armed, left_armed
from rig.bench.assembly import connected, fittings, occupied
from rig.bench.benchfile import BenchDescription
from rig.bench.possession import Possession
from rig.bench.roles import Energises
from rig.errors import RigError, WorkFailed

BY = "rig bench safe"


@dataclass(frozen=True)
class Found:
    """One instrument after the safe action; `off` is True only if that was read back."""

    role: str
    off: bool
    in_words: str


@dataclass(frozen=True)
class Done:
    """What the safe action did: `passed` are holders of the bench that it passed over, `left` what was left armed."""

    found: tuple[Found, ...]
    passed: tuple[str, ...]
    left: str | None
    platter: bool

    @property
    def safe(self) -> bool:
        """Whether all that energises something was read back as off. Of a platter only a person can say it."""
        return all(one.off for one in self.found)


def make_safe(description: BenchDescription, runs: Path) -> Done:
    """Make the bench safe and read it back; if all is off, nothing is armed on it any more.

    Raises BenchHeld if a live program has the bench: that one makes it safe itself when it is stopped.
    """
    with occupied(description, runs, passing=True) as possession:
        left = left_armed(possession.armed)
        found = tuple(_each(description, runs, possession))
        done = Done(
            (*found, *_not_here(left, found)),
            tuple(possession.passed),
            None if left is None else str(left),
            "turntable" in description.file.instruments,
        )
        if done.safe:
            _settle(description, runs, possession, done)
        return done


def _each(description: BenchDescription, runs: Path, possession: Possession) -> Iterator[Found]:
    for role, fitting in fittings(description).items():
        if not _energises(fitting.module):
            continue
        try:
            with connected(description, runs, role.__eq__, possession=possession) as bench:
                cast(Energises, bench.instruments[role]).make_safe()
            yield Found(role, True, "off, read back")
        except WorkFailed as error:
            yield Found(role, False, str(error))


def _not_here(left: Armed | None, found: Sequence[Found]) -> Iterator[Found]:
    """What was left armed and the bench file does not have: nobody has read it back."""
    for name in () if left is None else left.instruments:
        if name not in {one.role for one in found}:
            yield Found(name, False, "it was left armed, and the bench file has no such instrument to read back")


def _energises(driver: ModuleType) -> bool:
    """Whether a driver's instrument has a safe action; asked of the driver, since the instrument may not be there."""
    return any(
        isinstance(one, type) and one.__module__ == driver.__name__ and hasattr(one, "make_safe")
        for one in vars(driver).values()
    )


def _settle(description: BenchDescription, runs: Path, possession: Possession, done: Done) -> None:
    """Nothing is armed any more; the runs that had left it so say who has read it back."""
    logs = [run.path / GUARD_LOG for run in Runs(runs).list() if run.not_safe and _on_this(description, run)]
    if (armed := left_armed(possession.armed)) is not None and armed.log:
        logs.append(Path(armed.log))
    for log in map(GuardLog, sorted(set(logs))):
        for one in done.found:
            log.write("made safe", instrument=one.role, by=BY)
        log.write("done", by=BY)
    try:
        for file in possession.armed:
            file.unlink(missing_ok=True)
    except OSError as error:
        raise WorkFailed(
            f"{file}: found it kept ({error}), wanted it removed: all is off, but it says otherwise"
        ) from error


def _on_this(description: BenchDescription, run: Any) -> bool:
    """Whether a run was measured on this bench; a damaged header does not say so."""
    try:
        return bool(run.header.get("bench") == description.file.bench)
    except RigError:
        return False
