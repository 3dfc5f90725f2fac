"""Rocking: the shaker's table also turns about the vertical, most at a mode, so points beside the vibrometer's spot
move differently and gyros feel it."""

import math
from dataclasses import replace

import numpy as np

from rig.model import Array, Channels, Complexes, Coordinate, Effect, Motion, Parameter, Values

FREQUENCIES = tuple(float(f) for f in np.geomspace(90.0, 1000.0, 16).round(1))  # Hz, where a fit may start


class Rocking(Effect):
    stage = "motion"
    title = "rocking of the shaker's table"
    equation = "α = ratio·a/(1 − r² + 2j·damping·r), r = f/frequency; u = a + α·side"
    places = ("shaker",)
    coordinates = (
        Coordinate("ratio", 0.05),
        Coordinate("frequency", 2.0, starts=FREQUENCIES, shape=True),
        Coordinate("damping", 0.005, starts=(0.03, 0.12), shape=True),
    )
    parameters = (
        Parameter("ratio", "1/m", (-math.inf, math.inf), (0.1, 5.0)),
        Parameter("frequency", "Hz", (0.0, math.inf), (150.0, 900.0)),
        Parameter("damping", "1", (0.0, math.inf), (0.02, 0.1)),
    )
    missing = "gain and phase ripple about one frequency, ∝ distance from the spot, opposite on either side; gyros too"
    confused_with = ("resonance", "transverse_motion", "gravity_tilt")
    separate_by = "the vibrometer's spot moved to the other side: the error of rocking turns its sign"
    source = "error sources M01; ISO 16063-21"
    elsewhere = "it belongs to the shaker's table"

    def motion(self, motion: Motion, at: Values) -> Motion:
        up, alpha = motion.up[:, :, None], _alpha(motion.harmonics, at)
        omega = 2.0 * math.pi * motion.harmonics
        turned = np.divide(alpha, 1j * omega, out=np.zeros_like(alpha), where=omega > 0.0)
        rate, turning = motion.driven_by(turned), motion.driven_by(alpha)
        return replace(motion, rate=motion.rate + up * rate, turning=motion.turning + up * turning)

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        side = np.where(channels.rates | np.isnan(channels.side), 0.0, channels.side)
        share = side[:, None] * motion.drive[channels.axis]
        return np.asarray(felt + share[:, :, None] * motion.driven_by(_alpha(motion.harmonics, at)))


def _alpha(f: Array, at: Values) -> Complexes:
    """Angular acceleration per acceleration, 1/m, shape of `f` (Hz)."""
    if at["ratio"] == 0.0:
        return np.zeros(f.shape, np.complex128)
    r = f / at["frequency"]
    return np.asarray(at["ratio"] / (1.0 - r**2 + 2j * at["damping"] * r), np.complex128)
