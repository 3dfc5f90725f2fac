"""Three-pole Bessel low-pass in the output: every frequency is equally late, and the gain droops early."""

import math

import numpy as np

from rig.model import BOTH, Array, Complexes, Coordinate, Effect, Filtered, Inverse, Parameter, Values

HALF_POWER = 1.755672  # rad/s, where a three-pole Bessel filter of 1 s delay is 3 dB down


class BesselFilter(Effect):
    stage = "dynamics"
    title = "three-pole Bessel filter"
    equation = "H = 15/(s³ + 6·s² + 15·s + 15), s = 1.755672·j·f/corner"
    quantities = BOTH
    coordinates = (Coordinate("period", 2e-5),)  # 1/corner in s
    parameters = (Parameter("corner", "Hz", (0.0, math.inf), (1000.0, 5000.0)),)
    missing = "gain falls as 0.31·(f/corner)² while the phase lags as 0.279·f/corner of a turn, the same at every level"
    confused_with = ("first_order_lag", "moving_average", "butterworth_filter", "delay", "ldv_low_pass")
    separate_by = "a sweep past the corner: three poles fall faster than one and have no zeros as a moving average has"
    rarity = 2.0
    source = "error sources S14, L03; Thomson, Proc. IEE 96 (1949)"

    def response(self, frequency: Array, at: Values) -> Complexes:
        s = HALF_POWER * 1j * at["period"] * frequency
        return np.asarray(15.0 / (s**3 + 6.0 * s**2 + 15.0 * s + 15.0))

    def inverse(self, at: Values) -> Inverse:
        return Filtered(lambda frequency: self.response(frequency, at))

    def physical(self, at: Values) -> dict[str, float]:
        """NaN where the coordinate is no filter."""
        return {"corner": 1.0 / at["period"] if at["period"] > 0.0 else math.nan}

    def from_physical(self, values: Values) -> dict[str, float]:
        return {"period": 1.0 / values["corner"]}
