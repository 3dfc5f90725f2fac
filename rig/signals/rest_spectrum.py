"""Spectrum of records at rest in a few bands: powers of many lines, whose scatter is known from how many there are.

Below 1 Hz lines are those of a cosine transform, which are independent of white noise, flicker and random walk alike
(see `spectrum.Lines`); the lowest are left out, where a zero that drifts would pass for noise. Above, a record is
tapered at both ends (Tukey's window), so that a strong line stays within a few of its neighbours, and multiples of the
mains frequency are left out. One-sided densities in unit²/Hz throughout.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LOWEST = 0.1  # Hz
SPLIT = 1.0  # Hz, from which records are tapered
TAPER = 0.25  # share of a record in both slopes of its window
PER_OCTAVE = 2
FEWEST = 10.0  # degrees of freedom of a band: the logarithm of fewer is far from normal
NODES = 6  # frequencies that stand for the lines of a band
BESIDE = 0.3  # Hz on either side of a multiple of the mains that its line may reach
LOBES = 3.0  # lines of the tapered transform on either side that a steady line reaches


@dataclass(frozen=True)
class Bands:
    """Powers of c channels in b bands: `nodes` (b, NODES) Hz stand for a band's lines, which lie between `low` and
    `high` Hz (b,); mean `power` (c, b) unit²/Hz with `dof` (b,) degrees of freedom. The records that they are made of
    have so many samples (`counts`), `rate` of them a second; lines of the `mains` (Hz) are left out.
    """

    nodes: Array
    low: Array
    high: Array
    power: Array
    dof: Array
    counts: tuple[int, ...]
    rate: float
    mains: float


@dataclass(frozen=True)
class _Lines:
    """Lines of one record: frequency Hz (n,), power unit²/Hz (c, n), degrees of freedom of each."""

    frequency: Array
    power: Array
    dof: float


def edges(rate: float) -> Array:
    """Edges of all bands that a record at this rate can have, Hz."""
    below = SPLIT * 2.0 ** -(np.arange(math.floor(PER_OCTAVE * math.log2(SPLIT / LOWEST)), -1, -1) / PER_OCTAVE)
    count = math.floor(PER_OCTAVE * math.log2(0.5 * rate / SPLIT))
    above = SPLIT * 2.0 ** (np.arange(1, count + 1) / PER_OCTAVE)
    return np.concatenate([below, above[:-1] if above[-1] > 0.45 * rate else above, [0.5 * rate]])


def bands(records: Sequence[Array], rate: float, mains: float) -> Bands | None:
    """Bands of records at rest, each (n, c) at `rate` Hz, taken together; None if they are too short for any."""
    found = [lines for values in records for lines in (_slow(values, rate), _fast(values, rate, mains))]
    sides = edges(rate)
    made: list[tuple[list[tuple[_Lines, NDArray[np.bool_]]], float, float]] = []
    low = sides[0]
    for high in sides[1:]:
        here = [(one, mask) for one in found if (mask := (one.frequency >= low) & (one.frequency < high)).any()]
        if sum(one.dof * np.count_nonzero(mask) for one, mask in here) >= FEWEST or (high == sides[-1] and here):
            made.append((here, low, high))
            low = high
        elif high == SPLIT:  # what is left below is not mixed with lines of another kind
            low = high
    if not made:
        return None
    columns = [_band(here) for here, _, _ in made]
    nodes, power, dof = (np.array([one[k] for one in columns]) for k in range(3))
    low, high = (np.array([one[k] for one in made]) for k in (1, 2))
    return Bands(nodes, low, high, power.T, dof, tuple(len(values) for values in records), rate, mains)


def of_line(found: Bands, frequency: float) -> Array:
    """What a steady line (Hz) of unit mean square adds to the mean of every band, whatever its phase, 1/Hz (b,).

    A strong one reaches far beyond its own band: a taper damps what leaks and does not end it.
    """
    return _of_line(found.counts, found.rate, found.mains, frequency)


@lru_cache(maxsize=64)
def _of_line(counts: tuple[int, ...], rate: float, mains: float, frequency: float) -> Array:
    courses = (2.0 * math.pi * frequency / rate * np.arange(count) for count in counts)
    made = bands([math.sqrt(2.0) * np.stack([np.cos(one), np.sin(one)], axis=1) for one in courses], rate, mains)
    assert made is not None  # as of the records themselves
    return np.asarray(made.power.mean(axis=0))


def _band(here: Sequence[tuple[_Lines, NDArray[np.bool_]]]) -> tuple[Array, Array, float]:
    frequency = np.concatenate([one.frequency[mask] for one, mask in here])
    weight = np.concatenate([np.full(np.count_nonzero(mask), one.dof) for one, mask in here])
    dof = float(weight.sum())
    power = np.sum([one.dof * one.power[:, mask].sum(axis=1) for one, mask in here], axis=0) / dof
    order = np.argsort(frequency, kind="stable")
    share = (np.cumsum(weight[order]) - 0.5 * weight[order]) / dof
    nodes = np.interp((np.arange(NODES) + 0.5) / NODES, share, frequency[order])
    return nodes, power, dof


def _slow(values: Array, rate: float) -> _Lines:
    """Lines of the cosine transform below SPLIT."""
    from scipy.fft import dct

    count = len(values)
    apart = rate / (2.0 * count)
    k = np.arange(max(math.ceil(LOWEST / apart), 1), min(math.ceil(SPLIT / apart), count))
    lines = dct(values - values.mean(axis=0), type=2, norm="ortho", axis=0)[k]
    return _Lines(np.asarray(k * apart, np.float64), np.asarray(lines.T**2 * (2.0 / rate)), 1.0)


def _fast(values: Array, rate: float, mains: float) -> _Lines:
    """Lines of the tapered record above SPLIT, without those of the mains."""
    count = len(values)
    window = _tukey(count)
    square = float(window @ window)
    spectrum = np.fft.rfft((values - values.mean(axis=0)) * window[:, None], axis=0)
    apart = rate / count
    frequency = np.arange(len(spectrum)) * apart
    beside = np.abs(frequency - mains * np.maximum(np.round(frequency / mains), 1.0))
    kept = (frequency >= SPLIT) & (frequency < 0.5 * rate - 0.5 * apart) & (beside > max(BESIDE, LOBES * apart))
    power = np.abs(spectrum[kept]) ** 2 * (2.0 / (rate * square))
    dof = 2.0 * square**2 / (count * float(np.sum(window**4)))
    return _Lines(np.asarray(frequency[kept], np.float64), np.asarray(power.T), dof)


def _tukey(count: int) -> Array:
    """Tukey's window: one in the middle, half a cosine at either end."""
    slope = max(round(0.5 * TAPER * count), 1)
    rise = 0.5 - 0.5 * np.cos(math.pi * (np.arange(slope) + 0.5) / slope)
    return np.concatenate([rise, np.ones(count - 2 * slope), rise[::-1]])
