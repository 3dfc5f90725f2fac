"""Lines of the turntable's encoder (1000-line disk with HEDS-9040) from three sampled channels of the converter.

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
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from rig.record import Samples
from rig.units import Voltage

LINES = 1000
"""Lines per revolution."""

WHOLE = (LINES, 2 * LINES)
"""Counts between two index pulses that are a revolution, and two with an index missed."""

VOTES = 16
"""Lines before and after a line whose A and B are looked at to tell its direction."""

NEIGHBOURS = 8
"""Lines before and after an index pulse whose straight line says where between two lines it lies."""


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
    """Middle of every complete high pulse, s: each rising edge with the falling edge that follows it."""
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
    place = np.searchsorted(b_middles, a_middles)
    before = b_middles[np.maximum(place - 1, 0)] - a_middles
    after = b_middles[np.minimum(place, len(b_middles) - 1)] - a_middles
    delay = np.where(np.abs(before) < np.abs(after), before, after)
    return np.where(np.abs(delay) < periods, np.sin(2.0 * np.pi * delay / periods), np.nan)


class Directions:
    """Tells which way the lines went, from the middles of A's and B's pulses; remembers the last few."""

    def __init__(self) -> None:
        self._a = Pulses(np.empty(0), np.empty(0), 0)
        self._b = Pulses(np.empty(0), np.empty(0), 0)

    def feed(self, a: Pulses, b: Pulses) -> NDArray[np.int8]:
        """+1 where A leads, −1 where B leads, 0 where it cannot be told; one for each new rising edge of A."""
        new = len(a.rising)
        self._a, self._b = _joined(self._a, a), _joined(self._b, b)
        if not new:
            return np.empty(0, np.int8)
        sines = self._sines()
        votes = np.convolve(np.nan_to_num(sines), np.ones(2 * VOTES + 1))[VOTES : VOTES + len(sines)]
        self._forget()
        return np.sign(votes).astype(np.int8)[len(votes) - new :]

    def _sines(self) -> NDArray[np.float64]:
        """See `quadrature`; one for each rising edge of A, NaN where the pulse is not complete."""
        sines = np.full(len(self._a.rising), np.nan)
        if len(sines) >= 2:
            periods = np.diff(self._a.rising)
            whole = middles(self._a.rising, self._a.falling)
            periods = np.append(periods, periods[-1])[: len(whole)]
            sines[: len(whole)] = quadrature(whole, middles(self._b.rising, self._b.falling), periods)
        return sines

    def _forget(self) -> None:
        """Keep the last lines, and of B what belongs to them."""
        if len(self._a.rising) > 2 * VOTES:
            since = float(self._a.rising[-2 * VOTES - 1])
            self._a, self._b = (_later(one, since) for one in (self._a, self._b))


def _joined(one: Pulses, other: Pulses) -> Pulses:
    return Pulses(
        np.concatenate([one.rising, other.rising]), np.concatenate([one.falling, other.falling]), other.between
    )


def _later(pulses: Pulses, since: float) -> Pulses:
    return Pulses(pulses.rising[pulses.rising > since], pulses.falling[pulses.falling > since], pulses.between)


@dataclass(frozen=True)
class Placed:
    """An index pulse between line `line` and the next; `count` lines after the last pulse (None: it is the first).

    `time` (s) is half a line before the line after it, `ends` the revolutions that it closes: begin and end, s.
    """

    line: int
    count: int | None
    time: float
    ends: tuple[tuple[float, float], ...]


class IndexCount:
    """Places index pulses between lines, and closes revolutions."""

    def __init__(self) -> None:
        self._edges: NDArray[np.float64] = np.empty(0)
        self._seen = 0  # edges so far, the forgotten ones included
        self._pulses = Pulses(np.empty(0), np.empty(0), 0)
        self._last: tuple[int, float] | None = None  # the line before the last pulse, and the pulse's place

    def feed(self, edges: NDArray[np.float64], index: Pulses, *, final: bool) -> list[Placed]:
        """The pulses that can be placed now: those with enough lines after them; with `final` one is enough."""
        self._edges = np.concatenate([self._edges, edges])
        self._seen += len(edges)
        self._pulses = _joined(self._pulses, index)
        found: list[Placed] = []
        for pulse in middles(self._pulses.rising, self._pulses.falling).tolist():
            at = int(np.searchsorted(self._edges, pulse))
            if len(self._edges) - at < (1 if final else NEIGHBOURS):
                break
            if len(self._edges) >= 2:
                found.append(self._placed(pulse, at))
            self._pulses = _later(self._pulses, pulse)
        self._forget()
        return found

    def _placed(self, pulse: float, at: int) -> Placed:
        """One pulse, which comes before edge `at` of those that are kept."""
        first = max(at - NEIGHBOURS, 0)
        near = self._edges[first : at + NEIGHBOURS]
        offset = self._seen - len(self._edges)
        # A platter that spins up from rest turns with the square of time.
        curve = np.polyfit(near - pulse, np.arange(len(near)), 2 if len(near) >= NEIGHBOURS else 1)
        place = offset + first + float(curve[-1])
        line, count = math.floor(place), None
        if self._last is not None:
            count = round(place - self._last[1])
            line = self._last[0] + count
        line = min(max(line, offset - 1), self._seen - 2)
        ends = self._closed(line, count, offset) if count in WHOLE else ()
        self._last = (line, place)
        after = self._edges[line + 1 - offset]
        return Placed(line, count, float(after - 0.5 / max(float(curve[-2]), 1e-9)), ends)

    def _closed(self, line: int, count: int, offset: int) -> tuple[tuple[float, float], ...]:
        """Begin and end of the one or two revolutions that end with the line after `line`."""
        if line + 1 - count < offset:
            return ()
        bounds = [float(self._edges[line + 1 - offset - back]) for back in range(count, -1, -LINES)]
        return tuple(pairwise(bounds))

    def _forget(self) -> None:
        """Keep the lines of two revolutions, and all that a pulse still waits for."""
        keep = WHOLE[-1] + 2 * NEIGHBOURS
        waiting = self._pulses.rising[0] if len(self._pulses.rising) else math.inf
        keep += len(self._edges) - int(np.searchsorted(self._edges, waiting))
        self._edges = self._edges[max(len(self._edges) - keep, 0) :]


class Decoder:
    """Decodes one record, chunk by chunk. Chunks must follow one another without a gap."""

    def __init__(self, settings: Settings | None = None) -> None:
        self._settings = one = settings or Settings()
        self._triggers = {name: Trigger(one.low, one.high) for name in (one.a, one.b, one.index)}
        self._directions, self._index_count = Directions(), IndexCount()
        self._lines, self._next_scan = 0, -1

    def feed(self, samples: Samples, *, final: bool = False) -> Lines:
        """Lines and index pulses that this chunk completes. `final`: no chunk follows, place what is near the end.

        Raises what the samples do if a channel is missing, ValueError if the chunk does not follow the last one.
        """
        if self._next_scan not in (-1, samples.first_scan):
            raise ValueError(f"found a chunk from scan {samples.first_scan}, wanted one from {self._next_scan}")
        self._next_scan = samples.first_scan + len(samples.counts)
        a, b, index = (
            trigger.feed(samples.volts(name), samples.instants(name)) for name, trigger in self._triggers.items()
        )
        direction = self._directions.feed(a, b) * np.int8(self._settings.a_leads)
        first, self._lines = self._lines, self._lines + len(a.rising)
        placed = self._index_count.feed(a.rising, index, final=final)
        counts = tuple(one.count for one in placed if one.count is not None)
        return Lines(
            edges=a.rising,
            direction=direction,
            first_line=first,
            index=np.array([one.time for one in placed], np.float64),
            index_line=np.array([one.line for one in placed], np.int64),
            counts=counts,
            missed=sum(count // LINES - 1 for count in counts if count in WHOLE),
            flagged=tuple(count for count in counts if count not in WHOLE),
            revolutions=np.array([ends for one in placed for ends in one.ends], np.float64).reshape(-1, 2),
            between=a.between + b.between + index.between,
        )


def decode(samples: Samples, settings: Settings | None = None) -> Lines:
    """A whole record at once. Raises what the samples do if a channel is missing."""
    return Decoder(settings).feed(samples, final=True)
