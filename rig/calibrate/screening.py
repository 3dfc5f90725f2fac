"""What is looked at before anything is concluded: whether every channel's samples are a measurement at all.

A channel that shows nothing in a run is left out of it, and is among the results all the same: not determined, and why.
Nobody else sees it there: its wire has another name, which no sensor file knows. What is wrong with fewer samples stays
in, and flags what stands on it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.archive.journal import Entry
from rig.archive.records import Recorded, Signals, wires_of
from rig.archive.reduced import reduced
from rig.calibrate.calibration import Result, rejected
from rig.calibrate.cube_route import Recorder
from rig.record import CubeSamples, Response, Samples
from rig.sensor import Sensor, SensorChannel
from rig.signals.rest_lines import around
from rig.signals.sample_faults import Faults, faults, together

LOST = 0.1  # share of a record without which a channel shows nothing there
HIDDEN = "{} (left out)"
NOISE = ("deviation", "noise_density", "bias_instability", "random_walk", "noise_bandwidth")
ASKED = ("sensitivity", "sensitivity_gravity", "deviation")
PLAUSIBLE = {"supply": (1.0, 30.0, "V"), "temperature": (-40.0, 85.0, "°C")}  # of a bench with parts that work
MOST = 60_000.0  # steps of a record in volts: a code has sixteen bits
LONG = 1 << 17  # scans looked at together: 4 MB of sixteen channels
ONE_WIRE = 0.5  # correlation of steps, of which slots of a scan 60 µs apart leave 0.7; of separate ones none
ENOUGH = 1000  # steps: by chance their correlation is below 0.2
FEW = 3  # records that a remark names


@dataclass(frozen=True)
class Found:
    """What is wrong with a channel in one record of a run: `label` of the record, `at_rest` if nothing moved."""

    run: str
    label: str
    channel: str
    faults: Faults
    at_rest: bool
    like: tuple[str, ...] = ()
    """Channels that show the very same noise: there is one wire, or the multiplexer does not step."""

    @property
    def lost(self) -> bool:
        return self.faults.lost >= LOST

    @property
    def words(self) -> str:
        return ", ".join([*self.faults, *(f"the same noise as {one}" for one in self.like)])


@dataclass(frozen=True)
class Rejected:
    """A channel that is left out of a run, why, and where: `measurand` says what of it was to be determined there."""

    run: str
    channel: str
    why: str
    measurands: tuple[str, ...]

    def result(self, measurand: str, sensor: SensorChannel) -> Result:
        """Its row among the results."""
        unit = sensor.unit if measurand == "deviation" else f"V/({sensor.unit})"
        title = {"deviation": "deviation at rest", "sensitivity_gravity": "sensitivity from gravity"}
        return rejected(self.channel, measurand, title.get(measurand, "sensitivity"), unit, self.why)


@dataclass(frozen=True)
class Screened:
    """Runs with what cannot be used hidden, and what was found."""

    runs: tuple[Recorded, ...]
    rejected: tuple[Rejected, ...] = ()
    doubted: tuple[Found, ...] = ()
    surroundings: tuple[str, ...] = ()

    def rows(self, sensor: Sensor) -> Iterator[Result]:
        """Rows of what was left out."""
        for one in self.rejected:
            for measurand in one.measurands:
                yield one.result(measurand, sensor.channel(one.channel))

    def flags(self) -> Iterator[str]:
        """What is to be said of the calibration as a whole."""
        for one in self.rejected:
            yield f"{one.run}: {one.channel} left out: {one.why}"
        yield from self.surroundings

    def flagged(self, results: Iterable[Result]) -> Iterator[Result]:
        """The results, those that stand on doubtful samples flagged."""
        for result in results:
            here = [one for one in self.doubted if one.channel == result.channel and _concerns(one, result)]
            if not here:
                yield result
                continue
            if not result.determined:  # nobody asks for what no record could tell anyway
                yield replace(result, verdict="inconclusive") if result.measurand in ASKED else result
                continue
            said = [f"{one.run}, {one.label}: {one.words}" for one in here]
            more = f" and {len(said) - FEW} more" if len(said) > FEW else ""
            remark = f"samples that are no measurement: {'; '.join(said[:FEW])}{more}"
            yield replace(result, status="flagged", remarks=(*result.remarks, remark))


def _concerns(found: Found, result: Result) -> bool:
    """Whether a result stands on a record: noise on records at rest, everything else on all of them."""
    return found.at_rest or result.measurand not in NOISE


def screened(runs: Sequence[Recorded], sensor: Sensor, recorder: Recorder = "converter") -> Screened:
    """Look at all records of the converter, of the oscilloscope where there is no other, or of the cube if it is to be.

    Only the converter's wires are left out; what shows nothing elsewhere flags what stands on it.
    """
    views: list[Recorded] = []
    left_out: list[Rejected] = []
    doubted: list[Found] = []
    logged: list[str] = []
    for run in runs:
        every = _looked_at(run, sensor, recorder)
        found = [one for one in every if one.channel in sensor]
        logged += _surroundings(run, [one for one in every if one.channel not in sensor])
        wired = recorder != "cube" and any("samples" in entry.body for entry in run.lines)
        lost = {one.channel: one for one in reversed(found) if one.lost and wired}
        left_out += [Rejected(run.name, name, one.words, _meant(run, sensor, name)) for name, one in lost.items()]
        doubted += [one for one in found if one.channel not in lost]
        views.append(Without(run, frozenset(lost)) if lost else run)
    return Screened(tuple(views), tuple(left_out), tuple(doubted), tuple(logged))


def _surroundings(run: Recorded, found: Sequence[Found]) -> Iterator[str]:
    """What is wrong with supply and thermometer: each once, and values that no bench has."""
    for one in {one.channel: one for one in reversed(found)}.values():
        yield f"{run.name}, {one.label}: {one.channel} {one.words}: what stands on it is not known"
    for name, (low, high, unit) in PLAUSIBLE.items():
        said = [float(e.body["conditions"][name]) for e in run.lines if name in e.body.get("conditions", {})]
        odd = [value for value in said if not (low <= value <= high or math.isnan(value))]
        if odd:
            yield f"{run.name}: found a {name} of {odd[0]:.4g} {unit}, wanted {low:g} to {high:g} {unit}: wrong wire?"


def _looked_at(run: Recorded, sensor: Sensor, recorder: Recorder) -> list[Found]:
    """Everything that is wrong with samples of sensors in a run."""
    kinds = (Found, Faults)
    return reduced(run, "faults", kinds, lambda: list(_faults_of(run, sensor, recorder)), sensor, recorder)


def _faults_of(run: Recorded, sensor: Sensor, recorder: Recorder) -> Iterator[Found]:
    wires = wires_of(run)
    watched = {*sensor.names, wires.supply, wires.temperature}
    for entry in run.lines:
        body = entry.body
        if entry.kind not in ("point", "step"):
            continue
        at_rest = "frequency" not in body and "phase" not in body
        pieces: dict[str, list[Faults]] = {}
        alike: list[dict[str, set[str]]] = []
        for names, counts in _codes(run, body, recorder):
            for column, name in enumerate(names):
                if name in watched:
                    pieces.setdefault(name, []).append(faults(counts[:, column]))
            if at_rest and len(counts) > ENOUGH:
                alike.append(_alike([name for name in names if name in sensor], names, counts))
        label = str(body.get("label", body.get("samples", "")))
        for name, several in pieces.items():
            like = set.intersection(*(one.get(name, set()) for one in alike)) if alike else set()
            if list(whole := together(several)) or like:
                yield Found(run.name, label, name, whole, at_rest, tuple(sorted(like)))


def _alike(wanted: Sequence[str], names: Sequence[str], counts: NDArray[np.uint16]) -> dict[str, set[str]]:
    """Of each channel, those whose noise is its own: steps from sample to sample, in which a floor hardly shakes.

    Whatever stands out of a channel's spectrum is cut to what is around it: one hum on all wires is not one wire.
    """
    steps = np.diff(counts[:, [names.index(name) for name in wanted]].astype(np.float64), axis=0)
    moving = [n for n in range(len(wanted)) if len(steps) >= ENOUGH and steps[:, n].any()]
    if len(moving) < 2:
        return {}
    shown = steps[:, moving] - steps[:, moving].mean(axis=0)
    lines = np.fft.rfft(shown * np.hanning(len(shown))[:, None], axis=0)
    power = np.abs(lines) ** 2
    lines *= np.sqrt(np.minimum(around(power) / np.maximum(power, np.finfo(float).tiny), 1.0))
    shared = (lines.conj().T @ lines).real
    size = np.sqrt(np.maximum(np.diag(shared), np.finfo(float).tiny))
    together = np.abs(shared / np.outer(size, size)) > ONE_WIRE
    return {
        wanted[n]: {wanted[m] for m, same in zip(moving, row, strict=True) if same and m != n}
        for n, row in zip(moving, together, strict=True)
    }


def _codes(
    run: Recorded, body: Mapping[str, Any], recorder: Recorder
) -> Iterator[tuple[list[str], NDArray[np.uint16]]]:
    """Names and codes, (n, channels), of a record, in stretches."""
    if recorder == "cube":
        if "cube" in body:
            found = run.cube(str(body["cube"]))
            yield list(found.names), found.counts
    elif "samples" in body:
        yield from _stretches(run.pieces(str(body["samples"])))
    elif "traces" in body:
        traces = run.traces(str(body["traces"]))
        yield list(traces.names), np.column_stack([_steps(column) for column in traces.volts.T])


def _steps(volts: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Volts as codes of the converter that they come from, as far as its steps show; none of them on a rail."""
    apart = np.diff(np.unique(volts))
    step = max(float(apart.min()), float(apart.sum()) / MOST) if len(apart) else 1.0
    return np.asarray(np.rint((volts - volts.min()) / step) + 1.0, np.uint16)


def _stretches(pieces: Iterable[Samples]) -> Iterator[tuple[list[str], NDArray[np.uint16]]]:
    """Names and codes, (n, channels), in long stretches, however short the pieces are in which a record was kept."""
    names: list[str] = []
    held: list[NDArray[np.uint16]] = []
    for piece in pieces:
        names = [channel.name for channel in piece.channels]
        held.append(piece.counts)
        if sum(map(len, held)) >= LONG:
            yield names, np.concatenate(held)
            held = []
    if held:
        yield names, np.concatenate(held)


def _meant(run: Recorded, sensor: Sensor, name: str) -> tuple[str, ...]:
    """What a run was to tell of a channel."""
    channel, found = sensor.channel(name), []
    for body in run.points.values():
        along = "frequency" in body and not channel.is_rate and body["axis"] == channel.axis
        about = "phase" in body and channel in sensor.about(str(body["gyro_axis"]))
        if along or about:
            found.append("sensitivity")
        elif body.get("purpose") == "pose" and not channel.is_rate:
            found.append("sensitivity_gravity")
    return (*dict.fromkeys(found), "deviation")


@dataclass(frozen=True)
class Without:
    """A run as if some of its wires led to nothing that anybody knows."""

    whole: Recorded
    hidden: frozenset[str]

    @property
    def name(self) -> str:
        return self.whole.name

    @property
    def status(self) -> str:
        return self.whole.status

    @property
    def header(self) -> Mapping[str, Any]:
        bench: Mapping[str, Any] = self.whole.header["bench_file"]
        cables = {key: [self._called(name) for name in wires] for key, wires in bench["cables"].items()}
        return {**self.whole.header, "bench_file": {**bench, "cables": cables}}

    @property
    def lines(self) -> Sequence[Entry]:
        return self.whole.lines

    @property
    def points(self) -> Mapping[int, Mapping[str, Any]]:
        return self.whole.points

    def samples(self, name: str) -> Samples:
        return self._renamed(self.whole.samples(name))

    def pieces(self, name: str) -> Iterator[Samples]:
        return map(self._renamed, self.whole.pieces(name))

    def traces(self, name: str) -> Signals:
        return self.whole.traces(name)

    def response(self, name: str) -> Response:
        return self.whole.response(name)

    def cube(self, name: str) -> CubeSamples:
        return self.whole.cube(name)

    def table(self, name: str) -> tuple[NDArray[np.float64], tuple[str, ...]]:
        return self.whole.table(name)

    def earlier(self) -> Iterator[Recorded]:
        return self.whole.earlier()

    def _called(self, name: str) -> str:
        return HIDDEN.format(name) if name in self.hidden else name

    def _renamed(self, samples: Samples) -> Samples:
        return replace(samples, channels=tuple(replace(c, name=self._called(c.name)) for c in samples.channels))
