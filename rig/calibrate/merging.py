"""Several values of one measurand: the best is kept, the others stand beside it, and what differs too much is said.

Values of imported records are ratios to what a manifest states. Where the file's numbers are volts a ratio is a
sensitivity in volts after all, the same measurand as the bench's own, and runs of either make one calibration.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from rig.calibrate.budget import Budget
from rig.calibrate.calibration import Calibration, Result, text
from rig.foreign.manifest import Column


def merged(results: Iterable[Result], beside: Iterable[Result] = ()) -> Iterator[Result]:
    """Of what several experiments determine the best, with the others beside it; those `beside` only if there is no
    other."""
    beside = list(beside)
    second = {id(one) for one in beside}
    groups: dict[str, list[Result]] = {}
    for result in (*results, *beside):
        groups.setdefault(result.key, []).append(result)
    for group in groups.values():
        best, *others = sorted(group, key=lambda one: (not one.determined, id(one) in second, one.u))
        there = [one for one in others if one.determined]
        said = tuple(f"{one.method}{_against(one, best)}: {text(one)}" for one in there)
        apart = best.measurand == "sensitivity" and any(not _agree(best, one) for one in there)
        said = (*(("experiments differ by more than their uncertainties",) if apart else ()), *said)
        yield replace(best, remarks=(*best.remarks, *said), status="flagged" if apart else best.status)


def _against(one: Result, best: Result) -> str:
    return f" against {one.reference}" if one.reference and one.reference != best.reference else ""


def _agree(one: Result, other: Result) -> bool:
    assert one.value is not None
    assert other.value is not None
    return abs(one.value - other.value) <= 2.0 * math.hypot(one.u, other.u)


def in_volts(result: Result, column: Column) -> Result:
    """A sensitivity or a zero output of imported numbers that are volts, V per SI unit and V; others as they are."""
    if column.volts is None or result.measurand not in ("sensitivity", "offset") or result.unit.startswith("V"):
        return result
    si = "rad/s" if column.quantity == "rate" else "m/s²"
    unit = f"V/({si})" if result.measurand == "sensitivity" else "V"
    title = "sensitivity" if result.measurand == "sensitivity" else "zero output"
    if result.value is None or result.budget is None:
        return replace(result, title=title, unit=unit)
    lines = tuple(
        replace(line, u=line.u * abs(column.volts), unit=unit) if line.kind == "A"
        else replace(line, sensitivity=line.sensitivity * column.volts)
        for line in result.budget.contributions
    )  # fmt: skip
    zero = column.zero_volts if result.measurand == "offset" else 0.0
    return replace(
        result, title=title, unit=unit, value=result.value * column.volts + zero, budget=Budget(lines), low=None,
        high=None, verdict=None,
    )  # fmt: skip


def together(own: Calibration, imported: Calibration) -> Calibration:
    """One calibration from the bench's own runs and from imported ones of the same unit in the same measurands.

    Budgets of imported records hold what their owner states and nothing of alignment, temperature and drift: of values
    that both have, theirs is the better one only if it is a sensitivity whose reference has a stated uncertainty.
    """
    known = [r for r in imported.results if r.measurand == "sensitivity" and "B" in {c.kind for c in r.contributions}]
    less = [r for r in imported.results if r not in known]
    standards: list[Mapping[str, Any]] = list(own.standards)
    standards += [one for one in imported.standards if one not in standards]
    unit = {**own.unit, "channels": {**imported.unit["channels"], **own.unit["channels"]}} if own.unit else {}
    return replace(
        own, made=max(own.made, imported.made), simulated=own.simulated or imported.simulated,
        sources=(*own.sources, *imported.sources), standards=tuple(standards),
        conditions={**imported.conditions, **own.conditions},
        results=tuple(merged([*own.results, *known], less)),
        flags=tuple(dict.fromkeys([*own.flags, *imported.flags])),
        model=own.model or imported.model, unit=unit,
    )  # fmt: skip
