"""Channels of a run as the sensor file and the cabling describe them, for a model."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rig import units
from rig.archive.records import Recorded
from rig.model import Channels
from rig.sensor import sensors_of

UNSTATED = 0.2  # relative tolerance of a sensitivity whose data sheet states none
AXES = {"x": 0, "y": 1, "z": 2}


def channels_of(records: Recorded, cables: Sequence[str], relative_to: str = "") -> Channels:
    """The sensors among the cables; slots count from that of the reference `relative_to` if it is named."""
    sensors = sensors_of(records.header)
    stated = records.header["sensor"]["channels"]
    names = tuple(name for name in cables if name in sensors)
    origin = cables.index(relative_to) if relative_to else 0
    side = [stated[n].get("beside_spot") for n in names]
    return Channels(
        names=names,
        rates=np.array([sensors[n].quantity == "rate" for n in names]),
        axis=np.array([AXES[sensors[n].axis] for n in names]),
        slot=np.array([cables.index(n) - origin for n in names]),
        side=np.array([math.nan if s is None else units.parse(str(s), "length") for s in side]),
        sensitivity=np.array([sensors[n].nominal for n in names]),
        tolerance=np.array([UNSTATED if sensors[n].tolerance is None else sensors[n].tolerance for n in names]),
        pole=np.array([sensors[n].bandwidth for n in names]),
        unit=tuple(n.rpartition("_")[0] for n in names),
    )
