"""By which law a misfit grows: with frequency, level, angle, rate, temperature, supply or time, found by score tests.

A law is a small disturbance of one component of one channel, c·shape, in whitened rows. How much χ² it would remove
after everything else in the model has been refitted is (v·r)²/(v·v − vᵀP v), with P the projection on the columns of
the fit (Rao 1948). Laws are compared by that, so that one hidden behind a fitted pole or sensitivity is still seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from rig.diagnose.misfit_cells import Cell
from rig.fit.fit import Fit
from rig.motion import Array

CLEAR = 12.0  # χ² that a law must remove to be worth saying
ALIKE = 9.0  # χ² within which laws cannot be told apart
MOST_ALIKE = 3
HIDDEN = 1e-6  # share of a shape's square that the fit must leave for it to be told apart


@dataclass(frozen=True)
class Law:
    """A law and what χ² it would remove, in every channel."""

    words: str
    gains: Mapping[str, float]

    @property
    def gain(self) -> float:
        return sum(self.gains.values())


def laws(found: Fit, one: Cell) -> list[Law]:
    """Laws that the part proposes for the component of a cell, in its channels, the best first."""
    table = one.table
    score = partial(_score, found, table.number, found.covariance)
    made = [
        Law(words, {table.names[row]: gain for row, gain in gains.items()})
        for words, gains in table.part.laws(one.component, one.rows, table.rest, score)
    ]
    return sorted(made, key=lambda law: -law.gain)


def _score(found: Fit, number: int, covariance: Array, columns: Sequence[Array]) -> float:
    """(v·r)ᵀ (vᵀv − vᵀPv)⁻¹ (v·r) for k columns (rows,) of one part."""
    if not columns:
        return 0.0
    first, v = found.offsets()[number], np.stack(columns, axis=1)
    if found.use is not None:
        v = v * found.use[first : first + len(v), None]
    square = v.T @ v
    size = np.sqrt(np.diag(square))
    size = np.where(size > 0.0, size, 1.0)
    seen = np.zeros((found.layout.size, v.shape[1]))
    for block in found.blocks:
        here = block.rows - first
        if len(here) and here[0] >= 0 and here[-1] < len(v):
            seen[block.columns] += block.matrix.T @ v[here]
    free = (square - seen.T @ covariance @ seen) / np.outer(size, size)
    down = v.T @ found.left[first : first + len(v)] / size
    values, vectors = np.linalg.eigh(free)
    kept = values > HIDDEN
    return float(np.sum((vectors[:, kept].T @ down) ** 2 / values[kept]))


def in_words(ordered: Sequence[Law]) -> str:
    """The best law, with those that the data hardly tell from it; "" if none removes enough to be worth saying."""
    if not ordered or ordered[0].gain < CLEAR:
        return ""
    alike = [law.words for law in ordered if law.gain >= ordered[0].gain - ALIKE][:MOST_ALIKE]
    common = ", ".join(alike[0].split(", ")[:-1])
    if len(alike) == MOST_ALIKE and not alike[0].startswith("follows "):  # hardly anything is excluded
        return common if all(words.startswith(f"{common}, ") for words in alike) else ""
    if common and all(words.startswith(f"{common}, ") for words in alike):
        return f"{common}, {' or '.join(words.removeprefix(f'{common}, ') for words in alike)}"
    if all(words.startswith("follows ") for words in alike):
        return f"follows {' or '.join(words.removeprefix('follows ') for words in alike)}"
    return " or ".join(alike) if "," not in "".join(alike) else alike[0]


def strongest(law: Law) -> tuple[str, ...]:
    """Channels in which a law removes a good share of what it removes in the best of them."""
    most = max(law.gains.values(), default=0.0)
    return tuple(n for n, g in law.gains.items() if g > max(0.05 * most, math.log(len(law.gains)) + 6.0))
