"""Quantisation: the converter knows only whole steps.

A step is no shift of any harmonic: a test of its own looks at the codes that occur in records at rest. Where noise is
more than a third of a step it adds white noise of step²/12.
"""

from __future__ import annotations

import numpy as np

from rig.model import Array, Channels, Coordinate, Effect, Parameter, Values


class Quantisation(Effect):
    stage = "electronics"
    title = "quantisation"
    equation = "V_shown = step·round(V/step)"
    places = ("shaker",)
    coordinates = (Coordinate("step", 1e-3),)
    parameters = (Parameter("step", "V", (0.0, 1.0), (1e-3, 2e-2)),)
    missing = "few different values in a record, evenly spaced; a white residual of step/√12 where noise exceeds step/2"
    confused_with = ("white",)
    separate_by = "the values that occur, counted: noise leaves no gaps between them"
    source = "error sources E03"
    lost = "what lies between two steps leaves no trace"
    looks_in = "codes"

    def density(self, frequency: Array, rate: float, channels: Channels, at: Values) -> Array:
        return np.full((len(channels.names), *frequency.shape), at["step"] ** 2 / 6.0 / rate)
