"""Mains hum: the mains frequency and its third harmonic are added in the wiring.

Phases are those in a whole second of the bench clock, if the mains had exactly the nominal frequency; the true mains is
`offset` away, so its phase moves on from record to record, beginning with the first.
"""

import math

import numpy as np

from rig.model import BOTH, Array, Complexes, Coordinate, Effect, Parameter, Values


class MainsHum(Effect):
    stage = "electronics"
    title = "mains hum"
    equation = "V += amplitude·cos(2π·f·t + phase) + third·cos(2π·3·f·t + phase_third), f = nominal + offset"
    quantities = BOTH
    places = ("shaker",)  # a turntable's windows leave a fifth of it, folded above what is compared in motion
    coordinates = (
        Coordinate("cosine", 1e-4),
        Coordinate("sine", 1e-4),
        Coordinate("cosine_third", 1e-4),
        Coordinate("sine_third", 1e-4),
        Coordinate("offset", 1e-4, (-0.03, -0.02, -0.01, 0.0, 0.01, 0.02, 0.03), shape=True),
    )
    parameters = (
        Parameter("amplitude", "V", (0.0, math.inf), (1e-4, 1e-2)),
        Parameter("third", "V", (0.0, math.inf), (1e-4, 1e-2)),
        Parameter("phase", "rad", (-math.inf, math.inf), (-math.pi, math.pi)),
        Parameter("phase_third", "rad", (-math.inf, math.inf), (-math.pi, math.pi)),
        Parameter("offset", "Hz", (-0.5, 0.5), (-0.03, 0.03)),
    )
    missing = "lines at 50 or 60 Hz and three times that, the same volts in all channels at every level, also at rest"
    confused_with = ("drive_feedthrough", "aliasing", "spur")
    separate_by = "a record at rest: hum stays, and its frequency wanders with the mains"
    source = "error sources E09"
    lost = "its phase is that of the mains, which no channel shows"

    def at_mains(self, order: int, elapsed: Array, at: Values) -> Complexes | None:
        phasors = {1: at["cosine"] - 1j * at["sine"], 3: at["cosine_third"] - 1j * at["sine_third"]}
        if order not in phasors:
            return None
        return np.asarray(phasors[order] * np.exp(2j * math.pi * order * at["offset"] * elapsed))

    def physical(self, at: Values) -> dict[str, float]:
        """amplitude·cos(ωt + phase) = cosine·cos ωt + sine·sin ωt."""
        return {
            "amplitude": math.hypot(at["cosine"], at["sine"]),
            "third": math.hypot(at["cosine_third"], at["sine_third"]),
            "phase": math.atan2(-at["sine"], at["cosine"]),
            "phase_third": math.atan2(-at["sine_third"], at["cosine_third"]),
            "offset": at["offset"],
        }

    def from_physical(self, values: Values) -> dict[str, float]:
        return {
            "cosine": values["amplitude"] * math.cos(values["phase"]),
            "sine": -values["amplitude"] * math.sin(values["phase"]),
            "cosine_third": values["third"] * math.cos(values["phase_third"]),
            "sine_third": -values["third"] * math.sin(values["phase_third"]),
            "offset": values["offset"],
        }
