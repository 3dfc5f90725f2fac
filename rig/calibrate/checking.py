"""Budgets checked by propagation of distributions (GUM Supplement 1): is y ± U the interval that Monte Carlo gives?

The model is that of the results: relative inputs multiply the value, the others add to it,

    y = value · Π (1 + x_i) + Σ c_j · x_j .
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.calibrate.budget import Contribution, Draw, MonteCarlo, monte_carlo, validated
from rig.calibrate.calibration import COMBINED, Calibration, Result

SEED = 20_231
DRAWS = 1_000_000
MEASURANDS = (COMBINED, "sensitivity", "sensitivity_gravity", "sensitivity_centripetal")


@dataclass(frozen=True)
class Checked:
    """One result beside its Monte Carlo interval; `agrees` within the numerical tolerance of JCGM 101 clause 8."""

    key: str
    result: Result
    distribution: MonteCarlo
    agrees: bool


def checked(made: Calibration, measurands: Iterable[str] = MEASURANDS, draws: int = DRAWS) -> Iterator[Checked]:
    """Every determined sensitivity of a calibration."""
    wanted: Mapping[str, None] = dict.fromkeys(measurands)
    for result in made.results:
        if result.measurand in wanted and result.value is not None and result.budget is not None:
            found = distribution_of(result, draws)
            yield Checked(result.key, result, found, validated(result.budget, result.value, found))


def distribution_of(result: Result, draws: int = DRAWS) -> MonteCarlo:
    """Monte Carlo of one determined result."""
    value, lines = float(result.value or 0.0), result.contributions
    relative = np.array([line.unit == "1" for line in lines])
    coefficients = np.array([line.sensitivity for line in lines])
    inputs = [_draw(line) for line in lines]

    def model(x: NDArray[np.float64]) -> NDArray[np.float64]:
        scaled = x * coefficients[:, None]
        product = np.prod(1.0 + scaled[relative] / value, axis=0)
        return np.asarray(value * product + scaled[~relative].sum(axis=0))

    return monte_carlo(model, inputs, draws=draws, seed=SEED)


def _draw(line: Contribution) -> Draw:
    """What was estimated with few degrees of freedom is distributed as t (JCGM 101 6.4.9)."""
    estimated = line.kind == "A" and line.distribution == "normal" and math.isfinite(line.dof)
    return Draw(0.0, line.u, "t" if estimated else line.distribution, line.dof)
