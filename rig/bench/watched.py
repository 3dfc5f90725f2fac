"""A room in which every exchange with an instrument and every wait is a sign of life that the guard hears."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, Protocol

from rig.room import Clock, Room, Transcript

MARGIN = 0.8  # s of real time beyond what a link or a clock waits by itself


class Heartbeat(Protocol):
    """The guard, as a step sees it. Both raise WorkFailed if it is gone or has acted."""

    def beat(self, within: float) -> None:
        """What begins now takes at most so many seconds of real time, as a whole."""
        ...

    def expect(self, within: float = ...) -> None:
        """Work goes on; the next sign of life is due within so many seconds of real time."""
        ...


class WatchedClock:
    """A clock whose waits are announced."""

    def __init__(self, clock: Clock, guard: Heartbeat, patience: float) -> None:
        self._clock, self._guard, self._patience = clock, guard, patience

    def now(self) -> float:
        """Seconds since 1970-01-01 UTC by the bench's clock."""
        return self._clock.now()

    def sleep(self, seconds: float) -> None:
        """Let `seconds` ≥ 0 of the bench's time pass; a simulated bench needs no longer for it than a real one."""
        self._guard.expect(seconds + self._patience)
        self._clock.sleep(seconds)
        self._guard.expect(self._patience)


class WatchedTranscript:
    """A transcript that is heard: what is noted before it is sent is not sent if the guard is gone."""

    def __init__(self, transcript: Transcript, guard: Heartbeat, patience: float) -> None:
        self._transcript, self._guard, self._patience = transcript, guard, patience

    def note(self, instrument: str, direction: Literal["sent", "received"], data: bytes) -> None:
        """One message."""
        self._guard.expect(self._patience)
        self._transcript.note(instrument, direction, data)


def watched(room: Room, guard: Heartbeat, patience: float) -> Room:
    """The same room, heard by the guard; `patience` (s, real time) is how long it may be silent between two signs."""
    clock = WatchedClock(room.clock, guard, patience)
    return replace(room, clock=clock, transcript=WatchedTranscript(room.transcript, guard, patience))
