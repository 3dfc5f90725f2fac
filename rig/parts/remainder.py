"""What a fit leaves over of a part, and what a part can tell of that, as values."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.model import Local, Quantity, Term
from rig.motion import Array

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
Score = Callable[[Sequence[Array]], float]
"""χ² that columns (rows,) of a part would remove once everything else in the model has been refitted."""


@dataclass(frozen=True)
class Prediction:
    """What a model says of a part: its channels and terms, and the outputs that `predict` makes of them."""

    local: Local
    terms: tuple[Term, ...]
    predict: Callable[[Local, Sequence[Term]], NDArray[np.inexact]]

    @cached_property
    def predicted(self) -> NDArray[np.inexact]:
        """Outputs as the part's `raw` has them."""
        return self.predict(self.local, self.terms)


@dataclass(frozen=True)
class Remainder(Prediction):
    """What is left over of a part beside the prediction: `left` in standard deviations, of rows that are `used`; both
    (rows,).
    """

    left: Array
    used: Mask


@dataclass(frozen=True)
class Cut:
    """Rows of one channel's table under one condition: `kind` as level or time, `words` as a person says it."""

    kind: str
    words: str
    mask: Mask


@dataclass(frozen=True)
class Series:
    """Numbers in an order in which noise has none, (n,); `powers` of lines with two degrees of freedom each instead."""

    where: str
    values: Array
    powers: bool = False


@dataclass(frozen=True)
class Growth:
    """Sizes of what is left over with their noise, SI, and what they may be a power of, by name; all (n,)."""

    size: Array
    noise: Array
    against: Mapping[str, Array]


@dataclass(frozen=True)
class Reversal:
    """Squares of what stays the same and of what changes its sign when the input or the sense is reversed.

    `decides`: it says it all, and no other rows of the same experiment are asked.
    """

    even: float
    odd: float
    decides: bool = False


@dataclass(frozen=True)
class Sign:
    """What an instrument's own test shows: an effect of the shelf by name, its coordinates with standard uncertainties,
    the strength of the evidence as χ², why, and on which channels.
    """

    effect: str
    at: Mapping[str, float]
    u: Mapping[str, float]
    evidence: float
    because: str
    on: Quantity | None = None
