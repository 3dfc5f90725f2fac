"""Rows that a smooth signal about them contradicts are found at some standard deviations; noise and motion are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.foreign.isolated import isolated

Array = NDArray[np.float64]
T = np.arange(3000) / 100.0
CLEAN = {
    "heavy tails": np.random.default_rng(2).standard_t(5.0, size=3000),
    "a fast sine": np.sin(2.0 * np.pi * 37.0 * T),
    "coarse steps": np.round(0.3 * np.random.default_rng(4).normal(size=3000)),
    "a knock": np.exp(-((T - 15.0) ** 2) / 1e-3) * np.sin(200.0 * T)
    + 1e-3 * np.random.default_rng(5).normal(size=3000),
}
NOISE, ROWS = 0.01, 4000


def moving(seed: int, jitter: float = 0.0) -> tuple[Array, Array]:
    """Times of rows that are a tenth of an interval uneven, stamped with some jitter, and a motion of 300 times the
    noise up to 3 Hz at 100 rows per second."""
    random = np.random.default_rng(seed)
    t = np.cumsum(0.01 * (1.0 + 0.1 * random.uniform(-1.0, 1.0, ROWS)))
    motion = sum(np.sin(2.0 * np.pi * f * t + k) for k, f in enumerate((0.3, 1.1, 3.0)))
    return t + jitter * random.normal(size=ROWS), np.asarray(motion) + NOISE * random.normal(size=ROWS)


@pytest.mark.parametrize("kind", CLEAN)
def test_nothing_is_found_in_what_a_sensor_shows(kind: str) -> None:
    assert isolated(CLEAN[kind], T).tolist() == []


@pytest.mark.parametrize("jitter", [0.0, 1e-4, 1e-3])
def test_nothing_is_found_in_motion_with_stamps_that_jitter(jitter: float) -> None:
    assert [isolated(values, time).tolist() for time, values in (moving(seed, jitter) for seed in range(12))] == [
        []
    ] * 12


@pytest.mark.parametrize("seed", range(4))
def test_five_rows_of_thirteen_standard_deviations_are_found_amid_motion(seed: int) -> None:
    time, values = moving(seed)
    rows = np.random.default_rng(seed + 50).choice(np.arange(20, ROWS - 20, 12), 5, replace=False)
    values[rows] += 13.4 * NOISE
    found = set(isolated(values, time).tolist())
    assert found <= set(rows.tolist())
    assert len(found) >= 3


AT = 1000 + int(np.argmax(np.abs(np.gradient(moving(7)[1])[1000:3000])))  # where it moves fastest


def held(values: Array) -> Array:
    values[AT + 1 : AT + 3] = values[AT]
    return values


def knocked(values: Array) -> Array:
    values[AT : AT + 12] += 0.5 * np.random.default_rng(3).normal(size=12)
    return values


def stepped(values: Array) -> Array:
    values[AT:] += 1.0
    return values


@pytest.mark.parametrize(("change", "some"), [(held, True), (knocked, False), (stepped, False)])
def test_what_is_held_for_two_rows_stands_alone_and_what_lasts_or_stays_does_not(
    change: Callable[[Array], Array], some: bool
) -> None:
    time, values = moving(7)
    found = isolated(change(values), time)
    assert (len(found) > 0) == some
    assert set(found.tolist()) <= {AT, AT + 1, AT + 2}


@pytest.mark.parametrize("row", [4, 7, ROWS - 9, ROWS - 4])
def test_a_row_that_stands_alone_is_found_near_either_end_too(row: int) -> None:
    """As of a pose, which is a piece by itself."""
    time, values = moving(3)
    values[row] += 25.0 * NOISE
    assert isolated(values, time).tolist() == [row]


STILL, CYCLE = 600, 1000  # rows that a pose rests, and till the next one rests


def handled(seed: int) -> Array:
    """Eight poses at rest, and moves between them with knocks that ring for a third of a row up to ten rows."""
    random, t = np.random.default_rng(seed), np.arange(8 * CYCLE)
    values = NOISE * random.normal(size=len(t))
    moving = np.clip((t % CYCLE - STILL) / (CYCLE - STILL), 0.0, 1.0)
    for f in (0.9, 1.7, 2.9):
        values += np.sin(np.pi * moving) ** 2 * np.sin(2.0 * np.pi * f * t / 100.0 + random.uniform(0.0, 6.0))
    at = random.choice(np.flatnonzero((moving > 0.1) & (moving < 0.9)), 60, replace=False) + random.uniform(size=60)
    for start, lasts, height in zip(at, 10.0 ** random.uniform(-0.5, 1.0, 60), random.normal(size=60), strict=True):
        since = np.maximum(t - start, 0.0)
        values += (t >= start) * 0.4 * height * np.exp(-since / lasts) * np.cos(2.5 * since)
    return values


@pytest.mark.parametrize("seed", range(4))
def test_of_a_case_that_is_handled_knocks_within_a_row_are_motion_and_glitches_at_rest_are_found(seed: int) -> None:
    values = handled(seed)
    rows = STILL // 2 + CYCLE * np.arange(5)
    values[rows] += 30.0 * NOISE
    found = set(isolated(values, np.arange(len(values)) / 100.0).tolist())
    assert set(rows.tolist()) <= found
    assert len(found - set(rows.tolist())) <= 6  # of 60
