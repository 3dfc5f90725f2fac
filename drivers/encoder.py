"""The turntable's encoder (1000-line disk with HEDS-9040), read through three channels of the converter.

The outputs are TTL levels sampled at the scan rate: at 45 rpm a line passes in 4.2 samples, and both a state and the
index pulse (333 µs) are about as long as a sample (320 µs). Hence

- a line is one rising edge of channel A: the edges of one polarity, so that the pulse-width error (30 °e) cancels;
- an edge lies in the middle between the last sample that was surely low and the first that is surely high, at the
  instants of that channel's own slot of the scan;
- the direction comes from where the middle of B's pulses lies between those of A (75…105 °e away by the data sheet,
  better defined than any single edge), averaged over neighbouring lines, because a platter cannot reverse at once;
- an index pulse can fall between two samples. Lines are counted from pulse to pulse: 1000 is a revolution, 2000 is one
  whose index was missed, anything else is flagged and never mended.

An index is half a line wide at most and the samples place it within half a sample, so which line it belongs to is
decided by the smoothed position, not by which edge happens to come first.

Everything works chunk by chunk: `Decoder.feed` gives what is new.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from rig.record import Identity, Samples
from rig.room import Room
from rig.units import Voltage

LINES = 1000
"""Lines per revolution."""

VOTES = 16
"""Lines before and after a line whose A and B are looked at to tell its direction."""

NEIGHBOURS = 8
"""Lines before and after an index pulse whose straight line says where between two lines it lies."""

MESSAGES: tuple[str, ...] = ()
"""The encoder cannot be spoken to."""


class Settings(BaseModel):
    """`a_leads` is the sense (about z up) in which A leads B: it depends on the side that the module faces."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    a: str = Field(default="encoder_a", description="converter channel of output A")
    b: str = Field(default="encoder_b", description="converter channel of output B")
    index: str = Field(default="encoder_index", description="converter channel of the index")
    low: Voltage = Field(default=1.0, description="at or below this an output is low")
    high: Voltage = Field(default=2.0, description="at or above this an output is high")
    a_leads: Literal[-1, 1] = Field(default=-1, description="-1: A leads B when turning clockwise seen from above")
    serial: str = Field(default="not stated", description="from the plate")


@dataclass(frozen=True)
class Pulses:
    """What a Schmitt trigger sees: times (s) of rising and of falling edges, and samples between the thresholds."""

    rising: NDArray[np.float64]
    falling: NDArray[np.float64]
    between: int


@dataclass(frozen=True)
class Lines:
    """What is new in a chunk. Times are s since the record's first conversion.

    `edges`: rising edges of A, shape (n,), numbered from `first_line`. `direction`: +1 or −1 about z up for each, 0
    where it could not be told. `index`: one time per index pulse seen, in the middle between the two lines it lies
    between; `index_line`: the number of the line before it. `counts`: lines from each pulse to the next, where that
    was not the first; `missed` pulses in between; `flagged`: those counts that are no whole number of revolutions.
    `revolutions`: begin and end of every closed revolution by the first line after its index, shape (m, 2).
    `between`: samples of A, B and index that were neither low nor high.
    """

    edges: NDArray[np.float64]
    direction: NDArray[np.int8]
    first_line: int
    index: NDArray[np.float64]
    index_line: NDArray[np.int64]
    counts: tuple[int, ...]
    missed: int
    flagged: tuple[int, ...]
    revolutions: NDArray[np.float64]
    between: int

    @property
    def sense(self) -> int:
        """The direction of nearly all lines (nine in ten), or 0."""
        mean = float(self.direction.mean()) if len(self.direction) else 0.0
        return int(math.copysign(1, mean)) if abs(mean) >= 0.8 else 0


class Trigger:
    """A Schmitt trigger with memory: what one chunk leaves undecided is decided in the next."""

    def __init__(self, low: float, high: float) -> None:
        self._low, self._high = low, high
        self._level = 0  # -1 low, +1 high, 0 not known yet
        self._since = 0.0  # when a sample last had that level surely, s

    def feed(self, volts: NDArray[np.float64], instants: NDArray[np.float64]) -> Pulses:
        """Edges completed by these samples; volts and instants (s) shape (n,), instants ascending."""
        level = (volts >= self._high).astype(np.int8) - (volts <= self._low)
        sure = np.flatnonzero(level)
        between = len(level) - len(sure)
        if not len(sure):
            return Pulses(np.empty(0), np.empty(0), between)
        levels = np.concatenate([[self._level], level[sure]])
        times = np.concatenate([[self._since], instants[sure]])
        changed = np.flatnonzero(levels[1:] * levels[:-1] == -1)
        # A sample between the thresholds lies on the edge itself, and is skipped: the middle then falls onto it.
        middle = 0.5 * (times[changed] + times[changed + 1])
        rises = levels[changed + 1] > 0
        self._level, self._since = int(levels[-1]), float(times[-1])
        return Pulses(middle[rises], middle[~rises], between)


def edges(
    volts: NDArray[np.float64], instants: NDArray[np.float64], low: float = 1.0, high: float = 2.0
) -> NDArray[np.float64]:
    """Times (s) of the rising edges of one output; volts and instants (s) of its samples, both shape (n,)."""
    return Trigger(low, high).feed(volts, instants).rising


def middles(rising: NDArray[np.float64], falling: NDArray[np.float64]) -> NDArray[np.float64]:
    """Middle of every complete high pulse, s: each rising edge with the next falling one, if it comes before another."""
    if not len(rising) or not len(falling):
        return np.empty(0)
    after = np.searchsorted(falling, rising, side="right")
    whole = after < len(falling)
    return np.asarray(0.5 * (rising[whole] + falling[after[whole]]))


def quadrature(
    a_middles: NDArray[np.float64], b_middles: NDArray[np.float64], periods: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Sine of the phase by which B's pulse follows A's, for each pulse of A: near +1 if A leads, near −1 if B leads.

    `periods` (s) are those of the lines at A's pulses. NaN where no pulse of B is within a line's length.
    """
    if not len(b_middles):
        return np.full(len(a_middles), np.nan)
    place = np.clip(np.searchsorted(b_middles, a_middles), 1, len(b_middles) - 1) if len(b_middles) > 1 else None
    if place is None:
        delay = b_middles[0] - a_middles
    else:
        before, after = b_middles[place - 1] - a_middles, b_middles[place] - a_middles
        delay = np.where(np.abs(before) < np.abs(after), before, after)
    sine = np.sin(2.0 * np.pi * delay / periods)
    return np.where(np.abs(delay) < periods, sine, np.nan)


@dataclass
class _Tail:
    """What is remembered of the stretch before a chunk."""

    a_rising: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    a_falling: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    b_rising: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    b_falling: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def extend(self, a: Pulses, b: Pulses) -> None:
        self.a_rising = np.concatenate([self.a_rising, a.rising])
        self.a_falling = np.concatenate([self.a_falling, a.falling])
        self.b_rising = np.concatenate([self.b_rising, b.rising])
        self.b_falling = np.concatenate([self.b_falling, b.falling])

    def forget(self, lines: int) -> None:
        """Keep only so many of the last lines, and what belongs to them."""
        if len(self.a_rising) <= lines:
            return
        self.a_rising = self.a_rising[-lines:]
        since = self.a_rising[0] - (self.a_rising[1] - self.a_rising[0] if lines > 1 else 0.0)
        self.a_falling = self.a_falling[self.a_falling > since]
        self.b_rising = self.b_rising[self.b_rising > since]
        self.b_falling = self.b_falling[self.b_falling > since]


class Decoder:
    """Decodes one record, chunk by chunk. Chunks must follow one another without a gap."""

    def __init__(self, settings: Settings | None = None) -> None:
        self._settings = one = settings or Settings()
        self._a, self._b, self._index = (Trigger(one.low, one.high) for _ in range(3))
        self._tail = _Tail()
        self._lines = 0  # rising edges of A so far
        self._recent = np.empty(0)  # edges kept until no index pulse can need them
        self._rising: NDArray[np.float64] = np.empty(0)  # of index pulses that have not been placed yet
        self._falling: NDArray[np.float64] = np.empty(0)
        self._last: tuple[int, float] | None = None  # line after the last index, and its time
        self._next_scan: int | None = None

    def feed(self, samples: Samples) -> Lines:
        """Lines and index pulses that this chunk completes.

        Raises KeyError if a channel is missing, ValueError if the chunk does not follow the last one.
        """
        return self._feed(samples, final=False)

    def finish(self, samples: Samples) -> Lines:
        """The same for the last chunk: index pulses near its end are placed with the lines there are."""
        return self._feed(samples, final=True)

    def _feed(self, samples: Samples, *, final: bool) -> Lines:
        if self._next_scan is not None and samples.first_scan != self._next_scan:
            raise ValueError(f"found a chunk from scan {samples.first_scan}, wanted {self._next_scan}")
        self._next_scan = samples.first_scan + len(samples.counts)
        one = self._settings
        a, b, index = (
            trigger.feed(samples.volts(name), samples.instants(name))
            for trigger, name in ((self._a, one.a), (self._b, one.b), (self._index, one.index))
        )
        first = self._lines
        direction = self._directions(a, b)
        self._lines += len(a.rising)
        self._recent = np.concatenate([self._recent, a.rising])
        self._rising = np.concatenate([self._rising, index.rising])
        self._falling = np.concatenate([self._falling, index.falling])
        found = self._place_pulses(final)
        between = a.between + b.between + index.between
        return self._closed(found, Lines(a.rising, direction, first, *_nothing(), between=between))

    def _directions(self, a: Pulses, b: Pulses) -> NDArray[np.int8]:
        """Direction of the new lines, judged with their neighbours."""
        new = len(a.rising)
        self._tail.extend(a, b)
        tail = self._tail
        sines = _sines(tail)
        kernel = np.ones(2 * VOTES + 1)
        known = np.isfinite(sines)
        votes = np.convolve(np.where(known, sines, 0.0), kernel, "full")[VOTES : VOTES + len(sines)]
        direction = (np.sign(votes) * self._settings.a_leads).astype(np.int8)[len(sines) - new :]
        tail.forget(2 * VOTES)
        return direction

    def _place_pulses(self, final: bool) -> list[tuple[int, float, float]]:
        """Index pulses that can be placed now: line before, times of that line and of the next."""
        pulses = middles(self._rising, self._falling)
        found = []
        for pulse in pulses.tolist():
            after = len(self._recent) - int(np.searchsorted(self._recent, pulse))
            if after < NEIGHBOURS and not final:
                break
            place = self._place(pulse)
            if place is not None:
                found.append(place)
            self._falling = self._falling[self._falling > pulse]
            self._rising = self._rising[self._rising > pulse]
        self._forget_edges()
        return found

    def _place(self, pulse: float) -> tuple[int, float, float] | None:
        """Between which lines a pulse lies, by the straight line through its neighbours; None at a record's edge."""
        edges, offset = self._recent, self._lines - len(self._recent)
        at = int(np.searchsorted(edges, pulse))
        near = edges[max(at - NEIGHBOURS, 0) : at + NEIGHBOURS]
        if len(near) < 2:
            return None
        numbers = np.arange(len(near)) + max(at - NEIGHBOURS, 0) + offset
        slope = np.polyfit(near - pulse, numbers, 1)
        phase = float(slope[1])
        line = self._line_of(phase)
        here, there = (self._time_of(number, edges, offset, pulse, slope) for number in (line, line + 1))
        return line, here, there

    def _line_of(self, phase: float) -> int:
        """The line that the pulse follows. The first is taken as it comes; later ones by whole lines from it."""
        if self._last is None:
            self._phase = phase
            return math.floor(phase)
        line = self._last[0] - 1 + round(phase - self._phase)
        # The pulse's place within its line is the same every time; follow it slowly, so that noise averages out.
        self._phase = phase
        return line

    def _time_of(
        self, number: int, edges: NDArray[np.float64], offset: int, pulse: float, slope: NDArray[np.float64]
    ) -> float:
        if 0 <= number - offset < len(edges):
            return float(edges[number - offset])
        return pulse + (number - float(slope[1])) / float(slope[0])

    def _forget_edges(self) -> None:
        """Edges long before any pulse that is still to be placed are not needed."""
        keep = 2 * NEIGHBOURS
        if len(self._rising):
            keep += len(self._recent) - int(np.searchsorted(self._recent, self._rising[0]))
        self._recent = self._recent[max(len(self._recent) - keep, 0) :]

    def _closed(self, found: list[tuple[int, float, float]], lines: Lines) -> Lines:
        raise NotImplementedError
