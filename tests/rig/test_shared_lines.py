"""Lines that a gyro and its encoder share above the compared band, and lines that only one of them has."""

from __future__ import annotations

import numpy as np
import pytest

from rig.motion import Array
from rig.signals.shared_lines import shared_lines

INTERVAL = 0.01
T = INTERVAL * np.arange(12000)
SHAKE, LINE = 0.35, 12.8  # rad/s, Hz


def motion(shaken: float) -> tuple[Array, Array]:
    """Angle and rate of a slow turn to and fro, shaken at the line."""
    slow, fast = 2.0 * np.pi * 0.4, 2.0 * np.pi * LINE
    rate = np.sin(slow * T) + shaken * np.sin(fast * T)
    angle = -np.cos(slow * T) / slow - shaken * np.cos(fast * T) / fast
    return angle, rate


def noisy(angle: Array, rate: Array) -> tuple[Array, Array]:
    random = np.random.default_rng(3)
    return angle + 4e-4 * random.standard_normal(len(T)), rate + 2e-3 * random.standard_normal(len(T))


def test_a_line_in_both_is_found_with_its_size_whatever_the_gyros_gain() -> None:
    angle, rate = motion(SHAKE)
    angle, rate = noisy(angle, 0.95 * rate)
    found = shared_lines(angle, rate, INTERVAL, 5.0)
    assert [one.frequency for one in found] == pytest.approx([LINE], abs=0.1)
    assert found[0].rms == pytest.approx(0.95 * SHAKE / np.sqrt(2.0), rel=0.05)
    assert found[0].ratio == pytest.approx(0.95, abs=0.02)
    assert found[0].coherence > 0.99


def test_a_line_that_only_the_gyro_has_is_no_motion() -> None:
    angle, _ = motion(0.0)
    _, rate = motion(SHAKE)
    assert shared_lines(*noisy(angle, rate), INTERVAL, 5.0) == []


def test_motion_within_the_band_is_not_named_again() -> None:
    assert shared_lines(*noisy(*motion(SHAKE)), INTERVAL, 20.0) == []
