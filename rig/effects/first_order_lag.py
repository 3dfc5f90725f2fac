"""First-order lag: one more pole between the sensor and the converter, beside the known output filter."""

import math

import numpy as np

from rig.model import BOTH, Array, Complexes, Coordinate, Effect, Filtered, Inverse, Parameter, Values


class FirstOrderLag(Effect):
    stage = "dynamics"
    title = "first-order lag"
    equation = "H = 1/(1 + j·2π·f·time_constant)"
    quantities = BOTH
    coordinates = (Coordinate("time_constant", 2e-5),)
    parameters = (Parameter("time_constant", "s", (0.0, math.inf), (2e-5, 2e-4)),)
    missing = "gain falls as (2πfτ)²/2 while the phase lags as 2πfτ, the same at every level"
    confused_with = ("delay", "butterworth_filter", "bessel_filter", "moving_average", "resonance")
    separate_by = "a wider band with magnitude and phase: the gain of a lag falls, that of a delay does not"
    source = "error sources S12"

    def response(self, frequency: Array, at: Values) -> Complexes:
        return np.asarray(1.0 / (1.0 + 2j * math.pi * at["time_constant"] * frequency))

    def inverse(self, at: Values) -> Inverse:
        return Filtered(lambda frequency: self.response(frequency, at))
