"""Motion on the shaker as the vibrometer saw it: complex acceleration at every harmonic of a sine, with its variance.

The reference's output is  V = (G/scale)·D(f)·v  with the gain G, the decoder's delay and the low-pass filter behind it
in  D(f) = exp(−2πjfτ)·H_filter(f).  Acceleration follows from velocity as  a = jωv  (ISO 16063-11 and -41). Frequencies
are those that the converter's clock counts, free in the fit of the vibrometer's record: the generator has a clock of
its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, Reference, Signals, reference, signals_of, wires_of
from rig.archive.reduced import reduced
from rig.errors import BadInput
from rig.record import Wires
from rig.signals import tone

HARMONICS = 5
SHORTEST = 5.0  # cycles; below it a fit of five harmonics and offset says little
WHOLE = 0.02  # cycles away from a whole number: leakage of other lines is no longer cancelled
COHERENT = 0.98  # coherence² of the reference's sine with its record
BUTTERWORTH = (2.0 * math.sin(math.pi / 8.0), 2.0 * math.cos(math.pi / 8.0))  # 1/Q of the pairs of four poles

Complexes = NDArray[np.complex128]


def filter_response(settings: Mapping[str, Any], frequency: NDArray[np.float64]) -> Complexes:
    """Complex response of the tunable filter as it was set (and measured, if it was verified); one if it was bypassed.

    Butterworth: two pairs of poles with damping 2 sin(π/8) and 2 cos(π/8). Low-Q: four equal real poles.
    """
    if settings.get("mode", "bypass") == "bypass":
        return np.ones(np.shape(frequency), np.complex128)
    s = 1j * np.asarray(frequency, np.float64) / float(settings.get("measured_cutoff", settings["cutoff"]))
    gain = 10.0 ** (float(settings.get("gain_db", 0.0)) / 20.0)
    if settings["response"] == "low-q":
        return np.asarray(gain / (1.0 + s) ** 4)
    one, two = BUTTERWORTH
    return np.asarray(gain / ((s * s + one * s + 1.0) * (s * s + two * s + 1.0)))


@dataclass(frozen=True)
class Chain:
    """The reference's chain of one run: standards, and the filter behind the decoder.

    `u_cutoff` is the relative standard uncertainty of the filter's cut-off: of its verification, or of its dial.
    `wire` is what the cables call the reference.
    """

    gain: Reference
    delay: Reference
    time_base: Reference
    filter: Mapping[str, Any]
    u_cutoff: float
    wire: str = Wires.reference

    def velocity_per_volt(self, scale: float, frequency: NDArray[np.float64]) -> Complexes:
        """Velocity for one volt of the record, (m/s)/V, complex, shape of `frequency` (Hz)."""
        decoder = self.gain.value * np.exp(-2j * math.pi * frequency * self.delay.value)
        return np.asarray(scale / (decoder * filter_response(self.filter, frequency)))

    def phase_per_cutoff(self, frequency: NDArray[np.float64]) -> Complexes:
        """Relative change of the velocity for a relative change of the filter's cut-off, same shape."""
        if self.filter.get("mode", "bypass") == "bypass":
            return np.zeros(np.shape(frequency), np.complex128)
        step = 1e-4
        here, moved = (filter_response(self.filter, frequency / (1.0 + d)) for d in (0.0, step))
        return np.asarray((here / moved - 1.0) / step)


VERIFIED = 0.001  # of the cut-off, relative: analyzer averages at three frequencies
DIAL = 0.03  # what the dial of an unverified filter is good for


def chain_of(records: Recorded) -> Chain:
    """The reference's chain as the run's header and its verification of the filter say; raises BadInput."""
    found: Mapping[str, Any] = {}
    for entry in records.lines:
        if entry.kind in ("step", "point") and "filter" in entry.body:
            found = entry.body["filter"]
    verified = "measured_cutoff" in found
    return Chain(
        gain=reference(records, "vibrometer", "gain"),
        delay=reference(records, "vibrometer", "delay"),
        time_base=reference(records, "time_base", "rate"),
        filter=found,
        u_cutoff=(VERIFIED if verified else DIAL) if found.get("mode", "bypass") != "bypass" else 0.0,
        wire=wires_of(records).reference,
    )


@dataclass(frozen=True)
class Line:
    """One channel at one sine: amplitudes C_1…C_5 (V, complex), variance of each part (V²), mean and step (V).

    `crest` is the largest of what the fit leaves over, in units of its root mean square.
    """

    amplitudes: Complexes
    variance: NDArray[np.float64]
    mean: float
    residual_rms: float
    dof: float
    step: float = 0.0
    crest: float = 0.0
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class SinePoint:
    """One sine: true acceleration at its harmonics (m/s², complex, shape (5,)) and every channel's line.

    `u_relative` is the standard uncertainty of each part of the acceleration at the fundamental from the noise of the
    reference's record alone, relative to its magnitude. `u_time` (s) is how well the channels' instants are known by
    the reference's clock: 0 in one record. `flags` concern the point as a whole.
    """

    run: str
    index: int
    axis: str
    level: str
    frequency: float
    scale: float
    source: float
    acceleration: Complexes
    u_relative: float
    lines: Mapping[str, Line]
    reference_line: Line
    flags: tuple[str, ...] = ()
    u_time: float = 0.0

    @property
    def peak(self) -> float:
        """Peak acceleration at the driven frequency, m/s²."""
        return abs(complex(self.acceleration[0]))

    def response(self, channel: str) -> complex:
        """Complex ratio of a channel to the acceleration, V/(m/s²)."""
        return complex(self.lines[channel].amplitudes[0] / self.acceleration[0])

    def u_response(self, channel: str) -> float:
        """Standard uncertainty of each part of the response from noise alone, V/(m/s²)."""
        mine = math.sqrt(float(self.lines[channel].variance[0])) / self.peak
        return math.hypot(mine, self.u_relative * abs(self.response(channel)))


@dataclass(frozen=True)
class Sine:
    """One sine with its record and what the fit of harmonics and mean left of it, V, shape (n, channels)."""

    point: SinePoint
    record: Signals
    left: NDArray[np.float64]


def sine_points(records: Recorded, chain: Chain, known: Sequence[Sine] = ()) -> list[SinePoint]:
    """Every sine of a run, which may be `known` already; raises BadInput if its record has no reference or too few
    cycles.
    """
    return reduced(
        records, "sines", (SinePoint, Line), lambda: [sine.point for sine in known or sines(records, chain)], chain
    )  # fmt: skip


def sines(records: Recorded, chain: Chain) -> Iterator[Sine]:
    """The same one by one, with their records."""
    for index, body in sorted(records.points.items()):
        if "frequency" in body:
            found = signals_of(records, body)
            where = f"{records.name}, {body.get('label', f'point {index}')}"
            if found is None or chain.wire not in found.names:
                raise BadInput(
                    f"{where}: found no record of the reference (channel {chain.wire}), wanted one for a calibration"
                )
            yield _point(where, records.name, index, body, found, chain)


def _point(where: str, run: str, index: int, body: Mapping[str, Any], found: Signals, chain: Chain) -> Sine:
    frequency, flags = _driven(where, float(body["frequency"]), found, chain.wire)
    lines, left = lines_of(found, frequency)
    ldv = lines.pop(chain.wire)
    at = np.asarray(frequency * np.arange(1, HARMONICS + 1), np.float64)
    velocity = np.multiply(ldv.amplitudes, chain.velocity_per_volt(float(body["scale"]), at))
    magnitude = abs(complex(ldv.amplitudes[0]))
    point = SinePoint(
        run=run,
        index=index,
        axis=str(body["axis"]),
        level=str(body["level"]),
        frequency=frequency,
        scale=float(body["scale"]),
        source=float(body["source"]),
        acceleration=np.multiply(2j * math.pi * at, velocity),
        u_relative=math.sqrt(float(ldv.variance[0])) / magnitude,
        lines=lines,
        reference_line=ldv,
        flags=(*flags, *(f"reference {flag}" for flag in ldv.flags), *_incoherent(ldv, body)),
    )
    return Sine(point, found, left)


def _driven(where: str, nominal: float, found: Signals, wire: str) -> tuple[float, tuple[str, ...]]:
    """The driven frequency by the converter's clock, Hz, and what there is to say of the record's length."""
    seconds = float(found.instants[-1] - found.instants[0]) + 1.0 / found.rate
    cycles = seconds * nominal
    if cycles < SHORTEST:
        raise BadInput(f"{where}: found a record of {cycles:.2g} cycles, wanted at least {SHORTEST:g}")
    skew = float(found.skew[found.column(wire)])
    try:
        fitted = tone.fit_four(found.instants + skew, found.of(wire), nominal, _countable(nominal, found.rate))
    except BadInput as error:
        return nominal, (f"no sine to be fitted to the reference ({error})",)
    away = abs(seconds * fitted.frequency - round(seconds * fitted.frequency))
    return fitted.frequency, (f"not whole cycles ({cycles:.2f})",) if away > WHOLE else ()


def _countable(frequency: float, rate: float) -> int:
    """How many of the five harmonics lie below half the sampling rate, clear of it."""
    return max(1, min(HARMONICS, math.floor(0.49 * rate / frequency)))


def lines_of(found: Signals, frequency: float) -> tuple[dict[str, Line], NDArray[np.float64]]:
    """Lines of every channel in one solution (the skew only turns the amplitudes), and what it leaves over."""
    harmonics = _countable(frequency, found.rate)
    design = tone.design(found.instants, frequency, harmonics)
    solution = np.linalg.lstsq(design, found.volts, rcond=tone.SEPARABLE)[0]
    left = found.volts - design @ solution
    order = np.arange(1, harmonics + 1)
    dof = design.shape[0] - design.shape[1]
    variances, dofs = tone.line_variances(left, found.rate, frequency, range(1, harmonics + 1))
    lines = {}
    for column, name in enumerate(found.names):
        turn = np.exp(-2j * math.pi * frequency * order * found.skew[column])
        parts = solution[: 2 * harmonics, column]
        rms = float(np.sqrt(np.sum(left[:, column] ** 2) / dof))
        lines[name] = Line(
            amplitudes=_filled((parts[0::2] + 1j * parts[1::2]) * turn),
            variance=_filled(variances[:, column]),
            mean=float(solution[2 * harmonics, column]),
            residual_rms=rms,
            dof=dofs[0],
            step=found.step,
            crest=float(np.abs(left[:, column]).max()) / rms if rms > 0.0 else 0.0,
            flags=(f"clipped ({found.clipped[name]} samples)",) if found.clipped.get(name) else (),
        )
    return lines, np.asarray(left, np.float64)


def _filled(values: Any) -> Any:
    """Five entries, NaN for harmonics above half the sampling rate."""
    whole = np.full(HARMONICS, np.nan, values.dtype)
    whole[: len(values)] = values
    return whole


def _incoherent(ldv: Line, body: Mapping[str, Any]) -> tuple[str, ...]:
    power = 0.5 * float(np.nansum(np.abs(ldv.amplitudes) ** 2))
    coherence = power / (power + ldv.residual_rms**2)
    return (f"low coherence ({coherence:.3f}) of the reference",) if coherence < COHERENT else ()


def wrong_axis(points: Sequence[SinePoint], axes: Mapping[str, str]) -> str | None:
    """The axis that really moved, if another than the one that was to be driven answers most; `axes` by channel."""
    powers: dict[str, float] = {}
    for point in points:
        for channel, line in point.lines.items():
            if channel in axes:
                powers[axes[channel]] = powers.get(axes[channel], 0.0) + abs(complex(line.amplitudes[0])) ** 2
    strongest = max(powers, key=lambda axis: powers[axis], default=None)
    return strongest if points and strongest not in (None, points[0].axis) else None
