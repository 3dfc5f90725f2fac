"""A sine point is recorded with its inputs in range, at the level that was asked for, whatever the sensor hides."""

from __future__ import annotations

from typing import Any

import fast_bench
import pytest

from rig.bench import at_shaker
from rig.errors import SignalOverload

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "start": "160 Hz", "stop": "500 Hz", "points": 3}
SHIFTED = {"name": "offset", "parameters": {"quantity": "acceleration", "shift": 20.0}}  # m/s²


def points(hidden: list[dict[str, Any]]) -> dict[tuple[float, str], dict[str, Any]]:
    """Bodies of the sine points by frequency and level."""
    found = fast_bench.measure(SWEEP, fast_bench.world(923, hidden)).points.values()
    return {(one["frequency"], one["level"]): dict(one) for one in found if "level" in one and "source" in one}


@pytest.mark.parametrize("error", [1.25e-3, -1.25e-3, 2e-3])
def test_a_clock_that_is_off_does_not_drive_the_level_up(error: float) -> None:
    clean = points([])
    off = points([{"name": "clock_ratio", "parameters": {"error": error}}])
    assert off.keys() == clean.keys()
    for key, body in off.items():
        assert body["source"] == pytest.approx(clean[key]["source"], rel=0.01)
        assert body["acceleration"] == pytest.approx(body["target"], rel=at_shaker.CLOSE_ENOUGH)


def test_an_input_that_is_overloaded_gets_a_wider_range_and_the_point_is_repeated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(at_shaker, "SENSOR_INPUT", 0.5)  # V; a sensor at rest shows 2.5
    found = fast_bench.measure(SWEEP, fast_bench.world(923))
    notes = [one.body for one in found.lines if one.kind == "overload"]
    assert {name for one in notes for name in one["overloads"]} == {"input 2"}
    ranges = [one["ranges"][1] for one in notes]
    assert ranges == sorted(set(ranges))  # one after the other, and what was found holds for the points after it
    assert len(points([])) == len([one for one in found.points.values() if "source" in one])
    assert all("clipped" in one for one in found.points.values() if "source" in one)


def test_an_input_that_no_range_holds_is_an_error_that_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(at_shaker, "SENSOR_INPUT", 0.5)
    monkeypatch.setattr(fast_bench, "HIGHEST_RANGE", 18.0)
    with pytest.raises(SignalOverload, match=r"input 2 over range of 2.51 V, the widest.*wanted inputs in range"):
        fast_bench.measure(SWEEP, fast_bench.world(923, [SHIFTED]))
