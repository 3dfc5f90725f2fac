"""The room an instrument stands in: a clock, an operator and a transcript, handed in to every driver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

Value = str | float | int | bool | None


class Clock(Protocol):
    """The bench's time. On the simulated bench `sleep` is what advances the world."""

    def now(self) -> float:
        """Seconds since 1970-01-01 UTC by the bench's clock."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let `seconds` ≥ 0 of the bench's time pass."""
        ...


@dataclass(frozen=True)
class Request:
    """One thing a person must do: a machine-readable `action` with `settings` in SI, and the `text` of the card."""

    action: str
    text: str
    settings: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class Confirmation:
    """Who confirmed what, when (bench clock, s), and what they added (`said`, e.g. a dial reading)."""

    request: Request
    who: str
    when: float
    said: str = ""


class Operator(Protocol):
    """A person, an answers file, or the simulated bench's own operator."""

    def ask(self, request: Request) -> Confirmation:
        """Return once the thing is done.

        Raises OperatorRefused if the operator declines, OperatorMissing if nobody can answer.
        """
        ...


class Transcript(Protocol):
    """Keeps every exchange with an instrument."""

    def note(self, instrument: str, direction: Literal["sent", "received"], data: bytes) -> None: ...


class NoTranscript:
    """A transcript that keeps nothing."""

    def note(self, instrument: str, direction: Literal["sent", "received"], data: bytes) -> None:
        return None


@dataclass(frozen=True)
class Room:
    """What a driver is given besides its own settings."""

    clock: Clock
    operator: Operator
    transcript: Transcript = field(default_factory=NoTranscript)
