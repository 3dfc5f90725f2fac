"""Cubic nonlinearity: the sensitivity grows or falls with the square of the input, alike for both signs."""

import math

import numpy as np

from rig.model import BOTH, Array, Bend, Coordinate, Effect, Inverse, Motion, Parameter, Values


class Cubic(Effect):
    stage = "transducer"
    title = "cubic nonlinearity"
    equation = "V/S = u + coefficient·u³"
    quantities = BOTH
    coordinates = (Coordinate("coefficient", 1e-5),)
    parameters = (Parameter("coefficient", "1/(SI)²", (-math.inf, math.inf), (3e-6, 3e-5)),)
    missing = "gain changes by ¾·coefficient·A² and a line at 3f grows as A³/4, in phase, the same at every frequency"
    confused_with = ("odd_quadratic", "saturation", "resonance")
    separate_by = "two levels at two frequencies: gain ∝ A² against ∝ A (odd quadratic) or ∝ f² (resonance)"
    source = "error sources S06, S26; IEEE 1293"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return np.asarray(u + at["coefficient"] * (u * u * u))

    def inverse(self, at: Values) -> Inverse:
        return Bend(cubic=at["coefficient"])
