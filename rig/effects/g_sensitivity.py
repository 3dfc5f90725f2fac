"""Linear g-sensitivity of a gyro: it takes specific force along the next axis (y for x, z for y, x for z) for rate."""

import math

import numpy as np

from rig.model import NEXT, Array, Channels, Coordinate, Effect, Inverse, Motion, Parameter, Shares, Values


class GSensitivity(Effect):
    stage = "transducer"
    title = "linear g-sensitivity"
    equation = "u = ω + coefficient·f_next"
    quantities = ("rate",)
    places = ("shaker", "turntable", "rotation", "free", "poses")
    coordinates = (Coordinate("coefficient", 1e-4),)
    parameters = (Parameter("coefficient", "(rad/s)/(m/s²)", (-math.inf, math.inf), (1.8e-5, 3.6e-4)),)
    missing = "gyro error ∝ ω²·r where the next axis is radial, ∝ angular acceleration where tangential, else constant"
    confused_with = ("quadratic", "cross_axis", "offset", "platen_tilt")
    separate_by = "a second radius or the unit turned by 180° on the platter: ∝ r and turning its sign, unlike K₂ω²"
    source = "error sources S23; IEEE 1431"

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        return np.asarray(felt + at["coefficient"] * motion.force[(channels.axis + 1) % 3])

    def inverse(self, at: Values) -> Inverse:
        return Shares(force=at["coefficient"] * NEXT)
