"""Whether an answer holds when what is compared of a sampled reference reaches twice as far.

A reference that was sampled carries noise, and the columns of a delay, a lag or an average are made of it: beyond the
motion they explain the reference's own noise. What is there changes no more than by the noise of the rows that came in,
|p − p₂| ≤ 3·√|u² − u₂²| (Hausman 1978, Econometrica 46, 1251); what is not goes with the band.
"""

from __future__ import annotations

import math

from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.fit.parameters import Estimate, covariance_of, estimates
from rig.model import Quantity, Term

FAR = 3.0  # standard deviations of the difference
LEAST = 0.5  # of a variance: twice the band has other instants, stretches and weights too, not only more rows


Known = tuple[str, Quantity | None, tuple[str, ...]]


def dependent(evidence: Evidence, final: Fit) -> frozenset[Known]:
    """Name, quantity and channels of the effects of a final fit whose parameters change with the band.

    Empty where no band can be doubled.
    """
    terms = [term for term in final.state.terms if not term.prior]
    further = evidence.further() if any(not term.effect.looks_in for term in terms) else None
    if further is None:
        return frozenset()
    wide = further.fitted(terms, poles=final.state.poles, shared=final.state.shared)
    here, there = _known(final), _known(wide)
    return frozenset(key for key, found in here.items() if key in there and _differ(found, there[key]))


def _known(fit: Fit) -> dict[Known, dict[str, Estimate]]:
    """Parameters of every effect that rows determine."""
    terms = enumerate(fit.state.terms)
    return {
        (term.effect.name, term.on, term.only): estimates(term, covariance_of(fit, n))
        for n, term in terms if _of_rows(term)
    }  # fmt: skip


def _of_rows(term: Term) -> bool:
    return not term.prior and not term.effect.looks_in


def _differ(found: dict[str, Estimate], wide: dict[str, Estimate]) -> bool:
    return any(_far(one, wide[name]) for name, one in found.items())


def _far(one: Estimate, wide: Estimate) -> bool:
    if one.u is None or wide.u is None or not math.isfinite(one.value - wide.value):
        return True
    apart = one.value - wide.value
    if one.unit == "rad":  # the far side of a full turn is near
        apart = math.remainder(apart, 2.0 * math.pi)
    return abs(apart) > FAR * math.sqrt(max(abs(one.u**2 - wide.u**2), LEAST * one.u**2))
