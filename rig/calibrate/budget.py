"""The uncertainty budget: what each influence contributes, how they combine, and whether the combination is right.

    budget = Budget((
        Contribution("vibrometer gain", "B", "normal", 0.005, "1", sensitivity, source="certificate 1234"),
        Contribution("repeatability", "A", "t", 2e-4, "V·s²/m", 1.0, dof=9),
    ))
    budget.u, budget.dof, budget.expanded(0.95), budget.shares()

`propagate` carries a covariance through any function to first order (GUM 5.1, 5.2); `monte_carlo` carries whole
distributions through it (GUM Supplement 1), and `validated` tells whether the first may stand in for the second.
GUM: JCGM 100:2008. GUM Supplement 1: JCGM 101:2008.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.errors import BadInput

Floats = NDArray[np.float64]
Distribution = Literal["normal", "rectangular", "triangular", "arcsine", "t"]

DIVISORS: Mapping[str, float] = {"rectangular": math.sqrt(3), "triangular": math.sqrt(6), "arcsine": math.sqrt(2)}
CHUNK_VALUES = 2_000_000  # 16 MB of drawn inputs at a time
CHUNK_DRAWS = 100_000


def half_width(a: float, distribution: Distribution) -> float:
    """Standard uncertainty of a quantity known to lie within ±a (GUM 4.3.7, 4.3.9).

    Rectangular a/√3, triangular a/√6, arcsine (a sinusoid of amplitude a, met at an unknown phase) a/√2.
    Raises BadInput for a distribution without limits.
    """
    if distribution not in DIVISORS:
        raise BadInput(f"half-width: found {distribution!r}, wanted {', '.join(DIVISORS)}")
    _not_negative(a, "half-width")
    return a / DIVISORS[distribution]


def from_expanded(U: float, k: float) -> float:  # noqa: N803 - U is the expanded uncertainty everywhere
    """Standard uncertainty from a certificate's expanded uncertainty and its coverage factor (GUM 4.3.3)."""
    _not_negative(U, "expanded uncertainty")
    if not (math.isfinite(k) and k > 0):
        raise BadInput(f"coverage factor: found {k}, wanted a number above 0")
    return U / k


@dataclass(frozen=True)
class Contribution:
    """One line of the budget; the sensitivity is ∂y/∂x, unit of the measurand per unit of the input.

    `u` is the standard uncertainty of the input in `unit`. `dof` is infinite for a Type B value taken as exactly known.
    Raises BadInput for a negative or infinite `u`, a `dof` of zero or below, an unknown kind or distribution.
    """

    name: str
    kind: Literal["A", "B"]
    distribution: Distribution
    u: float
    unit: str
    sensitivity: float
    dof: float = math.inf
    source: str = ""

    def __post_init__(self) -> None:
        _not_negative(self.u, f"{self.name}: standard uncertainty")
        _degrees(self.dof, self.name)
        _known(self.distribution, self.name)
        if not math.isfinite(self.sensitivity):
            raise BadInput(f"{self.name}: found the sensitivity {self.sensitivity}, wanted a finite number")
        if self.kind not in ("A", "B"):
            raise BadInput(f"{self.name}: found the type {self.kind!r}, wanted 'A' or 'B'")

    @property
    def contribution(self) -> float:
        """|c|·u, in the measurand's unit (GUM eq. 11b)."""
        return abs(self.sensitivity) * self.u


@dataclass(frozen=True)
class Budget:
    """All contributions to one measurand, and the correlation coefficients between inputs that share a cause.

    `correlation[("gain", "range")]` is r between the two inputs; pairs that are not named are independent.
    Raises BadInput for a name twice, for a correlation with a name that is not in the budget, or for coefficients that
    no set of quantities can have (the matrix has a negative eigenvalue).
    """

    contributions: tuple[Contribution, ...]
    correlation: Mapping[tuple[str, str], float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = self.names
        if not names:
            raise BadInput("budget: found no contributions, wanted at least one")
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise BadInput(f"budget: found {', '.join(twice)} more than once, wanted each contribution once")
        for pair, r in self.correlation.items():
            self._check_pair(pair, r)
        _factor(self.correlations())

    def _check_pair(self, pair: tuple[str, str], r: float) -> None:
        first, second = pair
        if first == second or first not in self.names or second not in self.names:
            raise BadInput(f"budget: found a correlation between {first!r} and {second!r}, wanted two of its names")
        if not -1 <= r <= 1:
            raise BadInput(f"budget: found r = {r} between {first!r} and {second!r}, wanted -1 to 1")
        if self.correlation.get((second, first), r) != r:
            raise BadInput(f"budget: found two values of r between {first!r} and {second!r}, wanted one")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the contributions, in order."""
        return tuple(contribution.name for contribution in self.contributions)

    def correlations(self) -> Floats:
        """Correlation matrix of the inputs, shape (n, n)."""
        matrix = np.eye(len(self.contributions))
        place = {name: index for index, name in enumerate(self.names)}
        for (first, second), r in self.correlation.items():
            matrix[place[first], place[second]] = matrix[place[second], place[first]] = r
        return matrix

    def _variances(self) -> Floats:
        """c_i c_j u_i u_j r_ij, shape (n, n): the terms of GUM eq. 16."""
        signed = np.array([contribution.sensitivity * contribution.u for contribution in self.contributions])
        return np.outer(signed, signed) * self.correlations()

    @property
    def u(self) -> float:
        """Combined standard uncertainty in the measurand's unit (GUM eq. 10 and 16)."""
        # Fully correlated contributions may cancel to a rounding error below zero.
        return math.sqrt(max(float(self._variances().sum()), 0.0))

    @property
    def dof(self) -> float:
        """Effective degrees of freedom (Welch–Satterthwaite, GUM eq. G.2b).

        The formula holds for independent contributions. Contributions tied by a correlation therefore count as one,
        with the variance of their sum and the smallest degrees of freedom among them: exact when they come from one
        set of simultaneous observations (GUM H.2), on the safe side otherwise.
        """
        terms = self._variances()
        total = float(terms.sum())
        weight = 0.0
        for group in _groups(self.correlations()):
            fewest = min(self.contributions[index].dof for index in group)
            weight += float(terms[np.ix_(group, group)].sum()) ** 2 / fewest
        return total**2 / weight if weight > 0 else math.inf

    def coverage_factor(self, p: float = 0.95) -> float:
        """Student's t for the effective degrees of freedom truncated to an integer (GUM G.4.1, Table G.2)."""
        return coverage_factor(self.dof, p)

    def expanded(self, p: float = 0.95) -> float:
        """Expanded uncertainty with coverage probability `p`, in the measurand's unit (GUM eq. 18)."""
        return self.coverage_factor(p) * self.u

    def shares(self) -> dict[str, float]:
        """Share of each contribution in the variance; they sum to 1, or are all 0 when the variance is.

        A covariance between two contributions is split in halves, so a share may be negative: that input helps.
        """
        terms = self._variances()
        total = float(terms.sum())
        parts = terms.sum(axis=1) / total if total > 0 else np.zeros(len(terms))
        return dict(zip(self.names, (float(part) for part in parts), strict=True))


def coverage_factor(dof: float, p: float = 0.95) -> float:
    """Two-sided Student's t quantile for `dof` truncated to an integer; 1.959964 for p = 0.95 and infinite `dof`.

    Degrees of freedom below 1 count as 1 (GUM G.4.1 gives no lower value). Raises BadInput for p outside 0…1.
    """
    from scipy.special import ndtri, stdtrit

    _degrees(dof, "coverage factor")
    if not 0 < p < 1:
        raise BadInput(f"coverage probability: found {p}, wanted a number between 0 and 1")
    upper = 0.5 * (1 + p)
    if math.isinf(dof):
        return float(ndtri(upper))
    # 15.999999999 is 16 that went through a division.
    whole = max(math.floor(dof * (1 + 1e-12)), 1)
    return float(stdtrit(whole, upper))


def propagate(
    function: Callable[[Floats], ArrayLike],
    values: ArrayLike,
    covariance: ArrayLike,
    jacobian: ArrayLike | None = None,
) -> tuple[Floats, Floats]:
    """First-order propagation through `function`: y shape (m,) and its covariance J U_x Jᵀ, shape (m, m).

    `values` has shape (n,), `covariance` (n, n); `function` takes (n,) and returns (m,) or a number.
    `jacobian`, shape (m, n), is used when given; otherwise it is formed by central differences of fourth order.
    Raises BadInput for wrong shapes, a covariance that is none, or a function that is not finite near the values.
    GUM eq. 13, JCGM 102:2011 6.2.
    """
    at, matrix = _checked(values, covariance)
    y = _outputs(function, at)
    slopes = derivatives(function, at, np.sqrt(np.diag(matrix))) if jacobian is None else np.asarray(jacobian, float)
    if slopes.shape != (y.size, at.size):
        raise BadInput(f"jacobian: found the shape {slopes.shape}, wanted {(y.size, at.size)}")
    result = slopes @ matrix @ slopes.T
    return y, 0.5 * (result + result.T)


def derivatives(function: Callable[[Floats], ArrayLike], values: ArrayLike, u: ArrayLike) -> Floats:
    """Jacobian ∂y/∂x, shape (m, n), by the five-point central formula; `u` (n,) gives the scale of each input.

    The step is one standard uncertainty where that is neither lost in rounding nor coarse beside the value.
    """
    at = np.asarray(values, float)
    columns = [_slope(function, at, index, step) for index, step in enumerate(_steps(at, np.asarray(u, float)))]
    return np.stack(columns, axis=1)


def _slope(function: Callable[[Floats], ArrayLike], at: Floats, index: int, step: float) -> Floats:
    def moved(count: int) -> Floats:
        there = at.copy()
        there[index] += count * step
        return _outputs(function, there)

    return np.asarray((8 * (moved(1) - moved(-1)) - (moved(2) - moved(-2))) / (12 * step), float)


def _steps(at: Floats, u: Floats) -> Floats:
    eps = np.finfo(float).eps
    scale = np.maximum(np.abs(at), u)
    scale = np.where(scale > 0, scale, 1.0)
    steps = np.clip(u, eps ** (1 / 3) * scale, eps**0.2 * scale)
    # A power of two is added and taken away without rounding as far as the value's digits allow.
    return np.asarray(2.0 ** np.round(np.log2(steps)), float)


def _outputs(function: Callable[[Floats], ArrayLike], at: Floats) -> Floats:
    y = np.atleast_1d(np.asarray(function(at), float))
    if y.ndim != 1 or not np.all(np.isfinite(y)):
        raise BadInput(f"propagate: found {y.tolist()} at {at.tolist()}, wanted finite numbers in one dimension")
    return y


@dataclass(frozen=True)
class Draw:
    """One input of a Monte Carlo calculation: its distribution around `value` with standard uncertainty `u`.

    "t" is value + u·t with `dof` degrees of freedom, as for a mean of dof + 1 readings (JCGM 101 6.4.9); the others
    have the standard deviation `u` and do not use `dof`.
    """

    value: float
    u: float
    distribution: Distribution = "normal"
    dof: float = math.inf

    def __post_init__(self) -> None:
        _not_negative(self.u, "draw: standard uncertainty")
        _degrees(self.dof, "draw")
        _known(self.distribution, "draw")
        if not math.isfinite(self.value):
            raise BadInput(f"draw: found the value {self.value}, wanted a finite number")


@dataclass(frozen=True)
class MonteCarlo:
    """Result of a Monte Carlo calculation, all in the measurand's unit.

    `low` and `high` leave equal probability on both sides; `shortest` is the shortest interval of that probability.
    """

    mean: float
    u: float
    low: float
    high: float
    shortest: tuple[float, float]
    probability: float
    draws: int


def monte_carlo(
    function: Callable[[Floats], Floats],
    inputs: Sequence[Draw],
    *,
    draws: int = 1_000_000,
    seed: int = 20080901,
    probability: float = 0.95,
    correlation: ArrayLike | None = None,
) -> MonteCarlo:
    """Propagation of distributions (JCGM 101:2008 clause 7).

    `function` takes the inputs as (n, k) – one row per input, k draws – and returns (k,). `correlation`, shape (n, n),
    ties normal inputs. Inputs are drawn in pieces, so a million draws take well under 100 MB whatever n is.
    Raises BadInput for fewer than 10/(1 - probability) draws, a correlation with an input that is not normal, or
    results that are not finite.
    """
    if not inputs:
        raise BadInput("monte carlo: found no inputs, wanted at least one")
    if not 0 < probability < 1 or draws * (1 - probability) < 10:
        raise BadInput(f"monte carlo: found {draws} draws for p = {probability}, wanted at least 10/(1 - p), 0 < p < 1")
    y = np.empty(draws)
    start = 0
    for sample in _samples(inputs, draws, np.random.default_rng(seed), _input_factor(inputs, correlation)):
        stop = start + sample.shape[1]
        y[start:stop] = function(sample)
        start = stop
    if not np.all(np.isfinite(y)):
        raise BadInput("monte carlo: found infinite results, wanted a function defined for all inputs")
    return _summary(y, probability)


def _samples(inputs: Sequence[Draw], draws: int, rng: np.random.Generator, factor: Floats | None) -> Iterator[Floats]:
    piece = min(max(CHUNK_VALUES // len(inputs), 1000), CHUNK_DRAWS)
    for start in range(0, draws, piece):
        size = min(piece, draws - start)
        sample = np.stack([_standard(draw, size, rng) for draw in inputs])
        if factor is not None:
            tied = [index for index, draw in enumerate(inputs) if draw.distribution == "normal"]
            sample[tied] = factor[np.ix_(tied, tied)] @ sample[tied]
        sample *= np.array([[draw.u] for draw in inputs])
        sample += np.array([[draw.value] for draw in inputs])
        yield sample


def _standard(draw: Draw, size: int, rng: np.random.Generator) -> Floats:
    """Draws with value 0 and u 1 (JCGM 101 6.4)."""
    if draw.distribution == "rectangular":
        return rng.uniform(-1.0, 1.0, size) * DIVISORS["rectangular"]
    if draw.distribution == "triangular":
        return rng.triangular(-1.0, 0.0, 1.0, size) * DIVISORS["triangular"]
    if draw.distribution == "arcsine":
        return np.sin(rng.uniform(0.0, 2 * math.pi, size)) * DIVISORS["arcsine"]
    if draw.distribution == "t" and math.isfinite(draw.dof):
        return rng.standard_t(draw.dof, size)
    return rng.standard_normal(size)


def _input_factor(inputs: Sequence[Draw], correlation: ArrayLike | None) -> Floats | None:
    if correlation is None:
        return None
    matrix = np.asarray(correlation, float)
    if matrix.shape != (len(inputs), len(inputs)) or not np.array_equal(np.diag(matrix), np.ones(len(inputs))):
        raise BadInput(f"monte carlo: found a correlation of shape {matrix.shape}, wanted (n, n), ones on the diagonal")
    for index, draw in enumerate(inputs):
        if draw.distribution != "normal" and np.count_nonzero(matrix[index]) > 1:
            raise BadInput(f"monte carlo: found input {index} ({draw.distribution}) correlated, wanted normal ones")
    return _factor(matrix)


def _summary(y: Floats, probability: float) -> MonteCarlo:
    """Mean, standard deviation and both coverage intervals (JCGM 101 7.6, 7.7); sorts `y` in place."""
    mean, u = float(y.mean()), float(y.std(ddof=1))
    y.sort()
    inside = round(probability * y.size)
    left = (y.size - inside) // 2
    width = y[inside:] - y[: y.size - inside]
    best = int(np.argmin(width))
    return MonteCarlo(
        mean=mean,
        u=u,
        low=float(y[left]),
        high=float(y[left + inside]),
        shortest=(float(y[best]), float(y[best + inside])),
        probability=probability,
        draws=int(y.size),
    )


def tolerance(u: float, digits: int = 2) -> float:
    """Numerical tolerance δ: half a unit of the last of `digits` significant digits of `u` (JCGM 101 7.9.2)."""
    if not (math.isfinite(u) and u > 0) or digits < 1:
        raise BadInput(f"tolerance: found u = {u} with {digits} digits, wanted u above 0 and at least one digit")
    exponent = int(f"{u:.{digits - 1}e}".split("e")[1])
    return float(0.5 * 10.0 ** (exponent - digits + 1))


def validated(budget: Budget, y: float, monte_carlo: MonteCarlo, digits: int = 2) -> bool:
    """Whether the budget's interval y ± U agrees with the Monte Carlo one to `digits` digits of u (JCGM 101 clause 8).

    The probability is the Monte Carlo result's. Take so many draws that the end points repeat to a fifth of the
    tolerance (JCGM 101 8.2); near it, a million may not be enough.
    """
    expanded = budget.expanded(monte_carlo.probability)
    delta = tolerance(budget.u, digits)
    return abs(y - expanded - monte_carlo.low) <= delta and abs(y + expanded - monte_carlo.high) <= delta


def _groups(correlations: Floats) -> list[list[int]]:
    """Indices tied to each other, directly or through others."""
    left = set(range(len(correlations)))
    groups: list[list[int]] = []
    while left:
        group, fresh = set(), {min(left)}
        while fresh:
            group |= fresh
            fresh = {int(j) for i in fresh for j in np.flatnonzero(correlations[i])} - group
        groups.append(sorted(group))
        left -= group
    return groups


def _factor(matrix: Floats) -> Floats:
    """F with F Fᵀ = matrix, singular ones included; raises BadInput for a matrix that no quantities can have."""
    values, vectors = np.linalg.eigh(matrix)
    if not np.allclose(matrix, matrix.T, rtol=0, atol=1e-12) or values.min() < -1e-9 * max(values.max(), 1.0):
        raise BadInput(
            f"correlation: found a matrix with the eigenvalue {values.min():.3g}, wanted symmetry and none below 0"
        )
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)), float)


def _checked(values: ArrayLike, covariance: ArrayLike) -> tuple[Floats, Floats]:
    at, matrix = np.asarray(values, float), np.asarray(covariance, float)
    if at.ndim != 1 or matrix.shape != (at.size, at.size):
        raise BadInput(f"propagate: found shapes {at.shape} and {matrix.shape}, wanted (n,) and (n, n)")
    if not np.all(np.isfinite(matrix)) or np.any(np.diag(matrix) < 0):
        raise BadInput("propagate: found a covariance with infinite entries or negative variances, wanted neither")
    u = np.sqrt(np.diag(matrix))
    scale = np.outer(np.where(u > 0, u, 1.0), np.where(u > 0, u, 1.0))
    _factor(matrix / scale)
    return at, matrix


def _not_negative(value: float, where: str) -> None:
    if not (math.isfinite(value) and value >= 0):
        raise BadInput(f"{where}: found {value}, wanted a finite number, not negative")


def _degrees(dof: Any, where: str) -> None:
    if not dof > 0:
        raise BadInput(f"{where}: found {dof} degrees of freedom, wanted more than 0")


def _known(distribution: str, where: str) -> None:
    if distribution not in get_args(Distribution):
        raise BadInput(f"{where}: found the distribution {distribution!r}, wanted {', '.join(get_args(Distribution))}")
