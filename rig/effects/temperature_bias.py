"""Temperature coefficient of the zero output: the mean follows the thermometer."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model import BOTH, Array, Channels, Coordinate, Drift, Effect, Inverse, Motion, Parameter, Values

ROOM = 25.0  # °C, where the zero output is the nominal one


class TemperatureBias(Effect):
    stage = "transducer"
    title = "temperature coefficient of the zero output"
    equation = "V₀(T) = V₀ + S·coefficient·(T − 25 °C)"
    quantities = BOTH
    needs = ("temperature",)
    coordinates = (Coordinate("coefficient", 0.002),)
    parameters = (Parameter("coefficient", "SI/K", (-math.inf, math.inf), (0.002, 0.02)),)
    missing = "the mean drifts with the logged temperature, whatever the input; the gain stays"
    confused_with = ("warm_up", "temperature_scale", "supply_ratio")
    separate_by = "a temperature ramp both ways at rest: the mean comes back with the temperature, not with time"
    source = "error sources S18; ADXL350 data sheet"

    def output(
        self, signal: NDArray[np.inexact], zero: Array, motion: Motion, channels: Channels, at: Values
    ) -> tuple[NDArray[np.inexact], Array]:
        return signal, zero + channels.sensitivity[:, None] * at["coefficient"] * (motion.temperature - ROOM)

    def inverse(self, at: Values) -> Inverse:
        return Drift("temperature", ROOM, shift=at["coefficient"])
