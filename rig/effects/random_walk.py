"""Random walk of the zero: small steps by chance add up.

No hook: a test of its own looks at the density and the Allan deviation of records at rest.
"""

from rig.model import BOTH, Coordinate, Effect, Parameter


class RandomWalk(Effect):
    stage = "noise"
    title = "random walk of the zero"
    equation = "S(f) = 2·coefficient²/(2π·f)², one-sided"
    quantities = BOTH
    coordinates = (Coordinate("coefficient", 1e-5),)
    parameters = (Parameter("coefficient", "SI/√s", (0.0, 1.0), (1e-6, 1e-3)),)
    missing = "density rises as 1/f² at the low end, Allan deviation ∝ τ^½, coefficient·√(τ/3): longer means get worse"
    confused_with = ("flicker", "temperature_bias", "warm_up")
    separate_by = "a record at rest of hours with its temperature, repeated: a walk never takes the same path"
    source = "error sources N03; IEEE 952"
    lost = "it is chance"
    looks_in = "noise"
