"""Second harmonic of the encoder: a tilted or oval disk lets lines pass too fast twice per turn."""

import math

import numpy as np

from rig.model import Array, Coordinate, Effect, Parameter, Values


class EncoderSecondHarmonic(Effect):
    stage = "reference"
    title = "tilt or ellipticity of the encoder's disk"
    equation = "φ_shown = φ + ratio·sin(2·(φ − direction)), φ clockwise from the index"
    places = ("turntable", "rotation")
    coordinates = (Coordinate("sine", 5e-5), Coordinate("cosine", 5e-5))
    parameters = (
        Parameter("ratio", "rad", (0.0, 1.0), (4e-5, 6e-4)),
        Parameter("direction", "rad", (-math.inf, math.inf), (0.0, math.pi)),
    )
    missing = "encoder less gyro twice per turn, amplitude ∝ rate, phase fixed to the index; nothing in whole turns"
    confused_with = ("motor_pickup", "encoder_eccentricity", "encoder_graduation")
    separate_by = "a second speed and the coast-down: ∝ ω for the disk, and still there without the motor"
    rarity = 1.0
    source = "error sources T02"
    elsewhere = "it belongs to the encoder of the turntable"

    def turned(self, angle: Array, at: Values) -> tuple[Array, Array, Array]:
        sine, cosine = np.sin(2.0 * angle), np.cos(2.0 * angle)
        shown = at["sine"] * sine + at["cosine"] * cosine
        return shown, 2.0 * (at["sine"] * cosine - at["cosine"] * sine), -4.0 * shown

    def physical(self, at: Values) -> dict[str, float]:
        """With φ = −θ: ratio·sin 2(φ − d) = −(ratio·cos 2d·sin 2θ + ratio·sin 2d·cos 2θ)."""
        ratio = math.hypot(at["sine"], at["cosine"])
        return {"ratio": ratio, "direction": 0.5 * math.atan2(at["cosine"], at["sine"]) % math.pi}

    def from_physical(self, values: Values) -> dict[str, float]:
        ratio, direction = values["ratio"], values["direction"]
        return {"sine": ratio * math.cos(2.0 * direction), "cosine": ratio * math.sin(2.0 * direction)}
