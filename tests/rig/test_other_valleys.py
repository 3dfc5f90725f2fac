"""Effects so strong that the model without them reverses a sensitivity rather than leave the misfit: still named."""

from __future__ import annotations

import fast_bench
import pytest

from rig.diagnose import instruments
from rig.diagnose.diagnose import diagnose
from rig.fit.evidence import evidence_of

TURNS = {"procedure": "turntable", "all": True, "revolutions": 4, "rest": "10 s"}


@pytest.mark.parametrize(("tilt", "direction"), [(8e-3, 1.0)])
def test_a_strong_tilt_is_found_from_where_the_data_sheet_holds(tilt: float, direction: float) -> None:
    entry = {"name": "platen_tilt", "parameters": {"tilt": tilt, "direction": direction}}
    found = diagnose(evidence_of([fast_bench.measure(TURNS, fast_bench.world(21, [entry]))]))
    assert (
        instruments.implausible(found.base)
        == [
            one
            for one in instruments.implausible(found.base)
            if one.startswith("unit_a_x: sensitivity has the wrong sign")
        ]
        != []
    )
    assert (found.verdict, found.named, found.misplaced) == ("missing", ("platen_tilt",), ())
    term = found.final.state.terms[-1]
    assert term.effect.physical(term.at)["tilt"] == pytest.approx(tilt, rel=0.02)
