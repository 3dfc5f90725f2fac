"""Blocks of a record: which of them a model is judged by, and how those that wander together are made independent."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
THIRD = 1.0 / 3.0
ROUNDING = 1e-9
FEWEST = 3  # blocks that have one in the middle


def spread(states: Sequence[Hashable], share: float = THIRD) -> Mask:
    """Blocks to hold out, (n,): of each state every third in the order given, or another share as evenly.

    The count goes on from one state to the next, so that together they are the share too. What a state shows in a
    single block nothing else shows, and it is kept.
    """
    several = Counter(states)
    places = {state: k for k, state in enumerate(dict.fromkeys(states))}
    order = sorted((k for k, state in enumerate(states) if several[state] > 1), key=lambda k: places[states[k]])
    found = np.zeros(len(states), np.bool_)
    for number, k in enumerate(order):
        found[k] = math.floor((number + 1) * share + ROUNDING) > math.floor(number * share + ROUNDING)
    return found


def inward(held: Mask, sizes: Array, some: Mask) -> Mask:
    """Of `some` blocks, of sizes of their own, not the last of three held out but the one of middle size, (n,).

    Held out in the order of rising levels, the highest would say how a model does where it was never fitted.
    """
    found, places = held.copy(), np.flatnonzero(some)
    ends = np.flatnonzero(held[places]) + 1
    for group in np.split(places, ends):
        if len(group) >= FEWEST and held[group[-1]]:
            found[group[-1]] = False
            found[group[np.argsort(sizes[group], kind="stable")[len(group) // 2]]] = True
    return found


def unmixed(covariance: Array, last: Mask) -> Array:
    """Inverse Cholesky factor W of a covariance (n, n), WCWᵀ = 1, with some blocks `last` (n,), W's rows as C's.

    A row of the others then has nothing in it of those last.
    """
    order = np.argsort(last, kind="stable")
    found = np.zeros_like(covariance)
    square = np.ix_(order, order)
    found[square] = np.linalg.inv(np.linalg.cholesky(covariance[square]))
    return found
