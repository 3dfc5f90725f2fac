"""Allan deviation of a rate or acceleration record, with confidence limits, to be looked at.

Noise coefficients are not read off this curve: `rig.signals.noise` fits them to the spectrum.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.errors import BadInput

Array = NDArray[np.float64]

ONE_SIGMA = math.erf(math.sqrt(0.5))  # 68.27 %
CHUNK = 16_384  # differences at a time: three pieces of it stay in the processor's cache
PER_DECADE = 8
IDENTIFIED = 65_536  # cluster means that are enough to tell the kind of noise
FEWEST_FOR_KIND = 128  # cluster means: at the 30 of NIST SP 1065 sect. 5.5.3 chance decides too often


@dataclass(frozen=True)
class Allan:
    """Overlapping Allan deviation; every field has shape (taus,).

    `tau` in s; `deviation`, `low` and `high` in the unit of the record; `edf` equivalent degrees of freedom;
    `clusters` independent averages in the record; `kind` exponent of the noise density, 2 (white phase) to −2
    (random walk).
    """

    tau: Array
    deviation: Array
    edf: Array
    low: Array
    high: Array
    clusters: NDArray[np.int64]
    kind: NDArray[np.int64]


def overlapping(
    values: ArrayLike,
    rate: float,
    taus: ArrayLike | None = None,
    *,
    confidence: float = ONE_SIGMA,
    kind: int | None = None,
    minimum_clusters: int = 9,
) -> Allan:
    """Overlapping Allan deviation of `values`, shape (n,), at `rate` Hz (NIST SP 1065 eq. 11).

    `taus` in s are rounded to whole samples; without them, eight a decade. An averaging time with fewer than
    `minimum_clusters` clusters gets no value and is left out. `kind` is the exponent of the noise density if it is
    known; otherwise it is told from the data. The limits are those of a chi-square distribution (SP 1065 sect. 5.3).
    Raises BadInput for a record that is unusable or too short for every averaging time.
    """
    if not 0 < confidence < 1 or (kind is not None and kind not in range(-2, 3)):
        raise BadInput(f"allan: found confidence {confidence} and kind {kind}, wanted 0 to 1 and −2 to 2")
    phase = _phase(values, rate)
    lengths = _lengths(phase.size - 1, rate, taus, minimum_clusters)
    deviation = np.array([_deviation(phase, m) for m in lengths])
    kinds = np.array(list(_kinds(phase, lengths)) if kind is None else [kind] * len(lengths), dtype=np.int64)
    edf = np.array([degrees_of_freedom(phase.size, m, int(k)) for m, k in zip(lengths, kinds, strict=True)])
    low, high = _limits(deviation, edf, confidence)
    m = np.array(lengths, dtype=np.int64)
    return Allan(m / rate, deviation, edf, low, high, (phase.size - 1) // m, kinds)


def plain(values: ArrayLike, rate: float, taus: ArrayLike, *, minimum_clusters: int = 9) -> tuple[Array, Array]:
    """Averaging times in s and Allan deviation without overlap (NIST SP 1065 eq. 9); arguments as `overlapping`."""
    phase = _phase(values, rate)
    lengths = _lengths(phase.size - 1, rate, taus, minimum_clusters)
    deviation = [math.sqrt(float(np.mean(np.diff(phase[::m], 2) ** 2)) / 2) / m for m in lengths]
    return np.array(lengths) / rate, np.array(deviation)


def degrees_of_freedom(points: int, m: int, kind: int) -> float:
    """Equivalent degrees of freedom of the overlapping deviation of `points` phases at m samples (SP 1065 table 5)."""
    n = float(points)
    if kind == 2:
        edf = (n + 1) * (n - 2 * m) / (2 * (n - m))
    elif kind == 1:
        edf = math.exp(math.sqrt(max(0.0, math.log((n - 1) / (2 * m)) * math.log((2 * m + 1) * (n - 1) / 4))))
    elif kind == 0:
        edf = (3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4.0 * m * m / (4.0 * m * m + 5)
    elif kind == -1:
        edf = 2 * (n - 2) ** 2 / (2.3 * n - 4.9) if m == 1 else 5 * n * n / (4 * m * (n + 3.0 * m))
    else:
        edf = (n - 2) / m * ((n - 1) ** 2 - 3 * m * (n - 1) + 4.0 * m * m) / (n - 3) ** 2
    return max(1.0, edf)


def _phase(values: ArrayLike, rate: float) -> Array:
    """Running sum of the record less its mean, shape (n + 1,), in unit·samples."""
    data = np.asarray(values)
    if data.ndim != 1 or data.size < 3 or not rate > 0:
        raise BadInput(f"allan: found shape {data.shape} at {rate} Hz, wanted one channel of at least 3 samples")
    mean = float(data.mean(dtype=np.float64))
    if not math.isfinite(mean):
        raise BadInput("allan: found values that are not finite, wanted numbers")
    phase = np.zeros(data.size + 1)
    np.subtract(data, mean, out=phase[1:])
    np.cumsum(phase, out=phase)
    return phase


def _lengths(n: int, rate: float, taus: ArrayLike | None, minimum_clusters: int) -> list[int]:
    """Samples in a cluster, rising, each once, all with enough clusters."""
    fewest = max(2, minimum_clusters)
    if taus is None:
        decades = math.log10(max(1.0, n / fewest))
        wanted: Array = np.logspace(0, decades, 1 + round(decades * PER_DECADE))
    else:
        wanted = np.atleast_1d(np.asarray(taus, dtype=float)) * rate
    lengths = np.unique(np.rint(wanted).astype(np.int64))
    kept = [int(m) for m in lengths if m >= 1 and n // int(m) >= fewest]
    if not kept:
        raise BadInput(f"allan: found {n} samples, wanted {fewest} clusters at one averaging time at least")
    return kept


def _deviation(phase: Array, m: int) -> float:
    """√ of half the mean square second difference, the differences taken in pieces."""
    count = phase.size - 2 * m
    work, middle = np.empty(min(CHUNK, count)), np.empty(min(CHUNK, count))
    total = 0.0
    for begin in range(0, count, CHUNK):
        size = min(CHUNK, count - begin)
        late, early = work[:size], middle[:size]
        centre = phase[begin + m : begin + m + size]
        np.subtract(phase[begin + 2 * m : begin + 2 * m + size], centre, out=late)
        np.subtract(centre, phase[begin : begin + size], out=early)
        np.subtract(late, early, out=late)
        total += float(late @ late)
    return math.sqrt(total / (2.0 * float(m) * float(m) * float(count)))


def _kinds(phase: Array, lengths: list[int]) -> Iterator[int]:
    """Kind of noise at each averaging time; where too few clusters are left, that of the time before."""
    kind = 0
    for m in lengths:
        means = np.diff(phase[: IDENTIFIED * m : m])
        if means.size >= FEWEST_FOR_KIND:
            kind = _kind(means)
        yield kind


def _kind(means: Array) -> int:
    """Exponent of the density from the lag-1 autocorrelation of cluster means (NIST SP 1065 sect. 5.5.3)."""
    for differences in range(3):
        z = means - means.mean()
        square = float(z @ z)
        if square == 0:
            return 0
        r = float(z[1:] @ z[:-1]) / square
        delta = r / (1 + r)
        if delta < 0.25 or differences == 2:
            break
        means = np.diff(means)
    return int(np.clip(round(-2 * delta) - 2 * differences, -2, 2))


def _limits(deviation: Array, edf: Array, confidence: float) -> tuple[Array, Array]:
    from scipy.special import chdtri

    upper, lower = chdtri(edf, (1 - confidence) / 2), chdtri(edf, (1 + confidence) / 2)
    return deviation * np.sqrt(edf / upper), deviation * np.sqrt(edf / lower)
