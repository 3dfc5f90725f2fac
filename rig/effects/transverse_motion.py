"""Transverse motion: the shaker's table also moves up and down, most at a mode."""

import math

import numpy as np

from rig.model import Coordinate, Effect, Motion, Parameter, Values

FREQUENCIES = tuple(float(f) for f in np.geomspace(90.0, 1000.0, 16).round(1))  # Hz, where a fit may start


class TransverseMotion(Effect):
    stage = "motion"
    title = "transverse motion of the shaker"
    equation = "a_up = ratio·a/(1 − r² + 2j·damping·r), r = f/frequency"
    places = ("shaker",)
    coordinates = (
        Coordinate("ratio", 2e-3),
        Coordinate("frequency", 2.0, starts=FREQUENCIES, shape=True),
        Coordinate("damping", 0.005, starts=(0.03, 0.12), shape=True),
    )
    parameters = (
        Parameter("ratio", "1", (-math.inf, math.inf), (0.005, 0.05)),
        Parameter("frequency", "Hz", (0.0, math.inf), (150.0, 900.0)),
        Parameter("damping", "1", (0.0, math.inf), (0.02, 0.1)),
    )
    missing = "a line at f on the upright accelerometers, with a peak and a turn of phase at one frequency, ∝ the level"
    confused_with = ("cross_axis", "crosstalk", "rocking")
    separate_by = "the cube turned by 180° about the drive: true motion turns its sign, a cross-axis share does not"
    rarity = 1.0
    source = "error sources M02; ISO 16063-21"
    elsewhere = "it belongs to the shaker's table"

    def motion(self, motion: Motion, at: Values) -> Motion:
        if at["ratio"] == 0.0:
            return motion
        r = motion.harmonics / at["frequency"]
        upward = motion.driven_by(np.asarray(at["ratio"] / (1.0 - r**2 + 2j * at["damping"] * r), np.complex128))
        return motion.with_force(motion.up[:, :, None] * upward)
