"""White noise: every sample by chance, none knows of the one before.

No hook: a test of its own looks at the density and the Allan deviation of records at rest.
"""

from rig.model import BOTH, Coordinate, Effect, Parameter


class White(Effect):
    stage = "noise"
    title = "white noise"
    equation = "density = 2·rms²/f_sampling"
    quantities = BOTH
    coordinates = (Coordinate("rms", 1e-3),)
    parameters = (Parameter("rms", "SI", (0.0, 10.0), (1e-4, 5e-2)),)
    missing = "residuals without correlation: density flat in f, Allan deviation ∝ τ^−½, the same at every level"
    confused_with = ("quantisation", "flicker", "ldv_dropout")
    separate_by = "a record at rest, and one with the input shorted: what stays is the converter's"
    source = "error sources N01; IEEE 952"
    lost = "it is chance"
    looks_in = "noise"
