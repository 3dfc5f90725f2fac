"""By which law a misfit grows: with frequency, level, angle, rate, temperature, supply or time, found by score tests.

A law is a small disturbance of one component of one channel, c·shape, in whitened rows. How much χ² it would remove
after everything else in the model has been refitted is (v·r)²/(v·v − vᵀP v), with P the projection on the columns of
the fit (Rao 1948). Laws are compared by that, so that one hidden behind a fitted pole or sensitivity is still seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.diagnose.misfit_cells import Cell, Mask
from rig.fit.fit import Fit
from rig.motion import Array
from rig.parts.part import Part, Tabled
from rig.parts.sines import LINES, Sines
from rig.parts.turning import Turning

CLEAR = 12.0  # χ² that a law must remove to be worth saying
ALIKE = 9.0  # χ² within which laws cannot be told apart
MOST_ALIKE = 3
SMOOTH = 2.0  # s, about one revolution
COARSE = 0.1  # of the driven line: a misfit beyond which laws are fitted to its logarithm
CLEARLY = 100.0  # standard deviations that a line must have for its logarithm
HIDDEN = 1e-6  # share of a shape's square that the fit must leave for it to be told apart
FREQUENCY: Mapping[int, str] = {
    0: "the same at all frequencies", 1: "grows as f", 2: "grows as f²", -1: "falls as 1/f", -2: "falls as 1/f²",
}  # fmt: skip
RELATIVE: Mapping[int, str] = {
    0: "same at both levels", 1: "grows as the level", 2: "grows as the square of the level",
    -1: "grows as the level shrinks",
}  # fmt: skip
ABSOLUTE: Mapping[int, str] = {
    0: "same at both levels", 1: "as the level", 2: "as the square of the level", 3: "as the cube of the level",
}  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """One law in words, and its disturbance of every channel, V: one or two raw arrays as the part predicts them."""

    words: str
    raws: tuple[NDArray[np.inexact], ...]


@dataclass(frozen=True)
class Law:
    """A law and what χ² it would remove, in every channel."""

    words: str
    gains: Mapping[str, float]

    @property
    def gain(self) -> float:
        return sum(self.gains.values())


def laws(found: Fit, one: Cell) -> list[Law]:
    """Laws for the component of a cell, in its channels, the best first."""
    part, number = one.table.part, one.table.number
    if isinstance(part, Tabled):
        return _table_laws(found, one, part)
    if isinstance(part, Sines) and one.component in ("magnitude", "phase") and _coarse(found, one):
        return _coarse_laws(found, one)
    shapes = _sine_shapes(found, one) if isinstance(part, Sines) else _turning_shapes(part, one.component)
    mask = one.table.components[one.component] if isinstance(part, Turning) else None
    covariance = found.covariance
    others = [_columns(found.parts[number], raw, mask) for raw in _besides(found, one)]
    bare = {row: _score(found, number, covariance, [column[row] for column in others]) for row in one.rows}
    made = []
    for shape in shapes:
        columns = [*(_columns(found.parts[number], raw, mask) for raw in shape.raws), *others]
        gains = {
            row: _score(found, number, covariance, [column[row] for column in columns]) - bare[row] for row in one.rows
        }
        made.append(Law(shape.words, {one.table.names[row]: gain for row, gain in gains.items()}))
    return sorted(made, key=lambda law: -law.gain)


def _table_laws(found: Fit, one: Cell, part: Tabled) -> list[Law]:
    """Laws that the part itself proposes: what each takes from the rows of the component, one coefficient a name."""
    first = found.offsets()[one.table.number]
    left = found.left[first : first + part.rows].reshape(len(part.row_names), -1)
    mask, made = one.table.components[one.component], []
    for words, shape in part.shapes(one.component).items():
        gains = {}
        for row in one.rows:
            here = mask & one.table.used[row]
            own = shape if shape.ndim == 1 else shape[row]
            column = (own / np.sqrt(part.noise()[row]))[here]
            size = float(column @ column)
            gains[one.table.names[row]] = float(column @ left[row][here]) ** 2 / size if size > 0.0 else 0.0
        made.append(Law(words, gains))
    return sorted(made, key=lambda law: -law.gain)


def _coarse(found: Fit, one: Cell) -> bool:
    """Whether the driven line misses its prediction by so much that nothing is straight any more."""
    ratio = _against(found, one)[list(one.rows)]
    return bool(np.nanmax(np.abs(ratio - 1.0), initial=0.0, where=np.isfinite(ratio)) > COARSE)


def _against(found: Fit, one: Cell) -> NDArray[np.inexact]:
    """Driven line, observed ÷ predicted, where the noise is below a hundredth of it, else NaN; (c, p).

    What is known of the bench is taken as stated: a misfit that large has bent it.
    """
    part, number = one.table.part, one.table.number
    assert isinstance(part, Sines)
    stated = [term.moved(**dict.fromkeys(term.prior, 0.0)) for term in found.state.terms]
    wanted = part.raw(found.state.local(found.parts[number], number), stated)[..., 1]
    seen = part.data.observed[..., 1]
    with np.errstate(all="ignore"):
        clear = part.data.usable & (np.abs(seen) > CLEARLY * np.sqrt(part.data.variance[..., 1]))
        return np.where(clear, seen / wanted, np.nan)


def _coarse_laws(found: Fit, one: Cell) -> list[Law]:
    """Laws of the logarithm of observed ÷ predicted, whose real part is the magnitude and imaginary part the phase.

    Weighted least squares of one coefficient; of the magnitude less its mean, which the sensitivity takes up.
    """
    part = one.table.part
    assert isinstance(part, Sines)
    logarithm = np.log(_against(found, one))
    unit = _of_driven(found, one, np.ones(len(part.data.frequency)), one.component)[..., 1]
    made = []
    for shape in _sine_shapes(found, one):
        gains = {}
        for row in one.rows:
            good = np.isfinite(logarithm[row])
            y = (logarithm[row].real if one.component == "magnitude" else logarithm[row].imag)[good]
            v = np.asarray((shape.raws[0][row, :, 1][good] / unit[row][good]).real)
            weight = np.abs(part.data.observed[row, good, 1]) ** 2 / part.data.variance[row, good, 1]
            gains[one.table.names[row]] = _weighted_gain(y, v, weight, centred=one.component == "magnitude")
        made.append(Law(shape.words, gains))
    return sorted(made, key=lambda law: -law.gain)


def _weighted_gain(y: Array, v: Array, weight: Array, *, centred: bool) -> float:
    """χ² that c·v takes from y; all (n,)."""
    if not len(y):
        return 0.0
    if centred:
        y, v = (x - np.average(x, weights=weight) for x in (y, v))
    square = float(weight @ v**2)
    return float(weight @ (y * v)) ** 2 / square if square > HIDDEN * float(weight.sum()) else 0.0


def _besides(found: Fit, one: Cell) -> list[NDArray[np.inexact]]:
    """An error of magnitude of any power of frequency beside one of phase, and the other way round.

    A lag has both; its phase is judged whatever the magnitude does.
    """
    part = one.table.part
    if not isinstance(part, Sines) or one.component not in ("magnitude", "phase"):
        return []
    other = "phase" if one.component == "magnitude" else "magnitude"
    f = _relative(part.data.frequency, part.data.index >= 0)
    return [_of_driven(found, one, f**p * (part.data.index >= 0), other) for p in FREQUENCY]


def _relative(values: Array, driven: Mask) -> Array:
    """In units of the median of driven records, one at rest."""
    return np.where(driven, values, 1.0) / np.where(driven, float(np.median(values[driven])), 1.0)


def _columns(part: Part, raw: NDArray[np.inexact], mask: Mask | None) -> Array:
    """Whitened rows of a disturbance of each channel alone, (c, rows)."""
    c = len(part.channels.names)
    white = part.each_channel(raw)
    if white.ndim == 2:
        return np.asarray(white.T)
    rows = white.reshape(c, -1) * (1.0 if mask is None else mask)
    found = np.zeros((c, c, rows.shape[1]))
    found[np.arange(c), np.arange(c)] = rows
    return found.reshape(c, -1)


def _score(found: Fit, number: int, covariance: Array, columns: Sequence[Array]) -> float:
    """(v·r)ᵀ (vᵀv − vᵀPv)⁻¹ (v·r) for k columns (rows,) of one part."""
    if not columns:
        return 0.0
    first, v = found.offsets()[number], np.stack(columns, axis=1)
    if found.use is not None:
        v = v * found.use[first : first + len(v), None]
    square = v.T @ v
    size = np.sqrt(np.diag(square))
    size = np.where(size > 0.0, size, 1.0)
    seen = np.zeros((found.layout.size, v.shape[1]))
    for block in found.blocks:
        begin, end = block.rows.start - first, block.rows.stop - first
        if begin >= 0 and end <= len(v):
            seen[block.columns] += block.matrix.T @ v[begin:end]
    free = (square - seen.T @ covariance @ seen) / np.outer(size, size)
    down = v.T @ found.left[first : first + len(v)] / size
    values, vectors = np.linalg.eigh(free)
    kept = values > HIDDEN
    return float(np.sum((vectors[:, kept].T @ down) ** 2 / values[kept]))


def _sine_shapes(found: Fit, one: Cell) -> Iterator[Shape]:
    part = one.table.part
    assert isinstance(part, Sines)
    driven = part.data.index >= 0
    f = _relative(part.data.frequency, driven)
    level = _relative(np.abs(part.data.shown[:, 1]), driven)
    several = len({n for n, d in zip(part.data.level, driven, strict=True) if d}) > 1
    powers = _powers(one.component)
    for p, in_frequency in FREQUENCY.items() if powers else ():
        for q, in_level in powers.items():
            size = np.where(driven, f**p * level**q, 0.0)
            words = f"{in_frequency}, {in_level}" if several else in_frequency
            yield Shape(words, _lines(found, one, size))
    if not powers:
        yield Shape("the same throughout", _lines(found, one, np.ones(len(f))))
    for name, drift in _conditions(part.data.temperature, part.data.supply, part.data.begin):
        yield Shape(f"follows {name}", _lines(found, one, drift))
        if one.component not in ("magnitude", "phase") and powers:
            yield Shape(f"follows {name} and the level", _lines(found, one, drift * np.where(driven, level, 0.0)))


def _powers(component: str) -> Mapping[int, str]:
    if component in ("magnitude", "phase"):
        return RELATIVE
    return {} if "mains" in component else ABSOLUTE


def _conditions(temperature: Array, supply: Array, time: Array) -> Iterator[tuple[str, Array]]:
    """Deviations from the mean, in units of their spread."""
    for name, values in (("the temperature", temperature), ("the supply", supply), ("time", time)):
        if np.isfinite(values).all() and np.ptp(values) > 0.0:
            yield name, (values - values.mean()) / float(np.std(values))


def _lines(found: Fit, one: Cell, size: Array) -> tuple[NDArray[np.inexact], ...]:
    """Disturbances of one line of every channel by a real size per record (p,), V, each (c, p, LINES)."""
    part, number = one.table.part, one.table.number
    assert isinstance(part, Sines)
    if one.component in ("magnitude", "phase"):
        return (_of_driven(found, one, size, one.component),)
    local = found.state.local(found.parts[number], number)
    raw = np.zeros(part.data.observed.shape, np.complex128)
    small = 1e-3 * local.sensitivity[:, None] * size
    if one.component == "mean":
        raw[..., 0] = small
        return (raw,)
    place = _place(one)
    if place <= LINES - 3:  # a harmonic, which comes through the output filter at a phase that follows the drive's
        through = 1.0 / (1.0 + 1j * place * part.data.frequency / local.pole[:, None])
        small = small * through * np.exp(1j * place * np.angle(part.data.shown[:, 1]))
    raw[..., place] = small
    return (raw, 1j * raw)


def _of_driven(found: Fit, one: Cell, size: Array, component: str) -> NDArray[np.inexact]:
    """A relative change of magnitude or phase of the driven line by a size per record (p,), V, (c, p, LINES)."""
    part = found.parts[one.table.number]
    wanted = part.raw(found.state.local(part, one.table.number), found.state.terms)
    raw = np.zeros(wanted.shape, np.complex128)
    raw[..., 1] = 1e-3 * wanted[..., 1] * size * (1.0 if component == "magnitude" else 1j)
    return np.asarray(np.nan_to_num(raw))


def _place(one: Cell) -> int:
    from rig.fit.adequacy import domains

    return domains().index(one.component)


def _turning_shapes(part: Turning, component: str) -> Iterator[Shape]:
    """Laws of a component; for an order per revolution only those of that order, as wow itself has others."""
    size = part.channels.sensitivity[:, None] * 1e-3
    for words, signals in _signals(part):
        if "revolution" in component:
            if not words.startswith(component):
                continue
            words = words.removeprefix(f"{component}, ")
        yield Shape(words, tuple(size * np.broadcast_to(s, (len(size), len(s))) for s in signals))


def _signals(part: Turning) -> Iterator[tuple[str, Sequence[Array]]]:
    """Laws of a platter in words, with signals (n,) that belong to them."""
    data = part.data
    axis = int(np.argmax(np.abs(data.up).mean(axis=1)))
    platter = data.counted.rate
    top = float(np.abs(platter).max()) or 1.0
    w = data.up[axis] * _smooth(part, platter) / top
    fast = np.abs(w)
    angle = np.where(np.isfinite(data.counted.angle), data.counted.angle, 0.0)
    for order, times in ((1, "once"), (2, "twice"), (3, "three times")):
        for q, said in ((0, "whatever the rate"), (1, "as the rate"), (2, "as the square of the rate")):
            speed = fast**q * (platter != 0.0)
            yield f"{times} per revolution, {said}", (speed * np.cos(order * angle), speed * np.sin(order * angle))
    yield "as the size of the rate, whatever its sense", (fast,)
    yield "as the rate", (w,)
    yield "as the square of the rate", (w**2,)
    yield "as the square of the rate, with its sign", (w * fast,)
    yield "as the cube of the rate", (w**3,)
    yield "as the angular acceleration", (data.up[axis] * _smooth(part, data.counted.acceleration) / top,)
    yield "while the motor runs", (data.motor.astype(np.float64),)
    for name, drift in _conditions(data.temperature, data.supply, data.time):
        yield f"follows {name}", (drift,)
        yield f"follows {name} and the rate", (drift * w,)


def _smooth(part: Turning, values: Array) -> Array:
    """Without wow and what the encoder itself adds, which would bring orders of their own into every power; (n,)."""
    from scipy.ndimage import uniform_filter1d

    size = max(1, round(SMOOTH / part.data.interval))
    for _ in range(2):
        pieces = [uniform_filter1d(values[b:e], size, mode="nearest") for b, e in part.data.records]
        values = np.concatenate(pieces)
    return values


def in_words(ordered: Sequence[Law]) -> str:
    """The best law, with those that the data hardly tell from it; "" if none removes enough to be worth saying."""
    if not ordered or ordered[0].gain < CLEAR:
        return ""
    alike = [law.words for law in ordered if law.gain >= ordered[0].gain - ALIKE][:MOST_ALIKE]
    common = ", ".join(alike[0].split(", ")[:-1])
    if len(alike) == MOST_ALIKE and not alike[0].startswith("follows "):  # hardly anything is excluded
        return common if all(words.startswith(f"{common}, ") for words in alike) else ""
    if common and all(words.startswith(f"{common}, ") for words in alike):
        return f"{common}, {' or '.join(words.removeprefix(f'{common}, ') for words in alike)}"
    if all(words.startswith("follows ") for words in alike):
        return f"follows {' or '.join(words.removeprefix('follows ') for words in alike)}"
    return " or ".join(alike) if "," not in "".join(alike) else alike[0]


def strongest(law: Law) -> tuple[str, ...]:
    """Channels in which a law removes a good share of what it removes in the best of them."""
    most = max(law.gains.values(), default=0.0)
    return tuple(n for n, g in law.gains.items() if g > max(0.05 * most, math.log(len(law.gains)) + 6.0))
