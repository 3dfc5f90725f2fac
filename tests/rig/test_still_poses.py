"""Still stretches of an accelerometer: found where they were made, counted as published, uncertain as they are."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rig.errors import BadInput
from rig.signals.still_poses import StillPose, still_poses, u_mean

Array = NDArray[np.float64]
DATA = Path(os.environ.get("RIG_REAL_DATA", Path(__file__).parents[3] / "shared" / "data"))
RATE = 100.0


def directions(count: int) -> Array:
    """Unit vectors far from one another."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = 2.399963 * np.arange(count)
    return np.stack([np.sqrt(1 - height**2) * np.cos(angle), np.sqrt(1 - height**2) * np.sin(angle), height], axis=1)


def turned_about(
    seed: int, towards: Array, *, still: float = 4.0, moving: float = 2.0, scale: float = 9.81, zero: float = 0.0
) -> tuple[Array, list[tuple[int, int]]]:
    """A record that rests in each direction in turn, moved by hand in between; and where it rests."""
    rng = np.random.default_rng(seed)
    rest, move = round(still * RATE), round(moving * RATE)
    parts, places, at = [], [], 0
    for number, direction in enumerate(towards):
        places.append((at, at + rest - 1))
        parts.append(np.tile(direction, (rest, 1)))
        at += rest + move
        if number + 1 < len(towards):
            blend = np.linspace(0.0, 1.0, move)[:, None]
            shake = 0.08 * rng.normal(size=(move, 3)) * np.sin(np.pi * blend)
            parts.append((1 - blend) * direction + blend * towards[number + 1] + shake)
    record = np.concatenate(parts)
    return scale * (record + 5e-4 * rng.normal(size=record.shape)) + zero, places


def worst(poses: tuple[StillPose, ...], places: list[tuple[int, int]]) -> int:
    return max(
        max(abs(pose.first - first), abs(pose.last - last)) for pose, (first, last) in zip(poses, places, strict=True)
    )


@pytest.mark.parametrize(("scale", "zero"), [(9.81, 0.0), (1.0, 0.0), (4000.0, 33000.0)])
def test_every_rest_is_found_in_any_unit_and_none_else(scale: float, zero: float) -> None:
    towards = directions(12)
    record, places = turned_about(1, towards, scale=scale, zero=zero)
    poses = still_poses(record, RATE)
    assert len(poses) == 12
    assert worst(poses, places) < 0.5 * RATE
    assert all(pose.distinct for pose in poses)
    for pose, direction, (first, last) in zip(poses, towards, places, strict=True):
        assert pose.first >= first - 1
        assert pose.last <= last + 1
        assert (np.abs(pose.mean - (scale * direction + zero)) < 6.0 * pose.u_mean).all()


def test_the_same_pose_again_is_not_a_new_place() -> None:
    towards = directions(6)[[0, 1, 2, 0, 3, 4, 5, 1]]
    poses = still_poses(turned_about(2, towards)[0], RATE)
    assert [pose.place for pose in poses] == [0, 1, 2, 0, 3, 4, 5, 1]
    assert [pose.distinct for pose in poses] == [True, True, True, False, True, True, True, False]


@pytest.mark.parametrize(("degrees", "places"), [(4.0, 1), (6.0, 2)])
def test_poses_are_two_when_more_than_five_degrees_apart(degrees: float, places: int) -> None:
    tilt = np.radians(degrees)
    poses = still_poses(turned_about(3, np.array([[0.0, 0.0, 1.0], [np.sin(tilt), 0.0, np.cos(tilt)]]))[0], RATE)
    assert sum(pose.distinct for pose in poses) == places
    assert len(poses) == 2


def test_a_record_at_rest_is_one_pose() -> None:
    record = np.array([0.0, 0.0, 9.81]) + 0.01 * np.random.default_rng(0).normal(size=(3000, 3))
    (pose,) = still_poses(record, RATE)
    assert (pose.first, pose.last) == (0, 2999)


def test_a_steady_turn_about_the_vertical_is_no_rest_once_the_gyro_is_looked_at() -> None:
    rng = np.random.default_rng(4)
    record = np.array([0.0, 0.0, 9.81]) + 0.01 * rng.normal(size=(3000, 3))
    gyro = 0.3 + 0.05 * rng.normal(size=(3000, 3))  # deg/s, with its bias
    gyro[1200:1700, 2] += 20.0
    assert len(still_poses(record, RATE)) == 1
    poses = still_poses(record, RATE, gyro=gyro)
    assert len(poses) == 2
    assert abs(poses[0].last - 1200) < 30
    assert abs(poses[1].first - 1700) < 30


@pytest.mark.parametrize("memory", [0.0, 0.9])
def test_the_uncertainty_of_the_mean_holds_for_white_and_for_slow_noise(memory: float) -> None:
    rng = np.random.default_rng(5)
    ratios = []
    for _ in range(300):
        noise = rng.normal(size=(1000, 3))
        for at in range(1, 1000) if memory else ():
            noise[at] += memory * noise[at - 1]
        ratios.append(noise.mean(axis=0) / u_mean(noise))
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.2


@pytest.mark.parametrize(
    ("record", "told"),
    [
        (np.zeros((3000, 2)), "found acceleration of shape (3000, 2)"),
        (np.full((3000, 3), np.nan), "missing numbers"),
        (np.zeros((3000, 3)), "without any noise"),
        (np.ones((100, 3)), "found 1 s, wanted 8 s or more"),
    ],
)
def test_what_cannot_be_searched_is_refused(record: Array, told: str) -> None:
    with pytest.raises(BadInput) as caught:
        still_poses(record, RATE)
    assert told in str(caught.value)


def real(*parts: str) -> Path:
    path = DATA.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"no {path}: set RIG_REAL_DATA to the folder with the real measurements")
    return path


def gravity_error(terms: Array, means: Array) -> Array:
    """|a| − g for zero (3) and upper triangular scale (6), m/s²."""
    triangle = np.zeros((3, 3))
    triangle[np.triu_indices(3)] = terms[3:] / 400.0
    return np.asarray(np.linalg.norm((means - terms[:3]) @ triangle.T, axis=1) - 9.81744)


def test_the_published_38_poses_are_found_and_fit_gravity_to_a_milli_metre_per_second_squared() -> None:
    table = np.genfromtxt(real("imu-tk-xsens-multiposition", "xsens_acc_gyro_raw.csv"), delimiter=",", skip_header=1)
    for gyro in (None, table[:, 4:7]):
        poses = still_poses(table[:, 1:4], RATE, gyro=gyro)
        assert len(poses) == 38
        assert poses[0].first == 0
        assert poses[0].last / RATE > 50.0
        means = np.array([pose.mean for pose in poses])
        start = np.concatenate([means.mean(axis=0), [1.0, 0.0, 0.0, 1.0, 0.0, 1.0]])
        fit = least_squares(gravity_error, start, args=(means,), x_scale=np.abs(start) + 0.01)
        assert np.sqrt(np.mean(fit.fun**2)) < 0.0012


def test_the_six_faces_of_a_ferraris_session_are_found_where_they_are_labelled() -> None:
    table = np.genfromtxt(real("imucal-ferraris", "example_ferraris_session.csv"), delimiter=",", skip_header=1)
    labels = json.loads(real("imucal-ferraris", "example_ferraris_session_list.json").read_text())
    poses = still_poses(table[:, 4:7], 102.4, gyro=table[:, 1:4])
    assert sum(pose.distinct for pose in poses) == 6
    faces = {name: at for name, at in labels.items() if not name.endswith("_rot")}
    found = [
        pose.place for at in faces.values() for pose in poses if pose.first <= at["start"] < at["end"] <= pose.last
    ]
    assert sorted(found) == [0, 1, 2, 3, 4, 5]
    for name in set(labels) - set(faces):
        inside = [pose for pose in poses if labels[name]["start"] < pose.first and pose.last < labels[name]["end"]]
        assert not inside
