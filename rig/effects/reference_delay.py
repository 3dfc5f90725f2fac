"""The reference is late: its time stamps, or the clock they come from, are behind those of the sensor."""

import math

import numpy as np

from rig.model import Array, Complexes, Coordinate, Effect, Motion, Parameter, Values


class ReferenceDelay(Effect):
    stage = "reference"
    title = "reference late by a constant time"
    equation = "motion(t) = shown(t + time)"
    places = ("rotation", "free")
    coordinates = (Coordinate("time", 1e-4),)
    parameters = (Parameter("time", "s", (-math.inf, math.inf), (1e-4, 2e-2)),)
    missing = "the error goes with the rate of change of the motion, in all channels of either kind by the same time"
    confused_with = ("delay",)
    separate_by = "one clock for both, or an event that both see; delays that differ by channel are the sensor's"
    source = "error sources T05; time offsets between camera and inertial unit (Furgale 2013, Kalibr)"
    elsewhere = "it belongs to the reference"

    def motion(self, motion: Motion, at: Values) -> Motion:
        if not at["time"]:
            return motion

        def earlier(frequency: Array) -> Complexes:
            return np.asarray(np.exp(2j * math.pi * frequency * at["time"]))

        moved = {
            name: np.asarray(motion.grid.observed(getattr(motion, name), earlier), np.float64)
            for name in ("force", "rate", "turning")
        }
        return Motion(**{**vars(motion), **moved})
