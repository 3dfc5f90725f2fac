"""A tumble as data: the poses, and what they can tell apart."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from procedures.tumble import Settings, expand, poses
from rig.bench.steps import Ask, BenchFacts, Static


def test_six_poses_are_the_faces_of_the_cube() -> None:
    assert sorted(poses(6)) == sorted(
        tuple(sign if i == axis else 0.0 for i in range(3)) for axis in range(3) for sign in (1.0, -1.0)
    )


@pytest.mark.parametrize("number", [6, 12, 24])
def test_poses_are_different_unit_vectors_and_cancel_over_the_set_but_for_the_wedge(number: int) -> None:
    found = np.array(poses(number))
    assert found.shape == (number, 3)
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.ones(number))
    assert len({tuple(np.round(pose, 9)) for pose in found}) == number


@pytest.mark.parametrize("number", [12, 24])
def test_tilted_poses_stand_on_one_wedge_of_thirty_degrees(number: int) -> None:
    for pose in poses(number):
        sizes = sorted(abs(value) for value in pose)
        assert sizes == pytest.approx([0.0, 0.5, math.cos(math.radians(30.0))])


@pytest.mark.parametrize("number", [6, 12, 24])
def test_a_set_of_poses_separates_bias_from_sensitivity_and_cross_axis(number: int) -> None:
    design = np.column_stack([np.array(poses(number)), np.ones(number)])
    assert np.linalg.matrix_rank(design) == 4
    assert np.linalg.cond(design) < 4.0


def test_a_run_puts_the_cube_down_and_records_for_every_pose(facts: BenchFacts) -> None:
    plan = expand(Settings.model_validate({"poses": 12, "record": "3 s"}), facts)
    assert plan.points == 12
    assert plan.mistakes == ()
    pairs = list(zip(plan.steps[1::2], plan.steps[2::2], strict=True))
    for (ask, static), up in zip(pairs, poses(12), strict=True):
        assert isinstance(ask, Ask)
        assert tuple(ask.request.settings[f"up_{axis}"] for axis in "xyz") == up
        assert isinstance(static, Static)
        assert (static.seconds, static.purpose) == (3.0, "pose")


def test_every_mistake_is_told_at_once_with_its_key(facts: BenchFacts) -> None:
    plan = expand(Settings.model_validate({"record": "2 h"}), replace(facts, has=frozenset()))
    assert [mistake.path for mistake in plan.mistakes] == [("record",), ("procedure",)]
