"""From a run on the shaker to `SweepRecords`, one for every mounting: lines, noise and conditions of each record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import units
from rig.archive.records import Recorded, Signals, experiments, is_imported, reference, signals, statics, wires_of
from rig.archive.reduced import reduced
from rig.model import Channels
from rig.motion import ORDERS
from rig.parts.channels import channels_of
from rig.parts.conditions import smoothed
from rig.parts.ranges import beyond_range
from rig.parts.reading import nuisances
from rig.parts.reading.reading import Reading
from rig.parts.reading.sessions import begun
from rig.parts.reading.vibration import Chain, Sine, SinePoint, chain_of, sine_points, sines
from rig.parts.sweep import Sweep
from rig.parts.sweep_lines import LIMIT, densities, drive_clock, slow_noise, taken
from rig.parts.sweep_records import LINES, MAINS_ORDERS, Leftover, SweepRecords, directions
from rig.record import Wires
from rig.signals import tone
from rig.signals.noise import NoiseModel
from rig.signals.spectrum import Density

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
OUTSTANDING = 6.0  # robust standard deviations: one sample in 10⁹ of normal noise
FEW = 1e-9  # share of samples that may stand out
GATINGS = 3


@dataclass(frozen=True)
class _Record:
    """One record, or a piece of one at rest."""

    begin: float
    seconds: float
    lines: Complexes  # (c, LINES)
    usable: NDArray[np.bool_]  # (c,)
    leftover: Leftover
    temperature: float
    supply: float
    before: Complexes
    point: SinePoint | None
    reference_variance: Array
    gated: Complexes
    outliers: tuple[float, float]


def read(runs: Sequence[Recorded]) -> Reading:
    """Every sweep of the rig's own runs."""
    own = [run for run in runs if not is_imported(run)]
    since = begun(runs)
    parts = [(run, Sweep(replace(data, since=since.get(run.name)))) for run in own for data in shaken(run)]
    for run, part in parts:
        part.notes = (*part.notes, *beyond_range(run, part))
    swept = [one for run in own for one in _swept(run)]
    return Reading(tuple(part for _, part in parts), tuple(nuisances.of_shaker(swept)) if parts else ())


def _swept(records: Recorded) -> list[Recorded]:
    return [one for one in experiments(records) if any("frequency" in body for body in one.points.values())]


def shaken(records: Recorded) -> list[SweepRecords]:
    """Every sweep of a run, each a mounting; [] for a run that has none. Raises BadInput as `sines` does."""
    kinds = (SweepRecords, Channels, NoiseModel)
    return reduced(
        records, "sweep", kinds,
        lambda: [_sweep(one, f"{records.name}#{number}") for number, one in enumerate(_swept(records))],
    )  # fmt: skip


def _sweep(records: Recorded, name: str) -> SweepRecords:
    """One sweep: its records at rest and its sines."""
    chain = chain_of(records)
    mains = units.parse(str(records.header["bench_file"]["mains"]), "frequency")
    whole = [one for body in statics(records) for one in _resting(records, body, mains)]
    driven = list(sines(records, chain))
    sine_points(records, chain, driven)  # kept for who asks for those alone
    whole += [_driven(records, sine, chain, mains) for sine in driven]
    return _joined(records, name, driven[0].point.axis, whole, mains)


def _resting(records: Recorded, body: Mapping[str, Any], mains: float) -> Iterator[_Record]:
    """Pieces of about one second of a record at rest."""
    wires = wires_of(records)
    found = signals(records.samples(str(body["samples"])))
    if wires.reference not in found.names:
        return
    seconds = len(found.instants) / found.rate
    each = round(found.rate * seconds / max(1, math.floor(seconds)))
    for first in range(0, len(found.instants) - each + 1, each):
        piece = replace(found, instants=found.instants[first : first + each], volts=found.volts[first : first + each])
        volts = piece.volts
        mean = volts.mean(axis=0)
        lines = np.zeros((volts.shape[1], LINES), np.complex128)
        lines[:, 0] = mean
        lines[:, 1:ORDERS] = np.nan
        gate = _Gate(np.zeros(ORDERS, np.complex128), 0.0, 0.0, np.empty(0))
        yield _record(piece, wires, lines, volts - mean, None, mains, np.full(ORDERS, np.nan), gate)


def _driven(records: Recorded, sine: Sine, chain: Chain, mains: float) -> _Record:
    point, found = sine.point, sine.record
    every = {**point.lines, chain.wire: point.reference_line}
    lines = np.full((len(found.names), LINES), np.nan, np.complex128)
    for c, name in enumerate(found.names):
        lines[c, 0] = every[name].mean
        lines[c, 1:ORDERS] = every[name].amplitudes
    at = np.asarray(point.frequency * np.arange(1, ORDERS), np.float64)
    per_volt = np.abs(2.0 * math.pi * at * chain.velocity_per_volt(point.scale, at))
    gate = _gated(sine, chain)
    variance = np.concatenate([[np.nan], per_volt**2 * _reference_noise(sine, gate.left, at)])
    return _record(found, wires_of(records), lines, sine.left, point, mains, variance, gate)


@dataclass(frozen=True)
class _Gate:
    """The reference without samples that stand out: acceleration (6,), their share and depth, what is left (n,)."""

    acceleration: Complexes
    share: float
    depth: float
    left: Array


def _gated(sine: Sine, chain: Chain) -> _Gate:
    """Fit the reference again without samples beyond six robust standard deviations, until none is left."""
    found, point = sine.record, sine.point
    column = found.column(chain.wire)
    left = sine.left[:, column]
    count = int(np.count_nonzero(np.isfinite(point.acceleration)))
    shown = np.concatenate([[0.0], point.acceleration])
    good = np.abs(left - np.median(left)) < OUTSTANDING * _robust(left)
    if good.mean() > 1.0 - FEW:
        return _Gate(shown, 0.0, 0.0, left)
    volts = found.volts[:, column]
    design = tone.design(found.instants, point.frequency, count)
    for _ in range(GATINGS):
        solution = np.linalg.lstsq(design[good], volts[good], rcond=None)[0]
        left = volts - design @ solution
        good = np.abs(left) < OUTSTANDING * _robust(left)
    order = np.arange(1, count + 1)
    parts = solution[: 2 * count]
    amplitudes = (parts[0::2] + 1j * parts[1::2]) * np.exp(-2j * math.pi * point.frequency * order * found.skew[column])
    at = np.asarray(point.frequency * order)
    shown[1 : count + 1] = 2j * math.pi * at * chain.velocity_per_volt(point.scale, at) * amplitudes
    signal = volts - left - solution[-1]
    large = ~good & (np.abs(signal) > 0.5 * np.abs(signal).max())
    depth = float(np.median(-left[large] / signal[large])) if large.any() else 0.0
    return _Gate(shown, float(1.0 - good.mean()), depth, np.where(good, left, 0.0))


def _robust(left: Array) -> float:
    """Standard deviation from the median of absolute values, as for normal noise."""
    return 1.4826 * float(np.median(np.abs(left - np.median(left))))


def _reference_noise(sine: Sine, left: Array, at: Array) -> Array:
    """Variance of each part of the reference's lines, V², from its own record within an octave either way."""
    found = sine.record
    count = len(left)
    power = np.abs(np.fft.rfft(left)) ** 2 * (2.0 / count**2)
    f = np.fft.rfftfreq(count, 1.0 / found.rate)
    order = f / sine.point.frequency
    free = np.abs(order - np.round(order)) * sine.point.frequency > LIMIT * found.rate / count
    result = []
    for one in at:
        near = free & (f > min(0.5 * one, 0.25 * found.rate)) & (f < max(2.0 * one, 100.0 * found.rate / count))
        result.append(float(power[near].mean()) if near.any() else float(power[1:].mean()))
    return np.array(result)


def _record(
    found: Signals, wires: Wires, lines: Complexes, left: Array, point: SinePoint | None, mains: float,
    variance: Array, gate: _Gate,
) -> _Record:  # fmt: skip
    count, begin = len(left), found.start + float(found.instants[0])
    resolution = found.rate / count
    spectrum = np.fft.rfft(left, axis=0) * (2.0 / count)
    at = np.arange(len(spectrum)) * resolution
    spectrum *= tone.phasors(-2.0 * math.pi * at[:, None] * found.skew)
    lines[:, ORDERS:] = _at(left, found, mains * np.array(MAINS_ORDERS))
    lines[:, ORDERS:] *= np.exp(-2j * math.pi * mains * np.array(MAINS_ORDERS) * begin)
    if point is not None:
        lines[:, _mingled(point.frequency, mains, resolution)] = np.nan
    step = float(np.diff(np.sort(found.skew))[0]) if len(found.skew) > 1 else 0.0
    names = list(found.names)
    free = np.array([not found.clipped.get(name) for name in names])
    marked = taken(np.asarray(at, np.float64), point.frequency if point else None, resolution)
    leftover = Leftover(begin, resolution, spectrum, spectrum[:, found.column(wires.reference)], marked)
    return _Record(
        begin=begin,
        seconds=count / found.rate,
        lines=lines,
        usable=free,
        leftover=leftover,
        temperature=_mean(found, wires.temperature, 100.0),
        supply=_mean(found, wires.supply, 1.0),
        before=_before(lines, point, mains, step),
        point=point,
        reference_variance=variance,
        gated=gate.acceleration,
        outliers=(gate.share, gate.depth),
    )


def _mingled(frequency: float, mains: float, resolution: float) -> NDArray[np.bool_]:
    """Lines in which a record cannot tell a harmonic of the drive from the mains, (LINES,); the driven one is kept."""
    harmonics = frequency * np.arange(1, ORDERS)
    apart = np.abs(harmonics - mains * np.maximum(np.round(harmonics / mains), 1.0)) > LIMIT * resolution
    of_mains = np.abs(mains * np.array(MAINS_ORDERS)[:, None] - harmonics).min(axis=1) > LIMIT * resolution
    return ~np.concatenate([[True, True], apart[1:], of_mains])


def _at(left: Array, found: Signals, frequencies: Array) -> Complexes:
    """Amplitudes at a few frequencies of every channel, at a common instant, (channels, frequencies)."""
    angle = 2.0 * math.pi * frequencies[:, None] * (np.arange(len(left)) / found.rate)
    turned = (np.cos(angle) @ left - 1j * (np.sin(angle) @ left)).T * (2.0 / len(left))
    return np.asarray(turned * tone.phasors(-2.0 * math.pi * found.skew[:, None] * frequencies))


def _mean(found: Signals, name: str, factor: float) -> float:
    return float(found.of(name).mean()) * factor if name in found.names else math.nan


def _before(lines: Complexes, point: SinePoint | None, mains: float, step: float) -> Complexes:
    """Lines of the slot before each, one slot earlier; those of the last slot come before the first."""
    f = np.concatenate([(point.frequency if point else 0.0) * np.arange(ORDERS), mains * np.array(MAINS_ORDERS)])
    return np.asarray(np.roll(lines, 1, axis=0) * np.exp(-2j * math.pi * f * step))


def _joined(records: Recorded, name: str, axis: str, whole: Sequence[_Record], mains: float) -> SweepRecords:
    """Records in the order of time, channels of sensors only."""
    whole = sorted(whole, key=lambda one: one.begin)
    cables = list(records.header["bench_file"]["cables"]["shaker"])
    channels = channels_of(records, cables, relative_to=wires_of(records).reference)
    rows = np.array([cables.index(n) for n in channels.names])
    leftovers = [one.leftover for one in whole]
    noises = densities(leftovers, rows, mains)
    step = 20.0 / 65535.0
    models = tuple(
        slow_noise(d, float(pole), leftovers[0], step) for d, pole in zip(noises, channels.pole, strict=True)
    )
    points = [one.point for one in whole]
    frequency = np.array([0.0 if p is None else p.frequency for p in points])
    nominal = np.array([0.0 if p is None else _nominal(records, p) for p in points])
    begins = np.array([one.begin for one in whole])
    observed = np.array([one.lines[rows] for one in whole]).transpose(1, 0, 2)
    usable = np.array([one.usable[rows] & _trusted(one.point) for one in whole]).T
    return SweepRecords(
        name=name,
        run=records.name,
        axis=axis,
        channels=channels,
        observed=np.asarray(observed),
        before=np.asarray(np.array([one.before[rows] for one in whole]).transpose(1, 0, 2)),
        variance=_variances(noises, whole, observed, mains),
        noise=models,
        shown=np.nan_to_num(
            [np.zeros(ORDERS) if p is None else np.concatenate([[0.0], p.acceleration]) for p in points]
        ),
        gated=np.nan_to_num([one.gated for one in whole]),
        outliers=np.array([one.outliers for one in whole]),
        reference_variance=np.array([one.reference_variance for one in whole]),
        frequency=frequency,
        nominal=nominal,
        begin=begins,
        end=np.array([one.begin + one.seconds for one in whole]),
        level=tuple("rest" if p is None else p.level for p in points),
        index=np.array([-1 if p is None else p.index for p in points]),
        usable=usable,
        source=np.array([0.0 if p is None else p.source for p in points]),
        scale=np.array([0.0 if p is None else p.scale for p in points]),
        temperature=smoothed(begins, np.array([one.temperature for one in whole])),
        supply=smoothed(begins, np.array([one.supply for one in whole])),
        mains=mains,
        gravity=reference(records, "gravity", "gravity").value,
        directions=directions(axis),
        drive_off=drive_clock(frequency, nominal, [_only(one, rows) for one in leftovers], mains) is not None,
        notes=tuple(f"{p.run} point {p.index}: {f}" for p in points if p and not _trusted(p) for f in p.flags),
    )


def _trusted(point: SinePoint | None) -> bool:
    """Whether nothing but the record's length is to be said of a point: the fit knows the frequency, not its cycles."""
    return point is None or all(flag.startswith("not whole cycles") for flag in point.flags)


def _shown(point: SinePoint | None) -> Complexes:
    """Harmonics 0 … 5 of the acceleration that the reference shows, none at rest."""
    if point is None:
        return np.zeros(ORDERS, np.complex128)
    return np.concatenate([[0.0], point.acceleration])


def _only(leftover: Leftover, rows: NDArray[np.intp]) -> Leftover:
    return Leftover(
        leftover.begin, leftover.resolution, leftover.amplitude[:, rows], leftover.reference, leftover.taken
    )


def _nominal(records: Recorded, point: SinePoint) -> float:
    return float(records.points[point.index]["frequency"])


def _variances(densities: Sequence[Density], whole: Sequence[_Record], observed: Complexes, mains: float) -> Array:
    """Variance of each part of every line, V²: density ÷ length of the record."""
    found = np.full(observed.shape, np.nan)
    for p, one in enumerate(whole):
        f = np.concatenate(
            [(one.point.frequency if one.point else math.nan) * np.arange(ORDERS), mains * np.array(MAINS_ORDERS)]
        )
        for c, of_channel in enumerate(densities):
            at = np.interp(np.log(np.where(f > 0.0, f, 1.0)), np.log(of_channel.frequency), of_channel.density)
            found[c, p] = np.where(np.isfinite(observed[c, p]) & (f > 0.0), at / one.seconds, np.nan)
    return found
