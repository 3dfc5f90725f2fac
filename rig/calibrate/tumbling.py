"""Accelerometers against gravity: a tumble's poses give sensitivity, zero output and the angles of the triad."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, Reference, Signals, poses_of, reference
from rig.calibrate import triad
from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import Result, Status, not_determined, rejected
from rig.calibrate.resting import Resting
from rig.errors import BadInput
from rig.sensor import AXES, Triad
from rig.signals import gravity_poses

Array = NDArray[np.float64]
Read = Callable[[Recorded, Mapping[str, Any]], Signals | None]
ANGLES = ("xy", "xz", "yz")
SENSITIVITY = "V/(m/s²)"
ASKEW = 5.0  # times: never by chance with the two degrees of freedom of six poses (exp −25)


@dataclass(frozen=True)
class Poses:
    """A tumble: what was up in each pose (n, 3), the journal's bodies, and the records.

    `tilt` is the declared limit of a pose's angle, rad.
    """

    records: Recorded
    up: Array
    bodies: tuple[Mapping[str, Any], ...]
    signals: tuple[Signals, ...]
    gravity: Reference
    noise: Mapping[str, Resting]
    tilt: float

    @property
    def u_up(self) -> float:
        """Standard uncertainty of a pose about any axis, rad."""
        return self.tilt / math.sqrt(3.0)

    @property
    def begin(self) -> Array:
        """Bench clock, s, (n,)."""
        return np.array([float(body["start"]) for body in self.bodies])

    @property
    def end(self) -> Array:
        """Bench clock, s, (n,)."""
        return np.asarray(self.begin + np.array([float(body["seconds"]) for body in self.bodies]))

    def recorded(self, unit: Triad) -> Triad:
        """As much of a unit as was recorded, and whose noise is known."""
        there = (c for c in unit.channels if c.name in self.noise and all(c.name in one.names for one in self.signals))
        return replace(unit, channels=tuple(there))


def poses_in(records: Recorded, noise: Mapping[str, Resting], tilt: float, read: Read) -> Poses | None:
    """The poses of a run; None if there are none. `read` gives what the recorder that calibrates kept of a pose."""
    found = poses_of(records)
    kept = [(up, body, one) for up, body in found if (one := read(records, body)) is not None]
    if not kept:
        return None
    up, bodies, signals = zip(*kept, strict=True)
    gravity = reference(records, "gravity", "gravity")
    return Poses(records, np.array(up), tuple(map(_timed, bodies, signals)), signals, gravity, noise, tilt)


def _timed(body: Mapping[str, Any], found: Signals) -> Mapping[str, Any]:
    """A pose's line with when its record began, where only the recorder knows."""
    return body if "start" in body else {**body, "start": found.start}


@dataclass(frozen=True)
class UnitFit:
    """One unit in all poses: means (n, c) V with their uncertainty (c,), and its channels fitted to what was up.

    `scatter` (c,) is what the means leave over, in what noise and the declared tilt of the poses explain.
    """

    poses: Poses
    unit: Triad
    volts: Array
    u: Array
    directions: triad.Directions
    scatter: Array

    @property
    def signed(self) -> tuple[Array, Array]:
        """Sensitivity of every channel along its own axis, V/(m/s²), with the sign that it has along the declared one,
        and its derivatives by the readings; (c,) and (c, n, c).
        """
        found, own = self.directions, [channel.place for channel in self.unit.channels]
        signs = np.where(found.matrix[np.arange(len(own)), own] < 0.0, -1.0, 1.0)
        return np.asarray(signs * found.sizes[0]), np.asarray(signs[:, None, None] * found.own_axes)

    def u_of_tilt(self, weights: Array) -> float:
        """What poses that stood askew do to an estimate with these derivatives by the means, (n, c).

        A turn δ of the case moves the means by matrix·(δ × g·up).
        """
        pulled = self.poses.gravity.value * weights @ self.directions.matrix
        return self.poses.u_up * float(np.linalg.norm(np.cross(self.poses.up, pulled)))

    def results(self) -> Iterator[Result]:
        """Of every channel; the angles between axes need a whole triad."""
        for place, name in enumerate(self.unit.names):
            yield from _of_axis(self.poses, name, self, place)
        if self.unit.is_whole:
            yield from _angles(self.unit, self.volts, self.u, self.poses.gravity)


def fit_unit(poses: Poses, unit: Triad) -> UnitFit:
    """A unit against gravity. Raises BadInput for a channel that clipped, or poses that do not determine it."""
    clipped = [name for name in unit.names if any(name in one.clipped for one in poses.signals)]
    if clipped:
        raise BadInput(f"{poses.records.name}: {', '.join(clipped)} clipped in a pose")
    volts = np.array([[float(one.of(name).mean()) for name in unit.names] for one in poses.signals])
    noise = np.array([_u_mean(poses.noise[name], poses) for name in unit.names])
    left = np.array([_scatter(column, poses.up) for column in volts.T])
    u, gravity = np.maximum(noise, left), poses.gravity
    found = triad.fit_directions(volts, poses.up, gravity.value, gravity.u, u, poses.u_up)
    return UnitFit(poses, unit, volts, u, found, left / np.hypot(noise, found.sizes[0] * gravity.value * poses.u_up))


def misplaced(poses: Poses, units: Sequence[Triad]) -> dict[str, str]:
    """Channels that do not show gravity where the procedure says that it was, and why that cannot be believed.

    Where all units say the same of a pose, the pose is at fault, else the channels of those that do.
    """
    if len(poses.bodies) < gravity_poses.FEWEST or not units:
        return {}
    followed = {unit.name: gravity_poses.following(*_felt(poses, unit)) for unit in units}
    rows = [tuple(np.flatnonzero(off.any(axis=1)).tolist()) for _, off in followed.values()]
    if rows[0] and all(one == rows[0] for one in rows):
        guess = "the cube lay another way" + (", or channels are swapped" if len(units) == 1 else "")
        why = _of_pose(poses, units[0], rows[0], guess)
        return {name: why for unit in units for name in unit.names}
    found = {
        name: f"shows no gravity along {axis} as the poses have it, other units do: channels swapped or not connected"
        for unit in units for name, axis, off in zip(unit.names, unit.axes, followed[unit.name][1].T, strict=True)
        if off.any()
    }  # fmt: skip
    return found | _all_reversed(units, {name: gains for name, (gains, _) in followed.items()})


def _felt(poses: Poses, unit: Triad) -> tuple[Array, Array]:
    """What a unit felt by its data sheet, from an unknown zero on, and what it should have, of gravity, (n, c) each."""
    volts = np.array([[float(one.of(name).mean()) for name in unit.names] for one in poses.signals])
    nominal = np.array([channel.nominal for channel in unit.channels])
    return volts / nominal / poses.gravity.value, poses.up[:, [channel.place for channel in unit.channels]]


def _of_pose(poses: Poses, unit: Triad, rows: Sequence[int], why: str) -> str:
    felt, expected = _felt(poses, unit)
    k = rows[0]
    shown = felt[k] - np.median(felt - expected, axis=0)
    found, wanted = (
        " ".join(f"{share:+.2f}{axis}" for axis, share in zip(unit.axes, one, strict=True))
        for one in (shown, expected[k])
    )
    more = f" (and {len(rows) - 1} poses more)" if len(rows) > 1 else ""
    return f"{poses.bodies[k]['label']}{more}: found gravity along {found}, wanted {wanted}: {why}"


def _all_reversed(units: Sequence[Triad], gains: Mapping[str, Array]) -> dict[str, str]:
    """Axes along which several units have the other sign together: nobody turned all of them over."""
    found: dict[str, str] = {}
    every = [(c, gain) for unit in units for c, gain in zip(unit.channels, gains[unit.name].tolist(), strict=True)]
    for axis in AXES:
        along = [(c, gain) for c, gain in every if c.axis == axis]
        if len(along) > 1 and all(gain < 0.0 for _, gain in along):
            why = f"all {len(along)} units have the other sign along {axis}: its poses were exchanged"
            found |= {c.name: why for c, _ in along}
    return found


def without(unit: Triad, why: str) -> Iterator[Result]:
    """Why a unit has no sensitivities."""
    for name in unit.names:
        yield not_determined(name, "sensitivity_gravity", "sensitivity from gravity", SENSITIVITY, why)


def refused(channels: Mapping[str, str]) -> Iterator[Result]:
    """Rows of channels that cannot be believed, by why."""
    for name, why in channels.items():
        yield rejected(name, "sensitivity_gravity", "sensitivity from gravity", SENSITIVITY, why)


def _of_axis(poses: Poses, channel: str, of: UnitFit, place: int) -> Iterator[Result]:
    fit, gravity = of.directions, poses.gravity
    dof = float(max(fit.dof, 1))
    common = (f"{len(poses.bodies)} poses, twelve parameters", f"local gravity, {gravity.source}")
    share = gravity.u / gravity.value
    s, u_s = float(of.signed[0][place]), float(fit.sizes[1][place])
    lines = (
        Contribution("noise, wandering and poses", "A", "normal",
                     math.sqrt(max(u_s**2 - (s * share) ** 2, 0.0)), SENSITIVITY, 1.0, dof),
        Contribution("local gravity", "B", "normal", share, "1", s, source=gravity.source),
    )  # fmt: skip
    doubt, status = _askew(of.scatter[place])
    yield Result(
        channel,
        "sensitivity_gravity",
        "sensitivity from gravity",
        s,
        SENSITIVITY,
        Budget(lines),
        *common,
        status,
        doubt,
    )
    wandering = _u_common(poses.noise[channel], poses)
    offset = (
        Contribution("noise, wandering and poses", "A", "normal", float(fit.u_offsets[place]), "V", 1.0, dof),
        Contribution("wandering common to all poses", "A", "normal", wandering, "V", 1.0),
    )
    value = float(fit.offsets[place])
    yield Result(channel, "offset", "zero output", value, "V", Budget(offset), *common, status, doubt)


def _askew(scatter: float) -> tuple[tuple[str, ...], Status]:
    """What is to be said of poses that scatter more than noise and their declared tilt explain."""
    if scatter <= ASKEW:
        return (), "determined"
    said = f"the poses scatter {scatter:.3g} times as much as noise and their declared tilt explain: one stood askew?"
    return (said,), "flagged"


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


def _u_mean(noise: Resting, poses: Poses) -> float:
    """Standard deviation of the pose means about their common mean: noise of a record and wandering between records."""
    covariance, count = noise.slow.covariance(poses.begin, poses.end), len(poses.bodies)
    free = np.eye(count) - 1.0 / count
    return math.sqrt(float(np.trace(free @ covariance @ free)) / max(count - 1, 1))


def _u_common(noise: Resting, poses: Poses) -> float:
    """Standard uncertainty of the mean of all poses beyond what their scatter shows: no pose differs by it."""
    covariance, count = noise.slow.covariance(poses.begin, poses.end), len(poses.bodies)
    return math.sqrt(max(float(covariance.mean()) - _u_mean(noise, poses) ** 2 / count, 0.0))


def _scatter(volts: Array, up: Array) -> float:
    """Standard deviation of one channel's means about its own four parameters; zero if there are none to spare."""
    if len(volts) < 6:
        return 0.0
    design = np.column_stack([up, np.ones(len(up))])
    left = volts - design @ np.linalg.lstsq(design, volts, rcond=None)[0]
    return math.sqrt(float(left @ left) / (len(volts) - 4))
