"""Quadratic nonlinearity: the output bends one way for both signs; vibration is rectified."""

import math

import numpy as np

from rig.model import BOTH, Array, Bend, Coordinate, Effect, Inverse, Motion, Parameter, Values


class Quadratic(Effect):
    stage = "transducer"
    title = "quadratic nonlinearity"
    equation = "V/S = u + coefficient·u²"
    quantities = BOTH
    coordinates = (Coordinate("coefficient", 1e-4),)
    parameters = (Parameter("coefficient", "1/(SI)", (-math.inf, math.inf), (5e-5, 5e-4)),)
    missing = "a line at 2f and a shift of the mean, both growing as the square of the level; of a gyro, a part ∝ ω²"
    confused_with = ("asymmetry", "g_sensitivity", "saturation")
    separate_by = "a second level (square law against linear); of a gyro, a second radius or the cube turned by 90°"
    source = "error sources S05, S26; vibration rectification in IEEE 1293"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return np.asarray(u + at["coefficient"] * u**2)

    def inverse(self, at: Values) -> Inverse:
        return Bend(quadratic=at["coefficient"])
