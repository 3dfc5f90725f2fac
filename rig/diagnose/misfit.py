"""Where a model fails: error against independent noise of every kind of channel, and the worst conditions in words.

The noise of a group is the rms of what its independent noise makes of the numbers compared, referred to the input; it
is known from records at rest and from what lies between the lines, whatever the model. The ratio is √(χ²/n), every row
weighed by its own noise, and the error is the noise times that: the rms of what the model leaves over, on that scale.
Held-out rows are judged by a model that was fitted without them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rig.diagnose.misfit_cells import Cell, Mask, Table, cell, cells, span, tables, turned
from rig.diagnose.misfit_laws import Law, in_words, laws, strongest
from rig.diagnose.whiteness import FEWEST as FEWEST_VALUES
from rig.diagnose.whiteness import Whiteness, fisher_g, ljung_box, runs
from rig.fit import fit as fitting
from rig.fit.adequacy import FEWEST, LIMIT
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit, State
from rig.model import Term
from rig.motion import ORDERS, Array
from rig.parts.part import Tabled
from rig.parts.sines import Sines
from rig.parts.turning import Turning

CONDITIONS = 3
SHARE = 0.3  # of the largest excess of χ²/n: a slice with less is not where the model fails
OWN = 0.5  # of a condition's excess must lie in rows that no worse condition explains


@dataclass(frozen=True)
class Group:
    """Channels of one kind in one experiment; error and noise in m/s² or rad/s."""

    name: str
    channels: tuple[str, ...]
    experiment: str
    error: float
    noise: float
    ratio: float
    heldout_ratio: float

    def as_json(self) -> dict[str, Any]:
        """SI; a ratio that no row determines is null."""
        return {
            "name": self.name, "channels": list(self.channels), "experiment": self.experiment,
            "error": _number(self.error), "noise": _number(self.noise), "ratio": _number(self.ratio),
            "heldout_ratio": _number(self.heldout_ratio),
        }  # fmt: skip


@dataclass(frozen=True)
class Condition:
    """One condition: where, error against noise there, and how it grows in words; `z` as a normal deviate."""

    where: str
    ratio: float
    in_words: str
    z: float
    experiment: str
    component: str
    channels: tuple[str, ...]

    @property
    def stands_out(self) -> bool:
        """Whether noise hardly does as much."""
        return self.z > LIMIT


@dataclass(frozen=True)
class Comparison:
    """A model against all that was measured of a unit."""

    groups: tuple[Group, ...]
    worst: tuple[Condition, ...]
    whiteness: tuple[Whiteness, ...]
    fit: Fit = field(repr=False)

    def as_json(self, figures: Sequence[Path]) -> dict[str, Any]:
        """What `rig compare` prints."""
        worst = [{"where": one.where, "ratio": one.ratio, "in_words": one.in_words} for one in self.worst]
        return {
            "groups": [one.as_json() for one in self.groups], "worst": worst, "figures": [str(p) for p in figures],
        }  # fmt: skip


def compare(evidence: Evidence, terms: Sequence[Term] = (), poles: bool = True, shared: bool = False) -> Comparison:
    """Fit the data-sheet model with these effects to everything, and once more without held-out rows."""
    start = evidence.start(terms, poles=poles, shared=shared)
    whole = fitting.fit(evidence.parts, start)
    training = fitting.fit(evidence.parts, start, use=evidence.training)
    return comparison(whole, training.state, evidence.training)


def comparison(found: Fit, trained: State, training: Mask) -> Comparison:
    """From a fit to everything and the state of one without held-out rows."""
    made = tables(found)
    unseen = fitting.residual(found.parts, trained)
    return Comparison(
        tuple(_groups(found, made, np.where(training, np.nan, unseen))),
        tuple(conditions(found, made)),
        tuple(_whiteness(found, made)),
        found,
    )


# groups


def _groups(found: Fit, made: Sequence[Table], unseen: Array) -> Iterator[Group]:
    sums: dict[tuple[str, str], list[Array]] = {}
    names: dict[tuple[str, str], dict[str, None]] = {}
    offsets = found.offsets()
    for table in made:
        c = len(table.names)
        held = unseen[offsets[table.number] : offsets[table.number + 1]].reshape(c, -1)
        noises = _noises(table)
        errors = _errors(table, found.left[offsets[table.number] : offsets[table.number + 1]])
        for row, name in enumerate(table.names):
            title = table.part.title(name) if isinstance(table.part, Tabled) else table.families[row]
            key = (table.part.place, title)
            used, out = table.used[row], table.used[row] & np.isfinite(held[row])
            chi2 = float(table.squares[row][used].sum())
            counts = [float(used.sum()), float(np.sum(held[row][out] ** 2)), float(out.sum())]
            sums.setdefault(key, []).append(np.array([*noises[row], chi2, *counts, errors[row]]))
            names.setdefault(key, {})[name] = None
    for (place, family), rows in sums.items():
        square, number, chi2, count, held_chi2, held_count, error = np.sum(rows, axis=0).tolist()
        noise, ratio = _root(square, number), _root(chi2, count)
        yield Group(
            f"{place}, {family}", tuple(names[place, family]), place,
            noise * ratio if math.isnan(error) else _root(error, number), noise, ratio, _root(held_chi2, held_count),
        )  # fmt: skip


def _errors(table: Table, left: Array) -> Array:
    """Sum of squares of what is left, SI², where the part knows it, NaN else; (names,)."""
    return table.part.errors(left) if isinstance(table.part, Tabled) else np.full(len(table.names), math.nan)


def _root(total: float, count: float) -> float:
    return math.sqrt(total / count) if count > 0.0 else math.nan


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _noises(table: Table) -> Array:
    """Sum of variances of the noise, referred to the input by the data sheet, SI², and of how many numbers, (c, 2)."""
    if isinstance(table.part, Tabled):
        total = np.sum(np.where(table.used, table.part.noise(), 0.0), axis=1)
        return np.stack([total, table.part.numbers()], axis=1)
    sensitivity = table.part.channels.sensitivity
    if isinstance(table.part, Sines):
        return _line_noises(table.part, sensitivity, table.used)
    return _window_noises(table.part, sensitivity, table.used)


def _line_noises(part: Sines, sensitivity: Array, used: Mask) -> Array:
    """Of means and complex lines: the sensor's noise, and the reference's in channels along the drive."""
    data = part.data
    variance = 2.0 * data.variance / sensitivity[:, None, None] ** 2
    along = data.directions[data.channels.axis, 0] * ~data.channels.rates
    variance[..., :ORDERS] += 2.0 * np.multiply.outer(along**2, np.nan_to_num(data.reference_variance))
    since = float(data.begin.min())
    for row, model in enumerate(data.noise):
        own = np.diag(model.covariance(data.begin - since, data.end - since))
        variance[row, :, 0] = own / sensitivity[row] ** 2
    table = used.reshape(*data.usable.shape, -1)
    counted = np.concatenate([table[..., :1], table[..., 1::2]], axis=-1)
    return np.stack([np.sum(np.nan_to_num(variance) * counted, axis=(1, 2)), np.sum(counted, axis=(1, 2))], axis=1)


def _window_noises(part: Turning, sensitivity: Array, used: Mask) -> Array:
    """Of windows, in the band that is compared: lines of the cosine transform that count, and the means."""
    data = part.data
    lengths = np.array([end - begin for begin, end in data.stretches])
    since = float(data.time[0])
    begin = np.array([data.time[b] for b, _ in data.stretches]) - since - 0.5 * data.interval
    moving = part.frequency_of > 0.0
    total = np.zeros((len(sensitivity), 2))
    for row, model in enumerate(data.noise):
        means = np.diag(model.covariance(begin, begin + lengths * data.interval))
        lines = model.density(part.frequency_of[moving & used[row]]) / (2.0 * data.interval)
        total[row] = (float(means @ lengths) + float(lines.sum())) / sensitivity[row] ** 2, float(lengths.sum())
    return total


# the worst conditions


def conditions(found: Fit, made: Sequence[Table]) -> list[Condition]:
    """The three worst, each mostly in rows that no worse one explains."""
    ranked = sorted((one for table in made for one in cells(table)), key=lambda one: -one.z)
    taken: list[tuple[Cell, Condition]] = []
    for one in ranked:
        if len(taken) == CONDITIONS:
            break
        if not any(_same(one, other) for other, _ in taken):
            condition = _condition(found, one)
            if not any(other.component in condition.in_words for _, other in taken if "revolution" in other.component):
                taken.append((one, condition))
    return [condition for _, condition in taken]


def _same(one: Cell, other: Cell) -> bool:
    """Whether a cell shows the component of another, or mostly in rows that are of that too."""
    if one.table.part.place != other.table.part.place:
        return False
    if one.component == other.component or (_means(one) and _means(other)):
        return True
    there = one.table.components.get(other.component)
    if there is None:
        return False
    used = one.table.used[list(one.rows)] & one.mask & there
    shared = float(one.table.squares[list(one.rows)][used].sum()) - float(np.count_nonzero(used))
    return bool(used.any()) and shared > (1.0 - OWN) * (one.chi2 - one.count)


def _means(one: Cell) -> bool:
    """Whether a cell is of means over stretches, which are whitened together at rest and moving."""
    return one.component.startswith("mean, ")


def _condition(found: Fit, one: Cell) -> Condition:
    place = one.table.part.place
    name = _component(one.component)
    exact = [name, *([one.cut.words] if one.cut is not None else []), _who(one.channels, one.table)]
    where = f"{place}: {', '.join(exact)}"
    if one.z <= LIMIT:
        words = f"nothing stands out; most in {name}, {_who(one.channels, one.table)}, {one.ratio:.2g} times the noise"
        return Condition(where, one.ratio, words, one.z, place, one.component, one.channels)
    ordered = laws(found, _alike(one))
    law = in_words(ordered)
    channels = _channels(one, ordered[0] if law else None)
    said = [name, *_slices(one, channels), *([law] if law else []), _who(channels, one.table)]
    return Condition(where, one.ratio, ", ".join(said), one.z, place, one.component, channels)


def _alike(one: Cell) -> Cell:
    """The component in every channel of the same quantity."""
    rates = one.table.rates
    rows = tuple(np.flatnonzero(rates == rates[one.rows[0]]).tolist())
    return cell(one.table, one.component, rows) or one


def _component(name: str) -> str:
    return {"magnitude": "magnitude", "phase": "phase", "mean": "mean output"}.get(name, name)


def _channels(one: Cell, law: Law | None) -> tuple[str, ...]:
    """Channels that stand out in a cell's component, its own if none does alone."""
    found = [
        one.table.names[row]
        for row in range(len(one.table.names))
        if (alone := cell(one.table, one.component, (row,), one.cut)) is not None and alone.z > LIMIT
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
            said.append(_joined(bad, kind))
    return said


def _joined(bad: Sequence[Cell], kind: str) -> str:
    if kind != "frequency":
        return " and ".join(c.cut.words for c in bad if c.cut is not None)
    part = bad[0].table.part
    if not isinstance(part, Sines):
        return " and ".join(c.cut.words for c in bad if c.cut is not None)
    width = bad[0].table.squares.shape[1] // len(part.data.frequency)
    f = np.repeat(part.data.frequency, width)
    inside = np.concatenate([f[c.cut.mask] for c in bad if c.cut is not None])
    return f"{span(float(inside.min()), float(inside.max()))} Hz"


def _who(channels: Sequence[str], table: Table) -> str:
    """`all axes of unit A and unit B`, `gyro yaw`, in words."""
    said, whole = [], []
    family_of, word_of = (dict(zip(table.names, labels, strict=True)) for labels in (table.families, table.words))
    for family in dict.fromkeys(family_of[n] for n in channels):
        mine = [n for n in channels if family_of[n] == family]
        every = [n for n in table.names if family_of[n] == family]
        if len(every) > 1 and len(mine) == len(every):
            whole.append(family)
        else:
            said.append(f"{family.removesuffix('s')} {' and '.join(word_of[n] for n in mine)}".strip())
    return ", ".join(([f"all axes of {' and '.join(whole)}"] if whole else []) + said)


# whiteness


def _whiteness(found: Fit, made: Sequence[Table]) -> Iterator[Whiteness]:
    """Tests along frequency and time on the shaker, along time and over the lines on the turntable."""
    offsets = found.offsets()
    for table in made:
        left = found.left[offsets[table.number] : offsets[table.number + 1]]
        if isinstance(table.part, Sines):
            yield from _along(found, table, table.part, left)
        elif isinstance(table.part, Tabled):
            yield from _of_rows(table, left)
        else:
            yield from _of_platter(table, table.part, left)


def _of_rows(table: Table, left: Array) -> Iterator[Whiteness]:
    """Each kind of row of each name, in its order."""
    whole = left.reshape(len(table.names), -1)
    for row, name in enumerate(table.names):
        for what, mask in table.components.items():
            some = whole[row][mask & table.used[row]]
            if len(some) >= FEWEST_VALUES:
                yield runs(some, f"{table.part.name} {name}, {what}")
                yield ljung_box(some, where=f"{table.part.name} {name}, {what}")


def _along(found: Fit, table: Table, part: Sines, left: Array) -> Iterator[Whiteness]:
    lines = turned(found, part, table.number, left)[..., 0]
    data = part.data
    driven = np.flatnonzero(data.index >= 0)
    by_frequency = driven[np.lexsort((data.begin[driven], data.frequency[driven]))]
    for row, name in enumerate(table.names):
        if data.directions[data.channels.axis[row], 0] == 0.0 or data.channels.rates[row]:
            continue
        for what, values in (("magnitude", lines[row].real), ("phase", lines[row].imag)):
            for order, along in ((by_frequency, "frequency"), (driven, "time")):
                some = values[order][data.usable[row][order]]
                if len(some) >= FEWEST_VALUES:
                    where = f"{part.name} {name}, {what} along {along}"
                    yield runs(some, where)
                    yield ljung_box(some, where=where)


def _of_platter(table: Table, part: Turning, left: Array) -> Iterator[Whiteness]:
    whole = left.reshape(len(table.names), -1)
    for row, name in enumerate(table.names):
        if not part.channels.rates[row] or not part.data.usable[row]:
            continue
        means = whole[row, : len(part.data.stretches)]
        if len(means) >= FEWEST_VALUES:
            yield runs(means, f"{part.name} {name}, means along time")
            yield ljung_box(means, where=f"{part.name} {name}, means along time")
        longest = int(np.argmax(np.bincount(part.stretch_of[table.used[row]])))
        mine = whole[row][(part.stretch_of == longest) & (part.frequency_of > 0.0) & table.used[row]]
        pairs = mine[: len(mine) // 2 * 2].reshape(-1, 2)  # two cosine lines have two degrees of freedom
        if len(pairs) >= max(FEWEST, FEWEST_VALUES):
            yield fisher_g(np.sum(pairs**2, axis=1), f"{part.name} {name}, lines of the longest stretch")
