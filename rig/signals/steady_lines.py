"""Steady lines in a record of noise (mains, a fan, a clock): found, and taken out before a density is fitted.

A line is no density: a fit that meets one bends every term of its model. It stands out where the power of cosine lines,
averaged over stretches of the record, is further above the median around it than chance explains. From every stretch a
sine of free frequency is taken (IEEE Std 1057), so that mains that wander are followed; the cosine lines next to it
lose noise by that and do not count afterwards.
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
SLOWEST = 20  # lines from zero: below, a median follows a spectrum that rises badly
PASSES = 4  # what the strongest lines hide is found when they are gone
MOST = 24  # lines of a record; where more stand out they are not steady
LEAKS = 8.0  # of a line's power over the square of the distance in lines: more than an untapered transform spreads
STRETCH = 5.0  # s, in which mains keep their frequency
REACH = 0.3  # Hz on either side of a line that do not count: more than a stretch resolves


@dataclass(frozen=True)
class SteadyLine:
    """A line that was taken out: frequency, Hz, and root mean square in the record's unit."""

    frequency: float
    rms: float


def without_lines(heard: Periodogram, again: Callable[[], Iterable[Array]]) -> tuple[Lines, tuple[SteadyLine, ...]]:
    """Spectral lines of a record without its steady lines, and those, by frequency.

    `heard` was fed the record; `again` gives its pieces (n,) anew, asked for only where there are lines. Raises
    BadInput as `Periodogram.result` does.
    """
    quiet, starts, taken = heard, list[float](), list[SteadyLine]()
    for _ in range(PASSES):
        new = _standing_out(quiet, _bands(starts))[: MOST - len(starts)]
        if not new:
            break
        starts += new
        cleaner = _Cleaner(heard.rate, starts)
        quiet = Periodogram(heard.rate, without=_bands(starts))
        for piece in again():
            quiet.feed(cleaner.feed(piece))
        quiet.feed(cleaner.rest())
        taken = cleaner.lines()
    return quiet.result(), tuple(sorted(taken, key=lambda line: line.frequency))


def lines_without(values: Array, rate: float) -> tuple[Lines, tuple[SteadyLine, ...]]:
    """The same of a record (n,) in memory."""
    heard = Periodogram(rate)
    heard.feed(values)
    return without_lines(heard, lambda: [values])


def _bands(starts: Sequence[float]) -> list[tuple[float, float]]:
    return [(f - REACH, f + REACH) for f in starts]


def _standing_out(heard: Periodogram, known: Sequence[tuple[float, float]]) -> list[float]:
    """Frequencies of lines that chance does not explain, the strongest first, without those in the bands known."""
    from scipy.special import gammaincinv

    frequency, power, count = heard.powers()
    if len(power) <= 2 * SLOWEST:
        return []
    half = 0.5 * count
    level = around(power[:, None], float(gammaincinv(half, 0.5)) / half)[:, 0]
    looked = np.arange(len(power)) >= SLOWEST
    for low, high in known:
        looked &= (frequency < low) | (frequency > high)
    relative = np.where(looked & (level > 0.0), power / np.where(level > 0.0, level, 1.0), 0.0)
    tried = int(np.count_nonzero(looked))
    found: list[int] = []
    for k in np.argsort(relative)[::-1].tolist():
        if tried == 0 or evidence(half * float(relative[k]), half, tried) <= EVIDENCE:
            break
        if all(power[k] > LEAKS * power[j] / (k - j) ** 2 for j in found):
            found.append(k)
    return [float(frequency[k]) for k in sorted(found, key=lambda k: -power[k])]


class _Cleaner:
    """Takes sines near some frequencies (Hz) out of a record that comes in pieces; the strongest stand first."""

    def __init__(self, rate: float, frequencies: Sequence[float]) -> None:
        self._rate, self._starts, self._length = rate, tuple(frequencies), round(STRETCH * rate)
        self._held: Array = np.empty(0)
        self._samples = 0
        self._moments = np.zeros((2, len(frequencies)))  # of every line: Σ samples × mean square, × that × frequency

    def feed(self, values: Array) -> Array:
        """What is ready of the record so far."""
        self._held = np.concatenate([self._held, values])
        ready: list[Array] = [np.empty(0)]
        while len(self._held) >= 2 * self._length:  # so that the last stretch is no short one
            ready.append(self._without(self._held[: self._length]))
            self._held = self._held[self._length :]
        return np.concatenate(ready)

    def rest(self) -> Array:
        """What is left of it."""
        held, self._held = self._held, np.empty(0)
        return self._without(held) if len(held) else held

    def lines(self) -> list[SteadyLine]:
        """What was taken out."""
        square, turned = self._moments
        rms = np.sqrt(square / max(self._samples, 1))
        return [SteadyLine(float(f / s), float(r)) for f, s, r in zip(turned, square, rms, strict=True) if s > 0.0]

    def _without(self, values: Array) -> Array:
        time = np.arange(len(values)) / self._rate
        left = values.copy()
        for n, start in enumerate(self._starts):
            tone = _tone(time, left, start)
            left -= np.real(tone.amplitude * phasors(2.0 * math.pi * tone.frequency * time))
            square = 0.5 * tone.magnitude**2 * len(values)
            self._moments[:, n] += square, square * tone.frequency
        self._samples += len(values)
        return left


def _tone(time: Array, values: Array, near: float) -> Tone:
    """The sine in a stretch, at this very frequency where none near it settles."""
    try:
        return fit_four(time, values, near)
    except BadInput:
        return fit_three(time, values, near)
