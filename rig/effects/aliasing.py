"""Aliasing: a line above half the sampling rate is folded down among the signals.

A test of its own looks for lines in records at rest; what it finds is held against their spectra.
"""

from __future__ import annotations

import numpy as np

from rig.model import BOTH, Array, Channels, Coordinate, Effect, Parameter, Values


class Aliasing(Effect):
    stage = "sampling"
    title = "aliasing"
    equation = "f_shown = |frequency − k·f_sampling|, k whole, f_shown ≤ f_sampling/2"
    quantities = BOTH
    places = ("shaker", "turntable")
    coordinates = (Coordinate("amplitude", 1e-4), Coordinate("frequency", 1.0, searched=True))
    parameters = (
        Parameter("amplitude", "V", (0.0, 1.0), (1e-4, 1e-2)),
        Parameter("frequency", "Hz", (1500.0, 1e6), (2e4, 8e4)),
    )
    missing = "a narrow line at no harmonic of motion, turn or mains, the same volts at every level and at rest"
    confused_with = ("spur", "mains_hum", "motor_pickup")
    separate_by = "another sampling rate: a folded line moves, a real one stays"
    source = "error sources E05, S29"
    lost = "a folded line cannot be told from a signal at its frequency"
    looks_in = "lines"

    def tone(self, rate: float, channels: Channels, at: Values) -> tuple[Array, float] | None:
        shown = abs(at["frequency"] - rate * round(at["frequency"] / rate))
        return np.full(len(channels.names), at["amplitude"]), shown
