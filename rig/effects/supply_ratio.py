"""Ratiometric output: sensitivity and zero output follow the supply together."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model import BOTH, Array, Channels, Coordinate, Drift, Effect, Inverse, Motion, Parameter, Values

NOMINAL = 5.0  # V, the supply for which sensitivity and zero output are stated


class SupplyRatio(Effect):
    stage = "transducer"
    title = "ratiometric supply"
    equation = "V = (S·u + V₀)·(1 + share·(Vs/5 V − 1))"
    quantities = BOTH
    needs = ("supply",)
    coordinates = (Coordinate("share", 0.1),)
    parameters = (Parameter("share", "1", (0.0, math.inf), (0.1, 1.0)),)
    missing = "gain and mean drift together, by the same share, with the logged supply"
    confused_with = ("temperature_scale", "temperature_bias", "warm_up")
    separate_by = "the supply stepped by some per cent at a fixed temperature"
    source = "error sources S17; data sheets of ratiometric parts (0.2·Vs/g)"

    def output(
        self, signal: NDArray[np.inexact], zero: Array, motion: Motion, channels: Channels, at: Values
    ) -> tuple[NDArray[np.inexact], Array]:
        ratio = 1.0 + at["share"] * (motion.supply / NOMINAL - 1.0)
        return signal * motion.grid.each(ratio), zero * ratio

    def inverse(self, at: Values) -> Inverse:
        per_volt = at["share"] / NOMINAL
        return Drift("supply", NOMINAL, gain=per_volt, zero=per_volt)
