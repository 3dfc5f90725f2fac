"""Lever arm: the accelerometers sit beside the point whose radius is known."""

import math

import numpy as np

from rig.model import Array, Channels, Coordinate, Effect, Inverse, Motion, Parameter, Values, arms
from rig.motion import rigid


class LeverArm(Effect):
    stage = "motion"
    title = "lever arm"
    equation = "u = f + α×r + ω×(ω×r), r = (x, y, z)"
    quantities = ("acceleration",)
    places = ("turntable", "rotation", "free")
    coordinates = (Coordinate("x", 2e-3), Coordinate("y", 2e-3), Coordinate("z", 2e-3))
    parameters = (
        Parameter("length", "m", (0.0, math.inf), (1e-3, 0.01)),
        Parameter("direction", "rad", (-math.inf, math.inf), (0.0, 2.0 * math.pi)),  # from z towards x
        Parameter("y", "m", (-math.inf, math.inf), (1e-3, 0.01)),
    )
    missing = "accelerometer error ∝ ω² for either direction of turning, and ∝ angular acceleration 90° further round"
    confused_with = ("axis_offset", "quadratic", "cross_axis", "platen_tilt")
    separate_by = "a second known radius: the arm stays the same where a wrong sensitivity grows with the radius"
    source = "error sources T15, T16, S30"

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        return np.asarray(felt + rigid(motion, np.array([at["x"], at["y"], at["z"]]))[channels.axis])

    def inverse(self, at: Values) -> Inverse:
        return arms(np.tile([at["x"], at["y"], at["z"]], (3, 1)))

    def physical(self, at: Values) -> dict[str, float]:
        """x = length·sin(direction), z = length·cos(direction)."""
        direction = math.atan2(at["x"], at["z"]) % (2.0 * math.pi)
        return {"length": math.hypot(at["x"], at["z"]), "direction": direction, "y": float(at["y"])}

    def from_physical(self, values: Values) -> dict[str, float]:
        length, direction = values["length"], values["direction"]
        return {"x": length * math.sin(direction), "y": float(values["y"]), "z": length * math.cos(direction)}
