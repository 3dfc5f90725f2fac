"""A calibrated unit carries its calibration to others that rode with it: the bench's own reference cancels.

    S = S_cal · S_other / S_this          sensitivity; both measured in the same runs along one axis
    τ = τ_cal + τ_other − τ_this          lag of a gyro

Every line of the three budgets is followed by its origin. The vibrometer's gain multiplies both measured values and
goes out; what the certificate of the calibrated unit owed to it stays. What is not the same for two places on one table
(laser spot, transverse motion, base strain) is counted for each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rig.calibrate.budget import Budget
from rig.calibrate.calibration import ROUTES, Calibration, Result, not_determined
from rig.calibrate.combining import weighted
from rig.calibrate.comparison import correlation
from rig.calibrate.judging import judged
from rig.calibrate.verdict import agrees, normalised_error
from rig.errors import BadInput
from rig.sensor import SensorChannel, Triad

OWN_PLACE = ("laser spot", "transverse motion", "base strain", "place of the sensing element")
KEPT = ("offset", "noise_bandwidth")  # what needs no reference: noise in SI stands on the bench's


@dataclass(frozen=True)
class Against:
    """A carried value beside what was stated of it before: En, where that has an uncertainty."""

    key: str
    stated: float
    unit: str
    source: str
    en: float

    @property
    def agrees(self) -> bool:
        return agrees(self.en)

    def as_json(self) -> dict[str, Any]:
        """SI."""
        return {
            "key": self.key, "stated": self.stated, "unit": self.unit, "source": self.source, "en": self.en,
            "agrees": self.agrees,
        }  # fmt: skip


def qualified(ride: Calibration, known: Calibration, reference: str, names: Sequence[str] = ()) -> Calibration:
    """The calibration of the units `names` (all others without) by the unit `reference`, as `known` states it.

    `ride` is what the bench makes of the runs in which they rode together. Raises BadInput for a unit that is not in
    the sensor file, of another quantity or the reference itself, for one that is not calibrated, and for a calibration
    that stands on the same runs.
    """
    sensor = ride.under_test
    master = sensor.triad(reference)
    same = sorted({one.run for one in ride.sources} & {one.run for one in known.sources})
    if same:
        raise BadInput(f"calibration {known.name}: found it made from {same[0]}, wanted one from other runs than those "
                       "in which the units rode together")  # fmt: skip
    others = [sensor.triad(name) for name in names] or [
        one for one in sensor.of_quantity(master.quantity) if one.name != master.name
    ]
    for one in others:
        if one.quantity != master.quantity or one.name == master.name:
            raise BadInput(f"unit: found {one.name}, wanted other {master.quantity} sensors than {master.name}")
    results = [row for triad in others for row in _of_unit(ride, known, master, triad)]
    if not any(row.determined and row.measurand == "sensitivity" for row in results):
        units = ", ".join(one.name for one in others)
        raise BadInput(f"{units}: found no axis along which {master.name} is calibrated in {known.name} and both were "
                       "measured together, wanted one")  # fmt: skip
    return replace(
        ride, results=tuple(results), responses={}, analyzer={}, paper=(),
        flags=(*ride.flags, f"by {master.title} of {known.serial} as calibrated in {known.name}"),
    )  # fmt: skip


def _of_unit(ride: Calibration, known: Calibration, master: Triad, triad: Triad) -> Iterator[Result]:
    for channel in triad.channels:
        this = master.along(channel.axis)
        yield _sensitivity(ride, known, this, channel)
        if channel.is_rate and this is not None:
            yield from _lag(ride, known, this, channel)
        yield from (row for name in KEPT if (row := ride.find(f"{channel.name}.{name}")) is not None)


def _sensitivity(ride: Calibration, known: Calibration, this: SensorChannel | None, other: SensorChannel) -> Result:
    unit = f"V/({other.unit})"
    calibrated = None if this is None else known.to_use(this.name, "sensitivity")
    if this is None or calibrated is None:
        why = f"found no calibrated channel along {other.axis}, wanted one"
        return not_determined(other.name, "sensitivity", "sensitivity", unit, why)
    found = [
        row for route in ROUTES if (row := _by_route(ride, route, this, other, calibrated, known.name)) is not None
    ]
    if not found:
        why = f"{this.name} and {other.name} were not measured together: `rig sweep`, `rig turntable` or `rig tumble`"
        return not_determined(other.name, "sensitivity", "sensitivity", unit, why)
    return judged(min(found, key=lambda row: (row.status == "flagged", row.u)), other.nominal, other.tolerance)


def _by_route(
    ride: Calibration, route: str, this: SensorChannel, other: SensorChannel, calibrated: Result, name: str
) -> Result | None:
    """What one kind of run makes of it."""
    mine, theirs = (ride.find(f"{one.name}.{route}") for one in (this, other))
    if mine is None or theirs is None or not mine.value or theirs.value is None or calibrated.value is None:
        return None
    value = calibrated.value * theirs.value / mine.value
    parts = [
        (other.name, _in_its_place(theirs), value / theirs.value), (this.name, mine, -value / mine.value),
        (f"{this.name}, {name}", calibrated, value / calibrated.value),
    ]  # fmt: skip
    return _carried(theirs, value, parts, f"ratio to {this.name} in the same runs, {theirs.method}", this, name)


def _lag(ride: Calibration, known: Calibration, this: SensorChannel, other: SensorChannel) -> Iterator[Result]:
    mine, theirs, calibrated = (
        one.find(f"{channel.name}.lag") for one, channel in ((ride, this), (ride, other), (known, this))
    )
    if mine is not None and theirs is not None and calibrated is not None:
        value = float(calibrated.value or 0.0) + float(theirs.value or 0.0) - float(mine.value or 0.0)
        parts = [(other.name, theirs, 1.0), (this.name, mine, -1.0), (f"{this.name}, {known.name}", calibrated, 1.0)]
        yield _carried(theirs, value, parts, f"beside that of {this.name} in the same runs", this, known.name)


def _in_its_place(row: Result) -> Result:
    """The same with lines that belong to where a unit sits as its own."""
    assert row.budget is not None
    lines = tuple(
        replace(line, source=f"{line.source}, at {row.channel}") if line.name in OWN_PLACE else line
        for line in row.contributions
    )
    return replace(row, budget=Budget(lines, row.budget.correlation))


def _carried(
    row: Result, value: float, parts: Sequence[tuple[str, Result, float]], method: str, this: SensorChannel, name: str
) -> Result:
    flagged = [f"{label}: {one.remarks[0]}" for label, one, _ in parts if one.status == "flagged" and one.remarks]
    return replace(
        row, measurand="lag" if row.measurand == "lag" else "sensitivity", value=value,
        budget=Budget(tuple(weighted(parts))), method=method, reference=f"{this.name} by calibration {name}",
        status="flagged" if flagged else "determined", remarks=tuple(flagged), low=None, high=None, verdict=None,
        check=None,
    )  # fmt: skip


def against(made: Calibration, last: Calibration | None) -> Iterator[Against]:
    """Every carried sensitivity beside the last calibration's, else the data sheet's with its tolerance."""
    sensor = made.under_test
    for row in made.of("sensitivity"):
        value, channel = float(row.value or 0.0), sensor.channel(row.channel)
        before = None if last is None else last.to_use(row.channel, "sensitivity")
        if before is not None and before.value is not None and last is not None:
            en = normalised_error(value, row.expanded, before.value, before.expanded, correlation(row, before))
            yield Against(row.key, before.value, row.unit, f"calibration {last.name}", en)
        elif channel.tolerance is not None:
            limit = abs(channel.nominal) * channel.tolerance
            yield Against(row.key, channel.nominal, row.unit, "data sheet",
                          normalised_error(value, row.expanded, channel.nominal, limit))  # fmt: skip
