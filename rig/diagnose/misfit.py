"""Where a model fails: error against independent noise of every kind of channel, and the worst conditions in words.

The noise of a group is the rms of what its noise makes of the numbers compared, referred to the input; it is known from
records at rest and from what lies between the lines, whatever the model, or it is said to be no more than what a model
leaves over. The ratio is √(χ²/n), every row
weighed by its own noise, and the error is the noise times that: the rms of what the model leaves over, on that scale.
Held-out rows are judged by a model that was fitted without them. Errors are those of `rig.fit.quality`, as everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig.diagnose.misfit_cells import FEWEST, Cell, Table, cell, cells, tables
from rig.diagnose.misfit_laws import Law, in_words, laws, strongest
from rig.diagnose.whiteness import FEWEST as FEWEST_OF_SERIES
from rig.diagnose.whiteness import Whiteness, fisher_g, ljung_box, runs
from rig.fit import adequacy
from rig.fit.adequacy import RISK
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.fit.quality import Errors, Place, errors_from, errors_of, heldout_rows
from rig.fit.tails import limit
from rig.model import Term
from rig.motion import Array
from rig.parts.part import Finding, Origin

CONDITIONS = 3
SHARE = 0.3  # of the largest excess of χ²/n: a slice with less is not where the model fails
OWN = 0.5  # of a condition's excess must lie in rows that no worse condition explains


@dataclass(frozen=True)
class Group:
    """Channels of one kind in one experiment; error and noise in `unit`, SI, the noise known from `noise_from`."""

    name: str
    channels: tuple[str, ...]
    experiment: str
    error: float
    noise: float
    ratio: float
    heldout_ratio: float
    heldout_error: float = math.nan
    unit: str = ""
    noise_from: tuple[Origin, ...] = ()
    to_know: str = ""

    @property
    def told(self) -> bool:
        """Whether its noise is known independently of what a model leaves over."""
        return "misfit" not in self.noise_from

    def as_json(self) -> dict[str, Any]:
        """SI; a ratio that no row determines is null."""
        return {
            "name": self.name, "channels": list(self.channels), "experiment": self.experiment,
            "error": finite(self.error), "noise": finite(self.noise), "unit": self.unit, "ratio": finite(self.ratio),
            "heldout_ratio": finite(self.heldout_ratio), "heldout_error": finite(self.heldout_error),
            "noise_from": list(self.noise_from),
        }  # fmt: skip


@dataclass(frozen=True)
class Condition:
    """One condition: where, error against noise there, and how it grows in words; `z` as a normal deviate, and the most
    that noise hardly makes of the largest.
    """

    where: str
    ratio: float
    in_words: str
    z: float
    experiment: str
    component: str
    channels: tuple[str, ...]
    most: float
    against: str  # what the ratio is to

    @property
    def stands_out(self) -> bool:
        """Whether noise hardly does as much."""
        return self.z > self.most


@dataclass(frozen=True)
class Comparison:
    """A model against all that was measured of a unit: `errors` of all rows together and where they are largest,
    `references` that would have to leave their stated uncertainty for this model.
    """

    groups: tuple[Group, ...]
    worst: tuple[Condition, ...]
    whiteness: tuple[Whiteness, ...]
    fit: Fit = field(repr=False)
    errors: Errors
    references: tuple[Pull, ...] = ()

    def as_json(self, figures: Sequence[Path]) -> dict[str, Any]:
        """What `rig compare` prints."""
        worst = [{"where": one.where, "ratio": one.ratio, "in_words": one.in_words} for one in self.worst]
        return {
            "groups": [one.as_json() for one in self.groups], "error": self.errors.error,
            "heldout_error": finite(self.errors.heldout), "worst_at": place_as_json(self.errors.worst), "worst": worst,
            "references": [one.as_json() for one in self.references],
            "findings": [one.as_json() for one in self.faults], "figures": [str(p) for p in figures],
        }  # fmt: skip

    @property
    def faults(self) -> tuple[Finding, ...]:
        """What looks wrong with the records."""
        return tuple(dict.fromkeys(one for part in self.fit.parts for one in part.faults))


@dataclass(frozen=True)
class Pull:
    """Something of a reference that a fit moved so many stated standard uncertainties away from what is stated."""

    effect: str
    parameter: str
    title: str
    times: float

    @property
    def in_words(self) -> str:
        """One sentence."""
        return f"the {self.title} would have to be {self.times:.2g} times its stated uncertainty off"

    def as_json(self) -> dict[str, Any]:
        """As `rig compare --json` gives it."""
        return {
            "effect": self.effect, "parameter": self.parameter, "times": self.times, "in_words": self.in_words,
        }  # fmt: skip


def place_as_json(one: Place) -> dict[str, Any]:
    """Where an error is largest: ratios to the noise, the error in SI."""
    return {
        "where": one.where, "ratio": finite(one.ratio), "heldout_ratio": finite(one.heldout),
        "error": finite(one.error), "unit": one.unit,
    }  # fmt: skip


def compare(evidence: Evidence, terms: Sequence[Term] = (), poles: bool = True, shared: bool = False) -> Comparison:
    """Fit the data-sheet model with these effects to everything, and once more without held-out rows."""
    return comparison(evidence, evidence.fitted(terms, poles=poles, shared=shared))


def comparison(evidence: Evidence, found: Fit) -> Comparison:
    """From a fit to everything."""
    return _compared(found, errors_of(evidence, found))


def as_it_is(found: Fit) -> Comparison:
    """From parameters that were not fitted: rows held out are like all others."""
    out = heldout_rows(found)
    predicted = replace(found, left=found.left * out, use=out, chi2=float(np.sum(found.left[out] ** 2)))
    return _compared(found, errors_from(found, predicted if out.any() else None))


def _compared(found: Fit, errors: Errors) -> Comparison:
    made = tables(found)
    unseen = np.full(len(found.left), np.nan)
    if (predicted := errors.predicted) is not None and predicted.use is not None:
        unseen = np.where(predicted.use, predicted.left, np.nan)
    return Comparison(
        tuple(groups(found, made, unseen)), tuple(conditions(found, made)), tuple(_whiteness(made)), found, errors,
        tuple(pulls(found)),
    )  # fmt: skip


def pulls(found: Fit) -> Iterator[Pull]:
    """What is stated of references and cannot be, the farthest first."""
    standing = {(one.channel, one.domain) for one in adequacy.standing(adequacy.groups(found)) if one.count == 1}
    made = []
    for term in found.state.terms:
        for name, sigma in term.prior.items():
            if (term.effect.name, adequacy.stated(name)) in standing:
                several = f", {name}," if len(term.prior) > 1 else ""
                title = f"{term.effect.title}{several}"
                made.append(Pull(term.effect.name, name, title, abs(term.at[name]) / sigma))
    yield from sorted(made, key=lambda one: -one.times)


# groups


def untold(found: Fit) -> list[Group]:
    """Groups whose noise is not known independently."""
    if not adequacy.untold(found):
        return []
    return [one for one in groups(found, tables(found), np.full(len(found.left), np.nan)) if not one.told]


def groups(found: Fit, made: Sequence[Table], unseen: Array) -> Iterator[Group]:
    """Error and noise of every kind of channel; `unseen` (rows,) what is held out, NaN elsewhere."""
    sums: dict[tuple[str, str], list[Array]] = {}
    names: dict[tuple[str, str], dict[str, None]] = {}
    origins: dict[tuple[str, str], dict[Origin, None]] = {}
    units: dict[tuple[str, str], str] = {}
    advice: dict[tuple[str, str], str] = {}
    offsets = found.offsets()
    for table in made:
        held = unseen[offsets[table.number] : offsets[table.number + 1]]
        for name, row in zip(table.names, _sums(table, held), strict=True):
            key = (table.part.experiment, table.part.title(name))
            sums.setdefault(key, []).append(row)
            names.setdefault(key, {})[name] = None
            origins.setdefault(key, {})[table.part.origin(name)] = None
            units[key], advice[key] = table.part.unit(name), table.part.to_know
    for (experiment, title), rows in sums.items():
        square, number, chi2, count, held_chi2, held_count, error = np.sum(rows, axis=0).tolist()
        noise, ratio = _root(square, number), _root(chi2, count)
        unseen_ratio = _root(held_chi2, held_count) if held_count >= FEWEST else math.nan
        yield Group(
            f"{experiment}, {title}", tuple(names[experiment, title]), experiment,
            noise * ratio if math.isnan(error) else _root(error, number), noise, ratio, unseen_ratio,
            noise * unseen_ratio, units[experiment, title], tuple(origins[experiment, title]),
            advice[experiment, title],
        )  # fmt: skip


def _sums(table: Table, held: Array) -> Array:
    """For every name the sum of variances of the noise, SI², and of how many numbers, χ² and number of rows, those of
    what is held out, and the sum of squares of what is left, SI²; (names, 7).
    """
    part, used, held = table.part, table.used, held.reshape(table.used.shape)
    out = used & np.isfinite(held)
    noise = np.where(used, part.noise(), 0.0).sum(axis=1)
    chi2 = np.where(used, table.squares, 0.0).sum(axis=1)
    held_chi2 = np.where(out, held**2, 0.0).sum(axis=1)
    counts = used.sum(axis=1), held_chi2, out.sum(axis=1)
    return np.stack([noise, part.numbers(), chi2, *counts, part.errors(table.rest.left)], axis=1)


def _root(total: float, count: float) -> float:
    return math.sqrt(total / count) if count > 0.0 else math.nan


def finite(value: float) -> float | None:
    """A number that JSON has, null for what has no value."""
    return value if math.isfinite(value) else None


# the worst conditions


def conditions(found: Fit, made: Sequence[Table]) -> list[Condition]:
    """The three worst, each mostly in rows that no worse one explains."""
    ranked = sorted((one for table in made for one in cells(table)), key=lambda one: -one.z)
    most = limit(RISK, len(ranked))
    taken: list[tuple[Cell, Condition]] = []
    for one in ranked:
        if len(taken) == CONDITIONS:
            break
        if not any(_same(one, other) for other, _ in taken):
            condition = _condition(found, one, most)
            if not any(c.table.part.recurs(c.component) and c.component in condition.in_words for c, _ in taken):
                taken.append((one, condition))
    return [condition for _, condition in taken]


def _same(one: Cell, other: Cell) -> bool:
    """Whether a cell shows the component of another, or mostly in rows that are of that too."""
    part = one.table.part
    if not part.alike(other.table.part):
        return False
    if part.entangled(one.component, other.component):
        return True
    there = one.table.components.get(other.component)
    if there is None:
        return False
    used = one.table.used[list(one.rows)] & one.mask & there
    shared = float(one.table.squares[list(one.rows)][used].sum()) - float(np.count_nonzero(used))
    return bool(used.any()) and shared > (1.0 - OWN) * (one.chi2 - one.count)


def _condition(found: Fit, one: Cell, most: float) -> Condition:
    experiment = one.table.part.experiment
    name = _component(one.component)
    exact = [name, *([one.cut.words] if one.cut is not None else []), _who(one.channels, one.table)]
    where = f"{experiment}: {', '.join(exact)}"
    against = one.table.part.against
    if one.z <= most:
        words = f"nothing stands out; most in {name}, {_who(one.channels, one.table)}, {one.ratio:.2g} times {against}"
        return Condition(where, one.ratio, words, one.z, experiment, one.component, one.channels, most, against)
    ordered = laws(found, _alike(one))
    law = in_words(ordered)
    channels = _channels(one, ordered[0] if law else None, most)
    said = [name, *_slices(one, channels), *([law] if law else []), _who(channels, one.table)]
    return Condition(where, one.ratio, ", ".join(said), one.z, experiment, one.component, channels, most, against)


def _alike(one: Cell) -> Cell:
    """The component in every channel of the same quantity."""
    rates = one.table.rates
    rows = tuple(np.flatnonzero(rates == rates[one.rows[0]]).tolist())
    return cell(one.table, one.component, rows) or one


def _component(name: str) -> str:
    return {"magnitude": "magnitude", "phase": "phase", "mean": "mean output"}.get(name, name)


def _channels(one: Cell, law: Law | None, most: float) -> tuple[str, ...]:
    """Channels that stand out in a cell's component, its own if none does alone."""
    found = [
        one.table.names[row]
        for row in range(len(one.table.names))
        if (alone := cell(one.table, one.component, (row,), one.cut)) is not None and alone.z > most
    ]
    if law is not None:
        found = [n for n in one.table.names if n in {*found, *strongest(law)}]
    return tuple(found) if found else one.channels


def _slices(one: Cell, channels: tuple[str, ...]) -> list[str]:
    """Slices of frequency, or of rate and direction, in which these channels fail; nothing where it is everywhere."""
    rows = tuple(one.table.names.index(n) for n in channels)
    said = []
    for kind in ("frequency", "rate", "direction"):
        there = [cell(one.table, one.component, rows, cut) for cut in one.table.cuts if cut.kind == kind]
        known = [c for c in there if c is not None]
        most = max((c.ratio**2 - 1.0 for c in known), default=0.0)
        bad = [c for c in known if c.ratio**2 - 1.0 > SHARE * most]
        if bad and len(bad) < len(known):
            said.append(one.table.part.joined([c.cut for c in bad if c.cut is not None]))
    return said


def _who(channels: Sequence[str], table: Table) -> str:
    """`all axes of unit A and unit B`, `gyro yaw`, in words."""
    said, whole = [], []
    labels = dict(zip(table.names, table.part.labels, strict=True))
    for family in dict.fromkeys(labels[n][0] for n in channels):
        mine = [n for n in channels if labels[n][0] == family]
        every = [n for n in table.names if labels[n][0] == family]
        if len(every) > 1 and len(mine) == len(every):
            whole.append(family)
        else:
            said.append(f"{family.removesuffix('s')} {' and '.join(labels[n][1] for n in mine)}".strip())
    return ", ".join(([f"all axes of {' and '.join(whole)}"] if whole else []) + said)


# whiteness


def _whiteness(made: Sequence[Table]) -> Iterator[Whiteness]:
    """Tests of what each part says has no order in noise."""
    for table in made:
        for one in table.part.series(table.rest):
            if len(one.values) < FEWEST_OF_SERIES:
                continue
            if one.powers:
                yield fisher_g(one.values, one.where)
            else:
                yield runs(one.values, one.where)
                yield ljung_box(one.values, where=one.where)
