"""Sine approximation: the complex amplitude of a tone of known or free frequency, from samples at any instants.

Three- and four-parameter fits of IEEE Std 1057 (annex on sine fitting) and ISO 16063-11 (sine-approximation method), by
least squares on

    v(t) = Re( Σ_k C_k exp(j 2π k f t) ) + offset + drift · (t − t_mean),     k = 1 … harmonics

so a positive phase of C leads, and instants count from the same zero for every channel that is to be compared. A
channel that the multiplexer reads late brings its own late instants; nothing is resampled.

In white noise the covariance of a fit is that of least squares. Noise of a sensor is not white: `line_variances` takes
the density of what the fit leaves over in the neighbourhood of each harmonic, which is what the amplitude there feels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

# Singular values of the design below this share of the largest are rounding: the parameters cannot be told apart.
SEPARABLE = 1e-8


@dataclass(frozen=True)
class Tone:
    """What a fit found.

    `amplitudes`: C_1 … C_harmonics, complex, peak, in the unit of the values. `offset` in that unit, `drift` per second
    (0 when it was not fitted). `residual_rms` = √(Σ r²/dof) estimates the noise of one sample; `dof` = samples −
    parameters. `covariance` holds for white noise; its order is Re C_1, Im C_1, …, offset, drift (if it was fitted),
    frequency (if it was free).
    """

    frequency: float
    amplitudes: tuple[complex, ...]
    offset: float
    drift: float
    residual_rms: float
    dof: int
    samples: int
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)), repr=False, compare=False)

    @property
    def amplitude(self) -> complex:
        """C_1: the fundamental, v = Re(C_1 exp(j 2π f t))."""
        return self.amplitudes[0]

    @property
    def magnitude(self) -> float:
        """Peak value of the fundamental."""
        return abs(self.amplitude)

    @property
    def phase(self) -> float:
        """Phase of the fundamental at t = 0, rad, in (−π, π]."""
        return math.atan2(self.amplitude.imag, self.amplitude.real)


def fit_three(
    instants: NDArray[np.floating[Any]],
    values: NDArray[np.floating[Any]],
    frequency: float,
    harmonics: int = 1,
    drift: bool = False,
) -> Tone:
    """Fit a tone of known `frequency` (Hz) to `values`, shape (n,), sampled at `instants` (s), shape (n,).

    Raises BadInput if the samples are too few, not finite, or cannot tell the parameters apart (at half the sampling
    rate, or in a small part of one cycle).
    """
    t, v = np.asarray(instants, dtype=np.float64), np.asarray(values, dtype=np.float64)
    _check(t, v, frequency, harmonics, 2 * harmonics + 1 + drift)
    span = float(np.ptp(t)) or 1.0
    columns = design(t, frequency, harmonics, span if drift else None)
    parameters, _, rank, _ = np.linalg.lstsq(columns, v, rcond=SEPARABLE)
    if rank < columns.shape[1]:
        raise _inseparable(t, frequency)
    dof = len(v) - columns.shape[1]
    left = v - columns @ parameters
    rms = math.sqrt(float(left @ left) / dof)
    return Tone(
        frequency=float(frequency),
        amplitudes=tuple(complex(a, b) for a, b in zip(parameters[0::2], parameters[1::2], strict=False))[:harmonics],
        offset=float(parameters[2 * harmonics]),
        drift=float(parameters[-1]) / span if drift else 0.0,
        residual_rms=rms,
        dof=dof,
        samples=len(v),
        covariance=rms**2 * _covariance(columns, span if drift else 1.0),
    )


def fit_four(
    instants: NDArray[np.floating[Any]],
    values: NDArray[np.floating[Any]],
    frequency: float,
    harmonics: int = 1,
    tolerance: float = 1e-13,
    iterations: int = 30,
) -> Tone:
    """Fit a tone whose frequency is free, from a start (Hz) within about half a cycle over the record.

    Gauss–Newton with normal equations gathered in pieces that stay in the processor's cache; instants that are evenly
    spaced are recognised and need no sine per sample. Raises BadInput as `fit_three` does, and if the frequency does
    not settle within the record's resolution of the start.
    """
    t, v = np.asarray(instants, dtype=np.float64), np.asarray(values, dtype=np.float64)
    _check(t, v, frequency, harmonics, 2 * harmonics + 2)
    middle, span = 0.5 * float(t[0] + t[-1]), float(np.ptp(t)) or 1.0
    cosines = _Cosines(t, middle)
    found, amplitudes = float(frequency), np.zeros(harmonics, np.complex128)  # the first pass finds the amplitudes
    for step in range(iterations):
        gathered = _gather(cosines, v, found, amplitudes, span)
        solution, inverse = _solved(gathered, t, frequency)
        amplitudes = solution[0 : 2 * harmonics : 2] + 1j * solution[1 : 2 * harmonics : 2]
        change = float(solution[-1]) / (2.0 * math.pi * span) if step else 0.0
        found += change
        if abs(found - frequency) > 1.0 / span:
            break
        if step and abs(change) <= tolerance * found:
            return _four(found, amplitudes, gathered, solution, inverse, len(v), middle, span)
    raise BadInput(
        f"sine fit: found no frequency within {1.0 / span:.3g} Hz of {frequency:g} Hz that settles, wanted a start "
        "nearer to the tone, or a tone that stands above the noise"
    )


def residual(tone: Tone, instants: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a fit leaves over, shape (n,), in the unit of the values."""
    turning = phasors(2.0 * math.pi * tone.frequency * instants)
    total, power = np.full(len(instants), tone.offset), np.ones(len(instants), np.complex128)
    for amplitude in tone.amplitudes:
        power = power * turning
        total += (amplitude * power).real
    return np.asarray(values - total - tone.drift * (instants - instants.mean()), np.float64)


def line_variances(
    left: NDArray[np.float64], rate: float, frequency: float, harmonics: Sequence[int], share: float = 0.3,
    lines: int = 12,
) -> tuple[NDArray[np.float64], tuple[float, ...]]:  # fmt: skip
    """Variance of each part of C_k of every channel in coloured noise, (harmonics, c), and its degrees of freedom.

    `left` (n, c) are evenly spaced residuals.

    var = S(k·f)/T with the one-sided density S of the residual, averaged over the lines within `share` of the frequency
    (at least `lines` on either side); lines next to a harmonic are left out: the fit has emptied them.
    """
    count = len(left)
    resolution = rate / count
    power = np.abs(np.fft.rfft(left, axis=0)) ** 2 * (2.0 / (count * rate))
    order = np.arange(len(power)) * resolution / frequency
    free = np.abs(order - np.round(order)) * frequency > 1.5 * resolution
    found, dofs = np.empty((len(harmonics), left.shape[1])), []
    for row, harmonic in enumerate(harmonics):
        centre = frequency * harmonic / resolution
        reach = max(share * centre, lines + 2.0)
        near = slice(max(1, math.ceil(centre - reach)), min(len(power) - 1, math.floor(centre + reach)) + 1)
        chosen = power[near][free[near]] if free[near].any() else power[1:]
        found[row] = chosen.mean(axis=0) * rate / count
        dofs.append(2.0 * len(chosen))
    return found, tuple(dofs)


def ratio(numerator: Tone, denominator: Tone, harmonic: int = 1) -> complex:
    """Complex ratio of two tones of one frequency at a harmonic; raises BadInput if there is none."""
    if not math.isclose(numerator.frequency, denominator.frequency, rel_tol=1e-12):
        wanted = f"{denominator.frequency:g} Hz as in the other"
        raise BadInput(f"ratio of tones: found {numerator.frequency:g} Hz in one, wanted {wanted}")
    if not 1 <= harmonic <= min(len(numerator.amplitudes), len(denominator.amplitudes)):
        raise BadInput(f"ratio of tones: found no harmonic {harmonic} in both, wanted one that was fitted")
    below = denominator.amplitudes[harmonic - 1]
    if below == 0:
        raise BadInput(f"ratio of tones: found no signal at {denominator.frequency:g} Hz below, wanted one")
    return numerator.amplitudes[harmonic - 1] / below


def design(
    t: NDArray[np.float64], frequency: float, harmonics: int = 1, drift_span: float | None = None
) -> NDArray[np.float64]:
    """Columns cos, −sin of each harmonic, one, and the share of the span from the mean; shape (n, parameters).

    All columns are of the order of one, so that the rank says what the instants can tell apart.
    """
    columns = []
    for k in range(1, harmonics + 1):
        angle = 2.0 * math.pi * k * frequency * t
        columns += [np.cos(angle), -np.sin(angle)]
    columns.append(np.ones_like(t))
    if drift_span is not None:
        columns.append((t - t.mean()) / drift_span)
    return np.column_stack(columns)


CHUNK = 16_384  # samples gathered at once: their cosines stay in the cache


class _Cosines:
    """exp(j·ω·(t − middle)) piece by piece; evenly spaced instants need only one piece and a turn for each other."""

    def __init__(self, t: NDArray[np.float64], middle: float) -> None:
        self._t, self.middle = t, middle
        self._step = float(t[-1] - t[0]) / (len(t) - 1)
        ends = np.abs(t - (t[0] + self._step * np.arange(len(t)))).max()
        # sums of two floats differ in the last bits from products: a part in 10¹³ of the record is even
        self._even = bool(ends <= 1e-13 * max(abs(float(t[0])), abs(float(t[-1]))))

    def pieces(self, frequency: float) -> Iterator[tuple[slice, NDArray[np.float64], NDArray[np.complex128]]]:
        """Slice, instants from the middle of the record, and the turning unit vector there."""
        omega, first = 2.0 * math.pi * frequency, None
        for begin in range(0, len(self._t), CHUNK):
            here = slice(begin, min(begin + CHUNK, len(self._t)))
            x = self._t[here] - self.middle
            if first is None or not self._even:
                first = phasors(omega * x)
                yield here, x, first
            else:
                turn = complex(math.cos(omega * self._step * begin), math.sin(omega * self._step * begin))
                yield here, x, first[: len(x)] * turn


def phasors(angle: NDArray[np.float64]) -> NDArray[np.complex128]:
    """exp(j·angle), same shape; in two halves it takes a third of the time."""
    turned = np.empty(angle.shape, np.complex128)
    np.cos(angle, out=turned.real)
    np.sin(angle, out=turned.imag)
    return turned


@dataclass(frozen=True)
class _Gathered:
    """Normal equations: matrix, right-hand side, sum of squares of the values, shapes (p, p), (p,)."""

    matrix: NDArray[np.float64]
    right: NDArray[np.float64]
    squares: float


def _gather(
    cosines: _Cosines,
    values: NDArray[np.float64],
    frequency: float,
    amplitudes: NDArray[np.complex128],
    span: float,
) -> _Gathered:
    """Rows: Re and Im of every C_k, offset, and 2π·span times the change of the frequency."""
    harmonics = len(amplitudes)
    size = 2 * harmonics + 2
    matrix, squares = np.zeros((size + 1, size + 1)), 0.0
    rows = np.empty((size + 1, CHUNK))
    for here, x, turning in cosines.pieces(frequency):
        n = len(x)
        power, slope = turning, np.zeros(n)
        for k in range(harmonics):
            power = power * turning if k else turning
            rows[2 * k, :n] = power.real
            np.negative(power.imag, out=rows[2 * k + 1, :n])
            a, b = float(amplitudes[k].real), float(amplitudes[k].imag)
            slope += (k + 1) * (-a * power.imag - b * power.real)
        rows[-3, :n], rows[-2, :n], rows[-1, :n] = 1.0, slope * (x / span), values[here]
        matrix += rows[:, :n] @ rows[:, :n].T
    squares = float(matrix[-1, -1])
    return _Gathered(matrix[:-1, :-1], matrix[:-1, -1], squares)


def _solved(
    gathered: _Gathered, t: NDArray[np.float64], frequency: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Solution and inverse of the normal equations; the frequency's column is empty before amplitudes are known."""
    size = np.sqrt(np.diag(gathered.matrix))
    kept = size > 0.0
    scaled = gathered.matrix[np.ix_(kept, kept)] / np.outer(size[kept], size[kept])
    if np.linalg.cond(scaled) > 1.0 / SEPARABLE:
        raise _inseparable(t, frequency)
    inverse = np.zeros_like(gathered.matrix)
    inverse[np.ix_(kept, kept)] = np.linalg.inv(scaled) / np.outer(size[kept], size[kept])
    return inverse @ gathered.right, inverse


def _four(
    frequency: float,
    amplitudes: NDArray[np.complex128],
    gathered: _Gathered,
    solution: NDArray[np.float64],
    inverse: NDArray[np.float64],
    samples: int,
    middle: float,
    span: float,
) -> Tone:
    """The tone at t = 0 from the fit about the middle of the record, where phase and frequency are independent."""
    dof = samples - len(solution)
    rms = math.sqrt(max(gathered.squares - float(solution @ gathered.right), 0.0) / dof)
    orders = np.arange(1, len(amplitudes) + 1)
    turn = np.exp(-2j * math.pi * orders * frequency * middle)
    at_zero = amplitudes * turn
    jacobian = np.eye(len(solution))
    for k, (z, c) in enumerate(zip(turn, at_zero, strict=True)):
        jacobian[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[z.real, -z.imag], [z.imag, z.real]]
        moved = -2j * math.pi * (k + 1) * middle * c / (2.0 * math.pi * span)
        jacobian[2 * k : 2 * k + 2, -1] = [moved.real, moved.imag]
    jacobian[-1, -1] = 1.0 / (2.0 * math.pi * span)
    return Tone(
        frequency=frequency,
        amplitudes=tuple(complex(c) for c in at_zero),
        offset=float(solution[-2]),
        drift=0.0,
        residual_rms=rms,
        dof=dof,
        samples=samples,
        covariance=rms**2 * jacobian @ inverse @ jacobian.T,
    )


def _covariance(columns: NDArray[np.float64], drift_span: float) -> NDArray[np.float64]:
    """Covariance for noise of one; the last column of the design is the drift times `drift_span`, or the offset."""
    scale = np.ones(columns.shape[1])
    scale[-1] = drift_span
    return np.asarray(np.linalg.inv(columns.T @ columns) / np.outer(scale, scale), np.float64)


def _check(
    instants: NDArray[np.float64], values: NDArray[np.float64], frequency: float, harmonics: int, parameters: int
) -> None:
    where = "sine fit"
    if instants.ndim != 1 or instants.shape != values.shape:
        raise BadInput(f"{where}: found shapes {instants.shape} and {values.shape}, wanted two rows of one length")
    if not (math.isfinite(frequency) and frequency > 0.0):
        raise BadInput(f"{where}: found {frequency} Hz, wanted a frequency above zero")
    if harmonics < 1:
        raise BadInput(f"{where}: found {harmonics} harmonics, wanted at least 1")
    if len(values) <= parameters:
        raise BadInput(f"{where}: found {len(values)} samples, wanted more than the {parameters} parameters")
    bad = int(np.count_nonzero(~(np.isfinite(instants) & np.isfinite(values))))
    if bad:
        raise BadInput(f"{where}: found {bad} samples that are no numbers, wanted none")


def _inseparable(instants: NDArray[np.float64], frequency: float) -> BadInput:
    cycles = float(np.ptp(instants)) * frequency
    found = (
        f"found {len(instants)} samples over {cycles:.3g} cycles of {frequency:g} Hz that cannot tell sine from cosine"
    )
    return BadInput(
        f"sine fit: {found} or offset, wanted instants spread over a cycle and away from half the sampling rate"
    )
