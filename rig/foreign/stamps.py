"""Time stamps of an even clock that were written down in whole steps, and of a clock that was set back.

Stamps in whole milliseconds at 128 Hz lie up to a step beside the instants that they stand for, in a pattern that
repeats and is no jitter: taken as they stand they modulate a motion, and a rate found from their usual difference is
one that divides the step. A clock that is set back (the end of summer time, a time server) makes instants come twice.
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
SLACK = 1.02  # steps that stamps may spread over
ROUGH = 3.0  # the same about a line by least squares


BACK = 5.0  # intervals that a stamp lies before the one before it: a clock that was set back, and no jitter
STAYS = 4  # rows that stay behind
TIMES = 3  # that it is set back in a record; more is disorder


def set_back(stamps: Array) -> NDArray[np.intp]:
    """Rows at which a clock was set back, (k,); none of stamps in disorder."""
    there = np.flatnonzero(np.isfinite(stamps))
    steps = np.diff(stamps[there])
    if len(steps) < FEWEST or not (steps > 0.0).any():
        return there[:0]
    usual = float(np.median(steps[steps > 0.0]))
    places = np.flatnonzero(steps < -BACK * usual)
    stays = [
        k for k in places if (stamps[there[k + 1 : k + 1 + STAYS]] < stamps[there[k]]).all()
    ]  # no single bad stamp
    rows = there[1:][np.array(stays, np.intp)]
    return rows if len(places) <= TIMES else rows[:0]


def onward(stamps: Array) -> Array:
    """The same stamps with time going on by an interval where the clock was set back, s, (n,)."""
    rows = set_back(stamps)
    if not len(rows):
        return stamps
    found = stamps.copy()
    steps = np.diff(stamps[np.isfinite(stamps)])
    interval = float(np.median(steps[steps > 0.0]))
    for row in rows:
        before = found[:row][np.isfinite(found[:row])]
        found[row:] += before[-1] + interval - found[row]
    return found


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
    number = np.arange(len(stamps), dtype=np.float64)
    since = stamps - stamps[0]
    usual = float(np.polyfit(number, since, 1)[0])
    step = _step(since, usual)
    if step is None or float(np.ptp(since - usual * number)) > ROUGH * step:
        return None
    slope, offset = _nearest_line(number, since - usual * number)
    line = (usual + slope) * number + offset
    if float(np.abs(since - line).max()) > 0.5 * SLACK * step:
        return None
    return Rounded(np.asarray(stamps[0] + line, np.float64), step, usual + slope)


def _nearest_line(number: Array, left: Array) -> tuple[float, float]:
    """Slope and offset of the line whose largest distance from points (n,) is the smallest (Chebyshev's).

    Least squares follow the pattern of the steps where it is long; only the corners of the points' hull count here.
    """
    from scipy.optimize import linprog
    from scipy.spatial import ConvexHull

    scale = number[-1], float(np.ptp(left))
    corners = ConvexHull(np.column_stack([number / scale[0], left / scale[1]])).vertices
    x, y = number[corners] / scale[0], left[corners] / scale[1]
    above = np.column_stack([-x, -np.ones(len(x)), -np.ones(len(x))])
    below = np.column_stack([x, np.ones(len(x)), -np.ones(len(x))])
    found = linprog(
        [0.0, 0.0, 1.0], np.vstack([above, below]), np.concatenate([-y, y]), bounds=[(None, None)] * 2 + [(0.0, None)]
    )
    assert found.x is not None  # any line is allowed
    slope, offset = float(found.x[0]), float(found.x[1])
    return slope * scale[1] / scale[0], offset * scale[1]


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
