"""Sweeps and turntable runs with the sensor's channels as the Sensor Cube recorded them, the reference as before.

Amplitudes and means belong together, because motions are steady; the instants of every record are uncertain (see
`clocks`). Lost frames stay lost: sines are fitted at the instants that there are, noise and hum are told by the longest
stretch without a gap, and a turntable's record falls into the stretches without one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import units
from rig.archive.records import Recorded, experiments, is_imported, reference, wires_of
from rig.model import Channels
from rig.motion import ORDERS, Array, Complexes
from rig.parts.channels import channels_of
from rig.parts.conditions import smoothed
from rig.parts.platter import Platter
from rig.parts.reading import clocks, nuisances
from rig.parts.reading.cube_frames import (
    BESIDE,
    NYQUIST,
    STEP,
    Frames,
    frames,
    points_by_cube,
    rests,
    signals_of_frames,
)
from rig.parts.reading.reading import Reading
from rig.parts.reading.turntable import WINDOW, Windows, spun_from
from rig.parts.reading.vibration import Chain, SinePoint, chain_of, lines_of, sines
from rig.parts.sweep import Sweep
from rig.parts.sweep_lines import LIMIT, density, slow_noise, taken
from rig.parts.sweep_records import LINES, MAINS_ORDERS, Leftover, SweepRecords, directions
from rig.sensor import Sensor
from rig.signals.spectrum import Density

FOLDING = 12  # harmonics of the motion that may fall on another one at the cube's rate
PIECE = 1.0  # s of a record at rest, as long as a sine's
SHORTEST = 40  # windows of a turntable record without a gap, of which the margins leave something
ENOUGH = 64  # samples without a gap, of which a spectrum says something


def read(runs: Sequence[Recorded]) -> Reading:
    """Every sweep and turntable run of the rig's own of which the cube kept records."""
    own = [one for run in runs if not is_imported(run) for one in experiments(run)]
    swept = [(one, made) for n, one in enumerate(own) if (made := _swept(one, f"{one.name}#cube {n}")) is not None]
    parts = [Sweep(made) for _, made in swept]
    known = [*nuisances.of_shaker([one for one, _ in swept])] if swept else []
    known += [clocks.of_sines(data.name, np.flatnonzero(data.driven).tolist(), _u_time(one)) for one, data in swept]
    turned = [one for one in own if any("phase" in body for body in one.points.values())]
    spun = [Platter(data) for one in turned for data in spun_from(one, windows, partial(_channels, one))]
    if spun:
        known += [*nuisances.of_turntable(turned), clocks.of_turns(max(map(_u_time, turned)))]
    return Reading((*parts, *spun), tuple(known))


def _channels(records: Recorded) -> Channels:
    """All of the sensor, sampled at once."""
    found = channels_of(records, list(Sensor.of(records.header).names))
    return replace(found, slot=np.zeros(len(found.names), np.intp))


def _u_time(records: Recorded) -> float:
    """The largest uncertainty of an instant of the cube's records, s."""
    bodies = [body for body in records.points.values() if "cube" in body]
    return max((frames(records, body).u_time for body in bodies), default=0.0)


# sweeps


@dataclass(frozen=True)
class _Record:
    """One record of the cube, or a piece of one at rest; `lines` (c, LINES) V."""

    begin: float
    seconds: float
    lines: Complexes
    leftover: Leftover
    usable: NDArray[np.bool_]
    temperature: float
    supply: float
    point: SinePoint | None
    moved: Complexes  # (ORDERS,) m/s², what the reference shows, with the variance of each part
    variance: Array


def _swept(records: Recorded, name: str) -> SweepRecords | None:
    """One sweep; None for a run that is none, or of which the cube kept no sine."""
    if not any("frequency" in body and "cube" in body for body in records.points.values()):
        return None
    chain, channels = chain_of(records), _channels(records)
    mains = units.parse(str(records.header["bench_file"]["mains"]), "frequency")
    whole = [one for body in rests(records) for one in _resting(records, body, channels, mains)]
    sensor = Sensor.of(records.header)
    for sine in sines(records, chain):
        for point in points_by_cube(records, [sine.point], sensor):
            whole += _driven(records, point, channels, chain, mains)
    if not any(one.point is not None for one in whole):
        return None
    return _joined(records, name, channels, sorted(whole, key=lambda one: one.begin), mains)


def _resting(records: Recorded, body: Mapping[str, Any], channels: Channels, mains: float) -> Iterator[_Record]:
    """Pieces of about one second of what has no gap."""
    seen = frames(records, body)
    volts, first, last = _volts(seen, channels), seen.whole.start, seen.whole.stop
    each = round((last - first) / max(1, math.floor((last - first) / seen.samples.rate / PIECE)))
    for begin in range(first, last - each + 1, each):
        here = slice(begin, begin + each)
        lines = np.full((len(channels.names), LINES), np.nan, np.complex128)
        lines[:, 0] = volts[here].mean(axis=0)
        left = volts[here] - volts[here].mean(axis=0)
        yield _record(seen, channels, here, lines, left, None, mains)


def _driven(records: Recorded, point: SinePoint, channels: Channels, chain: Chain, mains: float) -> Iterator[_Record]:
    """A sine, its phases such that the channel that answers most answers as its data sheet says; none that the cube
    cannot show.
    """
    seen, signals = (
        frames(records, records.points[point.index]),
        signals_of_frames(records, records.points[point.index]),
    )
    if not point.lines or seen.whole.stop - seen.whole.start < ENOUGH:
        return
    fitted, left = lines_of(signals, point.frequency)
    lines, turn = np.full((len(channels.names), LINES), np.nan, np.complex128), _aligned(point, channels)
    for c, name in enumerate(channels.names):
        lines[c, 0], lines[c, 1:ORDERS] = fitted[name].mean, point.lines[name].amplitudes * turn
    lines[:, 1:ORDERS][:, ~_alone(point.frequency, seen.samples.rate)] = np.nan
    at = np.asarray(point.frequency * np.arange(1, ORDERS), np.float64)
    per_volt = np.abs(2.0 * math.pi * at * chain.velocity_per_volt(point.scale, at))
    order = [signals.column(name) for name in channels.names]
    one = _record(seen, channels, seen.whole, lines, left[seen.whole][:, order], point, mains)
    yield replace(
        one, begin=seen.start + float(seen.instants[0]), seconds=len(seen.instants) / seen.samples.rate,
        moved=np.concatenate([[0.0], np.nan_to_num(point.acceleration)]),
        variance=np.concatenate([[np.nan], per_volt**2 * point.reference_line.variance]),
    )  # fmt: skip


def _aligned(point: SinePoint, channels: Channels) -> Complexes:
    """What turns the harmonics of a sine, (ORDERS − 1,): a time that nobody knows, told by the strongest channel."""
    along = directions(point.axis)[channels.axis, 0] * ~channels.rates
    drive = complex(point.acceleration[0])
    expected = along * drive * channels.sensitivity / (1.0 + 1j * point.frequency / channels.pole)
    row = int(np.argmax(np.abs(expected)))
    angle = float(np.angle(expected[row] / point.lines[channels.names[row]].amplitudes[0]))
    return np.asarray(np.exp(1j * angle * np.arange(1, ORDERS)))


def _alone(frequency: float, rate: float) -> NDArray[np.bool_]:
    """Harmonics on which no other one falls at this rate, (ORDERS − 1,)."""
    at = frequency * np.arange(1, FOLDING + 1)
    folded = np.abs(at - rate * np.round(at / rate))
    near = np.abs(at[: ORDERS - 1, None] - folded[None, :]) < BESIDE
    near[np.arange(ORDERS - 1), np.arange(ORDERS - 1)] = False
    return np.asarray((at[: ORDERS - 1] < NYQUIST * rate) & ~near.any(axis=1))


def _record(
    seen: Frames, channels: Channels, here: slice, lines: Complexes, left: Array, point: SinePoint | None, mains: float
) -> _Record:
    """A stretch without gaps, `left` of it (n, c); mains lines are filled in."""
    samples, instants = seen.samples, seen.instants[here]
    count, rate = len(instants), samples.rate
    resolution, begin = rate / count, seen.start + float(instants[0])
    spectrum = np.fft.rfft(left, axis=0) * (2.0 / count)
    at = np.asarray(np.arange(len(spectrum)) * resolution, np.float64)
    for place, order in enumerate(MAINS_ORDERS, ORDERS):
        turned = np.exp(-2j * math.pi * order * mains * (instants - instants[0])) @ left * (2.0 / count)
        lines[:, place] = turned * np.exp(-2j * math.pi * order * mains * begin)
    if point is not None:
        lines[:, _mingled(point.frequency, rate, mains, resolution)] = np.nan
    marked = taken(at, point.frequency if point is not None else None, resolution)
    return _Record(
        begin=begin, seconds=count / rate, lines=lines,
        leftover=Leftover(begin, resolution, spectrum, np.zeros(len(spectrum), np.complex128), marked),
        usable=np.array([not samples.clipped(name) for name in channels.names]),
        temperature=float(samples.celsius()[here].mean()), supply=float(samples.supply_volts()[here].mean()),
        point=point, moved=np.zeros(ORDERS, np.complex128), variance=np.full(ORDERS, np.nan),
    )  # fmt: skip


def _mingled(frequency: float, rate: float, mains: float, resolution: float) -> NDArray[np.bool_]:
    """Lines in which a record cannot tell a harmonic of the drive from the mains, (LINES,); the driven one is kept."""
    harmonics = frequency * np.arange(1, ORDERS)
    apart = np.abs(harmonics - mains * np.maximum(np.round(harmonics / mains), 1.0)) > LIMIT * resolution
    folded = np.abs(harmonics - rate * np.round(harmonics / rate))
    of_mains = np.abs(mains * np.array(MAINS_ORDERS)[:, None] - folded).min(axis=1) > LIMIT * resolution
    return ~np.concatenate([[True, True], apart[1:], of_mains])


def _volts(seen: Frames, channels: Channels) -> Array:
    return np.stack([seen.samples.volts(name) for name in channels.names], axis=1)


def _joined(records: Recorded, name: str, channels: Channels, whole: Sequence[_Record], mains: float) -> SweepRecords:
    """Records in the order of time."""
    points = [one.point for one in whole]
    densities = [density([one.leftover for one in whole], row, mains) for row in range(len(channels.names))]
    models = tuple(
        slow_noise(d, float(pole), whole[0].leftover, STEP) for d, pole in zip(densities, channels.pole, strict=True)
    )
    axis = next(p.axis for p in points if p is not None)
    begins = np.array([one.begin for one in whole])
    observed = np.asarray(np.array([one.lines for one in whole]).transpose(1, 0, 2))
    moved = np.array([one.moved for one in whole])
    trusted = [p is None or all(flag.startswith("not whole cycles") for flag in p.flags) for p in points]
    return SweepRecords(
        name=name, run=records.name, axis=axis, channels=channels, observed=observed,
        before=np.zeros_like(observed), variance=_variances(densities, whole, observed, mains), noise=models,
        shown=moved, gated=moved, outliers=np.zeros((len(whole), 2)),
        reference_variance=np.array([one.variance for one in whole]),
        frequency=np.array([0.0 if p is None else p.frequency for p in points]),
        nominal=np.array([0.0 if p is None else float(records.points[p.index]["frequency"]) for p in points]),
        begin=begins, end=np.array([one.begin + one.seconds for one in whole]),
        level=tuple("rest" if p is None else p.level for p in points),
        index=np.array([-1 if p is None else p.index for p in points]),
        usable=np.array([one.usable & known for one, known in zip(whole, trusted, strict=True)]).T,
        source=np.array([0.0 if p is None else p.source for p in points]),
        scale=np.array([0.0 if p is None else p.scale for p in points]),
        temperature=smoothed(begins, np.array([one.temperature for one in whole])),
        supply=smoothed(begins, np.array([one.supply for one in whole])),
        mains=mains, gravity=reference(records, "gravity", "gravity").value, directions=directions(axis),
        notes=tuple(f"{p.run} point {p.index}: {f}" for p, t in zip(points, trusted, strict=True) if p and not t
                    for f in p.flags),
    )  # fmt: skip


def _variances(densities: Sequence[Density], whole: Sequence[_Record], observed: Complexes, mains: float) -> Array:
    """Variance of each part of every line, V²: density ÷ length of the record."""
    found = np.full(observed.shape, np.nan)
    for p, one in enumerate(whole):
        driven = (one.point.frequency if one.point else math.nan) * np.arange(ORDERS)
        f = np.concatenate([driven, mains * np.array(MAINS_ORDERS)])
        for c, level in enumerate(densities):
            at = np.interp(np.log(np.where(f > 0.0, f, 1.0)), np.log(level.frequency), level.density)
            found[c, p] = np.where(np.isfinite(observed[c, p]) & (f > 0.0), at / one.seconds, np.nan)
    return found


# the turntable


def windows(records: Recorded, body: Mapping[str, Any]) -> Iterator[Windows]:
    """Means of the cube's channels over the converter's windows, a stretch without lost frames after the other."""
    if "cube" not in body:
        return
    seen, piece = frames(records, body), next(iter(records.pieces(str(body["samples"]))))
    wires, interval, channels = wires_of(records), piece.timing.scan_period, _channels(records)
    volts = [*_volts(seen, channels).T, seen.samples.supply_volts(), seen.samples.celsius() / 100.0]
    count = sum(len(one.counts) for one in records.pieces(str(body["samples"]))) // WINDOW
    bounds = np.asarray(piece.start + (np.arange(count + 1) * WINDOW - 0.5) * interval, np.float64)
    means = np.array([seen.means(one, bounds[:-1], bounds[1:]) for one in volts])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.isfinite(means).all(axis=0), [False]]).astype(int)))
    clipped = {name: n for name in channels.names if (n := seen.samples.clipped(name))}
    names = (*channels.names, wires.supply, wires.temperature)
    for first, stop in zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True):
        if stop - first >= SHORTEST:
            later = first * WINDOW * interval
            yield Windows(names, means[:, first:stop], piece.start + later, interval, later, clipped)
