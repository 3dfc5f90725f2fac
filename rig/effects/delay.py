"""Pure delay: the output is right, but late by the same time at every frequency."""

import math

import numpy as np

from rig.model import BOTH, Array, Complexes, Coordinate, Effect, Filtered, Inverse, Parameter, Values


class Delay(Effect):
    stage = "dynamics"
    title = "pure delay"
    equation = "H = exp(−j·2π·f·time)"
    quantities = BOTH
    coordinates = (Coordinate("time", 5e-6),)
    parameters = (Parameter("time", "s", (0.0, math.inf), (5e-6, 2e-2)),)
    missing = "the phase lags exactly ∝ f, in every channel of this quantity alike, while the gain is right at every f"
    confused_with = ("ldv_delay", "channel_skew", "first_order_lag", "butterworth_filter", "moving_average")
    separate_by = "a wider band with magnitude and phase, and the scan in another order: skew goes with the slot"
    source = "error sources S16; digital units state 1 to 20 ms (register map of the MPU-6000 family, DLPF_CFG)"

    def response(self, frequency: Array, at: Values) -> Complexes:
        return np.asarray(np.exp(-2j * math.pi * frequency * at["time"]))

    def inverse(self, at: Values) -> Inverse:
        return Filtered(lambda frequency: self.response(frequency, at))
