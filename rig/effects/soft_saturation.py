"""Soft saturation: gain falls off gradually towards a limit, the more sharply the larger the exponent."""

import math

import numpy as np

from rig.model import BOTH, Array, Coordinate, Effect, Motion, Parameter, Values

AT = 5.0  # SI: the input at which a fit counts the loss of gain, to which all that is small is proportional


class SoftSaturation(Effect):
    """With an exponent of 2 it begins as a cubic does, without end it is the hard limit."""

    stage = "transducer"
    title = "soft saturation"
    equation = "V/S = u/(1 + |u/limit|^sharpness)^(1/sharpness)"
    quantities = BOTH
    coordinates = (
        Coordinate("loss", 0.002),
        Coordinate("sharpness", 0.05, starts=(2.5, 4.0, 6.0, 9.0, 14.0, 22.0), shape=True),
    )
    parameters = (
        Parameter("limit", "SI", (0.0, math.inf), (4.0, 20.0)),
        Parameter("sharpness", "1", (1.0, math.inf), (3.0, 30.0)),
    )
    missing = "rounded tops: gain falls with the level, slowly at first, faster than a cubic's later; lines at 3f, 5f"
    confused_with = ("saturation", "cubic", "odd_quadratic")
    separate_by = "three levels and more up to the limit: the law of the third line by level, and no pile-up of samples"
    beside = (("saturation", "cubic", "odd_quadratic"),)
    contains = ("saturation", "cubic", "odd_quadratic")
    source = "error sources S09; Rapp 1991, Second European Conference on Satellite Communications, ESA SP-332"
    lost = "near the limit the output is nearly the same for every input"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        sharpness = at["sharpness"]
        with np.errstate(all="ignore"):  # a fit that went too far finds no numbers, and turns back
            return np.asarray(u * (1.0 + sharpness * at["loss"] * np.abs(u / AT) ** sharpness) ** (-1.0 / sharpness))

    def physical(self, at: Values) -> dict[str, float]:
        """loss = (5 SI/limit)^sharpness/sharpness; a gain that grows has no limit, and is said as one below nought."""
        loss, sharpness = at["loss"], at["sharpness"]
        size = AT * abs(sharpness * loss) ** (-1.0 / sharpness) if loss else math.inf
        return {"limit": math.copysign(size, loss), "sharpness": sharpness}

    def from_physical(self, values: Values) -> dict[str, float]:
        limit, sharpness = values["limit"], values["sharpness"]
        return {"loss": math.copysign((AT / abs(limit)) ** sharpness / sharpness, limit), "sharpness": sharpness}
