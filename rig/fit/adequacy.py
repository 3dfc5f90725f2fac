"""Whether a model leaves nothing but noise: χ² by domain, channel and band, each against its own number of rows.

One χ² over everything hides a misfit that lives in a few rows. Rows are therefore tested in groups: means, every
harmonic and the mains lines of each channel on the shaker; means and three bands of each channel on the turntable, for
a moving platter and at rest. A density that was estimated is uncertain by some per cent; the tests allow for it, and
for as many groups as there are.

Rows that a fit left out are tested too, against their noise and what the fit does not know of its parameters: with J
their derivatives and C the covariance of the fit, rᵀ(1 + J·C·Jᵀ)⁻¹r is χ² of as many rows as there are. What a part
finds out for itself from the other rows (`Part.unsure`) counts like parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rig.fit import fit as fitting
from rig.fit.fit import Fit
from rig.fit.tails import deviate, limit
from rig.motion import Array
from rig.parts.part import ALLOWANCE, Part
from rig.parts.remainder import Indices, Mask

RISK = 0.01  # that noise alone makes any of the groups stand out
FEWEST = 2  # rows of a group
EXCEEDS = 3.0  # deviates from which a group counts as more than noise in a sum
FEWEST_HELD = 8  # rows held out, from which anything can be said of them
BY_CHANCE = 0.005  # half of that risk: that noise alone leaves too much in any of the parts' directions
ROUNDING = 1e-12  # of the largest direction's square: what is no longer changes nothing
TOLD = 0.02  # of a direction's χ²: what the fit leaves of it, from which it can be told from what the fit adjusts


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
        """How unusual χ² is, as a normal deviate, with the allowance; of a single prior its distance."""
        return math.sqrt(self.chi2) if self.count == 1 else deviate(self.chi2, self.count, self.allowance)


def groups(found: Fit) -> list[Group]:
    """Every group of rows."""
    result = [one for number in range(len(found.parts)) for one in _of_part(found, number) if one.count >= FEWEST]
    return [*result, *_pulls(found)]


def _of_part(found: Fit, number: int) -> Iterator[Group]:
    """Every kind of row of every name."""
    rest = found.rest(number)
    for name, domain, mask, rows in _kinds(found.parts[number], rest.used):
        part, left = found.parts[number], rest.left[rows]
        yield Group(part.name, part.experiment, name, domain, float(left @ left), len(rows),
                    part.allowance_of(name, mask))  # fmt: skip


def _kinds(part: Part, used: Mask) -> Iterator[tuple[str, str, Mask, Indices]]:
    """Name, domain, which of the name's rows are of that (width,), and which of the part's rows are and are used."""
    domains = part.domains()
    for row, name in enumerate(part.row_names):
        for domain, mask in domains.items():
            here = np.flatnonzero(mask) + row * part.width
            yield name, domain, mask, here[used[here]]


def unseen(trained: Fit) -> list[Group]:
    """Every group of rows that a fit left out, with χ² as it is judged; [] where there are too few to judge."""
    if trained.use is None:
        return []
    whole = fitting.linearised(trained.parts, trained.state)
    found = [one for number in range(len(whole.parts)) for one in _predicted(whole, trained, number)]
    return [one for one in found if one.count >= FEWEST] if sum(one.count for one in found) >= FEWEST_HELD else []


def _predicted(whole: Fit, trained: Fit, number: int) -> Iterator[Group]:
    """Groups of a part that were left out; `whole` has all rows and columns at the parameters of `trained`."""
    part, first = whole.parts[number], whole.offsets()[number]
    assert trained.use is not None
    out = part.counted & ~trained.use[first : first + part.rows]
    rest = whole.rest(number)
    unsure = part.unsure(rest.local, rest.terms)
    for name, domain, mask, rows in _kinds(part, out):
        if len(rows):
            block = next(one for one in whole.blocks if first + rows[0] in one.rows)
            matrix = block.matrix[np.searchsorted(block.rows, first + rows)]
            chi2 = distance(whole.left[first + rows], matrix, block.columns, trained.normal, unsure[rows])
            allowance = part.allowance_of(name, mask)
            yield Group(part.name, part.experiment, name, domain, chi2, len(rows), allowance)


def distance(left: Array, matrix: Array, columns: Indices, normal: Array, unsure: Array | None = None) -> float:
    """rᵀ(1 + J·C·Jᵀ)⁻¹r of rows r (n,) with derivatives J (n, k) by some parameters, C the inverse of the normal matrix
    of all; what that does not determine takes all that it can. `unsure` (n, m) moves with as many numbers more, each
    known to one.
    """
    here, size = matrix if unsure is None else np.hstack([matrix, unsure]), len(normal)
    extra = here.shape[1] - matrix.shape[1]
    columns = np.concatenate([columns, size + np.arange(extra)])
    pull, more = np.zeros(size + extra), np.eye(size + extra)
    more[:size, :size] = normal
    pull[columns] = here.T @ left
    more[np.ix_(columns, columns)] += here.T @ here
    return max(float(left @ left) - float(pull @ fitting.inverse(more) @ pull), 0.0)


def unsteady(found: Fit) -> list[Group]:
    """Directions of the parts in which more is left than noise: what steps or creeps while χ² of all rows hides it."""
    tried = changes(found)
    most = limit(BY_CHANCE, len(tried))
    return sorted((one for one in tried if _unusual(one) > most), key=lambda one: -_unusual(one))


def _unusual(one: Group) -> float:
    return deviate(one.chi2, one.count, one.allowance)


def changes(found: Fit) -> list[Group]:
    """Every direction in which something of a part may change in its course, with the χ² that it would take away beside
    all that the fit adjusts.
    """
    covariance, offsets = found.covariance, found.offsets()
    made = []
    for number, part in enumerate(found.parts):
        rest, first = found.rest(number), offsets[number]
        left = np.where(rest.used, rest.left, 0.0)
        blocks = [one for one in found.blocks if len(one.rows) and first <= one.rows[0] < first + part.rows]
        for name, words, columns in part.changes():
            seen = columns * rest.used[:, None]
            pull = np.zeros((len(found.normal), seen.shape[1]))
            for one in blocks:
                pull[one.columns] += one.matrix.T @ seen[one.rows - first]
            size = np.sum(seen**2, axis=0)
            beside = size - np.einsum("ik,ij,jk->k", pull, covariance, pull)
            tell = (beside > TOLD * size) & (size > ROUNDING * size.max(initial=0.0))
            mine = part.counted.reshape(len(part.row_names), -1)[part.row_names.index(name)]
            allowance = part.allowance_of(name, mine)
            made += [
                Group(part.name, part.experiment, name, words, float(chi2), 1, allowance)
                for chi2 in (seen.T @ left)[tell] ** 2 / beside[tell]
            ]
    return made


def _pulls(found: Fit) -> Iterator[Group]:
    """Nuisances that had to leave their stated uncertainty: the reference cannot be what its certificate says."""
    for term in found.state.terms:
        for name, sigma in term.prior.items():
            pull = (term.at[name] / sigma) ** 2
            yield Group("references", term.effect.places[0], term.effect.name, stated(name), pull, 1)


def stated(name: str) -> str:
    """Domain of what is stated of a reference's parameter."""
    return f"stated {name}"


def worst(found: Fit) -> Group | None:
    """The group furthest above its noise, None if there is none at all."""
    return max(groups(found), key=lambda one: one.z, default=None)


def standing(groups: Sequence[Group]) -> list[Group]:
    """Those of all groups that stand out of the noise, the most unusual first."""
    most = limit(RISK, len(groups))
    return sorted((one for one in groups if one.z > most), key=lambda one: -one.z)


def adequate(found: Fit) -> bool:
    """Whether no group stands out of its noise."""
    return not standing(groups(found))


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
    return sum(max(one.chi2 - one.count, 0.0) for one in groups(found) if one.z > EXCEEDS)
