"""Whether a model leaves nothing but noise: χ² by domain, channel and band, each against its own number of rows.

One χ² over everything hides a misfit that lives in a few rows. Rows are therefore tested in groups: means, every
harmonic and the mains lines of each channel on the shaker; means and three bands of each channel on the turntable, for
a moving platter and at rest. A density that was estimated is uncertain by some per cent; the tests allow for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.fit.fit import Fit
from rig.motion import ORDERS, Array
from rig.parts.part import Tabled
from rig.parts.sines import LINES, MAINS_ORDERS, Sines
from rig.parts.turning import Turning

ALLOWANCE = 0.06  # relative uncertainty of an estimated variance
LIMIT = 5.0  # standard deviations of a group's χ²
BANDS = ((0.0, 0.3), (0.3, 1.2), (1.2, 3.0), (3.0, 20.0))  # Hz
FEWEST = 4
KNOWN = 120.0  # s at rest that make a density as well known as the allowance says


@dataclass(frozen=True)
class Group:
    """Some rows: where they are, χ², their number, and how far χ² is above that in standard deviations."""

    part: str
    place: str
    channel: str
    domain: str
    chi2: float
    count: int
    allowance: float = ALLOWANCE

    @property
    def ratio(self) -> float:
        """Error against noise: √(χ²/n)."""
        return math.sqrt(self.chi2 / self.count)

    @property
    def z(self) -> float:
        """Excess of χ²/n in standard deviations, with the allowance; of a single prior its distance."""
        if self.count == 1:
            return math.sqrt(self.chi2)
        return (self.chi2 / self.count - 1.0) / math.sqrt(2.0 / self.count + self.allowance**2)


def groups(found: Fit) -> list[Group]:
    """Every group of rows."""
    result: list[Group] = []
    offsets = found.offsets()
    for part, first, end in zip(found.parts, offsets, offsets[1:], strict=False):
        left, counted = found.left[first:end], part.counted.copy()
        if found.use is not None:
            counted &= found.use[first:end]
        if isinstance(part, Sines):
            result += _of_sines(part, left, counted)
        elif isinstance(part, Turning):
            result += _of_turning(part, left, counted)
        elif isinstance(part, Tabled):
            result += _of_table(part, left, counted)
    return [*(one for one in result if one.count >= FEWEST), *_pulls(found)]


def _pulls(found: Fit) -> Iterator[Group]:
    """Nuisances that had to leave their stated uncertainty: the reference cannot be what its certificate says."""
    for term in found.state.terms:
        for name, sigma in term.prior.items():
            pull = (term.at[name] / sigma) ** 2
            yield Group("references", term.effect.places[0], term.effect.name, f"stated {name}", pull, 1)


def worst(found: Fit) -> Group | None:
    """The group furthest above its noise, None if there is none at all."""
    return max(groups(found), key=lambda one: one.z, default=None)


def adequate(found: Fit) -> bool:
    """Whether no group is above its noise by more than the limit."""
    one = worst(found)
    return one is None or one.z < LIMIT


def excess(found: Fit) -> float:
    """χ² in excess of the number of rows, in groups that stand out."""
    return sum(max(one.chi2 - one.count, 0.0) for one in groups(found) if one.z > 3.0)


def domains() -> tuple[str, ...]:
    """Domains of a sine record's rows, in their order: the mean, then two rows for each line."""
    return ("mean", *(f"{k}f" for k in range(1, ORDERS)), *("mains" if m == 1 else f"{m}×mains" for m in MAINS_ORDERS))


def _of_sines(part: Sines, left: Array, counted: NDArray[np.bool_]) -> Iterator[Group]:
    c, p = part.data.usable.shape
    table = (left**2).reshape(c, p, 2 * LINES - 1)
    used = counted.reshape(c, p, 2 * LINES - 1)
    for row, channel in enumerate(part.channels.names):
        for place, domain in enumerate(domains()):
            here = slice(0, 1) if place == 0 else slice(2 * place - 1, 2 * place + 1)
            yield _group(part.name, "shaker", channel, domain, table[row, :, here], used[row, :, here])


def _of_turning(part: Turning, left: Array, counted: NDArray[np.bool_]) -> Iterator[Group]:
    c = len(part.channels.names)
    table, used = (left**2).reshape(c, -1), counted.reshape(c, -1)
    masks = bands_of(part)
    allowance = ALLOWANCE * math.sqrt(max(KNOWN / max(part.data.resting, 1.0), 1.0))
    for row, channel in enumerate(part.channels.names):
        for domain, mask in masks.items():
            one = _group(part.name, "turntable", channel, domain, table[row, mask], used[row, mask])
            yield replace(one, allowance=allowance)


def _of_table(part: Tabled, left: Array, counted: NDArray[np.bool_]) -> Iterator[Group]:
    c = len(part.row_names)
    table, used = (left**2).reshape(c, -1), counted.reshape(c, -1)
    for row, name in enumerate(part.row_names):
        for domain, mask in part.domains().items():
            one = _group(part.name, part.place, name, domain, table[row, mask], used[row, mask])
            yield replace(one, allowance=part.allowance_of(name, mask))


def bands_of(part: Turning) -> dict[str, NDArray[np.bool_]]:
    """Rows of one channel by domain: means, and bands of frequency, of a moving platter and at rest."""
    stretches = len(part.data.stretches)
    moving = np.array([bool(np.any(part.data.counted.rate[b:e] != 0.0)) for b, e in part.data.stretches])
    of = part.stretch_of
    f = part.frequency_of
    mean = np.arange(len(of)) < stretches
    found = {"mean, moving": mean & moving[of], "mean, at rest": mean & ~moving[of]}
    for low, high in BANDS:
        inside = ~mean & (f >= low) & (f < high)
        found[f"{low:g}–{high:g} Hz, moving"] = inside & moving[of]
        found[f"{low:g}–{high:g} Hz, at rest"] = inside & ~moving[of]
    return found


def _group(part: str, place: str, channel: str, domain: str, squares: Array, used: NDArray[np.bool_]) -> Group:
    return Group(part, place, channel, domain, float(squares[used].sum()), int(np.count_nonzero(used)))
