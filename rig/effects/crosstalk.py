"""Capacitive crosstalk: every channel also sees how fast the next axis (x of y, y of z, z of x) changes."""

import math

import numpy as np

from rig.model import BOTH, NEXT, Array, Channels, Coordinate, Effect, Inverse, Motion, Parameter, Shares, Values


class Crosstalk(Effect):
    stage = "electronics"
    title = "capacitive crosstalk"
    equation = "u = u_own + time_constant·du_next/dt"
    quantities = BOTH
    places = ("shaker",)
    coordinates = (Coordinate("time_constant", 1e-6),)
    parameters = (Parameter("time_constant", "s", (-math.inf, math.inf), (3e-8, 3e-6)),)
    missing = "a copy of the driven axis in the axis before it, a quarter turn ahead and ∝ f, the same at every level"
    confused_with = ("cross_axis", "multiplexer_settling", "channel_skew")
    separate_by = "a sweep with phase: crosstalk is ∝ f at a quarter turn, a cross-axis share flat and in phase"
    rarity = 1.0
    source = "error sources E08"

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        whole = motion.rate if channels.rates.any() else motion.force
        return np.asarray(felt + at["time_constant"] * motion.grid.rise(whole)[(channels.axis + 1) % 3])

    def inverse(self, at: Values) -> Inverse:
        return Shares(own_rise=at["time_constant"] * NEXT)
