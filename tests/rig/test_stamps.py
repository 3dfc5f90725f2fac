"""Stamps in whole steps of an even clock are told from jitter, gaps and uneven clocks."""

from __future__ import annotations

from pathlib import Path

import foreign_data as made
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imported_worlds import evidence, manifest

from rig.foreign.importing import open_manifest
from rig.foreign.stamps import onward, rounded, set_back
from rig.foreign.tables import Foreign, Table
from rig.parts.reading.rest import at_rest

COUNT = 3000


@given(st.floats(40.0, 3000.0), st.sampled_from([1e-3, 4e-3, 1e-2]), st.sampled_from([np.floor, np.rint, np.ceil]))
@settings(deadline=None, max_examples=60)
def test_the_clock_behind_coarse_stamps_is_found(rate: float, step: float, how: np.ufunc) -> None:
    true = 5.0 + np.arange(COUNT) / rate
    stamps = how(true / step) * step
    found = rounded(stamps)
    if abs(round(1.0 / rate / step) - 1.0 / rate / step) < 1e-2:  # nearly whole: there is nothing to find
        return
    assert found is not None
    assert abs(found.interval - 1.0 / rate) * COUNT < 0.6 * step  # rates a beat apart fit the same stamps
    assert np.ptp(found.instants - true) < 0.6 * step
    assert np.abs(found.instants - true).max() < 1.5 * step


def test_stamps_that_are_fine_even_uneven_or_lack_one_are_left_alone() -> None:
    random = np.random.default_rng(2)
    even = np.arange(COUNT) / 128.0
    assert rounded(even) is None
    assert rounded(np.round(even, 6)) is None
    assert rounded(np.arange(COUNT) * 0.01) is None
    assert rounded(np.round(even + 2e-3 * random.normal(size=COUNT), 3)) is None
    assert rounded(np.round(np.delete(even, 1500), 3)) is None
    assert rounded(np.round(np.cumsum(random.uniform(4e-3, 12e-3, COUNT)), 3)) is None
    assert rounded(np.round(even[:30], 3)) is None


@pytest.mark.parametrize(("rate", "step"), [(640.0, 1e-3), (160.0, 4e-3)])
def test_a_density_is_right_though_its_stamps_are_coarse(rate: float, step: float) -> None:
    sigma = 0.03
    values = sigma * np.random.default_rng(5).normal(size=20_000)
    stamps = np.floor(np.arange(20_000) / rate / step) * step
    found = next(at_rest(still(stamps, values)))
    density = found.coefficients["N"]
    assert density.value is not None
    assert density.u is not None
    assert density.value == pytest.approx(sigma / np.sqrt(rate), abs=3.5 * density.u)
    assert density.u < 0.02 * density.value


def still(stamps: np.ndarray, values: np.ndarray) -> Foreign:
    columns = [{"column": "a", "quantity": "acceleration", "unit": "m/s²", "axis": "x"}]
    stated = manifest("static", columns, [{"path": "a.csv"}], time={"column": "t", "unit": "s"})
    return Foreign("made", stated, (Table("a", ("t", "a"), np.column_stack([stamps, values]), {}, False),), ())


def test_import_says_so_and_speaks_of_no_jitter(tmp_path: Path) -> None:
    data = made.turning(seconds=30.0, rate=160.0)
    data["t_s"] = np.round(data["t_s"], 3)
    (tmp_path / "d.csv").write_bytes(made.csv_bytes(data))
    (tmp_path / "m.yaml").write_text(made.turning_manifest("d.csv"), encoding="utf-8")
    (found,) = open_manifest(tmp_path / "m.yaml").found
    assert found.kind == "time_rounded"
    assert "whole multiples of 1 ms of an even clock, one every 6.25 ms" in found.text


def test_a_rotation_with_coarse_stamps_is_compared_as_the_same_with_fine_ones(tmp_path: Path) -> None:
    left = []
    for decimals in (9, 3):
        data = made.turning(seconds=60.0, rate=136.0, delay=0.0)
        data["t_s"] = np.round(data["t_s"], decimals)
        (tmp_path / "d.csv").write_bytes(made.csv_bytes(data))
        (tmp_path / "m.yaml").write_text(made.turning_manifest("d.csv"), encoding="utf-8")
        left.append(evidence(open_manifest(tmp_path / "m.yaml").data).fitted())
    assert left[1].chi2 / left[1].count == pytest.approx(left[0].chi2 / left[0].count, rel=1e-3)


def test_time_goes_on_where_a_clock_was_set_back() -> None:
    true = np.arange(COUNT) * 0.01
    stamps = true.copy()
    stamps[1000:] -= 3600.0
    stamps[2000:] -= 4.0
    assert set_back(stamps).tolist() == [1000, 2000]
    found = onward(stamps)
    assert np.diff(found).min() > 0.0
    assert np.diff(found) == pytest.approx(0.01)


def test_rows_in_disorder_are_no_clock_that_was_set_back() -> None:
    stamps = np.arange(COUNT) * 0.01
    jittered = stamps + 0.02 * np.random.default_rng(1).normal(size=COUNT)
    wrapped = np.mod(stamps, 1.0)
    single = np.where(np.arange(COUNT) == 700, 0.0, stamps)
    for one in (stamps, jittered, wrapped, single, stamps[:30] - 9.0 * (np.arange(30) > 15)):
        assert set_back(one).tolist() == []
        assert onward(one) is one


@pytest.mark.parametrize("back", [3600.0, 7.0])
def test_both_parts_of_a_record_are_compared_when_its_clock_was_set_back(tmp_path: Path, back: float) -> None:
    parts = []
    for seconds in (0.0, back):
        data = made.turning(seconds=60.0, delay=0.0)
        data["t_s"] = data["t_s"] + 5000.0 - seconds * (np.arange(6000) >= 2500)
        (tmp_path / "d.csv").write_bytes(made.csv_bytes(data))
        (tmp_path / "m.yaml").write_text(made.turning_manifest("d.csv"), encoding="utf-8")
        read = open_manifest(tmp_path / "m.yaml")
        parts.append((read, evidence(read.data).fitted()))
    (whole, first), (read, second) = parts
    assert [one.kind for one in (*whole.found, *read.found)] == ["time_set_back"]
    assert "at row 2500" in read.found[0].text
    assert second.count > 0.9 * first.count
    gains = [one.state.local(one.parts[0], 0).sensitivity[1] for one in (first, second)]
    assert gains[1] == pytest.approx(gains[0], abs=3e-4)
