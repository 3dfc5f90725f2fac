"""Dead zone: small inputs are not felt, larger ones are felt less by its width."""

import math

import numpy as np

from rig.model import BOTH, Array, Coordinate, Effect, Motion, Parameter, Values


class DeadZone(Effect):
    stage = "transducer"
    title = "dead zone"
    equation = "V/S = sign(u)·max(|u| − width, 0)"
    quantities = BOTH
    coordinates = (Coordinate("width", 2e-3),)
    parameters = (Parameter("width", "SI", (0.0, math.inf), (0.002, 0.05)),)
    missing = "the amplitude is short by 4·width/π at every level: gain falls as 1/A, no phase; a fixed line at 3f"
    confused_with = ("hysteresis", "odd_quadratic", "cubic")
    separate_by = "levels towards zero: amplitude a straight line with a negative intercept, without hysteresis' lag"
    kinked = True
    source = "error sources S10"
    lost = "inputs smaller than the width leave no trace"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        """A width below zero continues it straight, u − sign(u)·width, so that it has a slope at zero."""
        return np.asarray(np.sign(u) * np.maximum(np.abs(u) - at["width"], 0.0))
