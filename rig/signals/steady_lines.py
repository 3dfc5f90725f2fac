"""Steady lines in a record of noise (mains, a fan, a clock): found, and taken out before a density is fitted.

A line is no density: a fit that meets one bends every term of its model. It stands out where the power of cosine lines,
averaged over stretches of the record, is further above the median around it than chance explains. From every stretch a
sine of free frequency is taken (IEEE Std 1057), so that mains that wander are followed; the cosine lines next to it
lose noise by that and do not count afterwards. What is not as strong in every stretch, as narrow noise is not, stays;
a record of fewer than `TELLING` stretches does not tell the two apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.signals.rest_lines import EVIDENCE, around, evidence
from rig.signals.spectrum import Lines, Periodogram
from rig.signals.tone import Tone, fit_four, fit_three, phasors

Array = NDArray[np.float64]
Again = Callable[[], Iterable[Array]]
PASSES = 4  # what the strongest lines hide is found when they are gone
MOST = 24  # lines of a record: where more stand out, what was recorded is not noise with a line or two
SHARE = 0.02  # of a stretch's samples: more numbers than that are not taken from them
NUMBERS = 3  # of a sine
LEAKS = 8.0  # of a line's power over the square of the distance in lines: more than an untapered transform spreads
STRETCH = 5.0  # s, in which mains keep their frequency
LEAST = 500  # samples of a stretch
CYCLES = 5.0  # in a stretch: fewer are not told from drift, nor beside half the sampling rate from their mirror image
REACH = 0.3  # Hz on either side of a line that do not count
RESOLUTIONS = 1.5  # of a stretch, at least
TELLING = 4  # stretches, from which steadiness is judged
WAVERS = 0.5  # standard deviation of a line's power over the stretches, in means: a sine has none, narrow noise has one


@dataclass(frozen=True)
class SteadyLine:
    """A line that was taken out: frequency, Hz, and root mean square in the record's unit."""

    frequency: float
    rms: float


@dataclass(frozen=True)
class _Start:
    """Where a line stands out: Hz, and the density around it, unit²/Hz."""

    frequency: float
    level: float


def without_lines(heard: Periodogram, again: Again) -> tuple[Lines, tuple[SteadyLine, ...]]:
    """Spectral lines of a record without its steady lines, and those, by frequency.

    `heard` was fed the record; `again` gives its pieces (n,) anew, asked for only where there are lines. Raises
    BadInput as `Periodogram.result` does.
    """
    lines = heard.result()
    known, kept = list[_Start](), list[_Start]()
    quiet, cleaner = heard, _Cleaner(heard, ())
    for _ in range(PASSES):
        new = _standing_out(quiet, _bands(heard, known))
        if not new:
            break
        known += new
        if len(kept) + len(new) > min(MOST, SHARE * cleaner.length / NUMBERS):
            return lines, ()
        quiet, cleaner = _cleaned(heard, [*kept, *new], again)
        steady = cleaner.steady()
        if len(steady) < len(kept) + len(new):
            quiet, cleaner = _cleaned(heard, steady, again)
        kept = steady
    return (quiet.result() if kept else lines), cleaner.lines()


def lines_without(values: Array, rate: float) -> tuple[Lines, tuple[SteadyLine, ...]]:
    """The same of a record (n,) in memory."""
    heard = Periodogram(rate)
    heard.feed(values)
    return without_lines(heard, lambda: [values])


def _cleaned(heard: Periodogram, starts: Sequence[_Start], again: Again) -> tuple[Periodogram, _Cleaner]:
    """The record without lines near these frequencies, and what took them out."""
    cleaner, quiet = _Cleaner(heard, starts), Periodogram(heard.rate, without=_bands(heard, starts))
    for piece in again():
        quiet.feed(cleaner.feed(piece))
    quiet.feed(cleaner.rest())
    return quiet, cleaner


def _bands(heard: Periodogram, starts: Sequence[_Start]) -> list[tuple[float, float]]:
    """What is beside these lines, Hz."""
    reach = max(REACH, RESOLUTIONS / min(_stretch(heard.rate), heard.seconds))
    return [(one.frequency - reach, one.frequency + reach) for one in starts]


def _stretch(rate: float) -> float:
    """Length of a stretch, s."""
    return max(STRETCH, LEAST / rate)


def _standing_out(heard: Periodogram, known: Sequence[tuple[float, float]]) -> list[_Start]:
    """Lines that chance does not explain, the strongest first, without those in the bands known."""
    from scipy.special import gammaincinv

    frequency, power, count = heard.powers()
    half, slowest = 0.5 * count, CYCLES / min(_stretch(heard.rate), heard.seconds)
    looked = (frequency > slowest) & (frequency < 0.5 * heard.rate - slowest)
    for low, high in known:
        looked &= (frequency < low) | (frequency > high)
    if not looked.any():
        return []
    level = around(power[:, None], float(gammaincinv(half, 0.5)) / half)[:, 0]
    relative = np.where(looked & (level > 0.0), power / np.where(level > 0.0, level, 1.0), 0.0)
    tried = int(np.count_nonzero(looked))
    found: list[int] = []
    for k in np.argsort(relative)[::-1].tolist():
        if evidence(half * float(relative[k]), half, tried) <= EVIDENCE:
            break
        if all(power[k] > LEAKS * power[j] / (k - j) ** 2 for j in found):
            found.append(k)
    return [_Start(float(frequency[k]), float(level[k])) for k in sorted(found, key=lambda k: -power[k])]


class _Cleaner:
    """Takes sines near some frequencies out of a record that comes in pieces; the strongest stand first."""

    def __init__(self, heard: Periodogram, starts: Sequence[_Start]) -> None:
        self._rate, self._starts = heard.rate, tuple(starts)
        self.length = min(round(_stretch(heard.rate) * heard.rate), heard.samples)
        self._held: Array = np.empty(0)
        self._seen: list[list[tuple[float, float, int]]] = []  # of a stretch, of a line: Hz, mean square, samples

    def feed(self, values: Array) -> Array:
        """What is ready of the record so far."""
        self._held = np.concatenate([self._held, values])
        ready: list[Array] = [np.empty(0)]
        while len(self._held) >= 2 * self.length:  # so that the last stretch is no short one
            ready.append(self._without(self._held[: self.length]))
            self._held = self._held[self.length :]
        return np.concatenate(ready)

    def rest(self) -> Array:
        """What is left of it."""
        held, self._held = self._held, np.empty(0)
        return self._without(held) if len(held) else held

    def steady(self) -> list[_Start]:
        """Those of the lines that are as strong in every stretch, as far as there are enough to tell."""
        if len(self._seen) < TELLING:
            return list(self._starts)
        square = np.array([[one[1] for one in stretch] for stretch in self._seen])
        wavers = square.std(axis=0) > WAVERS * square.mean(axis=0)
        return [one for one, no in zip(self._starts, wavers, strict=True) if not no]

    def lines(self) -> tuple[SteadyLine, ...]:
        """What was taken out, by frequency, less what a sine of free frequency finds in noise alone."""
        if not self._starts:
            return ()
        frequency, square, samples = np.array(self._seen).transpose(2, 0, 1)
        weight, seconds = square * samples, samples.mean() / self._rate
        own = np.maximum(weight.sum(axis=0) / samples.sum(axis=0), np.finfo(float).tiny)
        level = np.array([one.level for one in self._starts])
        rms = np.sqrt(np.maximum(own - 1.5 * level / seconds, 0.0))
        mean = np.sum(weight * frequency, axis=0) / np.maximum(weight.sum(axis=0), np.finfo(float).tiny)
        found = (SteadyLine(float(f), float(r)) for f, r in zip(mean, rms, strict=True))
        return tuple(sorted(found, key=lambda line: line.frequency))

    def _without(self, values: Array) -> Array:
        time = np.arange(len(values)) / self._rate
        left, seen = values.copy(), []
        for start in self._starts:
            tone = _tone(time, left, start.frequency)
            left -= np.real(tone.amplitude * phasors(2.0 * math.pi * tone.frequency * time))
            seen.append((tone.frequency, 0.5 * tone.magnitude**2, len(values)))
        self._seen.append(seen)
        return left


def _tone(time: Array, values: Array, near: float) -> Tone:
    """The sine in a stretch, at this very frequency where none near it settles."""
    try:
        return fit_four(time, values, near)
    except BadInput:
        return fit_three(time, values, near)
