"""Poses and turns as numbers: what one record tells of a unit at rest, and of its turns by known angles."""

from __future__ import annotations

from dataclasses import dataclass

from rig.model import Channels
from rig.motion import Array
from rig.parts.remainder import Mask


@dataclass(frozen=True)
class PoseRecords:
    """Means of c channels over n poses and turns of one record, in the order of time.

    `observed` (c, n) V, NaN where there is none, with the noise's `variance` (c, n) V², about the mean of all where
    they wander together, and then their `covariance` (c, n, n) V². `turn` is the known angle as a vector in the case
    frame, rad, (3, n), zero in a pose, with standard uncertainty `u_turn` rad, (n,); `seconds` how long each took,
    `time` its middle, s, (n,). `held` (n,): a model is judged by them. `temperature` °C, `supply` V,
    both (n,), NaN where not logged. `gravity` and `u_gravity` m/s².
    """

    name: str
    run: str
    channels: Channels
    observed: Array
    variance: Array
    turn: Array
    u_turn: Array
    seconds: Array
    time: Array
    held: Mask
    temperature: Array
    supply: Array
    gravity: float
    u_gravity: float
    notes: tuple[str, ...] = ()
    zero: Array | None = None  # (c,): zero outputs where a fit begins, V; none where the numbers are about them already
    up: Array | None = None  # (3, n): what the owner says is up, NaN where nobody does
    covariance: Array | None = None  # None: every mean has a noise of its own
    since: float | None = None  # s, when the first record of its session began; None: that of its own
