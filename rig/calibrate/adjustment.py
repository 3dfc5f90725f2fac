"""Least-squares adjustment with prior knowledge, and how much each input contributes to the result.

Observations y with uncertainties and prior values of some parameters are treated alike (GUM with type A and type B
inputs; Mathews and Fowler, linear models with systematic effects): minimise

    Σ ((y_i − f_i(p)) / u_i)²  +  Σ ((p_j − p0_j) / u(p0_j))² .

Near the solution every parameter is a linear function of all inputs, so its variance splits exactly into the share of
the observations' noise and one signed coefficient for each prior.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

Array = NDArray[np.float64]
Model = Callable[[Array], Array]
SMALL = 1e-5  # of one standard uncertainty: a step that moves the fit by less changes nothing


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter beforehand: value and standard uncertainty."""

    value: float
    u: float


@dataclass(frozen=True)
class Adjustment:
    """`values` and `covariance` of the parameters by `names`; χ² with `dof`, priors included.

    `noise` is the part of the covariance that comes from the observations; `coefficients[j]` is ∂p/∂p0_j for the prior
    of parameter j, shape (parameters,). `weights` are ∂p/∂(residual), shape (parameters, observations).
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    noise: Array
    coefficients: Mapping[str, Array]
    priors: Mapping[str, Prior]
    chi2: float
    dof: int
    weights: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    def value(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    def u(self, name: str) -> float:
        place = self.names.index(name)
        return float(np.sqrt(self.covariance[place, place]))

    def u_noise(self, name: str) -> float:
        """Standard uncertainty from the observations alone."""
        place = self.names.index(name)
        return float(np.sqrt(self.noise[place, place]))

    def coefficient(self, name: str, prior: str) -> float:
        """∂(name)/∂(prior value of `prior`)."""
        return float(self.coefficients[prior][self.names.index(name)])


def adjust(
    residuals: Model, start: Mapping[str, float], priors: Mapping[str, Prior], iterations: int = 50
) -> Adjustment:
    """Gauss–Newton from `start`; `residuals(p)` are (y − f(p))/u, shape (n,), for parameters in the order of `start`.

    Raises BadInput if there are fewer observations than parameters, parameters that cannot be told apart, or no
    convergence.
    """
    names = tuple(start)
    p = np.array(list(start.values()), np.float64)
    scale = np.where(p != 0.0, np.abs(p), 1.0)
    scale = np.array([priors[n].u if n in priors and priors[n].u else s for n, s in zip(names, scale, strict=True)])
    for _ in range(iterations):
        jacobian, left = _linearised(residuals, names, p, scale, priors)
        _refuse_rank(jacobian, names)
        step = -np.linalg.lstsq(jacobian, left, rcond=None)[0]
        p = p + step * scale
        if float(np.linalg.norm(jacobian @ step)) < SMALL:
            return _adjusted(residuals, names, p, scale, priors)
    raise BadInput(f"adjustment of {', '.join(names)}: found no solution in {iterations} steps, wanted convergence")


def _linearised(
    residuals: Model, names: tuple[str, ...], p: Array, scale: Array, priors: Mapping[str, Prior]
) -> tuple[Array, Array]:
    """Jacobian by scaled parameters and residuals, the priors' rows below."""
    at = residuals(p)
    columns = []
    for place in range(len(p)):
        step = np.zeros(len(p))
        step[place] = 1e-6 * scale[place]
        columns.append((residuals(p + step) - residuals(p - step)) / 2e-6)
    rows = [(n, prior) for n, prior in priors.items() if prior.u > 0.0]
    below = np.zeros((len(rows), len(p)))
    known = np.zeros(len(rows))
    for row, (name, prior) in enumerate(rows):
        place = names.index(name)
        below[row, place] = -scale[place] / prior.u
        known[row] = (prior.value - p[place]) / prior.u
    return np.vstack([np.column_stack(columns), below]), np.concatenate([at, known])


def _refuse_rank(jacobian: Array, names: tuple[str, ...]) -> None:
    if jacobian.shape[0] < jacobian.shape[1]:
        raise BadInput(f"adjustment: found {jacobian.shape[0]} observations, wanted at least {jacobian.shape[1]}")
    size = np.linalg.norm(jacobian, axis=0)
    if not np.all(size > 0.0):
        missing = ", ".join(n for n, s in zip(names, size, strict=True) if not s > 0.0)
        raise BadInput(f"adjustment: found data that say nothing of {missing}, wanted some that do")
    values, vectors = np.linalg.eigh((jacobian / size).T @ (jacobian / size))
    if values[0] < 1e-12:
        mixed = [n for n, share in zip(names, np.abs(vectors[:, 0]), strict=True) if share > 0.1]
        raise BadInput(f"adjustment: found data that cannot tell {' from '.join(mixed)}, wanted some that can")


def _adjusted(
    residuals: Model, names: tuple[str, ...], p: Array, scale: Array, priors: Mapping[str, Prior]
) -> Adjustment:
    jacobian, left = _linearised(residuals, names, p, scale, priors)
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    gain = -inverse @ jacobian.T * scale[:, None]  # parameters by unit inputs: their covariance is gain · gainᵀ
    known = [name for name, prior in priors.items() if prior.u > 0.0]
    count = jacobian.shape[0] - len(known)
    noise = gain[:, :count] @ gain[:, :count].T
    coefficients = {name: gain[:, count + row] / priors[name].u for row, name in enumerate(known)}
    return Adjustment(
        names=names,
        values=p,
        covariance=gain @ gain.T,
        noise=noise,
        coefficients=coefficients,
        priors=dict(priors),
        chi2=float(left @ left),
        dof=jacobian.shape[0] - jacobian.shape[1],
        weights=gain[:, :count],
    )
