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
    line = lines["asymmetry, unseen here"]
    assert abs(float(result.value or 0.0) - truth) == pytest.approx(4.2e-3 * abs(truth), rel=0.25)
    assert line.contribution == pytest.approx(0.005 / 3**0.5 * abs(truth), rel=0.02)
    assert (line.sensitivity > 0.0) == (float(result.value or 0.0) > truth)  # the sense says which way
    assert any("turned in one sense and at one speed only" in remark for remark in result.remarks)


def test_both_senses_need_no_limit_of_the_data_sheet() -> None:
    result, truth = found("gyro_yaw.sensitivity", [], all=True)
    assert errors(result, truth) < 1.5
    said = (*result.remarks, *(c.name for c in result.contributions))
    assert not any("unseen" in text or "turned" in text for text in said)


def test_a_hidden_curve_at_one_speed_in_both_senses_is_covered() -> None:
    world = fast_bench.world(21, [{"name": "cubic", "parameters": {"quantity": "rate", "coefficient": 2e-4}}])
    runs = [fast_bench.measure({**TURNS, "inverted": inverted}, world) for inverted in (False, True)]
    result = calibrate(runs, "made").result("gyro_yaw.sensitivity")
    truth = world.truth["sensitivity"]["gyro_yaw"]
    alone = [c.contribution for c in result.contributions if c.name == "nonlinearity, unseen here"]
    assert errors(result, truth) < 1.0
    assert abs(float(result.value or 0.0) - truth) > 1.96 * (result.u**2 - alone[0] ** 2) ** 0.5  # not without it
    assert "turned at one speed only" in " ".join(result.remarks)


def test_data_sheets_of_two_gyros_are_two() -> None:
    made = calibrate([fast_bench.measure(TURNS, fast_bench.world(21))], "made")
    one, other = (made.result(f"{name}_yaw.sensitivity") for name in ("gyro", "backup"))
    theirs = {c.name: c.contribution for c in other.contributions if c.kind == "B" and "unseen" not in c.name}
    common = sum(c.contribution * theirs.get(c.name, 0.0) for c in one.contributions)
    assert any("unseen" in c.name for c in one.contributions)
    assert made.covariance([one.key, other.key])[0, 1] == pytest.approx(common, rel=0.2)
    assert common < 0.01 * one.u * other.u


def test_a_tilt_of_the_platter_is_covered() -> None:
    hidden = [{"name": "platen_tilt", "parameters": {"tilt": 1.55e-3}}]
    result, truth = found("unit_a_z.sensitivity_centripetal", hidden)
    line = next(c for c in result.contributions if c.name == "tilt of the platter")
    assert errors(result, truth) < 1.0
    force = 4.71**2 * 0.05  # rad²/s²·m
    assert line.contribution == pytest.approx(abs(truth) * 9.8123 * 0.3 * 3.14159 / 180.0 / force / 2**0.5, rel=0.1)
    assert {"place of the sensing element", "axis to the radius"} <= {c.name for c in result.contributions}
