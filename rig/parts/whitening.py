"""Rows that wander together, made independent: whitened = F⁻¹·rows with the covariance F·Fᵀ.

F comes from Cholesky's decomposition with held-out rows last. A row that is fitted is therefore told by fitted rows
alone, and what is left of a held-out one is how far it lies from what they say of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rig.motion import Array
from rig.parts.remainder import Mask

APART = 1e-9  # of the variance: two rows are never quite the same


@dataclass(frozen=True)
class Whitening:
    """Tables of some names with a row of n numbers each: `factor` F and its inverse, (names, n, n); nought in rows and
    columns that are not counted.
    """

    factor: Array
    inverse: Array

    @classmethod
    def of(cls, covariances: Sequence[Array], counted: Iterable[Mask], held: Mask) -> Whitening:
        """From every name's covariance (n, n), which of its numbers are counted and which of all are held out, (n,)."""
        size = len(held)
        factor, inverse = np.zeros((len(covariances), size, size)), np.zeros((len(covariances), size, size))
        order = np.argsort(held, kind="stable")
        for k, (covariance, used) in enumerate(zip(covariances, counted, strict=True)):
            here = order[used[order]]
            if len(here):
                square = np.ix_(here, here)
                found = covariance[square]
                factor[k][square] = np.linalg.cholesky(found + np.diag(APART * np.diag(found)))
                inverse[k][square] = np.linalg.inv(factor[k][square])
        return cls(factor, inverse)

    def whitened(self, table: Array) -> Array:
        """Numbers (names, n) in standard deviations, independent of each other."""
        return np.asarray(np.einsum("rij,rj->ri", self.inverse, table))

    def coloured(self, table: Array) -> Array:
        """The other way round: what independent standard deviations (names, n) make of the numbers."""
        return np.asarray(np.einsum("rij,rj->ri", self.factor, table))
