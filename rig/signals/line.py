"""Straight lines and polynomials through calibration points, with errors in the reference as well as in the sensor.

Ordinary least squares takes the reference as exact. When it is not, the slope comes out too small by
var(x)/(var(x) + u_x²): a quarter too small for the rate of single encoder lines at two speeds. `fit_line` and
`fit_polynomial` weigh both errors and have no such bias. `gls` is the linear least squares underneath: any design, any
covariance, and a refusal that names the columns which the data cannot tell apart.

York, Evensen, López Martínez, De Basabe Delgado, Am. J. Phys. 72 (2004) 367; ISO/TS 28037:2010.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.errors import BadInput

Floats = NDArray[np.float64]

ITERATIONS = 500
SETTLED = 1e-14  # relative change of the result at which an iteration ends
STALLED = 1e-9  # what is accepted when rounding keeps it from settling further


@dataclass(frozen=True)
class Solution:
    """Parameters (p,), their covariance (p, p), residuals in units of their sigma (n,), chi-square and n - p."""

    parameters: Floats
    covariance: Floats
    whitened: Floats
    chi2: float
    dof: int

    @property
    def u(self) -> Floats:
        """Standard uncertainty of each parameter, shape (p,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class Polynomial:
    """y = Σ c_k x^powers[k]; coefficients (p,), covariance (p, p), chi-square and degrees of freedom of its fit."""

    powers: tuple[int, ...]
    coefficients: Floats
    covariance: Floats
    chi2: float
    dof: int

    def value(self, x: ArrayLike) -> Floats:
        """The polynomial at `x`, same shape as `x`."""
        return np.asarray(self._columns(x) @ self.coefficients, float)

    def slope(self, x: ArrayLike) -> Floats:
        """Its derivative at `x`, same shape as `x`."""
        return _derivative(np.asarray(x, float), self.powers, self.coefficients)

    def u(self, x: ArrayLike) -> Floats:
        """Standard uncertainty of `value(x)` from the coefficients alone, same shape as `x`."""
        columns = self._columns(x)
        return np.asarray(np.sqrt(np.einsum("...i,ij,...j->...", columns, self.covariance, columns)), float)

    def _columns(self, x: ArrayLike) -> Floats:
        return np.asarray(np.asarray(x, float)[..., None] ** np.array(self.powers), float)

    def scaled(self) -> Polynomial:
        """The same fit with its covariance taken from the scatter: multiplied by chi2/dof (unknown common sigma)."""
        return replace(self, covariance=self.covariance * _scatter(self.chi2, self.dof))


@dataclass(frozen=True)
class Line:
    """y = intercept + slope·x; `covariance` is that of (slope, intercept), shape (2, 2)."""

    slope: float
    intercept: float
    covariance: Floats
    chi2: float
    dof: int

    @property
    def u_slope(self) -> float:
        """Standard uncertainty of the slope."""
        return math.sqrt(self.covariance[0, 0])

    @property
    def u_intercept(self) -> float:
        """Standard uncertainty of the intercept."""
        return math.sqrt(self.covariance[1, 1])

    def value(self, x: ArrayLike) -> Floats:
        """The line at `x`, same shape as `x`."""
        return np.asarray(self.intercept + self.slope * np.asarray(x, float), float)

    def u(self, x: ArrayLike) -> Floats:
        """Standard uncertainty of `value(x)`, same shape as `x`."""
        at = np.asarray(x, float)
        (slope, shared), (_, intercept) = self.covariance
        return np.asarray(np.sqrt(intercept + 2 * shared * at + slope * at**2), float)

    def scaled(self) -> Line:
        """The same fit with its covariance taken from the scatter: multiplied by chi2/dof (unknown common sigma)."""
        return replace(self, covariance=self.covariance * _scatter(self.chi2, self.dof))

    def polynomial(self) -> Polynomial:
        """The line as a polynomial with powers 0 and 1."""
        return Polynomial(
            (0, 1), np.array([self.intercept, self.slope]), self.covariance[::-1, ::-1], self.chi2, self.dof
        )


def fit_line(
    x: ArrayLike, y: ArrayLike, u_x: ArrayLike = 0.0, u_y: ArrayLike = 0.0, correlation: ArrayLike = 0.0
) -> Line:
    """Best straight line with errors in both variables (York et al. 2004, eqs 13a–13c).

    `x`, `y` have shape (n,); `u_x`, `u_y` (standard uncertainties, in the units of x and y) and `correlation` (of the
    two errors of one point) are numbers or (n,). With u_x = 0 it is weighted least squares exactly. The covariance is
    evaluated at the adjusted points. Points must be independent of each other; otherwise use `fit_polynomial` or `gls`.
    Raises BadInput for fewer than two different x, for points without any uncertainty, or when there is no best slope.
    """
    x, y = _points(x, y)
    points = _Points(x, y, _sigmas(u_x, x, "u_x"), _sigmas(u_y, x, "u_y"), _correlations(correlation, x))
    if np.ptp(x) == 0:
        raise BadInput(f"line: found {x.size} points at x = {x[0]:g}, wanted at least two different x")
    slope = points.settled_slope()
    weight, x_mean, y_mean, beta = points.adjusted(slope)
    adjusted = x_mean + beta
    centre = float(np.average(adjusted, weights=weight))
    var_slope = 1 / float(weight @ (adjusted - centre) ** 2)
    shared = -centre * var_slope
    covariance = np.array([[var_slope, shared], [shared, 1 / float(weight.sum()) + centre**2 * var_slope]])
    residual = y - y_mean - slope * (x - x_mean)
    return Line(slope, y_mean - slope * x_mean, covariance, float(weight @ residual**2), x.size - 2)


@dataclass(frozen=True)
class _Points:
    """Points with the uncertainty of each coordinate; the symbols are York's."""

    x: Floats
    y: Floats
    u_x: Floats
    u_y: Floats
    r: Floats

    def adjusted(self, b: float) -> tuple[Floats, float, float, Floats]:
        """Weights W, means x̄ and ȳ, and β, the adjusted x less x̄, for the slope `b`."""
        cross = self.r * self.u_x * self.u_y
        variance = self.u_y**2 + b**2 * self.u_x**2 - 2 * b * cross
        if not np.all(variance > 0):
            raise BadInput("line: found points with u_x = u_y = 0, wanted an uncertainty for each")
        weight = 1 / variance
        x_mean, y_mean = float(np.average(self.x, weights=weight)), float(np.average(self.y, weights=weight))
        dx, dy = self.x - x_mean, self.y - y_mean
        beta = weight * (dx * self.u_y**2 + b * dy * self.u_x**2 - (b * dx + dy) * cross)
        return weight, x_mean, y_mean, beta

    def next_slope(self, b: float) -> float:
        """York's eq. 13b."""
        weight, x_mean, y_mean, beta = self.adjusted(b)
        below = float(weight * beta @ (self.x - x_mean))
        if below == 0:
            raise BadInput("line: found points with one common adjusted x, wanted a spread of x above its uncertainty")
        return float(weight * beta @ (self.y - y_mean)) / below

    def settled_slope(self) -> float:
        """The slope at which eq. 13b returns what it was given, from the slope of ordinary least squares."""
        dx = self.x - self.x.mean()
        slope, change = float(dx @ (self.y - self.y.mean())) / float(dx @ dx), math.inf
        for _ in range(ITERATIONS):
            following = self.next_slope(slope)
            change = abs(following - slope) / max(abs(following), np.finfo(float).tiny)
            slope = following
            if change <= SETTLED:
                break
        if change > STALLED:
            raise BadInput("line: found no best slope, wanted points whose spread is well above their uncertainties")
        return slope


def fit_polynomial(
    x: ArrayLike,
    y: ArrayLike,
    order: int | Sequence[int],
    u_x: ArrayLike = 0.0,
    u_y: ArrayLike = 0.0,
    covariance: ArrayLike | None = None,
) -> Polynomial:
    """Polynomial with errors in both variables; `order` is the degree, or the powers to use such as (1, 3).

    `x`, `y` (n,); `u_x`, `u_y` numbers or (n,). `covariance`, (n, n), is the full covariance of y and replaces u_y.
    Each x is adjusted along with the coefficients (generalised distance regression, ISO/TS 28037 clause 10): leaving
    the x where they were read would bias the slope however they are weighted. A bias ½·y''·u_x² of the curvature
    remains, far below u_y for a nearly straight sensor. Raises BadInput as `gls` does, and when it does not settle.
    """
    x, y = _points(x, y)
    powers = _powers(order)
    sigma_x = _sigmas(u_x, x, "u_x")
    noise = _sigmas(u_y, x, "u_y") ** 2 if covariance is None else np.asarray(covariance, float)
    if covariance is None and not np.all(noise + sigma_x**2 > 0):
        raise BadInput("polynomial: found points with u_x = u_y = 0, wanted an uncertainty for each")
    names = [f"x^{power}" for power in powers]
    adjusted, coefficients = x, _start(x, y, powers, noise if covariance is None else np.diag(noise), names)
    for _ in range(ITERATIONS):
        tangent = _derivative(adjusted, powers, coefficients)
        total = _with_variance(noise, (tangent * sigma_x) ** 2)
        moved = y - tangent * (x - adjusted)
        solution = gls(_design(adjusted, powers), moved, total, names)
        change = _change(solution.parameters, coefficients, solution.u)
        coefficients = solution.parameters
        if not np.any(sigma_x) or change < 1e-10:
            return Polynomial(powers, coefficients, solution.covariance, solution.chi2, solution.dof)
        left = moved - _design(adjusted, powers) @ coefficients
        adjusted = x + sigma_x**2 * tangent * _solved(total, left)
    raise BadInput("polynomial: found no best curve, wanted points whose spread is well above their uncertainties")


def odd_even(line: Line | Polynomial) -> tuple[Polynomial, Polynomial]:
    """The odd and the even part of a calibration curve, each with its own block of the covariance.

    The odd part is what the sensor makes of the sign of its input (sensitivity, cubic); the even part is the offset
    and what rectifies a vibration. The two are correlated through the block that is left out here.
    """
    whole = line.polynomial() if isinstance(line, Line) else line
    return _part(whole, 1), _part(whole, 0)


def _part(whole: Polynomial, parity: int) -> Polynomial:
    keep = [index for index, power in enumerate(whole.powers) if power % 2 == parity]
    return Polynomial(
        tuple(whole.powers[index] for index in keep),
        whole.coefficients[keep],
        whole.covariance[np.ix_(keep, keep)],
        whole.chi2,
        whole.dof,
    )


def gls(design: ArrayLike, y: ArrayLike, covariance: ArrayLike, names: Sequence[str] | None = None) -> Solution:
    """Generalised least squares: y = design·parameters, errors of y with the given covariance (ISO/TS 28037 annex D).

    `design` (n, p), `y` (n,), `covariance` (n, n), or (n,) for the variances of independent errors. Whitened by
    Cholesky, columns brought to one length, solved by singular values with one step of refinement. Raises BadInput for
    fewer points than parameters, a covariance that is not positive definite, or columns of the design that cannot be
    told apart, naming them by `names` (their numbers otherwise).
    """
    matrix, values = np.asarray(design, float), np.asarray(y, float)
    _check_design(matrix, values)
    white = _whitened(np.column_stack([matrix, values]), np.asarray(covariance, float))
    return _solve(white[:, :-1], white[:, -1], [str(n) for n in range(matrix.shape[1])] if names is None else names)


def _solve(white: Floats, target: Floats, names: Sequence[str]) -> Solution:
    length = np.linalg.norm(white, axis=0)
    scale = np.where(length > 0, length, 1.0)
    left, size, right = np.linalg.svd(white / scale, full_matrices=False)
    _refuse_alike(size, right, names, len(white))
    inverse = (right.T / size) @ left.T
    parameters = inverse @ target
    parameters += inverse @ (target - (white / scale) @ parameters)
    residual = target - (white / scale) @ parameters
    covariance = (right.T / size**2) @ right / np.outer(scale, scale)
    return Solution(
        parameters / scale, covariance, residual, float(residual @ residual), white.shape[0] - white.shape[1]
    )


def _refuse_alike(size: Floats, right: Floats, names: Sequence[str], rows: int) -> None:
    weak = size <= size[0] * max(rows, len(names)) * 8 * np.finfo(float).eps
    if not np.any(weak):
        return
    part = np.max(np.abs(right[weak]), axis=0)
    columns = ", ".join(name for name, amount in zip(names, part, strict=True) if amount > 1e-3 * part.max())
    raise BadInput(f"least squares: found columns that cannot be told apart: {columns}; wanted data that separate them")


def _check_design(matrix: Floats, values: Floats) -> None:
    if matrix.ndim != 2 or values.shape != (len(matrix),):
        raise BadInput(f"least squares: found shapes {matrix.shape} and {values.shape}, wanted (n, p) and (n,)")
    if matrix.shape[0] < matrix.shape[1] or matrix.shape[1] == 0:
        raise BadInput(f"least squares: found {len(matrix)} points for {matrix.shape[1]} parameters, wanted as many")
    if not (np.all(np.isfinite(matrix)) and np.all(np.isfinite(values))):
        raise BadInput("least squares: found numbers that are not finite, wanted finite ones")


def _whitened(columns: Floats, covariance: Floats) -> Floats:
    """Columns divided by the Cholesky factor of the covariance, so that their errors are independent with sigma 1."""
    if covariance.shape == (len(columns),):
        if not (np.all(np.isfinite(covariance)) and np.all(covariance > 0)):
            raise BadInput("least squares: found a variance that is not above 0, wanted all above 0")
        return np.asarray(columns / np.sqrt(covariance)[:, None], float)
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(_cholesky(covariance, len(columns)), columns, lower=True), float)


def _cholesky(covariance: Floats, size: int) -> Floats:
    from scipy.linalg import LinAlgError, cholesky

    if covariance.shape != (size, size) or not np.all(np.isfinite(covariance)):
        raise BadInput(f"least squares: found a covariance of shape {covariance.shape}, wanted {(size, size)}, finite")
    scale = float(np.max(np.abs(covariance)))
    if not np.allclose(covariance, covariance.T, rtol=0, atol=1e-10 * scale):
        raise BadInput("least squares: found a covariance that is not symmetric, wanted a symmetric one")
    try:
        return np.asarray(cholesky(covariance, lower=True), float)
    except LinAlgError as error:
        raise BadInput("least squares: found a covariance that is not positive definite, wanted one that is") from error


def _solved(covariance: Floats, right: Floats) -> Floats:
    """covariance⁻¹·right for variances (n,) or a matrix (n, n)."""
    if covariance.ndim == 1:
        return np.asarray(right / covariance, float)
    from scipy.linalg import cho_solve

    return np.asarray(cho_solve((_cholesky(covariance, len(right)), True), right), float)


def _with_variance(noise: Floats, variance: Floats) -> Floats:
    return noise + variance if noise.ndim == 1 else noise + np.diag(variance)


def _start(x: Floats, y: Floats, powers: tuple[int, ...], variance: Floats, names: Sequence[str]) -> Floats:
    """Coefficients with the x taken as exact; weights only where every point has one."""
    weighted = np.all(variance > 0)
    return gls(_design(x, powers), y, variance if weighted else np.ones(x.size), names).parameters


def _change(new: Floats, old: Floats, u: Floats) -> float:
    return float(np.max(np.abs(new - old) / u))


def _design(x: Floats, powers: tuple[int, ...]) -> Floats:
    return np.asarray(x[:, None] ** np.array(powers), float)


def _derivative(x: Floats, powers: tuple[int, ...], coefficients: Floats) -> Floats:
    terms = [c * power * x ** (power - 1) for c, power in zip(coefficients, powers, strict=True) if power > 0]
    return np.asarray(np.sum(terms, axis=0) if terms else np.zeros_like(x), float)


def _powers(order: int | Sequence[int]) -> tuple[int, ...]:
    powers = tuple(range(order + 1)) if isinstance(order, int) else tuple(order)
    if not powers or min(powers) < 0 or len(set(powers)) != len(powers):
        raise BadInput(f"polynomial: found the powers {powers}, wanted different whole numbers, none below 0")
    return powers


def _points(x: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    xs, ys = np.asarray(x, float), np.asarray(y, float)
    if xs.ndim != 1 or xs.shape != ys.shape or xs.size < 2:
        raise BadInput(f"points: found shapes {xs.shape} and {ys.shape}, wanted (n,) twice with n at least 2")
    if not (np.all(np.isfinite(xs)) and np.all(np.isfinite(ys))):
        raise BadInput("points: found numbers that are not finite, wanted finite ones")
    return xs, ys


def _sigmas(u: ArrayLike, like: Floats, name: str) -> Floats:
    values = np.asarray(u, float)
    if values.shape not in ((), like.shape):
        raise BadInput(f"{name}: found the shape {values.shape}, wanted a number or {like.shape}")
    if not (np.all(np.isfinite(values)) and np.all(values >= 0)):
        raise BadInput(f"{name}: found a value that is negative or not finite, wanted standard uncertainties")
    return np.broadcast_to(values, like.shape)


def _correlations(r: ArrayLike, like: Floats) -> Floats:
    values = np.asarray(r, float)
    if values.shape not in ((), like.shape) or not np.all(np.abs(values) < 1):
        raise BadInput("correlation: found a wrong shape or a value beyond ±1, wanted one, or one per point")
    return np.broadcast_to(values, like.shape)


def _scatter(chi2: float, dof: int) -> float:
    if dof < 1:
        raise BadInput(f"scatter: found {dof} degrees of freedom, wanted at least 1 to take sigma from the scatter")
    return chi2 / dof
