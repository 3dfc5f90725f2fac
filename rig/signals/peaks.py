"""Peaks of a response over frequency, for a fit of what resonates to start at."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

STANDS = math.log(1.2)  # how far a peak stands out, as a logarithm
MOST = 3

Array = NDArray[np.float64]


def peaks(frequency: Array, size: Array) -> Array:
    """Where a response is largest, Hz, (k,): the highest peaks, and half-way (in log frequency) to the points beside
    them, as a sharp one may lie between two. `size` (n,) at `frequency` (n,), Hz, in any order and with repeats.
    """
    known = np.isfinite(size) & (size > 0.0) & (frequency > 0.0)
    points, place = np.unique(frequency[known], return_inverse=True)
    if len(points) < 3:
        return np.zeros(0)
    height = np.bincount(place, np.log(size[known])) / np.bincount(place)
    prominence = prominences(height)
    at = np.flatnonzero(prominence >= STANDS)
    at = at[np.argsort(-prominence[at])][:MOST]
    return np.unique(np.concatenate([points[at], *(np.sqrt(points[at] * points[at + way]) for way in (-1, 1))]))


def prominences(height: Array) -> Array:
    """How far each point, (n,), stands above the higher of the two lowest points between it and the next higher one, or
    the end, on either side: 0 where it is no peak. As `scipy.signal.find_peaks`, which takes longer to load than a
    whole search takes to run; of a flat top every point counts.
    """
    return np.array([min(_fall(height[at::-1]), _fall(height[at:])) for at in range(len(height))])


def _fall(way: Array) -> float:
    """How far one goes down from the first point before there is a higher one."""
    higher = np.flatnonzero(way > way[0])
    return float(way[0] - way[: higher[0] if len(higher) else None].min())
