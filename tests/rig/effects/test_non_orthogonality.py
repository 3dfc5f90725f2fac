"""Axes that are not square to each other: values worked by hand, the published matrix, and the limit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rig.effects.non_orthogonality import NonOrthogonality
from rig.model import Array, Channels, Motion, Stretches

ANGLES = {"yz": 0.01, "zy": 0.02, "zx": 0.03}
NOTHING = {"yz": 0.0, "zy": 0.0, "zx": 0.0}


def at_rest(force: Array, rate: Array) -> Motion:
    """Instants with this force and rate, (3, n)."""
    ones = np.ones(force.shape[1])
    return Motion(
        Stretches(1.0, ((0, len(ones)),)), "poses", force, rate, 0.0 * rate, force, 10.0, 25.0 * ones, 5.0 * ones,
        0.0 * ones,
    )  # fmt: skip


def channels(*axis: int, rates: bool = False) -> Channels:
    count = len(axis)
    one = np.ones(count)
    return Channels(
        tuple("abc"[:count]), np.full(count, rates), np.array(axis), np.arange(count), np.full(count, math.nan),
        one, one, one, ("unit",) * count,
    )  # fmt: skip


def felt(vectors: Array, *axis: int, rates: bool = False) -> Array:
    """What these axes feel of vectors (3, n) of their kind, while the other kind is something else."""
    other = np.full_like(vectors, 7.0)
    motion = at_rest(other, vectors) if rates else at_rest(vectors, other)
    return NonOrthogonality().felt(vectors[list(axis)], motion, channels(*axis, rates=rates), ANGLES)


@pytest.mark.parametrize("rates", [False, True])
@pytest.mark.parametrize(
    ("vector", "out"),
    [
        ([10.0, 0.0, 0.0], [10.0, 0.0, 0.0]),
        ([0.0, 10.0, 0.0], [0.1, 10.0, 0.0]),
        ([0.0, 0.0, 10.0], [0.003 - 0.2, 0.3, 10.0]),  # yz·zx·f − zy·f
    ],
)
def test_an_axis_takes_a_share_of_those_it_leans_to(vector: list[float], out: list[float], rates: bool) -> None:
    assert felt(np.array([vector]).T, 0, 1, 2, rates=rates)[:, 0] == pytest.approx(out)


def test_the_published_matrix_makes_square_axes_of_what_is_felt() -> None:
    force = np.random.default_rng(1).normal(size=(3, 20))
    square = np.array([[1.0, -0.01, 0.02], [0.0, 1.0, -0.03], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(square @ felt(force, 0, 1, 2), force, atol=1e-14)


def test_every_channel_has_the_angles_of_its_own_axis_in_any_order() -> None:
    force = np.random.default_rng(2).normal(size=(3, 5))
    np.testing.assert_allclose(felt(force, 2, 0), felt(force, 0, 1, 2)[[2, 0]])


def test_without_angles_nothing_changes() -> None:
    force = np.random.default_rng(3).normal(size=(3, 5))
    found = NonOrthogonality().felt(force, at_rest(force, force), channels(0, 1, 2), NOTHING)
    np.testing.assert_array_equal(found, force)
