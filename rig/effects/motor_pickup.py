"""Pickup from the turntable's motor: its magnets pass by, so many times per turn, while it is driven."""

import math

import numpy as np

from rig.model import Array, Channels, Coordinate, Effect, Motion, Parameter, Values

ORDERS = tuple(range(1, 17))  # per turn: poles of usual motors, as far as ten per second show them


class MotorPickup(Effect):
    stage = "electronics"
    title = "pickup from the motor"
    equation = "V += motor·amplitude·cos(order·φ + phase), φ clockwise from the index, motor 1 while driven, else 0"
    quantities = ("rate",)
    places = ("turntable",)
    coordinates = (
        Coordinate("cosine", 1e-4),
        Coordinate("sine", 1e-4),
        Coordinate("order", 1.0, tuple(float(order) for order in ORDERS), searched=True),
    )
    parameters = (
        Parameter("amplitude", "V", (0.0, math.inf), (1e-4, 1e-3)),
        Parameter("phase", "rad", (-math.inf, math.inf), (-math.pi, math.pi)),
        Parameter("order", "1", (1.0, math.inf), (4.0, 24.0)),
    )
    missing = "a line at a whole number per turn in the gyros, amplitude independent of ω, gone in the coast-down"
    confused_with = ("encoder_eccentricity", "encoder_second_harmonic", "g_sensitivity", "platen_tilt")
    separate_by = "the coast-down: pickup ends where the motor is switched off, disk and tilt go on"
    source = "error sources S28, T18"
    elsewhere = "it belongs to the motor of the turntable"

    def added(self, motion: Motion, channels: Channels, at: Values) -> Array | None:
        turned = at["order"] * np.nan_to_num(motion.angle)  # before the index has passed the angle is unknown
        wave = motion.motor * (at["cosine"] * np.cos(turned) + at["sine"] * np.sin(turned))
        return np.broadcast_to(wave, (len(channels.names), *wave.shape))

    def physical(self, at: Values) -> dict[str, float]:
        """With φ = −θ: amplitude·cos(nφ + phase) = cosine·cos nθ + sine·sin nθ."""
        amplitude, phase = math.hypot(at["cosine"], at["sine"]), math.atan2(at["sine"], at["cosine"])
        return {"amplitude": amplitude, "phase": phase, "order": at["order"]}

    def from_physical(self, values: Values) -> dict[str, float]:
        amplitude, phase = values["amplitude"], values["phase"]
        return {"cosine": amplitude * math.cos(phase), "sine": amplitude * math.sin(phase), "order": values["order"]}
