"""Moving average: each output is the mean of the input over a window that has just passed."""

import math

import numpy as np

from rig.model import BOTH, Array, Complexes, Coordinate, Effect, Filtered, Inverse, Parameter, Values


class MovingAverage(Effect):
    stage = "dynamics"
    title = "moving average"
    equation = "H = sin(π·f·window)/(π·f·window)·exp(−j·π·f·window)"
    quantities = BOTH
    # beside a delay a window of nothing moves nothing, and one of −w does what +w does: started from some real ones too
    coordinates = (Coordinate("window", 5e-5, (0.0, 3e-4, 2e-3, 1e-2)),)
    parameters = (Parameter("window", "s", (0.0, math.inf), (5e-5, 2e-2)),)
    missing = "gain falls as (π·f·window)²/6 while the phase lags as f·window/2 of a turn, exactly ∝ f, at every level"
    confused_with = ("delay", "bessel_filter", "first_order_lag", "butterworth_filter")
    separate_by = "a sweep past 1/window: the gain is zero there, no filter with poles alone is"
    rarity = 2.0
    source = "error sources S14; decimators in sigma-delta data sheets"

    def response(self, frequency: Array, at: Values) -> Complexes:
        turns = frequency * at["window"]
        return np.asarray(np.sinc(turns) * np.exp(-1j * math.pi * turns))

    def inverse(self, at: Values) -> Inverse:
        return Filtered(lambda frequency: self.response(frequency, at))
