"""Gain error of the buffer or of the converter behind the sensor: signal and zero grow alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.model import BOTH, Array, Channels, Coordinate, Drift, Effect, Inverse, Motion, Parameter, Values


class BufferGain(Effect):
    stage = "electronics"
    title = "gain error of the buffer"
    equation = "V_measured = (1 + error)·V"
    quantities = BOTH
    coordinates = (Coordinate("error", 1e-3),)
    parameters = (Parameter("error", "1", (-0.1, 0.1), (1e-4, 5e-3)),)
    missing = "nothing: sensitivity and zero output come out too large by the same factor, flat in f and level"
    confused_with = ("ldv_cosine",)
    separate_by = "a reference voltage in place of the sensor: what is shown too much is the gain's error"
    source = "error sources E01"
    absorbed = "a gain behind the sensor is part of the sensitivity and the zero output"

    def output(
        self, signal: NDArray[np.inexact], zero: Array, motion: Motion, channels: Channels, at: Values
    ) -> tuple[NDArray[np.inexact], Array]:
        return signal * (1.0 + at["error"]), zero * (1.0 + at["error"])

    def inverse(self, at: Values) -> Inverse:
        return Drift("", gain=at["error"], zero=at["error"])
