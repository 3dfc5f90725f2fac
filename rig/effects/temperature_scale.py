"""Temperature coefficient of the sensitivity: the scale follows the thermometer."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model import BOTH, Array, Channels, Coordinate, Drift, Effect, Inverse, Motion, Parameter, Values

ROOM = 25.0  # °C, where the sensitivity is the nominal one


class TemperatureScale(Effect):
    stage = "transducer"
    title = "temperature coefficient of the sensitivity"
    equation = "S(T) = S·(1 + coefficient·(T − 25 °C))"
    quantities = BOTH
    needs = ("temperature",)
    coordinates = (Coordinate("coefficient", 1e-4),)
    parameters = (Parameter("coefficient", "1/K", (-math.inf, math.inf), (1e-4, 3e-4)),)
    missing = "the gain drifts with the logged temperature, in proportion to the signal; the zero stays"
    confused_with = ("supply_ratio", "warm_up", "temperature_bias")
    separate_by = "a temperature ramp both ways at a fixed supply, points in random order"
    source = "error sources S19"

    def output(
        self, signal: NDArray[np.inexact], zero: Array, motion: Motion, channels: Channels, at: Values
    ) -> tuple[NDArray[np.inexact], Array]:
        return signal * motion.grid.each(1.0 + at["coefficient"] * (motion.temperature - ROOM)), zero

    def inverse(self, at: Values) -> Inverse:
        return Drift("temperature", ROOM, gain=at["coefficient"])
