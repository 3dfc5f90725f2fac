"""From a tumble on the rig's own bench to poses: means of every channel, one table for each unit of the sensor.

Of a triad only the magnitude of gravity is compared, so nobody needs to know how well the cube stood. Channels that
are no triad and no gyros, as of a sensor with one axis, are left out and named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rig.archive.records import Recorded, Signals, experiments, is_imported, poses_of, reference, signals
from rig.model import Channels
from rig.motion import Array
from rig.parts.channels import channels_of
from rig.parts.part import Part
from rig.parts.pose_records import PoseRecords
from rig.parts.poses import Poses
from rig.parts.reading.intervals import Interval, Whole, held_out
from rig.parts.reading.reading import Reading
from rig.parts.reading.sessions import begun
from rig.parts.remainder import Indices

HELD = 0.4  # of the poses, or of the time of each where none can be spared, as for imported ones
WINDOW = 100  # scans in one mean: slower than the output filters, whose slope would pass for flicker
FEWEST = 64  # means of a pose, from which its noise is known
LOGGED = {"temperature": 100.0, "supply": 1.0}  # per volt at the converter


def read(runs: Sequence[Recorded]) -> Reading:
    """Every tumble of the rig's own runs."""
    parts: list[Part] = []
    since = begun(runs)
    for run in (one for one in runs if not is_imported(one)):
        for number, one in enumerate(one for one in experiments(run) if poses_of(one)):
            parts += [Poses(replace(data, since=since.get(run.name))) for data in tumbled(one, number)]
    return Reading(tuple(parts))


Read = Callable[[Recorded, Mapping[str, Any]], Signals | None]
"""What a recorder of the sensor kept of a pose; None if nothing."""


def by_converter(records: Recorded, body: Mapping[str, Any]) -> Signals | None:
    """The converter's record of a pose."""
    return signals(records.samples(str(body["samples"]))) if "samples" in body else None


def tumbled(records: Recorded, number: int = 0, read: Read = by_converter) -> Iterator[PoseRecords]:
    """Each unit of the sensor in all poses. Raises BadInput for a channel that shows one number throughout."""
    found = [windows(one) for _, body in poses_of(records) if (one := read(records, body)) is not None]
    if not found:
        return
    channels = channels_of(records, found[0].names)
    gravity = reference(records, "gravity", "gravity")
    intervals, said = held_out(_intervals(found), HELD, ordered=True)
    intervals = sorted(intervals, key=lambda one: one.first)
    for unit in dict.fromkeys(channels.unit):
        rows = np.flatnonzero([one == unit for one in channels.unit])
        used, notes = _used(channels, rows)
        if len(used):
            whole = whole_of(records, found, channels.only(used))
            yield whole.posed(
                f"{records.name}#poses {number} {channels.titles[rows[0]]}", intervals, (gravity.value, gravity.u),
                [said, *notes],
            )  # fmt: skip


def windows(found: Signals, fewest: int = FEWEST) -> Signals:
    """A record as means of some scans each, at least so many."""
    size = max(1, min(WINDOW, len(found.instants) // fewest))
    whole = len(found.instants) // size * size
    volts = found.volts[:whole].reshape(-1, size, found.volts.shape[1]).mean(axis=1)
    return replace(found, instants=found.instants[:whole].reshape(-1, size).mean(axis=1), volts=volts)


def _intervals(found: Sequence[Signals]) -> list[Interval]:
    """One pose after the other in their joined rows."""
    ends = np.cumsum([len(one.instants) for one in found]).tolist()
    return [Interval(first, last) for first, last in zip([0, *ends], ends, strict=False)]


def _used(channels: Channels, rows: Indices) -> tuple[Indices, list[str]]:
    """Channels of a unit that poses can judge: its gyros, and its accelerometers if they are a triad."""
    felt = rows[~channels.rates[rows]]
    if sorted(channels.axis[felt].tolist()) in ([], [0, 1, 2]):
        return rows, []
    names = ", ".join(channels.names[row] for row in felt)
    return rows[channels.rates[rows]], [f"poses: {names} {'is' if len(felt) == 1 else 'are'} no triad, left out there"]


def whole_of(records: Recorded, found: Sequence[Signals], channels: Channels) -> Whole:
    """Records one after the other, with the zero outputs that they show."""
    numbers = np.concatenate([one.volts[:, [one.column(n) for n in channels.names]] for one in found]).T
    time = np.concatenate([one.start + one.instants for one in found])
    conditions = {name: _condition(found, name, scale) for name, scale in LOGGED.items()}
    ends = np.cumsum([len(one.instants) for one in found])
    means = np.array([part.mean(axis=1) for part in np.split(numbers, ends[:-1], axis=1)]).T
    zero = _zero(channels, means)
    return Whole(records.name, records.name, channels, numbers, time, found[0].rate, conditions, zero, together=True)


def _zero(channels: Channels, means: Array) -> Array:
    """Zero outputs (c,) from means (c, poses): for accelerometers the centre of the sphere that gravity draws with the
    data sheet's sensitivities, x·x = 2·x·centre + rest; what gyros show at rest.
    """
    zero, triad = means.mean(axis=1), channels.of("acceleration")
    if len(triad):
        x = (means[triad] / channels.sensitivity[triad, None]).T
        columns = np.column_stack([2.0 * x, np.ones(len(x))])
        centre = np.linalg.lstsq(columns, np.sum(x**2, axis=1), rcond=None)[0][:3]
        zero[triad] = centre * channels.sensitivity[triad]
    return np.asarray(zero)


def _condition(found: Sequence[Signals], name: str, scale: float) -> Array:
    """Temperature (°C) or supply (V) at every row; NaN where not recorded."""
    there = [one.of(name) * scale if name in one.names else np.full(len(one.instants), np.nan) for one in found]
    return np.concatenate(there)
