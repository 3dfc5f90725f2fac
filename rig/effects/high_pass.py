"""High-pass: a coupling capacitor or a servo lets slow signals leak away.

At f = 0 the response is taken as 1: the zero output is free anyway, and the motion of a shaker has no constant part.
"""

import math

import numpy as np

from rig.model import Array, Complexes, Coordinate, Effect, Parameter, Values


class HighPass(Effect):
    stage = "dynamics"
    title = "first-order high-pass"
    equation = "H = 1/(1 − j·corner/f), 1 at f = 0"
    quantities = ("acceleration",)
    places = ("shaker",)
    coordinates = (Coordinate("corner", 0.05),)
    parameters = (Parameter("corner", "Hz", (0.0, math.inf), (0.05, 2.0)),)
    missing = "the phase leads as corner/f and the gain falls as (corner/f)²/2, at the low end only, at every level"
    confused_with = ("drive_feedthrough", "rocking")
    separate_by = "a sweep to lower frequencies with phase: a high-pass leads, a tilt in gravity stays in phase"
    rarity = 1.0
    source = "error sources S15"
    lost = "slow signals have leaked away, and its inverse would let every error of the zero grow without end"

    def response(self, frequency: Array, at: Values) -> Complexes:
        f = np.where(frequency > 0.0, frequency, math.inf)
        return np.asarray(1.0 / (1.0 - 1j * at["corner"] / f))
