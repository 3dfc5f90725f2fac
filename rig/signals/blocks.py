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


def unmixed(covariance: Array, last: Mask) -> Array:
    """Inverse Cholesky factor W of a covariance (n, n), WCWᵀ = 1, with some blocks `last` (n,), W's rows as C's.

    A row of the others then has nothing in it of those last.
    """
    order = np.argsort(last, kind="stable")
    found = np.zeros_like(covariance)
    square = np.ix_(order, order)
    found[square] = np.linalg.inv(np.linalg.cholesky(covariance[square]))
    return found
