"""Noise of like channels from many short records at rest: white noise and, if they need it together, flicker."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.signals.noise import NoiseModel, fit_density
from rig.signals.spectrum import Density

Array = NDArray[np.float64]
LEAST = 32  # samples of a part at rest that says something about noise
BINS = 10.0  # per decade of frequency
EDGE = 0.1  # of a part, left out at either end where its noise is looked at
EFFICIENCY = 2.0 / math.pi  # of a median beside a mean
QUANTILES = 2000  # of a distribution, of which an expectation is made


def noises_at_rest(channels: Sequence[Sequence[Array]], rate: float) -> list[NoiseModel]:
    """White noise, and flicker if they need it together, of like channels with their parts at rest, (n,), at `rate` Hz.

    Lines of cosine transforms without the mean (see `spectrum.Lines`). The ends of a part, where a hand may still
    be on it, are left out, and the parts' median is taken in every band of frequency: one that was pushed counts
    little. Raises BadInput if all parts are short.
    """
    found = [_noise(parts, rate) for parts in channels]
    coloured = sum(gain for _, _, gain in found) > 0.0
    return [flicker if coloured else white for white, flicker, _ in found]


def _noise(parts: Sequence[Array], rate: float) -> tuple[NoiseModel, NoiseModel, float]:
    """White noise; white noise and flicker; and how much better the latter is by Akaike's criterion (1974).

    It asks which of the two tells how noisy a mean will be. Schwarz's (1978) asks which is true, and leaves out flicker
    that few or short parts hardly show, although means feel it most.
    """
    step = step_of(np.concatenate(parts))
    rounding = step**2 / 6.0 / rate
    density = _together([_lines(_middle(part), rate) for part in parts], rounding)
    level = float(np.average(density.density, weights=density.dof))
    white = NoiseModel(rate, max(level - rounding, 0.0), quantisation=rounding)
    coloured = fit_density(density, rate, step=step, pole=None)
    gain = 2.0 * (_likelihood(density, coloured) - _likelihood(density, white))
    return white, coloured, gain - 2.0


def _middle(part: Array) -> Array:
    """A part without its ends and without gaps."""
    end = int(EDGE * len(part))
    values = part[end : len(part) - end]
    return np.asarray(values[np.isfinite(values)], np.float64)


def _lines(values: Array, rate: float) -> tuple[Array, Array]:
    """Frequencies and squares of the lines of one part, Hz and unit²/Hz; none of a short one."""
    from scipy.fft import dct

    if len(values) < LEAST:
        return np.zeros(0), np.zeros(0)
    lines: Array = dct(values, type=2, norm="ortho")[1:]
    frequency = np.arange(1, len(values), dtype=np.float64) * rate / (2.0 * len(values))
    return np.asarray(frequency), np.asarray(lines**2 * 2.0 / rate)


def _together(parts: Sequence[tuple[Array, Array]], least: float) -> Density:
    """Median over the parts of their means in bins of equal width in the logarithm of frequency, at least `least`."""
    seen: dict[int, list[tuple[float, int, float]]] = {}
    for frequency, power in parts:
        place = np.floor(BINS * np.log10(frequency)).astype(np.intp)
        for one in np.unique(place).tolist():
            here = place == one
            count = int(np.count_nonzero(here))
            seen.setdefault(one, []).append((float(power[here].mean()), count, float(np.log(frequency[here]).mean())))
    if not seen:
        raise BadInput(f"poses: found no part at rest of {LEAST} samples, wanted longer poses")
    found = [np.array(seen[one]) for one in sorted(seen)]
    efficiency = [1.0 if len(one) == 1 else EFFICIENCY for one in found]
    levels = [float(np.median(one[:, 0] / [_median(len(one), int(k)) for k in one[:, 1]])) for one in found]
    return Density(
        np.array([math.exp(float(np.average(one[:, 2], weights=one[:, 1]))) for one in found]),
        np.maximum(levels, least),
        np.array([share * float(one[:, 1].sum()) for share, one in zip(efficiency, found, strict=True)]),
    )


@lru_cache(maxsize=1024)
def _median(parts: int, lines: int) -> float:
    """Expectation of the median of some means, each of the squares of so many lines, of which one square has 1.

    Order statistics of χ² ÷ its degrees of freedom: of few parts the median is well above that of the distribution.
    """
    from scipy.special import gammaincinv
    from scipy.stats import beta

    if parts == 1:
        return 1.0
    share = (np.arange(QUANTILES) + 0.5) / QUANTILES
    middle = {(parts + 1) // 2, parts // 2 + 1}
    weights = np.sum([beta.pdf(share, k, parts + 1 - k) for k in middle], axis=0)
    return float(np.average(2.0 / lines * gammaincinv(0.5 * lines, share), weights=weights))


def _likelihood(seen: Density, model: NoiseModel) -> float:
    """Logarithm, without constants, of that of bins which are gamma distributed (Whittle 1953)."""
    level = model.density(seen.frequency)
    return -0.5 * float(seen.dof @ (np.log(level) + seen.density / level))


def step_of(values: Array) -> float:
    """Smallest difference between the numbers that a record holds: what it is rounded to."""
    different = np.diff(np.unique(values[np.isfinite(values)]))
    return float(different.min()) if len(different) else 0.0
