"""Clock ratio: the converter's clock and the source's do not agree on how long a second is.

No hook: a test of its own compares the frequency that is found in the records with the one that was set.
"""

from rig.model import Coordinate, Effect, Parameter


class ClockRatio(Effect):
    stage = "sampling"
    title = "ratio of the clocks"
    equation = "f_found = f_set·(1 + error)"
    places = ("shaker",)
    coordinates = (Coordinate("error", 1e-4),)
    parameters = (Parameter("error", "1", (-0.05, 0.05), (1e-4, 1e-3)),)
    missing = "the phase runs away within a record as 2π·f·error·t; at a fixed frequency the gain falls ∝ (f·error·T)²"
    confused_with = ("first_order_lag",)
    separate_by = "two lengths of record: a filter does not know how long it is watched"
    source = "error sources K01"
    elsewhere = "it belongs to the clocks of the bench"
    looks_in = "clock"
