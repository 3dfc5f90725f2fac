"""Spur: one narrow line in the noise, of the sensor's own clock or of something that hums nearby.

A test of its own looks for lines in records at rest; what it finds is held against their spectra.
"""

from __future__ import annotations

import numpy as np

from rig.model import BOTH, Array, Channels, Coordinate, Effect, Parameter, Values


class Spur(Effect):
    stage = "noise"
    title = "spurious line"
    equation = "u += amplitude·cos(2π·frequency·t + any phase)"
    quantities = BOTH
    places = ("shaker", "turntable")
    coordinates = (Coordinate("amplitude", 1e-3), Coordinate("frequency", 1.0, searched=True))
    parameters = (
        Parameter("amplitude", "SI", (0.0, 10.0), (1e-4, 1e-1)),
        Parameter("frequency", "Hz", (0.0, 1e6), (1.0, 1500.0)),
    )
    missing = "a narrow line at no harmonic of motion, turn or mains, also at rest; the Allan deviation swings"
    confused_with = ("aliasing", "mains_hum", "motor_pickup")
    separate_by = "another sampling rate: a real line stays where it is, a folded one moves"
    source = "error sources N07, S29"
    lost = "its phase is not known from record to record"
    looks_in = "lines"

    def tone(self, rate: float, channels: Channels, at: Values) -> tuple[Array, float] | None:
        shown = abs(at["frequency"] - rate * round(at["frequency"] / rate))
        return np.abs(channels.sensitivity) * at["amplitude"], shown
