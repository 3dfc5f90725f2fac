"""What the shaker gave: every sweep of a unit, a mounting each, and the results of their points and rests."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, mounts
from rig.calibrate import accelerometers, agreement, gyros
from rig.calibrate.accelerometers import SENSITIVITY, ChannelFit
from rig.calibrate.agreement import DirectEstimate
from rig.calibrate.allowances import in_runs
from rig.calibrate.basis import Basis
from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import ResponsePoint, Result, not_determined, rejected
from rig.calibrate.cube_route import Recorder, at_rest
from rig.calibrate.input_noise import Scale
from rig.errors import BadInput
from rig.parts.reading.cube_frames import points_by_cube
from rig.parts.reading.vibration import Chain, SinePoint, chain_of, sine_points, wrong_axis
from rig.sensor import SensorChannel

Unusable = Callable[[str, str, str, str], Result]  # the row, why included, for channel, measurand, title and unit
UP = {"x": 1, "y": 2, "z": 0}  # cube axis that is up while this one is driven


class ShakerRuns:
    """Everything from the shaker."""

    def __init__(self, basis: Basis) -> None:
        self._basis = basis
        self.points: list[list[SinePoint]] = []  # of every sweep, each a mounting
        self._fits: dict[str, list[ChannelFit]] = {}
        self._whole: dict[str, ChannelFit] = {}
        self._unusable: dict[str, Unusable] = {}
        self._chain: Chain | None = None
        for records in basis.runs:
            if any("frequency" in body for body in records.points.values()):
                chain = chain_of(records)
                if self._chain is None or chain.u_cutoff > self._chain.u_cutoff:
                    self._chain = chain  # standards are common to all runs; of their filters the least sure one counts
                points = sine_points(records, chain)
                points = points_by_cube(records, points, basis.sensor) if basis.recorder == "cube" else points
                self.points += [points] if points else []
        self._refuse_wrong_axis()
        self._fit()

    def _refuse_wrong_axis(self) -> None:
        axes = {c.name: c.axis for c in self._basis.sensor.channels if not c.is_rate}
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
            for sensor in self._basis.sensor.along(group[0].axis):
                if any(sensor.name in point.lines for point in group):
                    self._fit_mounting(group, sensor, chain)
        for name, several in self._fits.items():
            sensor = self._basis.sensor.channel(name)
            merged = several[0]
            if len(several) > 1:
                whole = self._fitted(self._points_of(sensor.axis), sensor, chain)
                if not isinstance(whole, ChannelFit):
                    self._unusable[name] = whole
                    continue
                merged = whole
            self._whole[name] = merged

    def _fit_mounting(self, group: Sequence[SinePoint], sensor: SensorChannel, chain: Chain) -> None:
        """One channel in one mounting."""
        found = self._fitted(group, sensor, chain)
        if not isinstance(found, ChannelFit):
            self._unusable[sensor.name] = found
        else:
            self._fits.setdefault(sensor.name, []).append(found)

    def _fitted(self, points: Sequence[SinePoint], sensor: SensorChannel, chain: Chain) -> ChannelFit | Unusable:
        """A channel's fit, or why there is none: one without does not take the others with it."""
        try:
            seen = accelerometers.observed(points, sensor.name)
        except BadInput as error:
            return partial(not_determined, why=f"{points[0].run}: {error}")
        try:
            return accelerometers.fit_channel(seen, sensor.name, chain, sensor.bandwidth)
        except BadInput as error:
            return partial(rejected, why=f"{points[0].run}: {error}")

    def _points_of(self, axis: str) -> list[SinePoint]:
        return [point for point in self.everything() if point.axis == axis]

    def everything(self) -> list[SinePoint]:
        """All points of all runs."""
        return [point for group in self.points for point in group]

    def setup(self) -> accelerometers.Setup | None:
        """What the budgets need beside the points; None without a sweep."""
        limits = self._basis.alignment
        if self._chain is None:
            return None
        return accelerometers.Setup(self._chain, limits.beam, limits.mount, self._basis.temperature)

    def results(self) -> Iterator[Result]:
        basis, chain, setup = self._basis, self._chain, self.setup()
        if chain is None or setup is None:
            return
        remount = accelerometers.remount_of(self._fits)
        for name in [one for one in self._unusable if one not in self._whole]:
            yield self._unusable[name](name, "sensitivity", "sensitivity at low frequency", SENSITIVITY)
        for name, fit in self._whole.items():
            sensor = basis.sensor.channel(name)
            yield accelerometers.sensitivity_result(fit, setup, remount, sensor.drift)
            yield accelerometers.pole_result(fit, chain)
            yield accelerometers.curvature_result(fit.seen, name, chain, sensor.bandwidth)
            for driven in "xyz":
                points = self._points_of(driven)
                if driven != sensor.axis and points:
                    yield accelerometers.cross_axis_result(points, name, driven, fit)
        yield from self._offsets()

    def noise_in_motion(self, scales: Mapping[str, Scale]) -> Iterator[Result]:
        """Of every driven channel."""
        for name, fit in self._whole.items():
            if name in scales:
                sensor = self._basis.sensor.channel(name)
                refer, points = partial(scales[name].result, sensor), self._points_of(sensor.axis)
                yield accelerometers.motion_noise_result(points, name, sensor.unit, refer, fit)

    def _offsets(self) -> Iterator[Result]:
        """Zero output from the records at rest in which the axis was horizontal."""
        title = "zero output"
        for name in self._whole:
            sensor = self._basis.sensor.channel(name)
            found = self._mean_at_rest(sensor)
            if found is None:
                why = "no record at rest with this axis horizontal: `static` of a sweep along another axis, or a tumble"
                yield not_determined(name, "offset", title, "V", why)
            else:
                yield self._offset(sensor, found)

    def _mean_at_rest(self, sensor: SensorChannel) -> _AtRest | None:
        """Generalised least-squares mean: records that wander together are not counted as independent."""
        runs, by = self._basis.runs, self._basis.recorder
        found = [r for records in runs for r in _level_rests(records, sensor, by)]
        if not found or sensor.name not in self._basis.noise:
            return None
        names, *columns = zip(*found, strict=True)
        begin, end, volts = (np.array(column, np.float64) for column in columns)
        weights, u = weights_of(self._basis.noise[sensor.name].slow.covariance(begin, end))
        return _AtRest(names, begin, end, weights, float(weights @ volts), u)

    def _offset(self, sensor: SensorChannel, found: _AtRest) -> Result:
        noise, value, u = self._basis.noise[sensor.name], found.value, found.u
        limit = self._basis.alignment.mount
        tilt = abs(self._whole[sensor.name].sensitivity) * 9.80665 * math.sin(limit)
        lines = (
            Contribution("noise and wandering", "A", "normal", u, "V", 1.0, gyros.dof_of(noise)),
            Contribution("tilt of the mounting", "B", "rectangular", tilt / math.sqrt(3.0), "V", 1.0,
                         source=in_runs(f"declared limit {math.degrees(limit):.3g}°", found.runs)),
        )  # fmt: skip
        method = f"mean of {len(found.weights)} records at rest, axis horizontal"
        return Result(sensor.name, "offset", "zero output", value, "V", Budget(lines), method, "plumb line")

    def responses(self) -> dict[str, tuple[ResponsePoint, ...]]:
        if self._chain is None:
            return {}
        axes = {name: self._basis.sensor.channel(name).axis for name in self._whole}
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
            level = self._mean_at_rest(self._basis.sensor.channel(name))
            if level is not None:
                change = agreement.of_means(level.begin, level.end, level.weights)
                yield DirectEstimate(f"{name}.offset", "shaker", level.value, level.u, change)

    def flags(self) -> Iterator[str]:
        for group in self.points:
            for point in group:
                mine = ((n, one) for n, one in point.lines.items() if n in self._basis.sensor)
                for flag in (*point.flags, *(f"{n} {f}" for n, one in mine for f in one.flags)):
                    yield f"{point.run}, {point.frequency:.4g} Hz {point.level}: {flag}; the point was left out"


@dataclass(frozen=True)
class _AtRest:
    """A weighted mean of records at rest of `runs` between `begin` and `end` (bench clock, s), V."""

    runs: tuple[str, ...]
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


def _level_rests(records: Recorded, sensor: SensorChannel, by: Recorder) -> Iterator[tuple[str, float, float, float]]:
    """Run, begin, end (bench clock, s), mean volts of every record at rest on the shaker with this axis horizontal."""
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
            yield records.name, start, start + float(body["seconds"]), float(found.of(sensor.name).mean())
