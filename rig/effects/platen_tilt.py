"""Tilt of the turntable: its axis leans, so gravity goes round once per revolution in the plane of the platter."""

import math

import numpy as np

from rig.model import Coordinate, Effect, Motion, Parameter, Values


class PlatenTilt(Effect):
    stage = "motion"
    title = "tilt of the turntable's axis"
    equation = "f_out = g·tilt·cos(φ − direction), f_tan = g·tilt·sin(φ − direction), φ clockwise from the index"
    places = ("turntable",)
    coordinates = (Coordinate("cosine", 1e-3), Coordinate("sine", 1e-3))
    parameters = (
        Parameter("tilt", "rad", (0.0, 0.5 * math.pi), (1e-3, 9e-3)),
        Parameter("direction", "rad", (-math.inf, math.inf), (0.0, 2.0 * math.pi)),
    )
    missing = "once per revolution on both accelerometers in the plane, 90° apart, the same size at every rate"
    confused_with = ("encoder_eccentricity", "motor_pickup", "g_sensitivity", "lever_arm")
    separate_by = "a spirit level and the coast-down: a tilt stays the same at every ω and without the motor"
    source = "error sources T09"
    elsewhere = "it belongs to the turntable"

    def motion(self, motion: Motion, at: Values) -> Motion:
        """Where the angle is unknown (NaN), nothing is added."""
        known = np.isfinite(motion.angle)
        cosine, sine = (np.where(known, turn(motion.angle), 0.0) for turn in (np.cos, np.sin))
        out, tan = at["cosine"] * cosine + at["sine"] * sine, at["sine"] * cosine - at["cosine"] * sine
        return motion.with_force(motion.gravity * (motion.outward * out + motion.tangent * tan))

    def physical(self, at: Values) -> dict[str, float]:
        """With φ = −θ: tilt·cos(φ − d) = tilt·cos d·cos θ − tilt·sin d·sin θ."""
        direction = math.atan2(-at["sine"], at["cosine"]) % (2.0 * math.pi)
        return {"tilt": math.hypot(at["cosine"], at["sine"]), "direction": direction}

    def from_physical(self, values: Values) -> dict[str, float]:
        tilt, direction = values["tilt"], values["direction"]
        return {"cosine": tilt * math.cos(direction), "sine": -tilt * math.sin(direction)}
