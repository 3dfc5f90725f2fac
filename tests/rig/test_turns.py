"""Gyros that turned a case from pose to pose are held against gravity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from imported_worlds import manifest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.foreign.tables import Foreign, Table
from rig.foreign.turns import findings

Array = NDArray[np.float64]
RATE, STILL, TURN, G = 100.0, 150, 120, 9.80665
COLUMNS = [
    *({"column": f"a{a}", "quantity": "acceleration", "unit": "m/s²", "axis": a} for a in "xyz"),
    *({"column": f"g{a}", "quantity": "rate", "unit": "rad/s", "axis": a} for a in "xyz"),
]


def posed(seed: int, poses: int = 16) -> Array:
    """Accelerometers and gyros (n, 6) with zeros and noise: at rest, then turned about some axis, and so on."""
    random = np.random.default_rng(seed)
    attitude, rows = Rotation.random(random_state=seed), []
    bump = 1.0 - np.cos(2.0 * np.pi * (np.arange(TURN) + 0.5) / TURN)
    for _ in range(poses):
        rows += [np.concatenate([attitude.inv().apply([0.0, 0.0, G]), np.zeros(3)])] * STILL
        axis = random.normal(size=3)
        turn = axis / np.linalg.norm(axis) * random.uniform(0.6, 2.6)
        for share in bump / bump.sum():
            rows.append(np.concatenate([attitude.inv().apply([0.0, 0.0, G]), turn * share * RATE]))
            attitude = attitude * Rotation.from_rotvec(turn * share)
    zeros = np.array([0.3, -0.2, 0.1, 0.01, -0.02, 0.005])
    return np.array(rows) + zeros + np.array([0.02] * 3 + [0.002] * 3) * random.normal(size=(len(rows), 6))


def said(values: Array, **changed: Any) -> list[str]:
    time = np.arange(len(values)) / RATE
    body: Mapping[str, Any] = {"time": {"column": "t", "unit": "s"}, **changed}
    made = manifest("poses", COLUMNS, [{"path": "a.csv"}], **body)
    table = Table("a", ("t", *(one["column"] for one in COLUMNS)), np.column_stack([time, values]), {}, False)
    return [one.text for one in findings(Foreign("made", made, (table,), ()), table)]


@pytest.mark.parametrize("seed", range(4))
def test_a_right_handed_device_in_its_stated_units_is_not_blamed(seed: int) -> None:
    assert said(posed(seed)) == []


@pytest.mark.parametrize("axis", range(3))
def test_an_accelerometer_that_counts_the_other_way_makes_a_left_handed_triad(axis: int) -> None:
    values = posed(axis)
    values[:, axis] *= -1.0
    (found,) = said(values)
    assert f"it would fit with a{'xyz'[axis]} counting the other way (a left-handed triad)" in found


def test_gyros_that_count_the_other_way_are_named() -> None:
    values = posed(5)
    values[:, 4] *= -1.0
    assert "it would fit with gy counting the other way" in said(values)[0]
    values = posed(5)
    values[:, 3:] *= -1.0
    assert "the gyros counting the other way, all three" in said(values)[0]


@pytest.mark.parametrize("order", [(1, 2, 0), (1, 0, 2)])
def test_gyros_along_other_axes_are_named_and_accelerometers_where_it_may_be_they(order: tuple[int, ...]) -> None:
    values = posed(5)
    values[:, 3:] = values[:, 3:][:, order]
    (found,) = said(values)
    shown = ", ".join(f"g{'xyz'[k]} shows +{'xyz'[axis]}" for k, axis in enumerate(order) if k != axis)
    assert f"it would fit with {shown}" in found
    assert (", or a" in found) == (order == (1, 2, 0))  # a mirrored triad of gyros is no triad of accelerometers


def test_rates_in_another_unit_than_stated_are_told_from_a_sensitivity_that_is_off() -> None:
    values = posed(6)
    values[:, 3:] = np.degrees(values[:, 3:])
    assert "it would fit with the gyros in °/s instead of rad/s" in said(values)[0]
    values = posed(6)
    values[:, 3:] /= 1.8
    assert "it would fit with rates 1.8 times what is stated" in said(values)[0]


def test_gyros_that_have_nothing_to_do_with_gravity_are_explained_by_nothing() -> None:
    values = posed(7)
    values[:, 3:] = values[::-1, 3:]
    assert "no sign and no unit explains it" in said(values)[0]


def test_few_turns_and_gaps_say_nothing() -> None:
    values = posed(8, poses=3)
    values[:, 0] *= -1.0
    assert said(values) == []
