"""What is wrong with a reference taken off: which effects decide how it is read, and an encoder's own errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rig.model import Effect, Term
from rig.motion import Array

REMEMBERED = 8  # readings of the reference
INVERSIONS = 3  # of shown into true angle; each gains a factor of the error's size
CLOSE = 1e-8  # rad: an inversion that changes no angle by more is the last


def reference_key(terms: Sequence[Term]) -> tuple[object, ...]:
    """What decides how the reference is read: effects of its stage with their coordinates, and how fine it must be."""
    stage = tuple((t.effect.name, *t.at.values()) for t in terms if t.effect.stage == "reference")
    return (*stage, any(t.effect.kinked for t in terms))


@dataclass(frozen=True)
class Shown:
    """What the encoder shows at every window: angle (NaN where no index ties it down), rate and acceleration; (n,)."""

    angle: Array
    rate: Array
    acceleration: Array


def true_motion(shown: Shown, terms: Sequence[Term]) -> tuple[Array, Array, Array]:
    """True angle, rate and acceleration: what the encoder shows is θ + Σδ(θ) of the true angle θ."""
    angle = shown.angle
    if not terms or not any(any(term.at.values()) for term in terms):
        return angle, shown.rate, shown.acceleration
    for _ in range(INVERSIONS):
        known, angle = angle, shown.angle - sum(term.effect.turned(np.nan_to_num(angle), term.at)[0] for term in terms)
        if not np.any(np.abs(angle - known) > CLOSE):
            break
    errors = [term.effect.turned(np.nan_to_num(angle), term.at) for term in terms]
    first, second = (sum((one[k] for one in errors), np.zeros_like(angle)) for k in (1, 2))
    rate = shown.rate / (1.0 + first)
    return angle, rate, (shown.acceleration - rate**2 * second) / (1.0 + first)


def turns(term: Term) -> bool:
    """Whether an effect adds to the angle that an encoder shows."""
    return type(term.effect).turned is not Effect.turned
