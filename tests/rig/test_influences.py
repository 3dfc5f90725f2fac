"""What no run measures is in the budgets with the size that the bench file states, or said to be missing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import fast_bench
import pytest

from rig.calibrate.analyzer_route import SecondRoute
from rig.calibrate.budget import Contribution
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration, Result
from rig.calibrate.influences import CONCERNS
from rig.errors import BadInput, StandardOverdue

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 2}
TURNS = {"procedure": "turntable", "axis": "yaw", "revolutions": 4}
STATED = {name: {"half_width": f"{0.001 * n}", "source": "an estimate"} for n, name in enumerate(CONCERNS, 1)}
CONVERTER = {"standard": "converter", "certificate": "EX-ADC", "due": "2099-01-01", "values": {
    "gain": {"kind": "ratio", "value": "1", "expanded_uncertainty": "0.4 %", "coverage_factor": 2.0}}}  # fmt: skip


@cache
def _measured() -> tuple[fast_bench.MemoryRecords, ...]:
    world = fast_bench.world(5)
    return tuple(fast_bench.measure(one, world) for one in (SWEEP, TURNS))


def made(influences: Any, *standards: Any) -> Calibration:
    """Both runs on a bench whose file states these."""
    others = [one for one in _measured()[0].header["standards"] if one["standard"] != "converter"]
    return calibrate([
        replace(run, header={
            **run.header, "standards": [*others, *standards],
            "bench_file": {**run.header["bench_file"], "influences": influences},
        }) for run in _measured()
    ], "made")  # fmt: skip


def lines(result: Result) -> dict[str, float]:
    """Relative half-widths of the lines that a bench file states, and of the converter's gain."""
    words = {name.replace("_", " ") for name in CONCERNS} | {"converter gain"}
    return {c.name: c.contribution / abs(result.value or 0.0) * 3**0.5 for c in result.contributions if c.name in words}


def test_each_influence_is_a_line_of_what_it_concerns_and_of_nothing_else() -> None:
    found = made(STATED)
    for key, route in (("unit_a_x.sensitivity", "sweep"), ("gyro_yaw.sensitivity", "turntable")):
        wanted = {n.replace("_", " "): 0.001 * k for k, n in enumerate(CONCERNS, 1) if route in CONCERNS[n]}
        assert lines(found.result(key)) == pytest.approx(wanted, rel=1e-6)
    by_analyzer, of_sweep = (
        lines(found.result(f"unit_a_x.{name}")) for name in ("sensitivity_analyzer", "sensitivity")
    )
    assert by_analyzer == pytest.approx({name: size for name, size in of_sweep.items() if name in by_analyzer})
    assert "base strain" in by_analyzer
    assert not {"converter linearity", "settling"} & set(by_analyzer)  # it has converters of its own
    assert not lines(found.result("unit_a_x.deviation"))
    assert not any("not in the budgets" in flag for flag in found.flags)


def test_responses_have_them_too_and_so_has_what_noise_is_referred_by() -> None:
    plain, wide = made({}), made(STATED)
    u = sum((0.001 * k) ** 2 / 3.0 for k, n in enumerate(CONCERNS, 1) if "sweep" in CONCERNS[n]) ** 0.5
    for before, after in zip(plain.responses["unit_a_x"], wide.responses["unit_a_x"], strict=True):
        assert after.uc_magnitude**2 - before.uc_magnitude**2 == pytest.approx((u * after.magnitude) ** 2, rel=1e-6)
    line = next(c for c in wide.result("unit_a_x.deviation").contributions if c.name == "sensitivity")
    own = wide.result("unit_a_x.sensitivity")
    assert line.u == pytest.approx(own.u / abs(own.value or 1.0))
    assert wide.result("unit_a_x.sensitivity_analyzer").check == plain.result("unit_a_x.sensitivity_analyzer").check


def test_what_is_not_stated_is_said_to_be_missing() -> None:
    found = made({"laser_spot": STATED["laser_spot"], "settling": {"half_width": "0 %", "source": "none"}})
    assert lines(found.result("unit_a_x.sensitivity")) == pytest.approx({"laser spot": 0.003})
    (said,) = [flag for flag in found.flags if "not in the budgets, as the bench file" in flag]
    assert "base strain" in said
    assert "laser spot" not in said
    assert "settling" not in said  # none is a size too


def test_the_converters_gain_counts_where_no_channel_shows_the_reference() -> None:
    plain, certified = made({}), made({}, CONVERTER)
    assert lines(certified.result("gyro_yaw.sensitivity")) == pytest.approx({"converter gain": 0.002 * 3**0.5})
    assert lines(certified.result("gyro_yaw.offset")) == pytest.approx({"converter gain": 0.002 * 3**0.5})
    assert not lines(certified.result("unit_a_x.sensitivity"))  # a ratio of two of its channels
    relative = "in volts of the converter, whose gain no standard"
    assert any(relative in flag for flag in plain.flags)
    assert not any(relative in flag for flag in certified.flags)


def test_an_analyzer_whose_match_no_fit_follows_costs_its_own_value_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def endless(self: SecondRoute, fit: object) -> Iterator[Contribution]:
        raise BadInput("adjustment of log_sensitivity: found no solution in 50 steps, wanted convergence")

    monkeypatch.setattr(SecondRoute, "_match", endless)
    found = made({})
    assert "found no solution" in found.result("unit_a_x.sensitivity_analyzer").remarks[0]
    assert found.result("unit_a_x.sensitivity").determined


def test_a_converter_that_is_off_or_past_its_date_is_refused() -> None:
    gain = {**CONVERTER["values"]["gain"], "value": "1.005"}  # type: ignore[index]
    with pytest.raises(BadInput, match=r"found a converter of gain 1\.005"):
        made({}, {**CONVERTER, "values": {"gain": gain}})
    with pytest.raises(StandardOverdue, match="converter"):
        made({}, {**CONVERTER, "due": "2020-01-01"})
