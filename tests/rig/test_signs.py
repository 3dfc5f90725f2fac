"""A sign is a declared property: what answers with the other one fails by it, by whatever route it was found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import fast_bench
import pytest
from miswired import Wrong, WrongWorld

from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration, Result, not_determined
from rig.calibrate.judging import judged

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 2, "static": "3 s", "static_after": "0 s"}
TURNS = {"procedure": "turntable", "revolutions": 2, "rest": "3 s"}
TUMBLE = {"procedure": "tumble", "record": "1 s"}
CASES: Mapping[str, tuple[Mapping[str, Any], str, str]] = {
    "sweep": (SWEEP, "unit_a_x", "sensitivity"),
    "turntable": (TURNS, "gyro_yaw", "sensitivity"),
    "tumble": (TUMBLE, "unit_a_x", "sensitivity_gravity"),
    "tumble of 24 poses": ({**TUMBLE, "poses": 24}, "unit_b_z", "sensitivity_gravity"),
}


def concluded(procedure: Mapping[str, Any], wrong: Wrong, seed: int = 5) -> Calibration:
    return calibrate([fast_bench.measure(procedure, WrongWorld(seed, wrong))], "signs")


@pytest.mark.parametrize("case", CASES)
def test_a_reversed_channel_has_its_value_with_its_sign_and_fails_by_it(case: str) -> None:
    procedure, channel, measurand = CASES[case]
    made = concluded(procedure, Wrong(inverted=frozenset({channel})))
    found = made.result(f"{channel}.{measurand}")
    true = -WrongWorld(5, Wrong()).truth["sensitivity"][channel]
    assert found.value == pytest.approx(true, abs=2.0 * found.expanded)
    assert found.ruling == "fail: sign reversed"
    assert [r.channel for r in made.results if r.verdict == "fail"] == [channel] * (2 if case == "sweep" else 1)


def test_a_negative_sensitivity_that_is_declared_passes() -> None:
    value = concluded(TURNS, Wrong()).result("gyro_yaw.sensitivity")
    negative = Result("g", "sensitivity", "", -abs(value.value or 0.0), value.unit, value.budget)
    assert judged(negative, -abs(value.value or 0.0), 0.05).ruling == "pass"
    assert judged(negative, abs(value.value or 0.0), 0.05).ruling == "fail: sign reversed"
    assert judged(negative, abs(value.value or 0.0), None).ruling == "fail: sign reversed"
    assert judged(not_determined("g", "sensitivity", "", "V", "why"), 1.0, 0.05).ruling == ""
