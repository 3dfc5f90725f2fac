"""Eccentricity of the encoder's disk: it sits beside the axis, so lines pass too fast on one side."""

import math

import numpy as np

from rig.model import Array, Coordinate, Effect, Parameter, Values


class EncoderEccentricity(Effect):
    stage = "reference"
    title = "eccentricity of the encoder's disk"
    equation = "φ_shown = φ + ratio·sin(φ − direction), φ clockwise from the index"
    places = ("turntable", "rotation")
    coordinates = (Coordinate("sine", 3e-4), Coordinate("cosine", 3e-4))
    parameters = (
        Parameter("ratio", "rad", (0.0, 1.0), (4e-4, 2e-3)),
        Parameter("direction", "rad", (-math.inf, math.inf), (0.0, 2.0 * math.pi)),
    )
    missing = "encoder less gyro once per revolution, amplitude ∝ rate, phase fixed to the index; none in whole turns"
    confused_with = ("motor_pickup", "platen_tilt", "g_sensitivity")
    separate_by = "a second speed and the coast-down: ∝ ω for the disk, independent of ω for a tilt or a field"
    source = "error sources T01; HEDS-9040 data sheet"
    elsewhere = "it belongs to the encoder of the turntable"

    def turned(self, angle: Array, at: Values) -> tuple[Array, Array, Array]:
        sine, cosine = np.sin(angle), np.cos(angle)
        shown = at["sine"] * sine + at["cosine"] * cosine
        return shown, at["sine"] * cosine - at["cosine"] * sine, -shown

    def physical(self, at: Values) -> dict[str, float]:
        """With φ = −θ: ratio·sin(φ − d) = −(ratio·cos d·sin θ + ratio·sin d·cos θ), which φ shows too much."""
        ratio = math.hypot(at["sine"], at["cosine"])
        return {"ratio": ratio, "direction": math.atan2(at["cosine"], at["sine"]) % (2.0 * math.pi)}

    def from_physical(self, values: Values) -> dict[str, float]:
        ratio, direction = values["ratio"], values["direction"]
        return {"sine": ratio * math.cos(direction), "cosine": ratio * math.sin(direction)}
