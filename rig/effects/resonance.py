"""Second-order resonance of the sensing element (or, on one mounting, of the mount)."""

import math

import numpy as np

from rig.model import Array, Complexes, Coordinate, Effect, Filtered, Inverse, Parameter, Values

DAMPINGS = (0.01, 0.1)  # where a fit may start at a peak


class Resonance(Effect):
    stage = "dynamics"
    title = "second-order resonance"
    equation = "H = 1/(1 − r² + 2j·damping·r), r = f/frequency"
    quantities = ("acceleration",)
    places = ("shaker",)
    coordinates = (Coordinate("square", 1e-8), Coordinate("loss", 1e-6))  # 1/frequency² in s², 2·damping/frequency in s
    parameters = (
        Parameter("frequency", "Hz", (0.0, math.inf), (1000.0, 6000.0)),
        Parameter("damping", "1", (0.0, math.inf), (0.01, 0.7)),
    )
    missing = "gain rises as (f/f_n)² with little phase, the same at every level"
    confused_with = ("first_order_lag", "delay", "butterworth_filter", "rocking")
    separate_by = "a wider band; a remount moves the mount's resonance and leaves the element's where it is"
    rarity = 1.0
    source = "error sources S13, M03"

    def response(self, frequency: Array, at: Values) -> Complexes:
        return np.asarray(1.0 / (1.0 - at["square"] * frequency**2 + 1j * at["loss"] * frequency))

    def at_peak(self, frequency: float) -> list[dict[str, float]]:
        return [self.from_physical({"frequency": frequency, "damping": one}) for one in DAMPINGS]

    def inverse(self, at: Values) -> Inverse:
        return Filtered(lambda frequency: self.response(frequency, at))

    def physical(self, at: Values) -> dict[str, float]:
        """NaN where the coordinates are no oscillator."""
        square = at["square"]
        natural = 1.0 / math.sqrt(square) if square > 0.0 else math.nan
        return {"frequency": natural, "damping": 0.5 * at["loss"] * natural}

    def from_physical(self, values: Values) -> dict[str, float]:
        return {"square": values["frequency"] ** -2.0, "loss": 2.0 * values["damping"] / values["frequency"]}
