"""Rates and forces from a camera's track, against a motion whose derivatives are known, and against a real one."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfiltfilt

from rig.errors import BadInput
from rig.signals.pose_track import PoseTrack, pose_track
from rig.signals.smoother import inverse_band

Array = NDArray[np.float64]
DATA = Path(os.environ.get("RIG_REAL_DATA", Path(__file__).parents[3] / "shared" / "data"))
RATE, GRAVITY = 285.714, 9.81
U_PLACE, U_ANGLE = 0.2e-3, 1e-3  # m, rad: what such cameras reach


@dataclass(frozen=True)
class Swing:
    """Sums of sines, (3, k) amplitudes, frequencies (Hz) and phases."""

    amplitude: Array
    frequency: Array
    phase: Array

    def at(self, time: Array, derivative: int = 0) -> Array:
        turn = 2.0 * np.pi * self.frequency
        argument = turn[..., None] * time + self.phase[..., None] + derivative * np.pi / 2.0
        return np.asarray((self.amplitude[..., None] * turn[..., None] ** derivative * np.sin(argument)).sum(axis=1))


def swing(seed: int, size: float) -> Swing:
    rng = np.random.default_rng(seed)
    frequency = np.array([0.4, 1.1, 2.3, 4.2, 7.0, 10.0]) * rng.uniform(0.97, 1.0, (3, 6))
    return Swing(size * frequency**-1.3, frequency, rng.uniform(0.0, 2.0 * np.pi, (3, 6)))


def quaternion_of(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Body to world, yaw about z first, then pitch about y, then roll about x; (n, 4)."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a / 2), np.sin(a / 2)) for a in (roll, pitch, yaw))
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )


def rate_of(angles: Swing, time: Array) -> Array:
    (roll, pitch, _), (p, q, r) = angles.at(time), angles.at(time, 1)
    return np.stack(
        [
            p - r * np.sin(pitch),
            q * np.cos(roll) + r * np.sin(roll) * np.cos(pitch),
            r * np.cos(roll) * np.cos(pitch) - q * np.sin(roll),
        ]
    )


def matrix_of(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Case to world, written out independently of quaternions; (n, 3, 3)."""
    zero, one = np.zeros_like(roll), np.ones_like(roll)

    def rows(*entries: Array) -> Array:
        return np.moveaxis(np.array(entries).reshape(3, 3, -1), 2, 0)

    x = rows(one, zero, zero, zero, np.cos(roll), -np.sin(roll), zero, np.sin(roll), np.cos(roll))
    y = rows(np.cos(pitch), zero, np.sin(pitch), zero, one, zero, -np.sin(pitch), zero, np.cos(pitch))
    z = rows(np.cos(yaw), -np.sin(yaw), zero, np.sin(yaw), np.cos(yaw), zero, zero, zero, one)
    return z @ y @ x


@dataclass(frozen=True)
class Truth:
    rate: Array
    turning: Array
    force: Array
    up: Array


@dataclass(frozen=True)
class Filmed:
    """A motion, and what a camera makes of it."""

    angles: Swing
    path: Swing
    time: Array
    position: Array
    quaternion: Array

    def truth(self, time: Array) -> Truth:
        h = 1e-4
        turning = (8 * (rate_of(self.angles, time + h) - rate_of(self.angles, time - h))) / (12 * h)
        turning -= (rate_of(self.angles, time + 2 * h) - rate_of(self.angles, time - 2 * h)) / (12 * h)
        world = self.path.at(time, 2) + np.array([[0.0], [0.0], [GRAVITY]])
        matrices = matrix_of(*self.angles.at(time))
        force = np.einsum("nji,jn->in", matrices, world)
        return Truth(rate_of(self.angles, time), turning, force, matrices[:, 2, :].T)


def filmed(seed: int = 0, count: int = 6000, noise: float = 1.0) -> Filmed:
    rng = np.random.default_rng(100 + seed)
    time = np.arange(count) / RATE
    angles, path = swing(seed, 0.25), swing(50 + seed, 0.02)
    small = noise * U_ANGLE * rng.normal(size=(count, 3)) / 2.0
    clean = quaternion_of(*angles.at(time))
    w, v = clean[:, :1], clean[:, 1:]
    shaken = np.concatenate([w - (v * small).sum(axis=1, keepdims=True), v + w * small + np.cross(v, small)], axis=1)
    shaken /= np.linalg.norm(shaken, axis=1, keepdims=True)
    return Filmed(angles, path, time, path.at(time).T + noise * U_PLACE * rng.normal(size=(count, 3)), shaken)


def tracked(
    film: Filmed,
    *,
    quaternion: Array | None = None,
    convention: Literal["body_to_world", "world_to_body"] = "body_to_world",
    keep: float | None = None,
) -> PoseTrack:
    turned = film.quaternion if quaternion is None else quaternion
    return pose_track(film.time, film.position, turned, convention=convention, up="z", gravity=GRAVITY, keep=keep)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_error_is_small_against_the_motion_and_is_what_the_uncertainty_says() -> None:
    ratios: dict[str, list[float]] = {"rate": [], "turning": [], "force": []}
    for seed in range(6):
        film = filmed(seed)
        track = tracked(film)
        truth = film.truth(track.time)
        for name in ratios:
            error = (getattr(track, name) - getattr(truth, name))[:, track.good]
            ratios[name].append(rms(error / getattr(track, f"u_{name}")[:, track.good]))
        assert rms((track.rate - truth.rate)[:, track.good]) < 0.02 * rms(truth.rate)
        assert rms((track.turning - truth.turning)[:, track.good]) < 0.06 * rms(truth.turning)
        assert rms((track.up - truth.up)[:, track.good]) < U_ANGLE
        assert track.good.mean() > 0.97
    for name, each in ratios.items():
        assert 0.8 < np.mean(each) < 1.2, (name, each)


def test_the_rate_is_neither_late_nor_too_small_up_to_10_hz() -> None:
    film = filmed(3)
    track = tracked(film)
    truth = film.truth(track.time)
    inner = slice(300, -300)
    window = np.hanning(len(track.time[inner]))
    for frequency in film.angles.frequency[0]:
        wave = window * np.exp(-2j * np.pi * frequency * track.time[inner])
        ratio = (track.rate[0][inner] @ wave) / (truth.rate[0][inner] @ wave)
        assert abs(ratio - 1.0) < 0.01


def test_a_band_that_is_asked_for_is_kept() -> None:
    track = tracked(filmed(1), keep=25.0)
    assert track.kept == pytest.approx((25.0, 25.0))
    assert np.median(track.u_force) > 3.0 * np.median(tracked(filmed(1)).u_force)


def test_both_conventions_and_any_signs_give_the_same_motion() -> None:
    film = filmed(2, 2000)
    track = tracked(film)
    other = tracked(film, quaternion=film.quaternion * [1.0, -1.0, -1.0, -1.0], convention="world_to_body")
    signs = np.random.default_rng(5).choice([-1.0, 1.0], len(film.time))
    flipped = tracked(film, quaternion=film.quaternion * signs[:, None])
    for name in ("rate", "turning", "force", "up", "u_rate", "u_force"):
        np.testing.assert_allclose(getattr(other, name), getattr(track, name), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(getattr(flipped, name), getattr(track, name), rtol=1e-6, atol=1e-6)


def test_turning_the_world_about_up_changes_neither_rate_nor_force() -> None:
    film = filmed(4, 2000)
    angle = 1.1
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    half = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    w, v = film.quaternion[:, :1], film.quaternion[:, 1:]
    axis = np.broadcast_to(half[1:], v.shape)
    turned = np.concatenate([half[0] * w - v @ half[1:, None], half[0] * v + w * axis + np.cross(axis, v)], axis=1)
    other = tracked(Filmed(film.angles, film.path, film.time, film.position @ turn.T, turned))
    track = tracked(film)
    for name in ("rate", "turning", "force", "up"):
        np.testing.assert_allclose(getattr(other, name), getattr(track, name), rtol=1e-6, atol=1e-6)


def test_a_short_gap_is_bridged_and_a_long_one_is_not_good_and_more_uncertain() -> None:
    film = filmed(0)
    position, quaternion = film.position.copy(), film.quaternion.copy()
    for lost in (slice(1000, 1004), slice(3000, 3100)):
        position[lost], quaternion[lost] = np.nan, np.nan
    track = pose_track(film.time, position, quaternion, convention="body_to_world", up="z", gravity=GRAVITY)
    truth = film.truth(track.time)
    assert track.good[1001:1003].all()
    assert not track.good[3000:3100].any()
    strict = pose_track(
        film.time, position, quaternion, convention="body_to_world", up="z", gravity=GRAVITY, longest=0.01
    )
    assert not strict.good[1000:1004].any()
    assert not track.good[2999]
    assert track.good[3150]
    assert (track.u_force[:, 3050] > 10.0 * np.median(track.u_force, axis=1)).all()
    error = (track.force - truth.force)[:, track.good] / track.u_force[:, track.good]
    assert rms(error) < 1.25
    assert any("longest is 0.35" in note for note in track.notes)
    whole = tracked(film)
    far = np.abs(track.time - film.time[3050]) > 0.5
    assert rms((track.force - whole.force)[:, far]) < 0.5 * float(np.median(whole.u_force))


def test_a_pose_without_noise_gives_the_motion_itself() -> None:
    film = filmed(1, 3000, noise=1e-4)
    track = tracked(film)
    truth = film.truth(track.time)
    assert rms((track.rate - truth.rate)[:, track.good]) < 1e-3 * rms(truth.rate)
    assert rms((track.force - truth.force)[:, track.good]) < 1e-3 * GRAVITY


def test_another_axis_may_point_up_and_the_grid_may_be_another() -> None:
    still = np.tile([1.0, 0.0, 0.0, 0.0], (500, 1)) + 1e-4 * np.random.default_rng(0).normal(size=(500, 4))
    still /= np.linalg.norm(still, axis=1, keepdims=True)
    place = 1e-4 * np.random.default_rng(1).normal(size=(500, 3))
    time = np.arange(500) / 100.0
    track = pose_track(time, place, still, convention="body_to_world", up="-y", gravity=9.8, interval=0.02)
    assert track.interval == 0.02
    assert len(track.time) == 250
    np.testing.assert_allclose(track.up.mean(axis=1), [0.0, -1.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(track.force.mean(axis=1), [0.0, -9.8, 0.0], atol=0.02)


def test_stamps_that_stand_still_are_dropped_and_counted() -> None:
    film = filmed(0, 1500)
    time = film.time.copy()
    time[700] = time[699]
    track = pose_track(time, film.position, film.quaternion, convention="body_to_world", up="z", gravity=GRAVITY)
    assert track.notes[0] == "dropped 1 of 1500 poses: their time stamp did not increase"


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"up": "north"}, "found up 'north', wanted x, y or z"),
        ({"quaternion": np.full((1500, 4), 0.7)}, "found a quaternion of length 1.4, wanted unit length"),
        ({"position": np.zeros((1500, 2))}, "wanted (n,), (n, 3) and (n, 4)"),
        ({"quaternion": np.full((1500, 4), np.nan)}, "found 0 complete poses"),
    ],
)
def test_what_cannot_be_a_pose_track_is_refused(change: dict[str, object], told: str) -> None:
    film = filmed(0, 1500)
    whole = {"time": film.time, "position": film.position, "quaternion": film.quaternion, "up": "z"} | change
    with pytest.raises(BadInput) as caught:
        pose_track(convention="body_to_world", gravity=GRAVITY, **whole)  # type: ignore[arg-type]
    assert told in str(caught.value)


def test_the_band_of_the_inverse_is_that_of_the_whole_inverse() -> None:
    rng = np.random.default_rng(2)
    factor = rng.normal(size=(6, 75))
    factor[0] = np.abs(factor[0]) + 4.0
    lower = np.zeros((75, 75))
    for apart in range(6):
        lower += np.diag(factor[apart, : 75 - apart], -apart)
    whole = np.linalg.inv(lower @ lower.T)
    band = inverse_band(factor)
    for apart in range(6):
        np.testing.assert_allclose(band[apart, : 75 - apart], np.diag(whole, -apart), atol=1e-12)


# A real track: 60 s of fast rotation by hand (BROAD, trial 07). Figures: rms per component after a 20 Hz low pass.


def low_passed(values: Array, interval: float) -> Array:
    sections = butter(4, 20.0, fs=1.0 / interval, output="sos")
    return np.asarray(sosfiltfilt(sections, values, axis=-1), np.float64)


def delayed(values: Array, time: Array, delay: float) -> Array:
    return np.array([np.interp(time - delay, time, row) for row in values])


def left_over(columns: list[Array], wanted: Array, kept: NDArray[np.bool_]) -> tuple[float, Array]:
    matrix = np.stack(columns, axis=-1)[:, kept].reshape(-1, len(columns))
    aim = wanted[:, kept].reshape(-1)
    found = np.linalg.lstsq(matrix, aim, rcond=None)[0]
    return rms(aim - matrix @ found), found


def crossed(one: Array, other: Array) -> Array:
    return np.asarray(np.cross(one.T, other.T).T, np.float64)


@dataclass(frozen=True)
class Real:
    track: PoseTrack
    gyro: Array
    accelerometer: Array
    kept: NDArray[np.bool_]


@pytest.fixture(scope="module")
def real() -> Real:
    path = DATA / "broad-imu-optitrack" / "07_undisturbed_fast_rotation_B_60s.csv"
    if not path.exists():
        pytest.skip(f"no {path}: set RIG_REAL_DATA to the folder with the real measurements")
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    track = pose_track(
        table[:, 0], table[:, 11:14], table[:, 7:11], convention="body_to_world", up="z", gravity=GRAVITY
    )
    gyro, accelerometer = (low_passed(part.T, track.interval) for part in (table[:, 1:4], table[:, 4:7]))
    kept = track.good & (track.time > 5.0) & (track.time < track.time[-1] - 0.5)
    return Real(track, gyro, accelerometer, kept)


def test_the_real_gyro_agrees_with_the_camera_once_its_delay_is_known(real: Real) -> None:
    track = real.track
    assert 0.41 < rms((real.gyro - low_passed(track.rate, track.interval))[:, real.kept]) < 0.45

    def error(delay: float) -> float:
        rate = low_passed(delayed(track.rate, track.time, delay), track.interval)
        columns = [np.outer(np.eye(3)[to], rate[axis]) for to in range(3) for axis in range(3)]
        columns += [np.outer(np.eye(3)[to], np.ones_like(track.time)) for to in range(3)]
        return left_over(columns, real.gyro, real.kept)[0]

    best = minimize_scalar(error, bounds=(-0.02, 0.02), method="bounded")
    assert best.x == pytest.approx(4.17e-3, abs=0.1e-3)
    assert best.fun < 0.075


def test_the_real_accelerometer_agrees_once_tilt_lever_arm_and_delay_are_known(real: Real) -> None:
    track = real.track
    assert 0.95 < rms((real.accelerometer - low_passed(track.force, track.interval))[:, real.kept]) < 1.05

    def repaired(delay: float) -> tuple[float, Array]:
        force, rate, turning = (delayed(one, track.time, delay) for one in (track.force, track.rate, track.turning))
        force = low_passed(force, track.interval)
        axes = [np.outer(np.eye(3)[axis], np.ones_like(track.time)) for axis in range(3)]
        levers = [low_passed(crossed(turning, e) + crossed(rate, crossed(rate, e)), track.interval) for e in axes]
        columns = levers + [crossed(force, e) for e in axes] + axes
        return left_over(columns, real.accelerometer - force, real.kept)

    best = minimize_scalar(lambda delay: repaired(delay)[0], bounds=(-0.02, 0.02), method="bounded")
    error, found = repaired(float(best.x))
    assert best.x == pytest.approx(2.8e-3, abs=0.3e-3)
    assert error < 0.48
    np.testing.assert_allclose(1e3 * found[:3], [0.4, -1.8, 7.5], atol=0.3)  # mm
