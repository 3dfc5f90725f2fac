"""An imported record at rest: its mean and its noise against what was put in."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from rig.foreign.manifest import from_json
from rig.foreign.tables import Array, Foreign, Table
from rig.parts.reading.rest import AtRest, at_rest


def record(values: Array, **column: Any) -> list[AtRest]:
    """A record of one channel at 100 Hz."""
    body = {
        "format": 1, "kind": "static", "unit": {"serial": "one"}, "provenance": {"source": "made", "licence": "none"},
        "files": [{"path": "a.csv"}], "time": {"rate": "100 Hz"},
        "columns": [{"column": "g", "quantity": "rate", "unit": "°/s", "axis": "z", **column}],
    }  # fmt: skip
    table = Table("a", ("g",), values[:, None], {}, False)
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
