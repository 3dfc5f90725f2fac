"""What the turntable gave: every run on the platter, and the results of its rests, revolutions and changes of rate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rig.archive.records import Recorded, reference, wires_of
from rig.calibrate import agreement, gyros, resting
from rig.calibrate.agreement import DirectEstimate
from rig.calibrate.basis import Basis
from rig.calibrate.calibration import Result, not_determined
from rig.calibrate.cube_route import with_clock
from rig.calibrate.input_noise import Scale, u_deviation
from rig.parts.reading.cube_frames import rotation_by_cube
from rig.parts.reading.revolutions import Rotation, rotation_of
from rig.sensor import ROTATIONS


class TurntableRuns:
    """Everything from the turntable."""

    def __init__(self, basis: Basis) -> None:
        self._basis = basis
        self._rotations: dict[str, list[Rotation]] = {}
        self._fits: dict[str, gyros.PlatterFit] = {}
        self._radial: dict[str, tuple[gyros.PlatterFit, float]] = {}
        self._unusable: dict[str, str] = {}
        self._setup: gyros.Setup | None = None
        for records in basis.runs:
            phases = {body["phase"] for body in records.points.values() if "phase" in body}
            if phases and ("hold" in phases or records.status == "completed"):  # an interrupted one may not have held
                self._setup = self._setup or self._made(records)
                wired, supply = records.header["bench_file"]["cables"]["turntable"], wires_of(records).supply
                channels = [c for c in wired if c in basis.sensor or c == supply]
                by_cube = basis.recorder == "cube"
                rotation = rotation_of(records, [] if by_cube else channels, basis.sensor)
                rotation = rotation_by_cube(records, rotation, basis.sensor) if by_cube else rotation
                if not rotation.blocks:  # the cube kept nothing of this run
                    continue
                self._rotations.setdefault(rotation.blocks[0].mount.axis, []).append(rotation)
        if self._setup is not None:
            for axis, rotations in self._rotations.items():
                for gyro in basis.sensor.about(axis):
                    self._fit(gyro.name, rotations, self._setup)
            self._radial.update(self._fit_radial(self._setup))

    def _fit(self, name: str, rotations: Sequence[Rotation], setup: gyros.Setup) -> None:
        """One gyro on the platter's axis; why it cannot be, if its records cannot be used."""
        if not any(name in block.volts for rotation in rotations for block in rotation.blocks):
            return
        clipped = sum(rotation.clipped(name) for rotation in rotations)
        if clipped:
            self._unusable[name] = f"{rotations[0].run}: clipped ({clipped} samples)"
        elif name not in self._basis.noise:
            self._unusable[name] = self._basis.without_noise.get(name, "no record at rest: its noise is not known")
        else:
            self._fits[name] = gyros.fit_gyro(rotations, name, self._basis.noise[name], setup)

    def _made(self, records: Recorded) -> gyros.Setup:
        limits, channels = self._basis.alignment, self._basis.sensor.channels
        return gyros.Setup(
            time_base=reference(records, "time_base", "rate"),
            tilt=limits.mount,
            radius=limits.radius,
            gravity=reference(records, "gravity", "gravity").value,
            temperature=self._basis.temperature,
            ratiometric={c.name: c.ratiometric for c in channels if c.ratiometric is not None},
            drift={c.name: c.drift for c in channels if c.drift is not None},
            supply=wires_of(records).supply,
            platen=limits.platen,
            straight={c.name: (c.asymmetry, c.nonlinearity) for c in channels if c.is_rate},
            off_centre={c.name: c.off_centre for c in channels if c.off_centre is not None},
        )

    def results(self) -> Iterator[Result]:
        setup = self._setup
        if setup is None:
            return
        for name, why in self._unusable.items():
            yield not_determined(name, "sensitivity", "sensitivity", gyros.SENSITIVITY, why)
        for axis, rotations in self._rotations.items():
            for name in [one for one in self._basis.noise if one not in self._unusable]:
                sensor = self._basis.sensor.channel(name)
                if name in self._fits and sensor.axis == ROTATIONS[axis]:
                    yield from self._gyro(rotations, name, setup)
                elif sensor.is_rate and name in rotations[0].blocks[0].volts:
                    own = self._fits[name].sensitivity if name in self._fits else sensor.nominal
                    yield gyros.coupling_result(rotations, name, axis, own, self._basis.noise[name], setup)
        for fit, radius in self._radial.values():
            yield gyros.centripetal_result(fit, radius, setup)

    def _gyro(self, rotations: Sequence[Rotation], name: str, setup: gyros.Setup) -> Iterator[Result]:
        fit = self._fits[name]
        found = (
            gyros.sensitivity_result(fit, setup),
            gyros.offset_result(fit),
            *gyros.linearity_results(rotations, fit, setup),
        )
        yield from with_clock(found, rotations, self._basis.noise, setup)

    def direct(self) -> Iterator[DirectEstimate]:
        """What the direct estimators say, to be held against the fit."""
        for name, fit in self._fits.items():
            yield self._estimate(f"{name}.sensitivity", fit)
            weights = agreement.gls_weights(fit)[:-1].mean(axis=0)
            zero = float(fit.solution.parameters[:-1].mean())
            share = np.full(len(fit.solution.u) - 1, 1.0 / (len(fit.solution.u) - 1))
            u = math.sqrt(float(share @ fit.solution.covariance[:-1, :-1] @ share))
            change = agreement.of_means(fit.blocks.begin, fit.blocks.end, weights)
            yield DirectEstimate(f"{name}.offset", "turntable", zero, u, change)
        for name, (fit, _) in self._radial.items():
            yield self._estimate(f"{name}.sensitivity_centripetal", fit)

    def _estimate(self, key: str, fit: gyros.PlatterFit) -> DirectEstimate:
        change = agreement.of_means(fit.blocks.begin, fit.blocks.end, agreement.gls_weights(fit)[-1])
        return DirectEstimate(key, "turntable", fit.sensitivity, float(fit.solution.u[-1]), change)

    def _fit_radial(self, setup: gyros.Setup) -> Iterator[tuple[str, tuple[gyros.PlatterFit, float]]]:
        """Accelerometers that feel the centripetal acceleration, with the radius, m."""
        everything = [r for several in self._rotations.values() for r in several]
        for name, noise in self._basis.noise.items():
            sensor = self._basis.sensor.channel(name)
            with_it = [r for r in everything if name in r.blocks[0].volts and not r.clipped(name)]
            if not sensor.is_rate and with_it:
                found = gyros.fit_centripetal(with_it, name, sensor.place, noise, setup)
                if found is not None:
                    yield name, found

    def noise_in_motion(self, own: Mapping[str, Scale]) -> Iterator[Result]:
        title = "deviation in motion: output less the fitted rate, 1/30 Hz to half the sampling rate"
        for rotations in self._rotations.values():
            for name, lines in rotations[0].in_motion.items():
                if name in own and name in self._basis.noise:
                    sensor = self._basis.sensor.channel(name)
                    value, dof, why = resting.deviation(lines, self._basis.noise[name].fit, rotations[0].step)
                    if value is None:
                        yield not_determined(name, "deviation_in_motion", title, sensor.unit, why)
                    else:
                        how = f"hold of {lines.seconds:.4g} s ({rotations[0].run})"
                        u = u_deviation(value, dof)
                        yield own[name].result(sensor, "deviation_in_motion", title, sensor.unit, value, u, how)

    def flags(self) -> Iterator[str]:
        for rotations in self._rotations.values():
            for rotation in rotations:
                yield from rotation.flags
