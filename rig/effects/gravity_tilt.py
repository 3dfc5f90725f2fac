"""Gravity through tilt: a table that is driven level tilts as it moves out, and gravity comes in along the drive."""

import math

import numpy as np

from rig.model import Coordinate, Effect, Motion, Parameter, Values


class GravityTilt(Effect):
    stage = "motion"
    title = "gravity through the table's tilt"
    equation = "u = a + g·per_metre·x, x = −a/ω²"
    places = ("shaker",)
    coordinates = (Coordinate("per_metre", 1.0),)
    parameters = (Parameter("per_metre", "rad/m", (-math.inf, math.inf), (0.1, 10.0)),)
    missing = "gain error ∝ 1/f², only at the low end of the band, in phase, the same at every level and for all units"
    confused_with = ("rocking", "dead_zone")
    separate_by = "lower frequencies with magnitude and phase (a high-pass leads, a tilt does not), or an upright drive"
    rarity = 1.0
    source = "error sources M10; ISO 16063-11"
    elsewhere = "it belongs to the shaker's table"

    def motion(self, motion: Motion, at: Values) -> Motion:
        omega = 2.0 * math.pi * motion.harmonics
        per_acceleration = np.divide(-1.0, omega**2, out=np.zeros_like(omega), where=omega > 0.0)
        tilt = at["per_metre"] * motion.driven_by(per_acceleration.astype(np.complex128))
        return motion.with_force(motion.drive[:, :, None] * motion.gravity * tilt)
