"""Tumbles on the fitted model: gravity's values are true within what they state, and agree with the direct ones."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache

import fast_bench
import numpy as np
import pytest

from rig.calibrate import triad
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration, Check, Result

SEEDS = range(1, 9)
NOISE = {"procedure": "noise", "length": "60 s", "cables": "shaker"}
TILTED = {"name": "cross_axis", "parameters": {"quantity": "acceleration", "share": 0.05}}


@cache
def made(seed: int, hidden: str = "", poses: int = 24) -> Calibration:
    effects = {"": [], "tilted": [TILTED], "quadratic": [
        {"name": "quadratic", "parameters": {"quantity": "acceleration", "coefficient": 2e-3}}]}  # fmt: skip
    world = fast_bench.world(seed, effects[hidden])
    runs = [fast_bench.measure(one, world) for one in ({"procedure": "tumble", "poses": poses}, NOISE)]
    return calibrate(runs, "made")


def found(measurand: str, truth: str) -> Iterator[tuple[Result, Check, float]]:
    """Results of the triads with their direct estimates and true values, over some worlds."""
    for seed in SEEDS:
        true = fast_bench.world(seed).truth[truth]
        for result in made(seed).of(measurand):
            assert result.check is not None
            yield result, result.check, true[result.channel]


@pytest.mark.parametrize(("measurand", "truth"), [("sensitivity_gravity", "sensitivity"), ("offset", "zero")])
def test_values_on_the_model_are_true_within_their_uncertainty_and_agree_with_the_direct_ones(
    measurand: str, truth: str
) -> None:
    rows = list(found(measurand, truth))
    assert len(rows) == 9 * len(SEEDS)
    away = np.array([(float(result.value or 0.0) - true) / _u(result) for result, _, true in rows])
    delta = np.array([check.delta / check.u_delta for _, check, _ in rows])
    assert 0.5 < math.sqrt(float(np.mean(away**2))) < 1.25
    assert np.abs(away).max() < 4.0
    assert 0.75 < math.sqrt(float(np.mean(delta**2))) < 1.25
    assert np.mean([check.agrees for _, check, _ in rows]) > 0.88
    assert all(result.method.startswith("model fitted to all records of the tumble") for result, _, _ in rows)


def _u(result: Result) -> float:
    """Without the gain of the converter, which is exact here."""
    return math.hypot(*(c.contribution for c in result.contributions if c.name != "converter gain"))


def test_the_budget_has_the_noise_of_the_fit_and_the_uncertainty_of_gravity() -> None:
    result = made(1).result("unit_a_x.sensitivity_gravity")
    noise, gravity, gain, temperature = result.contributions
    assert (noise.name, gravity.name) == ("noise and wandering", "local gravity")
    assert {gain.name, temperature.name} == {"converter gain", "temperature"}
    assert result.value is not None
    assert gravity.contribution == pytest.approx(result.value * gravity.u, rel=1e-3)
    offset = made(1).result("unit_a_x.offset")
    named = [line.name for line in offset.contributions]
    assert named == ["noise and wandering", "converter gain"]  # a common wander is in the first
    assert offset.check is not None
    assert offset.u > 2.0 * offset.check.u


def test_a_sensitivity_is_along_the_channels_own_axis_wherever_that_points() -> None:
    """√(1 + 0.05²) is 1 + 1.25e-3, ten times what a value is uncertain by."""
    own = math.hypot(1.0, 0.05)
    for channel in ("unit_a_x", "unit_b_y", "unit_b_z"):
        true = float(fast_bench.world(1).truth["sensitivity"][channel])
        result = made(1, "tilted").result(f"{channel}.sensitivity_gravity")
        assert result.check is not None
        assert result.check.agrees
        assert result.value is not None
        assert abs(result.value - own * true) < 3.0 * result.u
        assert abs(result.value - true) > 3.0 * result.u


def test_an_effect_that_the_model_lacks_flags_its_values() -> None:
    result = made(1, "quadratic").result("unit_a_x.sensitivity_gravity")
    assert result.status == "flagged"
    assert "leaves more than noise on the tumble (gravity, poses" in result.remarks[0]
    assert "u of the noise is widened" in result.remarks[0]
    assert result.u > 2.0 * made(1).result("unit_a_x.sensitivity_gravity").u


@pytest.mark.parametrize("poses", [6, 12])
def test_poses_that_leave_the_axes_open_have_the_direct_value_and_say_so(poses: int) -> None:
    result = made(1, poses=poses).result("unit_a_x.sensitivity_gravity")
    assert result.check is None
    assert result.status == "determined"
    assert result.remarks[-1].endswith(
        f"{poses} poses leave the angles between the axes open (`rig tumble --poses 24`)"
    )
    true = float(fast_bench.world(1).truth["sensitivity"]["unit_a_x"])
    assert abs(float(result.value or 0.0) - true) < 3.5 * result.u


def test_derivatives_by_the_readings_are_those_of_the_fit() -> None:
    draw = np.random.default_rng(4)
    up = draw.normal(size=(15, 3))
    up /= np.linalg.norm(up, axis=1)[:, None]
    matrix = np.array([[0.066, 0.001, -0.002], [0.0, 0.065, 0.001], [0.002, 0.0, 0.067]])
    volts = 9.81 * up @ matrix.T + 1.6 + 1e-4 * draw.normal(size=up.shape)

    def fit(readings: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> triad.Directions:
        return triad.fit_directions(readings, up, 9.81, 1e-5, np.full(3, 1e-4), 0.005)

    at, step = fit(volts), np.zeros_like(volts)
    step[6, 1] = 1e-3
    change = (fit(volts + step).sizes[0] - fit(volts - step).sizes[0]) / 2e-3
    np.testing.assert_allclose(at.own_axes[:, 6, 1], change, atol=2e-3 * np.abs(at.own_axes).max())
    change = (fit(volts + step).offsets - fit(volts - step).offsets) / 2e-3
    np.testing.assert_allclose(at.by_readings[:, 3, 6, 1], change, atol=2e-3 * np.abs(at.by_readings[:, 3]).max())
