"""Gain step of the vibrometer: its finer ranges show too much or too little against the coarsest one."""

from __future__ import annotations

import math

import numpy as np

from rig.model import Array, Complexes, Coordinate, Effect, Motion, Parameter, Quantity, Values


class LdvGainStep(Effect):
    stage = "reference"
    instrument = "vibrometer"
    title = "gain step between the vibrometer's ranges"
    equation = "a = a_shown/(1 + step) where scale ≤ range"
    places = ("shaker",)
    coordinates = (Coordinate("step", 1e-3), Coordinate("range", 1e-3, searched=True))
    parameters = (
        Parameter("step", "1", (-1.0, math.inf), (1e-3, 1e-2)),
        Parameter("range", "(m/s)/V", (0.0, math.inf), (1e-3, 1.0)),
    )
    missing = "all accelerometers jump by the same factor where the range changes; flat in f and level inside a range"
    confused_with = ("resonance", "cubic", "ldv_low_pass")
    separate_by = "the same frequency and level measured in both ranges: only the step differs"
    rarity = 1.0
    source = "error sources L02"
    elsewhere = "it belongs to the vibrometer"

    def shaken(self, along: Complexes, frequency: Array, scale: Array, at: Values) -> Complexes:
        gain = np.where(scale <= at["range"], 1.0 + at["step"], 1.0)
        return np.asarray(along / gain[:, None])

    def starts(self, motion: Motion, on: Quantity | None) -> list[dict[str, float]]:
        """One per range that was used, the coarsest left out: beside it every range has the same gain."""
        used = np.unique(motion.scale[motion.scale > 0.0])
        return [{"step": 0.0, "range": float(one)} for one in used[:-1]]
