"""One value to use: the best mean of what several references say, and a reference that is off."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import fast_bench
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import COMBINED, ROUTES, Calibration, Result, covariance_of, load, rejected, save
from rig.calibrate.combining import combined
from rig.calibrate.gyros import WHOLE_BUDGET
from rig.export import python_module
from rig.export.selection import Choice
from rig.sensor import Sensor

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 3}
TUMBLE = {"procedure": "tumble", "poses": 6}
SENSOR = Sensor.stated({"channels": {"x": {
    "part": "", "quantity": "acceleration", "axis": "x", "sensitivity": "1 V/(m/s²)", "range": "2 g",
    "bandwidth": "9 Hz",
}}})  # fmt: skip
SIZES = st.floats(1e-3, 1e-1)


def stated(measurand: str, value: float, noise: float, *, common: float = 0.0, own: float = 0.0) -> Result:
    """A sensitivity with noise, an error that others of the same certificate share, and one by a limit of its own."""
    lines = (
        Contribution("noise", "A", "normal", noise, "V/(m/s²)", 1.0, 20.0),
        Contribution("gain", "B", "normal", common, "1", value, source="certificate"),
        Contribution("limit", "B", "rectangular", own, "1", value, source=measurand),
    )
    return Result("x", measurand, "sensitivity", value, "V/(m/s²)", Budget(lines), reference=f"{measurand}, traceable")


def whole(radial: Result) -> Result:
    """A sensitivity from ω²r whose place and tilt are stated to be exact."""
    lines = (Contribution(name, "B", "rectangular", 0.0, "1", 1.0, source="stated") for name in sorted(WHOLE_BUDGET))
    return replace(radial, budget=Budget((*radial.contributions, *lines)))


def best(*several: Result) -> Result:
    found = next(iter(combined(several, SENSOR)))
    assert found.measurand == COMBINED
    return found


@given(noise=st.tuples(SIZES, SIZES, SIZES), common=SIZES, own=st.tuples(SIZES, SIZES, SIZES))
def test_no_other_weights_give_a_smaller_uncertainty_and_its_budget_says_so(
    noise: tuple[float, ...], common: float, own: tuple[float, ...]
) -> None:
    values = [1.0, 1.0 + 1e-4, 1.0 - 2e-4]
    several = [
        stated(name, value, a, common=common, own=b)
        for name, value, a, b in zip(ROUTES, values, noise, own, strict=True)
    ]
    several[2] = whole(several[2])
    found, covariance = best(*several), covariance_of(several)
    weights = np.linalg.solve(covariance, np.ones(len(several)))
    assert found.u**2 == pytest.approx(1.0 / weights.sum(), rel=1e-6)
    assert found.value == pytest.approx(weights @ values / weights.sum(), rel=1e-9)
    assert found.u <= min(one.u for one in several) * (1.0 + 1e-9)
    assert sum(line.name == "gain" for line in found.contributions) == 1  # of one certificate, one error


def test_the_mean_of_two_is_that_of_a_textbook() -> None:
    found = best(stated("sensitivity", 1.02, 0.01), stated("sensitivity_gravity", 1.00, 0.02))
    assert found.value == pytest.approx((4.0 * 1.02 + 1.00) / 5.0)
    assert found.u == pytest.approx(0.01 * math.sqrt(0.8))
    assert found.reference == "sensitivity, traceable; sensitivity_gravity, traceable"
    assert found.status == "determined"


def test_references_that_disagree_are_said_to_and_widen_the_interval() -> None:
    found = best(stated("sensitivity", 1.10, 0.01), stated("sensitivity_gravity", 1.00, 0.01))
    assert found.status == "flagged"
    assert "one of them is off" in found.remarks[0]
    assert found.u == pytest.approx(0.05)  # half their distance
    assert found.expanded == pytest.approx(1.96 * 0.05, rel=0.01)


def test_a_gain_that_all_channels_share_is_told_from_all_of_them_together() -> None:
    channels = list("abcdefgh")
    row = {"part": "", "quantity": "acceleration", "axis": "x", "sensitivity": "1 V/(m/s²)", "range": "2 g"}
    sensor = Sensor.stated({"channels": {name: {**row, "bandwidth": "9 Hz"} for name in channels}})

    def rows(off: float) -> list[Result]:
        pair = stated("sensitivity", 1.0 + off, 1e-3, common=5e-3), stated("sensitivity_gravity", 1.0, 1e-3)
        return [replace(one, channel=name) for name in channels for one in pair]

    fine, wrong = ([one for one in combined(rows(off), sensor) if one.measurand == COMBINED] for off in (0.010, 0.0125))
    assert {one.status for one in fine} == {"determined"}
    assert {one.status for one in wrong} == {"flagged"}
    assert "times those by" in wrong[0].remarks[0]


def test_what_is_not_believed_keeps_its_verdict_and_its_channel_has_no_value_to_use() -> None:
    lost = rejected("x", "sensitivity", "sensitivity", "V/(m/s²)", "why")
    rows = [lost, stated("sensitivity_gravity", 1.0, 0.01), whole(stated("sensitivity_centripetal", 1.0, 0.01))]
    assert list(combined(rows, SENSOR)) == rows
    assert rows[0].rejected


def test_another_sign_is_told_by_its_channel_and_is_no_factor_of_all() -> None:
    found = best(stated("sensitivity", -1.0, 0.01), stated("sensitivity_gravity", 1.0, 0.01))
    assert found.remarks[0].startswith("the references disagree here (")
    assert found.status == "flagged"


def test_what_is_combined_once_more_is_what_it_was() -> None:
    once = list(combined([stated("sensitivity", 1.02, 0.01), stated("sensitivity_gravity", 1.0, 0.02)], SENSOR))
    assert list(combined(once, SENSOR)) == once


def test_only_the_value_to_use_is_judged_unless_another_fails() -> None:
    found = made()
    assert found.result("unit_a_x.sensitivity").verdict is None
    assert found.result(f"unit_a_x.{COMBINED}").verdict == "pass"


def test_a_value_to_use_is_never_one_that_stands_in_for_what_was_not_believed() -> None:
    found = made()
    lost = tuple(
        rejected(r.channel, r.measurand, r.title, r.unit, "why") if r.key == "unit_a_x.sensitivity" else r
        for r in found.results if r.measurand != COMBINED
    )  # fmt: skip
    assert replace(found, results=lost).to_use("unit_a_x", "sensitivity") is None
    old = replace(found, results=tuple(r for r in found.results if r.measurand != COMBINED))
    assert old.to_use("unit_a_x", "sensitivity") == old.result("unit_a_x.sensitivity")


def test_what_is_flagged_or_alone_is_not_combined() -> None:
    one, other = stated("sensitivity", 1.0, 0.01), stated("sensitivity_gravity", 1.0, 0.01)
    flagged = replace(other, status="flagged", remarks=("why",))
    assert list(combined([one], SENSOR)) == [one]
    assert list(combined([one, flagged], SENSOR)) == [one, flagged]
    radial = stated("sensitivity_centripetal", 1.0, 0.01)
    assert list(combined([one, radial], SENSOR)) == [one, radial]  # nobody said where its element sits


@cache
def made(gain: str = "1") -> Calibration:
    """Of a sweep and a tumble, by a certificate of the vibrometer that states this gain."""
    world = fast_bench.world(3)
    runs = [fast_bench.measure(one, world) for one in (SWEEP, TUMBLE)]
    return calibrate([replace(run, header=_certified(run.header, gain)) for run in runs], "made")


def _certified(header: Mapping[str, Any], gain: str) -> dict[str, Any]:
    first, *others = header["standards"]
    values = {**first["values"], "gain": {**first["values"]["gain"], "value": gain}}
    return {**header, "standards": [{**first, "values": values}, *others]}


def test_vibrometer_and_gravity_make_one_value_that_is_true_and_exported(tmp_path: Any) -> None:
    found, true = made(), fast_bench.world(3).truth["sensitivity"]
    for unit in "abc":
        one = found.result(f"unit_{unit}_x.{COMBINED}")
        assert abs(float(one.value or 0.0) - true[one.channel]) < one.expanded
        parts = [found.result(f"{one.channel}.{route}") for route in ("sensitivity", "sensitivity_gravity")]
        assert one.u < min(part.u for part in parts)
        assert one.verdict == "pass"
        assert found.to_use(one.channel, "sensitivity") == one
    assert found.to_use("unit_a_y", "sensitivity") == found.result("unit_a_y.sensitivity_gravity")
    save(found, tmp_path / "made.yaml")
    assert load(tmp_path / "made.yaml") == found
    (module,) = (text for name, text in python_module.files(found, Choice()).items() if name.endswith(".py"))
    assert repr(found.result(f"unit_a_x.{COMBINED}").value) in module.decode()  # what a robot would load


def test_a_certificate_that_is_wrong_by_three_percent_is_found_by_gravity() -> None:
    found = made("1.03")
    rows = [found.result(f"unit_{unit}_x.{COMBINED}") for unit in "ab"]
    assert all(one.status == "flagged" and "the references disagree" in one.remarks[0] for one in rows)
    assert all(one.verdict == "inconclusive" for one in rows)
