"""A reference whose frame is turned against the case, against values worked by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rig.effects.reference_tilt import ReferenceTilt
from rig.model import Motion, Stretches

STRAIGHT = {"x": 0.0, "y": 0.0, "z": 0.0}


def still(place: str = "free", axis: int = 2, rate: float = 2.0) -> Motion:
    """One instant with gravity of 10 m/s² along z, turning about one axis."""
    one, up, about = np.ones(1), np.eye(3)[:, 2:], np.eye(3)[:, axis : axis + 1]
    return Motion(
        Stretches(0.01, ((0, 1),)), place, 10.0 * up, rate * about, 3.0 * about, up, 10.0, one, one, 0.0 * one
    )


@pytest.mark.parametrize(
    ("at", "force"),
    [
        ({**STRAIGHT, "x": math.pi / 2.0}, [0.0, -10.0, 0.0]),  # a quarter turn about x takes z to −y
        ({**STRAIGHT, "y": math.pi / 6.0}, [5.0, 0.0, 8.660254]),  # 30° about y: 10·sin 30°, 10·cos 30°
    ],
)
def test_force_rate_and_up_turn_together(at: dict[str, float], force: list[float]) -> None:
    moved = ReferenceTilt().motion(still(), at)
    np.testing.assert_allclose(moved.force[:, 0], force, atol=1e-6)
    np.testing.assert_allclose(moved.up[:, 0], np.array(force) / 10.0, atol=1e-7)
    np.testing.assert_allclose(moved.rate[:, 0], np.array(force) / 5.0, atol=1e-6)
    np.testing.assert_allclose(moved.turning[:, 0], np.array(force) * 0.3, atol=1e-6)


def test_small_angles_add_a_share_of_the_other_axes_with_opposite_signs() -> None:
    moved = ReferenceTilt().motion(still(axis=0), {"x": 0.0, "y": 1e-4, "z": 2e-4})
    np.testing.assert_allclose(moved.rate[:, 0], [2.0, 4e-4, -2e-4], atol=1e-7)
    np.testing.assert_allclose(moved.force[:, 0], [1e-3, 0.0, 10.0], atol=1e-6)


def test_turned_about_the_shaft_of_a_rotation_nothing_changes() -> None:
    motion = still("rotation")
    moved = ReferenceTilt().motion(motion, {**STRAIGHT, "z": 0.5})
    np.testing.assert_array_equal(moved.rate, motion.rate)
    np.testing.assert_array_equal(moved.force, motion.force)


def test_straight_is_straight() -> None:
    moved = ReferenceTilt().motion(still(), STRAIGHT)
    np.testing.assert_array_equal(moved.force, still().force)
