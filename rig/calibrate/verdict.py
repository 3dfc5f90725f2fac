"""Pass, fail or inconclusive: what a value and its expanded uncertainty say about a limit, or about another value."""

from __future__ import annotations

import math
from typing import Literal

from rig.errors import BadInput

Verdict = Literal["pass", "fail", "inconclusive"]


def verdict(value: float, expanded: float, low: float | None = None, high: float | None = None) -> Verdict:
    """Compare value ± expanded with the limits, guard band w = U on both sides of each limit.

    Pass when the whole interval lies within the limits, fail when all of it lies outside, else inconclusive.
    `low` or `high` may be missing: one-sided. All in one unit. Raises BadInput without any limit, for limits the wrong
    way round, or for numbers that cannot be compared. ISO 14253-1:2017, ILAC-G8:09/2019 4.2.3.
    """
    _check(value, expanded)
    lower, upper = _limits(low, high)
    if lower <= value - expanded and value + expanded <= upper:
        return "pass"
    if value + expanded < lower or value - expanded > upper:
        return "fail"
    return "inconclusive"


def normalised_error(x1: float, U1: float, x2: float, U2: float, correlation: float = 0.0) -> float:  # noqa: N803
    """En: the difference in units of its expanded uncertainty; |En| ≤ 1 agrees.

    `correlation` is that of the two results, for instance through a shared reference: it takes the shared part out of
    the uncertainty of the difference. Raises BadInput when the difference has no uncertainty.
    ISO/IEC 17043:2023 B.3, ISO 13528:2022 9.6.
    """
    _check(x1, U1)
    _check(x2, U2)
    if not -1 <= correlation <= 1:
        raise BadInput(f"normalised error: found the correlation {correlation}, wanted -1 to 1")
    variance = U1**2 + U2**2 - 2 * correlation * U1 * U2
    if variance <= 1e-15 * (U1**2 + U2**2):
        raise BadInput("normalised error: found a difference without uncertainty, wanted U1 or U2 above 0")
    return (x1 - x2) / math.sqrt(variance)


def agrees(error: float) -> bool:
    """Whether a normalised error says that two results agree."""
    return abs(error) <= 1


def _check(value: float, expanded: float) -> None:
    if not math.isfinite(value):
        raise BadInput(f"verdict: found the value {value}, wanted a finite number")
    if not (math.isfinite(expanded) and expanded >= 0):
        raise BadInput(f"verdict: found the expanded uncertainty {expanded}, wanted a finite number, not negative")


def _limits(low: float | None, high: float | None) -> tuple[float, float]:
    if low is None and high is None:
        raise BadInput("verdict: found no limit, wanted a lower one, an upper one or both")
    lower = -math.inf if low is None else low
    upper = math.inf if high is None else high
    if not lower < upper:
        raise BadInput(f"verdict: found the limits {lower} to {upper}, wanted the lower one first")
    return lower, upper
