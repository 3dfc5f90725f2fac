"""Settling of the multiplexer: a share of the voltage of the slot before is still there at the conversion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.model import Coordinate, Effect, Parameter, Values


class MultiplexerSettling(Effect):
    stage = "sampling"
    title = "settling of the multiplexer"
    equation = "V_shown = V + share·(V_before − V)"
    places = ("shaker",)
    coordinates = (Coordinate("share", 1e-3),)
    parameters = (Parameter("share", "1", (0.0, 1.0), (1e-4, 5e-3)),)
    missing = "a copy of the slot before in every channel, zero output included, the same share at every f and level"
    confused_with = ("cross_axis", "crosstalk", "drive_feedthrough")
    separate_by = "the scan in another order, or a grounded slot in between: the copy goes with the slot, not the axis"
    rarity = 1.0
    source = "error sources E07"
    lost = "it belongs to one scan: a channel needs the volts of the slot before"

    def mixed(self, volts: NDArray[np.inexact], before: NDArray[np.inexact], at: Values) -> NDArray[np.inexact]:
        return volts + at["share"] * (before - volts)
