"""A first look at a run: plain estimates and one figure, with no uncertainty yet.

Sine points are fitted with the three-parameter sine approximation (IEEE 1057; ISO 16063-11), the sensor's own sampling
instants and the vibrometer's; a = jωv. Rates come from whole revolutions of the encoder. Calibration proper, with
uncertainty, is another program part; these numbers say that the record is worth analysing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import tone
from rig.record import Channel, CubeSamples, Samples, Timing, Traces
from rig.run_reader import Run

STANDARD_GRAVITY = 9.80665
Signal = tuple[NDArray[np.float64], NDArray[np.float64]]  # instants s, volts
LOW = 50.0  # Hz; below it a 400 Hz output filter takes less than 0.8 % of the amplitude


@dataclass(frozen=True)
class SinePoint:
    """One channel at one sine point: complex response, V/(m/s²), at `frequency` (Hz), `level` by name."""

    channel: str
    axis: str
    frequency: float
    level: str
    response: complex


@dataclass(frozen=True)
class Row:
    """One line of the table: a channel, its plain sensitivity (SI), and where that comes from."""

    channel: str
    sensitivity: float
    unit: str
    basis: str


class Records:
    """A run's journal read once, and its records as Samples."""

    def __init__(self, run: Run) -> None:
        self.run, self.header = run, run.header
        self.lines, self.points, self._blocks = list(run.lines()), run.points(), run.blocks()

    def samples(self, name: str) -> Samples:
        """The record behind a block name; pieces of a long record are joined. KeyError if there is none."""
        parts = self._blocks[name]
        meta = parts[0].meta
        channels = tuple(Channel(str(n), int(k), float(low), float(high)) for n, k, low, high in meta["channels"])
        pieces = [self.run.read(part) for part in parts]
        return Samples(
            counts=pieces[0] if len(pieces) == 1 else np.concatenate(pieces),
            channels=channels,
            timing=Timing(float(meta["convert_period"]), int(meta["scan_channels"])),
            start=float(meta["start"]),
            first_scan=int(meta["first_scan"]),
            flags=frozenset(meta["flags"]),
        )

    def signals(self, body: Mapping[str, Any]) -> Iterator[tuple[str, Signal]]:
        """Instants (s) and volts of every channel of one point: the converter's, else the oscilloscope's."""
        if "samples" in body:
            samples = self.samples(body["samples"])
            for channel in samples.channels:
                yield channel.name, (samples.instants(channel.name), samples.volts(channel.name))
        elif "traces" in body:
            meta = self._blocks[body["traces"]][0].meta
            volts = self.run.block(body["traces"])
            traces = Traces(tuple(meta["names"]), volts, float(meta["start"]), float(meta["interval"]))
            for name, row in zip(traces.names, traces.volts, strict=True):
                yield name, (traces.instants(), row)

    def cube(self, name: str) -> CubeSamples:
        """The Sensor Cube's own frames behind a block name."""
        meta = self._blocks[name][0].meta
        frames = self.run.block(f"{name}-frames")
        return CubeSamples(
            names=tuple(meta["names"]),
            counts=self.run.block(name),
            sequence=frames[:, 0],
            device_us=frames[:, 1],
            flags=frames[:, 2].astype(np.uint16),
            supply=frames[:, 3].astype(np.uint16),
            temperature=frames[:, 4].astype(np.uint16),
            gaps=int(meta["gaps"]),
            bad_frames=int(meta["bad_frames"]),
            rate=float(meta["rate"]),
            start=float(meta["start"]),
        )


def sine_points(records: Records) -> list[SinePoint]:
    """Response of every accelerometer channel at every sine point that the converter recorded."""
    found: list[SinePoint] = []
    sensors = records.header["sensor"]["channels"]
    for body in records.points.values():
        if "frequency" in body:
            signals = dict(records.signals(body))
            names = [n for n, sensor in sensors.items() if sensor["quantity"] == "acceleration" and n in signals]
            found += [_sine_point(signals, body, name) for name in names if "ldv" in signals]
    return found


def _sine_point(signals: Mapping[str, Signal], body: Mapping[str, Any], name: str) -> SinePoint:
    frequency = float(body["frequency"])
    reference, sensor = (tone.fit_three(*signals[channel], frequency) for channel in ("ldv", name))
    acceleration = 2j * math.pi * frequency * reference.amplitude * float(body["scale"])
    return SinePoint(name, str(body["axis"]), frequency, str(body["level"]), complex(sensor.amplitude / acceleration))


def sweep_rows(records: Records, points: list[SinePoint]) -> list[Row]:
    """Plain sensitivity of the driven channels: mean magnitude up to 50 Hz, or at the lowest frequency there is."""
    rows = []
    sensors = records.header["sensor"]["channels"]
    for axis in sorted({point.axis for point in points}):
        for name, sensor in sensors.items():
            mine = [p for p in points if p.channel == name and p.axis == axis and sensor["axis"] == axis]
            if not mine:
                continue
            top = max(LOW, min(p.frequency for p in mine))
            low = [abs(p.response) for p in mine if p.frequency <= top]
            basis = f"three-parameter sine fit, mean of {len(low)} points up to {top:g} Hz"
            rows.append(Row(name, float(np.mean(low)), "V/(m/s²)", basis))
    return rows


def static_means(records: Records) -> Iterator[tuple[Mapping[str, Any], dict[str, float], dict[str, float]]]:
    """For every static record: its journal body, the mean and the standard deviation of each channel, V."""
    for entry in records.lines:
        if entry.kind in ("point", "step") and "purpose" in entry.body and "samples" in entry.body:
            samples = records.samples(entry.body["samples"])
            names = [channel.name for channel in samples.channels]
            means = {name: float(samples.volts(name).mean()) for name in names}
            yield entry.body, means, {name: float(samples.volts(name).std()) for name in names}


def turntable_rows(records: Records) -> list[Row]:
    """Plain gyro sensitivity: (mean volts turning − mean volts at rest) ÷ whole-revolution mean rate of the encoder."""
    rest = {name: value for _, means, _ in static_means(records) for name, value in means.items()}
    rows = []
    for body in records.points.values():
        if body.get("phase") != "hold" or not rest:
            continue
        samples = records.samples(body["samples"])
        for name in (f"gyro_{body['gyro_axis']}", f"backup_{body['gyro_axis']}"):
            inside = _between(samples, name, body["first_index"], body["last_index"])
            # about the gyro's own axis: upside down it sees the platter turn the other way
            rate = -float(body["rate"]) if body["inverted"] else float(body["rate"])
            sensitivity = (float(inside.mean()) - rest[name]) / rate
            where = f"at {math.degrees(rate):+.2f} °/s, {body['revolutions']} whole revolutions of the encoder"
            rows.append(Row(name, sensitivity, "V/(rad/s)", where))
    return rows


def _between(samples: Samples, name: str, first: float, last: float) -> NDArray[np.float64]:
    instants = samples.instants(name)
    return samples.volts(name)[(instants >= first) & (instants < last)]


@dataclass(frozen=True)
class Line:
    """Volts of one channel against the component of gravity: slope V/(m/s²), residuals V, shape (poses,)."""

    channel: str
    slope: float
    residuals: NDArray[np.float64]


def tumble_lines(records: Records) -> list[Line]:
    """Least squares of volts on the component of "up", with offset, for every accelerometer channel."""
    poses = [(body, means) for body, means, _ in static_means(records) if body["purpose"] == "pose"]
    ups = _pose_directions(records)
    if len(poses) < 6 or len(ups) != len(poses):
        return []
    gravity = gravity_of(records)
    lines = []
    for name, sensor in records.header["sensor"]["channels"].items():
        if sensor["quantity"] != "acceleration" or name not in poses[0][1]:
            continue
        component = np.array([up["xyz".index(sensor["axis"])] for up in ups]) * gravity
        volts = np.array([means[name] for _, means in poses])
        slope, offset = np.polyfit(component, volts, 1)
        lines.append(Line(name, float(slope), volts - slope * component - offset))
    return lines


def tumble_rows(records: Records) -> list[Row]:
    """Plain accelerometer sensitivity against gravity."""
    return [
        Row(line.channel, line.slope, "V/(m/s²)", f"straight line, {len(line.residuals)} poses against gravity")
        for line in tumble_lines(records)
    ]


def _pose_directions(records: Records) -> list[tuple[float, float, float]]:
    asked = [e.body["settings"] for e in records.lines if e.kind == "confirmed" and e.body["action"] == "pose"]
    return [(float(s["up_x"]), float(s["up_y"]), float(s["up_z"])) for s in asked]


def gravity_of(records: Records) -> float:
    """Local gravity from the run's standards, m/s²; standard gravity if the bench has no such standard."""
    from rig import units

    for standard in records.header["standards"]:
        if standard["standard"] == "gravity":
            return units.parse(standard["values"]["gravity"]["value"], "acceleration")
    return STANDARD_GRAVITY


def noise_rows(records: Records) -> list[Row]:
    """Standard deviation of each channel at rest, V."""
    return [
        Row(name, deviation, "V rms", f"{body['seconds']:g} s at rest")
        for body, _, deviations in static_means(records)
        if body["purpose"] == "noise"
        for name, deviation in deviations.items()
        if name in records.header["sensor"]["channels"]
    ]


def rows_of(records: Records) -> list[Row]:
    """The table of a run, whatever kinds of measurement are in it."""
    return [
        *sweep_rows(records, sine_points(records)),
        *turntable_rows(records),
        *tumble_rows(records),
        *noise_rows(records),
    ]
