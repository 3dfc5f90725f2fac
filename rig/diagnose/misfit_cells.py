"""What a fit leaves over, cut along every condition of the measurement: χ² of each cell against its number of rows.

A *component* is a kind of row: the mean, magnitude or phase of the driven line, a harmonic, hum, a band of frequency
or an order per revolution. A *cell* is a component of some channels under one condition. χ² of few rows is far from
normal, so its cube root is judged (Wilson and Hilferty 1931, PNAS 17, 684), with the allowance for estimated variances.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.fit.adequacy import ALLOWANCE, FEWEST, bands_of, domains
from rig.fit.fit import Fit
from rig.model import labelled
from rig.motion import Array, Complexes
from rig.parts.part import Cut, Tabled
from rig.parts.sines import LINES, Sines, split
from rig.parts.turning import Turning

Mask = NDArray[np.bool_]
STEADY = 0.02  # of the rate
HIGHEST_ORDER = 3
NOMINAL: Mapping[str, float] = {"16⅔": 50.0 / 3.0, "33⅓": 100.0 / 3.0, "45": 45.0, "78": 78.0}
NEAR = 0.04  # of a nominal speed
BESIDE = 2.5  # lines on either side of an order


@dataclass(frozen=True)
class Table:
    """Squares of what a part left over, (channels, width), and what each place of the width stands for."""

    part: Sines | Turning | Tabled
    number: int
    squares: Array
    used: Mask
    components: Mapping[str, Mask]
    cuts: tuple[Cut, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return self.part.row_names if isinstance(self.part, Tabled) else self.part.channels.names

    @property
    def families(self) -> tuple[str, ...]:
        """What each name's unit is called."""
        part = self.part
        return tuple(labelled(n)[0] for n in self.names) if isinstance(part, Tabled) else part.channels.titles

    @property
    def words(self) -> tuple[str, ...]:
        """Which axis of its unit each name is."""
        part = self.part
        return tuple(labelled(n)[1] for n in self.names) if isinstance(part, Tabled) else part.channels.words

    @property
    def rates(self) -> Mask:
        """Whether each name's rows are of a rate, (names,)."""
        return self.part.row_rates if isinstance(self.part, Tabled) else self.part.channels.rates


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
        return deviate(self.chi2, self.count)


def deviate(chi2: float, count: int) -> float:
    """χ² of so many rows as a normal deviate, variances known to within the allowance."""
    mean = 1.0 - 2.0 / (9.0 * count)
    return (math.cbrt(chi2 / count) - mean) / math.sqrt(2.0 / (9.0 * count) + (ALLOWANCE / 3.0) ** 2)


def tables(found: Fit) -> list[Table]:
    """One for every part."""
    made = []
    offsets = found.offsets()
    for number, (part, first, end) in enumerate(zip(found.parts, offsets, offsets[1:], strict=False)):
        counted = part.counted if found.use is None else part.counted & found.use[first:end]
        if isinstance(part, Sines):
            made.append(_of_sines(found, part, number, found.left[first:end], counted))
        elif isinstance(part, Turning):
            c = len(part.channels.names)
            squares = (found.left[first:end] ** 2).reshape(c, -1)
            cuts = tuple(_cuts_of_turning(part))
            made.append(Table(part, number, squares, counted.reshape(c, -1), components_of(part), cuts))
        elif isinstance(part, Tabled):
            shape = (len(part.row_names), -1)
            squares = (found.left[first:end] ** 2).reshape(shape)
            cuts = tuple(part.cuts())
            made.append(Table(part, number, squares, counted.reshape(shape), part.domains(), cuts))
    return made


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
    for row, family in enumerate(table.families):
        families.setdefault(family, []).append(row)
    sets = {tuple(rows) for rows in families.values()} | {(row,) for row in range(len(table.names))}
    for component in table.components:
        for rows in sorted(sets):
            for cut in (None, *table.cuts):
                if (one := cell(table, component, rows, cut)) is not None:
                    yield one


def turned(found: Fit, part: Sines, number: int, left: Array) -> Complexes:
    """Lines of a part in standard deviations, the driven one turned by its prediction, (c, p, LINES − 1).

    Its real part is then an error of magnitude and its imaginary part one of phase.
    """
    c, p = part.data.usable.shape
    _, lines = split(left, c, p)
    wanted = part.raw(found.state.local(found.parts[number], number), found.state.terms)[..., 1]
    phase = np.exp(-1j * np.angle(np.where(np.isfinite(wanted), wanted, 1.0)))
    lines = lines.copy()
    lines[..., 0] *= phase
    return lines


def _of_sines(found: Fit, part: Sines, number: int, left: Array, counted: Mask) -> Table:
    c, p = part.data.usable.shape
    means, _ = split(left, c, p)
    lines = turned(found, part, number, left)
    pairs = np.stack([lines.real, lines.imag], axis=-1).reshape(c, p, -1)
    squares = np.concatenate([means[..., None], pairs], axis=-1).reshape(c, -1) ** 2
    used = counted.reshape(c, -1)
    of = np.tile(np.arange(2 * LINES - 1), p)
    components: dict[str, Mask] = {}
    for place, domain in enumerate(domains()):
        if place == 1:
            components |= {"magnitude": of == 1, "phase": of == 2}
        else:
            components[domain] = (of == 0) if place == 0 else (of == 2 * place - 1) | (of == 2 * place)
    return Table(part, number, squares, used, components, tuple(_cuts_of_sines(part)))


def _cuts_of_sines(part: Sines) -> Iterator[Cut]:
    data = part.data
    width = 2 * LINES - 1
    driven = data.index >= 0
    for words, mask in terciles(data.frequency, driven):
        yield Cut("frequency", f"{words} Hz", np.repeat(mask, width))
    for level in dict.fromkeys(data.level):
        mask = np.array([one == level for one in data.level])
        yield Cut("level", "at rest" if level == "rest" else f"{level} level", np.repeat(mask, width))
    every = np.ones(len(driven), np.bool_)
    for kind, values, thirds in (
        ("time", data.begin, ("early", "half-way", "late")),
        ("temperature", data.temperature, ("while cool", "at middling temperature", "while warm")),
        ("supply", data.supply, ("at low supply", "at middling supply", "at high supply")),
    ):
        if np.isfinite(values).all() and np.ptp(values) > 0.0:
            for said, (_, mask) in zip(thirds, terciles(values, every), strict=False):
                yield Cut(kind, said, np.repeat(mask, width))
    scales = sorted(set(data.scale[driven].tolist()))
    for scale in scales if len(scales) > 1 else []:
        yield Cut("range", f"vibrometer at {scale:g} (m/s)/V", np.repeat(driven & (data.scale == scale), width))


def terciles(values: Array, here: Mask) -> list[tuple[str, Mask]]:
    """Three thirds of the values that are `here`, each with its bounds; equal values stay together."""
    different = np.unique(values[here])
    found = []
    for some in np.array_split(different, 3):
        if len(some):
            found.append((span(float(some[0]), float(some[-1])), here & (values >= some[0]) & (values <= some[-1])))
    return found


def span(low: float, high: float) -> str:
    """Bounds as a person says them, `20–57`."""
    first, last = f"{low:.3g}", f"{high:.3g}"
    return first if first == last else f"{first}–{last}"


def components_of(part: Turning) -> dict[str, Mask]:
    """Bands and orders per revolution of one channel's rows."""
    found = dict(bands_of(part))
    mean = np.abs(_mean_rates(part)) / (2.0 * math.pi)
    step = np.array([1.0 / (2.0 * (e - b) * part.data.interval) for b, e in part.data.stretches])
    of, f = part.stretch_of, part.frequency_of
    steady = _steady(part)[of] & (f > 0.0)
    for order in range(1, HIGHEST_ORDER + 1):
        near = np.abs(f - order * mean[of]) <= BESIDE * step[of]
        found[f"{_TIMES[order]} per revolution"] = steady & near
    return found


_TIMES = {1: "once", 2: "twice", 3: "three times"}


def _mean_rates(part: Turning) -> Array:
    return np.array([float(np.mean(part.data.counted.rate[b:e])) for b, e in part.data.stretches])


def _steady(part: Turning) -> Mask:
    rates = [part.data.counted.rate[b:e] for b, e in part.data.stretches]
    return np.array([abs(r.mean()) > 0.0 and float(np.std(r)) < STEADY * abs(r.mean()) for r in rates])


def _cuts_of_turning(part: Turning) -> Iterator[Cut]:
    of, data = part.stretch_of, part.data
    rates, steady = _mean_rates(part), _steady(part)
    moving = rates != 0.0
    speeds = np.array([_speed(float(rate)) for rate in rates])
    for speed in sorted(set(speeds[steady].tolist())):
        yield Cut("rate", f"at {speed} rpm", (steady & (speeds == speed))[of])
    yield Cut("rate", "while it speeds up or coasts down", (moving & ~steady)[of])
    yield Cut("rate", "at rest", ~moving[of])
    inverted = np.array([_inverted(part, begin) for begin, _ in data.stretches])
    if inverted.any() and not inverted.all():
        yield Cut("direction", "upright", (moving & ~inverted)[of])
        yield Cut("direction", "inverted", (moving & inverted)[of])
    begins = np.array([data.time[b] for b, _ in data.stretches])
    for said, (_, mask) in zip(("early", "half-way", "late"), terciles(begins, np.isfinite(begins)), strict=False):
        yield Cut("time", said, mask[of])


def _speed(rate: float) -> str:
    """Nominal speed of a platter near this rate (rad/s) in rpm, or the rounded one if it is near none."""
    rpm = abs(rate) * 30.0 / math.pi
    near = [words for words, nominal in NOMINAL.items() if abs(rpm / nominal - 1.0) < NEAR]
    return near[0] if near else f"{rpm:.0f}"


def _inverted(part: Turning, window: int) -> bool:
    label = next(n for n, (b, e) in zip(part.data.labels, part.data.records, strict=True) if b <= window < e)
    up = part.data.up[:, window]
    return "inverted" in label or float(up[np.argmax(np.abs(up))]) < 0.0
