"""Flicker noise: the longer one waits, the farther the zero has strolled, the same in every octave.

No hook: a test of its own looks at the density and the Allan deviation of records at rest.
"""

from rig.model import BOTH, Coordinate, Effect, Parameter


class Flicker(Effect):
    stage = "noise"
    title = "flicker noise"
    equation = "S(f) = level²/f, one-sided"
    quantities = BOTH
    coordinates = (Coordinate("level", 1e-4),)
    parameters = (Parameter("level", "SI", (0.0, 10.0), (1e-5, 1e-2)),)
    missing = "density rises as 1/f at the low end, Allan deviation flat at 1.18·level: longer means get no better"
    confused_with = ("random_walk", "white", "temperature_bias")
    separate_by = "a record at rest of hours with its temperature: flicker is left when the thermometer is taken off"
    source = "error sources N02; IEEE 952"
    lost = "it is chance"
    looks_in = "noise"
