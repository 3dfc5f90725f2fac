"""What an effect "would leave" is said only of effects that were refitted in full, and adding it leaves just that."""

from __future__ import annotations

from functools import lru_cache

import fast_bench
import pytest

from rig.cli.repair import diagnosis_text
from rig.diagnose import search
from rig.diagnose.conclusion import Conclusion, conclude
from rig.fit import fit as fitting
from rig.repair import repair
from rig.repair.repair import Bench
from rig.shelf import shelf

BENT = {"name": "quadratic", "parameters": {"quantity": "acceleration", "coefficient": 1e-3}}
WARM = {"name": "temperature_scale", "parameters": {"quantity": "acceleration", "coefficient": 1e-3}}
SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 8}


@lru_cache(maxsize=1)
def bent() -> tuple[Bench, Conclusion]:
    bench = repair.bench_of([fast_bench.measure(SWEEP, fast_bench.world(5, [BENT]))], shelf())
    return bench, conclude(bench.evidence, [], shelf())


def test_what_an_effect_would_leave_is_what_adding_it_leaves() -> None:
    bench, said = bent()
    told = [one for one in said.excluded if one.error_after is not None]
    assert told
    for one in told:
        name, _, on = one.effect.partition(" (")
        made = repair.added(bench, repair.new(bench, "datasheet"), name, on.rstrip(")") or None)  # type: ignore[arg-type]
        assert one.error_after == pytest.approx(made.after.error, rel=1e-3)


def test_of_what_came_nowhere_near_no_number_is_said() -> None:
    _, said = bent()
    far = [one for one in said.excluded if one.error_after is None]
    assert far
    lines = diagnosis_text(said)
    for one in far:
        assert one.as_json()["error_after"] is None
        (line,) = [line for line in lines if f" {one.effect}, not refitted: " in line]
        assert "would leave" not in line


def test_everything_within_reach_of_the_best_is_refitted_until_nothing_changes() -> None:
    """A quick refit, with the model's own columns as they were, may fall short by half."""
    bench = repair.bench_of([fast_bench.measure(SWEEP, fast_bench.world(6, [WARM]))], shelf())
    base = bench.evidence.fitted()
    refits = search.best(base, search.scores(base, search.possible(shelf(), base))[:8])
    can_be = [one for one in refits if search.admissible(one.term, one.u)]
    near = [one for one in can_be if one.gain > search.REACH * can_be[0].gain]
    assert [one for one in refits if one.full] == near
    for one in near:
        again = fitting.fit(base.parts, one.fit.state)
        assert again.objective == pytest.approx(one.fit.objective, abs=0.1)
        assert one.gain == pytest.approx(base.objective - one.fit.objective)
