"""Hysteresis: the output rests at every turning point until the input has come back by twice the width (play)."""

import math

import numpy as np

from rig.model import Array, Coordinate, Effect, Motion, Parameter, Values


class Hysteresis(Effect):
    stage = "transducer"
    title = "hysteresis"
    equation = "V/S = y, y = min(max(y_before, u − width), u + width)"
    quantities = ("acceleration",)
    places = ("shaker",)
    coordinates = (Coordinate("width", 2e-3),)
    parameters = (Parameter("width", "SI", (0.0, math.inf), (0.002, 0.02)),)
    missing = "the phase lags by 4·width/(πA): more at small levels, alike at every frequency; hardly any loss of gain"
    confused_with = ("delay", "first_order_lag", "dead_zone")
    separate_by = "smaller levels at one frequency: this lag is ∝ 1/A, that of a delay or filter does not change"
    kinked = True
    source = "error sources S11; Visintin, Differential Models of Hysteresis (play operator)"
    lost = "the output depends on turning points that a record need not hold"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        """A width below zero mirrors it, 2u − play(u, −width), so that it has a slope at zero."""
        width = at["width"]
        varies = np.ptp(u, axis=-1) > 0.0
        if width == 0.0 or not varies.any():
            return u
        found = u.copy()
        found[varies] = _play(u[varies], width) if width > 0.0 else 2.0 * u[varies] - _play(u[varies], -width)
        return found


def _play(u: Array, width: float) -> Array:
    """Rows (r, phases) of one closed period each: the first round finds the state that the second starts from."""
    low, high = np.ascontiguousarray(u.T) - width, np.ascontiguousarray(u.T) + width
    y, state = np.empty_like(low), u.mean(axis=-1)
    for _ in range(2):
        for phase in range(len(y)):
            state = np.minimum(np.maximum(state, low[phase]), high[phase])
            y[phase] = state
    return np.asarray(y.T)
