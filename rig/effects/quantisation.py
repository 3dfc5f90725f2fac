"""Quantisation: the converter knows only whole steps.

No hook: a step is no shift of any harmonic, so a test of its own looks at the codes that occur in the raw records.
"""

from rig.model import BOTH, Coordinate, Effect, Parameter


class Quantisation(Effect):
    stage = "electronics"
    title = "quantisation"
    equation = "V_shown = step·round(V/step)"
    quantities = BOTH
    places = ("shaker",)
    coordinates = (Coordinate("step", 1e-3),)
    parameters = (Parameter("step", "V", (0.0, 1.0), (1e-3, 2e-2)),)
    missing = "few different values in a record, evenly spaced; a white residual of step/√12 where noise exceeds step/2"
    confused_with = ("white",)
    separate_by = "the values that occur, counted: noise leaves no gaps between them"
    source = "error sources E03"
    lost = "what lies between two steps leaves no trace"
    looks_in = "codes"
