"""What is wrong with imported data, found and said, and never mended.

    for one in findings(foreign):
        print(one.where, one.text)            # "22 time stamps are the same as the one before: rows 9, 37, …"

Rows are counted from 0, as in a manifest's segments. This file looks at one column at a time and at its time stamps;
rig.foreign.pairs at the device against its reference, rig.foreign.frames at the axes of a triad, rig.foreign.lines at
tones and clocks. A finding is a sentence with its numbers. Thresholds are such that clean data with noise give none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rig.foreign import frames, straying, turns
from rig.foreign import lines as foreign_lines
from rig.foreign import pairs as foreign_pairs
from rig.foreign.faults import FROZEN, GAP, STILL, faults
from rig.foreign.finding import Finding, listed, runs, stretches_of
from rig.foreign.manifest import KINDS
from rig.foreign.stamps import rounded, set_back
from rig.foreign.tables import Foreign, Table

__all__ = ["Finding", "findings"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
RATES = (5.0, 2e5)  # Hz, between which inertial sensors are logged
JITTER = 0.005  # standard deviation of a time stamp worth a word, of the interval
DROPPED = 5  # whole rows that repeat


def findings(data: Foreign) -> list[Finding]:
    """Everything that looks wrong in imported data, file by file."""
    found = [data.located(table, one) for table in data.tables for one in _of_table(data, table)]
    return [*found, *foreign_lines.across(data), *straying.findings(data)]


def _of_table(data: Foreign, table: Table) -> Iterator[Finding]:
    if data.manifest.time is not None and data.manifest.time.column is not None:
        yield from _of_time(data, table)
    yield from _of_values(data, table)
    if KINDS[data.manifest.kind].timed:
        yield from _of_whole_rows(data, table)
    yield from _of_axes(data, table)
    yield from turns.findings(data, table)
    yield from foreign_lines.findings(data, table)


def _of_axes(data: Foreign, table: Table) -> Iterator[Finding]:
    """The device against its reference. With an attitude that turns the other way nothing can be said of axes; what a
    triad as a whole says holds the sign of each of its channels.
    """
    found = list(foreign_pairs.findings(data, table))
    backwards = any(one.kind == "quaternion_sense" for one in found)
    axes = [] if backwards else list(frames.findings(data, table))
    of = {one.channel: one.quantity for one in data.manifest.columns}
    said = {of[one.channel] for one in axes}
    yield from (one for one in found if one.kind != "sign" or of[one.channel] not in said)
    yield from axes


def _seconds(value: float) -> str:
    return f"{value:.4g} s" if value >= 1.0 else f"{value * 1e3:.4g} ms" if value >= 1e-3 else f"{value * 1e6:.4g} µs"


def _of_time(data: Foreign, table: Table) -> Iterator[Finding]:
    """Time stamps: not numbers, backwards, the same twice, far apart, uneven, implausible."""
    if (behind := rounded(data.stamps(table))) is not None:
        text = f"time stamps are whole multiples of {_seconds(behind.step)} of an even clock, one every"
        yield Finding("time_rounded", table.label, f"{text} {_seconds(behind.interval)}: rows are taken as even")
    if len(back := set_back(data.stamps(table))):
        row, raw = int(back[0]), data.stamps(table)
        text = f"the clock was set back at {listed(back)}, the first time from {raw[row - 1]:.6g} s to {raw[row]:.6g} s"
        yield Finding("time_set_back", table.label, f"{text}: what follows is taken to go on from there",
                      stretches=stretches_of(back))  # fmt: skip
    stamps = data.time(table)
    bad = np.flatnonzero(~np.isfinite(stamps))
    if len(bad):
        text = f"{len(bad)} time stamps are not numbers: {listed(bad)}"
        yield Finding("time_missing", table.label, text, stretches=stretches_of(bad))
    places = np.flatnonzero(np.isfinite(stamps))
    if len(places) < 3:
        return
    steps = np.diff(stamps[places])
    rows = places[1:]
    back = np.flatnonzero(steps < 0.0)
    if len(back):
        k = int(back[0])
        worst = f"the first from {stamps[rows[k] - 1]:.6g} s to {stamps[rows[k]]:.6g} s"
        text = f"time runs backwards at {listed(rows[back])}, {worst}"
        yield Finding("time_backwards", table.label, text, stretches=stretches_of(rows[back]))
    forward = steps[steps > 0.0]
    if len(forward) < 2:
        yield Finding("time_constant", table.label, "time does not run: nearly all time stamps are the same")
        return
    usual = float(np.median(forward))
    yield from _twice_and_gaps(table, steps, rows, usual)
    yield from _evenness(data, table, steps, usual, stamps)


def _twice_and_gaps(table: Table, steps: Array, rows: NDArray[np.int64], usual: float) -> Iterator[Finding]:
    twice = np.flatnonzero(steps == 0.0)
    if len(twice):
        text = f"{len(twice)} time stamp{' is' if len(twice) == 1 else 's are'} the same as the one before"
        found = stretches_of(rows[twice])
        yield Finding("time_duplicates", table.label, f"{text}: {listed(rows[twice])}", stretches=found)
    wide = np.flatnonzero(steps > GAP * usual)
    if len(wide):
        longest = wide[int(np.argmax(steps[wide]))]
        late = sum(bool(np.any(np.abs(twice - k) <= 1)) for k in wide)
        lost = _lost(steps, np.concatenate((wide, twice)))
        text = (
            f"{len(wide)} gap{'' if len(wide) == 1 else 's'} in the time stamps ({listed(rows[wide])}), the longest "
            f"{_seconds(float(steps[longest]))} before row {rows[longest]} where {_seconds(usual)} is usual"
        )
        text += f"; about {lost} sample{' is' if lost == 1 else 's are'} missing" if lost else ""
        beside = "stands" if late == 1 else "stand"
        text += f"; {late} {beside} beside a time stamp that is there twice: logged late, not lost" if late else ""
        yield Finding("time_gaps", table.label, text, stretches=stretches_of(rows[wide]))


def _lost(steps: Array, odd: NDArray[np.int64]) -> int:
    """Samples that are missing: what a stamp is late is made up for by the next ones, what is lost is not."""
    calm = np.ones(len(steps), bool)
    for shift in range(-3, 4):
        calm[np.clip(odd + shift, 0, len(steps) - 1)] = False
    if calm.sum() < 10:
        return 0
    usual, scatter = float(np.mean(steps[calm])), float(np.std(steps[calm]))
    missing = float(np.sum(steps)) / usual - len(steps)
    sure = 3.0 * scatter / usual * math.sqrt(len(steps) / calm.sum() * len(steps))
    return round(missing) if missing > max(0.7, sure) else 0


def _evenness(data: Foreign, table: Table, steps: Array, usual: float, stamps: Array) -> Iterator[Finding]:
    """Jitter beyond what the manifest states, stamps too coarse for a float, and a rate nobody would log at."""
    base = data.manifest.time
    near = steps[(steps > 0.3 * usual) & (steps < GAP * usual)]
    sd = float(np.std(near)) / math.sqrt(2.0) if len(near) > 10 else 0.0
    if base is not None and sd > max(base.jitter, JITTER * usual):
        text = f"time stamps jitter by {_seconds(sd)} (standard deviation), their usual interval is {_seconds(usual)}"
        stated = f", the manifest states {_seconds(base.jitter)}" if base.jitter else "; `time: {jitter: …}` states it"
        yield Finding("time_jitter", table.label, text + stated)
    coarse = float(np.spacing(np.nanmax(np.abs(stamps))))
    if coarse > 1e-4 * usual:
        text = f"time stamps are so large that they are held to {_seconds(coarse)} only, at {_seconds(usual)} apart"
        yield Finding("time_resolution", table.label, f"{text}: write them less their first")
    rate = 1.0 / usual
    if data.manifest.kind not in ("response", "sweep") and not RATES[0] <= rate <= RATES[1]:
        fits = [f"'{unit}' gives {rate * k:.4g} Hz" for unit, k in _other_units(data) if 10.0 <= rate * k <= 2e4]
        text = f"the time stamps say {rate:.4g} samples per second, which no inertial sensor is logged at"
        yield Finding("time_base", table.label, text + (f"; the unit {' and '.join(fits)}" if fits else ""))


def _other_units(data: Foreign) -> list[tuple[str, float]]:
    """Units the time stamps could be in, and how much the rate grows with each."""
    scale = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9}
    stated = data.manifest.time.unit.replace("u", "µ").replace("μ", "µ") if data.manifest.time is not None else "s"
    return [(unit, scale[stated] / k) for unit, k in scale.items() if stated in scale and unit != stated]


def _of_values(data: Foreign, table: Table) -> Iterator[Finding]:
    yield from _not_numbers(data, table)
    for column in data.manifest.columns:
        values = table.of(column.column)
        if column.quantity == "quaternion" or column.quantity in STILL or not KINDS[data.manifest.kind].timed:
            continue
        finite = values[np.isfinite(values)]
        if len(finite) < 2 * FROZEN:
            continue
        if np.ptp(finite) == 0.0:
            text = f"{column.channel}: every row holds {finite[0]:.6g}"
            yield Finding("constant", table.label, text, column.channel)
            continue
        yield from faults(data, table, column)


def _not_numbers(data: Foreign, table: Table) -> Iterator[Finding]:
    """Stretches without numbers; channels that lack the same rows share a sentence."""
    groups: dict[bytes, list[str]] = {}
    for column in data.manifest.columns:
        lacking = ~np.isfinite(table.of(column.column))
        if lacking.any():
            groups.setdefault(np.packbits(lacking).tobytes(), []).append(column.channel)
    for packed, channels in groups.items():
        lacking = np.unpackbits(np.frombuffer(packed, np.uint8), count=len(table.values)).astype(bool)
        stretches = runs(lacking)
        first, longest = max(stretches, key=lambda one: one[1])
        name = ", ".join(channels)
        count = f"{int(lacking.sum())} of {len(lacking)} rows are not numbers"
        where = f"in {len(stretches)} stretch{'' if len(stretches) == 1 else 'es'}"
        text = f"{name}: {count}, {where}, the longest {longest} rows from row {first}"
        yield Finding("not_numbers", table.label, text, channels[0], stretches_of(np.flatnonzero(lacking)))


def _of_whole_rows(data: Foreign, table: Table) -> Iterator[Finding]:
    """Rows of zeros, and whole rows that repeat, where that is no chance."""
    columns = [one for one in data.manifest.columns if one.quantity not in STILL]
    if not columns:
        return
    values = np.column_stack([table.of(one.column) for one in columns])
    moving = values[:, np.array([_moves(one) for one in values.T])]
    if moving.shape[1] == 0:
        return
    zeros = np.all(values == 0.0, axis=1)
    if zeros.any() and _not_by_chance(moving[~zeros] == 0.0, zeros):
        where = listed(np.flatnonzero(zeros))
        n = int(zeros.sum())
        text = f"{n} row{' is' if n == 1 else 's are'} all zeros: {where}"
        yield Finding("zeros", table.label, text, stretches=stretches_of(np.flatnonzero(zeros)))
    same = np.all(np.diff(moving, axis=0) == 0.0, axis=1) & ~zeros[1:]
    stretches = [(first, n + 1) for first, n in runs(same) if n + 1 >= DROPPED]
    rest = np.diff(moving, axis=0)[~same] == 0.0
    if stretches and float(np.prod(np.mean(rest, axis=0))) ** (DROPPED - 2) * len(values) < 1e-3:
        first, n = max(stretches, key=lambda one: one[1])
        text = f"whole rows repeat in {len(stretches)} stretch{'' if len(stretches) == 1 else 'es'}"
        found = tuple((begin, begin + count - 1) for begin, count in stretches)
        yield Finding("rows_repeat", table.label, f"{text}, the longest {n} rows from row {first}", stretches=found)


def _moves(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return len(known) > 0 and float(np.ptp(known)) > 0.0


def _not_by_chance(zero: Mask, zeros: Mask) -> bool:
    """Whether more rows are zero than columns that are zero now and then would bring about."""
    expected = len(zeros) * float(np.prod(np.mean(zero, axis=0))) if len(zero) else math.inf
    longest = max(n for _, n in runs(zeros))
    return expected < 1e-2 * int(zeros.sum()) and (zero.shape[1] >= 3 or longest >= 3)
