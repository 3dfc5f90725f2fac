"""A name is no surer than the best formula lets it be: noise of the misfit hides what a law of no shelf leaves."""

from __future__ import annotations

import blind_imports
import blind_laws
import pytest
from blind_imports import Record

from rig.diagnose.diagnose import Diagnosis, diagnose
from rig.foreign.tables import Foreign

ROOT, STRAIGHT, SLOW = 666763064, 1655286942, 7


def said(foreign: Foreign) -> Diagnosis:
    return diagnose(blind_imports.evidence(foreign))


@pytest.mark.parametrize(("law", "size"), [("root_bias", 0.066), ("asymmetry", 0.012)])
def test_a_root_is_no_asymmetry_though_its_noise_hides_what_that_leaves(law: str, size: float) -> None:
    """Before cameras, where noise is known from the misfit alone."""
    record = Record("motion", ROOT, blind_laws.law_of(law), {"size": size, "on": "acceleration"})
    found = said(record.made())
    assert found.named == ("asymmetry",)
    assert found.verdict == ("unlisted" if law == "root_bias" else "missing")


def test_a_zero_that_drifts_straight_on_is_not_surely_a_warm_up() -> None:
    foreign, planted = blind_imports.with_fault(Record("rotation", STRAIGHT), "drift", 270.0)
    assert planted["kind"] == "drift"
    found = said(foreign)
    assert found.named == ("warm_up",)
    assert found.steps[0].taken.probability <= 0.5


def test_a_zero_that_bends_as_it_warms_up_is() -> None:
    law, at = blind_laws.law_of("warm_up"), {"size": 0.02, "time_constant": 20.0, "on": "rate"}
    found = said(Record("rotation", SLOW, law, at).made())
    assert found.named == ("warm_up",)
    assert found.steps[0].taken.probability > 0.9
