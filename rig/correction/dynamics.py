"""Filters and delays undone: a short sum over neighbouring samples that is as early and as high as the output is late
and low, within a stated band.

Above the band the inverse of a filter is mostly noise, so there the sum fades out. What is asked of it is least
squares over frequency; at rest it is exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rig.correction.inverse import Array, Complexes

HALF = 32  # samples on either side
LINES = 512  # frequencies up to half the rate
MOST_GAIN = 2.0  # a signal that the filter leaves less than half of is not brought back
SHARE = 0.4  # of the rate: nearer to half of it there is no telling signals from their images
BESIDE = 1e-3  # weight above the band
SLOW = 0.01  # Hz, where a lag is taken


@dataclass(frozen=True)
class Taps:
    """The sum: out[i] = Σ taps[k]·in[i + ahead + k − HALF], beyond the ends the end's own value.

    Up to `band` Hz it is right within `error` (of 1); `noise` is what white noise is multiplied by.
    """

    rate: float
    ahead: int
    taps: Array
    band: float
    error: float
    noise: float

    def __call__(self, signal: Array) -> Array:
        """Along the last axis."""
        count, half = signal.shape[-1], len(self.taps) // 2
        first = np.repeat(signal[..., :1], half + max(-self.ahead, 0), axis=-1)
        last = np.repeat(signal[..., -1:], half + max(self.ahead, 0), axis=-1)
        wide = np.concatenate([first, signal, last], axis=-1)
        begin = half + max(-self.ahead, 0) + self.ahead - half
        found = np.zeros_like(signal, np.float64)
        for k, tap in enumerate(self.taps):
            found += tap * wide[..., begin + k : begin + k + count]
        return found


def lag(response: Callable[[Array], Complexes]) -> float:
    """How late slow signals come, s."""
    slow = response(np.array([SLOW]))[0]
    return float(-np.angle(slow) / (2.0 * math.pi * SLOW))


def taps(response: Callable[[Array], Complexes], rate: float, half: int = HALF) -> Taps:
    """The sum that undoes a response in records of `rate` samples per second."""
    f = np.linspace(0.0, 0.5 * rate, LINES)
    with np.errstate(divide="ignore", invalid="ignore"):
        wanted = 1.0 / response(f)
    band = _band(f, np.abs(wanted), rate)
    ahead = round(lag(response) * rate)
    wanted = wanted * np.exp(-2j * math.pi * f * ahead / rate)
    inside = f <= band
    fading = np.clip(2.0 - f / band, 0.0, 1.0)
    wanted = np.where(inside, wanted, wanted[inside][-1] * fading)
    waves = np.exp(2j * math.pi * np.outer(f, np.arange(-half, half + 1)) / rate)
    weight = np.where(inside, 1.0, BESIDE)
    heavy, target = waves * weight[:, None], wanted * weight
    found, *_ = np.linalg.lstsq(np.concatenate([heavy.real, heavy.imag]), np.concatenate([target.real, target.imag]))
    found = found * (float(wanted[0].real) / float(found.sum()))
    error = float(np.max(np.abs((waves @ found)[inside] / wanted[inside] - 1.0)))
    return Taps(rate, ahead, found, band, error, float(np.sqrt(np.sum(found**2))))


def _band(f: Array, gain: Array, rate: float) -> float:
    """Highest frequency that is brought back, Hz."""
    beyond = np.flatnonzero(~(gain <= MOST_GAIN))
    highest = float(f[beyond[0] - 1]) if len(beyond) and beyond[0] > 0 else math.inf
    return max(min(SHARE * rate, highest), float(f[1]))
