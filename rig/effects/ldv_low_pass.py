"""Low-pass of the vibrometer's decoder: the reference droops and is late, so sensors seem to rise and to lead."""

import math

import numpy as np

from rig.model import Array, Complexes, Coordinate, Effect, Parameter, Values

HALF_POWER = 1.755672  # rad/s, where a three-pole Bessel filter of 1 s delay is 3 dB down


class LdvLowPass(Effect):
    stage = "reference"
    instrument = "vibrometer"
    title = "low-pass of the vibrometer's decoder"
    equation = "a = a_shown/H, H = 15/(s³ + 6·s² + 15·s + 15), s = 1.755672·j·f/corner"
    places = ("shaker",)
    coordinates = (Coordinate("period", 2e-5),)  # 1/corner in s
    parameters = (Parameter("corner", "Hz", (0.0, math.inf), (3000.0, 20000.0)),)
    missing = "all channels' gains rise as 0.31·(f/corner)² and their phases lead as 0.279·f/corner of a turn"
    confused_with = ("resonance", "ldv_delay", "bessel_filter")
    separate_by = "another filter setting of the decoder: a rise that comes from it changes"
    rarity = 1.0
    source = "error sources L03"
    elsewhere = "it belongs to the vibrometer"

    def shaken(self, along: Complexes, frequency: Array, scale: Array, at: Values) -> Complexes:
        s = HALF_POWER * 1j * at["period"] * frequency  # written again as in bessel_filter: effects stand alone
        response = 15.0 / (s**3 + 6.0 * s**2 + 15.0 * s + 15.0)
        return np.asarray(along / response)

    def physical(self, at: Values) -> dict[str, float]:
        """NaN where the coordinate is no filter."""
        return {"corner": 1.0 / at["period"] if at["period"] > 0.0 else math.nan}

    def from_physical(self, values: Values) -> dict[str, float]:
        return {"period": 1.0 / values["corner"]}
