"""Which recorder calibrates, and what of a calibration is read from the Sensor Cube's own frames.

The converter has the sensor's channels in one scan with the reference; the cube samples all of them at once, by a clock
of its own. Where both kept a record, either can be chosen, and the two must agree.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from rig.archive.records import Experiment, Recorded, Signals, signals
from rig.calibrate import gyros, resting
from rig.calibrate.allowances import in_runs
from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import Result
from rig.calibrate.resting import Resting
from rig.errors import BadInput
from rig.parts.reading.cube_frames import STEP, frames, rests, signals_of_frames, u_time_of
from rig.parts.reading.revolutions import Rotation
from rig.sensor import Sensor
from rig.signals import noise, steady_lines
from rig.signals.line import gls

Recorder = Literal["converter", "cube", "scope"]
RECORDERS: tuple[Recorder, ...] = ("converter", "cube", "scope")
SAID: Mapping[str, str] = {"cube": "recorded by the Sensor Cube itself", "scope": "sines recorded by the oscilloscope"}
SOURCE = "fit of the cube's clock, latency of its line"


def recorder_of(runs: Sequence[Recorded], sensor: Sensor, wanted: Recorder | None) -> Recorder:
    """The recorder that calibrates: the one asked for, else converter, oscilloscope, cube, whichever saw the sensor.

    Raises BadInput if the one asked for kept nothing of the sensor.
    """
    kept = {one for records in runs for one in _kept(records, sensor)}
    if wanted is not None and wanted not in kept:
        found = ", ".join(sorted(kept)) or "none"
        raise BadInput(
            f"{', '.join(r.name for r in runs)}: found no record of the sensor by the {wanted}, wanted one "
            f"(there is: {found})"
        )
    if wanted is not None:
        return wanted
    return next((one for one in ("converter", "scope", "cube") if one in kept), "converter")


def _kept(records: Recorded, sensor: Sensor) -> Iterator[Recorder]:
    """Recorders that kept some channel of the sensor."""
    cables: Mapping[str, Sequence[str]] = records.header["bench_file"]["cables"]
    for entry in records.lines:
        if entry.kind not in ("point", "step"):
            continue
        body = entry.body
        wired = cables.get("turntable" if "phase" in body else str(body.get("cables", "shaker")), ())
        if "samples" in body and any(name in sensor for name in wired):
            yield "converter"
        if "traces" in body:
            yield "scope"
        if "cube" in body:
            yield "cube"


def seen_by(records: Recorded, recorder: Recorder) -> Recorded:
    """The run as a choice of recorder has it: sines by the oscilloscope alone, if that is the choice."""
    if recorder != "scope":
        return records
    sines = {n: body for n, body in records.points.items() if "traces" in body}
    return Experiment(records, records.lines, {**records.points, **{n: _without(b) for n, b in sines.items()}})


def _without(body: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in body.items() if name != "samples"}


def said(results: Iterable[Result], recorder: Recorder) -> Iterator[Result]:
    """The results with their recorder in the method, where it is not the converter."""
    for one in results:
        at_once = recorder in SAID and one.determined
        yield replace(one, method=f"{one.method}; {SAID[recorder]}") if at_once else one


def at_rest(records: Recorded, body: Mapping[str, Any], recorder: Recorder) -> Signals | None:
    """A record at rest by the recorder; None if it kept none."""
    if recorder == "cube":
        return signals_of_frames(records, body) if "cube" in body else None
    return signals(records.samples(str(body["samples"]))) if "samples" in body else None


def noise_by_cube(
    runs: Sequence[Recorded], channels: Iterable[str], poles: Mapping[str, float]
) -> tuple[dict[str, Resting], dict[str, str]]:
    """Noise of each channel from the cube's longest record at rest; why a channel has none.

    Of a record with gaps, the longest stretch without one.
    """
    every = [(float(body["seconds"]), records, body) for records in runs for body in rests(records)]
    if not every:
        return {}, {}
    _, records, body = max(every, key=lambda one: one[0])
    seen, found, missing = frames(records, body), dict[str, Resting](), dict[str, str]()
    rate = seen.samples.rate
    for name in (one for one in channels if one in seen.names):
        clipped = seen.samples.clipped(name)
        try:
            if clipped:
                raise BadInput(f"clipped ({clipped} samples)")
            result, lines = steady_lines.lines_without(seen.samples.volts(name)[seen.whole], rate)
        except BadInput as error:
            missing[name] = f"{records.name}, record at rest: {error}"
            continue
        fitted = noise.fit_blocks(result, step=STEP, pole=poles.get(name))
        value, dof, reason = resting.deviation(result, fitted, STEP)
        block = str(body["cube"])
        found[name] = Resting(name, records.name, block, result.seconds, fitted, value, dof, reason, lines)
    return found, missing


def with_clock(
    results: Iterable[Result], rotations: Sequence[Rotation], noise_: Mapping[str, Resting], setup: gyros.Setup
) -> Iterator[Result]:
    """What the cube's clock does to results from the turntable: dV = S·α·dt in every block, and a lag outright."""
    u = u_time_of(rotations)
    for one in results:
        if u and one.budget is not None and one.measurand in ("sensitivity", "lag"):
            slope = 1.0 if one.measurand == "lag" else _slope(one, rotations, noise_[one.channel], setup)
            source = in_runs(SOURCE, [rotation.run for rotation in rotations])
            line = Contribution("clock between the recorders", "B", "normal", u, "s", slope, source=source)
            one = replace(one, budget=Budget((*one.contributions, line), one.budget.correlation))
        yield one


def _slope(result: Result, rotations: Sequence[Rotation], noise_: Resting, setup: gyros.Setup) -> float:
    """∂S/∂t: what the fit of rest and whole revolutions makes of S·α."""
    found = gyros.rows(rotations, result.channel, noise_, setup, ("rest", "hold"), 0)
    zeros = [(found.run == n).astype(float) for n in np.unique(found.run)]
    names = [*(f"zero {n}" for n in range(len(zeros))), "sensitivity"]
    solution = gls(np.column_stack([*zeros, found.rate]), found.acceleration, found.covariance, names)
    return float(result.value or 0.0) * float(solution.parameters[-1])
