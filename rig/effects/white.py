"""White noise: every sample by chance, none knows of the one before.

No hook: a test of its own looks at the density and the Allan deviation of records at rest.
"""

from rig.model import BOTH, Coordinate, Effect, Parameter


class White(Effect):
    stage = "noise"
    title = "white noise"
    equation = "S(f) = density² at every f, one-sided; rms = density·√(f_sampling/2)"
    quantities = BOTH
    coordinates = (Coordinate("density", 2.5e-5),)
    parameters = (Parameter("density", "(SI)/√Hz", (0.0, 1.0), (2.5e-6, 1e-3)),)
    missing = "residuals without correlation: density flat in f, Allan deviation ∝ τ^−½, the same at every level"
    confused_with = ("quantisation", "flicker", "ldv_dropout")
    separate_by = "a record at rest, and one with the input shorted: what stays is the converter's"
    source = "error sources N01; IEEE 952"
    lost = "it is chance"
    looks_in = "noise"
