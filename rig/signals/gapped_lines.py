"""Cosine lines of a record of which some instants do not count, made independent of each other again.

Where instants are set to zero the orthonormal cosine lines of what is left are no longer independent: with the mask m
and all n lines D of a stretch they are  A·D·x,  A = D·diag(m)·Dᵀ,  and noise with variances v of its lines gives them
the covariance  A·diag(v)·Aᵀ.  Its Cholesky factor, line after line from the lowest, makes rows of unit variance that
are again nearly functions of one frequency each. What the lower lines say already within the instants that count is no
row: its share of the line's variance is below `LEAST`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
LEAST = 0.1


def whitening(kept: Mask, variance: Array) -> tuple[Array, Mask]:
    """Matrix (w, w) that makes the lowest w lines of a stretch, in which `kept` (n,) instants count, rows of unit
    variance; and which of the rows say something, (w,): the others are zero.

    `variance` (w,) of these lines if all instants counted; lines above them are taken to be as noisy as the last.
    """
    from scipy.fft import dct, idct
    from scipy.linalg import solve_triangular

    width, count = len(variance), len(kept)
    shapes = idct(np.eye(width, count), type=2, norm="ortho", axis=1) * kept
    all_lines = dct(shapes, type=2, norm="ortho", axis=1)
    whole = np.concatenate([variance, np.full(count - width, variance[-1])])
    covariance = (all_lines * whole) @ all_lines.T
    left, factor, there = covariance.copy(), np.zeros((width, width)), np.zeros(width, np.bool_)
    for k in range(width):
        there[k] = left[k, k] > LEAST * variance[k]
        if there[k]:
            factor[k:, k] = left[k:, k] / np.sqrt(left[k, k])
            left[k:, k:] -= np.outer(factor[k:, k], factor[k:, k])
    some = np.flatnonzero(there)
    matrix = np.zeros((width, width))
    matrix[np.ix_(some, some)] = solve_triangular(factor[np.ix_(some, some)], np.eye(len(some)), lower=True)
    return matrix, there
