"""Time stamps of an even clock that were written down in whole steps, such as whole milliseconds at 128 Hz.

Such stamps lie up to a step beside the instants that they stand for, in a pattern that repeats and is no jitter: taken
as they stand they modulate a motion, and a rate found from their usual difference is one that divides the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FEWEST = 50  # stamps
DECIMALS = 9  # of a second that are looked at
COARSE = 0.01  # of the interval: finer steps do no harm
WHOLE = 1e-3  # of a step: how far a stamp may lie from a whole number of them
SLACK = 1.1  # steps that stamps may spread over: the line through them is off at its ends where the pattern is long


@dataclass(frozen=True)
class Rounded:
    """An even clock behind coarse stamps: its instants (n,), the `step` of the stamps and the `interval`, s."""

    instants: Array
    step: float
    interval: float


def rounded(stamps: Array) -> Rounded | None:
    """The clock behind stamps in whole steps, s, (n,); None where they are fine, uneven, or lack one."""
    if len(stamps) < FEWEST or not np.isfinite(stamps).all() or not stamps[-1] > stamps[0]:
        return None
    number = np.arange(len(stamps))
    since = stamps - stamps[0]
    slope, offset = np.polyfit(number, since, 1)
    left = since - (slope * number + offset)
    step = _step(since, float(slope))
    if step is None or float(np.ptp(left)) > SLACK * step:
        return None
    return Rounded(np.asarray(stamps[0] + slope * number + offset, np.float64), step, float(slope))


def _step(since: Array, interval: float) -> float | None:
    """The largest step of which all stamps are whole multiples; None if it is fine beside the interval, or is it."""
    for decimals in range(DECIMALS + 1):
        unit = 10.0**-decimals
        if unit <= COARSE * interval / 100.0:
            return None
        counts = np.rint(since / unit)
        if float(np.abs(since / unit - counts).max()) < WHOLE:
            step = unit * int(np.gcd.reduce(np.diff(counts).astype(np.int64)))
            even = abs(step / interval - 1.0) < WHOLE
            return step if step > COARSE * interval and not even else None
    return None
