"""Numbers that stand for nothing, such as −999, and rows that stand alone far from all others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.foreign.finding import runs

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
FEWEST = 40  # numbers that say what is usual
FAR = 3.0  # times the span of all other numbers, beyond which a number is none of them
MARKS = 4  # values looked at, from the outermost
RARE = 0.1  # share of rows: a mark is rarer
ALONE = 8.0  # times the next smaller jump: rows that jump out and back
FEW = 20  # rows that jump
AROUND, LOCAL = 7, 2000  # rows whose median a row is held against, and by whose scatter
OUT = 8.0  # robust standard deviations
TURNING = 6.0  # times the motion from row to row: a median of seven rows is off by so much where motion turns back
LONGEST = 3  # rows that stand alone together; what lasts longer is motion
SPARSE = 0.01  # of the rows: what stands out more often is no exception
SPAN = 0.5  # of all that the other rows span


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
    """Rows that jump out and back far more than noise or motion does, (k,); none where many do.

    More than a few within seven rows are a knock, or whatever else happened to the case.
    """
    rest = values.copy()
    rest[rows := _by_span(values)] = np.nan
    rows = np.union1d(rows, _by_jumps(rest))
    if not len(rows):
        return rows
    groups = np.split(rows, np.flatnonzero(np.diff(rows) > AROUND) + 1)
    return np.concatenate([rows[:0], *(one for one in groups if len(one) <= LONGEST)])


def _by_jumps(values: Array) -> Rows:
    """Rows that jump from both neighbours far more than any other row does, (k,); none where many do.

    The jump of a row is its distance from the middle one of itself and its neighbours. Of noise, and of a motion that
    is sampled as it should be, the largest jumps differ little. A row whose jump is only to one of these stays.
    """
    rows = np.flatnonzero(np.isfinite(values))
    known = values[rows]
    if len(known) < FEWEST:
        return rows[:0]
    jumps = _jumps(known)
    order = np.argsort(jumps)[::-1]
    top = jumps[order[: FEW + 1]]
    wide = np.flatnonzero(top[:-1] > ALONE * np.maximum(top[1:], _smallest(known)))
    if not len(wide):
        return rows[:0]
    flagged = np.sort(order[: wide[-1] + 1] + 1)
    limit = ALONE * max(float(top[wide[-1] + 1]), _smallest(known))
    rest = np.delete(np.arange(len(known)), flagged)
    between = np.interp(flagged, rest, known[rest])
    return np.sort(rows[flagged[np.abs(known[flagged] - between) > limit]])


def _jumps(known: Array) -> Array:
    """Distance of every row but the ends from the middle one of itself and its neighbours, (n − 2,)."""
    before, here, after = known[:-2], known[1:-1], known[2:]
    return np.asarray(np.abs(here - np.median(np.stack([before, here, after]), axis=0)))


def _smallest(known: Array) -> float:
    """The smallest step between two values."""
    return float(np.min(np.diff(np.unique(known)), initial=np.inf))


def _by_span(values: Array) -> Rows:
    """Rows, up to three one after the other, that jump out and back far more than noise or motion does, (k,).

    They lie off the median of seven rows about them by much more than its scatter, in the whole record and thereabouts,
    than the motion there goes from row to row, and by half of all that the other rows span: a case that is knocked
    shows less. Where many do, it is no exception: none.
    """
    from scipy.ndimage import maximum_filter1d, median_filter

    there = np.flatnonzero(np.isfinite(values))
    seen = values[there]
    if len(seen) < FEWEST:
        return there[:0]
    middle = median_filter(seen, AROUND, mode="nearest")
    off = np.abs(seen - middle)
    pieces = np.array_split(off, max(1, len(off) // LOCAL))
    scatter = np.repeat([max(_scatter(one), _scatter(off)) for one in pieces], [len(one) for one in pieces])
    if not scatter.any():  # most rows are the median of those about them: the smallest step is the scale
        scatter[:] = float(np.min(np.diff(np.unique(seen)), initial=np.inf))
    pace = maximum_filter1d(np.abs(np.diff(middle, prepend=middle[0])), 2 * AROUND + 1)
    flags = _short(off > OUT * scatter + TURNING * pace)
    if not flags.any() or flags.mean() > SPARSE:
        return there[:0]
    return np.asarray(there[flags & (off > SPAN * float(np.ptp(seen[~flags])))])


def _short(flags: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Without what lasts longer than a few rows."""
    kept = np.zeros(len(flags), np.bool_)
    for first, count in runs(flags):
        kept[first : first + count] = count <= LONGEST
    return kept


def _scatter(off: Array) -> float:
    """Standard deviation by the median of absolute values, as for normal noise."""
    return 1.4826 * float(np.median(off)) if len(off) else 0.0
