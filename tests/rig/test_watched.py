"""Nothing is noted, waited for, or sent on behalf of a program whose guard has gone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import pytest

from rig.bench.watched import WatchedClock, WatchedTranscript
from rig.errors import WorkFailed


class Gone:
    """A guard that has acted."""

    def beat(self, within: float) -> None:
        raise WorkFailed("guard: it is gone")

    def expect(self, within: float = 1.0) -> None:
        raise WorkFailed("guard: it is gone")


@dataclass
class Wire:
    """What came through, of notes and of waits."""

    came: list[object] = field(default_factory=list)

    def note(self, instrument: str, direction: Literal["sent", "received"], data: bytes) -> None:
        self.came.append((instrument, direction, data))

    def now(self) -> float:
        return 7.0

    def sleep(self, seconds: float) -> None:
        self.came.append(seconds)


def test_a_message_is_not_noted_and_so_not_sent_once_the_guard_has_gone() -> None:
    wire = Wire()
    with pytest.raises(WorkFailed, match="it is gone"):
        WatchedTranscript(wire, Gone(), 1.0).note("analyzer", "sent", b"OUTP ON")
    assert wire.came == []


def test_no_time_passes_once_the_guard_has_gone() -> None:
    wire = Wire()
    with pytest.raises(WorkFailed, match="it is gone"):
        WatchedClock(wire, Gone(), 1.0).sleep(3.0)
    assert wire.came == []
