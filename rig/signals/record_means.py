"""Noise of the means of records that were made apart, and how far their zeros wander from one another beyond it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import chdtri

from rig.signals.noise import NoiseModel, fit_density
from rig.signals.spectrum import Density

Array = NDArray[np.float64]
EQUAL = 1e-9  # relative: what varies by less does not vary
WIDEST = 1e8  # times the variance from noise: how far zeros are looked for
OUTSTANDING = 3.0  # times its noise: a wandering that is worth a word


@dataclass(frozen=True)
class Means:
    """Means of a channel over p records from `begin` to `end` (s), (p,), with the `power` of the motion in each, which
    a bent response turns into a mean, and what else they may follow, `beside` (k, p)."""

    values: Array
    begin: Array
    end: Array
    power: Array
    beside: Array

    @property
    def design(self) -> Array:
        """A constant, the power, and of the rest what leaves three records for each column, (p, columns)."""
        rows = [np.ones(len(self.values))]
        for row, each in ((self.power, 1), *((row, 3) for row in self.beside)):
            spread = float(np.ptp(row))
            if spread > EQUAL * float(np.abs(row).max()) and each * (len(rows) + 1) <= max(len(self.values) - 1, 0):
                rows.append((row - row.mean()) / spread)
        return np.array(rows).T


def noise_of(found: Sequence[Density], rate: float, pole: float | None, means: Means) -> NoiseModel:
    """Noise of a channel for its means, from spectra each of which has at least its own noise: the least counts.

    Flicker counts as far as lines show it. What is too slow for the lines shows in the means themselves: a zero of
    each record's own, with the variance that makes the rest agree.
    """
    models = [fit_density(one, rate, step=0.0, pole=pole, shown=True) for one in found]
    seconds = float(np.median(means.end - means.begin))
    model = min(models, key=lambda one: float(one.covariance(0.0, seconds)[0, 0]))
    since = float(means.begin.min())
    covariance = model.covariance(means.begin - since, means.end - since)
    apart, freedom = between(means.values, covariance, design := means.design), len(means.values) - design.shape[1]
    share = apart / (apart + float(np.trace(covariance)) / len(means.values))
    known = share * math.sqrt(2.0 / max(freedom, 1))
    return replace(model, apart=apart, u_apart=known)


def between(values: Array, covariance: Array, design: Array) -> float:
    """Variance between values (p,) beyond their covariance (p, p), what `design` (p, k) explains taken off.

    χ²(τ²) = rᵀ(C + τ²I)⁻¹r comes down to its median (Paule and Mandel 1982, median-unbiased as in Viechtbauer 2021);
    zero where it lies below without, and where there are no more values than columns.
    """
    freedom = len(values) - design.shape[1]
    if freedom < 1:
        return 0.0
    wanted = float(chdtri(freedom, 0.5))
    typical = float(np.trace(covariance)) / len(values)

    def excess(share: float) -> float:
        whole = covariance + share * typical * np.eye(len(values))
        root = np.linalg.inv(np.linalg.cholesky(whole))
        of_values, of_design = root @ values, root @ design
        left = of_values - of_design @ np.linalg.lstsq(of_design, of_values, rcond=None)[0]
        return float(left @ left) - wanted

    if excess(0.0) <= 0.0:
        return 0.0
    return typical * float(brentq(excess, 0.0, WIDEST)) if excess(WIDEST) < 0.0 else typical * WIDEST


def wandering(channel: str, unit: str, model: NoiseModel, seconds: float) -> list[str]:
    """A sentence on a zero that wanders, if it does by more than its noise."""
    noise = math.sqrt(float(replace(model, apart=0.0).covariance(0.0, seconds)[0, 0]))
    wanders = math.sqrt(model.apart)
    if wanders <= OUTSTANDING * noise:
        return []
    size = f"{wanders:.2g} {unit}".strip()
    return [
        f"the zero output of {channel} wanders by {size} from file to file, {wanders / noise:.2g} times the noise of a "
        "mean: counted as noise of the means"
    ]
