"""Accelerometers against gravity: a tumble's poses give sensitivity, zero output and the angles of the triad."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, Reference, poses_of, reference, signals
from rig.calibrate import triad
from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import Result, not_determined
from rig.calibrate.resting import Resting
from rig.errors import BadInput

Array = NDArray[np.float64]
UNITS = ("unit_a", "unit_b", "unit_c")
ANGLES = ("xy", "xz", "yz")
SENSITIVITY = "V/(m/s²)"


class Axis(Protocol):
    """What is needed of a sensor: its data-sheet sensitivity."""

    @property
    def nominal(self) -> float: ...


def results(
    records: Recorded, sensors: Mapping[str, Axis], noise: Mapping[str, Resting], tilt: float
) -> Iterator[Result]:
    """Results of every triad; nothing for a run without poses. `tilt` is the declared limit of a pose's angle, rad."""
    found = poses_of(records)
    if not found:
        return
    gravity = reference(records, "gravity", "gravity")
    up = np.array([direction for direction, _ in found])
    bodies = [body for _, body in found]
    for unit in UNITS:
        channels = [f"{unit}_{axis}" for axis in "xyz"]
        if all(c in sensors and c in noise for c in channels):
            yield from _triad(records, unit, channels, up, bodies, gravity, noise, tilt)


def _triad(
    records: Recorded, unit: str, channels: Sequence[str], up: Array, bodies: Sequence[Mapping[str, Any]],
    gravity: Reference, noise: Mapping[str, Resting], tilt: float,
) -> Iterator[Result]:  # fmt: skip
    records_of = [signals(records.samples(body["samples"])) for body in bodies]
    if any(channels[0] not in one.names for one in records_of):
        return
    clipped = [c for c in channels if any(c in one.clipped for one in records_of)]
    if clipped:
        for c in channels:
            why = f"{records.name}: {', '.join(clipped)} clipped in a pose"
            yield not_determined(c, "sensitivity_gravity", "sensitivity from gravity", SENSITIVITY, why)
        return
    volts = np.array([[float(one.of(c).mean()) for c in channels] for one in records_of])
    u = np.array(
        [max(_u_mean(noise[c], bodies), _scatter(column, up)) for c, column in zip(channels, volts.T, strict=True)]
    )
    try:
        fit = triad.fit_directions(volts, up, gravity.value, gravity.u, u, tilt / math.sqrt(3.0))
    except BadInput as error:
        for c in channels:
            yield not_determined(c, "sensitivity_gravity", "sensitivity from gravity", SENSITIVITY, str(error))
        return
    nine = fit.intrinsic
    common = (f"{len(bodies)} poses, twelve parameters", f"local gravity, {gravity.source}")
    share = gravity.u / gravity.value
    for place, channel in enumerate(channels):
        s, u_s = float(nine.sensitivities[place]), float(nine.u[place])
        lines = (
            Contribution("noise, wandering and poses", "A", "normal",
                         math.sqrt(max(u_s**2 - (s * share) ** 2, 0.0)), SENSITIVITY, 1.0, float(max(fit.dof, 1))),
            Contribution("local gravity", "B", "normal", share, "1", s, source=gravity.source),
        )  # fmt: skip
        yield Result(channel, "sensitivity_gravity", "sensitivity from gravity", s, SENSITIVITY, Budget(lines), *common)
        offset = (
            Contribution("noise, wandering and poses", "A", "normal", float(nine.u[3 + place]), "V", 1.0,
                         float(max(fit.dof, 1))),
            Contribution("wandering common to all poses", "A", "normal", _u_common(noise[channel], bodies), "V", 1.0),
        )  # fmt: skip
        yield Result(channel, "offset", "zero output", float(nine.offsets[place]), "V", Budget(offset), *common)
    yield from _angles(unit, channels, volts, u, gravity, common)


def _angles(
    unit: str, channels: Sequence[str], volts: Array, u: Array, gravity: Reference, common: tuple[str, str]
) -> Iterator[Result]:
    """Angles between the axes from the magnitude of gravity alone, which no pose's direction disturbs."""
    titles = {name: f"departure of the axes {name[0]} and {name[1]} from a right angle" for name in ANGLES}
    try:
        nine = triad.fit_magnitude(volts, gravity.value, gravity.u, u)
    except BadInput as error:
        for name in ANGLES:
            yield not_determined(unit, f"angle_{name}", titles[name], "rad", f"{error} (`rig tumble --poses 24`)")
        return
    for place, name in enumerate(ANGLES):
        line = Contribution("noise and wandering", "A", "normal", float(nine.u[6 + place]), "rad", 1.0,
                            float(max(nine.dof, 1)))  # fmt: skip
        method = ("nine parameters from the magnitude of gravity", common[1])
        departure = float(nine.angles[place]) - math.pi / 2.0
        yield Result(unit, f"angle_{name}", titles[name], departure, "rad", Budget((line,)), *method)


def _u_mean(noise: Resting, bodies: Sequence[Mapping[str, Any]]) -> float:
    """Standard deviation of the pose means about their common mean: noise of a record and wandering between records."""
    covariance, count = _covariance(noise, bodies), len(bodies)
    free = np.eye(count) - 1.0 / count
    return math.sqrt(float(np.trace(free @ covariance @ free)) / max(count - 1, 1))


def _u_common(noise: Resting, bodies: Sequence[Mapping[str, Any]]) -> float:
    """Standard uncertainty of the mean of all poses beyond what their scatter shows: no pose differs by it."""
    covariance, count = _covariance(noise, bodies), len(bodies)
    return math.sqrt(max(float(covariance.mean()) - _u_mean(noise, bodies) ** 2 / count, 0.0))


def _covariance(noise: Resting, bodies: Sequence[Mapping[str, Any]]) -> Array:
    begin = np.array([float(body["start"]) for body in bodies])
    return noise.slow.covariance(begin, begin + np.array([float(body["seconds"]) for body in bodies]))


def _scatter(volts: Array, up: Array) -> float:
    """Standard deviation of one channel's means about its own four parameters; zero if there are none to spare."""
    if len(volts) < 6:
        return 0.0
    design = np.column_stack([up, np.ones(len(up))])
    left = volts - design @ np.linalg.lstsq(design, volts, rcond=None)[0]
    return math.sqrt(float(left @ left) / (len(volts) - 4))
