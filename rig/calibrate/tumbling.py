"""Accelerometers against gravity: a tumble's poses give sensitivity, zero output and the angles of the triad."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, Reference, Signals, poses_of, reference
from rig.calibrate import triad
from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import Result, not_determined
from rig.calibrate.resting import Resting
from rig.errors import BadInput
from rig.sensor import Sensor, Triad

Array = NDArray[np.float64]
Read = Callable[[Recorded, Mapping[str, Any]], Signals | None]
ANGLES = ("xy", "xz", "yz")
SENSITIVITY = "V/(m/s²)"


def results(
    records: Recorded, sensor: Sensor, noise: Mapping[str, Resting], tilt: float, read: Read
) -> Iterator[Result]:
    """Results of every unit; nothing for a run without poses. `tilt` is the declared limit of a pose's angle, rad.

    `read` gives what the recorder that calibrates kept of a pose, None if nothing.

    The angles between axes need a whole triad; fewer axes have sensitivity and zero output alone.
    """
    found = poses_of(records)
    if not found:
        return
    gravity = reference(records, "gravity", "gravity")
    kept = [(up, body, one) for up, body in found if (one := read(records, body)) is not None]
    if not kept:
        return
    up, bodies, records_of = zip(*kept, strict=True)
    poses = _Poses(records, np.array(up), tuple(map(_timed, bodies, records_of)), records_of, gravity, noise, tilt)
    for unit in sensor.of_quantity("acceleration"):
        if all(name in noise and all(name in one.names for one in poses.signals) for name in unit.names):
            yield from _of_unit(poses, unit)


def _timed(body: Mapping[str, Any], found: Signals) -> Mapping[str, Any]:
    """A pose's line with when its record began, where only the recorder knows."""
    return body if "start" in body else {**body, "start": found.start}


@dataclass(frozen=True)
class _Poses:
    """A tumble: what was up in each pose (n, 3), the journal's bodies, and the records."""

    records: Recorded
    up: Array
    bodies: tuple[Mapping[str, Any], ...]
    signals: tuple[Signals, ...]
    gravity: Reference
    noise: Mapping[str, Resting]
    tilt: float


def _of_unit(poses: _Poses, unit: Triad) -> Iterator[Result]:
    clipped = [name for name in unit.names if any(name in one.clipped for one in poses.signals)]
    if clipped:
        yield from _without(unit, f"{poses.records.name}: {', '.join(clipped)} clipped in a pose")
        return
    volts = np.array([[float(one.of(name).mean()) for name in unit.names] for one in poses.signals])
    u = np.array([
        max(_u_mean(poses.noise[name], poses.bodies), _scatter(column, poses.up))
        for name, column in zip(unit.names, volts.T, strict=True)
    ])  # fmt: skip
    gravity = poses.gravity
    try:
        fit = triad.fit_directions(volts, poses.up, gravity.value, gravity.u, u, poses.tilt / math.sqrt(3.0))
    except BadInput as error:
        yield from _without(unit, str(error))
        return
    for place, name in enumerate(unit.names):
        yield from _of_axis(poses, name, fit, place)
    if unit.is_whole:
        yield from _angles(unit, volts, u, gravity)


def _without(unit: Triad, why: str) -> Iterator[Result]:
    for name in unit.names:
        yield not_determined(name, "sensitivity_gravity", "sensitivity from gravity", SENSITIVITY, why)


def _of_axis(poses: _Poses, channel: str, fit: triad.Directions, place: int) -> Iterator[Result]:
    gravity, dof = poses.gravity, float(max(fit.dof, 1))
    common = (f"{len(poses.bodies)} poses, twelve parameters", f"local gravity, {gravity.source}")
    share = gravity.u / gravity.value
    sizes, u_sizes = fit.sizes
    s, u_s = float(sizes[place]), float(u_sizes[place])
    lines = (
        Contribution("noise, wandering and poses", "A", "normal",
                     math.sqrt(max(u_s**2 - (s * share) ** 2, 0.0)), SENSITIVITY, 1.0, dof),
        Contribution("local gravity", "B", "normal", share, "1", s, source=gravity.source),
    )  # fmt: skip
    yield Result(channel, "sensitivity_gravity", "sensitivity from gravity", s, SENSITIVITY, Budget(lines), *common)
    wandering = _u_common(poses.noise[channel], poses.bodies)
    offset = (
        Contribution("noise, wandering and poses", "A", "normal", float(fit.u_offsets[place]), "V", 1.0, dof),
        Contribution("wandering common to all poses", "A", "normal", wandering, "V", 1.0),
    )
    yield Result(channel, "offset", "zero output", float(fit.offsets[place]), "V", Budget(offset), *common)


def _angles(unit: Triad, volts: Array, u: Array, gravity: Reference) -> Iterator[Result]:
    """Angles between the axes from the magnitude of gravity alone, which no pose's direction disturbs."""
    titles = {name: f"departure of the axes {name[0]} and {name[1]} from a right angle" for name in ANGLES}
    try:
        nine = triad.fit_magnitude(volts, gravity.value, gravity.u, u)
    except BadInput as error:
        for name in ANGLES:
            yield not_determined(unit.name, f"angle_{name}", titles[name], "rad", f"{error} (`rig tumble --poses 24`)")
        return
    for place, name in enumerate(ANGLES):
        line = Contribution("noise and wandering", "A", "normal", float(nine.u[6 + place]), "rad", 1.0,
                            float(max(nine.dof, 1)))  # fmt: skip
        method = ("nine parameters from the magnitude of gravity", f"local gravity, {gravity.source}")
        departure = float(nine.angles[place]) - math.pi / 2.0
        yield Result(unit.name, f"angle_{name}", titles[name], departure, "rad", Budget((line,)), *method)


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
