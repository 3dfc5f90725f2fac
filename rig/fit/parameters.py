"""Parameters of an effect as a person reads them: value, unit, standard uncertainty, and whether the size is usual."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rig import units
from rig.fit.fit import Fit, fitted
from rig.model import Parameter, Term
from rig.motion import Array
from rig.printed import DEGREE, SHOWN, G, rounded

PROBE = 1e-3  # of a standard uncertainty: a step over which parameters are straight
USUAL = 3.0  # factor beyond the usual sizes that is still plausible
COVERAGE = 2.0  # k
TIED = 0.95  # correlation of two parameters of which one is hardly known by itself
LOOSE = 3.0  # standard uncertainties: what is not as far from nought is not known by itself

# kinds of `rig.units` that suit themselves to the size
KINDS: Mapping[str, str] = {
    "Hz": "frequency", "s": "time", "m": "length", "rad": "angle", "V": "voltage", "m/s²": "acceleration",
    "rad/s": "rate", "1": "ratio",
}  # fmt: skip
# the rest: unit on paper, and how many of it make one SI unit
LABORATORY: Mapping[str, tuple[str, float]] = {
    **SHOWN,
    "1/(m/s²)²": ("%/g²", 1e2 * G**2),
    "1/K": ("%/K", 1e2),
    "m/s²/K": ("mg/K", 1e3 / G),
    "rad/s/K": ("(°/s)/K", 1.0 / DEGREE),
    "m/s²/√s": ("mg/√s", 1e3 / G),
    "rad/s/√s": ("(°/s)/√s", 1.0 / DEGREE),
    "(rad/s)/(m/s²)": ("(°/s)/g", G / DEGREE),
    "rad/m": ("°/mm", 1e-3 / DEGREE),
}


UNSEEN = 1e-15  # SI; a coordinate that nothing moves stays where it was, at zero


@dataclass(frozen=True)
class Estimate:
    """A number in its SI `unit` with its standard uncertainty; `u` is None where it has no finite value."""

    value: float
    unit: str
    u: float | None

    def as_json(self) -> dict[str, float | str | None]:
        """SI; null for a number that is not finite."""
        return {"value": self.value if math.isfinite(self.value) else None, "unit": self.unit, "u": self.u}

    @property
    def text(self) -> str:
        """`1.23 ± 0.04 ms`, in a laboratory's unit, with U for k = 2."""
        symbol, factor = _shown_in(self)
        if self.u is not None and self.u < UNSEEN and abs(self.value) < UNSEEN:
            return "not seen in this data"
        if self.u is None:
            return f"{self.value * factor:.4g} {symbol}".rstrip()
        number, expanded = rounded(self.value * factor, COVERAGE * self.u * factor)
        return f"{number} ± {expanded} {symbol}".rstrip()


def _shown_in(one: Estimate) -> tuple[str, float]:
    """Unit in which a number of this size is shown, and how many of it make one SI unit."""
    kind = KINDS.get(one.unit)
    if kind is None or not math.isfinite(one.value):
        return LABORATORY.get(one.unit, (one.unit, 1.0))
    largest = max(abs(one.value), one.u or 0.0)
    symbol = units.format_quantity(largest, kind).partition(" ")[2]
    return symbol, units.KINDS[kind].units[symbol].from_si(1.0)


def covariance_of(fit: Fit, number: int) -> Array:
    """Covariance of the coordinates of a fit's term that the fit moves, SI, (k, k)."""
    first = fit.layout.terms[number]
    here = slice(first, first + len(fitted(fit.state.terms[number])))
    return np.asarray(fit.covariance[here, here])


def independent(term: Term, u: Mapping[str, float]) -> Array:
    """The same of all coordinates from standard uncertainties that have nothing to do with each other, (k, k)."""
    return np.diag([u.get(one.name, 0.0) ** 2 for one in term.effect.coordinates])


def estimates(term: Term, covariance: Array) -> dict[str, Estimate]:
    """All parameters, with standard uncertainties by linear propagation from those of the coordinates.

    Their `covariance` (k, k) is of all of them, or of those that a fit moves.
    """
    names = [p.name for p in term.effect.parameters]
    unit = dict(zip(names, term.effect.units(term.on), strict=True))
    slopes = _slopes(term, np.sqrt(np.maximum(np.diag(covariance), 0.0)), unit)
    found = {}
    for name, value in term.effect.physical(term.at).items():
        variance = float(slopes[name] @ covariance @ slopes[name])
        known = math.isfinite(variance) and variance >= 0.0
        found[name] = Estimate(float(value), unit[name], math.sqrt(variance) if known else None)
    return found


@dataclass(frozen=True)
class Tied:
    """Two parameters that are not known apart, the correlation of their estimates, and what is known of them together:
    `what`, such as `shift/time_constant`, is `together`; '' and None where no simple power of one times the other is.
    """

    names: tuple[str, str]
    correlation: float
    what: str = ""
    together: Estimate | None = None

    def as_json(self) -> dict[str, object]:
        """Names, correlation, and the joint quantity, SI."""
        known = None if self.together is None else {"quantity": self.what, **self.together.as_json()}
        return {"parameters": list(self.names), "correlation": self.correlation, "together": known}

    @property
    def text(self) -> str:
        """In words, for both together."""
        said = f"{' and '.join(self.names)} are not known apart (correlation {self.correlation:.4f})"
        return f"{said}; together: {self.what} = {self.together.text}" if self.together is not None else said


def tied(term: Term, covariance: Array) -> Tied | None:
    """The two parameters that an estimate ties to each other, if one by itself could as well be nought.

    `covariance` of the coordinates that a fit moves, (k, k). What is known of two is the product of powers whose
    relative uncertainty is least.
    """
    found = estimates(term, covariance)
    slopes = _slopes(
        term, np.sqrt(np.maximum(np.diag(covariance), 0.0)), {name: one.unit for name, one in found.items()}
    )
    loose = [name for name, one in found.items() if one.u and math.isfinite(one.value)]
    pairs = [
        (_correlation(slopes[a], slopes[b], covariance), a, b)
        for a, b in itertools.combinations(loose, 2)
        if any((found[name].u or 0.0) * LOOSE > abs(found[name].value) for name in (a, b))
    ]
    rho, a, b = max(pairs, key=lambda pair: abs(pair[0]), default=(0.0, "", ""))
    if abs(rho) < TIED:
        return None
    what, together = _together((found[a], found[b]), (a, b), rho)
    return Tied((a, b), rho, what, together)


def _correlation(a: Array, b: Array, covariance: Array) -> float:
    size = float(a @ covariance @ a) * float(b @ covariance @ b)
    return float(np.clip(float(a @ covariance @ b) / math.sqrt(size), -1.0, 1.0)) if size > 0.0 else 0.0


def _together(both: tuple[Estimate, Estimate], names: tuple[str, str], rho: float) -> tuple[str, Estimate | None]:
    """The better known of a product and a quotient, if it is known at all."""
    one, other = both
    assert one.u is not None
    assert other.u is not None
    r, s = one.u / one.value, other.u / other.value  # with their signs
    power = 1.0 if r * s * rho < 0.0 else -1.0
    value = one.value * other.value**power
    relative = math.sqrt(max(r**2 + s**2 + 2.0 * power * rho * r * s, 0.0))
    if relative * LOOSE > 1.0:
        return "", None
    unit = f"{one.unit}·{other.unit}" if power > 0.0 else f"{_grouped(one.unit)}/{_grouped(other.unit)}"
    return f"{names[0]}{'·' if power > 0.0 else '/'}{names[1]}", Estimate(value, unit, abs(value) * relative)


def _grouped(unit: str) -> str:
    return f"({unit})" if "/" in unit or "·" in unit else unit


def _slopes(term: Term, u: Array, unit: Mapping[str, str]) -> dict[str, Array]:
    """Derivatives of every parameter by as many coordinates, {name: (k,)}: all, or those that a fit moves."""
    found = {name: np.zeros(len(u)) for name in unit}
    steps = {c.name: c.step for c in term.effect.coordinates}
    for k, name in enumerate(steps if len(u) == len(steps) else fitted(term)):
        step = PROBE * (float(u[k]) or steps[name])
        above, below = (term.effect.physical(term.moved(**{name: term.at[name] + s}).at) for s in (step, -step))
        for parameter, symbol in unit.items():
            change = above[parameter] - below[parameter]
            if symbol == "rad" and math.isfinite(change):  # the far side of a full turn is near
                change = math.remainder(change, 2.0 * math.pi)
            found[parameter][k] = change / (2.0 * step)
    return found


def plausible(term: Term) -> bool:
    """Whether every parameter is within its usual sizes, or outside by no more than the factor that is allowed."""
    values = term.effect.physical(term.at)
    return all(_usual(p, values[p.name]) for p in term.effect.parameters)


def _usual(parameter: Parameter, value: float) -> bool:
    low, high = parameter.typical
    if not (math.isfinite(low) and math.isfinite(high)):
        return math.isfinite(value)
    largest = USUAL * max(abs(low), abs(high))
    return (low / USUAL if low > 0.0 else 0.0) <= abs(value) <= largest
