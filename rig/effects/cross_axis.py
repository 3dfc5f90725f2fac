"""Cross-axis: every sensor also feels a share of the next axis (x of y, y of z, z of x), as if tilted towards it."""

import math

import numpy as np

from rig.model import BOTH, NEXT, Array, Channels, Coordinate, Effect, Inverse, Motion, Parameter, Shares, Values


class CrossAxis(Effect):
    stage = "motion"
    title = "cross-axis sensitivity"
    equation = "u = u_own + share·u_next"
    quantities = BOTH
    coordinates = (Coordinate("share", 0.01),)
    parameters = (Parameter("share", "1", (-math.inf, math.inf), (0.005, 0.03)),)
    missing = "a copy of the driven axis in the axis before it, in phase, the same share at every frequency and level"
    confused_with = ("transverse_motion", "multiplexer_settling", "crosstalk")
    separate_by = "the cube turned by 90° about the driven axis, or another axis driven: a true share goes along"
    source = "error sources S03, S04; IEEE 1293"

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        whole = motion.rate if channels.rates.any() else motion.force
        return np.asarray(felt + at["share"] * whole[(channels.axis + 1) % 3])

    def inverse(self, at: Values) -> Inverse:
        return Shares(own=at["share"] * NEXT)
