"""Whether a model leaves nothing but noise: χ² by domain, channel and band, each against its own number of rows.

One χ² over everything hides a misfit that lives in a few rows. Rows are therefore tested in groups: means, every
harmonic and the mains lines of each channel on the shaker; means and three bands of each channel on the turntable, for
a moving platter and at rest. A density that was estimated is uncertain by some per cent; the tests allow for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rig.fit.fit import Fit
from rig.parts.part import ALLOWANCE

LIMIT = 5.0  # standard deviations of a group's χ²
FEWEST = 4


@dataclass(frozen=True)
class Group:
    """Some rows: where they are, χ², their number, and how far χ² is above that in standard deviations."""

    part: str
    experiment: str
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
    result = [one for number in range(len(found.parts)) for one in _of_part(found, number) if one.count >= FEWEST]
    return [*result, *_pulls(found)]


def _of_part(found: Fit, number: int) -> Iterator[Group]:
    """Every kind of row of every name."""
    part, rest = found.parts[number], found.rest(number)
    table, used = (one.reshape(len(part.row_names), -1) for one in (rest.left**2, rest.used))
    domains = part.domains()
    for row, name in enumerate(part.row_names):
        for domain, mask in domains.items():
            here = used[row, mask]
            chi2, count = float(table[row, mask][here].sum()), int(np.count_nonzero(here))
            yield Group(part.name, part.experiment, name, domain, chi2, count, part.allowance_of(name, mask))


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


def untold(found: Fit) -> list[tuple[int, str]]:
    """Number of the part and name of all rows whose noise is only what a model leaves over: no verdict stands on it."""
    return [
        (number, name)
        for number, part in enumerate(found.parts)
        for name, used in zip(part.row_names, part.counted.reshape(len(part.row_names), -1), strict=True)
        if used.any() and part.origin(name) == "misfit"
    ]


def excess(found: Fit) -> float:
    """χ² in excess of the number of rows, in groups that stand out."""
    return sum(max(one.chi2 - one.count, 0.0) for one in groups(found) if one.z > 3.0)
