"""Tests of the instruments and of the metadata, before any physics of the sensor is blamed.

Each looks at something that the fit itself does not see: lines counted between index pulses, samples of the vibrometer
that stand out of their record, the driven frequency by the converter's clock, values that no data sheet allows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.model import Effect, Term
from rig.parts.part import by_kind

IMPLAUSIBLE = 6.0  # tolerances of a data sheet


@dataclass(frozen=True)
class Finding:
    """An effect that a test of its own sees: with its coordinates, u, the strength of the evidence as χ², and why."""

    term: Term
    u: Mapping[str, float]
    evidence: float
    because: str


def findings(evidence: Evidence, shelf: Mapping[str, Effect], there: set[str]) -> list[Finding]:
    """What the instruments' own tests find that is not in the model, strongest first."""
    signs = [one for kind, parts in by_kind(evidence.parts) for one in kind.signs(parts)]
    found = [
        Finding(term, one.u, one.evidence, one.because)
        for one in signs
        if one.effect in shelf and (term := Term(shelf[one.effect], one.on, one.at)).key not in there
    ]
    return sorted(found, key=lambda one: -one.evidence)


def implausible(found: Fit) -> list[str]:
    """Gains and poles that no data sheet allows: a wrong range, a wrong unit, a reversed sign; in words."""
    said = []
    tolerance = {n: float(t) for p in found.parts for n, t in zip(p.channels.names, p.channels.tolerance, strict=True)}
    for name, gain in found.state.gain.items():
        if gain < -1.0:
            said.append(f"{name}: sensitivity has the wrong sign ({1.0 + gain:+.3g} of the data sheet's)")
        elif abs(gain) > IMPLAUSIBLE * tolerance[name]:
            said.append(f"{name}: sensitivity is {1.0 + gain:.3g} of the data sheet's: a range or a unit is wrong")
    return said
