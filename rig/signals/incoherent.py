"""The part of some lines that no linear filter of a reference's motion explains, and how dense it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
PER_DECADE = 8.0
FREE = 10.0  # lines' worth of freedom that a density is worked out from at least
RESOLVED = 1e-9  # of the largest singular value: directions below it are rounding
ROUNDS = 2  # plain least squares, then weighted by what that left


def incoherent(f: Array, target: Array, columns: Array) -> tuple[Array, Array]:
    """Density at frequencies f (n,) of what is left of lines `target` (n,) once columns (n, k) are fitted to them, and
    the freedom that the fit left to each line; both (n,).
    """
    density, freedom = np.ones(len(f)), np.ones(len(f))
    for _ in range(ROUNDS):
        weight = 1.0 / np.sqrt(density)
        basis = _orthonormal(columns * weight[:, None])
        aim = target * weight
        left = (aim - basis @ (basis.T @ aim)) / weight
        freedom = 1.0 - np.sum(basis**2, axis=1)
        density = _smooth(f, left**2, freedom)
    return density, freedom


def by_rising(f: Array, values: Array) -> tuple[Array, Array]:
    """Both in the order of rising f."""
    order = np.argsort(f, kind="stable")
    return f[order], values[order]


def _orthonormal(columns: Array) -> Array:
    """An orthonormal basis of what the first of these columns (n, k) span, at most half as many as rows; (n, rank).

    A filter with as many numbers as there are lines would explain noise as well. Derivatives stand last.
    """
    columns = columns[:, : max(len(columns) // 2, 1)]
    vectors, sizes, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return np.asarray(vectors[:, sizes > RESOLVED * sizes[0]])


def _smooth(f: Array, power: Array, freedom: Array) -> Array:
    """Density at every line (n,), from the power that a filter left and the freedom that it left to each line.

    Lines are taken together in bins of log frequency, and so many of them that some freedom is left: a line that the
    filter follows by itself leaves nothing over, and that is no lack of noise.
    """
    at, power = by_rising(f, power)
    _, freedom = by_rising(f, freedom)
    places, free, whole = [], [], []
    begin = 0
    for end in _bins(at, freedom):
        places.append(float(np.log(at[begin:end]).mean()))
        free.append(float(freedom[begin:end].sum()))
        whole.append(float(power[begin:end].sum()))
        begin = end
    levels = np.log(np.array(whole) / np.array(free))
    return np.asarray(np.exp(np.interp(np.log(f), places, levels)))


def _bins(f: Array, freedom: Array) -> list[int]:
    """Ends of bins among rising frequencies: PER_DECADE of them, wider where less freedom than FREE is left."""
    ends, begin, total = [], 0, np.concatenate([[0.0], np.cumsum(freedom)])
    for end in [*(np.flatnonzero(np.diff(np.floor(np.log10(f) * PER_DECADE))) + 1).tolist(), len(f)]:
        if total[end] - total[begin] >= FREE:
            ends.append(end)
            begin = end
    return [*ends[:-1], len(f)]
