"""Two calibrations side by side: the same unit a year apart, or unit against unit, by normalised errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from rig.calibrate.allowances import SHEET
from rig.calibrate.budget import Contribution
from rig.calibrate.calibration import Calibration, Result, text
from rig.calibrate.verdict import agrees, normalised_error


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
        return agrees(self.en)

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
    same = first.serial == second.serial
    return [_compared(r, theirs[r.key], same) for r in first.results if r.determined and r.key in theirs]


def _compared(one: Result, other: Result, same_unit: bool) -> Compared:
    mine, theirs = float(one.value or 0.0), float(other.value or 0.0)
    r = correlation(one, other, same_unit=same_unit)
    en = normalised_error(theirs, other.expanded, mine, one.expanded, r)
    variance = one.expanded**2 + other.expanded**2 - 2.0 * r * one.expanded * other.expanded
    expanded = math.sqrt(max(variance, 0.0))
    return Compared(one.key, text(one), text(other), theirs - mine, expanded, one.unit, en)


def correlation(one: Result, other: Result, *, same_unit: bool = True) -> float:
    """Of two results: type B inputs of one name and source (a certificate, a run) are the same error in both.

    An origin that is not named (no source) is taken as independent; of two units, what a data sheet allows each.
    """
    mine, theirs = (
        {(c.name, c.source): c.sensitivity * c.u for c in found.contributions if _common(c, same_unit)}
        for found in (one, other)
    )
    common = sum(mine[origin] * theirs[origin] for origin in mine.keys() & theirs.keys())
    return max(-1.0, min(common / (one.u * other.u), 1.0)) if one.u and other.u else 0.0


def _common(line: Contribution, same_unit: bool) -> bool:
    """Whether the error of a line may be another result's too."""
    return line.kind == "B" and bool(line.source) and (same_unit or not line.source.startswith(SHEET))
