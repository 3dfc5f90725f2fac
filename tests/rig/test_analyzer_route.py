"""The analyzer at the bench and the records off-line see one motion through one vibrometer, and say the same of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import fast_bench
import numpy as np
import pytest

from fixtures.world import World
from rig.calibrate.allowances import misfit
from rig.calibrate.analyzer_route import apart
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration, load, save
from rig.record import Response

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 8, "static": "2 s"}
KEY = "unit_a_x.sensitivity_analyzer"


@pytest.fixture(scope="module")
def world() -> World:
    return fast_bench.world(5)


@pytest.fixture(scope="module")
def sweep(world: World) -> fast_bench.MemoryRecords:
    return fast_bench.measure(SWEEP, world)


@pytest.fixture(scope="module")
def made(sweep: fast_bench.MemoryRecords) -> Calibration:
    return calibrate([sweep], "made")


class Answering:
    """A run whose analyzer answered otherwise."""

    def __init__(self, run: fast_bench.MemoryRecords, change: Any) -> None:
        self._run, self._change = run, change

    def __getattr__(self, name: str) -> Any:
        return getattr(self._run, name)

    def response(self, name: str) -> Response:
        changed: Response = self._change(self._run.response(name))
        return changed


def test_the_analyzer_gives_the_true_sensitivity(made: Calibration, world: World) -> None:
    found = made.result(KEY)
    assert found.value is not None
    assert found.value == pytest.approx(world.truth["sensitivity"]["unit_a_x"], abs=3.0 * found.u)
    # what the two routes share is left out: their own noise alone
    known = found.value * world.truth["ldv_gain"]
    noise = next(c for c in found.contributions if c.name == "noise of the responses")
    delay = [c.contribution for c in found.contributions if c.name in ("decoder delay", "low-pass cut-off")]
    assert abs(known - world.truth["sensitivity"]["unit_a_x"]) < 4.0 * math.hypot(noise.contribution, *delay)


def test_both_routes_agree_and_the_vibrometer_cancels_in_their_difference(made: Calibration) -> None:
    found, offline = made.result(KEY), made.result("unit_a_x.sensitivity")
    assert found.check is not None
    assert found.status == "determined"
    assert found.check.value == offline.value
    assert found.check.agrees
    assert found.check.u_delta == apart(found, offline)
    gain = next(c for c in offline.contributions if c.name == "vibrometer gain")
    match = next(c for c in found.contributions if c.name == "analyzer's inputs, gain")
    assert found.check.u_delta < math.hypot(gain.contribution, found.u)
    assert found.check.u_delta == pytest.approx(abs(match.contribution), rel=0.1)
    # and beyond the limits of the data sheet, they agree within their noise
    assert abs(found.check.delta / offline.u) < 0.2


def test_responses_of_both_routes_lie_on_each_other(made: Calibration) -> None:
    ours, theirs = made.responses["unit_a_x"], made.analyzer["unit_a_x"]
    assert len(ours) == len(theirs) == 16
    by_condition = [sorted(points, key=lambda p: (round(p.frequency), p.level)) for points in (ours, theirs)]
    for one, other in zip(*by_condition, strict=True):
        assert (one.level, one.run) == (other.level, other.run)
        assert abs(one.magnitude - other.magnitude) < 5.0 * math.hypot(one.u_magnitude, 2e-4 * one.magnitude)
        assert abs(math.remainder(one.phase - other.phase, 2.0 * math.pi)) < 0.01
        assert other.coherence > 0.99


def test_a_route_that_reads_otherwise_is_flagged(sweep: fast_bench.MemoryRecords) -> None:
    made = calibrate([Answering(sweep, lambda one: replace(one, ratio=1.05 * one.ratio))], "apart")
    found = made.result(KEY)
    assert found.status == "flagged"
    assert "the value from the records lies" in " ".join(found.remarks)
    assert made.result("unit_a_x.sensitivity").status == "determined"


def test_points_with_overload_or_low_coherence_are_left_out_and_said(sweep: fast_bench.MemoryRecords) -> None:
    names = sorted(str(body["response"]) for body in sweep.points.values() if "response" in body)
    seen: list[int] = []

    def spoilt(one: Response) -> Response:
        seen.append(1)
        if len(seen) == 1:
            return replace(one, overloads=("input 2",))
        return replace(one, coherence=np.full(len(one.frequency), 0.4)) if len(seen) == 2 else one

    made = calibrate([Answering(sweep, spoilt)], "spoilt")
    found = made.result(KEY)
    assert found.value is not None
    assert f"2 of {len(names)} points left out: input 2 over range, low coherence" in found.remarks
    assert sum("its response was left out" in flag for flag in made.flags) == 2


def test_noise_that_is_an_estimate_does_not_make_a_clean_sensor_miss_an_effect() -> None:
    # twelve points of two averages each, met on the bench: noise known to a third of its variance
    assert misfit(65.1, 23, "the points").remarks
    assert not misfit(65.1, 23, "the points", 16.0).remarks
    assert misfit(23 * 16.0, 23, "the points", 16.0).remarks


def test_without_two_points_it_says_why(sweep: fast_bench.MemoryRecords) -> None:
    made = calibrate([Answering(sweep, lambda one: replace(one, averages=1))], "once")
    found = made.result(KEY)
    assert found.value is None
    assert "one average" in found.remarks[0]


def test_a_calibration_with_both_routes_reads_back(made: Calibration, tmp_path: Any) -> None:
    save(made, tmp_path / "made.yaml")
    assert load(tmp_path / "made.yaml") == made
