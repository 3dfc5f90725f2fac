"""By which law a misfit of a sweep grows: with powers of frequency and level, with temperature, supply or time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.motion import Array
from rig.parts.laws import Shape, conditions, scored
from rig.parts.part import Part
from rig.parts.remainder import Growth, Mask, Prediction, Remainder, Score
from rig.parts.sweep_cuts import order_of
from rig.parts.sweep_records import LINES, SweepRecords

COARSE = 0.1  # of the driven line: a misfit beyond which laws are fitted to its logarithm
CLEARLY = 100.0  # standard deviations that a line must have for its logarithm
HIDDEN = 1e-6  # share of a shape's square that a mean must leave for it to be told apart
DRIVEN = ("magnitude", "phase")
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
class Asked:
    """A component of some names, and what is left over."""

    component: str
    rows: tuple[int, ...]
    rest: Remainder


def laws(part: Part, data: SweepRecords, asked: Asked, score: Score) -> Iterator[tuple[str, dict[int, float]]]:
    """Laws with the χ² that each would remove; of the logarithm where the driven line misses by far."""
    if asked.component in DRIVEN:
        ratio = _against(data, asked.rest)
        missed = np.abs(ratio[list(asked.rows)] - 1.0)
        if np.nanmax(missed, initial=0.0, where=np.isfinite(missed)) > COARSE:  # nothing is straight any more
            return _coarse(data, asked, ratio)
    return scored(part, _shapes(data, asked), _beside(data, asked), asked.rows, score)


def _against(data: SweepRecords, rest: Remainder) -> NDArray[np.inexact]:
    """Driven line, observed ÷ predicted, where the noise is below a hundredth of it, else NaN; (c, p).

    What is known of the bench is taken as stated: a misfit that large has bent it.
    """
    stated = [term.moved(**dict.fromkeys(term.prior, 0.0)) for term in rest.terms]
    wanted = rest.predict(rest.local, stated)[..., 1]
    seen = data.observed[..., 1]
    with np.errstate(all="ignore"):
        clear = data.usable & (np.abs(seen) > CLEARLY * np.sqrt(data.variance[..., 1]))
        return np.where(clear, seen / wanted, np.nan)


def _coarse(data: SweepRecords, asked: Asked, against: NDArray[np.inexact]) -> Iterator[tuple[str, dict[int, float]]]:
    """Laws of the logarithm of observed ÷ predicted, whose real part is the magnitude and imaginary part the phase.

    Weighted least squares of one coefficient; of the magnitude less its mean, which the sensitivity takes up.
    """
    logarithm = np.log(against)
    unit = _of_driven(asked.rest, np.ones(len(data.frequency)), asked.component)[..., 1]
    for shape in _shapes(data, asked):
        gains = {}
        for row in asked.rows:
            good = np.isfinite(logarithm[row])
            y = (logarithm[row].real if asked.component == "magnitude" else logarithm[row].imag)[good]
            v = np.asarray((shape.raws[0][row, :, 1][good] / unit[row][good]).real)
            weight = np.abs(data.observed[row, good, 1]) ** 2 / data.variance[row, good, 1]
            gains[row] = _weighted_gain(y, v, weight, centred=asked.component == "magnitude")
        yield shape.words, gains


def _weighted_gain(y: Array, v: Array, weight: Array, *, centred: bool) -> float:
    """χ² that c·v takes from y; all (n,)."""
    if not len(y):
        return 0.0
    if centred:
        y, v = (x - np.average(x, weights=weight) for x in (y, v))
    square = float(weight @ v**2)
    return float(weight @ (y * v)) ** 2 / square if square > HIDDEN * float(weight.sum()) else 0.0


def _beside(data: SweepRecords, asked: Asked) -> list[NDArray[np.inexact]]:
    """An error of magnitude of any power of frequency beside one of phase, and the other way round.

    A lag has both; its phase is judged whatever the magnitude does.
    """
    if asked.component not in DRIVEN:
        return []
    other = "phase" if asked.component == "magnitude" else "magnitude"
    f = _relative(data.frequency, data.driven)
    return [_of_driven(asked.rest, f**p * data.driven, other) for p in FREQUENCY]


def _relative(values: Array, driven: Mask) -> Array:
    """In units of the median of driven records, one at rest."""
    return np.where(driven, values, 1.0) / np.where(driven, float(np.median(values[driven])), 1.0)


def _shapes(data: SweepRecords, asked: Asked) -> Iterator[Shape]:
    driven = data.driven
    f = _relative(data.frequency, driven)
    level = _relative(np.abs(data.shown[:, 1]), driven)
    several = len({n for n, d in zip(data.level, driven, strict=True) if d}) > 1
    powers = _powers(asked.component)
    for p, in_frequency in FREQUENCY.items() if powers else ():
        for q, in_level in powers.items():
            size = np.where(driven, f**p * level**q, 0.0)
            words = f"{in_frequency}, {in_level}" if several else in_frequency
            yield Shape(words, _lines(data, asked, size))
    if not powers:
        yield Shape("the same throughout", _lines(data, asked, np.ones(len(f))))
    for name, drift in conditions(data.temperature, data.supply, data.begin):
        yield Shape(f"follows {name}", _lines(data, asked, drift))
        if asked.component not in DRIVEN and powers:
            yield Shape(f"follows {name} and the level", _lines(data, asked, drift * np.where(driven, level, 0.0)))


def _powers(component: str) -> Mapping[int, str]:
    if component in DRIVEN:
        return RELATIVE
    return {} if "mains" in component else ABSOLUTE


def _lines(data: SweepRecords, asked: Asked, size: Array) -> tuple[NDArray[np.inexact], ...]:
    """Disturbances of one line of every channel by a real size per record (p,), V, each (c, p, LINES)."""
    if asked.component in DRIVEN:
        return (_of_driven(asked.rest, size, asked.component),)
    local = asked.rest.local
    raw = np.zeros(data.observed.shape, np.complex128)
    small = 1e-3 * local.sensitivity[:, None] * size
    if asked.component == "mean":
        raw[..., 0] = small
        return (raw,)
    place = order_of(asked.component)
    if place <= LINES - 3:  # a harmonic, which comes through the output filter at a phase that follows the drive's
        through = 1.0 / (1.0 + 1j * place * data.frequency / local.pole[:, None])
        small = small * through * np.exp(1j * place * np.angle(data.shown[:, 1]))
    raw[..., place] = small
    return (raw, 1j * raw)


def _of_driven(rest: Remainder, size: Array, component: str) -> NDArray[np.inexact]:
    """A relative change of magnitude or phase of the driven line by a size per record (p,), V, (c, p, LINES)."""
    wanted = rest.predicted
    raw = np.zeros(wanted.shape, np.complex128)
    raw[..., 1] = 1e-3 * wanted[..., 1] * size * (1.0 if component == "magnitude" else 1j)
    return np.asarray(np.nan_to_num(raw))


def growth(data: SweepRecords, domain: str, row: int, found: Prediction) -> Growth | None:
    """Size of a harmonic before the output filter, against frequency and level."""
    if not domain.endswith("f"):
        return None
    order = int(domain[:-1])
    f, sensitivity = order * data.frequency, float(data.channels.sensitivity[row])
    pole = found.local.pole[row]
    left = (data.observed[row] - found.predicted[row]) / sensitivity
    size = np.abs(left[:, order] * (1.0 + 1j * f / pole))
    sigma = np.sqrt(data.variance[row, :, order] * (1.0 + (f / pole) ** 2)) / abs(sensitivity)
    used = data.usable[row] & (data.frequency > 0.0) & np.isfinite(size) & np.isfinite(sigma)
    against = {"frequency": data.frequency[used], "level": np.abs(data.shown[used, 1])}
    return Growth(size[used], math.sqrt(2.0) * sigma[used], against)
