"""Channel skew: the multiplexer takes longer from slot to slot than its driver says.

The time that is stated is already taken off each record; `extra` is what comes on top, for each slot of the scan after
the reference's (slots count from there).
"""

import math

import numpy as np
from numpy.typing import NDArray

from rig.model import Array, Coordinate, Effect, Inverse, Late, Parameter, Values


class ChannelSkew(Effect):
    stage = "sampling"
    title = "skew of the scan"
    equation = "t_k = t_stated + slot_k·extra"
    places = ("shaker",)
    coordinates = (Coordinate("extra", 1e-6),)
    parameters = (Parameter("extra", "s", (-math.inf, math.inf), (1e-7, 1e-5)),)
    missing = "phase against the reference ∝ f and ∝ the slot in the scan, accelerometers and gyros alike; gain right"
    confused_with = ("delay", "ldv_delay", "first_order_lag")
    separate_by = "the scan in another order: skew goes with the slot, a delay stays with the sensor"
    rarity = 1.0
    source = "error sources E06"

    def late(self, slots: NDArray[np.intp], at: Values) -> Array:
        return np.asarray(slots * at["extra"])

    def inverse(self, at: Values) -> Inverse:
        return Late(at["extra"])
