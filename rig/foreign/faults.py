"""Samples that are no measurement: marks, rows that stand alone, stretches stuck or cut off, steps of a reference.

They are found in the numbers as they stand in the file, before any filter or fit. What is found is left out of what a
model is compared with, said on import, and keeps a model from being called adequate. A flat top below the extreme of a
channel is saturation, which is physics, and none of these.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.foreign import outliers
from rig.foreign.finding import Finding, Rows, listed, runs, stretches_of
from rig.foreign.isolated import isolated, jumping
from rig.foreign.manifest import KINDS, Column
from rig.foreign.repeats import contradicted
from rig.foreign.tables import Foreign, Table

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FROZEN = 20  # rows of one value that are looked at
SHORTEST = 3  # of them where hardly a row is like the one before
BESIDE, FINE, BY_CHANCE = (
    400,
    0.05,
    1e-4,
)  # rows on either side, share of equal ones there, and stretches that are rarer
PILED, UNIQUE = 3, 0.9  # rows at an extreme of a channel with so many different numbers
GAP = 1.5  # times the usual interval
# what stands still by itself, or is a counter: neither frozen values nor clipping mean anything there
STILL = ("frequency", "magnitude", "phase", "real", "imaginary", "excitation", "temperature", "line_a", "line_b",
         "index_line")  # fmt: skip
RESPONSES = ("magnitude", "phase", "real", "imaginary")
SIGNALS = ("acceleration", "rate", "voltage", "unstated")


def faults(data: Foreign, table: Table, column: Column) -> list[Finding]:
    """What is wrong with single samples of a column of a file that is sampled in time: with when, and left out."""
    key, accepted = (id(table), column.channel), column.findings == "accepted"
    if key not in data.noticed or data.noticed[key][0] is not table:
        data.noticed[key] = (
            table,
            tuple(
                replace(data.located(table, replace(one, where=table.label)), left_out=True, accepted=accepted)
                for one in _found(data, table, column)
            ),
        )
    return list(data.noticed[key][1])


def _found(data: Foreign, table: Table, column: Column) -> list[Finding]:
    values = table.of(column.column)
    if data.manifest.kind == "response":
        return list(_contradicted(data, table, column))
    finite = values[np.isfinite(values)]
    if not KINDS[data.manifest.kind].timed or column.quantity == "quaternion" or column.quantity in STILL:
        return []
    if len(finite) < 2 * FROZEN or np.ptp(finite) == 0.0:
        return []
    found: list[Finding] = [*_clipped(column, values)] if column.quantity in SIGNALS else []
    rest = values.copy()
    for one in found:
        rest[one.rows] = math.nan  # stands still and ends in a kink for a reason that is known
    frozen = list(_frozen(data, table, column, rest))
    for one in frozen:
        rest[one.rows] = math.nan
    if column.quantity in SIGNALS:
        found += _outliers(column, rest, data.time(table), _beside(data, table, column), _pieces(data, values))
    if column.quantity == "angle":
        found += _steps(data, table, column, values)
    return [*found, *frozen]


def without_faults(data: Foreign, table: Table, column: Column) -> Array:
    """A column in SI, (n,), NaN where its samples are no measurement; an angle goes on after a step as before it."""
    values = data.si(table, column).copy()
    for one in faults(data, table, column):
        if one.kind == "reference_step":
            values = _rejoined(values, one.rows)
        values[one.rows] = math.nan
    return values


def bridged(data: Foreign, table: Table, column: Column) -> Array:
    """A column in SI, (n,), with straight lines in place of samples that are no measurement."""
    rows = [one.rows for one in faults(data, table, column)]
    return lined(data.si(table, column), np.concatenate(rows)) if rows else data.si(table, column)


def lined(values: Array, rows: Rows) -> Array:
    """Values (n,) with a straight line in place of some rows."""
    good = np.ones(len(values), np.bool_)
    good[rows] = False
    there = np.flatnonzero(good)
    return np.where(good, values, np.interp(np.arange(len(values)), there, values[there]))


def left_out(data: Foreign) -> list[Finding]:
    """All samples in all files that a model is not compared with."""
    return [
        one
        for table in data.tables for column in data.manifest.columns if column.role in ("device", "reference")
        for one in faults(data, table, column)
    ]  # fmt: skip


def _of(column: Column, kind: str, rows: Rows, text: str) -> Finding:
    return Finding(kind, "", text, column.channel, stretches_of(rows))


# samples that stand out


def _beside(data: Foreign, table: Table, column: Column) -> list[Array]:
    """The other signals that feel a knock, each as it stands in the file."""
    others = (one for one in data.manifest.columns if one.role in ("device", "reference") and one.quantity in SIGNALS)
    return [table.of(one.column) for one in others if one.column != column.column]


def _pieces(data: Foreign, values: Array) -> list[slice]:
    """Rows that follow one another as one motion does: of poses that are named each by itself."""
    named = data.manifest.segments if data.manifest.kind == "poses" else []
    return [slice(one.first, one.last) for one in named] or [slice(0, len(values))]


def _outliers(
    column: Column, values: Array, time: Array, beside: Sequence[Array], pieces: Sequence[slice]
) -> Iterator[Finding]:
    """Numbers that stand for nothing, and rows that stand alone; what other signals feel too is a knock."""
    rest = values.copy()
    for mark in outliers.marks(values):
        n = len(mark.rows)
        many = f"{n} row{' holds' if n == 1 else 's hold'} {mark.value:.6g}"
        text = f"{column.channel}: {many}, all others lie within {mark.low:.4g} to {mark.high:.4g}: {listed(mark.rows)}"
        advice = f"; if it stands for no number, `missing: {mark.value:.6g}` says so"
        yield _of(column, "marks", mark.rows, text + advice)
        rest[mark.rows] = math.nan
    single = [here.start + isolated(rest[here], time[here]) for here in pieces]
    gaps = [(first, n) for first, n in runs(~np.isfinite(values)) if n > outliers.LONGEST]
    beside_gaps = np.concatenate([np.zeros(0, np.intp), *(np.array([first - 1, first + n]) for first, n in gaps)])
    rows = np.setdiff1d(
        np.concatenate([outliers.alone(rest), *single]), beside_gaps
    )  # what it was held against is gone
    rows = rows[~np.any([jumping(one, time)[rows] for one in beside], axis=0)] if beside and len(rows) else rows
    if n := len(rows):
        text = f"{column.channel}: {n} row{' stands' if n == 1 else 's stand'} alone, far from the rows beside"
        yield _of(column, "alone", rows, f"{text}: {listed(rows)}, the first at {values[rows[0]]:.6g}")


# stretches


def _clipped(column: Column, values: Array) -> Iterator[Finding]:
    """Plateaus at an extreme that the signal enters at speed, or rows that pile up there as nowhere else: a range that
    was exceeded.

    A signal that turns by itself comes to its extreme in its smallest steps; a cut one arrives in large ones.
    """
    for name, extreme in (("top", np.nanmax(values)), ("bottom", np.nanmin(values))):
        at = values == extreme
        if extreme != 0.0 and at.mean() <= 0.5 and (_entered(values, at) or _piled_up(values, float(extreme))):
            flats = runs(at)
            many = f"{len(flats)} stretch{'' if len(flats) == 1 else 'es'}"
            share = f"{int(at.sum())} rows in {many} stand at {extreme:.6g}"
            text = f"{column.channel}: clipped at the {name}: {share}, the first from row {flats[0][0]}"
            yield _of(column, "clipped", np.flatnonzero(at), text)


def _entered(values: Array, at: Mask) -> bool:
    """Whether an extreme is a plateau more than once, and entered at speed."""
    steps = np.abs(np.diff(values))
    moving = steps[np.isfinite(steps) & (steps > 0.0)]
    flats = [(first, n) for first, n in runs(at) if n >= 3]
    if len(flats) < 2 or sum(n for _, n in flats) < 8:
        return False
    entries = [steps[first - 1] for first, n in flats if first > 0 and np.isfinite(steps[first - 1])]
    smallest = float(np.min(moving, initial=np.inf))
    return bool(entries) and bool(np.median(entries) > max(3.0 * smallest, 0.1 * float(np.median(moving))))


def _piled_up(values: Array, extreme: float) -> bool:
    """Whether rows share an extreme of a channel whose numbers are otherwise each their own, and follow one another."""
    if 2 * sum(n for _, n in runs(values == extreme) if n >= 2) < int(np.count_nonzero(values == extreme)):
        return False  # a sine comes back to where it was
    known = values[np.isfinite(values)]
    kinds, each = np.unique(known, return_counts=True)
    inward, count = (kinds[::-1], each[::-1]) if extreme == kinds[-1] else (kinds, each)
    if count[0] < PILED or len(kinds) < UNIQUE * len(known) or count[1 : PILED + 1].max(initial=0) > 1:
        return False
    steps = np.abs(np.diff(known))
    return bool(abs(inward[1] - extreme) < 3.0 * float(np.median(steps[steps > 0.0])))  # else a number for nothing


def _frozen(data: Foreign, table: Table, column: Column, values: Array) -> Iterator[Finding]:
    """A value that repeats far longer than it would by chance while another channel moves."""
    odd = [one for one in _repeated(values) if one[1] >= FROZEN or column.quantity in SIGNALS]
    odd = [(first, n) for first, n in odd if _moves_beside(values, first, n)]
    told = column.quantity in SIGNALS and _share_alike(values, odd) < FINE  # then chance makes no twenty alike
    odd = [(first, n) for first, n in odd if told or n < FROZEN or _others_move(data, table, column, first, n)]
    if odd:
        first, n = max(odd, key=lambda one: one[1])
        rows = np.concatenate([np.arange(begin, begin + count) for begin, count in odd])
        where = f"in {len(odd)} stretch{'' if len(odd) == 1 else 'es'}, the longest {n} rows from row {first}"
        text = f"{column.channel}: frozen for {len(rows)} rows {where} (at {values[first]:.6g})"
        while_ = ", where no two rows are alike by chance" if told or n < FROZEN else " while other channels move"
        yield _of(column, "frozen", rows, text + while_)


def _repeated(values: Array) -> list[tuple[int, int]]:
    """Stretches of one value, first row and length, that are longer than chance makes them.

    With a share p of rows that are like the one before, n rows have a stretch of r by chance n·p^(r−1) times.
    """
    same = np.diff(values) == 0.0
    long = [(first, n + 1) for first, n in runs(same) if n + 1 >= FROZEN]
    outside = len(same) - sum(n - 1 for _, n in long)
    equal = int(same.sum()) - sum(n - 1 for _, n in long)
    chance = math.log(len(values)) / max(-math.log(max(equal / max(outside, 1), 1e-6)), 1e-3)
    found = [(first, n) for first, n in long if n > 4.0 * chance]
    for first, n in ((first, n + 1) for first, n in runs(same) if SHORTEST <= n + 1 < FROZEN):
        beside = np.concatenate((same[max(first - BESIDE, 0) : first], same[first + n - 1 : first + n - 1 + BESIDE]))
        p = max((equal - n + 2) / (outside + 2), float(beside.mean()) if len(beside) else 1.0)
        if p < FINE and n > math.log(len(values) / BY_CHANCE) / -math.log(p) + 1.0:
            found.append((first, n))
    return found


def _share_alike(values: Array, odd: Sequence[tuple[int, int]]) -> float:
    """Share of the rows outside these stretches that are like the one before."""
    steps = np.diff(values)
    for first, n in odd:
        steps[first : first + n - 1] = math.nan
    known = steps[np.isfinite(steps)]
    return float(np.mean(known == 0.0)) if len(known) else 1.0


def _moves_beside(values: Array, first: int, count: int) -> bool:
    """Whether the channel moves by more than a few of its smallest steps before and after it stood still."""
    steps = np.abs(np.diff(values))
    smallest = float(np.min(steps[steps > 0.0], initial=np.inf))
    beside = np.concatenate((values[max(first - 50, 0) : first], values[first + count : first + count + 50]))
    beside = beside[np.isfinite(beside)]
    return len(beside) > 1 and float(np.ptp(beside)) > 6.0 * smallest


def _others_move(data: Foreign, table: Table, column: Column, first: int, count: int) -> bool:
    """Whether another channel goes on that cannot while this one rightly stands still.

    A sensor always shows its noise, so its neighbours' steps decide; an angle or a position may rest, so there it is
    how far the neighbours go.
    """
    rests = column.quantity in ("angle", "position")
    for other in data.manifest.columns:
        if other.column == column.column or not _kin(data, other, column):
            continue
        values = table.of(other.column)
        here, whole = values[first : first + count], values
        if not rests:
            here, whole = np.diff(here), np.diff(whole)
        if np.isfinite(here).sum() > 2 and float(np.nanstd(here)) > 0.5 * float(np.nanstd(whole)) > 0.0:
            return True
    return False


def _kin(data: Foreign, one: Column, other: Column) -> bool:
    """Whether two channels move together; of the gyros, an angle knows the one on its axis only."""
    rotation = data.manifest.rotation
    if {one.quantity, other.quantity} == {"rate", "angle"}:
        return rotation is not None and rotation.axis in (one.axis, other.axis)
    groups = (("rate",), ("angle",), ("acceleration", "unstated", "voltage"), ("position",))
    return any(one.quantity in group and other.quantity in group for group in groups)


# repeats in a table


def _contradicted(data: Foreign, table: Table, column: Column) -> Iterator[Finding]:
    """Repeats that lie far off the others at their frequency: sizes by their ratio, phases by their difference."""
    frequency = data.manifest.of("reference", "frequency")
    if column.quantity not in RESPONSES or not frequency:
        return
    values = data.si(table, column)
    if column.quantity == "magnitude":
        values = np.log(np.where(values > 0.0, values, math.nan))
    elif column.quantity == "phase":
        values = np.unwrap(np.nan_to_num(values))
    rows = contradicted(values, data.si(table, frequency[0]))
    if n := len(rows):
        text = f"{column.channel}: {n} row{'' if n == 1 else 's'} of {column.quantity} contradict{'s' * (n == 1)}"
        yield _of(column, "alone", rows, f"{text} the repeats at the same frequency: {listed(rows)}")


# the reference's angle


def _steps(data: Foreign, table: Table, column: Column, values: Array) -> list[Finding]:
    """Where an angle jumps from one row to the next and goes on from there: counts that were lost, or a wrong index."""
    angle = np.asarray((values - column.zero) / column.scale, np.float64)
    there = np.flatnonzero(np.isfinite(angle))
    moved = np.diff(np.unwrap(angle[there], period=2.0 * math.pi))
    later = np.diff(data.time(table)[there])
    usual = float(np.median(later[later > 0.0])) if (later > 0.0).any() else math.inf
    moved[(np.diff(there) > 1) | ~((later > 0.0) & (later < GAP * usual))] = math.nan  # it may have turned meanwhile
    at, since = data.time(table)[there][1:], np.diff(data.time(table)[there])
    # by the stamps and from row to row: where stamps jitter and readings do not, a short interval is no leap
    by_time, by_row = isolated(np.where(since > 0.0, moved / since, math.nan), at), isolated(moved, at)
    out = np.union1d(outliers.alone(moved), np.intersect1d(by_time, by_row))
    # a single wrong reading jumps there and back: that is no step
    pairs = [
        k for k in out if not any(j in out and abs(moved[j] + moved[k]) < 0.2 * abs(moved[k]) for j in (k - 1, k + 1))
    ]
    if not pairs:
        return []
    rows = there[np.array(pairs) + 1]
    size = math.degrees(float(moved[pairs[int(np.argmax(np.abs(moved[pairs])))]]))
    text = f"{column.channel}: the reference steps by {size:.3g}° at {listed(rows)}"
    return [_of(column, "reference_step", rows, text)]


def _rejoined(angle: Array, rows: Rows) -> Array:
    """An angle, rad, without what it jumps by at these rows more than it goes on by there."""
    there = np.flatnonzero(np.isfinite(angle))
    whole = angle.copy()
    whole[there] = np.unwrap(angle[there], period=2.0 * math.pi)
    for row in rows:
        place = int(np.searchsorted(there, row))
        near = np.diff(whole[there[max(place - 4, 0) : place + 4]])
        jump = whole[row] - whole[there[place - 1]]
        whole[row:] -= jump - float(np.median(near))
    return whole
