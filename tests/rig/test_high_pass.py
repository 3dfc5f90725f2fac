"""A high-pass is one effect on the shaker and on the platter, whose motion outlasts its memory many times."""

from __future__ import annotations

import fast_bench
import pytest

from rig.diagnose import search
from rig.fit.evidence import Evidence, evidence_of
from rig.shelf import shelf

RIVALS = ("high_pass", "hysteresis", "lever_arm", "gravity_tilt", "drive_feedthrough", "platen_tilt")


CORNER = 0.05  # Hz: after three seconds 1/e of what was is left


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    """A short sweep and a turntable run in one world with it."""
    world = fast_bench.world(7, [{"name": "high_pass", "parameters": {"corner": CORNER}}])
    swept = fast_bench.measure({"procedure": "frequency_sweep", "axis": "x", "points": 4}, world)
    turned = fast_bench.measure({"procedure": "turntable", "revolutions": 4, "rest": "10 s"}, world)
    return evidence_of([swept, turned])


def test_it_is_found_in_both_runs_together_and_leaves_nothing(evidence: Evidence) -> None:
    base = evidence.fitted()
    terms = search.possible({name: shelf()[name] for name in RIVALS}, base)
    first = search.scores(base, terms)[0]
    found = search.completed(base, search.refitted(base, first))
    assert found.name == "high_pass"
    assert abs(found.term.at["corner"] - CORNER) < 3.5 * found.u["corner"]
    assert found.fit.chi2 / found.fit.count < 1.03
