"""Sensitivity: the whole output is larger or smaller by one factor."""

import numpy as np

from rig.model import BOTH, Array, Bend, Coordinate, Effect, Inverse, Motion, Parameter, Values


class Sensitivity(Effect):
    stage = "transducer"
    title = "relative change of the sensitivity"
    equation = "V/S = (1 + relative)·u"
    quantities = BOTH
    coordinates = (Coordinate("relative", 0.01),)
    parameters = (Parameter("relative", "1", (-0.5, 0.5), (0.001, 0.05)),)
    missing = "an error in proportion to the input, in phase, the same share at every frequency, level and rate"
    confused_with = ("temperature_scale", "supply_ratio", "asymmetry")
    separate_by = "a reference of another kind (gravity in a tumble, whole turns): the fit takes it up as S"
    source = "error sources section 0, M0; L01, L02"
    absorbed = "the sensitivity is fitted: a relative change of it is part of S"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return np.asarray((1.0 + at["relative"]) * u)

    def inverse(self, at: Values) -> Inverse:
        return Bend(relative=at["relative"])
