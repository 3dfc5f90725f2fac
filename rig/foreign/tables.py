"""Imported data as the analysis reads them: a manifest, and one table of numbers for every file.

A table holds what the files held, to the bit; `si` is where counts and units become SI, and nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import units
from rig.archive.records import Recorded, is_imported
from rig.errors import BadInput
from rig.foreign.finding import Finding, from_json
from rig.foreign.manifest import Column, Manifest
from rig.foreign.manifest import from_json as manifest_of
from rig.foreign.stamps import onward, rounded
from rig.yaml import document
from rig.yaml.document import Document

Array = NDArray[np.float64]
CONDITIONS = {
    "temperature": "temperature",
    "supply": "voltage",
}  # what is logged beside a motion, and as which quantity
CELSIUS = 273.15  # K at 0 °C
LARGEST = 1e150  # beyond it a number marks something, as infinity does: its square is none


def numbers(values: Array) -> Array:
    """The same with NaN in place of infinities, and of what is as good as one."""
    return np.where(np.abs(values) < LARGEST, values, math.nan)


@dataclass(frozen=True)
class Table:
    """One file's rows: `values` (n, columns) as they stood there, by the file's `names`."""

    label: str
    names: tuple[str, ...]
    values: Array
    settings: Mapping[str, str | float]
    held_out: bool

    def of(self, column: str) -> Array:
        """One column as it stood in the file, (n,), NaN for what is no number; KeyError if it was not kept."""
        return numbers(self.values[:, self.names.index(column)])


@dataclass(frozen=True)
class Foreign:
    """A run of imported data."""

    run: str
    manifest: Manifest
    tables: tuple[Table, ...]
    found: tuple[Finding, ...]  # what was found wrong with the files on import
    lines: Mapping[str, int] = field(default_factory=dict)  # of the manifest, in which a channel is named
    noticed: dict[tuple[int, str], tuple[Table, tuple[Finding, ...]]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    """What was found in single samples, by table and channel: looked for once."""

    def si(self, table: Table, column: Column) -> Array:
        """One column in SI, (n,): (number − zero) ÷ numbers per SI unit; NaN where the file has none."""
        return np.asarray((table.of(column.column) - column.zero) / column.scale, np.float64)

    def condition(self, table: Table, name: str) -> Array:
        """Temperature (°C) or supply (V) at every row, (n,): a column's, else the file's setting; NaN for neither."""
        there = self.manifest.of("condition", CONDITIONS[name])
        if there and name == "temperature" and there[0].unit == "K":
            return self.si(table, there[0]) - CELSIUS
        if there:
            return self.si(table, there[0])
        stated = table.settings.get(name)
        if not isinstance(stated, str):
            return np.full(len(table.values), math.nan)
        value = units.parse(stated, CONDITIONS[name]) - (CELSIUS if name == "temperature" else 0.0)
        return np.full(len(table.values), value)

    def time(self, table: Table) -> Array:
        """Time stamps, or made from rate or interval; s, (n,). Stamps in whole steps of an even clock are even, and
        after a clock was set back they go on; others are as they stand. BadInput without a time base.
        """
        stamps = self.stamps(table)
        behind = rounded(stamps) if self.manifest.time is not None and self.manifest.time.column is not None else None
        return onward(stamps) if behind is None else behind.instants

    def stamps(self, table: Table) -> Array:
        """Time stamps as they stand, or made from rate or interval; s, (n,). BadInput without a time base."""
        base = self.manifest.time
        if base is None:
            raise BadInput(f"{self.run}: found no time base, wanted one in the manifest")
        if base.column is not None:
            unit = units.KINDS["time"].units[base.unit]
            return np.asarray(table.of(base.column) * unit.multiply / unit.divide, np.float64)
        interval = base.interval if base.interval is not None else 1.0 / (base.rate or math.nan)
        return np.asarray(np.arange(len(table.values)) * interval, np.float64)

    def located(self, table: Table, one: Finding) -> Finding:
        """A finding in one of its files with when its rows were sampled, and the manifest's line."""
        line = self.lines.get(one.channel) if one.channel or one.kind.startswith("time") else None
        if not one.stretches or self.manifest.time is None:
            return replace(one, manifest_line=line)
        time, base = self.time(table), self.manifest.time
        times = tuple((float(time[first]), float(time[last])) for first, last in one.stretches)
        known = time[np.isfinite(time)]
        stamp = None if base.column is None else float(table.of(base.column)[one.stretches[0][0]])
        return replace(one, times=times, since=float(known[0]) if len(known) else 0.0, stamp=stamp, manifest_line=line)

    def u(self, table: Table, column: Column) -> Array | None:
        """Standard uncertainty of every number, SI, (n,); None if the manifest states none."""
        if column.uncertainty_column is not None:
            return np.asarray(np.abs(table.of(column.uncertainty_column) / column.scale) / column.coverage, np.float64)
        if column.uncertainty is None:
            return None
        value = units.parse(column.uncertainty, column.unit_kind or "ratio")
        return np.full(len(table.values), value / column.coverage)


def without_missing(made: Manifest, table: Table) -> Table:
    """With NaN where a column holds the number that stands for none, as its manifest says."""
    stated = {one.column: one.missing for one in made.columns if one.missing is not None}
    if not stated:
        return table
    values = table.values.copy()
    for name, number in stated.items():
        column = values[:, table.names.index(name)]
        column[column == number] = math.nan
    return replace(table, values=values)


def foreign_of(records: Recorded) -> Foreign:
    """The imported data of a run. Raises BadInput for a run that was not imported."""
    if not is_imported(records):
        raise BadInput(f"{records.name}: found no imported data, wanted a run that was imported")
    made = manifest_of(records.header["imported"])
    tables = tuple(without_missing(made, _table(records, body)) for _, body in sorted(records.points.items()))
    found = tuple(from_json(entry.body.get("found", entry.body)) for entry in records.lines if entry.kind == "finding")
    written = document.read_text(str(records.header["manifest"]["text"]), str(records.header["manifest"]["path"]))
    return Foreign(records.name, made, tables, found, lines_of(written, made))


def lines_of(written: Document, made: Manifest) -> dict[str, int]:
    """In which line of a manifest's file each channel is named, and the time."""
    columns = {one.channel: written.locate(("columns", k, "column"))[0] for k, one in enumerate(made.columns)}
    return {"": written.locate(("time",))[0], **columns}


def _table(records: Recorded, body: Mapping[str, Any]) -> Table:
    values, names = records.table(str(body["table"]))
    return Table(str(body["label"]), names, values, dict(body["settings"]), bool(body["held_out"]))
