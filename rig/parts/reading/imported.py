"""Imported runs as parts of a fit: one way in for every kind of foreign data."""

from __future__ import annotations

from rig.errors import BadInput
from rig.foreign.tables import Foreign
from rig.model import Term
from rig.parts import nuisances
from rig.parts.following import Following
from rig.parts.part import Part
from rig.parts.poses import Posed
from rig.parts.reading.imported_sweep import sweeps
from rig.parts.reading.motion import motions, rotations
from rig.parts.reading.poses import posed
from rig.parts.response import Responding, responses
from rig.parts.sines import Sines


def parts_of(foreign: Foreign) -> tuple[list[Part], list[Term]]:
    """Parts of an imported run, and what is known of its reference only within an uncertainty.

    Raises BadInput for data of a kind that no model can be compared with.
    """
    match foreign.manifest.kind:
        case "response":
            return [Responding(data) for data in responses(foreign)], []
        case "rotation":
            turned = rotations(foreign)
            lies = not turned.upright and not turned.channels.rates.all()
            known = nuisances.of_track(max(turned.bands))
            return [Following(turned)], [*known, *(nuisances.of_rotation(turned.axis) if lies else [])]
        case "motion":
            moved = motions(foreign)
            return [Following(moved)], nuisances.of_track(max(moved.bands))
        case "sweep":
            return [Sines(data) for data in sweeps(foreign)], []
        case "poses":
            return [Posed(data) for data in posed(foreign)], []
        case kind:
            raise BadInput(f"{foreign.run}: found a {kind} record, wanted one with motion (its noise: rig show)")
