"""Saturation: beyond a limit the output stays where it is."""

import math

import numpy as np

from rig.model import BOTH, Array, Coordinate, Effect, Motion, Parameter, Quantity, Values

# of the largest input, where a fit may start
SHARES = (0.9995, 0.998, 0.996, 0.994, 0.992, 0.99, 0.988, 0.986, 0.984, 0.98, 0.97, 0.95, 0.91, 0.8, 0.6)


class Saturation(Effect):
    """Nothing happens while the limit is above every input, so fits start with a limit somewhat below the largest."""

    stage = "transducer"
    title = "saturation"
    equation = "V/S = min(max(u, −limit), limit)"
    quantities = BOTH
    coordinates = (Coordinate("limit", 0.002, starts=(1e3,)),)  # 1e3: where it vanishes
    parameters = (Parameter("limit", "SI", (0.0, math.inf), (4.0, 20.0)),)
    missing = "flat tops: above one level gain falls and lines at 3f and 5f rise at once, below it nothing; no phase"
    confused_with = ("cubic", "quadratic", "odd_quadratic")
    separate_by = "levels on both sides of the knee, and a histogram of the samples: they pile up at the limit"
    kinked = True
    source = "error sources S09"
    lost = "beyond the limit the output is the same for every input"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return np.asarray(np.clip(u, -at["limit"], at["limit"]))

    def starts(self, motion: Motion, on: Quantity | None) -> list[dict[str, float]]:
        """Shares of the largest input that varies: the drive's amplitude, or the rate of the table."""
        swing = motion.rate if on == "rate" else motion.along[:, 1:2]
        peak = float(np.max(np.abs(swing), initial=0.0))
        return [{"limit": share * peak} for share in SHARES] if peak > 0.0 else []
