"""Numbers that stand for nothing, such as −999, and rows that stand alone far from all others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
FEWEST = 40  # numbers that say what is usual
FAR = 3.0  # times the span of all other numbers, beyond which a number is none of them
MARKS = 4  # values looked at, from the outermost
RARE = 0.1  # share of rows: a mark is rarer
ALONE = 8.0  # times the next smaller jump: rows that jump out and back
FEW = 20  # rows that jump


@dataclass(frozen=True)
class Mark:
    """A value far outside all others: its rows, and the span of the rest."""

    value: float
    rows: Rows
    low: float
    high: float


def marks(values: Array) -> Iterator[Mark]:
    """Values, each in one row or many, that lie further outside than three times the span of all others."""
    left = np.isfinite(values)
    for _ in range(MARKS):
        for value in _extremes(values[left]):
            here = left & (values == value)
            rest = values[left & ~here]
            if len(rest) < FEWEST or here.sum() > RARE * len(values):
                continue
            low, high = float(rest.min()), float(rest.max())
            if max(low - value, value - high) > FAR * (high - low) > 0.0:
                yield Mark(value, np.flatnonzero(here), low, high)
                left &= ~here
                break
        else:
            return


def _extremes(values: Array) -> tuple[float, ...]:
    return (float(values.min()), float(values.max())) if len(values) else ()


def alone(values: Array) -> Rows:
    """Rows that jump from both neighbours far more than any other row does, (k,); none where many do.

    The jump of a row is its distance from the middle one of itself and its neighbours. Of noise, and of a motion that
    is sampled as it should be, the largest jumps differ little.
    """
    rows = np.flatnonzero(np.isfinite(values))
    known = values[rows]
    if len(known) < FEWEST:
        return rows[:0]
    before, here, after = known[:-2], known[1:-1], known[2:]
    jumps = np.abs(here - np.median(np.stack([before, here, after]), axis=0))
    order = np.argsort(jumps)[::-1]
    top = jumps[order[: FEW + 1]]
    wide = np.flatnonzero(top[:-1] > ALONE * top[1:])
    if not len(wide) or top[wide[-1] + 1] <= 0.0:
        return rows[:0]
    return np.sort(rows[1:-1][order[: wide[-1] + 1]])
