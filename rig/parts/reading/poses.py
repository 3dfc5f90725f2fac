"""From imported data of kind "poses" to the means that a model is compared with.

Poses and turns are those that the manifest names as segments; where it names none, the intervals at rest are found in
the record itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from rig.errors import BadInput
from rig.foreign.faults import bridged, faults, without_faults
from rig.foreign.finding import Finding
from rig.foreign.manifest import Column, Segment
from rig.foreign.tables import CONDITIONS, Foreign, Table
from rig.model import Channels
from rig.motion import Array
from rig.parts.pose_records import PoseRecords
from rig.parts.reading.intervals import Interval, Pair, Whole, beginning, held_out, marked, mean_of, signed
from rig.units import STANDARD_GRAVITY

Finder = Callable[[Array, float, Array | None], Sequence[Pair]]


def posed(foreign: Foreign, find: Finder | None = None) -> list[PoseRecords]:
    """Every file of a run of kind "poses"; `find` finds the intervals at rest where the manifest names none.

    Raises BadInput for a file without poses, or for segments of several files.
    """
    if foreign.manifest.segments and len(foreign.tables) > 1:
        raise BadInput(f"{foreign.run}: found segments and {len(foreign.tables)} files, wanted one file")
    by_file = any(table.held_out for table in foreign.tables)
    return [_record(foreign, number, table, find or _at_rest, by_file) for number, table in enumerate(foreign.tables)]


def _record(foreign: Foreign, number: int, table: Table, find: Finder, by_file: bool) -> PoseRecords:
    columns = [one for one in foreign.manifest.of("device") if one.quantity in ("acceleration", "rate")]
    where = f"{foreign.run} {table.label}".strip()
    if not columns:
        raise BadInput(f"{where}: found no accelerometer and no gyro, wanted one")
    numbers = np.array([without_faults(foreign, table, one) * one.scale for one in columns])
    time = foreign.time(table)
    rate = (len(time) - 1) / float(time[-1] - time[0])
    channels = _channels(columns, foreign.manifest.unit.serial)
    shown = np.array([bridged(foreign, table, one) for one in columns])
    intervals, notes = _intervals(foreign, table, shown, channels, rate, find)
    if by_file:
        intervals = [marked(one, table.held_out) for one in intervals]
    else:
        intervals, said = held_out(intervals, foreign.manifest.compared.held_out)
        notes = [*notes, said]
    for values, column in zip(numbers, columns, strict=True):
        _without_cut_off(values, intervals, [one for one in faults(foreign, table, column) if one.kind == "clipped"])
    return _means(foreign, table, number, channels, numbers, time, rate, sorted(intervals, key=beginning), notes)


def _without_cut_off(values: Array, intervals: Sequence[Interval], clipped: Sequence[Finding]) -> None:
    """Leaves out whole intervals in which some rows are cut off: what is left of their noise lies on one side."""
    for finding in clipped:
        for one in intervals:
            if ((finding.rows >= one.first) & (finding.rows < one.last)).any():
                values[one.first : one.last] = math.nan


def _channels(columns: Sequence[Column], serial: str) -> Channels:
    count = len(columns)
    return Channels(
        names=tuple(one.channel for one in columns),
        rates=np.array([one.quantity == "rate" for one in columns]),
        axis=np.array(["xyz".index(one.axis or "x") for one in columns], np.intp),
        slot=np.arange(count, dtype=np.intp), side=np.full(count, math.nan),
        sensitivity=np.array([one.scale for one in columns]),
        tolerance=np.array([one.tolerance for one in columns]),
        pole=np.array([one.bandwidth or math.inf for one in columns]), unit=(serial,) * count,
    )  # fmt: skip


def _intervals(
    foreign: Foreign, table: Table, shown: Array, channels: Channels, rate: float, find: Finder
) -> tuple[list[Interval], list[str]]:
    """Poses and turns, and what is to be said of how they were found; `shown` (c, n) SI by the data sheet."""
    named = [_named(one, len(table.values), foreign.run) for one in foreign.manifest.segments]
    if any(not one.turns for one in named):
        return named, [*_contradictions(named, shown, channels, rate)]
    acceleration, gyro = (shown[channels.of(quantity)] for quantity in ("acceleration", "rate"))
    if len(acceleration) != 3:
        raise BadInput(f"{foreign.run}: found no segments and no triad, wanted poses named in the manifest")
    found = find(acceleration.T, rate, gyro.T if len(gyro) else None)
    if not len(found):
        raise BadInput(f"{foreign.run} {table.label}: found no interval at rest, wanted poses")
    said = f"{len(found)} poses at rest found in the record"
    return [*(Interval(*one) for one in found), *named], [said, *_contradictions(named, shown, channels, rate)]


def _at_rest(acceleration: Array, rate: float, gyro: Array | None) -> list[Pair]:
    from rig.signals.still_poses import still_poses

    return [(one.first, one.last) for one in still_poses(acceleration, rate, gyro=gyro)]


def _named(one: Segment, rows: int, run: str) -> Interval:
    if one.last > rows:
        raise BadInput(f"{run}: found a segment up to row {one.last}, wanted at most {rows}")
    angle = [one.angle or 0.0 if axis == one.turn else 0.0 for axis in "xyz"]
    return Interval(
        one.first, one.last, (angle[0], angle[1], angle[2]), one.angle_uncertainty, up=one.up, label=one.label
    )


def _contradictions(named: Sequence[Interval], shown: Array, channels: Channels, rate: float) -> list[str]:
    """Turns that a gyro shows the other way round, and poses that an accelerometer does."""
    said = []
    for one in named:
        for c in channels.of("acceleration") if one.up is not None and not one.turns else ():
            felt = mean_of(shown[c, one.first : one.last])
            if felt * float(signed(one.up)[int(channels.axis[c])]) < -0.5 * STANDARD_GRAVITY:
                said.append(
                    f"{channels.names[c]} shows {felt:.3g} m/s² in {one.words}, stated with {one.up} up: the sign of "
                    "its axis or of the statement is wrong"
                )
        for c in channels.of("rate"):
            stated = one.angle[int(channels.axis[c])]
            seen = float(np.nansum(shown[c, one.first : one.last])) / rate
            if stated * seen < 0.0 and abs(seen) > 0.5 * abs(stated):
                said.append(
                    f"{channels.names[c]} shows {math.degrees(seen):.0f}° in {one.words}, stated as "
                    f"{math.degrees(stated):.0f}°: the sign of its axis or of the angle is wrong"
                )
    return said


def _means(
    foreign: Foreign, table: Table, number: int, channels: Channels, numbers: Array, time: Array, rate: float,
    intervals: Sequence[Interval], notes: Sequence[str],
) -> PoseRecords:  # fmt: skip
    """Means over the intervals and how noisy they are."""
    conditions = {name: foreign.condition(table, name) for name in CONDITIONS}
    whole = Whole(f"{foreign.run} {table.label}", foreign.run, channels, numbers, time, rate, conditions)
    gravity = foreign.manifest.gravity
    return whole.posed(f"{foreign.run}#{number}", intervals, (gravity.value, gravity.uncertainty), notes)
