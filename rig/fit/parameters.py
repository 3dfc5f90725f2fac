"""Parameters of an effect as a person reads them: value, unit, standard uncertainty, and whether the size is usual."""

from __future__ import annotations

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
    """The same from standard uncertainties that have nothing to do with each other, (k, k)."""
    return np.diag([u.get(name, 0.0) ** 2 for name in fitted(term)])


def estimates(term: Term, covariance: Array) -> dict[str, Estimate]:
    """All parameters, with standard uncertainties by linear propagation from those of the coordinates (k, k)."""
    names = [p.name for p in term.effect.parameters]
    unit = dict(zip(names, term.effect.units(term.on), strict=True))
    slopes = _slopes(term, np.sqrt(np.maximum(np.diag(covariance), 0.0)), unit)
    found = {}
    for name, value in term.effect.physical(term.at).items():
        variance = float(slopes[name] @ covariance @ slopes[name])
        known = math.isfinite(variance) and variance >= 0.0
        found[name] = Estimate(float(value), unit[name], math.sqrt(variance) if known else None)
    return found


def _slopes(term: Term, u: Array, unit: Mapping[str, str]) -> dict[str, Array]:
    """Derivatives of every parameter by the coordinates that a fit moves, {name: (k,)}."""
    found = {name: np.zeros(len(u)) for name in unit}
    steps = {c.name: c.step for c in term.effect.coordinates}
    for k, name in enumerate(fitted(term)):
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
