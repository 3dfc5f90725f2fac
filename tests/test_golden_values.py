"""The numbers of standard runs are what they were: `python tests/golden_values.py --renew` keeps new ones."""

from __future__ import annotations

from pathlib import Path

import golden_runs
import golden_values
import pytest
from golden_values import Change, changes


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("scenario", sorted(golden_runs.SCENARIOS))
def test_numbers_of_a_standard_run_are_what_they_were(scenario: str, tmp_path: Path) -> None:
    found = golden_values.measured(scenario, tmp_path)
    relative = golden_values.tolerance(scenario)
    far = [one for one in changes(golden_values.kept(scenario), found) if not one.within(relative)]
    assert not far, "\n".join([f"{len(far)} values changed", *map(str, far[:40])])


def test_a_value_may_move_by_a_millionth_of_its_uncertainty_and_by_no_more() -> None:
    kept = {"gain": {"value": 1.0, "u": 0.01}}
    near, far = {"gain": {"value": 1.0 + 9e-9, "u": 0.01}}, {"gain": {"value": 1.0 + 2e-8, "u": 0.01}}
    assert [one.within(1e-9) for one in changes(kept, near)] == [True]
    (change,) = changes(kept, far)
    assert not change.within(1e-9)
    assert str(change) == "gain / value: 1.0 → 1.00000002 (+2e-06 u)"


def test_text_and_whole_numbers_may_not_move_at_all() -> None:
    kept = {"verdict": "adequate", "mountings": 3, "gone": None}
    found = {"verdict": "missing", "mountings": 4, "new": True}
    said = list(changes(kept, found))
    assert [one.where for one in said] == ["verdict", "mountings", "gone", "new"]
    assert not any(one.within(1.0) for one in said)


def test_only_the_date_in_a_run_s_name_and_where_it_lies_are_left_out() -> None:
    body = {"runs": ["x"], "path": "/tmp/x", "method": "at rest (2026-11-29T104829-noise)", "results": [
        {"channel": "a", "measurand": "offset", "value": 1.5}]}  # fmt: skip
    kept = {"channel": "a", "measurand": "offset", "value": 1.5}
    assert golden_values.plain(body) == {"method": "at rest (noise)", "results": {"a.offset": kept}}


def test_renewing_changes_only_what_is_outside_the_tolerance() -> None:
    before, now = {"a": 1.0, "b": {"c": 2.0}}, {"a": 1.0 + 1e-12, "b": {"c": 3.0}}
    assert golden_values.renewed(before, now, {"b / c"}) == {"a": 1.0, "b": {"c": 3.0}}
    assert Change("b / c", 2.0, 3.0).within(1e-9) is False
