"""One-sided saturation: beyond a limit of one sign the output stays where it is, the other way it goes on."""

import math

import numpy as np

from rig.model import BOTH, Array, Coordinate, Effect, Motion, Parameter, Quantity, Values

# of the largest input, where a fit may start
SHARES = (0.997, 0.985, 0.95, 0.9, 0.75, 0.5)


class OneSidedSaturation(Effect):
    """Nothing happens while the limit is beyond every input, so fits start with one somewhat below the largest."""

    stage = "transducer"
    title = "saturation on one side"
    equation = "V/S = min(u, limit) for a limit above nought, max(u, limit) for one below"
    quantities = BOTH
    coordinates = (Coordinate("limit", 0.002, starts=(1e3,)),)  # 1e3: where it vanishes
    parameters = (Parameter("limit", "SI", (-math.inf, math.inf), (4.0, 20.0)),)
    missing = (
        "tops are flat on one side: above one level gain falls, the mean shifts, even and odd lines rise; no phase"
    )
    confused_with = ("saturation", "quadratic", "asymmetry", "cubic")
    separate_by = "levels on both sides of the knee, and a histogram of the samples: they pile up at one end only"
    kinked = True
    beside = (("saturation", "cubic", "odd_quadratic"),)
    source = "error sources S09"
    lost = "beyond the limit the output is the same for every input"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        limit = at["limit"]
        return np.asarray(np.minimum(u, limit) if limit > 0.0 else np.maximum(u, limit))

    def starts(self, motion: Motion, on: Quantity | None) -> list[dict[str, float]]:
        """Shares of the largest input that varies: the drive's amplitude, or the rate of the table; of either sign."""
        swing = motion.rate if on == "rate" else motion.along[:, 1:2]
        peak = float(np.max(np.abs(swing), initial=0.0))
        return [{"limit": sign * share * peak} for sign in (1.0, -1.0) for share in SHARES] if peak > 0.0 else []
