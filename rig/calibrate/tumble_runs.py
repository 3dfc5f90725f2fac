"""What tumbles gave: every unit against gravity, on the fitted model where the poses tell one, directly beside it.

A model of a triad has nine parameters, and each attitude tells it one number, the magnitude of gravity, however the
cube stood. The direct estimate takes each pose's direction from the procedure, within the declared tilt. Where the
attitudes are too few or too much alike for the nine, only the latter knows how the axes stand, and stays.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

from rig.calibrate import agreement, triad, tumbling
from rig.calibrate.agreement import DirectEstimate
from rig.calibrate.allowances import temperature
from rig.calibrate.basis import Basis
from rig.calibrate.budget import Budget
from rig.calibrate.calibration import Result
from rig.calibrate.cube_route import at_rest
from rig.calibrate.fitted import Assumed, alone
from rig.calibrate.joined import joined
from rig.calibrate.tumbling import Poses, Read, UnitFit
from rig.errors import BadInput
from rig.parts.poses import Poses as PosesPart
from rig.parts.reading.tumble import tumbled
from rig.sensor import Triad

PLACE = "tumble"
GRAVITY = "sensitivity_gravity"
NO_TRIAD = "a model needs a triad of x, y and z"
DIRECT = "the value is a direct estimate from the poses' directions"


@dataclass(frozen=True)
class _Model:
    """The model for every unit of a tumble, the units' parts of a fit; `why` there are none."""

    assumed: Assumed
    parts: tuple[PosesPart, ...]
    why: str


def results(basis: Basis, assumed: Assumed | None) -> Iterator[Result]:
    """Results of every tumble; direct estimates alone without a model."""
    read = partial(at_rest, recorder=basis.recorder)
    for records in basis.runs:
        poses = tumbling.poses_in(records, basis.noise, basis.alignment.mount, read)
        if poses is not None:
            model = None if assumed is None else _model(poses, assumed, read)
            recorded = map(poses.recorded, basis.sensor.of_quantity("acceleration"))
            units = [unit for unit in recorded if unit.channels]
            wrong = tumbling.misplaced(poses, units)
            yield from tumbling.refused(wrong)
            for unit in units:
                kept = replace(unit, channels=tuple(c for c in unit.channels if c.name not in wrong))
                found = _of_unit(poses, kept, model) if kept.channels else ()
                yield from (_at_its_temperature(row, basis, records.name) for row in found)


def _at_its_temperature(row: Result, basis: Basis, run: str) -> Result:
    """A sensitivity with what its temperature leaves open."""
    if row.measurand != GRAVITY or row.budget is None or row.value is None:
        return row
    drift = basis.sensor.channel(row.channel).drift
    lines, said = temperature(row.value, drift, basis.temperature, [f"poses of {run}"])
    budget = Budget((*row.contributions, *lines), row.budget.correlation)
    return replace(row, budget=budget, remarks=(*row.remarks, *said))


def _model(poses: Poses, assumed: Assumed, read: Read) -> _Model:
    try:
        triad.check_spread(poses.up)
    except BadInput:
        why = f"{len(poses.bodies)} poses leave the angles between the axes open (`rig tumble --poses 24`)"
        return _Model(assumed, (), why)
    try:
        return _Model(assumed, tuple(PosesPart(data) for data in tumbled(poses.records, read=read)), NO_TRIAD)
    except BadInput as error:
        return _Model(assumed, (), str(error))


def _of_unit(poses: Poses, unit: Triad, model: _Model | None) -> Iterator[Result]:
    try:
        found = tumbling.fit_unit(poses, unit)
    except BadInput as error:
        yield from tumbling.without(unit, str(error))
        return
    yield from found.results() if model is None else _on_model(found, model)


def _on_model(found: UnitFit, model: _Model) -> Iterator[Result]:
    """The results of a unit on the model fitted to all its poses; why they are direct where there is none."""
    direct = {one.key: one for one in _direct(found)}
    part = next((one for one in model.parts if set(found.unit.names) <= set(one.channels.names)), None)
    if part is None:
        yield from (_said(result, model.why) if result.key in direct else result for result in found.results())
        return
    experiment, assumed = alone(part, model.assumed)
    fits = {PLACE: replace(experiment, name=PLACE)}
    for result in found.results():
        yield joined(result, direct[result.key], fits, assumed) if result.key in direct else result


def _said(result: Result, why: str) -> Result:
    return replace(result, remarks=(*result.remarks, f"{DIRECT}: {why}"))


def _direct(found: UnitFit) -> Iterator[DirectEstimate]:
    """What the direct estimator says, to be held against the fit."""
    poses, directions = found.poses, found.directions
    share = poses.gravity.u / poses.gravity.value
    sizes, own_axes = found.signed
    for place, name in enumerate(found.unit.names):
        size, u = float(sizes[place]), float(directions.sizes[1][place])
        zero, u_zero = float(directions.offsets[place]), float(directions.u_offsets[place])
        for measurand, value, u_value, weights in (
            (GRAVITY, size, math.sqrt(max(u**2 - (size * share) ** 2, 0.0)), own_axes[place]),
            ("offset", zero, u_zero, directions.by_readings[place, 3]),
        ):
            change = agreement.of_poses(poses.begin, poses.end, weights)
            yield DirectEstimate(f"{name}.{measurand}", PLACE, value, u_value, change, found.u_of_tilt(weights))
