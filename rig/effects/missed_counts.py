"""Missed counts: lines of the encoder that pass between two samples are lost.

No hook: a test of its own counts the lines between two passes of the index.
"""

from rig.model import Coordinate, Effect, Parameter


class MissedCounts(Effect):
    stage = "reference"
    title = "missed counts of the encoder"
    equation = "ω_shown = ω·(1 − share)"
    places = ("turntable",)
    coordinates = (Coordinate("share", 1e-4),)
    parameters = (Parameter("share", "1", (0.0, 1.0), (1e-5, 2e-2)),)
    missing = "whole lines too few from index to index; the sensitivities of all gyros come out too high by the share"
    confused_with = ("encoder_graduation", "buffer_gain")
    separate_by = "the lines from index to index at several speeds: the disk's number is exact, loss goes with speed"
    source = "error sources T05, T08, U32"
    elsewhere = "it belongs to the counting of the encoder"
    looks_in = "closure"
