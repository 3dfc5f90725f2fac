"""Drive feed-through: a share of the shaker's drive voltage reaches every channel by the wiring, not by motion."""

import math

import numpy as np

from rig.model import BOTH, Array, Channels, Coordinate, Effect, Motion, Parameter, Values


class DriveFeedthrough(Effect):
    stage = "electronics"
    title = "drive feed-through"
    equation = "V += share·V_drive"
    quantities = BOTH
    places = ("shaker",)
    needs = ("source",)
    coordinates = (Coordinate("share", 1e-4),)
    parameters = (Parameter("share", "1", (-math.inf, math.inf), (1e-5, 1e-3)),)
    missing = "the same volts in all channels, in line with the drive's voltage: against the acceleration, ∝ 1/f²"
    confused_with = ("cross_axis", "high_pass", "mains_hum")
    separate_by = "the sensor turned over: the feed-through keeps its sign; a dummy in its place still shows it"
    source = "error sources E10"
    elsewhere = "it belongs to the wiring of the shaker"

    def added(self, motion: Motion, channels: Channels, at: Values) -> Array | None:
        drive = motion.drive_waveform()
        return np.broadcast_to(at["share"] * drive, (len(channels.names), *drive.shape))
