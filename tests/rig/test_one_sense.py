"""What one sense, an unlevel platter or an element off the centre hide is in the stated uncertainty."""

from __future__ import annotations

from typing import Any

import fast_bench
import pytest

from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Result

TURNS = {"procedure": "turntable", "axis": "yaw", "revolutions": 12}


def found(key: str, hidden: list[dict[str, Any]], **more: Any) -> tuple[Result, float]:
    """A result of a turntable run with its true value."""
    world = fast_bench.world(21, hidden)
    result = calibrate([fast_bench.measure({**TURNS, **more}, world)], "made").result(key)
    return result, world.truth["sensitivity"][result.channel]


def errors(result: Result, truth: float) -> float:
    """In expanded uncertainties."""
    return abs(float(result.value or 0.0) - truth) / result.expanded


@pytest.mark.parametrize("inverted", [False, True])
def test_a_hidden_asymmetry_of_one_sense_is_covered(inverted: bool) -> None:
    hidden = [{"name": "asymmetry", "parameters": {"quantity": "rate", "ratio": 4.2e-3}}]
    result, truth = found("gyro_yaw.sensitivity", hidden, inverted=inverted)
    assert errors(result, truth) < 1.0
    lines = {c.name: c for c in result.contributions}
    line = lines["asymmetry, unseen in one sense"]
    assert abs(float(result.value or 0.0) - truth) == pytest.approx(4.2e-3 * abs(truth), rel=0.25)
    assert line.contribution == pytest.approx(0.005 / 3**0.5 * abs(truth), rel=0.02)
    assert (line.sensitivity > 0.0) == (float(result.value or 0.0) > truth)  # the sense says which way
    assert any("one sense only" in remark for remark in result.remarks)


def test_both_senses_need_no_limit_of_the_data_sheet() -> None:
    result, truth = found("gyro_yaw.sensitivity", [], all=True)
    assert errors(result, truth) < 1.5
    assert not any("one sense" in text for text in (*result.remarks, *(c.name for c in result.contributions)))


def test_a_tilt_of_the_platter_is_covered() -> None:
    hidden = [{"name": "platen_tilt", "parameters": {"tilt": 1.55e-3}}]
    result, truth = found("unit_a_z.sensitivity_centripetal", hidden)
    assert errors(result, truth) < 1.0
    names = {c.name for c in result.contributions}
    assert {"place of the sensing element", "tilt of the platter", "axis to the radius"} <= names
