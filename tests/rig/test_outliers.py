"""Numbers that stand for nothing and rows that stand alone are found; noise, motion and coarse steps are neither."""

from __future__ import annotations

from pathlib import Path

import foreign_data as made
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.archive.records import Records
from rig.archive.runs import Runs
from rig.foreign.importing import keep, open_manifest
from rig.foreign.outliers import alone, marks
from rig.foreign.tables import foreign_of
from rig.parts.reading.rest import at_rest

Array = NDArray[np.float64]
T = np.arange(3000) / 100.0
CLEAN = {
    "noise": np.random.default_rng(1).normal(size=3000),
    "heavy tails": np.random.default_rng(2).standard_t(5.0, size=3000),
    "a fast sine": np.sin(2.0 * np.pi * 37.0 * T),
    "a slow one with noise": 40.0 * np.sin(T) + 0.1 * np.random.default_rng(3).normal(size=3000),
    "coarse steps": np.round(0.3 * np.random.default_rng(4).normal(size=3000)),
    "a knock": np.exp(-((T - 15.0) ** 2) / 1e-3) * np.sin(200.0 * T)
    + 1e-3 * np.random.default_rng(5).normal(size=3000),
    "a step": np.where(T > 12.0, 5.0, 0.0) + 0.01 * np.random.default_rng(6).normal(size=3000),
}


@pytest.mark.parametrize("kind", CLEAN)
def test_nothing_is_found_in_what_a_sensor_shows(kind: str) -> None:
    assert list(marks(CLEAN[kind])) == []
    assert alone(CLEAN[kind]).tolist() == []


@given(st.sets(st.integers(1, 2998), min_size=1, max_size=15), st.sampled_from([-999.0, 9999.0, -2000.0, 32767.0]))
@settings(deadline=None, max_examples=25)
def test_a_mark_is_found_in_all_its_rows(rows: set[int], value: float) -> None:
    values = CLEAN["a slow one with noise"].copy()
    values[sorted(rows)] = value
    (found,) = marks(values)
    assert (found.value, found.rows.tolist()) == (value, sorted(rows))
    assert -41.0 < found.low < found.high < 41.0


def test_two_marks_are_two() -> None:
    values = CLEAN["noise"].copy()
    values[[5, 900]], values[[7, 8, 9]] = -9999.0, 1e6
    assert {(one.value, len(one.rows)) for one in marks(values)} == {(-9999.0, 2), (1e6, 3)}


@given(st.sets(st.integers(5, 290), min_size=1, max_size=4), st.floats(12.0, 60.0))
@settings(deadline=None, max_examples=25)
def test_rows_that_stand_alone_within_the_range_of_the_rest_are_found(tens: set[int], jump: float) -> None:
    values = CLEAN["a slow one with noise"].copy()
    rows = sorted(10 * one for one in tens)
    values[rows] += jump
    assert alone(values).tolist() == rows


def test_a_mark_is_named_at_import_has_no_noise_and_is_no_number_once_it_is_stated(tmp_path: Path) -> None:
    data = made.resting()
    data["acc_x_g"][[100, 101, 1700]] = -999.0
    (tmp_path / "d.csv").write_bytes(made.csv_bytes(data))
    text = made.resting_manifest("d.csv")
    (tmp_path / "m.yaml").write_text(text, encoding="utf-8")
    read = open_manifest(tmp_path / "m.yaml")
    assert "acc_x_g: 3 rows hold -999, all others lie within" in read.found[0].text
    assert "3 rows hold -999" in next(at_rest(read.data)).in_words
    stated = text.replace("column: acc_x_g,", "column: acc_x_g, missing: -999.0,")
    (tmp_path / "m.yaml").write_text(stated, encoding="utf-8")
    read = open_manifest(tmp_path / "m.yaml")
    assert [one.kind for one in read.found] == ["not_numbers"]
    runs = Runs(tmp_path / "runs")
    kept = foreign_of(Records(runs.open(keep(read, runs))))
    assert np.count_nonzero(np.isnan(kept.si(kept.tables[0], kept.manifest.columns[0]))) == 3
    assert read.files[0].table.values[100, 1] == -999.0  # as it stood in the file
