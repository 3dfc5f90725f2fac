"""Laws that a misfit may follow, as small disturbances of every channel, and the χ² that each would remove."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.motion import Array
from rig.parts.part import Part
from rig.parts.remainder import Mask, Score


@dataclass(frozen=True)
class Shape:
    """One law in words, and its disturbance of every channel, V: one or two raw arrays as the part predicts them."""

    words: str
    raws: tuple[NDArray[np.inexact], ...]


def scored(
    part: Part, shapes: Iterable[Shape], beside: Sequence[NDArray[np.inexact]], rows: Sequence[int], score: Score,
    mask: Mask | None = None,
) -> Iterator[tuple[str, dict[int, float]]]:  # fmt: skip
    """What each law would remove in these rows of names beyond what disturbances `beside` it would."""
    others = [_columns(part, raw, mask) for raw in beside]
    bare = {row: score([column[row] for column in others]) for row in rows}
    for shape in shapes:
        columns = [*(_columns(part, raw, mask) for raw in shape.raws), *others]
        yield shape.words, {row: score([column[row] for column in columns]) - bare[row] for row in rows}


def _columns(part: Part, raw: NDArray[np.inexact], mask: Mask | None) -> Array:
    """Whitened rows of a disturbance of each channel alone, (c, rows)."""
    c = len(part.channels.names)
    white = part.each_channel(raw)
    if white.ndim == 2:
        return np.asarray(white.T)
    rows = white.reshape(c, -1) * (1.0 if mask is None else mask)
    found = np.zeros((c, c, rows.shape[1]))
    found[np.arange(c), np.arange(c)] = rows
    return found.reshape(c, -1)


def conditions(temperature: Array, supply: Array, time: Array) -> Iterator[tuple[str, Array]]:
    """Deviations from the mean, in units of their spread."""
    for name, values in (("the temperature", temperature), ("the supply", supply), ("time", time)):
        if np.isfinite(values).all() and np.ptp(values) > 0.0:
            yield name, (values - values.mean()) / float(np.std(values))
