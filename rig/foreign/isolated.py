"""Rows that a smooth signal about them contradicts: a glitch, a value held for a row, a step of an angle's increments.

A row is held against the polynomial of fifth degree through three rows on either side (Lagrange's, at their own times):
what is sampled as finely as it should be lies on it up to noise. A row, or up to three together, stands alone if it is
far off, and nothing thereabouts is once it is taken out: a knock lasts, or its neighbours feel it. Where a case is
handled, most knocks last and some are over within a row: there a row off is no exception.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.foreign.finding import runs

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
SIDE = 3  # rows on either side
FAR = 6.5  # standard deviations of what noise leaves
OFF = 5.0  # of them, where rows are alike that hardly ever are: of three hundred such, noise is as far off in 1e-4
PAIRS = 200  # of rows all over, held against the same polynomial
ABOVE = 3.0  # times what one of a hundred of them reaches: of plain noise that is as far as the limit
FINE = 0.05  # share of rows that are like the one before, up to which they hardly ever are
KNOCK = 3.5  # of them, in another signal at about the same row: a case that was knocked
ABOUT = 7  # rows on either side
QUIET = 4.5  # of them, about a row that was taken out
PACES = 12  # groups of rows by how fast they change
BLOCK = 100  # rows whose scatter is looked at together
GAP = 1.3  # times the usual time between the outermost of them: one that is missing
TOGETHER = 3  # rows
MOST = 30  # places; where there are more they are no exception
KNOCKS, SOME = 3, 0.2  # places, and share of the rows that stand alone, from which on a case is one that is handled
STRICTER = 3.0  # power of how much heavier the tails are than normal noise's: noise has outermost rows of its own
FEWEST = 100


def isolated(values: Array, time: Array) -> Rows:
    """Rows that stand alone, (k,), among values (n,), NaN where there is none, at times (n,), s."""
    held = _against(values, time)
    if held is None:
        return np.zeros(0, np.intp)
    heavier = max(1.0, _tails(held.share)) ** STRICTER
    found = np.union1d(_standing(held, FAR * heavier), _alike(held, OFF * heavier)).astype(np.intp)
    return held.rows[_unlike_knocks(held, found)] if len(found) else found


def jumping(values: Array, time: Array) -> NDArray[np.bool_]:
    """Rows that are off the polynomial through their neighbours, or beside such, (n,): the case was knocked."""
    found, held = np.zeros(len(values), np.bool_), _against(values, time)
    if held is not None:
        near = np.convolve(held.share > KNOCK, np.ones(2 * ABOUT + 1), mode="same") > 0.5
        found[held.rows[near]] = True
    return found


@dataclass(frozen=True)
class _Held:
    """Rows with a number and a later stamp, (m,), held against the polynomial: their clock, s or rows, values, what
    each takes from its neighbours, the scatter of noise, and how far off each is in units of that.
    """

    rows: Rows
    clock: Array
    known: Array
    weights: Array
    scatter: Array
    share: Array


def _against(values: Array, time: Array) -> _Held | None:
    """None of too few rows, or such as scatter nowhere."""
    later = np.flatnonzero(np.isfinite(values) & np.isfinite(time))
    later = later[np.diff(np.maximum.accumulate(time[later]), prepend=-np.inf) > 0.0]
    if len(later) < FEWEST or not np.ptp(values[later]) > 0.0:
        return None
    known = values[later]
    span = time[later][2 * SIDE :] - time[later][: -2 * SIDE]
    whole = np.pad(span < GAP * float(np.median(span)), SIDE)  # rows that have no gap thereabouts
    # stamps that jitter more than the sampling does make things worse
    tried = []
    for clock in (time[later], np.arange(len(later), dtype=np.float64)):
        weights = _weights(clock)
        off = np.abs(_off(known, weights))
        tried.append((float(np.median(off)), clock, weights, off))
    _, clock, weights, off = min(tried, key=lambda one: one[0])
    off *= whole
    scatter = _scatter(off, known)
    return _Held(later, clock, known, weights, scatter, off / scatter) if (scatter > 0.0).all() else None


def _weights(time: Array) -> Array:
    """What every row takes from the six about it, (6, n), SIDE rows at either end nothing."""
    count, at = len(time), [*range(-SIDE, 0), *range(1, SIDE + 1)]
    middle = time[SIDE : count - SIDE]
    near = np.stack([time[SIDE + k : count - SIDE + k] - middle for k in at])
    above, below = np.ones_like(near), np.ones_like(near)
    for j, k in itertools.permutations(range(len(at)), 2):
        above[j] *= near[k]
        below[j] *= near[k] - near[j]
    return np.pad(above / below, ((0, 0), (SIDE, SIDE)))


def _off(known: Array, weights: Array) -> Array:
    """Distance of every row from the polynomial, in units in which plain noise is as large as it is, (n,)."""
    count = len(known)
    padded = np.pad(known, SIDE, mode="edge")
    at = [*range(-SIDE, 0), *range(1, SIDE + 1)]
    through = sum(weights[j] * padded[SIDE + k : SIDE + k + count] for j, k in enumerate(at))
    found = (known - through) / np.sqrt(1.0 + np.einsum("jn,jn->n", weights, weights))
    found[:SIDE] = found[-SIDE:] = 0.0
    return np.asarray(found)


def _scatter(off: Array, known: Array) -> Array:
    """Standard deviation of what noise leaves about every row, by medians: of the whole, or thereabouts if more, or of
    rows that change as fast if more: stamps that jitter count there.
    """
    pieces = np.array_split(off, max(1, len(off) // BLOCK))
    each = np.concatenate([np.median(np.array(list(one)), axis=1) for _, one in itertools.groupby(pieces, len)])
    beside = np.max([each, np.append(each[1:], each[-1]), np.append(each[0], each[:-1])], axis=0)
    size = np.repeat(np.maximum(beside, np.median(off)), [len(one) for one in pieces])
    size = 1.4826 * np.maximum(size, _as_fast(off, known))
    steps = np.abs(np.diff(known))
    coarse = 0.5 * float(np.min(steps[steps > 0.0], initial=np.inf))  # codes
    return np.asarray(np.maximum(size, coarse), np.float64)


def _tails(share: Array) -> float:
    """How far the outermost hundredth of what is not far off, nor beside such, lies out, against normal noise."""
    near = np.convolve(share > FAR, np.ones(2 * SIDE + 1), mode="same") > 0.5
    return np.inf if near.all() else float(np.quantile(share[~near], 0.99)) / 2.576


def _as_fast(off: Array, known: Array) -> Array:
    """Median of rows that change as fast, straight from group to group and on beyond the fastest, (n,)."""
    pace = np.abs(np.gradient(known))
    groups = np.array_split(np.argsort(pace), PACES)
    at = np.array([np.mean(pace[one] ** 2) for one in groups])
    square = np.array([np.median(off[one]) ** 2 for one in groups])
    slope, level = np.polyfit(at, square, 1)
    return np.asarray(np.sqrt(np.maximum(level + max(slope, 0.0) * pace**2, 0.0)))


def _standing(held: _Held, limit: float) -> Rows:
    """Numbers of the rows that stand alone."""
    order = np.argsort(held.share)[::-1]
    far = order[: int(np.count_nonzero(held.share > limit))]
    found: list[int] = []
    taken = np.zeros(len(held.known), np.bool_)
    for place, row in enumerate(far.tolist()):
        if place > MOST * (2 * SIDE + 1) or len(found) > MOST:
            return np.zeros(0, np.intp)
        if not taken[max(row - SIDE, 0) : row + SIDE + 1].any():
            group = _group(held, row)
            found += group
            taken[group] = True
    return np.array(sorted(found), np.intp)


def _group(held: _Held, row: int) -> list[int]:
    """The fewest rows about this one without which all is quiet; none if there are none such."""
    for count in range(1, TOGETHER + 1):
        for first in range(row - count + 1, row + 1):
            if _off_alone(held, out := np.arange(first, first + count), row) > QUIET:
                return [int(one) for one in out]
    return []


def _unlike_knocks(held: _Held, found: Rows) -> Rows:
    """Without those amid as much motion as goes with knocks, where these are no exception: places that stay off when
    the farthest row is taken out.
    """
    filled = held.known.copy()
    for out in np.split(found, np.flatnonzero(np.diff(found) > 1) + 1):
        filled[out] = _through(held, out, int(out[0]))
    off = np.abs(_off(filled, held.weights)) / held.scatter
    places = runs(np.convolve(off > QUIET, np.ones(2 * ABOUT + 1), mode="same") > 0.5)
    worst = [first + int(np.argmax(off[first : first + count])) for first, count in places]
    knocks = [row for row in worst if not _off_alone(held, np.array([row]), row)]
    if len(knocks) < max(KNOCKS, SOME * len(found)):
        return found
    motion = _motion_beside(filled)
    return np.asarray(found[motion[found] < motion[knocks].min()])


def _motion_beside(values: Array) -> Array:
    """How far values (n,) go on the livelier side of every row, a knock there not counted, (n,)."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    wide, away = 2 * ABOUT + 1, 3 * (ABOUT + 1) // 2
    span = np.pad(maximum_filter1d(values, wide) - minimum_filter1d(values, wide), away, mode="edge")
    return np.asarray(np.maximum(span[: len(values)], span[2 * away :]))


def _alike(held: _Held, limit: float) -> list[int]:
    """Rows that are like the one before where hardly any are, and off: held, or cut off at the top of a swing.

    Two together draw the polynomial through the others after them, so that each by itself is not far off; but so few
    are alike by chance that less will do. A motion that the polynomial does not follow is off anywhere by as much.
    """
    same = np.diff(held.known) == 0.0
    stand = [] if same.mean() > FINE else list(_alike_beyond(held, same, limit))
    if not stand or len(stand) > MOST:
        return []
    usual = float(np.quantile([_away(held, out, int(out[0])) for out in _anywhere(held)], 0.99))
    return [int(row) for out, off in stand if off > ABOVE * usual for row in out]


def _alike_beyond(held: _Held, same: NDArray[np.bool_], limit: float) -> Iterator[tuple[Rows, float]]:
    """Such rows, all together or all after the first, and how far off they are."""
    for first, more in runs(same):
        rows = np.arange(first, first + more + 1)
        for out in (rows, rows[1:]) if len(rows) <= TOGETHER else ():
            if (off := _off_alone(held, out, int(out[0]))) > limit:
                yield out, off
                break


def _off_alone(held: _Held, out: Rows, row: int) -> float:
    """How far the nearest of some rows is off what leads through those about them, in units of the scatter; nothing
    unless all is quiet without them.
    """
    begin, end = _about(held, out)
    if out[0] - begin < SIDE or end - 1 - out[-1] < SIDE:
        return 0.0
    filled = held.known[begin:end].copy()
    filled[out - begin] = _through(held, out, row)
    left = np.abs(_off(filled, held.weights[:, begin:end])) / held.scatter[begin:end]
    return _away(held, out, row) if left[SIDE:-SIDE].max() < QUIET else 0.0


def _away(held: _Held, out: Rows, row: int) -> float:
    """How far the nearest of some rows is off what leads through those about them, in units of the scatter."""
    return float(np.min(np.abs(held.known[out] - _through(held, out, row)) / held.scatter[out]))


def _anywhere(held: _Held) -> list[Rows]:
    """Pairs of rows all over."""
    at = np.linspace(3 * SIDE, len(held.known) - 3 * SIDE - 2, PAIRS).astype(np.intp)
    return [np.array([one, one + 1]) for one in at]


def _through(held: _Held, out: Rows, row: int) -> Array:
    """The polynomial in place of some rows: of one as everywhere, of several by least squares through more about them.

    Through the nearest of either side alone it would lead smoothly from one side of a step to the other.
    """
    if len(out) == 1:
        near = held.known[row - SIDE : row + SIDE + 1]
        return np.asarray([held.weights[:, row] @ np.delete(near, SIDE)])
    beside = np.setdiff1d(np.arange(*_about(held, out)), out)
    places, at = (held.clock[one] - held.clock[row] for one in (beside, out))
    return np.asarray(np.polyval(np.polyfit(places, held.known[beside], 5), at))


def _about(held: _Held, out: Rows) -> tuple[int, int]:
    """First and last + 1 of some rows and those about them, as far as there are any."""
    return max(int(out[0]) - 3 * SIDE, 0), min(int(out[-1]) + 1 + 3 * SIDE, len(held.known))
