"""Two calibrations side by side: the same unit a year apart, or unit against unit, by normalised errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from rig.estimate.budget import coverage_factor
from rig.estimate.calibration import PROBABILITY, Calibration, Result, text


@dataclass(frozen=True)
class Compared:
    """One measurand of both: values as text and in SI, the normalised error En, and whether they agree."""

    key: str
    first: str
    second: str
    difference: float
    expanded: float
    unit: str
    en: float

    @property
    def agrees(self) -> bool:
        return abs(self.en) <= 1.0

    @property
    def words(self) -> str:
        return "agrees" if self.agrees else "differs by more than its uncertainty"

    def as_json(self) -> dict[str, Any]:
        """SI."""
        return {
            "key": self.key, "difference": self.difference, "expanded": self.expanded, "unit": self.unit,
            "en": self.en, "agrees": self.agrees,
        }  # fmt: skip


def compare(first: Calibration, second: Calibration) -> list[Compared]:
    """Every measurand that both determined, in the order of the first (ISO/IEC 17043, ISO 13528)."""
    theirs = {r.key: r for r in second.results if r.determined}
    return [_compared(r, theirs[r.key]) for r in first.results if r.determined and r.key in theirs]


def _compared(one: Result, other: Result) -> Compared:
    difference = (other.value or 0.0) - (one.value or 0.0)
    u = u_difference(one, other)
    k = coverage_factor(min(one.dof, other.dof), PROBABILITY)
    en = difference / (k * u) if u > 0.0 else math.copysign(math.inf, difference) if difference else 0.0
    return Compared(one.key, text(one), text(other), difference, k * u, one.unit, en)


def u_difference(one: Result, other: Result) -> float:
    """Standard uncertainty of the difference: type B inputs of one name and source are the same error in both.

    An origin that is not named (no source) is taken as independent.
    """
    mine = {(c.name, c.source): c.sensitivity * c.u for c in one.contributions if c.kind == "B" and c.source}
    theirs = {(c.name, c.source): c.sensitivity * c.u for c in other.contributions if c.kind == "B" and c.source}
    common = sum(mine[o] * theirs[o] for o in mine.keys() & theirs.keys())
    return math.sqrt(max(one.u**2 + other.u**2 - 2.0 * common, 0.0))
