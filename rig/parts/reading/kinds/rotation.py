"""Foreign data of kind `rotation`: turned about one axis of the case, perhaps at a radius from it."""

from __future__ import annotations

from dataclasses import replace

from rig.foreign.tables import Foreign
from rig.model import Term
from rig.parts.reading import nuisances
from rig.parts.reading.motion import rotations
from rig.parts.reading.reading import Reading
from rig.parts.reference_gain import channels_beside
from rig.parts.track import TrackedMotion, TrackRecords


def read(foreign: Foreign) -> Reading:
    """All files together. Raises BadInput where nothing can be compared."""
    turned = rotations(foreign)
    turned = replace(turned, channels=channels_beside(foreign, turned.channels))
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
