"""Axis offset: the three accelerometers of one unit do not sense at one point (size effect)."""

import math

import numpy as np

from rig.model import Array, Channels, Coordinate, Effect, Inverse, Motion, Parameter, Values, arms
from rig.motion import rigid

TOWARDS = (np.eye(3) + np.roll(np.eye(3), 1, axis=1)) / np.sqrt(2.0)  # rows (e_i + e_next)/√2


class AxisOffset(Effect):
    stage = "motion"
    title = "offset of the axes' sensing points"
    equation = "u_i = f_i + (α×r_i + ω×(ω×r_i))_i, r_i = offset·(e_i + e_next)/√2"
    quantities = ("acceleration",)
    places = ("turntable",)
    coordinates = (Coordinate("offset", 1e-3),)
    parameters = (Parameter("offset", "m", (-math.inf, math.inf), (5e-4, 5e-3)),)
    missing = "accelerometer error ∝ ω² and ∝ angular acceleration, different for each axis: no single radius fits"
    confused_with = ("lever_arm", "cross_axis", "quadratic")
    separate_by = "the unit turned by 90° on the platter: the differences between its axes go with the unit"
    rarity = 4.0
    source = "error sources S30"

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        own = np.stack([rigid(motion, at["offset"] * TOWARDS[i])[i] for i in range(3)])
        return np.asarray(felt + own[channels.axis])

    def inverse(self, at: Values) -> Inverse:
        return arms(at["offset"] * TOWARDS)
