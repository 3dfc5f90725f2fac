"""Four-pole Butterworth low-pass in the output: as flat as can be below the corner, but late."""

import math

import numpy as np

from rig.model import BOTH, Array, Complexes, Coordinate, Effect, Filtered, Inverse, Parameter, Values


class ButterworthFilter(Effect):
    stage = "dynamics"
    title = "four-pole Butterworth filter"
    equation = "H = 1/((s² + 0.76537·s + 1)·(s² + 1.84776·s + 1)), s = j·f/corner"
    quantities = BOTH
    coordinates = (Coordinate("period", 2e-5),)  # 1/corner in s
    parameters = (Parameter("corner", "Hz", (0.0, math.inf), (1000.0, 5000.0)),)
    missing = "the phase lags as 0.416·f/corner of a turn while the gain only falls as (f/corner)⁸/2, at every level"
    confused_with = ("delay", "bessel_filter", "moving_average", "first_order_lag", "resonance")
    rarity = 0.5  # far above the band it shows nothing that a plain delay does not
    separate_by = "a sweep past the corner: the gain of the filter falls there, that of a delay does not"
    source = "error sources S14; Butterworth, Wireless Engineer 7 (1930)"

    def response(self, frequency: Array, at: Values) -> Complexes:
        s = 1j * at["period"] * frequency
        return np.asarray(1.0 / ((s**2 + 0.76537 * s + 1.0) * (s**2 + 1.84776 * s + 1.0)))

    def inverse(self, at: Values) -> Inverse:
        return Filtered(lambda frequency: self.response(frequency, at))

    def physical(self, at: Values) -> dict[str, float]:
        """NaN where the coordinate is no filter."""
        return {"corner": 1.0 / at["period"] if at["period"] > 0.0 else math.nan}

    def from_physical(self, values: Values) -> dict[str, float]:
        return {"period": 1.0 / values["corner"]}
