"""Imported runs as parts of a fit: one way in for every kind of foreign data."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from rig.errors import BadInput
from rig.foreign.tables import Foreign
from rig.model import Term
from rig.parts import nuisances
from rig.parts.following import Following, FollowRecords
from rig.parts.part import Part
from rig.parts.poses import Posed
from rig.parts.reading.imported_sweep import sweeps
from rig.parts.reading.motion import motions, rotations
from rig.parts.reading.poses import posed
from rig.parts.reference_gain import channels_beside, gains_of
from rig.parts.response import Responding, ResponseTable, responses
from rig.parts.sines import SineRecords, Sines

D = TypeVar("D", ResponseTable, FollowRecords, SineRecords)


def parts_of(foreign: Foreign) -> tuple[list[Part], list[Term]]:
    """Parts of an imported run, and what is known of its reference only within an uncertainty.

    Raises BadInput for data of a kind that no model can be compared with.
    """
    _refuse_standing_clocks(foreign)
    parts, known = _read(foreign)
    return parts, [*known, *gains_of(foreign, [part.name for part in parts])]


def _read(foreign: Foreign) -> tuple[list[Part], list[Term]]:
    match foreign.manifest.kind:
        case "response":
            return [Responding(_beside(foreign, data)) for data in responses(foreign)], []
        case "rotation":
            turned = _beside(foreign, rotations(foreign))
            known = nuisances.of_track(max(turned.bands))
            return [Following(turned)], [*known, *([] if turned.channels.rates.all() else _standing(foreign, turned))]
        case "motion":
            moved = _beside(foreign, motions(foreign))
            return [Following(moved)], nuisances.of_track(max(moved.bands))
        case "sweep":
            return [Sines(_beside(foreign, data)) for data in sweeps(foreign)], []
        case "poses":
            return [Posed(data) for data in posed(foreign)], []
        case kind:
            raise BadInput(
                f"{foreign.run}: found a {kind} record, wanted one with motion (its noise: `rig show {foreign.run}`)"
            )


def _standing(foreign: Foreign, turned: FollowRecords) -> list[Term]:
    """What accelerometers on a rotation depend on and nobody states: where gravity lies, and where the case sits."""
    stated = foreign.manifest.rotation
    prior: dict[str, float] = {}
    if turned.outward.any() and stated is not None:
        prior |= {} if stated.outward else {"angle": nuisances.U_PLACE_ANGLE}
        prior |= {"length": stated.radius_uncertainty} if stated.radius_uncertainty else {}
    lies = [] if turned.upright.any() else nuisances.of_rotation(turned.axis)
    return [*lies, *nuisances.of_place(turned.axis, turned.radius, prior)]


def _beside(foreign: Foreign, data: D) -> D:
    """Records whose channels' tolerances say nothing of a reference that is not well known itself."""
    return replace(data, channels=channels_beside(foreign, data.channels))


def _refuse_standing_clocks(foreign: Foreign) -> None:
    """Time has to pass in a record. Raises BadInput."""
    for table in foreign.tables if foreign.manifest.time is not None else ():
        stamps = foreign.time(table)
        known = stamps[np.isfinite(stamps)]
        if len(known) < 2 or not known[-1] > known[0]:
            where = f"{foreign.run} {table.label}".strip()
            raise BadInput(f"{where}, time: found stamps that do not go forward, wanted each later than the one before")
