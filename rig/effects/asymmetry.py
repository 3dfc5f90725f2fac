"""Scale-factor asymmetry: positive and negative inputs have different sensitivities."""

import numpy as np

from rig.model import BOTH, Array, Bend, Coordinate, Effect, Inverse, Motion, Parameter, Values


class Asymmetry(Effect):
    stage = "transducer"
    title = "scale-factor asymmetry"
    equation = "V/S = u + ratio·|u|"
    quantities = BOTH
    coordinates = (Coordinate("ratio", 1e-3),)
    parameters = (Parameter("ratio", "1", (-1.0, 1.0), (5e-4, 5e-3)),)
    missing = "mean shifts by 2·ratio·A/π, lines at 2f (0.424·ratio·A) and 4f, all ∝ the level; no change of the gain"
    confused_with = ("quadratic", "saturation", "sensitivity")
    separate_by = "a second level (2f ∝ A against A², and a line at 4f); of a gyro, the table turned the other way"
    kinked = True
    source = "error sources S07, S26; IEEE 1431"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return np.asarray(u + at["ratio"] * np.abs(u))

    def inverse(self, at: Values) -> Inverse:
        return Bend(ratio=at["ratio"])
