"""Rows of a table of responses that their own repeats contradict: a reading that slipped, or was typed wrong.

What a frequency shows again and again scatters a little. A repeat that lies off the middle one of them by many times
the scatter of the repeats about it, at this frequency and at those beside it, is no such scatter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
SAME = 1e-6  # relative: one frequency
BESIDE = 5  # frequencies on either side whose repeats say how much they scatter
FEWEST = 8  # repeats that say it
# times that scatter: a median of some twenty repeats is as well known as a deviation of about eight degrees of
# freedom, of which noise exceeds this once in a thousand tables of sixty rows
APART = 10.0
NORMAL = 1.4826  # standard deviation of normal noise over the median of its absolute values


def contradicted(values: Array, frequency: Array) -> Rows:
    """Rows, (k,), among values (n,) whose repeats differ by scatter alone; both of two that contradict each other."""
    groups = _repeated(frequency)
    off = [_off(values[rows]) for rows in groups]
    found: list[int] = []
    for k, rows in enumerate(groups):
        near = np.concatenate([one[1] for one in off[max(k - BESIDE, 0) : k + BESIDE + 1]])
        scatter = NORMAL * float(np.median(near)) if len(near) >= FEWEST else 0.0
        if scatter > 0.0:
            found += rows[np.abs(off[k][0]) > APART * scatter].tolist()
    return np.array(sorted(found), np.intp)


def _repeated(frequency: Array) -> list[Rows]:
    """Rows of every frequency that is there more than once, by frequency."""
    order = np.flatnonzero(np.isfinite(frequency))
    order = order[np.argsort(frequency[order], kind="stable")]
    edges = np.flatnonzero(np.diff(frequency[order]) > SAME * np.abs(frequency[order[1:]])) + 1
    return [one for one in np.split(order, edges) if len(one) > 1]


def _off(values: Array) -> tuple[Array, Array]:
    """How far each repeat is off the middle one, of two off the other, and how far they scatter, n − 1 of them."""
    apart = values - np.nanmedian(values)
    scatter = np.sort(np.abs(apart))[1:]  # the middle one itself says nothing
    if len(values) == 2:
        return apart * np.sqrt(2.0), scatter * np.sqrt(2.0)
    return apart / np.sqrt(1.0 + 1.0 / (len(values) - 1.0)), scatter
