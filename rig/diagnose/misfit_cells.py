"""What a fit leaves over, cut along every condition of the measurement: χ² of each cell against its number of rows.

A *component* is a kind of row: the mean, magnitude or phase of the driven line, a harmonic, hum, a band of frequency
or an order per revolution. A *cell* is a component of some channels under one condition. χ² of few rows is far from
normal, so its tail is judged, with the allowance for estimated variances.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from rig.fit.fit import Fit
from rig.fit.tails import deviate
from rig.motion import Array
from rig.parts.part import ALLOWANCE, Part
from rig.parts.remainder import Cut, Mask, Remainder

FEWEST = 4  # rows of a cell: what is shown of fewer is mostly chance


@dataclass(frozen=True)
class Table:
    """Squares of what a part left over, (names, width), and what each place of the width stands for."""

    part: Part
    number: int
    rest: Remainder
    squares: Array
    used: Mask
    components: Mapping[str, Mask]
    cuts: tuple[Cut, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return self.part.row_names

    @property
    def rates(self) -> Mask:
        """Whether each name's rows are of a rate, (names,)."""
        return self.part.row_rates


@dataclass(frozen=True)
class Cell:
    """χ² of some rows of a table: `rows` of its channels, `mask` of its width."""

    table: Table
    component: str
    rows: tuple[int, ...]
    cut: Cut | None
    chi2: float
    count: int

    @property
    def mask(self) -> Mask:
        """Places of the width, (width,)."""
        mask = self.table.components[self.component]
        return mask if self.cut is None else mask & self.cut.mask

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self.table.names[row] for row in self.rows)

    @property
    def ratio(self) -> float:
        """Error against noise: √(χ²/n)."""
        return math.sqrt(self.chi2 / self.count)

    @property
    def z(self) -> float:
        """How unusual χ² is, as a normal deviate."""
        return deviate(self.chi2, self.count, ALLOWANCE)


def tables(found: Fit) -> list[Table]:
    """One for every part."""
    return [_table(found, number) for number in range(len(found.parts))]


def _table(found: Fit, number: int) -> Table:
    part, rest = found.parts[number], found.rest(number)
    used = rest.used.reshape(len(part.row_names), -1)
    return Table(part, number, rest, part.squares(rest), used, part.components(), tuple(part.cuts()))


def cell(table: Table, component: str, rows: tuple[int, ...], cut: Cut | None = None) -> Cell | None:
    """Some rows together; None if there are too few."""
    mask = table.components[component]
    if cut is not None:
        mask = mask & cut.mask
    used = table.used[list(rows)] & mask
    count = int(np.count_nonzero(used))
    chi2 = float(table.squares[list(rows)][used].sum())
    return Cell(table, component, rows, cut, chi2, count) if count >= FEWEST else None


def cells(table: Table) -> Iterator[Cell]:
    """Every component of every family and channel, whole and under each condition."""
    families: dict[str, list[int]] = {}
    for row, (family, _) in enumerate(table.part.labels):
        families.setdefault(family, []).append(row)
    sets = {tuple(rows) for rows in families.values()} | {(row,) for row in range(len(table.names))}
    for component in table.components:
        for rows in sorted(sets):
            for cut in (None, *table.cuts):
                if (one := cell(table, component, rows, cut)) is not None:
                    yield one
