"""A slice of the fault matrix, and that its outcomes are told by number: a wrong number that nobody tells is found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fault_cells import cells
from fault_matrix import Store
from fault_outcomes import BAD, judged, off
from fault_page import page
from faulty_bench import Cell, Said, carried_out

TRUTH = {"sensitivity": {"unit_a_x": 0.066}, "pole": {"unit_a_x": 400.0}}
SLICE: Mapping[str, str] = {
    "sweep: vibrometer, identity, silence": "error",
    "sweep: vibrometer, identity, truncated": "error",
    "sweep: analyzer, identity, wrong identity": "error",
    "sweep: analyzer, identity, garbage": "error",
    "sweep: gateway, hung from the start": "error",
    "tumble: converter, identity, wrong identity": "error",
    "noise: converter, range, previous answer": "error",
    "noise: converter, data, lost frame": "error",
    "noise: converter, data, flipped bit": "error",
    "noise: converter, data, lost conversion": "error",
    "tumble: channel unit_a_x, stuck": "flagged",
    "tumble: cables, unit_a_x and unit_a_y swapped": "flagged",
    "tumble: -, none": "harmless",
}  # fmt: skip
CELLS = {one.name: one for one in cells()}


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Said:
    return carried_out(CELLS["tumble: -, none"], tmp_path_factory.mktemp("clean"))


@pytest.mark.parametrize("name", [name for name in SLICE if "none" not in name])
def test_a_fault_of_the_bench_ends_as_it_should(name: str, clean: Said, tmp_path: Path) -> None:
    cell = CELLS[name]
    said = carried_out(cell, tmp_path)
    assert said.injected or cell.spoilt is None
    rows = clean.rows if cell.procedure == "tumble" else []
    assert judged(said, rows, clean.flags).kind == SLICE[name]


def test_without_a_fault_every_row_is_true_and_nothing_is_said(clean: Said) -> None:
    assert judged(clean, clean.rows, clean.flags).kind == "harmless"
    assert sum(row["key"].endswith("sensitivity_gravity") for row in clean.rows) == 9
    assert all(off(row, clean.truth, clean.rows) < 1.0 for row in clean.rows)


def test_a_planted_wrong_number_is_silent_until_something_says_so(clean: Said) -> None:
    key = "unit_b_y.sensitivity_gravity"

    def with_row(flags: tuple[str, ...] = (), **other: Any) -> Said:
        rows = [row | other if row["key"] == key else row for row in clean.rows]
        return replace(clean, rows=rows, flags=list(flags))

    (row,) = (row for row in clean.rows if row["key"] == key)
    wrong = {"value": row["value"] + 5.0 * row["expanded"]}
    assert judged(with_row(**wrong), clean.rows).kind == "silent"
    assert judged(with_row(value=-row["value"]), clean.rows).kind == "silent"
    assert judged(replace(with_row(**wrong), code=3), clean.rows).kind == "silent"
    assert judged(with_row(**wrong, status="flagged"), clean.rows).kind == "flagged"
    assert judged(with_row(**wrong, verdict="fail"), clean.rows).kind == "flagged"
    assert judged(with_row(**wrong, flags=("reference suspected",)), clean.rows).kind == "flagged"
    assert judged(with_row(**wrong, flags=("as ever",)), clean.rows, ["as ever"]).kind == "silent"
    assert judged(with_row(value=None, status="not determined", verdict="inconclusive"), clean.rows).kind == "flagged"
    assert judged(replace(clean, rows=[r for r in clean.rows if r["key"] != key]), clean.rows).kind == "flagged"


def row(value: float | None, key: str = "unit_a_x.sensitivity", expanded: float = 0.001) -> dict[str, Any]:
    return {"key": key, "value": value, "expanded": expanded, "unit": "V/(m/s²)", "status": "determined",
            "verdict": None, "remarks": []}  # fmt: skip


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ({}, "harmless"),
        ({"rows": [row(0.0679)]}, "harmless"),
        ({"rows": [row(0.0681)]}, "silent"),
        ({"code": 1, "stderr": "error: analyzer at GPIB 19: sent '*IDN?', wanted an answer"}, "error"),
        ({"code": 1, "stderr": "error: something is wrong"}, "unnamed"),
        ({"code": 1, "stderr": "Traceback (most recent call last):\n  …\nKeyError: 'analyzer'"}, "traceback"),
        ({"calibrated_stderr": "Traceback (most recent call last):\nIndexError", "calibrated": 1}, "traceback"),
        ({"code": 70}, "traceback"),
        ({"flags": ["the clock is off"]}, "flagged"),
        ({"calibrated": 3, "calibrated_stderr": "error: unit_a_x: not determined"}, "flagged"),
    ],
)
def test_outcomes_are_told_apart(said: Mapping[str, Any], kind: str) -> None:
    whole = {"code": 0, "stderr": "", "calibrated": 0, "calibrated_stderr": "", "rows": [row(0.066)], "flags": [],
             "truth": TRUTH, "injected": 1, "seconds": 1.0}  # fmt: skip
    assert judged(Said(**{**whole, **said}), [row(0.066)]).kind == kind


def test_what_did_not_end_hung() -> None:
    assert judged(None, []).kind == "hang"


def test_what_is_not_drawn_is_held_to_what_is_found_without_the_fault() -> None:
    offset = row(1.65, "unit_a_x.offset")
    assert (
        off(row(1.6527, "unit_a_x.offset"), TRUTH, [offset]) < 1.0 < off(row(1.653, "unit_a_x.offset"), TRUTH, [offset])
    )
    assert off(row(0.01, "unit_a_x.nonlinearity"), TRUTH, []) > 1.0


def test_the_table_has_four_hundred_cells_with_names_of_their_own() -> None:
    every = list(cells())
    assert len(every) >= 400
    assert len({one.name for one in every}) == len(every)
    assert set(SLICE) <= {one.name for one in every}


def test_the_page_lists_what_must_not_be_and_what_is_harmless(clean: Said) -> None:
    outcomes = {
        Cell("tumble", "converter", "works"): judged(clean, clean.rows),
        Cell("tumble", "converter", "stands still"): judged(None, []),
    }
    text = page(outcomes)
    assert "2 cells: 1 hang, 1 harmless." in text
    assert "| converter | **hang** | stands still |" in text
    assert "- tumble: converter, stands still: did not end" in text
    assert all(kind in text for kind in BAD)
    assert "earlier state" not in text
    assert "1 of the cells were not run again" in page(outcomes, stale=1)


def test_a_cell_that_was_run_with_other_sources_counts_as_stale(clean: Said, tmp_path: Path) -> None:
    cell, other = CELLS["tumble: -, none"], CELLS["noise: -, none"]
    store = Store(tmp_path, stale=True)
    store.keep(cell, clean)
    assert not store.is_stale(cell)
    assert not store.is_stale(other)
    store.path(cell).write_text(store.path(cell).read_text().replace('"of": "', '"of": "x'))
    assert store.is_stale(cell)
    assert Store(tmp_path).kept(cell) is None
