"""Foreign data of kind `sweep`: a shaker's steady sines beside a second accelerometer."""

from __future__ import annotations

from dataclasses import replace

from rig.foreign.tables import Foreign
from rig.parts.reading.imported_sweep import sweeps
from rig.parts.reading.reading import Reading
from rig.parts.reference_gain import channels_beside
from rig.parts.sweep import Sweep


def read(foreign: Foreign) -> Reading:
    """All files together. Raises BadInput where nothing can be compared."""
    found = (replace(data, channels=channels_beside(foreign, data.channels)) for data in sweeps(foreign))
    return Reading(tuple(Sweep(data) for data in found))
