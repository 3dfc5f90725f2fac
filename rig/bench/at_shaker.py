"""At the shaker: one sine point, the beam, and the filter that a person sets."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.bench.cube_record import joined
from rig.bench.station import A_PERSON, Station, pace_of
from rig.bench.steps import AlignBeam, SetFilter, Sine, filter_test_request, requests_of
from rig.errors import BadInput, SettingRefused, SignalLow, SignalOverload, VerdictNotMet
from rig.record import CubeSamples, Response, Samples, Traces
from rig.signals import tone

RISING, FAR = 600.0, 1.12  # Hz above which a constant holds no further than this ratio upwards
FIRST_APPROACH = 0.1  # share of the wanted drive where the drive constant is not known yet
CLOSE_ENOUGH = 0.05  # a level within 5 % of its target is not repeated
OVERSHOOT = 1.10  # measured motion beyond this times a limit stops the run
ANALYZER_SPAN = 1000.0  # Hz
ANALYZER_POINTS = 401  # 2.5 Hz apart, records of 0.4 s
ANALYZER_AVERAGES = 2
SCOPE_RECORD = 0.5  # s, ten divisions
SENSOR_REST = 1.65  # V; half the supply of a 2 g unit
CLOCK_OFF = 5e-3  # relative: more than any clock that runs
BESIDE = 2.0  # cycles over a record that a tone is looked for beside its nominal frequency
ON_FREQUENCY = 0.05  # cycles: less costs no more than 0.4 % of the amplitude
INPUTS = ("input 1", "input 2")
WIDER = 1.1  # of a range, for the next one: they are 2 dB apart
SENSOR_INPUT = 4.0  # V; half the supply plus the signal of a 2 g unit, DC coupled


@dataclass(frozen=True)
class Captured:
    """What each recorder kept of one sine point; None from those that keep nothing."""

    samples: Samples | None
    response: Response | None
    traces: Traces | None
    cube: CubeSamples | None


def prepare(station: Station) -> None:
    """Put the analyzer into its two-channel state and the converter at its rate; nothing is energised."""
    station.analyzer.preset()
    station.analyzer.configure(span=ANALYZER_SPAN, points=ANALYZER_POINTS, averages=ANALYZER_AVERAGES)
    station.sensor_range = station.analyzer.set_range(2, SENSOR_INPUT)
    if station.keeps("scope"):
        sensor = (4.0, SENSOR_REST)
        station.scope.configure(duration=SCOPE_RECORD, ranges=[(20.0, 0.0), sensor, sensor, sensor])


def sine(step: Sine, station: Station) -> dict[str, Any]:
    """One frequency at one level; returns the body of the point's journal line.

    Raises SignalOverload or SignalLow if the reference cannot be trusted, VerdictNotMet if the motion passes a limit.
    """
    omega = 2.0 * math.pi * step.frequency
    if station.keeps("recorder") and station.wired != station.channels():
        station.wire()  # the procedure before was on the other cable set, and this one began without a record at rest
    approach = _unknown(step.frequency, station.drive.constants)
    for attempt in range(3):
        wanted = step.acceleration / omega**2 / station.drive.constant(step.frequency)
        share = FIRST_APPROACH if approach and attempt == 0 else 1.0
        body = _record(step, station, wanted * share)
        reached = body["acceleration"] / step.acceleration
        station.drive.constants[step.frequency] = body["drive_constant"]
        _refuse_excess(step, station, body)
        if share == 1.0 and (step.hold == "drive" or abs(reached - 1.0) <= CLOSE_ENOUGH):
            return body
        station.journal.note("approach", label=step.label, attempt=attempt, reached=reached, source=body["source"])
    raise VerdictNotMet(
        f"{step.label}: found {reached:.1%} of the level after 3 attempts, wanted within {CLOSE_ENOUGH:.0%}"
    )


def _unknown(frequency: float, constants: Mapping[float, float]) -> bool:
    """Whether the drive constant there must first be felt out: nothing is known, or only far below a high frequency.

    Towards the stack's resonance the stroke rises, so that a constant from far below would overshoot.
    """
    if not constants:
        return True
    return frequency > RISING and frequency > FAR * max(constants)


def rest(station: Station) -> None:
    """Switch the drive off, if it is on."""
    if station.drive.on:
        station.analyzer.output(False)
        station.drive.on = False


def _record(step: Sine, station: Station, amplitude: float) -> dict[str, Any]:
    velocity = step.acceleration / (2.0 * math.pi * step.frequency)
    with station.watch("instruments"):
        scale = station.vibrometer.set_range_for(1.3 * velocity)
        # at most 7.4 V of the 7.9 V that input 1 takes
        ranges = {1: station.analyzer.set_range(1, 1.2 * velocity / scale), 2: station.sensor_range}
        _move(station, step.frequency, amplitude)
        station.room.clock.sleep(step.settle)
        station.vibrometer.check(require=False)  # the over-range latch may hold what the change of drive did
        before = _trusted(station)
        captured = _in_range(step, station, ranges)
        after = _trusted(station)
    with station.watch("analysis"):
        volts = _reference_volts(step, captured, station.description.wires.reference)
    return {
        "frequency": step.frequency,
        "level": step.level,
        "hold": step.hold,
        "target": step.target,
        "axis": step.axis,
        "source": amplitude,
        "scale": scale,
        "optical_level": [before.level, after.level],
        "velocity": volts * scale,
        "acceleration": volts * scale * 2.0 * math.pi * step.frequency,
        "drive_constant": volts * scale / (2.0 * math.pi * step.frequency) / amplitude,
        **_stored(step, station, captured),
    }


def _move(station: Station, frequency: float, amplitude: float) -> None:
    """Change the sine so that the acceleration never passes the larger of the old and the new one.

    a grows with f² at constant drive, so the drive goes down before and up after the frequency changes.
    """
    drive, analyzer = station.drive, station.analyzer
    if drive.on and amplitude < drive.amplitude:
        analyzer.set_sine(drive.frequency, amplitude)
    elif drive.on:
        analyzer.set_sine(frequency, drive.amplitude)
    analyzer.set_sine(frequency, amplitude)
    if not drive.on:
        analyzer.output(True)
    drive.frequency, drive.amplitude, drive.on = frequency, amplitude, True


def _in_range(step: Sine, station: Station, ranges: dict[int, float]) -> Captured:
    """The point with all inputs of the analyzer in range; `ranges` by input, V peak, are those that are set.

    An input that is overloaded gets its next wider range and everything is recorded again: the analyzer's own autorange
    steps up in the same way, but only while nothing is measured. The sensor's input keeps the range that it needed.
    Raises SignalOverload if no range is wide enough.
    """
    while True:
        captured = _acquire(step, station)
        overloads = () if captured.response is None else captured.response.overloads
        if not overloads:
            station.sensor_range = ranges[2]
            return captured
        station.journal.note("overload", label=step.label, overloads=list(overloads), ranges=list(ranges.values()))
        for channel in ranges:
            if f"input {channel}" in overloads:
                ranges[channel] = _wider(step, station, channel, ranges[channel])
        if any(name not in INPUTS for name in overloads):  # a relay that tripped is for a person to look at
            raise _overloaded(step, overloads)


def _wider(step: Sine, station: Station, channel: int, volts: float) -> float:
    """The next range of an input above this one, V peak."""
    try:
        return station.analyzer.set_range(channel, WIDER * volts)
    except SettingRefused as refused:
        raise _overloaded(step, (f"input {channel}",), f" of {volts:.3g} V, the widest") from refused


def _overloaded(step: Sine, overloads: Sequence[str], widest: str = "") -> SignalOverload:
    found = f"{', '.join(overloads)} over range{widest}"
    return SignalOverload("analyzer", step.label, wanted="inputs in range", received=found)


def _acquire(step: Sine, station: Station) -> Captured:
    """Every recorder that keeps data looks at the same stretch of motion; the oscilloscope at the stretch after it."""
    samples = response = None
    cube: CubeSamples | None = None
    if station.keeps("cube"):
        station.cube.configure()
        station.cube.start()
    if station.keeps("recorder"):
        station.recorder.start(step.scans)
    if station.keeps("analyzer"):
        station.analyzer.start_measurement()
        response = station.analyzer.finish_measurement()
    _trusted(station)
    seconds = step.scans / station.description.file.rate
    if station.keeps("cube"):  # in two pieces: a line holds about a second
        cube = station.cube.read(0.5 * seconds)
    if station.keeps("recorder"):
        samples = station.read(step.scans)
    if cube is not None:
        cube = joined(cube, station.cube.read(0.5 * seconds))
        station.cube.stop()
    traces = station.scope.capture() if station.keeps("scope") else None
    return Captured(samples, response, traces, cube)


def _trusted(station: Station) -> Any:
    """The vibrometer's own judgement, required to be good."""
    return station.vibrometer.check(require=True)


def _reference_volts(step: Sine, captured: Captured, name: str) -> float:
    """Amplitude of the reference channel at the driven frequency, V."""
    samples, traces = captured.samples, captured.traces
    if samples is not None:
        return _amplitude(samples.instants(name), samples.volts(name), step.frequency)
    if traces is not None:
        return _amplitude(traces.instants(), traces.volts[traces.names.index(name)], step.frequency)
    raise VerdictNotMet(f"{step.label}: found no record of the reference, wanted the converter or the oscilloscope")


def _amplitude(instants: NDArray[np.float64], volts: NDArray[np.float64], frequency: float) -> float:
    """Peak value of a tone that lies beside its nominal frequency if the recorder's clock is off, V.

    A sine fitted half a cycle beside the tone shows two thirds of it: the level would be driven up, past the limits.
    """
    span = float(np.ptp(instants))
    most = min(BESIDE, CLOCK_OFF * frequency * span)
    aside = [frequency + share / span for share in np.arange(-BESIDE, BESIDE + 0.1, 0.25) if abs(share) <= most]
    near = max((tone.fit_three(instants, volts, f) for f in aside), key=lambda one: one.magnitude)
    try:
        free = tone.fit_four(instants, volts, near.frequency)
    except BadInput:  # no tone that stands above the noise
        return near.magnitude
    if abs(free.frequency - frequency) * span < ON_FREQUENCY:
        return tone.fit_three(instants, volts, frequency).magnitude
    return free.magnitude


def _stored(step: Sine, station: Station, captured: Captured) -> dict[str, Any]:
    body: dict[str, Any] = {}
    name = station.block_name(step.label)
    samples, response, traces = captured.samples, captured.response, captured.traces
    if samples is not None:
        body["samples"] = station.store(name, samples).name
        body |= pace_of(samples)
        body["conditions"] = station.conditions(samples)
        body["clipped"] = {c.name: n for c in samples.channels if (n := samples.clipped(c.name))}
    if captured.cube is not None:
        body |= station.store_cube(name, captured.cube)
    with station.storing():
        if response is not None:
            block = station.journal.block(f"{name}-response", _columns(response), response_meta(response))
            body["response"] = block.name
        if traces is not None:
            body["traces"] = station.journal.block(f"{name}-traces", traces.volts, traces_meta(traces)).name
    return body


def _columns(response: Response) -> np.ndarray[Any, np.dtype[np.float64]]:
    coherence = np.full(len(response.frequency), np.nan) if response.coherence is None else response.coherence
    return np.column_stack([response.frequency, response.ratio.real, response.ratio.imag, coherence])


def response_meta(response: Response) -> dict[str, Any]:
    return {
        "kind": "response",
        "columns": ["frequency", "real", "imaginary", "coherence"],
        "averages": response.averages,
        "overloads": list(response.overloads),
    }


def traces_meta(traces: Traces) -> dict[str, Any]:
    return {
        "kind": "traces",
        "names": list(traces.names),
        "start": traces.start,
        "interval": traces.interval,
        "clipped": list(traces.clipped),
    }


def _refuse_excess(step: Sine, station: Station, body: dict[str, Any]) -> None:
    limits = station.description.file.limits
    stroke = body["velocity"] / (2.0 * math.pi * step.frequency)
    for name, value, limit in (
        ("acceleration", body["acceleration"], limits.acceleration),
        ("stroke", stroke, limits.stroke),
        ("velocity", body["velocity"], limits.velocity),
    ):
        if value > limit * OVERSHOOT:
            rest(station)
            raise VerdictNotMet(
                f"{step.label}: found {name} {value:.4g} (SI), wanted at most {limit:.4g}; the drive is off"
            )


def align(step: AlignBeam, station: Station) -> dict[str, Any]:
    """The operator aligns the beam; the level is judged afterwards."""
    for request in requests_of(step):
        station.ask(request)
    check = station.vibrometer.check(require=False)
    if check.level < 5:
        raise SignalLow("vibrometer", step.label, received=f"level {check.level}", wanted="at least 5 of 40 bars")
    return {"optical_level": check.level}


def set_filter(step: SetFilter, station: Station) -> dict[str, Any]:
    """The operator sets the filter, and its response at three frequencies says what it really is."""
    station.guard.expect(A_PERSON)  # a person turns the knobs; nothing is energised yet
    confirmation = station.filter.configure(
        mode=step.mode, cutoff=step.cutoff, response=step.response, gain_db=step.gain_db
    )
    station.journal.note(
        "confirmed",
        action="set_filter",
        who=confirmation.who,
        when=confirmation.when,
        said=confirmation.said,
        settings=dict(confirmation.request.settings),
        text=confirmation.request.text,
    )
    if step.verify:
        station.ask(filter_test_request(on=True))
        try:
            verified = station.filter.verify(lambda frequency: _measured_response(frequency, station))
        finally:
            rest(station)
            station.ask(filter_test_request(on=False))
        station.journal.note("filter_verified", result=str(verified))
    return {"filter": station.filter.settings()}


def _measured_response(frequency: float, station: Station) -> complex:
    """The complex response from input 1 to input 2 at one frequency, with the analyzer's own source."""
    analyzer, drive = station.analyzer, station.drive
    span = max(1000.0, 2.0 * frequency)
    analyzer.configure(span=span, points=ANALYZER_POINTS, averages=ANALYZER_AVERAGES)
    analyzer.set_range(1, 2.0)
    analyzer.set_range(2, 2.0)
    # A whole number of analyzer bins, so that the line falls on one.
    resolution = span / (ANALYZER_POINTS - 1)
    on_bin = round(frequency / resolution) * resolution
    analyzer.set_sine(on_bin, 0.5)
    if not drive.on:
        analyzer.output(True)
        drive.on = True
    drive.frequency, drive.amplitude = on_bin, 0.5
    station.room.clock.sleep(0.3)
    analyzer.start_measurement()
    return analyzer.finish_measurement().at(on_bin)
