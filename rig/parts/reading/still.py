"""From a record at rest on the rig's own bench to the gyros' means in its pieces: zero output, and how it drifts.

Nobody says how the cube lay, so what the accelerometers show is gravity and zero output in unknown shares: they are
left out. A tumble tells them apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rig.archive.records import Recorded, experiments, is_imported, reference, signals
from rig.parts.channels import channels_of
from rig.parts.pose_records import PoseRecords
from rig.parts.poses import Poses
from rig.parts.reading.intervals import Interval, held_out
from rig.parts.reading.reading import Reading
from rig.parts.reading.tumble import HELD, whole_of, windows

PURPOSE = "noise"  # of a record that is a measurement by itself
PIECES = 24  # of a record
SHORTEST = 64  # means in a piece, from which its noise is known
LEFT_OUT = (
    "accelerometers at rest are not compared: nobody says how the cube lay (`rig tumble` tells zero from gravity)"
)


def read(runs: Sequence[Recorded]) -> Reading:
    """Every long record at rest of the rig's own runs."""
    own = [one for run in runs if not is_imported(run) for one in experiments(run)]
    return Reading(tuple(Poses(data) for one in own for data in rested(one)))


def rested(records: Recorded) -> Iterator[PoseRecords]:
    """The gyros of every record at rest; none of one that is too short. Raises BadInput for a gyro that is dead."""
    bodies = [body for body in records.points.values() if body.get("purpose") == PURPOSE and "samples" in body]
    for number, body in enumerate(bodies):
        found = windows(signals(records.samples(str(body["samples"]))), SHORTEST)
        channels = channels_of(records, found.names)
        size = max(len(found.instants) // PIECES, SHORTEST)
        pieces = [Interval(k * size, (k + 1) * size) for k in range(len(found.instants) // size)]
        if len(pieces) < 2 or not channels.rates.any():
            continue
        gravity = reference(records, "gravity", "gravity")
        intervals, said = held_out(pieces, HELD)
        whole = whole_of(records, [found], channels.only(np.flatnonzero(channels.rates)))
        notes = [said] if channels.rates.all() else [said, LEFT_OUT]
        ordered = sorted(intervals, key=lambda one: one.first)
        yield whole.posed(f"{records.name}#rest {number}", ordered, (gravity.value, gravity.u), notes)
