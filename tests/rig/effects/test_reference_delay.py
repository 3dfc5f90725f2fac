"""A late reference against values worked by hand: motion shown at t is what happened later than the reference says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rig.effects.reference_delay import ReferenceDelay
from rig.model import Array, Motion, Stretches

INTERVAL, COUNT = 0.01, 400
T: Array = np.asarray(INTERVAL * np.arange(COUNT), np.float64)
MIDDLE = slice(60, 340)


def moving(rate: Array) -> Motion:
    """Turned about z at a rate (n,), upright."""
    rates, still, one = np.zeros((3, COUNT)), np.zeros((3, COUNT)), np.ones(COUNT)
    rates[2] = rate
    up = np.repeat(np.eye(3)[:, 2:], COUNT, axis=1)
    return Motion(Stretches(INTERVAL, ((0, COUNT),)), "free", 10.0 * up, rates, still, up, 10.0, one, one, T)


@pytest.mark.parametrize(("time", "value"), [(0.125, 0.0), (-0.25, -1.0)])
def test_a_cosine_of_one_hertz_is_a_turn_further_on_for_every_second_it_is_late(time: float, value: float) -> None:
    # cos(2πt) at t = 0.125 and 1.125 later by the time: cos(2π·0.25) = 0; earlier by 0.25 of a turn from t = 0.75: −1
    at = {0.125: 112, -0.25: 75}[time]
    expected = {0.125: math.cos(2.0 * math.pi * 1.245), -0.25: math.cos(2.0 * math.pi * 0.5)}[time]
    found = ReferenceDelay().motion(moving(np.cos(2.0 * math.pi * T)), {"time": time}).rate[2]
    assert found[at] == pytest.approx(expected, abs=2e-3)
    assert found[at] == pytest.approx(value, abs=0.04)


def test_a_ramp_is_ahead_by_its_slope_times_the_time() -> None:
    found = ReferenceDelay().motion(moving(3.0 * T), {"time": 0.02}).rate[2]
    np.testing.assert_allclose(found[MIDDLE], 3.0 * T[MIDDLE] + 0.06, atol=1e-6)


def test_without_a_delay_nothing_changes() -> None:
    motion = moving(np.cos(T))
    assert ReferenceDelay().motion(motion, {"time": 0.0}) is motion


def test_a_constant_is_the_same_however_late_it_is_shown() -> None:
    found = ReferenceDelay().motion(moving(np.full(COUNT, 2.0)), {"time": 0.5})
    np.testing.assert_allclose(found.rate[2], 2.0, atol=1e-12)
    np.testing.assert_allclose(found.force[2], 10.0, atol=1e-12)
