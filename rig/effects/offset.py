"""Offset: the output is shifted by a constant input that is not there."""

import numpy as np

from rig.model import BOTH, Array, Bend, Coordinate, Effect, Inverse, Motion, Parameter, Values


class Offset(Effect):
    stage = "transducer"
    title = "offset"
    equation = "V/S = u + shift"
    quantities = BOTH
    coordinates = (Coordinate("shift", 0.01),)
    parameters = (Parameter("shift", "SI", (-100.0, 100.0), (0.01, 1.5)),)
    missing = "a constant shift of the mean, the same at every frequency, level, rate and angle"
    confused_with = ("temperature_bias", "warm_up", "quadratic")
    separate_by = "a tumble or the unit inverted, which turns the input's sign: the fit takes it up as zero output"
    source = "error sources S01"
    absorbed = "the zero output is fitted: a constant shift is part of it"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return np.asarray(u + at["shift"])

    def inverse(self, at: Values) -> Inverse:
        return Bend(shift=at["shift"])
