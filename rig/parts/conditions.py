"""Logged temperature and supply as smooth functions of time.

They drift slowly, but are logged with noise; noise in what a model takes as given makes a fitted coefficient too small
and adds noise of its own. A polynomial in time replaces the readings where it leaves nothing but noise (von Neumann's
ratio of successive differences, 1941); readings that jump, as after a step of the supply, stay as they are.
"""

from __future__ import annotations

import math

import numpy as np

from rig.motion import Array

HIGHEST = 7  # degree
FEWEST = 4  # readings that show how something settles
SLOWEST, FASTEST, TRIED = 3.0, 0.05, 120  # of the time that readings span: how slowly they may settle
SETTLES = 0.05  # of what readings vary by, squared: what does not settle exponentially leaves more
# where nobody logged them: what the effects take as nominal, so that none of theirs does anything
NOMINAL = {"temperature": 25.0, "supply": 5.0}


def logged(**values: Array) -> frozenset[str]:
    """Names of the signals that a record holds: of whose readings some are numbers."""
    return frozenset(name for name, one in values.items() if np.isfinite(one).any())


def filled(name: str, values: Array) -> Array:
    """Readings (n,) with their mean where some are no numbers, and with what is nominal where all are."""
    known = np.isfinite(values)
    usual = float(values[known].mean()) if known.any() else NOMINAL[name]
    return np.asarray(np.where(known, values, usual), np.float64)


def smoothed(time: Array, values: Array) -> Array:
    """Readings (n,) at times (s, (n,)) without their noise, or as they are if no polynomial follows them."""
    if len(values) < 12 or not np.isfinite(values).all():
        return values
    span = float(np.ptp(time)) or 1.0
    x = 2.0 * (time - time.min()) / span - 1.0
    for degree in range(HIGHEST + 1):
        fit = np.polynomial.Chebyshev.fit(x, values, degree, domain=(-1.0, 1.0))
        left = values - fit(x)
        square = float(left @ left)
        if square == 0.0 or float(np.sum(np.diff(left) ** 2)) / square > 2.0 - 4.0 / math.sqrt(len(values)):
            return np.asarray(fit(x), np.float64)
    return values


def continued(time: Array, values: Array, at: Array) -> Array:
    """What readings (n,) at times (s, (n,)) will be at later ones (k,): going on to settle, if they settle
    exponentially, by no more than they have done; else what they were last.

    A bench that warms up is soon as warm as it gets: a later run does not show the same rise again.
    """
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(at), math.nan)
    order = np.argsort(time[known], kind="stable")
    now, here = values[known][order], time[known][order] - float(time[known].min())
    held = np.full(len(at), float(now[-1]))
    if len(now) < FEWEST or not here[-1] > 0.0:
        return held
    slownesses = here[-1] * np.geomspace(FASTEST, SLOWEST, TRIED)
    courses = [np.stack([np.ones(len(here)), np.exp(-here / one)], axis=1) for one in slownesses]
    sizes = [np.linalg.lstsq(columns, now, rcond=None)[0] for columns in courses]
    left = np.array([float(np.sum((now - a @ b) ** 2)) for a, b in zip(courses, sizes, strict=True)])
    best = int(left.argmin())
    if best in (0, TRIED - 1) or left[best] > SETTLES * float(np.sum((now - now.mean()) ** 2)):
        return held
    later = sizes[best][0] + sizes[best][1] * np.exp(-(at - float(time[known].min())) / slownesses[best])
    return np.asarray(np.clip(later, held - float(np.ptp(now)), held + float(np.ptp(now))), np.float64)
