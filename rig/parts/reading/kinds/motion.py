"""Foreign data of kind `motion`: moved freely before cameras."""

from __future__ import annotations

from dataclasses import replace

from rig.foreign.tables import Foreign
from rig.parts.reading import nuisances
from rig.parts.reading.motion import motions
from rig.parts.reading.reading import Reading
from rig.parts.reference_gain import channels_beside
from rig.parts.track import TrackedMotion


def read(foreign: Foreign) -> Reading:
    """All files together. Raises BadInput where nothing can be compared."""
    moved = motions(foreign)
    moved = replace(moved, channels=channels_beside(foreign, moved.channels))
    return Reading((TrackedMotion(moved),), tuple(nuisances.of_track(max(moved.bands))))
