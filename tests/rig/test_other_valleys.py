"""Effects so strong that the model without them reverses a sensitivity rather than leave the misfit: still named."""

from __future__ import annotations

import fast_bench
import pytest

from rig.diagnose import instruments
from rig.diagnose.diagnose import diagnose
from rig.fit.evidence import evidence_of

TURNS = {"procedure": "turntable", "all": True, "revolutions": 4, "rest": "10 s"}


def test_a_strong_tilt_is_found_from_where_the_data_sheet_holds() -> None:
    entry = {"name": "platen_tilt", "parameters": {"tilt": 8e-3, "direction": 1.0}}
    found = diagnose(evidence_of([fast_bench.measure(TURNS, fast_bench.world(21, [entry]))]))
    (reversed_one,) = instruments.implausible(found.base)
    assert reversed_one.startswith("unit_a_x: sensitivity has the wrong sign")
    assert (found.verdict, found.named, found.misplaced) == ("missing", ("platen_tilt",), ())
    term = found.final.state.terms[-1]
    assert term.effect.physical(term.at)["tilt"] == pytest.approx(8e-3, rel=0.02)
