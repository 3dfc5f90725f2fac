"""Flicker noise: the longer one waits, the farther the zero has strolled, the same in every octave up to its
reach.

It is seen in spectra of records at rest, whose noise a data sheet states. What is fitted is the power, its square.
"""

from __future__ import annotations

import math

import numpy as np

from rig.model import BOTH, Array, Channels, Coordinate, Effect, Parameter, Values


class Flicker(Effect):
    stage = "noise"
    title = "flicker noise"
    equation = "S(f) = level²/f·exp(−f/reach), one-sided"
    quantities = BOTH
    places = ("shaker", "turntable")
    coordinates = (
        Coordinate("power", 1e-8, starts=(1e-10, 1e-8, 1e-6)),
        Coordinate("reach", 1.0, starts=(100.0, 1e4), searched=True),
    )
    parameters = (
        Parameter("level", "SI", (0.0, 10.0), (1e-5, 1e-2)), Parameter("reach", "Hz", (3.0, math.inf), (30.0, 3000.0)),
    )  # fmt: skip
    missing = "density rises as 1/f at the low end, Allan deviation flat at 1.18·level: longer means get no better"
    confused_with = ("random_walk", "white", "temperature_bias")
    separate_by = "a record at rest of hours with its temperature: flicker is left when the thermometer is taken off"
    source = "error sources N02; IEEE 952"
    lost = "it is chance"

    def physical(self, at: Values) -> dict[str, float]:
        return {"level": math.copysign(math.sqrt(abs(at["power"])), at["power"]), "reach": at["reach"]}

    def from_physical(self, values: Values) -> dict[str, float]:
        return {"power": values["level"] ** 2, "reach": values["reach"]}

    def density(self, frequency: Array, rate: float, channels: Channels, at: Values) -> Array:
        if not at["power"]:
            return np.zeros((len(channels.names), *frequency.shape))
        return np.multiply.outer(channels.sensitivity**2, at["power"] * np.exp(-frequency / at["reach"]) / frequency)
