"""An imported record at rest: its mean and its noise against what was put in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from rig.foreign.manifest import from_json
from rig.foreign.tables import Array, Foreign, Table
from rig.parts.reading.rest import AtRest, at_rest


def record(values: Array, time: Array | None = None, **column: Any) -> list[AtRest]:
    """A record of one channel at 100 Hz, or with these stamps, s."""
    body = {
        "format": 1, "kind": "static", "unit": {"serial": "one"}, "provenance": {"source": "made", "licence": "none"},
        "files": [{"path": "a.csv"}], "time": {"rate": "100 Hz"} if time is None else {"column": "t", "unit": "s"},
        "columns": [{"column": "g", "quantity": "rate", "unit": "°/s", "axis": "z", **column}],
    }  # fmt: skip
    stamps = np.arange(len(values)) / 100.0 if time is None else time
    table = Table("a", ("t", "g"), np.stack([stamps, values], axis=1), {}, False)
    return list(at_rest(Foreign("run", from_json(body), (table,), ())))


def test_mean_and_white_noise_come_back_in_si() -> None:
    sigma = 0.2  # °/s per sample at 100 Hz: N = σ/√rate
    found = record(1.5 + sigma * np.random.default_rng(4).standard_normal(20000))[0]
    assert found.mean == pytest.approx(math.radians(1.5), abs=4.0 * math.radians(sigma) / math.sqrt(20000))
    walk = found.coefficients["N"]
    assert walk.value is not None
    assert walk.u is not None
    assert walk.value == pytest.approx(math.radians(sigma) / 10.0, abs=4.0 * walk.u)
    assert walk.u < 0.03 * walk.value
    assert "rad/s/√Hz" in found.in_words


def test_a_channel_with_rows_without_a_number_has_no_noise() -> None:
    values = np.random.default_rng(1).standard_normal(1000)
    values[10] = np.nan
    (found,) = record(values)
    assert (found.coefficients, "found 1 rows without a number" in found.in_words) == ({}, True)


@pytest.mark.parametrize("sigma", [0.25, 0.4, 0.7])
def test_noise_of_less_than_half_a_step_has_no_density(sigma: float) -> None:
    values = np.rint(0.3 + sigma * np.random.default_rng(3).standard_normal(20000))
    (found,) = record(values)
    if sigma < 0.5:
        assert "wanted half a step of its numbers" in found.reason
    else:
        walk = found.coefficients["N"]
        assert walk.value == pytest.approx(math.radians(sigma) / 10.0, rel=0.03)


def test_a_zero_that_drifts_straight_on_is_a_ramp_and_no_random_walk() -> None:
    noise = 0.1 * np.random.default_rng(6).standard_normal(20000)
    (found,) = record(noise + 0.4 * np.linspace(0.0, 1.0, 20000))
    assert found.coefficients["K"].value is None
    ramp = found.coefficients["R"]
    assert ramp.value is not None
    assert ramp.u is not None
    assert ramp.value == pytest.approx(math.radians(0.4) / 200.0, abs=3.0 * ramp.u)
    assert "(a ramp)" in found.in_words


@pytest.mark.parametrize("once", [True, False])
def test_rows_that_stand_apart_show_no_slow_noise_but_those_in_one_stretch_do(once: bool) -> None:
    random, count = np.random.default_rng(8), 40000
    values = 0.02 * random.standard_normal(count) + np.cumsum(2e-4 * random.standard_normal(count))
    number = np.arange(count)
    there = (number < 30000) | (number > 30800) if once else number % 300 < 180
    (found,) = record(values[there], number[there] / 100.0)
    assert found.coefficients["N"].value == pytest.approx(math.radians(0.02) / 10.0, rel=0.05)
    assert ("K" in found.coefficients) == once
    if once:
        walk = found.coefficients["K"]
        assert walk.value is not None
        assert walk.value == pytest.approx(math.radians(2e-4) * 10.0, abs=3.0 * (walk.u or 0.0))
