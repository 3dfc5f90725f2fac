"""High-pass: a coupling capacitor or a servo lets slow signals leak away.

What has leaked away stays away: while the platter turns, ω²r and its share of gravity are forgotten with the time
constant 1/(2π·corner), and what was forgotten comes back as it stops. A run begins with a cube that stands for long. On
the shaker the response is taken as 1 at f = 0: the zero output is free anyway, and the motion has no constant part.
"""

import math

from rig.model import Coordinate, Effect, Parameter, Values


class HighPass(Effect):
    stage = "dynamics"
    title = "first-order high-pass"
    equation = "H = 1/(1 − j·corner/f), 1 at f = 0 of the shaker"
    quantities = ("acceleration",)
    places = ("shaker", "turntable")
    coordinates = (Coordinate("corner", 0.05, starts=(0.0, 0.1)),)
    parameters = (Parameter("corner", "Hz", (0.0, math.inf), (0.05, 2.0)),)
    missing = (
        "the phase leads as corner/f and the gain falls as (corner/f)²/2, at the low end only, at every level; on a "
        "platter that goes on turning the centripetal acceleration fades, and shows with the other sign as it stops"
    )
    confused_with = ("drive_feedthrough", "rocking")
    separate_by = "a sweep to lower frequencies with phase: a high-pass leads, a tilt in gravity stays in phase"
    rarity = 1.0
    source = "error sources S15"
    lost = "slow signals have leaked away, and its inverse would let every error of the zero grow without end"

    def leaks(self, at: Values) -> float:
        return at["corner"]
