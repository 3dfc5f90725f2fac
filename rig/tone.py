"""Sine approximation: the complex amplitude of a tone of known frequency, from samples at any instants.

Three-parameter fit of IEEE Std 1057 (annex on sine fitting) and ISO 16063-11 (sine-approximation method), by linear
least squares on

    v(t) = Re( Σ_k C_k exp(j 2π k f t) ) + offset + drift · (t − t_mean),     k = 1 … harmonics

so a positive phase of C leads, and instants count from the same zero for every channel that is to be compared. A
channel that the multiplexer reads late brings its own late instants; nothing is resampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
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
    parameters.
    """

    frequency: float
    amplitudes: tuple[complex, ...]
    offset: float
    drift: float
    residual_rms: float
    dof: int
    samples: int

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
    design = _design(t, frequency, harmonics, span if drift else None)
    parameters, _, rank, _ = np.linalg.lstsq(design, v, rcond=SEPARABLE)
    if rank < design.shape[1]:
        raise _inseparable(t, frequency)
    dof = len(v) - design.shape[1]
    residual = v - design @ parameters
    return Tone(
        frequency=float(frequency),
        amplitudes=tuple(complex(a, b) for a, b in zip(parameters[0::2], parameters[1::2], strict=False))[:harmonics],
        offset=float(parameters[2 * harmonics]),
        drift=float(parameters[-1]) / span if drift else 0.0,
        residual_rms=math.sqrt(float(residual @ residual) / dof),
        dof=dof,
        samples=len(v),
    )


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


def _design(t: NDArray[np.float64], frequency: float, harmonics: int, drift_span: float | None) -> NDArray[np.float64]:
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
