"""Narrow lines in records at rest, whether they were folded into sight, and codes that a converter does not use.

A line stands out of the median power around it; the powers of like channels and of all records are added up, and chance
is a gamma distribution with as many degrees of freedom, times the number of lines looked at. Channels that a
multiplexer converts one after the other see a line of frequency F at phases that go as F times the delay of each: one
that was folded at the sampling rate keeps the phases of what it was, modulo one over the delay between two slots.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
AROUND = 121  # lines whose median is the level around one
SLOWEST = 20.0  # lines from zero: below, a median follows a spectrum that rises badly
BESIDE = 0.15  # Hz on either side of a multiple of the mains
EVIDENCE = 30.0  # −2·ln of what chance gives
IN_STEP = 0.95  # of phases that a folded line explains
ALIKE = 1e-6  # of that: frequencies that cannot be told apart
FEWEST = 4  # channels whose phases tell
FINE = 32  # parts of a line's width to which a frequency is looked for
USED = 0.93  # share of codes in the middle of a record that a converter must have left out to be called coarser
SPAN = 8  # codes that the middle must have


@dataclass(frozen=True)
class Line:
    """A line as it is shown: `frequency` Hz with `u`, `amplitude` (c,) with `u_amplitude` (c,), and −2·ln of chance.

    `phases` (records, c) are those of its cosine at each record's first scan.
    """

    frequency: float
    u: float
    amplitude: Array
    u_amplitude: Array
    phases: Array
    evidence: float


def strongest(records: Sequence[Array], rate: float, mains: float) -> Line | None:
    """The line that stands out most in records (n, c) of like channels, which all are of one length; or None."""
    found = [_powers(values) for values in records]
    relative = np.sum([power / around(power) for power in found], axis=(0, 2))
    frequency = np.arange(len(relative)) * rate / len(records[0])
    beside = np.abs(frequency - mains * np.maximum(np.round(frequency / mains), 1.0))
    looked = (np.arange(len(relative)) > SLOWEST) & (beside > BESIDE) & (frequency < 0.5 * rate - 1.0)
    if not looked.any():
        return None
    place = int(np.where(looked, relative, 0.0).argmax())
    chance = evidence(float(relative[place]), len(records) * records[0].shape[1], int(np.count_nonzero(looked)))
    return _fitted(records, rate, float(frequency[place]), place, chance) if chance > EVIDENCE else None


def _powers(values: Array) -> Array:
    """Lines of Hann's window, (lines, c), of any unit."""
    window = 0.5 - 0.5 * np.cos(2.0 * math.pi * (np.arange(len(values)) + 0.5) / len(values))
    return np.asarray(np.abs(np.fft.rfft((values - values.mean(axis=0)) * window[:, None], axis=0)) ** 2)


def around(power: Array, median: float = math.log(2.0)) -> Array:
    """Expectation of every line from the median of those around it, (lines, c); thinned, for it is smooth.

    `median` of a line whose expectation is 1, by its degrees of freedom: of two without being told.
    """
    step = AROUND // 4
    padded = np.pad(power, ((AROUND // 2, AROUND // 2 + step), (0, 0)), mode="reflect")
    places = np.arange(0, len(power) + step, step)
    windows = np.lib.stride_tricks.sliding_window_view(padded, AROUND, axis=0)
    medians = np.median(windows[np.minimum(places, len(power) - 1)], axis=-1)
    at = np.arange(len(power))
    return np.stack([np.interp(at, places, one) for one in medians.T], axis=1) / median


def evidence(total: float, count: float, tried: int) -> float:
    """−2·ln of the probability that the largest of some sums of `count` exponential numbers is so large."""
    from scipy.special import gammaincc, gammaln

    chance = float(gammaincc(count, total))
    log = math.log(chance) if chance > 0.0 else (count - 1) * math.log(total) - total - float(gammaln(count))
    return -2.0 * (log + math.log(tried))


def _fitted(records: Sequence[Array], rate: float, near: float, place: int, evidence: float) -> Line:
    count = len(records[0])
    time = np.arange(count) / rate
    tried = near + np.linspace(-1.0, 1.0, 2 * FINE + 1) * rate / count
    window = 1.0 - np.cos(2.0 * math.pi * (np.arange(count) + 0.5) / count)
    level = [around(_powers(one))[place] for one in records]  # of Hann's lines, (c,)
    wave = np.exp(-2j * math.pi * tried[0] * time) * (2.0 / count) * window
    step = np.exp(-2j * math.pi * (tried[1] - tried[0]) * time)
    lines = np.empty((len(records), len(tried), records[0].shape[1]), np.complex128)
    centred = [one - one.mean(axis=0) for one in records]
    for at in range(len(tried)):
        lines[:, at] = [wave @ one for one in centred]
        wave = wave * step  # which is the next one's: a product costs a fraction of an exponential
    power = np.sum(np.abs(lines) ** 2 / np.array(level)[:, None], axis=(0, 2))
    best = int(power.argmax())
    shown = lines[:, best]
    variance = np.mean(level, axis=0) / len(records) * (2.0 / count) ** 2 * 4.0 / 2.0  # of each part of an amplitude
    square = np.mean(np.abs(shown) ** 2, axis=0) - 2.0 * np.mean(level, axis=0) * (4.0 / count) ** 2 / 2.0
    amplitude = np.sqrt(np.maximum(square, variance))
    told = float(np.sum(amplitude**2 / (variance * len(records)))) * len(records)
    u = math.sqrt(6.0 / told) / (math.pi * count / rate)
    return Line(float(tried[best]), u, amplitude, np.sqrt(variance), np.angle(shown), evidence)


def folded(line: Line, delay: Array, rate: float) -> float | None:
    """Frequency that a line had before it was folded, as low as it can have been, Hz; None where it was not.

    `delay` s (c,) of every channel in the scan. None too where the phases go with the frequency as it is shown.
    """
    weight = (line.amplitude / line.u_amplitude) ** 2
    if np.count_nonzero(weight > 9.0) < FEWEST:
        return None
    slot = float(np.diff(np.unique(delay)).min())
    highest = round(1.0 / (slot * rate))
    found = []
    for fold in range(highest + 1):
        for sign in (1.0, -1.0):
            tried = fold * rate + sign * line.frequency
            if tried > 0.0:
                turned = np.exp(1j * (sign * line.phases - 2.0 * math.pi * tried * delay))
                step = float(np.mean(np.abs(turned @ weight)) / weight.sum())
                found.append((step, tried))
    best = max(found)[0]
    lowest = min(tried for step, tried in found if step > best - ALIKE)
    return lowest if best > IN_STEP and lowest > 0.5 * rate else None


def coarse_step(codes: Array) -> tuple[float, float] | None:
    """Distance of the codes that a record (n,) of whole numbers uses, and its u, where it leaves others out."""
    low, high = np.quantile(codes, [0.02, 0.98])
    used = np.unique(codes[(codes >= low) & (codes <= high)])
    if len(used) < 2 or used[-1] - used[0] + 1.0 < SPAN or len(used) > USED * (used[-1] - used[0] + 1.0):
        return None
    number = np.round((used - used[0]) / np.diff(used).min())
    if len(used) > 2:
        guess = float((used[-1] - used[0]) / (len(used) - 1))
        number = np.round((used - used[0]) / guess)
    step = float(np.polyfit(number, used, 1)[0])
    return step, 1.0 / math.sqrt(float(np.sum((number - number.mean()) ** 2)))
