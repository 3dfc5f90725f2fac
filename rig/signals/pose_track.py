"""What a body went through, from a camera's track of its pose: rates and specific force in the case frame.

A pose is a position p (m, in a world that stands still) and a quaternion q (w, x, y, z). With R the rotation that
takes case vectors to the world, and * the conjugate (Markley & Crassidis 2014, section 3.2):

    rate     ω = 2 vec(q* q̇)                 turning   ω̇ = 2 vec(q* q̈)
    force    f = Rᵀ (p̈ + g·up)                up in the case frame   Rᵀ up

Position and quaternion are smoothed apart (`smoother`), each with the band and the noise that its own spectrum
shows. A quaternion and its negative are the same rotation, so signs are made continuous first. Noise of the single axes
is shared out as the residuals are. Not in the uncertainty: a wrong mounting of markers, a wrong clock, a world that is
not level. Those are constants, for a fit to find.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.signals.smoother import FEWEST, Curve, smooth, trusted

Array = NDArray[np.float64]
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
LONGEST = 0.1
"""Gaps up to here are bridged, s."""


@dataclass(frozen=True)
class PoseTrack:
    """Motion in the case frame on an even grid; vectors have shape (3, n).

    `time` s on the track's own clock, (n,), every `interval` s; `rate` rad/s, `turning` (angular acceleration) rad/s²,
    `force` (specific force at the tracked point) m/s², `up` unit vector; `u_…`: standard uncertainty per instant and
    component, same units. `good` (n,): False in gaps longer than the limit, near their ends and near those of the
    track; what stands there is only a smooth bridge. `bandwidth` Hz: motion and noise are equal here in orientation
    and in position, and above it nothing is to be trusted; `kept` Hz: to there the smoothers keep 99 %.
    `notes`: what a reader must know, in sentences.
    """

    time: Array
    interval: float
    rate: Array
    turning: Array
    force: Array
    up: Array
    u_rate: Array
    u_turning: Array
    u_force: Array
    good: NDArray[np.bool_]
    bandwidth: tuple[float, float]
    kept: tuple[float, float]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Rotation:
    """Smoothed quaternions (n, 4) with derivatives, and the variance of rotation, rate and turning, each (3, n)."""

    quaternion: Array
    rate: Array
    turning: Array
    variances: tuple[Array, Array, Array]


def pose_track(
    time: Array,
    position: Array,
    quaternion: Array,
    *,
    convention: Literal["body_to_world", "world_to_body"],
    up: str | Sequence[float] | Array,
    gravity: float,
    interval: float | None = None,
    keep: float | None = None,
    longest: float = LONGEST,
) -> PoseTrack:
    """Motion from poses at `time` (s, (n,)): `position` (m, (n, 3)) and `quaternion` (w x y z, (n, 4)), NaN in gaps.

    `convention`: which way the quaternion takes vectors. `up`: world axis that points up ("z", "-y" or three numbers).
    `gravity` m/s². `interval` (s) of the grid: the median of the stamps without it. `keep` (Hz): keep 99 % up to
    there, instead of what the data suggest. `longest` (s): longer gaps are not good.
    Raises BadInput for shapes that differ, quaternions that are not of unit length, and too few poses.
    """
    _checked(time, position, quaternion)
    later, notes = _increasing(time)
    stamps = time[later]
    turned = quaternion[later] * (np.array([1.0, -1.0, -1.0, -1.0]) if convention == "world_to_body" else 1.0)
    (turn_times, turns), (place_times, places) = (_known(stamps, one) for one in (turned, position[later]))
    rotation_curve = smooth(turn_times, continuous(turns), keep=keep)
    position_curve = smooth(place_times, places, keep=keep)
    every = float(np.median(np.diff(stamps))) if interval is None else interval
    begin, end = max(turn_times[0], place_times[0]), min(turn_times[-1], place_times[-1])
    grid = begin + every * np.arange(math.floor((end - begin) / every + 1e-9) + 1)
    rotation = _rotation(rotation_curve, turn_times, continuous(turns), grid)
    force, u_force, up_case = _force(position_curve, (place_times, places), rotation, gravity * _axis(up), grid)
    good = trusted(rotation_curve, grid, turn_times, longest) & trusted(position_curve, grid, place_times, longest)
    return PoseTrack(
        time=grid,
        interval=every,
        rate=rotation.rate,
        turning=rotation.turning,
        force=force,
        up=up_case,
        u_rate=np.sqrt(rotation.variances[1]),
        u_turning=np.sqrt(rotation.variances[2]),
        u_force=u_force,
        good=good,
        bandwidth=(rotation_curve.spectrum.bandwidth, position_curve.spectrum.bandwidth),
        kept=(rotation_curve.low_pass.kept, position_curve.low_pass.kept),
        notes=(*notes, *_curve_notes(rotation_curve, position_curve), *_gap_notes(time, turn_times, longest)),
    )


def _checked(time: Array, position: Array, quaternion: Array) -> None:
    count = len(time)
    if time.shape != (count,) or position.shape != (count, 3) or quaternion.shape != (count, 4):
        shapes = f"time {time.shape}, position {position.shape}, quaternion {quaternion.shape}"
        raise BadInput(f"pose track: found {shapes}, wanted (n,), (n, 3) and (n, 4)")
    lengths = np.linalg.norm(quaternion[np.isfinite(quaternion).all(axis=1)], axis=1)
    if len(lengths) and float(np.abs(lengths - 1.0).max()) > 0.02:
        worst = float(lengths[np.argmax(np.abs(lengths - 1.0))])
        raise BadInput(f"pose track: found a quaternion of length {worst:.4g}, wanted unit length")


def _increasing(time: Array) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Rows whose stamp is above all before, and a note about the others."""
    known = np.isfinite(time)
    filled = np.where(known, time, -np.inf)
    later = known.copy()
    later[1:] &= filled[1:] > np.maximum.accumulate(filled)[:-1]
    dropped = int(np.count_nonzero(~later))
    return later, (f"dropped {dropped} of {len(time)} poses: their time stamp did not increase",) if dropped else ()


def _known(time: Array, values: Array) -> tuple[Array, Array]:
    """Rows with all their numbers. Raises BadInput if they are too few for a spectrum."""
    known = np.isfinite(values).all(axis=1)
    if np.count_nonzero(known) < FEWEST:
        raise BadInput(f"pose track: found {np.count_nonzero(known)} complete poses, wanted {FEWEST} or more")
    return time[known], values[known]


def _axis(up: str | Sequence[float] | Array) -> Array:
    """Unit vector that points up in the world. Raises BadInput for a name that is no axis or a vector of no length."""
    if isinstance(up, str):
        if up.lstrip("+-") not in AXES:
            raise BadInput(f"pose track: found up '{up}', wanted x, y or z, or -x, -y, -z")
        return np.array(AXES[up.lstrip("+-")]) * (-1.0 if up.startswith("-") else 1.0)
    vector = np.asarray(up, np.float64)
    if vector.shape != (3,) or not float(np.linalg.norm(vector)) > 0.0:
        raise BadInput(f"pose track: found up {vector.tolist()}, wanted three numbers that are not all zero")
    return np.asarray(vector / np.linalg.norm(vector), np.float64)


def continuous(quaternion: Array) -> Array:
    """The same rotations (n, 4) of length one, each with the sign that is nearer to the one before."""
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    flips = np.where((unit[1:] * unit[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    return np.asarray(unit * np.concatenate([[1.0], np.cumprod(flips)])[:, None], np.float64)


def _twice_vector(one: Array, other: Array) -> Array:
    """2 vec(one* other) for quaternions (n, 4), shape (3, n)."""
    w, v, x, y = one[:, :1], one[:, 1:], other[:, :1], other[:, 1:]
    return np.asarray(2.0 * (w * y - x * v - np.cross(v, y)).T, np.float64)


def case_from_world(quaternion: Array) -> Array:
    """Rᵀ for quaternions (n, 4) of length one that take case vectors to the world; shape (n, 3, 3)."""
    w, x, y, z = quaternion.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _rotation(curve: Curve, time: Array, measured: Array, grid: Array) -> _Rotation:
    """Rate and turning on the grid; the length of the smoothed quaternion, a little below one, is divided out.

    With ω' = 2 vec(q* q̇)/|q|² exact for any length of q; of ω̇ the change of the length is taken off likewise.
    """
    values = [curve.value(grid, order) for order in range(3)]
    square = np.maximum((values[0] ** 2).sum(axis=1), 1e-6)
    growth = 2.0 * (values[0] * values[1]).sum(axis=1) / square
    rate = _twice_vector(values[0], values[1]) / square
    turning = _twice_vector(values[0], values[2]) / square - growth * rate
    unit = values[0] / np.sqrt(square)[:, None]
    shares = _shares(_twice_vector(curve.value(time), measured).T)[:, None]
    angle, speed, spin = (4.0 * shares * curve.variance(grid, order) for order in range(3))
    # δω = δθ̇ + ω×δθ, and with one derivative more for ω̇
    return _Rotation(unit, rate, turning, (angle, speed + _crossed(rate, angle), spin + _crossed(turning, angle)))


def _shares(residuals: Array) -> Array:
    """Share of each column in the mean square; equal shares if there is nothing left over."""
    squares = np.mean(residuals**2, axis=0)
    return np.asarray(squares / squares.sum() if squares.sum() > 0.0 else np.full(len(squares), 1.0 / len(squares)))


def _crossed(vector: Array, variance: Array) -> Array:
    """Variance of vector × error, for independent errors of the components; all (3, n)."""
    one, two = (1, 2, 0), (2, 0, 1)
    return np.asarray(vector[one, :] ** 2 * variance[two, :] + vector[two, :] ** 2 * variance[one, :], np.float64)


def _force(
    curve: Curve, placed: tuple[Array, Array], rotation: _Rotation, gravity: Array, grid: Array
) -> tuple[Array, Array, Array]:
    """Specific force and its standard uncertainty (m/s²), and the way up, in the case frame, each (3, n)."""
    turn = case_from_world(rotation.quaternion)
    force = np.einsum("nij,nj->in", turn, curve.value(grid, 2) + gravity)
    shares = _shares(placed[1] - curve.value(placed[0]))
    own = np.einsum("nij,j->in", turn**2, shares) * curve.variance(grid, 2)
    up = np.einsum("nij,j->in", turn, gravity / np.linalg.norm(gravity))
    return force, np.sqrt(own + _crossed(force, rotation.variances[0])), up


def _curve_notes(rotation: Curve, position: Curve) -> tuple[str, ...]:
    return (*(f"orientation: {note}" for note in rotation.notes), *(f"position: {note}" for note in position.notes))


def _gap_notes(time: Array, known: Array, longest: float) -> tuple[str, ...]:
    """How many poses are missing, and how many gaps are too long."""
    missing = int(np.count_nonzero(np.isfinite(time))) - len(known)
    wide = np.diff(known)[np.diff(known) > longest]
    if not missing and not len(wide):
        return ()
    gaps = f"; {len(wide)} gaps are longer than {longest:.3g} s, the longest is {wide.max():.3g} s" if len(wide) else ""
    return (f"{missing} of {len(time)} poses have no orientation{gaps}",)
