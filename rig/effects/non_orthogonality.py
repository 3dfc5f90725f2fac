"""Non-orthogonality: the three sensitive axes of a triad are not square to each other.

The case's own axes are laid through the triad: z along its z axis, y in the plane of its y and z axes. Three small
angles are left; `yz` turns the x axis about z (towards y), `zy` the x axis about y (away from z), `zx` the y axis about
x (towards z). Names and signs as published, where they take what a triad shows to square axes:
f = [[1, −yz, zy], [0, 1, −zx], [0, 0, 1]]·u.
"""

import numpy as np

from rig.model import BOTH, Array, Channels, Coordinate, Effect, Inverse, Motion, Parameter, Shares, Values


class NonOrthogonality(Effect):
    stage = "motion"
    title = "axes that are not square to each other"
    equation = "u_x = f_x + yz·u_y − zy·u_z, u_y = f_y + zx·u_z, u_z = f_z"
    quantities = BOTH
    places = ("poses",)
    coordinates = (Coordinate("yz", 0.001), Coordinate("zy", 0.001), Coordinate("zx", 0.001))
    parameters = (
        Parameter("yz", "rad", (-0.5, 0.5), (0.002, 0.03)),
        Parameter("zy", "rad", (-0.5, 0.5), (0.002, 0.03)),
        Parameter("zx", "rad", (-0.5, 0.5), (0.002, 0.03)),
    )
    missing = "the magnitude of gravity changes with the attitude as a product of two axes, most halfway between them"
    confused_with = ("cross_axis", "asymmetry", "cubic")
    separate_by = "poses on edges and corners: products of two axes vanish where one axis stands upright"
    source = "Skog and Händel 2006, IMEKO XVIII; Tedaldi, Pretto and Menegatti 2014, ICRA, eq. 1–3"

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        _, y, z = motion.rate if channels.rates.any() else motion.force
        y_more = at["zx"] * z
        more = np.stack([at["yz"] * (y + y_more) - at["zy"] * z, y_more, np.zeros_like(z)])
        return np.asarray(felt + more[channels.axis])

    def inverse(self, at: Values) -> Inverse:
        own = np.array([[0.0, at["yz"], at["yz"] * at["zx"] - at["zy"]], [0.0, 0.0, at["zx"]], [0.0, 0.0, 0.0]])
        return Shares(own=own)
