"""Lines of a record with sines: which belong to the drive, which to the mains, and the noise between them.

A leftover is what a fit of the drive's harmonics leaves of a record; hum is still in it. Its mains lines tell whether
the recorder's second is right, because the mains frequency is known whatever drives the shaker.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.parts.sweep_records import Leftover
from rig.signals import noise, tone
from rig.signals.spectrum import Density, log_bins

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Mask = NDArray[np.bool_]

PER_DECADE = 20.0
FOLDED = 24  # harmonics that are no noise, those beyond half the sampling rate among them
LIMIT = 1.5  # lines beside one that was fitted, or mains: not noise
WANDER = 1e-3  # relative standard uncertainty of the mains frequency itself (60 mHz of 60 Hz)
SEARCHED = 5e-3  # relative: how far from its nominal frequency a mains line is looked for
STANDS_OUT = 25.0  # power of a mains line's peak over that of its neighbours
NEIGHBOURS = 12  # spectral lines on either side that say what the noise is
HIGHEST = 0.49  # of the sampling rate: harmonics above are not fitted
FILLINGS = 12  # the rest of an error shrinks by the faulty share each time
CLEAR = 2.0  # spectral lines between a mains line and a harmonic that can be told apart


def taken(at: Array, frequency: float | None, resolution: float, orders: int = FOLDED) -> Mask:
    """Lines `at` (Hz) at zero and near any of so many multiples of the drive, folded or not: a clipped sine has many.

    `frequency` None: at rest.
    """
    found = at < 0.5 * resolution
    if frequency is not None:
        rate = 2.0 * float(at[-1])
        for order in range(1, orders + 1):
            folded = abs((order * frequency + at[-1]) % rate - at[-1])
            found |= np.abs(at - folded) < LIMIT * resolution
    return np.asarray(found)


def density(leftovers: Sequence[Leftover], row: int, mains: float | None) -> Density:
    """Density of a channel's leftovers, V²/Hz, averaged over all records in bins of log frequency."""
    return densities(leftovers, np.array([row]), mains)[0]


def densities(leftovers: Sequence[Leftover], rows: NDArray[np.intp], mains: float | None) -> list[Density]:
    """The same of several channels; which lines are noise is the same for all."""
    lines: list[Array] = []
    gathered: list[Array] = []
    for left in leftovers:
        at = np.asarray(np.arange(len(left.amplitude)) * left.resolution, np.float64)
        hum = np.zeros(len(at), np.bool_)
        if mains is not None:
            hum = np.abs(at / mains - np.round(at / mains)) * mains < LIMIT * left.resolution
        free = ~left.taken & ~hum
        free[-1] = False
        lines.append(at[free])
        gathered.append(np.abs(left.amplitude[np.ix_(free, rows)].T) ** 2 / (2.0 * left.resolution))
    f, powers = np.concatenate(lines), np.concatenate(gathered, axis=1)
    # equal frequencies of many records: a tiny step apart, for bins that rise
    order = np.argsort(f, kind="stable")
    rising = f[order] * (1.0 + 1e-12 * np.arange(len(f)))
    return [log_bins(rising, power[order], PER_DECADE, 2.0) for power in powers]


def slow_noise(found: Density, pole: float | None, first: Leftover, step: float) -> noise.NoiseModel:
    """Noise model of a channel for means over records as long as the first."""
    rate = first.resolution * 2.0 * (len(first.amplitude) - 1)
    model = noise.fit_density(found, rate, step=step, pole=pole)
    # flicker that records of this length could hide is counted: few of them say little below a hertz
    return replace(model, flicker=max(model.flicker, model.white * first.resolution))


@dataclass(frozen=True)
class Separated:
    """A record taken apart, c channels: harmonics 1 … k of the drive (c, k), complex, mean (c,), mains lines (c, m) at
    `mains` Hz (m,), what is `left` after all of them (n, c), and the `hum` among it that was taken off (n, c).
    """

    harmonics: Complexes
    mean: Array
    mains: Array
    mains_lines: Complexes
    left: Array
    hum: Array


def separated(t: Array, values: Array, rate: float, frequency: float | None, mains: float | None) -> Separated:
    """Harmonics of the drive below half the sampling rate and multiples of the mains, fitted together.

    `t` s (n,), `values` (n, c). Mains lines that lie within two spectral lines of a harmonic cannot be told from it:
    they stay with the harmonic. Rows over many cycles are nearly orthogonal, so normal equations lose no digits.
    """
    resolution = rate / len(t)
    count = 0 if frequency is None else max(1, math.floor(HIGHEST * rate / frequency))
    lines = np.array(list(_apart(mains, frequency, rate, resolution)), np.float64)
    whole = _rows(t, count, frequency or 0.0, lines)
    solution = np.linalg.solve(_gram(whole, count), whole @ values)
    first, second = 2 * count + 1, 2 * count + 1 + len(lines)
    return Separated(
        harmonics=np.asarray((solution[0 : 2 * count : 2] + 1j * solution[1 : 2 * count : 2]).T),
        mean=solution[2 * count],
        mains=lines,
        mains_lines=np.asarray((solution[first:second] + 1j * solution[second:]).T),
        left=values - whole.T @ solution,
        hum=whole[first:].T @ solution[first:],
    )


def filled(t: Array, values: Array, faulty: Mask, rate: float, frequency: float) -> Array:
    """Values (n, c) with what the drive's harmonics say in place of `faulty` ones (n, c): a fit that these do not move.

    What is filled in is fitted and filled in again,  x ← G⁻¹(R·y + B·Bᵀx)  with B the faulty columns of the rows R and
    y nought there: so few times that harmonics which only faulty rows would tell stay small.
    """
    rows = _rows(t, max(1, math.floor(HIGHEST * rate / frequency)), frequency, np.zeros(0))
    gram, found = _gram(rows, (len(rows) - 1) // 2), values.copy()
    for c in np.flatnonzero(faulty.any(axis=0)):
        lacking = rows[:, faulty[:, c]]
        known = np.linalg.solve(gram, rows @ np.where(faulty[:, c], 0.0, values[:, c]))
        again, solution = np.linalg.solve(gram, lacking @ lacking.T), np.linalg.solve(gram, rows @ values[:, c])
        for _ in range(FILLINGS - 1):
            solution = known + again @ solution
        found[faulty[:, c], c] = lacking.T @ solution
    return found


def _rows(t: Array, count: int, frequency: float, lines: Array) -> Array:
    """Rows cos, −sin of so many harmonics, one, then cosines and −sines of further lines (Hz); (2k + 1 + 2m, n)."""
    rows = np.empty((2 * count + 1 + 2 * len(lines), len(t)))
    turning = tone.phasors(2.0 * math.pi * frequency * t)
    power = np.ones_like(turning)
    for k in range(count):
        power *= turning
        rows[2 * k], rows[2 * k + 1] = power.real, -power.imag
    rows[2 * count] = 1.0
    for k, line in enumerate(lines):
        angle = 2.0 * math.pi * line * t
        rows[2 * count + 1 + k], rows[2 * count + 1 + len(lines) + k] = np.cos(angle), -np.sin(angle)
    return rows


def _gram(rows: Array, count: int) -> Array:
    """Products of rows (k, n) with each other, (k, k), of which the first are so many harmonics of one angle x.

    Those follow from the sums of exp(jmx) alone, m up to twice as many:
    cos kx·cos lx = ½[cos (k − l)x + cos (k + l)x],  and so on. A long record has hundreds of them.
    """
    first = 2 * count
    beside = rows[first:] @ rows.T
    found = np.empty((len(rows), len(rows)))
    found[first:], found[:, first:] = beside, beside.T
    if not count:
        return found
    last = rows[first - 2 : first]  # cos, −sin of the highest
    products = rows[:first] @ last.T
    cosines, sines = products[0::2], products[1::2]
    low = beside[0, :first:2] - 1j * beside[0, 1:first:2]
    high = cosines[:, 0] - sines[:, 1] - 1j * (sines[:, 0] + cosines[:, 1])
    sums = np.concatenate([[beside[0, first]], low, high])
    order = np.arange(1, count + 1)
    apart = order[:, None] - order
    less, more = sums[np.abs(apart)], sums[order[:, None] + order]
    turned = np.sign(apart) * less.imag
    found[0:first:2, 0:first:2] = 0.5 * (less.real + more.real)
    found[1:first:2, 1:first:2] = 0.5 * (less.real - more.real)
    found[0:first:2, 1:first:2] = 0.5 * (turned - more.imag)
    found[1:first:2, 0:first:2] = found[0:first:2, 1:first:2].T
    return found


def _apart(mains: float | None, frequency: float | None, rate: float, resolution: float) -> Iterator[float]:
    """Multiples of the mains frequency that can be told from every harmonic of the drive."""
    if mains is None:
        return
    for order in range(1, math.floor(HIGHEST * rate / mains) + 1):
        at = order * mains
        if frequency is None or abs(at - round(at / frequency) * frequency) > CLEAR * resolution:
            yield at


@dataclass(frozen=True)
class Mains:
    """The mains frequency by the recorder's clock: Hz with its standard uncertainty; `strongest` multiples seen, Hz."""

    frequency: float
    u: float
    strongest: tuple[float, ...]


def mains_seen(leftovers: Sequence[Leftover], mains: float) -> Mains | None:
    """The mains frequency as the lines show it that stand above the noise; None without such lines.

    Three bins give the place of a line between bins:  δ = Re[(X₋₁ − X₊₁)/(2X₀ − X₋₁ − X₊₁)]  (Jacobsen and Kootsookos
    2007, exact for a record without window).
    """
    found = np.array([one for left in leftovers for one in _places(left, mains)], np.float64).reshape(-1, 4)
    if not len(found):
        return None
    order, at, u, power = found.T
    weight = (u / order) ** -2.0
    value = float(weight @ (at / order) / weight.sum())
    scatter = float(weight @ (at / order - value) ** 2) / max(len(at) - 1, 1)
    sums = {one: float(power[order == one].sum()) for one in np.unique(order)}
    best = sorted(sorted(sums, key=lambda one: -sums[one])[:3])
    each = (float(np.average(at[order == one], weights=weight[order == one])) for one in best)
    return Mains(value, math.sqrt(max(scatter, 1.0) / weight.sum()), tuple(each))


def _places(left: Leftover, mains: float) -> Iterator[tuple[float, float, float, float]]:
    """Order, frequency with u (Hz) and power over noise of every mains line that stands out, channel by channel."""
    spectra = np.concatenate([left.amplitude, left.reference[:, None]], axis=1)
    for order in range(1, math.floor(len(spectra) * left.resolution / mains) + 1):
        centre = order * mains / left.resolution
        reach = 1.0 + SEARCHED * centre
        low, high = math.ceil(centre - reach), math.floor(centre + reach)
        if low < NEIGHBOURS or high + NEIGHBOURS >= len(spectra):
            continue
        for spectrum in spectra.T:
            k = low + int(np.argmax(np.abs(spectrum[low : high + 1])))
            beside = np.concatenate([np.arange(k - NEIGHBOURS, k - 2), np.arange(k + 3, k + NEIGHBOURS + 1)])
            beside = beside[(beside > 0) & (beside < len(spectrum))]
            beside = beside[~left.taken[beside]]
            if left.taken[k - 2 : k + 3].any() or len(beside) < NEIGHBOURS // 2:
                continue
            noise_power = float(np.mean(np.abs(spectrum[beside]) ** 2))
            ratio = float(np.abs(spectrum[k]) ** 2) / noise_power if noise_power > 0.0 else 0.0
            if ratio > STANDS_OUT:
                before, here, after = spectrum[k - 1], spectrum[k], spectrum[k + 1]
                delta = float(((before - after) / (2.0 * here - before - after)).real)
                yield order, (k + delta) * left.resolution, 0.5 * left.resolution / math.sqrt(ratio), ratio


@dataclass(frozen=True)
class DriveClock:
    """A drive that is off by `error` (relative) while the recorder is right: `commanded` and `found`, Hz."""

    error: float
    commanded: float
    found: float
    mains: Mains

    @property
    def said(self) -> str:
        """As a sentence."""
        way = "fast" if self.error > 0.0 else "slow"
        lines = ", ".join(f"{one:.1f}" for one in self.mains.strongest)
        return (
            f"the drive runs {abs(self.error):.1%} {way}: commanded {self.commanded:g} Hz, found {self.found:.4g} Hz, "
            f"while mains lines come out at {lines} Hz: the recorder's clock is right"
        )


def drive_clock(frequency: Array, nominal: Array, leftovers: Sequence[Leftover], mains: float) -> DriveClock | None:
    """Whether it is the drive that is off, and not the recorder: mains lines come out at the mains frequency.

    `frequency` and `nominal` Hz, (p,), zero at rest. None if they agree, if no mains line is seen or if it is off too.
    """
    driven = nominal > 0.0
    if not driven.any() or not mains > 0.0:
        return None
    ratio = frequency[driven] / nominal[driven]
    middle = int(np.argsort(ratio)[len(ratio) // 2])
    error = float(ratio[middle]) - 1.0
    if abs(error) < 6.0 * WANDER:
        return None
    seen = mains_seen(leftovers, mains)
    if seen is None:
        return None
    limit = 3.0 * math.hypot(seen.u / mains, WANDER)
    if abs(seen.frequency / mains - 1.0) > limit or abs(error) < 2.0 * limit:
        return None
    return DriveClock(error, float(nominal[driven][middle]), float(frequency[driven][middle]), seen)
