"""Warm-up: the zero output settles exponentially. Time counts from the beginning of the first record of a session
(runs that follow one another closely), so `shift` is what was left then."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.model import BOTH, Array, Channels, Coordinate, Drift, Effect, Inverse, Motion, Parameter, Values


class WarmUp(Effect):
    stage = "transducer"
    title = "warm-up"
    equation = "V₀(t) = V₀ + S·shift·exp(−t/time_constant), t since the first record of the session began"
    quantities = BOTH
    coordinates = (
        Coordinate("shift", 0.01),
        Coordinate("time_constant", 5.0, starts=(60.0, 150.0, 350.0, 800.0), shape=True),
    )
    parameters = (
        Parameter("shift", "SI", (-math.inf, math.inf), (0.005, 0.05)),
        Parameter("time_constant", "s", (0.0, math.inf), (60.0, 600.0)),
    )
    missing = "the mean drifts fast at first, then ever slower, with time and not with temperature or input; gain stays"
    confused_with = ("temperature_bias", "offset", "supply_ratio")
    separate_by = "a second start from cold, or records repeated an hour later: it repeats after power-on, then ends"
    source = "error sources S20"

    def output(
        self, signal: NDArray[np.inexact], zero: Array, motion: Motion, channels: Channels, at: Values
    ) -> tuple[NDArray[np.inexact], Array]:
        if at["shift"] == 0.0:
            return signal, zero
        left = at["shift"] * np.exp(-motion.elapsed / at["time_constant"])
        return signal, zero + channels.sensitivity[:, None] * left

    def inverse(self, at: Values) -> Inverse:
        return Drift("time", decay=at["time_constant"], shift=at["shift"])
