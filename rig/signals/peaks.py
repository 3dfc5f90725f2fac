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
    from scipy.signal import find_peaks

    known = np.isfinite(size) & (size > 0.0) & (frequency > 0.0)
    points, place = np.unique(frequency[known], return_inverse=True)
    if len(points) < 3:
        return np.zeros(0)
    height = np.bincount(place, np.log(size[known])) / np.bincount(place)
    at, found = find_peaks(height, prominence=STANDS)
    at = at[np.argsort(-found["prominences"])][:MOST]
    return np.unique(np.concatenate([points[at], *(np.sqrt(points[at] * points[at + way]) for way in (-1, 1))]))
