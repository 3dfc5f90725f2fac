"""Allan deviation against the data published with NIST SP 1065, against theory, and its limits against Monte Carlo."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.errors import BadInput
from rig.signals import allan

NBS14 = [892, 809, 823, 798, 671, 644, 883, 903, 677]


def thousand() -> np.ndarray:
    """The 1000-point set of NIST SP 1065 sect. 12.4: a Lehmer generator that starts at 1234567890."""
    numbers = [1234567890]
    while len(numbers) < 1000:
        numbers.append(16807 * numbers[-1] % 2147483647)
    return np.array(numbers) / 2147483647


def test_the_published_ten_point_set_gives_every_printed_digit() -> None:
    _, plain = allan.plain(NBS14, 1.0, [1, 2], minimum_clusters=2)
    overlapping = allan.overlapping(NBS14, 1.0, [1, 2], minimum_clusters=2).deviation
    assert [f"{value:.7g}" for value in plain] == ["91.22945", "115.8082"]
    assert [f"{value:.7g}" for value in overlapping] == ["91.22945", "85.95287"]


def test_the_published_thousand_point_set_gives_every_printed_digit() -> None:
    _, plain = allan.plain(thousand(), 1.0, [1, 10, 100])
    overlapping = allan.overlapping(thousand(), 1.0, [1, 10, 100]).deviation
    assert [f"{value:.6e}" for value in plain] == ["2.922319e-01", "9.965736e-02", "3.897804e-02"]
    assert [f"{value:.6e}" for value in overlapping] == ["2.922319e-01", "9.159953e-02", "3.241343e-02"]


def test_white_noise_falls_with_the_root_of_the_averaging_time_inside_its_limits() -> None:
    rate, density = 100.0, 2.0
    values = np.random.default_rng(4).standard_normal(200_000) * math.sqrt(density * rate / 2)
    found = allan.overlapping(values, rate, confidence=0.999)
    truth = np.sqrt(density / 2 / found.tau)
    assert np.all((found.low < truth) & (truth < found.high))
    assert set(found.kind[found.clusters > 1000]) == {0}


@pytest.mark.parametrize(("kind", "m"), [(0, 10), (0, 80), (-2, 10), (-2, 80)])
def test_stated_limits_hold_the_truth_as_often_as_they_say(kind: int, m: int) -> None:
    inside, n, runs = 0, 2000, 400
    truth = math.sqrt(1 / m) if kind == 0 else math.sqrt((2 * m * m + 1) / (6 * m))  # unit steps
    for seed in range(runs):
        noise = np.random.default_rng(seed).standard_normal(n)
        found = allan.overlapping(noise if kind == 0 else np.cumsum(noise), 1.0, [m], kind=kind)
        inside += bool(found.low[0] < truth < found.high[0])
    assert abs(inside / runs - allan.ONE_SIGMA) < 0.08


@pytest.mark.parametrize("kind", [2, 0, -2])
def test_the_kind_of_noise_is_told_from_the_data(kind: int) -> None:
    white = np.random.default_rng(2).standard_normal(20_000)
    values = {2: np.diff(white), 0: white, -2: np.cumsum(white)}[kind]
    assert set(allan.overlapping(values, 1.0, [1, 4, 16]).kind) == {kind}


def test_fewer_than_nine_clusters_get_no_value_unless_asked_for() -> None:
    values = thousand()
    assert allan.overlapping(values, 1.0, [100, 112, 200]).tau.tolist() == [100.0]
    assert allan.overlapping(values, 1.0, [100, 200], minimum_clusters=5).tau.tolist() == [100.0, 200.0]
    assert allan.overlapping(values, 1.0).clusters.min() >= 9


@given(st.floats(-1e3, 1e3), st.floats(0.01, 100), st.integers(1, 40))
@settings(max_examples=30, deadline=None)
def test_an_offset_changes_nothing_and_a_gain_scales(offset: float, gain: float, m: int) -> None:
    values = thousand()
    one = allan.overlapping(values, 10.0, [m / 10]).deviation
    other = allan.overlapping(values * gain + offset, 10.0, [m / 10]).deviation
    assert other == pytest.approx(gain * one, rel=1e-7)


def test_raw_counts_are_as_good_as_numbers() -> None:
    counts = np.random.default_rng(3).integers(0, 65535, 40_000).astype(np.uint16)
    taus = [1, 7, 50, 1000]
    expected = allan.overlapping(counts.astype(float), 1.0, taus).deviation
    assert allan.overlapping(counts, 1.0, taus).deviation == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("values", "taus", "wanted"),
    [
        ([1.0, 2.0], [1], "at least 3 samples"),
        ([1.0, math.nan, 2.0, 3.0], [1], "wanted numbers"),
        (list(range(20)), [5], "9 clusters"),
    ],
)
def test_a_record_that_cannot_be_used_is_refused(values: list[float], taus: list[float], wanted: str) -> None:
    with pytest.raises(BadInput, match=wanted):
        allan.overlapping(values, 1.0, taus)
