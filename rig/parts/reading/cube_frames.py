"""The Sensor Cube's own frames as a recorder of the sensor, beside a record of the reference.

All channels are sampled at once, by the device's clock: bench time = offset + device time / (1 + rate error), with the
fit of arrivals over device time (`drivers/sensor_cube.py`). A frame arrives later than it was sampled: on average half
a period until the next one is the newest, and about as long on the line. That mean is taken off; what is left of it,
with the scatter of the fit, is the uncertainty of every instant of a record, the same for all its samples.

Lost frames stay lost: means are of the samples that are there, sines are fitted at the instants that there are, and
noise comes from the longest stretch without a gap.

At a sine the frequency is free in the cube's own record. The motion is steady, so amplitudes of the two records belong
together wherever they begin; phases differ by 2πf times the clocks' uncertainty, which `SinePoint.u_time` says.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, Signals, wires_of
from rig.errors import BadInput
from rig.parts.reading.revolutions import Blocks, Rotation
from rig.parts.reading.vibration import HARMONICS, Line, SinePoint, lines_of
from rig.record import ClockFit, CubeSamples
from rig.sensor import Sensor
from rig.signals import tone

Array = NDArray[np.float64]
STEP = 5.0 / 65535.0  # V
LATENCY = 1.0  # sample periods between a sample and its arrival, on average
U_LATENCY = 1.0 / math.sqrt(3.0)  # sample periods: between none and two
BESIDE = 3.0  # lines that an alias must keep away from the driven frequency
NYQUIST = 0.45  # of the rate: no sine is read above
ENOUGH = 0.95  # of a block's samples must be there for its mean to stand for the block
UNKNOWN_START = 1.0  # s; of a record without any clock


@dataclass(frozen=True)
class Frames:
    """One record of the cube: `instants` s since `start` (bench clock, s), each uncertain by the same `u_time` (s)."""

    samples: CubeSamples
    start: float
    instants: Array
    u_time: float

    @property
    def names(self) -> tuple[str, ...]:
        return self.samples.names

    @cached_property
    def whole(self) -> slice:
        """The longest stretch without a gap."""
        breaks = np.flatnonzero(np.diff(self.samples.sequence) != 1) + 1
        bounds = np.concatenate([[0], breaks, [len(self.samples.sequence)]])
        longest = int(np.argmax(np.diff(bounds)))
        return slice(int(bounds[longest]), int(bounds[longest + 1]))

    def mean(self, name: str) -> float:
        """Mean of one channel over the samples that are there, V."""
        return float(self.samples.volts(name).mean())

    def means(self, volts: Array, begin: Array, end: Array) -> Array:
        """Means between bench times (s), of the samples whose instants fall there; NaN where some part was lost."""
        first, last = (np.searchsorted(self.start + self.instants, at) for at in (begin, end))
        total = np.concatenate([[0.0], np.cumsum(volts)])
        count = last - first
        enough = count >= ENOUGH * (end - begin) * self.samples.rate
        return np.asarray(np.where(enough, (total[last] - total[first]) / np.maximum(count, 1), np.nan), np.float64)


def frames(records: Recorded, body: Mapping[str, Any]) -> Frames:
    """The cube's record of a point or a record at rest."""
    samples = records.cube(str(body["cube"]))
    stated = body.get("cube_clock")
    clock = samples.clock if stated is None else ClockFit(**stated)
    device, period = samples.instants(), 1.0 / samples.rate
    if clock is None:
        return Frames(samples, samples.start, device, UNKNOWN_START)
    u_fit = math.hypot(clock.u_offset, clock.u_rate * float(device[-1])) if len(device) else clock.u_offset
    start = clock.offset - LATENCY * period
    return Frames(samples, start, device / (1.0 + clock.rate_error), math.hypot(u_fit, U_LATENCY * period))


def signals_of_frames(records: Recorded, body: Mapping[str, Any]) -> Signals:
    """The same as signals of simultaneous channels."""
    found = frames(records, body)
    samples = found.samples
    volts = samples.counts / 65535.0 * 5.0
    clipped = {name: n for name in samples.names if (n := samples.clipped(name))}
    return Signals(samples.names, found.instants, np.zeros(len(samples.names)), volts, clipped, STEP, found.start)


def rests(records: Recorded) -> Iterator[Mapping[str, Any]]:
    """Journal bodies of every record at rest that the cube kept."""
    for entry in records.lines:
        if entry.kind in ("point", "step") and "purpose" in entry.body and "cube" in entry.body:
            yield entry.body


# sines


def points_by_cube(records: Recorded, points: Iterable[SinePoint], sensor: Sensor) -> list[SinePoint]:
    """The same points with the sensor's channels as the cube recorded them; [] where it kept no record."""
    return [
        _by_cube(records, records.points[point.index], point, sensor)
        for point in points
        if "cube" in records.points[point.index]
    ]


def _by_cube(records: Recorded, body: Mapping[str, Any], point: SinePoint, sensor: Sensor) -> SinePoint:
    seen = signals_of_frames(records, body)
    refused = _unreadable(point.frequency, seen.rate)
    if refused:
        return replace(point, lines={}, flags=(*point.flags, refused))
    strongest = _strongest(seen, point, sensor)
    nominal = float(body["frequency"])
    found = tone.fit_four(seen.instants, seen.of(strongest), nominal).frequency
    lines, _ = lines_of(seen, found)
    if "samples" not in body:  # the oscilloscope's trigger has no bench time
        return replace(point, lines=_of_sensor(lines, sensor, np.ones(HARMONICS)), u_time=UNKNOWN_START)
    behind = records.samples(str(body["samples"])).start - seen.start
    turn = np.exp(2j * math.pi * point.frequency * np.arange(1, HARMONICS + 1) * behind)
    return replace(point, lines=_of_sensor(lines, sensor, turn), u_time=frames(records, body).u_time)


def _of_sensor(lines: Mapping[str, Line], sensor: Sensor, turn: NDArray[Any]) -> dict[str, Line]:
    """Lines of the sensor's channels, every harmonic turned."""
    mine = {name: line for name, line in lines.items() if name in sensor}
    return {name: replace(line, amplitudes=np.multiply(line.amplitudes, turn)) for name, line in mine.items()}


def _strongest(seen: Signals, point: SinePoint, sensor: Sensor) -> str:
    along = [c.name for c in sensor.along(point.axis) if c.name in seen.names and c.name not in seen.clipped]
    if not along:
        raise BadInput(f"{point.run}, point {point.index}: found no channel of the cube along {point.axis}, wanted one")
    return max(along, key=lambda name: abs(tone.fit_three(seen.instants, seen.of(name), point.frequency).amplitude))


def _unreadable(frequency: float, rate: float) -> str:
    """Why a sine cannot be read at this rate: too fast, or a harmonic of the motion falls on it; "" if it can."""
    if frequency > NYQUIST * rate:
        return f"beyond {NYQUIST * rate:g} Hz, what the cube's {rate:.4g} samples per second can show"
    for order in range(2, HARMONICS + 1):
        folded = abs(order * frequency - rate * round(order * frequency / rate))
        if abs(folded - frequency) < BESIDE:
            return f"harmonic {order} of the motion folds onto it at the cube's {rate:.4g} samples per second"
    return ""


# the turntable


def rotation_by_cube(records: Recorded, rotation: Rotation, sensor: Sensor) -> Rotation:
    """The same motion of the platter with what the cube recorded meanwhile; noise in motion is not evaluated."""
    bodies = {str(body["samples"]): body for body in records.points.values() if "cube" in body and "samples" in body}
    supply = wires_of(records).supply
    blocks = tuple(_block(records, bodies[b.record], b, sensor, supply) for b in rotation.blocks if b.record in bodies)
    return replace(rotation, blocks=blocks, in_motion={}, flags=tuple(f for one in blocks for f in one.flags))


def _block(records: Recorded, body: Mapping[str, Any], block: Blocks, sensor: Sensor, supply: str) -> Blocks:
    found = frames(records, body)
    samples = found.samples
    volts = {name: samples.volts(name) for name in samples.names if name in sensor} | {supply: samples.supply_volts()}
    means = {name: found.means(one, block.begin, block.end) for name, one in volts.items()}
    there = np.all([np.isfinite(one) for one in means.values()], axis=0)
    clipped = {name: n for name in samples.names if name in sensor and (n := samples.clipped(name))}
    flags = tuple(f"{block.label}: {name} clipped ({n} samples)" for name, n in clipped.items())
    lost = int(np.count_nonzero(~there))
    if lost:
        flags = (*flags, f"{block.label}: {lost} of {len(there)} blocks left out: frames of the cube were lost")
    kept = ("begin", "end", "rate", "square", "cube", "acceleration")
    arrays: dict[str, Any] = {name: getattr(block, name)[there] for name in kept}
    index = tuple(flag for flag in block.flags if "index" in flag)
    return replace(
        block, **arrays, volts={n: one[there] for n, one in means.items()}, clipped=clipped,
        flags=(*index, *flags), u_time=found.u_time,
    )  # fmt: skip


def u_time_of(rotations: Sequence[Rotation]) -> float:
    """The largest uncertainty of the cube's instants among the blocks, s."""
    return max((block.u_time for rotation in rotations for block in rotation.blocks), default=0.0)
