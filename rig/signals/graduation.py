"""Pattern of an encoder's disk: what its lines show alike in every turn, at different speeds.

The mean over the turns of where each line passed, less an even turn, holds the disk's graduation, what the platter does
alike in every turn (its first orders), and a pattern of sampling that is another at another speed. Between two speeds
only the disk is common. Lines that err each for themselves give all orders the same; a pattern that runs over many
lines gives the low ones more.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.signals.encoder import LINES
from rig.signals.rotation import Edges, turns

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
FEWEST = 8  # turns
ALIKE = 0.05  # relative: speeds closer than that are one
PATTERN, EACH = (5, 60), (150, 450)  # orders of a pattern, and of lines that err each for themselves

LARGEST = 0.05  # share of orders that is left out
TOGETHER = 0.35  # relative: how far errors of lines may run together and be each line's own all the same


@dataclass(frozen=True)
class Graduation:
    """Standard deviation of the pattern, rad, with its standard uncertainty, and how unusual it is (χ²)."""

    rms: float
    u: float
    evidence: float


def line_errors(edges: Edges) -> tuple[float, Complexes] | None:
    """Speed, rad/s, and amplitudes by order (LINES/2 + 1,), rad; None for too few whole turns."""
    try:
        closed = turns(edges)
    except BadInput:
        return None
    count = len(closed.bounds) - 1
    if count < FEWEST:
        return None
    first = int(np.searchsorted(edges.times, closed.bounds[0]))
    table = edges.times[first : first + count * LINES].reshape(count, LINES)
    even = closed.bounds[:-1, None] + np.diff(closed.bounds)[:, None] * np.arange(LINES) / LINES
    speed = abs(closed.mean_rate)
    late = ((table - even) * (2.0 * math.pi / np.diff(closed.bounds)[:, None])).mean(axis=0)
    return speed, np.fft.rfft(late) * (2.0 / LINES)


def graduation(found: Sequence[tuple[float, Complexes]]) -> Graduation | None:
    """What the holds at different speeds have in common; None where all were at one speed."""
    ordered = sorted(found, key=lambda one: one[0])
    groups: list[tuple[float, list[Complexes]]] = []
    for speed, lines in ordered:
        if groups and speed < (1.0 + ALIKE) * groups[-1][0]:
            groups[-1][1].append(lines)
        else:
            groups.append((speed, [lines]))
    if len(groups) < 2:
        return None
    means = [np.mean(lines, axis=0) for _, lines in groups]
    cross = np.mean([(a * b.conj()).real for a, b in itertools.combinations(means, 2)], axis=0)
    pattern, each = (_trimmed(cross[low:high]) for low, high in (PATTERN, EACH))
    usual = float(each.mean())
    excess = float(pattern.mean()) - usual
    if not excess > 0.0 < usual:
        return None
    more = float(np.mean(cross[slice(*PATTERN)]) - np.mean(cross[slice(*EACH)]))
    rms = math.sqrt(max(0.5 * (PATTERN[1] - PATTERN[0]) * more, 0.0))
    by_chance = math.hypot(float(each.std()) / math.sqrt(len(pattern)), TOGETHER * usual)
    own = float(pattern.std()) / math.sqrt(len(pattern))  # what was drawn scatters too
    return Graduation(rms, 0.5 * rms * own / excess, (excess / by_chance) ** 2)


def _trimmed(powers: Array) -> Array:
    """Without the largest: a flutter that keeps step with the platter is in one order."""
    return np.sort(powers)[: round((1.0 - LARGEST) * len(powers))]
