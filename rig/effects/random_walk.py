"""Random walk of the zero: small steps by chance add up.

It is seen in spectra of records at rest, whose noise a data sheet states. What is fitted is the power, its square.
"""

from __future__ import annotations

import math

import numpy as np

from rig.model import BOTH, Array, Channels, Coordinate, Effect, Parameter, Values


class RandomWalk(Effect):
    stage = "noise"
    title = "random walk of the zero"
    equation = "S(f) = 2·coefficient²/(2π·f)², one-sided"
    quantities = BOTH
    places = ("shaker", "turntable")
    coordinates = (Coordinate("power", 1e-8, starts=(1e-10, 1e-8, 1e-6)),)
    parameters = (Parameter("coefficient", "SI/√s", (0.0, 1.0), (1e-6, 1e-3)),)
    missing = "density rises as 1/f² at the low end, Allan deviation ∝ τ^½, coefficient·√(τ/3): longer means get worse"
    confused_with = ("flicker", "temperature_bias", "warm_up")
    separate_by = "a record at rest of hours with its temperature, repeated: a walk never takes the same path"
    source = "error sources N03; IEEE 952"
    lost = "it is chance"

    def physical(self, at: Values) -> dict[str, float]:
        return {"coefficient": math.copysign(math.sqrt(abs(at["power"])), at["power"])}

    def from_physical(self, values: Values) -> dict[str, float]:
        return {"power": values["coefficient"] ** 2}

    def density(self, frequency: Array, rate: float, channels: Channels, at: Values) -> Array:
        return np.multiply.outer(channels.sensitivity**2, at["power"] * 2.0 * (2.0 * math.pi * frequency) ** -2.0)
