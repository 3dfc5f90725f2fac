"""Dropouts of the vibrometer: dark speckle, and for a moment the reading falls towards zero.

No hook: a test of its own looks for the bursts in the reference's records.
"""

from rig.model import Coordinate, Effect, Parameter


class LdvDropout(Effect):
    stage = "reference"
    instrument = "vibrometer"
    title = "dropouts of the vibrometer"
    equation = "v_shown = v·(1 − depth) for a share of the time"
    places = ("shaker",)
    coordinates = (Coordinate("share", 1e-3), Coordinate("depth", 0.1))
    parameters = (
        Parameter("share", "1", (0.0, 1.0), (1e-3, 2e-2)),
        Parameter("depth", "1", (0.0, 1.0), (0.1, 1.0)),
    )
    missing = "bursts in the reference's residual with heavy tails; all gains too high by share·depth, not repeatable"
    confused_with = ("ldv_gain_step", "white")
    separate_by = "retro-reflecting tape and a longer gate on the signal level: dropouts vanish, a gain error stays"
    source = "error sources L05"
    elsewhere = "it belongs to the vibrometer"
    looks_in = "dropouts"
