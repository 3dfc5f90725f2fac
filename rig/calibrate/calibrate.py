"""From runs to a calibration: sweeps, turntable runs, tumbles and records at rest of one unit, merged.

Each kind of run contributes what it can determine; what no run determines is in the calibration too, with the run that
would. Runs of different units or benches are refused.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig import units
from rig.archive.records import Recorded, experiments, mounts, reference, wires_of
from rig.calibrate import accelerometers, agreement, gyros, imported, paper_method, resting, tumbling
from rig.calibrate.accelerometers import SENSITIVITY, ChannelFit
from rig.calibrate.analyzer_route import SecondRoute, second_route
from rig.calibrate.budget import Budget, Contribution, half_width
from rig.calibrate.calibration import Calibration, PaperRow, ResponsePoint, Result, Source, not_determined
from rig.calibrate.cube_route import SAID, Recorder, at_rest, noise_by_cube, recorder_of, said, seen_by, with_clock
from rig.calibrate.fitted import Assumed, Experiment
from rig.calibrate.fitted import experiments as experiments_fitted
from rig.calibrate.joined import DirectEstimate, joined, of_model
from rig.calibrate.resting import Resting
from rig.calibrate.verdict import verdict
from rig.errors import BadInput
from rig.fit.evidence import evidence_of
from rig.foreign.tables import is_foreign
from rig.parts.reading.cube_frames import points_by_cube, rotation_by_cube
from rig.parts.reading.revolutions import Rotation, rotation_of
from rig.parts.reading.vibration import Chain, SinePoint, chain_of, sine_points, wrong_axis
from rig.sensor import ROTATIONS, Sensor, SensorChannel, SheetNoise
from rig.signals.noise import coefficients

UP = {"x": 1, "y": 2, "z": 0}  # cube axis that is up while this one is driven
DEVIATION = "deviation at rest, 1/30 Hz to half the sampling rate"
_DATA_SHEET = Assumed()
RANDOM_WALK = {"acceleration": "(m/s²)·√Hz", "rate": "(rad/s)·√Hz"}


@dataclass(frozen=True)
class Alignment:
    """Declared limits: beam and mount angles, rad; radius, m."""

    beam: float
    mount: float
    radius: float
    declared: bool


def alignment_of(runs: Sequence[Recorded]) -> Alignment:
    """The widest limits of the runs' bench files; zero and marked as not declared if one of them has none."""
    stated = [records.header["bench_file"].get("alignment") for records in runs]
    if not all(stated):
        return Alignment(0.0, 0.0, 0.0, False)
    beam, mount, radius = (
        max(units.parse(one[name], kind) for one in stated)
        for name, kind in (("beam", "angle"), ("mount", "angle"), ("radius", "length"))
    )
    return Alignment(beam, mount, radius, True)


def calibrate(
    runs: Sequence[Recorded],
    name: str,
    digests: Mapping[str, str] | None = None,
    assumed: Assumed | None = _DATA_SHEET,
    recorder: Recorder | None = None,
) -> Calibration:
    """One calibration from all runs of a unit; `digests` are SHA-256 of the seals by run.

    Values stand on the model `assumed`, fitted to all records of an experiment, with the direct estimates beside them;
    without a model (None) they are the direct estimates. `recorder` is the one to read the sensor from (None: the
    converter, else the oscilloscope, else the cube); a model reads the converter's records alone.

    Raises BadInput for runs of different units, a sweep of the wrong axis or without its reference, and for runs that
    determine nothing; StandardOverdue for a standard used past its date without an order.
    """
    if _imported(runs):
        return imported.calibration(runs, name, _sources(runs, digests), assumed or _DATA_SHEET)
    header = _common_header(runs)
    sensor = Sensor.of(header)
    bench = _bench_of(runs, header, recorder_of(runs, sensor, recorder))
    shaken = _Shaken(bench)
    turned = _Turned(bench)
    assumed = assumed if bench.recorder == "converter" else None
    results, unfitted = _on_model(runs, shaken, turned, assumed)
    results += [*bench.noise_results(list(results), shaken, turned), *_tumble_results(bench)]
    results = list(said(results, bench.recorder))
    _refuse_nothing(runs, results)
    second = second_route(bench.runs, sensor, shaken.setup())
    if second is not None:
        results += second.results(results)
    return Calibration(
        name=name,
        sensor=sensor.name,
        serial=sensor.serial,
        made=max(entry.t for records in runs for entry in records.lines),
        simulated=any(records.header["simulated"] for records in runs),
        sources=_sources(runs, digests),
        standards=tuple(header["standards"]),
        conditions=resting.conditions_of(runs),
        results=tuple(_judged(_ordered(results, sensor), sensor)),
        responses=shaken.responses(),
        analyzer={} if second is None else second.responses(),
        paper=tuple(_paper(shaken, bench)),
        overdue=tuple(dict.fromkeys(late for records in runs for late in records.header["overdue_overridden"])),
        flags=tuple(dict.fromkeys([*unfitted, *_flags(bench, shaken, turned, second)])),
        program={key: str(value) for key, value in header["program"].items()},
        unit=header["sensor"],
        model="" if assumed is None else assumed.said,
    )


def _on_model(
    runs: Sequence[Recorded], shaken: _Shaken, turned: _Turned, assumed: Assumed | None
) -> tuple[list[Result], tuple[str, ...]]:
    """Results of sweeps and turntable runs, on the fitted model if one is assumed; and why none was fitted."""
    results = [*shaken.results(), *turned.results()]
    if assumed is None:
        return results, ()
    fits, unfitted = _fitted(runs, assumed)
    direct = {one.key: one for one in (*shaken.direct(), *turned.direct())}
    results = [joined(r, direct[r.key], fits, assumed) if r.key in direct else r for r in results]
    return [*results, *of_model(fits, assumed)], unfitted


def _fitted(runs: Sequence[Recorded], assumed: Assumed) -> tuple[dict[str, Experiment], tuple[str, ...]]:
    """The model fitted to each experiment; nothing, and why, for runs that no model can be compared with."""
    moved = [run for run in runs if any("frequency" in b or "phase" in b for b in run.points.values())]
    if not moved:
        return {}, ()
    try:
        return experiments_fitted(evidence_of(moved), assumed), ()
    except BadInput as error:
        return {}, (f"no model was fitted, values are the direct estimates: {error}",)


def _refuse_nothing(runs: Sequence[Recorded], results: Iterable[Result]) -> None:
    if not any(r.determined for r in results):
        raise BadInput(f"{', '.join(r.name for r in runs)}: found nothing that determines a value, wanted a sweep, "
                       "a turntable run, a tumble or a noise record")  # fmt: skip


def _flags(bench: _Bench, shaken: _Shaken, turned: _Turned, second: SecondRoute | None) -> Iterator[str]:
    yield from bench.flags()
    yield from shaken.flags()
    yield from turned.flags()
    if second is not None:
        yield from second.flags()


def _paper(shaken: _Shaken, bench: _Bench) -> Iterator[PaperRow]:
    """The published estimators, which read the converter."""
    if bench.recorder == "cube":
        return
    yield from paper_method.accelerometer_rows(shaken.everything(), bench.sensor, bench.runs)
    for one in bench.runs:
        yield from paper_method.gyro_rows(one, bench.sensor)


def _bench_of(runs: Sequence[Recorded], header: Mapping[str, Any], recorder: Recorder) -> _Bench:
    """What was measured, as the recorder that calibrates has it, with the noise that it saw at rest."""
    sensor = Sensor.of(header)
    poles = {channel.name: channel.bandwidth for channel in sensor.channels}
    done = [seen_by(one, recorder) for records in runs for one in experiments(records)]
    noise_of = noise_by_cube if recorder == "cube" else resting.noise_of
    return _Bench(done, header, sensor, alignment_of(runs), *noise_of(done, sensor.names, poles), recorder)


def _imported(runs: Sequence[Recorded]) -> bool:
    """Whether the runs are imported ones; BadInput for some that are and some that are not."""
    foreign, own = [[run.name for run in runs if is_foreign(run) == kind] for kind in (True, False)]
    if foreign and own:  # values of the one are ratios to what a manifest states, of the other volts per SI
        raise BadInput(
            f"{foreign[0]}: found imported data beside {own[0]}, which a bench recorded in volts, wanted either alone: "
            "ratios to what a manifest states and volts per m/s² are not one measurand"
        )
    return bool(foreign)


def _common_header(runs: Sequence[Recorded]) -> Mapping[str, Any]:
    if not runs:
        raise BadInput("calibrate: found no run, wanted at least one")
    first = runs[0].header
    for records in runs[1:]:
        for key in ("sensor", "standards", "simulated"):
            if records.header[key] != first[key]:
                raise BadInput(f"{records.name}: found another {key} than in {runs[0].name}, wanted runs of one unit "
                               "on one bench")  # fmt: skip
    return first


def _sources(runs: Sequence[Recorded], digests: Mapping[str, str] | None) -> tuple[Source, ...]:
    return tuple(
        Source(
            records.name, str(records.header.get("procedure") or records.header["title"]), records.status,
            (digests or {}).get(records.name, ""), float(records.header["started"]),
        )
        for records in runs
    )  # fmt: skip


@dataclass(frozen=True)
class _Bench:
    """What every part of a calibration looks up; `runs` are single experiments, those of a sequence taken apart."""

    runs: Sequence[Recorded]
    header: Mapping[str, Any]
    sensor: Sensor
    alignment: Alignment
    noise: Mapping[str, Resting]
    without_noise: Mapping[str, str]
    recorder: Recorder = "converter"

    @property
    def temperature(self) -> tuple[float, float, float] | None:
        return resting.conditions_of(self.runs).get("temperature")

    def flags(self) -> Iterator[str]:
        if self.recorder != "converter":
            yield f"{SAID[self.recorder]}: values are direct estimates, a model reads the converter alone"
        if not self.alignment.declared:
            yield "no `alignment` in the bench file of every run: the budgets contain no misalignment"
        for records in self.runs:
            if records.status != "completed":
                yield f"{records.name} is {records.status}: not every point of it was measured"

    def noise_results(self, sensitivities: Iterable[Result], shaken: _Shaken, turned: _Turned) -> Iterator[Result]:
        """Noise referred to the input by each channel's own sensitivity, or the data sheet's if it has none."""
        own = {r.channel: r for r in sensitivities if r.measurand == "sensitivity" and r.value is not None}
        for name, noise in self.noise.items():
            channel = self.sensor.channel(name)
            yield from _noise_of(channel, noise, scale_of(channel, own.get(name)))
        for name, why in self.without_noise.items():
            yield not_determined(name, "deviation", DEVIATION, self.sensor.channel(name).unit, why)
        scales = {n: scale_of(self.sensor.channel(n), r) for n, r in own.items()}
        yield from turned.noise_in_motion(scales)
        yield from shaken.noise_in_motion(scales)


@dataclass(frozen=True)
class Scale:
    """What turns volts of noise into the sensed quantity: sensitivity (SI) and its line in the budget, per unit."""

    sensitivity: float
    line: Contribution | None
    remarks: tuple[str, ...]
    reference: str

    def result(
        self, sensor: SensorChannel, measurand: str, title: str, unit: str, volts: float, u: float, how: str
    ) -> Result:
        """A noise quantity in V (or V/√Hz …) with standard uncertainty `u`, referred to the input."""
        value = volts / abs(self.sensitivity)
        lines = [Contribution("estimate of the spectrum", "A", "normal", u / abs(self.sensitivity), unit, 1.0)]
        if self.line is not None:
            lines.append(replace(self.line, sensitivity=value))
        return Result(
            sensor.name, measurand, title, value, unit, Budget(tuple(lines)), how, self.reference, remarks=self.remarks
        )


def scale_of(sensor: SensorChannel, own: Result | None) -> Scale:
    """The channel's own sensitivity if these runs determine it, else the data sheet's within its tolerance."""
    if own is not None and own.value is not None:
        known = Contribution("sensitivity", "B", "normal", own.u / abs(own.value), "1", 1.0, source=own.reference)
        return Scale(own.value, known, (), "own sensitivity")
    remarks = ["by the data sheet's sensitivity"]
    line: Contribution | None = None
    if sensor.tolerance is None:
        remarks.append("its tolerance is not declared and not in the budget")
    else:
        line = Contribution("sensitivity", "B", "rectangular", half_width(sensor.tolerance, "rectangular"), "1", 1.0,
                            source="data sheet")  # fmt: skip
    return Scale(sensor.nominal, line, tuple(remarks), "data sheet's sensitivity")


def _noise_of(sensor: SensorChannel, noise: Resting, by: Scale) -> Iterator[Result]:
    how = f"record of {noise.seconds:.4g} s at rest ({noise.run})"
    title = DEVIATION
    if noise.deviation is None:
        yield not_determined(sensor.name, "deviation", title, sensor.unit, noise.reason)
    else:
        yield by.result(
            sensor, "deviation", title, sensor.unit, noise.deviation, _u_deviation(noise.deviation, noise.dof), how
        )
    found = coefficients(noise.fit)
    for measurand, key, title, unit in (
        ("noise_density", "N", "noise density at low frequency, N (two-sided root)", f"({sensor.unit})/√Hz"),
        ("bias_instability", "B", "bias instability, B", sensor.unit),
        ("random_walk", "K", "random walk of the output, K", RANDOM_WALK[sensor.quantity]),
    ):
        one = found[key]
        if one.value is None or one.u is None:
            yield not_determined(sensor.name, measurand, title, unit, one.reason)
        else:
            result = by.result(sensor, measurand, title, unit, one.value, one.u, how)
            yield _beside_sheet(result, sensor.noise) if key == "N" else result
    yield _bandwidth(sensor, noise, how)


def _beside_sheet(result: Result, sheet: SheetNoise | None) -> Result:
    """A measured N with what the data sheet says of it; a sheet's density is one-sided, √2·N."""
    if sheet is None or result.value is None:
        return result
    kind = f"{'rate' if 'rad' in result.unit else 'acceleration'}_density"
    ratio = math.sqrt(2.0) * result.value / sheet.density
    inside = abs(ratio - 1.0) <= sheet.tolerance + math.sqrt(2.0) * result.expanded / sheet.density
    said = (
        f"√2·N is {ratio:.3g} of the data sheet's {units.format_quantity(sheet.density, kind)}: "
        f"{'within' if inside else 'outside'} its ± {units.format_quantity(sheet.tolerance, 'ratio', unit='%')}"
    )
    return replace(result, remarks=(*result.remarks, said))


def _u_deviation(value: float, dof: float) -> float:
    """Standard uncertainty of a standard deviation from the degrees of freedom of its square."""
    return value / math.sqrt(2.0 * max(dof, 1.0))


def _bandwidth(sensor: SensorChannel, noise: Resting, how: str) -> Result:
    title = "noise bandwidth of the white noise, π/2 of the corner"
    if "pole" in noise.fit.refused or not math.isfinite(noise.fit.model.pole):
        why = noise.fit.refused.get("pole", "no corner in the spectrum")
        return not_determined(sensor.name, "noise_bandwidth", title, "Hz", why)
    factor = math.pi / 2.0
    line = Contribution("estimate of the spectrum", "A", "normal", noise.fit.u["pole"], "Hz", factor)
    value = factor * noise.fit.model.pole
    return Result(sensor.name, "noise_bandwidth", title, value, "Hz", Budget((line,)), how, "time base")


class _Shaken:
    """Everything from the shaker."""

    def __init__(self, bench: _Bench) -> None:
        self._bench = bench
        self.points: list[list[SinePoint]] = []  # of every sweep, each a mounting
        self._fits: dict[str, list[ChannelFit]] = {}
        self._whole: dict[str, ChannelFit] = {}
        self._unusable: dict[str, str] = {}
        self._chain: Chain | None = None
        for records in bench.runs:
            if any("frequency" in body for body in records.points.values()):
                chain = chain_of(records)
                if self._chain is None or chain.u_cutoff > self._chain.u_cutoff:
                    self._chain = chain  # standards are common to all runs; of their filters the least sure one counts
                points = sine_points(records, chain)
                points = points_by_cube(records, points, bench.sensor) if bench.recorder == "cube" else points
                self.points += [points] if points else []
        self._refuse_wrong_axis()
        self._fit()

    def _refuse_wrong_axis(self) -> None:
        axes = {c.name: c.axis for c in self._bench.sensor.channels if not c.is_rate}
        for group in self.points:
            moved = wrong_axis(group, axes)
            if moved is not None:
                raise BadInput(f"{group[0].run}: found the motion along {moved}, wanted it along {group[0].axis}: "
                               "the cube stands on another face than the run says")  # fmt: skip

    def _fit(self) -> None:
        chain = self._chain
        if chain is None:
            return
        for group in self.points:
            for sensor in self._bench.sensor.along(group[0].axis):
                if any(sensor.name in point.lines for point in group):
                    self._fit_mounting(group, sensor, chain)
        for name, several in self._fits.items():
            sensor = self._bench.sensor.channel(name)
            merged = several[0]
            if len(several) > 1:
                whole = accelerometers.observed(self._points_of(sensor.axis), name)
                merged = accelerometers.fit_channel(whole, name, chain, sensor.bandwidth)
            self._whole[name] = merged

    def _fit_mounting(self, group: Sequence[SinePoint], sensor: SensorChannel, chain: Chain) -> None:
        """One channel in one mounting; a channel without usable points does not take the others with it."""
        try:
            seen = accelerometers.observed(group, sensor.name)
        except BadInput as error:
            self._unusable[sensor.name] = f"{group[0].run}: {error}"
            return
        fit = accelerometers.fit_channel(seen, sensor.name, chain, sensor.bandwidth)
        self._fits.setdefault(sensor.name, []).append(fit)

    def _points_of(self, axis: str) -> list[SinePoint]:
        return [point for point in self.everything() if point.axis == axis]

    def everything(self) -> list[SinePoint]:
        """All points of all runs."""
        return [point for group in self.points for point in group]

    def setup(self) -> accelerometers.Setup | None:
        """What the budgets need beside the points; None without a sweep."""
        limits = self._bench.alignment
        if self._chain is None:
            return None
        return accelerometers.Setup(self._chain, limits.beam, limits.mount, self._bench.temperature)

    def results(self) -> Iterator[Result]:
        bench, chain, setup = self._bench, self._chain, self.setup()
        if chain is None or setup is None:
            return
        remount = accelerometers.remount_of(self._fits)
        for name in [one for one in self._unusable if one not in self._whole]:
            yield not_determined(name, "sensitivity", "sensitivity at low frequency", SENSITIVITY, self._unusable[name])
        for name, fit in self._whole.items():
            sensor = bench.sensor.channel(name)
            yield accelerometers.sensitivity_result(fit, setup, remount, sensor.drift)
            yield accelerometers.pole_result(fit)
            yield accelerometers.curvature_result(fit.seen, name, chain, sensor.bandwidth)
            for driven in "xyz":
                points = self._points_of(driven)
                if driven != sensor.axis and points:
                    yield accelerometers.cross_axis_result(points, name, driven, fit)
        yield from self._offsets()

    def noise_in_motion(self, scales: Mapping[str, Scale]) -> Iterator[Result]:
        """Of every driven channel."""
        for name in self._whole:
            if name in scales:
                sensor = self._bench.sensor.channel(name)
                refer = partial(scales[name].result, sensor)
                yield accelerometers.motion_noise_result(self._points_of(sensor.axis), name, sensor.unit, refer)

    def _offsets(self) -> Iterator[Result]:
        """Zero output from the records at rest in which the axis was horizontal."""
        title = "zero output"
        for name in self._whole:
            sensor = self._bench.sensor.channel(name)
            found = self._mean_at_rest(sensor)
            if found is None:
                why = "no record at rest with this axis horizontal: `static` of a sweep along another axis, or a tumble"
                yield not_determined(name, "offset", title, "V", why)
            else:
                yield self._offset(sensor, found)

    def _mean_at_rest(self, sensor: SensorChannel) -> _AtRest | None:
        """Generalised least-squares mean: records that wander together are not counted as independent."""
        runs, by = self._bench.runs, self._bench.recorder
        found = [r for records in runs for r in _level_rests(records, sensor, by)]
        if not found or sensor.name not in self._bench.noise:
            return None
        begin, end, volts = (np.array(column) for column in zip(*found, strict=True))
        weights, u = weights_of(self._bench.noise[sensor.name].slow.covariance(begin, end))
        return _AtRest(begin, end, weights, float(weights @ volts), u)

    def _offset(self, sensor: SensorChannel, found: _AtRest) -> Result:
        noise, value, u = self._bench.noise[sensor.name], found.value, found.u
        tilt = abs(self._whole[sensor.name].sensitivity) * 9.80665 * math.sin(self._bench.alignment.mount)
        lines = (
            Contribution("noise and wandering", "A", "normal", u, "V", 1.0, gyros.dof_of(noise)),
            Contribution("tilt of the mounting", "B", "rectangular", tilt / math.sqrt(3.0), "V", 1.0,
                         source="declared limit"),
        )  # fmt: skip
        method = f"mean of {len(found.weights)} records at rest, axis horizontal"
        return Result(sensor.name, "offset", "zero output", value, "V", Budget(lines), method, "plumb line")

    def responses(self) -> dict[str, tuple[ResponsePoint, ...]]:
        if self._chain is None:
            return {}
        axes = {name: self._bench.sensor.channel(name).axis for name in self._whole}
        return {
            name: accelerometers.response_table(self._points_of(axes[name]), fit, self._chain)
            for name, fit in self._whole.items()
        }

    def direct(self) -> Iterator[DirectEstimate]:
        """What the direct estimators say, to be held against the fit."""
        for name, fit in self._whole.items():
            for measurand, parameter, value in (
                ("sensitivity", "log_sensitivity", fit.sensitivity), ("bandwidth", "log_pole", fit.pole),
            ):  # fmt: skip
                u = abs(value) * fit.adjustment.u_noise(parameter)
                yield DirectEstimate(f"{name}.{measurand}", "shaker", value, u, agreement.of_response(fit, parameter))
            level = self._mean_at_rest(self._bench.sensor.channel(name))
            if level is not None:
                change = agreement.of_means(level.begin, level.end, level.weights)
                yield DirectEstimate(f"{name}.offset", "shaker", level.value, level.u, change)

    def flags(self) -> Iterator[str]:
        for group in self.points:
            for point in group:
                for flag in (*point.flags, *(f"{n} {f}" for n, one in point.lines.items() for f in one.flags)):
                    yield f"{point.run}, {point.frequency:.4g} Hz {point.level}: {flag}; the point was left out"


@dataclass(frozen=True)
class _AtRest:
    """A weighted mean of records at rest between `begin` and `end` (bench clock, s), V."""

    begin: NDArray[np.float64]
    end: NDArray[np.float64]
    weights: NDArray[np.float64]
    value: float
    u: float


def weights_of(covariance: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Weights of the best mean of correlated values, and its standard uncertainty."""
    weights = np.linalg.pinv(covariance, hermitian=True).sum(axis=0)
    total = float(weights.sum())
    return np.asarray(weights / total), total**-0.5


def _level_rests(records: Recorded, sensor: SensorChannel, by: Recorder) -> Iterator[tuple[float, float, float]]:
    """Begin, end (bench clock, s) and mean volts of every record at rest on the shaker with this axis horizontal."""
    for entry, mount in mounts(records):
        body = entry.body
        if (
            entry.kind not in ("point", "step")
            or mount is None
            or mount["place"] != "shaker"
            or not str(body.get("purpose", "")).startswith("static_")
            or "xyz"[UP[str(mount["axis"])]] == sensor.axis
        ):
            continue
        found = at_rest(records, body, by)
        if found is not None and sensor.name in found.names and not found.clipped.get(sensor.name):
            start = float(body.get("start", found.start))
            yield start, start + float(body["seconds"]), float(found.of(sensor.name).mean())


class _Turned:
    """Everything from the turntable."""

    def __init__(self, bench: _Bench) -> None:
        self._bench = bench
        self._rotations: dict[str, list[Rotation]] = {}
        self._fits: dict[str, gyros.GyroFit] = {}
        self._unusable: dict[str, str] = {}
        self._setup: gyros.Setup | None = None
        for records in bench.runs:
            phases = {body["phase"] for body in records.points.values() if "phase" in body}
            if phases and ("hold" in phases or records.status == "completed"):  # an interrupted one may not have held
                self._setup = self._setup or self._made(records)
                wired, supply = records.header["bench_file"]["cables"]["turntable"], wires_of(records).supply
                channels = [c for c in wired if c in bench.sensor or c == supply]
                by_cube = bench.recorder == "cube"
                rotation = rotation_of(records, [] if by_cube else channels, bench.sensor)
                rotation = rotation_by_cube(records, rotation, bench.sensor) if by_cube else rotation
                if not rotation.blocks:  # the cube kept nothing of this run
                    continue
                self._rotations.setdefault(rotation.blocks[0].mount.axis, []).append(rotation)
        if self._setup is not None:
            for axis, rotations in self._rotations.items():
                for gyro in bench.sensor.about(axis):
                    self._fit(gyro.name, rotations, self._setup)

    def _fit(self, name: str, rotations: Sequence[Rotation], setup: gyros.Setup) -> None:
        """One gyro on the platter's axis; why it cannot be, if its records cannot be used."""
        if not any(name in block.volts for rotation in rotations for block in rotation.blocks):
            return
        clipped = sum(rotation.clipped(name) for rotation in rotations)
        if clipped:
            self._unusable[name] = f"{rotations[0].run}: clipped ({clipped} samples)"
        elif name not in self._bench.noise:
            self._unusable[name] = self._bench.without_noise.get(name, "no record at rest: its noise is not known")
        else:
            self._fits[name] = gyros.fit_gyro(rotations, name, self._bench.noise[name], setup)

    def _made(self, records: Recorded) -> gyros.Setup:
        limits, channels = self._bench.alignment, self._bench.sensor.channels
        return gyros.Setup(
            time_base=reference(records, "time_base", "rate"),
            tilt=limits.mount,
            radius=limits.radius,
            gravity=reference(records, "gravity", "gravity").value,
            temperature=self._bench.temperature,
            ratiometric={c.name: c.ratiometric for c in channels if c.ratiometric is not None},
            drift={c.name: c.drift for c in channels if c.drift is not None},
            supply=wires_of(records).supply,
        )

    def results(self) -> Iterator[Result]:
        setup = self._setup
        if setup is None:
            return
        for name, why in self._unusable.items():
            yield not_determined(name, "sensitivity", "sensitivity", gyros.SENSITIVITY, why)
        for axis, rotations in self._rotations.items():
            for name in [one for one in self._bench.noise if one not in self._unusable]:
                sensor = self._bench.sensor.channel(name)
                if name in self._fits and sensor.axis == ROTATIONS[axis]:
                    yield from self._gyro(rotations, name, setup)
                elif sensor.is_rate and name in rotations[0].blocks[0].volts:
                    own = self._fits[name].sensitivity if name in self._fits else sensor.nominal
                    yield gyros.coupling_result(rotations, name, axis, own, self._bench.noise[name], setup)
        yield from self._centripetal(setup)

    def _gyro(self, rotations: Sequence[Rotation], name: str, setup: gyros.Setup) -> Iterator[Result]:
        fit = self._fits[name]
        found = (
            gyros.sensitivity_result(fit, setup),
            gyros.offset_result(fit),
            *gyros.linearity_results(rotations, fit, setup),
        )
        yield from with_clock(found, rotations, self._bench.noise, setup)

    def direct(self) -> Iterator[DirectEstimate]:
        """What the direct estimators say, to be held against the fit."""
        for name, fit in self._fits.items():
            weights, blocks = agreement.gls_weights(fit), fit.blocks
            mean = weights[:-1].mean(axis=0)
            zero = float(fit.solution.parameters[:-1].mean())
            share = np.full(len(weights) - 1, 1.0 / (len(weights) - 1))
            u_zero = math.sqrt(float(share @ fit.solution.covariance[:-1, :-1] @ share))
            u = float(fit.solution.u[-1])
            for measurand, value, u_value, row in (
                ("sensitivity", fit.sensitivity, u, weights[-1]), ("offset", zero, u_zero, mean),
            ):  # fmt: skip
                change = agreement.of_means(blocks.begin, blocks.end, row)
                yield DirectEstimate(f"{name}.{measurand}", "turntable", value, u_value, change)

    def _centripetal(self, setup: gyros.Setup) -> Iterator[Result]:
        everything = [r for several in self._rotations.values() for r in several]
        for name, noise in self._bench.noise.items():
            sensor = self._bench.sensor.channel(name)
            with_it = [r for r in everything if name in r.blocks[0].volts and not r.clipped(name)]
            if not sensor.is_rate and with_it:
                found = gyros.centripetal_result(with_it, name, sensor.place, noise, setup)
                if found is not None:
                    yield found

    def noise_in_motion(self, own: Mapping[str, Scale]) -> Iterator[Result]:
        title = "deviation in motion: output less the fitted rate, 1/30 Hz to half the sampling rate"
        for rotations in self._rotations.values():
            for name, lines in rotations[0].in_motion.items():
                if name in own and name in self._bench.noise:
                    sensor = self._bench.sensor.channel(name)
                    value, dof, why = resting.deviation(lines, self._bench.noise[name].fit, rotations[0].step)
                    if value is None:
                        yield not_determined(name, "deviation_in_motion", title, sensor.unit, why)
                    else:
                        how = f"hold of {lines.seconds:.4g} s ({rotations[0].run})"
                        u = _u_deviation(value, dof)
                        yield own[name].result(sensor, "deviation_in_motion", title, sensor.unit, value, u, how)

    def flags(self) -> Iterator[str]:
        for rotations in self._rotations.values():
            for rotation in rotations:
                yield from rotation.flags


def _tumble_results(bench: _Bench) -> Iterator[Result]:
    for records in bench.runs:
        read = partial(at_rest, recorder=bench.recorder)
        yield from tumbling.results(records, bench.sensor, bench.noise, bench.alignment.mount, read)


def _ordered(results: Iterable[Result], sensor: Sensor) -> list[Result]:
    """By channel as in the sensor file; of a measurand determined twice (offset: sweep and tumble) the better one."""
    best: dict[str, Result] = {}
    for result in results:
        before = best.get(result.key)
        if before is None or (result.determined and (not before.determined or result.u < before.u)):
            best[result.key] = result
    places = {name: place for place, name in enumerate(sensor.names)}
    return sorted(best.values(), key=lambda r: places.get(r.channel, len(places)))


def _judged(results: Iterable[Result], sensor: Sensor) -> Iterator[Result]:
    """Sensitivities against the data sheet's tolerance, with a guard band of U."""
    for result in results:
        channel = sensor.channel(result.channel) if result.channel in sensor else None
        if result.measurand != "sensitivity" or result.value is None or channel is None or channel.tolerance is None:
            yield result
            continue
        low, high = sorted(channel.nominal * (1.0 + sign * channel.tolerance) for sign in (-1.0, 1.0))
        said = verdict(abs(result.value), result.expanded, low, high)
        # a model that leaves something over says nothing about limits
        yield replace(result, low=low, high=high, verdict="inconclusive" if result.status == "flagged" else said)


def digest_of(seal: bytes) -> str:
    """SHA-256 of a seal's bytes."""
    return hashlib.sha256(seal).hexdigest()
