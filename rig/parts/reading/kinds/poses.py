"""Foreign data of kind `poses`: held still against gravity, and turned by known angles between."""

from __future__ import annotations

from rig.foreign.tables import Foreign
from rig.parts.poses import Poses
from rig.parts.reading.poses import posed
from rig.parts.reading.reading import Reading


def read(foreign: Foreign) -> Reading:
    """Every file. Raises BadInput where no pose is found."""
    return Reading(tuple(Poses(data) for data in posed(foreign)))
