"""Means of records made apart: noise from their spectra, and a variance between them where noise is not all."""

from __future__ import annotations

import numpy as np
import pytest

from rig.signals.noise import NoiseModel
from rig.signals.record_means import Means, between, noise_of, wandering
from rig.signals.spectrum import Density

SIGMA = 2e-3


def _levels(seed: int, count: int, apart: float) -> np.ndarray:
    random = np.random.default_rng(seed)
    return 0.7 + np.hypot(SIGMA, apart) * random.normal(size=count)


def _means(values: np.ndarray, power: np.ndarray, *beside: np.ndarray) -> Means:
    begin = np.arange(float(len(values)))
    return Means(values, begin, begin + 0.9, power, np.array(beside).reshape(len(beside), len(values)))


@pytest.mark.parametrize("apart", [0.0, 4e-3, 2e-2])
def test_the_variance_between_is_right_in_the_median(apart: float) -> None:
    found = [
        between(_levels(seed, 6, apart), SIGMA**2 * np.eye(6), np.ones((6, 1))) for seed in range(400)
    ]  # fmt: skip
    assert float(np.median(found)) == pytest.approx(apart**2, rel=0.15, abs=0.05 * SIGMA**2)


def test_what_the_means_follow_is_not_between_them() -> None:
    power = np.linspace(0.0, 1.0, 8) ** 2
    found = []
    for seed in range(100):
        means = _means(_levels(seed, 8, 0.0) + 0.4 * power, power)
        found.append([between(means.values, SIGMA**2 * np.eye(8), means.design[:, :k]) for k in (1, 2)])
    assert np.median(found, axis=0) == pytest.approx([0.16 * power.var(ddof=1) * 7.0 / 6.35, 0.0], rel=0.05, abs=1e-7)


@pytest.mark.parametrize(("apart", "files"), [(0.0, 4), (4e-3, 4), (8e-3, 9)])
def test_a_mean_errs_as_much_as_noise_and_what_is_between_say(apart: float, files: int) -> None:
    pulls = []
    for seed in range(1500):
        values = _levels(seed, files, apart)
        found = between(values, SIGMA**2 * np.eye(files), np.ones((files, 1)))
        pulls.append((values.mean() - 0.7) / np.sqrt((SIGMA**2 + found) / files))
    assert 0.8 < float(np.sqrt(np.mean(np.square(pulls)))) < 1.3


def test_the_power_is_looked_at_first_and_the_rest_only_with_three_records_for_each() -> None:
    random = np.random.default_rng(1)
    odd = np.vstack([np.full((1, 13), 23.0), np.full((1, 13), np.nan)])
    varied = random.normal(size=(3, 13))
    columns = {
        n: _means(np.zeros(n), varied[0, :n], *varied[1:, :n], *odd[:, :n]).design.shape[1] for n in range(1, 14)
    }
    assert columns == {1: 1, 2: 1} | dict.fromkeys(range(3, 10), 2) | {10: 3, 11: 3, 12: 3, 13: 4}
    assert _means(np.zeros(13), np.zeros(13), *odd).design.shape == (13, 1)
    assert between(np.array([0.3]), np.eye(1), np.ones((1, 1))) == 0.0


def test_the_quieter_spectrum_counts_and_flicker_that_no_line_shows_does_not() -> None:
    f = np.geomspace(0.1, 50.0, 60)
    dof = np.full(60, 40.0)
    drawn = np.random.default_rng(2).chisquare(40.0, size=60) / 40.0
    quiet, loud = Density(f, 1e-6 * drawn, dof), Density(f, 9e-6 * drawn, dof)
    rising = Density(f, (1e-6 + 3e-6 / f) * drawn, dof)
    begin = np.arange(4) * 20.0
    means = Means(np.full(4, 0.1), begin, begin + 10.0, np.zeros(4), np.empty((0, 4)))
    model = noise_of([loud, quiet], 100.0, None, means)
    assert (model.white, model.flicker, model.apart) == (pytest.approx(1e-6, rel=0.1), 0.0, 0.0)
    assert noise_of([rising], 100.0, None, means).flicker == pytest.approx(3e-6, rel=0.2)


def test_a_variance_of_each_blocks_own_is_on_the_diagonal_alone() -> None:
    begin, end = np.array([0.0, 3.0, 9.0]), np.array([2.0, 5.0, 12.0])
    plain = NoiseModel(100.0, 1e-6, flicker=1e-7).covariance(begin, end)
    whole = NoiseModel(100.0, 1e-6, flicker=1e-7, apart=4e-6).covariance(begin, end)
    assert whole - plain == pytest.approx(4e-6 * np.eye(3), abs=1e-18)


def test_a_zero_that_wanders_is_named() -> None:
    model = NoiseModel(100.0, 2e-6)
    assert wandering("acc_x", "m/s²", model, 10.0) == []
    (said,) = wandering("acc_x", "m/s²", NoiseModel(100.0, 2e-6, apart=1e-4), 10.0)
    assert "acc_x wanders by 0.01 m/s² from file to file, 32 times" in said
