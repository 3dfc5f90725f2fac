"""White noise: every sample by chance, none knows of the one before.

It is seen in spectra of records at rest, whose noise a data sheet states. What is fitted is the power, its square.
"""

from __future__ import annotations

import math

import numpy as np

from rig.model import BOTH, Array, Channels, Coordinate, Effect, Parameter, Values


class White(Effect):
    stage = "noise"
    title = "white noise"
    equation = "S(f) = density² at every f, one-sided; rms = density·√(f_sampling/2)"
    quantities = BOTH
    places = ("shaker", "turntable")
    coordinates = (Coordinate("power", 1e-8, starts=(1e-10, 1e-8, 1e-6)),)
    parameters = (Parameter("density", "(SI)/√Hz", (0.0, 1.0), (2.5e-6, 1e-3)),)
    missing = "residuals without correlation: density flat in f, Allan deviation ∝ τ^−½, the same at every level"
    confused_with = ("quantisation", "flicker", "ldv_dropout")
    separate_by = "a record at rest, and one with the input shorted: what stays is the converter's"
    source = "error sources N01; IEEE 952"
    lost = "it is chance"

    def physical(self, at: Values) -> dict[str, float]:
        return {"density": math.copysign(math.sqrt(abs(at["power"])), at["power"])}

    def from_physical(self, values: Values) -> dict[str, float]:
        return {"power": values["density"] ** 2}

    def density(self, frequency: Array, rate: float, channels: Channels, at: Values) -> Array:
        return np.multiply.outer(channels.sensitivity**2, at["power"] * np.ones_like(frequency))
