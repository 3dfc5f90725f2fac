"""Imported runs as parts of a fit: one reader for every kind of foreign data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from rig.archive.records import Recorded
from rig.errors import BadInput
from rig.foreign.manifest import Manifest
from rig.foreign.tables import Foreign, foreign_of, is_foreign
from rig.model import Term
from rig.parts.part import Part
from rig.parts.poses import Poses
from rig.parts.reading import nuisances
from rig.parts.reading.imported_sweep import sweeps
from rig.parts.reading.motion import motions, rotations
from rig.parts.reading.poses import posed
from rig.parts.reading.reading import Reading
from rig.parts.reading.response import responses
from rig.parts.reference_gain import channels_beside, gains_of, shared
from rig.parts.response import ResponseRecords, ResponseTable
from rig.parts.sweep import Sweep
from rig.parts.sweep_records import SweepRecords
from rig.parts.track import TrackedMotion, TrackRecords

D = TypeVar("D", ResponseRecords, TrackRecords, SweepRecords)


def read(runs: Sequence[Recorded]) -> Reading:
    """The imported ones among these runs."""
    found = Reading.joined(reading_of(foreign_of(run)) for run in runs if is_foreign(run))
    return replace(found, known=tuple(shared(found.known)))


def reading_of(foreign: Foreign) -> Reading:
    """An imported run. Raises BadInput for data of a kind that no model can be compared with."""
    _refuse_standing_clocks(foreign)
    kind = foreign.manifest.kind
    if not comparable(foreign.manifest):
        wanted = f"wanted one with motion (its noise: `rig show {foreign.run}`)"
        raise BadInput(f"{foreign.run}: found a {kind} record, {wanted}")
    found = KINDS[kind](foreign)
    return replace(found, known=(*found.known, *gains_of(foreign, [part.name for part in found.parts])))


def comparable(manifest: Manifest) -> bool:
    """Whether a model can be compared with what a manifest describes."""
    return manifest.kind in KINDS


def parts_of(foreign: Foreign) -> tuple[list[Part], list[Term]]:
    """Its parts, and what is known of its reference only within an uncertainty. Raises BadInput as `reading_of`."""
    found = reading_of(foreign)
    return list(found.parts), list(found.known)


def _response(foreign: Foreign) -> Reading:
    return Reading(tuple(ResponseTable(_beside(foreign, data)) for data in responses(foreign)))


def _rotation(foreign: Foreign) -> Reading:
    turned = _beside(foreign, rotations(foreign))
    standing = [] if turned.channels.rates.all() else _standing(foreign, turned)
    return Reading((TrackedMotion(turned),), (*nuisances.of_track(max(turned.bands)), *standing))


def _standing(foreign: Foreign, turned: TrackRecords) -> list[Term]:
    """What accelerometers on a rotation depend on and nobody states: where gravity lies, and where the case sits."""
    stated = foreign.manifest.rotation
    prior: dict[str, float] = {}
    if turned.outward.any() and stated is not None:
        prior |= {} if stated.outward else {"angle": nuisances.U_PLACE_ANGLE}
        prior |= {"length": stated.radius_uncertainty} if stated.radius_uncertainty else {}
    lies = [] if turned.upright.any() else nuisances.of_rotation(turned.axis)
    return [*lies, *nuisances.of_place(turned.axis, turned.radius, prior)]


def _motion(foreign: Foreign) -> Reading:
    moved = _beside(foreign, motions(foreign))
    return Reading((TrackedMotion(moved),), tuple(nuisances.of_track(max(moved.bands))))


def _sweep(foreign: Foreign) -> Reading:
    return Reading(tuple(Sweep(_beside(foreign, data)) for data in sweeps(foreign)))


def _poses(foreign: Foreign) -> Reading:
    return Reading(tuple(Poses(data) for data in posed(foreign)))


def _refuse_standing_clocks(foreign: Foreign) -> None:
    """Time has to pass in a record. Raises BadInput."""
    for table in foreign.tables if foreign.manifest.time is not None else ():
        stamps = foreign.time(table)
        known = stamps[np.isfinite(stamps)]
        if len(known) < 2 or not known[-1] > known[0]:
            where = f"{foreign.run} {table.label}".strip()
            raise BadInput(f"{where}, time: found stamps that do not go forward, wanted each later than the one before")


def _beside(foreign: Foreign, data: D) -> D:
    """Records whose channels' tolerances say nothing of a reference that is not well known itself."""
    return replace(data, channels=channels_beside(foreign, data.channels))


KINDS: Mapping[str, Callable[[Foreign], Reading]] = {
    "response": _response, "rotation": _rotation, "motion": _motion, "sweep": _sweep, "poses": _poses,
}  # fmt: skip
