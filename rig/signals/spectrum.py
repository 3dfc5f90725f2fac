"""Noise density of a record: Welch's averaged spectrum for looking, and spectral lines for fitting a noise model.

Densities are one-sided, unit²/Hz. Records may be fed piece by piece, so that an hour at full rate needs no more
memory than its slow part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.errors import BadInput

Array = NDArray[np.float64]

SEGMENT = 16_384  # samples of one transform of the fast part of a long record
BLOCK = 64  # samples in a mean of the slow part of a long record
WHOLE = 1 << 20  # samples up to which a record is transformed in one piece
LOW_LINES = 256  # lowest lines kept one by one, with their sign
SKIPPED = 8  # lowest lines of a segment: the slow part knows them better


@dataclass(frozen=True)
class Density:
    """A spectrum: frequency in Hz, one-sided density in unit²/Hz, and degrees of freedom, each of shape (n,)."""

    frequency: Array
    density: Array
    dof: Array


@dataclass(frozen=True)
class Lines:
    """Cosine-transform lines of a record of `seconds` at `rate` Hz, each the square root of a density.

    The cosine transform (DCT-II) makes independent lines of white noise and of random walk alike, without a window
    and without leakage from the ends of the record (Ahmed, Natarajan and Rao 1974). Every line is normal with the
    one-sided density as variance: one degree of freedom, every 1/(2·seconds).

    `low` holds the lowest lines with their sign, unit/√Hz, at `low_frequency`; `ramp` the lines of a unit slope
    (1 unit/s) there; `high` the bins above them, `variance` that of all samples in unit².
    """

    rate: float
    seconds: float
    low_frequency: Array
    low: Array
    ramp: Array
    high: Density
    variance: float


def log_bins(frequency: ArrayLike, power: ArrayLike, per_decade: float, dof: float = 1.0) -> Density:
    """Average of `power`, shape (n,), in bins evenly spaced in log frequency; empty bins are left out.

    `frequency` rises and is positive; `dof` is that of one line. A bin stands at the geometric mean of its lines.
    """
    f, p = np.asarray(frequency, dtype=float), np.asarray(power, dtype=float)
    if f.size == 0:
        return Density(f, p, np.empty(0))
    if f.shape != p.shape or f[0] <= 0 or np.any(np.diff(f) <= 0):
        raise BadInput("log_bins: found frequencies that do not rise from above zero, wanted one per power, rising")
    log = np.log10(f)
    begin = np.flatnonzero(np.diff(np.floor(log * per_decade), prepend=-np.inf))
    count = np.diff(begin, append=f.size)
    mean_log, mean = np.add.reduceat(log, begin) / count, np.add.reduceat(p, begin) / count
    return Density(10.0**mean_log, mean, count * dof)


def noise_bandwidth(spectrum: Density, plateau: tuple[float, float] | None = None) -> float:
    """Equivalent noise bandwidth ∫S df / S_plateau, Hz (NIST SP 1065 sect. 3.4; Bendat and Piersol, eq. 8.139).

    The plateau is the mean density between the two frequencies, in Hz; without them, the median of all.
    """
    f, s = spectrum.frequency, spectrum.density
    inside = np.ones(f.shape, dtype=bool) if plateau is None else (f >= plateau[0]) & (f <= plateau[1])
    if not inside.any():
        raise BadInput(f"noise bandwidth: found no line between {plateau} Hz, wanted a plateau inside the spectrum")
    level = float(np.median(s) if plateau is None else s[inside].mean())
    if level <= 0:
        raise BadInput("noise bandwidth: found a plateau of zero density, wanted noise")
    return float(np.trapezoid(s, f)) / level


class Welch:
    """Averaged spectrum of half-overlapped Hann segments of `seconds`, fed piece by piece (Welch 1967).

    Each segment loses its mean; the line at zero frequency is left out.
    """

    def __init__(self, rate: float, seconds: float) -> None:
        self._length = 2 * round(rate * seconds / 2)
        if not rate > 0 or self._length < 8:
            raise BadInput(f"welch: found segments of {seconds} s at {rate} Hz, wanted at least 8 samples")
        self._rate = rate
        self._window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(self._length) / self._length)
        self._sum = np.zeros(self._length // 2 + 1)
        self._segments = 0
        self._rest: Array = np.empty(0)

    def feed(self, values: ArrayLike) -> None:
        """Take the next samples, shape (n,)."""
        data = np.concatenate([self._rest, _finite(values)])
        half = self._length // 2
        count = max(0, data.size // half - 1)
        for index in range(count):
            piece = data[index * half : index * half + self._length]
            self._sum += np.abs(np.fft.rfft((piece - piece.mean()) * self._window)) ** 2
        self._segments += count
        self._rest = data[count * half :].copy()

    def result(self) -> Density:
        """The spectrum so far. Raises BadInput for less than one segment."""
        if not self._segments:
            raise BadInput(f"welch: found a record shorter than one segment, wanted {self._length} samples")
        scale = 2.0 / (self._rate * float(self._window @ self._window) * self._segments)
        density = self._sum * scale
        density[-1] /= 2  # the Nyquist line has no mirror image
        dof = np.full(density.shape, self._dof())
        dof[-1] /= 2
        frequency = np.asarray(np.arange(density.size) * (self._rate / self._length), dtype=np.float64)
        return Density(frequency[1:], density[1:], np.asarray(dof[1:], dtype=np.float64))

    def _dof(self) -> float:
        """Equivalent degrees of freedom of overlapping segments (Welch 1967, eq. for the variance)."""
        half = self._length // 2
        share = float(self._window[half:] @ self._window[:half] / (self._window @ self._window)) ** 2
        k = self._segments
        return 2.0 * k / (1.0 + 2.0 * share * (k - 1) / k)


def welch(values: ArrayLike, rate: float, seconds: float) -> Density:
    """Spectrum of `values`, shape (n,), sampled at `rate` Hz, by half-overlapped Hann segments of `seconds`."""
    spectrum = Welch(rate, seconds)
    spectrum.feed(values)
    return spectrum.result()


class Periodogram:
    """Lines of a record fed piece by piece; beyond `WHOLE` samples only segment powers and block means are kept.

    A long record gives its high frequencies as averages over segments and its low ones from the means of blocks.
    `without` are bands (low, high) in Hz of which nothing is kept.
    """

    def __init__(self, rate: float, per_decade: float = 50.0, without: Sequence[tuple[float, float]] = ()) -> None:
        if not (rate > 0 and math.isfinite(rate)):
            raise BadInput(f"periodogram: found a rate of {rate} Hz, wanted one above zero")
        self._rate, self._per_decade, self._without = rate, per_decade, tuple(without)
        self._pieces: list[Array] = []
        self._means: list[Array] = []
        self._rest: Array = np.empty(0)
        self._power = np.zeros(SEGMENT)
        self._segments = 0
        self._samples = 0
        self._offset = 0.0
        self._moments = np.zeros(2)

    def feed(self, values: ArrayLike) -> None:
        """Take the next samples, shape (n,)."""
        data = _finite(values)
        if data.size == 0:
            return
        if self._samples == 0:
            self._offset = float(data.mean())
        self._samples += data.size
        self._keep_whole(data)
        for begin in range(0, data.size, WHOLE):
            self._condense(data[begin : begin + WHOLE])

    def result(self) -> Lines:
        """The lines so far. Raises BadInput for a record too short (64 samples) or without any noise."""
        if self._samples < 64:
            raise BadInput(f"periodogram: found {self._samples} samples, wanted at least 64")
        mean, square = self._moments / self._samples
        variance = float(square - mean**2)
        if variance <= 0:
            raise BadInput("periodogram: found a constant record, wanted noise")
        return self._whole(variance) if self._samples <= WHOLE else self._long(variance)

    @property
    def rate(self) -> float:
        """Sampling rate, Hz."""
        return self._rate

    @property
    def samples(self) -> int:
        """How many were fed."""
        return self._samples

    @property
    def seconds(self) -> float:
        """Length of the record so far."""
        return self._samples / self._rate

    def powers(self) -> tuple[Array, Array, int]:
        """Frequencies (n,) in Hz of cosine lines, powers (n,) in unit²/Hz, and of how many stretches these are means.

        Raises BadInput for an empty record.
        """
        if not self._samples:
            raise BadInput("periodogram: found no samples, wanted some")
        if self._segments:
            power = self._power[1:] * (2.0 / (self._rate * self._segments))
            return self._fast(np.arange(1, SEGMENT)), power, self._segments
        frequency, lines, _ = _cosine_lines(np.concatenate(self._pieces), self._rate)
        return frequency, lines**2, 1

    def _keep_whole(self, data: Array) -> None:
        if self._samples <= WHOLE:
            self._pieces.append(data.copy())
        else:
            self._pieces.clear()

    def _condense(self, data: Array) -> None:
        centred = data - self._offset
        self._moments += (centred.sum(), centred @ centred)
        joined = np.concatenate([self._rest, data])
        count = joined.size // SEGMENT
        if count:
            from scipy.fft import dct

            segments = joined[: count * SEGMENT].reshape(count, SEGMENT)
            self._power += (dct(segments, type=2, norm="ortho", axis=1) ** 2).sum(axis=0)
            self._means.append(segments.reshape(-1, BLOCK).mean(axis=1))
            self._segments += count
        self._rest = joined[count * SEGMENT :].copy()

    def _whole(self, variance: float) -> Lines:
        values = np.concatenate(self._pieces)
        frequency, lines, ramp = _cosine_lines(values, self._rate)
        kept = self._kept(frequency)
        low, rest = np.flatnonzero(kept[:LOW_LINES]), LOW_LINES + np.flatnonzero(kept[LOW_LINES:])
        high = log_bins(frequency[rest], lines[rest] ** 2, self._per_decade)
        return Lines(
            self._rate, values.size / self._rate, frequency[low], lines[low], ramp[low], _above(high), variance
        )

    def _fast(self, k: NDArray[np.intp]) -> Array:
        """Frequencies of lines of a segment, Hz."""
        return np.asarray(k * (self._rate / (2 * SEGMENT)), np.float64)

    def _kept(self, frequency: Array) -> NDArray[np.bool_]:
        """Which of these frequencies are outside the bands that do not count."""
        kept = np.ones(frequency.shape, np.bool_)
        for below, above in self._without:
            kept &= (frequency < below) | (frequency > above)
        return kept

    def _long(self, variance: float) -> Lines:
        """Slow part up to a twentieth of the block rate, where the block mean loses less than 1 %; segments above."""
        tail = self._rest[: self._rest.size // BLOCK * BLOCK].reshape(-1, BLOCK).mean(axis=1)
        means = np.concatenate([*self._means, tail])
        frequency, lines, ramp = _cosine_lines(means, self._rate / BLOCK)
        kept = self._kept(frequency)
        middle = kept & (frequency < SKIPPED * self._rate / (2 * SEGMENT))
        middle[:LOW_LINES] = False
        slow = log_bins(frequency[middle], lines[middle] ** 2, self._per_decade)
        k = np.arange(SKIPPED, SEGMENT)
        k = k[self._kept(self._fast(k))]
        power = self._power[k] * (2.0 / (self._rate * self._segments))
        fast = log_bins(self._fast(k), power, self._per_decade, self._segments)
        high = Density(
            np.concatenate([slow.frequency, fast.frequency]),
            np.concatenate([slow.density, fast.density]),
            np.concatenate([slow.dof, fast.dof]),
        )
        low = np.flatnonzero(kept[:LOW_LINES])
        seconds = means.size * BLOCK / self._rate
        return Lines(self._rate, seconds, frequency[low], lines[low], ramp[low], _above(high), variance)


def _above(high: Density) -> Density:
    """Without bins of no power: exact zeros come from a constant stretch, not from noise."""
    keep = high.density > 0
    return Density(high.frequency[keep], high.density[keep], high.dof[keep])


def _cosine_lines(values: Array, rate: float) -> tuple[Array, Array, Array]:
    """Frequencies, signed lines in unit/√Hz and lines of a unit slope; the mean (line 0) is left out."""
    from scipy.fft import dct

    n = values.size
    scale = math.sqrt(2.0 / rate)
    lines = dct(values - values.mean(), type=2, norm="ortho")[1:] * scale
    k = np.arange(1, n)
    # DCT-II of i/rate in closed form: −√(2/n)·cos(πk/2n)/(2 sin²(πk/2n))/rate for odd k, zero for even k
    angle = np.pi * k / (2 * n)
    ramp = np.where(k % 2 == 1, -math.sqrt(2.0 / n) * np.cos(angle) / (2 * np.sin(angle) ** 2) / rate, 0.0) * scale
    return np.asarray(k * (rate / (2 * n)), dtype=np.float64), lines, ramp


def _finite(values: ArrayLike) -> Array:
    data = np.asarray(values, dtype=np.float64)
    if data.ndim != 1:
        raise BadInput(f"spectrum: found an array of shape {data.shape}, wanted one channel of shape (n,)")
    if not np.isfinite(data).all():
        raise BadInput("spectrum: found values that are not finite, wanted numbers")
    return data
