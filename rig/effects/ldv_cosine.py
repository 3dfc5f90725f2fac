"""Cosine of the vibrometer's beam: at an angle to the motion it sees only the component along itself."""

import math

from rig.model import Array, Complexes, Coordinate, Effect, Parameter, Values


class LdvCosine(Effect):
    stage = "reference"
    instrument = "vibrometer"
    title = "angle of the vibrometer's beam"
    equation = "a = a_shown/cos(angle)"
    places = ("shaker",)
    coordinates = (Coordinate("angle", 0.02),)
    parameters = (Parameter("angle", "rad", (0.0, 0.5), (0.002, 0.05)),)
    missing = "nothing: all sensitivities come out too large by 1/cos(angle), flat in f and level"
    confused_with = ("buffer_gain", "ldv_gain_step")
    separate_by = "the beam turned on purpose in two directions: the cosine's maximum is the true alignment"
    source = "error sources L01; ISO 16063-41"
    elsewhere = "it belongs to the vibrometer"
    absorbed = "the cosine of the beam's angle is part of the sensitivity"

    def shaken(self, along: Complexes, frequency: Array, scale: Array, at: Values) -> Complexes:
        return along / math.cos(at["angle"])
