"""Graduation of the encoder: each line sits a little beside its place, the same in every turn.

No hook: a test of its own averages where each line passes over the turns, and takes what two speeds have in common.
"""

from rig.model import Coordinate, Effect, Parameter


class EncoderGraduation(Effect):
    stage = "reference"
    title = "graduation of the encoder's disk"
    equation = "θ_k = 2π·k/lines + δ_k, rms of δ_k where δ runs over many lines"
    places = ("turntable",)
    coordinates = (Coordinate("rms", 1e-5),)
    parameters = (Parameter("rms", "rad", (0.0, 1e-3), (1e-5, 1e-4)),)
    missing = "a pattern from line to line that repeats every turn, at every speed; nothing in whole turns"
    confused_with = ("encoder_second_harmonic", "encoder_eccentricity", "missed_counts")
    separate_by = "twenty turns and more, averaged line by line: graduation repeats, the sampling of edges does not"
    source = "error sources T03; HEDS-9040 data sheet"
    elsewhere = "it belongs to the encoder of the turntable"
    looks_in = "graduation"
