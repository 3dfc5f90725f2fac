"""Odd quadratic nonlinearity: the sensitivity grows or falls with the size of the input, alike for both signs."""

import math

import numpy as np

from rig.model import BOTH, Array, Bend, Coordinate, Effect, Inverse, Motion, Parameter, Values


class OddQuadratic(Effect):
    stage = "transducer"
    title = "odd quadratic nonlinearity"
    equation = "V/S = u + coefficient·u·|u|"
    quantities = BOTH
    coordinates = (Coordinate("coefficient", 5e-5),)
    parameters = (Parameter("coefficient", "1/(SI)", (-math.inf, math.inf), (1e-5, 3e-4)),)
    missing = "gain changes by 0.849·coefficient·A and a line at 3f grows as 0.170·A², in phase; nothing at 0 and 2f"
    confused_with = ("cubic", "dead_zone", "quadratic")
    separate_by = "a third level: gain ∝ A against ∝ A² (cubic) or ∝ 1/A (dead zone)"
    rarity = 2.0
    source = "error sources S07; IEEE 1293"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return np.asarray(u + at["coefficient"] * u * np.abs(u))

    def inverse(self, at: Values) -> Inverse:
        return Bend(odd_quadratic=at["coefficient"])
