"""Full cross-axis matrix: every axis of a triad feels a share of its own of each of the two others.

`xy` is what the x axis feels of y, and so on: six shares, of which an experiment shows those of axes that it moves.
Alike in every triad; one unit's own, or one channel's, where the term says so.
"""

import math

import numpy as np

from rig.model import BOTH, Array, Channels, Coordinate, Effect, Inverse, Motion, Parameter, Shares, Values

NAMES = ("xy", "xz", "yz", "yx", "zx", "zy")  # where only sums of two show, the first three stand for them


class CrossAxisMatrix(Effect):
    stage = "motion"
    title = "cross-axis sensitivity, each axis to both others"
    equation = "u_x = f_x + xy·f_y + xz·f_z, u_y = f_y + yx·f_x + yz·f_z, u_z = f_z + zx·f_x + zy·f_y; of rates alike"
    quantities = BOTH
    entries = True
    contains = ("cross_axis", "non_orthogonality")
    rarity = 2.0  # where poses show no more than three sums, the name that says just those comes first
    coordinates = tuple(Coordinate(name, 0.01) for name in NAMES)
    parameters = tuple(Parameter(name, "1", (-math.inf, math.inf), (0.0, 0.03)) for name in NAMES)
    missing = "a copy of the driven axis in both others, in phase, shares that differ, the same at every level"
    confused_with = ("cross_axis", "reference_tilt", "non_orthogonality", "transverse_motion")
    separate_by = "the other two axes driven or set upright: each shows two of the six shares"
    source = "error sources S03, S04; IEEE 1293"

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        whole = motion.rate if channels.rates.any() else motion.force
        return np.asarray(felt + np.tensordot(_matrix(at)[channels.axis], whole, axes=1))

    def inverse(self, at: Values) -> Inverse:
        return Shares(own=_matrix(at))


def _matrix(at: Values) -> Array:
    """What row i feels of column j besides itself, (3, 3)."""
    matrix = np.zeros((3, 3))
    for name in NAMES:
        matrix["xyz".index(name[0]), "xyz".index(name[1])] = at[name]
    return matrix
