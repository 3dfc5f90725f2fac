"""Channels of a run as the sensor file and the cabling describe them, for a model."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rig.archive.records import Recorded
from rig.errors import BadInput
from rig.model import Channels
from rig.sensor import Sensor

UNSTATED = 0.2  # relative tolerance of a sensitivity whose data sheet states none


def channels_of(records: Recorded, cables: Sequence[str], relative_to: str = "") -> Channels:
    """The sensors among the cables; slots count from that of the reference `relative_to` if it is named."""
    sensor = Sensor.of(records.header)
    found = [sensor.channel(name) for name in cables if name in sensor]
    if not found:
        raise BadInput(
            f"{records.name}: found none of the sensor's channels ({', '.join(sensor.names)}) among what was recorded "
            f"({', '.join(cables)}), wanted a sensor file and cables that use the same names"
        )
    units = [sensor.triad(one.triad) for one in found]
    origin = cables.index(relative_to) if relative_to else 0
    return Channels(
        names=tuple(one.name for one in found),
        rates=np.array([one.is_rate for one in found]),
        axis=np.array([one.place for one in found], np.intp),
        slot=np.array([cables.index(one.name) - origin for one in found], np.intp),
        side=np.array([math.nan if one.beside_spot is None else one.beside_spot for one in found]),
        sensitivity=np.array([one.nominal for one in found]),
        tolerance=np.array([UNSTATED if one.tolerance is None else one.tolerance for one in found]),
        pole=np.array([one.bandwidth for one in found]),
        unit=tuple(unit.name for unit in units),
        titles=tuple(unit.title for unit in units),
        words=tuple(one.word for one in found),
        colours=tuple(unit.colour for unit in units),
    )
