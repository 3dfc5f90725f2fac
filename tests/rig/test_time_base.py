"""The converter's clock against that of its machine: found as far as it is off, and never where it is not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import fast_bench
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rig.archive.records import Recorded
from rig.calibrate.calibrate import calibrate
from rig.calibrate.time_base import SCATTER, clock_of

TURNS = {"procedure": "turntable", "revolutions": 4, "rest": "5 s"}


@pytest.fixture(scope="module")
def turned() -> fast_bench.MemoryRecords:
    return fast_bench.measure(TURNS, fast_bench.world(3))


def paced(run: fast_bench.MemoryRecords, paces: list[tuple[float, float]]) -> Recorded:
    """The same run whose converter was seen to go like that."""
    others = [replace(one, body={k: v for k, v in one.body.items() if k != "pace"}) for one in run.lines]
    line: Any = run.lines[-1]
    seen = [replace(line, kind="step", body={"pace": list(one)}) for one in paces]
    changed = object.__new__(type(run))
    changed.__dict__.update({**run.__dict__, "lines": [*others, *seen]})
    return cast(Recorded, changed)


@settings(deadline=None)
@example(0.0, [1.0, 1.0], 1982255, 0.0)
@given(
    st.floats(-0.019, 0.019), st.lists(st.floats(1.0, 300.0), min_size=1, max_size=40), st.integers(0, 2**32 - 1),
    st.floats(0.0, 0.06),
)  # fmt: skip
def test_the_error_is_found_within_its_uncertainty(
    turned: fast_bench.MemoryRecords, error: float, lengths: list[float], seed: int, late: float
) -> None:
    jitter = np.random.default_rng(seed).uniform(0.0, 0.01, len(lengths))
    paces = [(t * (1.0 + error), t + late + more) for t, more in zip(lengths, jitter.tolist(), strict=True)]
    found = clock_of(paced(turned, paces))
    assert found is not None
    assert abs(found.error - error) < 5.0 * found.u
    spread = float(np.std(jitter, ddof=1)) if len(lengths) > 1 else 0.0
    assert found.u < 0.06 / max(lengths) * max(spread / SCATTER, 1.0)  # records that disagree widen it


def test_without_a_pace_nothing_is_said_of_the_clock(turned: fast_bench.MemoryRecords) -> None:
    assert clock_of(paced(turned, [])) is None


@pytest.mark.parametrize("error", [0.005, -0.005, 0.019])
def test_what_stands_on_a_clock_that_is_off_is_flagged(turned: fast_bench.MemoryRecords, error: float) -> None:
    paces = [(t * (1.0 + error), t + 0.02) for t in (30.0, 14.5, 28.0, 7.5, 30.0)]
    made = calibrate([paced(turned, paces)], "off", assumed=None)
    sensitivity, noise = made.result("gyro_yaw.sensitivity"), made.result("gyro_pitch.deviation")
    assert (sensitivity.status, sensitivity.verdict) == ("flagged", "inconclusive")
    way = "fast" if error > 0.0 else "slow"
    assert f"{abs(error):.2%}" in sensitivity.remarks[-1]
    assert way in sensitivity.remarks[-1]
    assert noise.status == "determined"


def test_a_clean_clock_is_never_off(turned: fast_bench.MemoryRecords) -> None:
    for document in (
        {"procedure": "frequency_sweep", "axis": "x", "points": 2}, {"procedure": "noise", "length": "30 s"},
        {"procedure": "tumble", "poses": 6},
    ):  # fmt: skip
        found = clock_of(fast_bench.measure(document, fast_bench.world(4)))
        assert found is not None
        assert not found.off
    assert not any(
        "clock" in remark for result in calibrate([turned], "on", assumed=None).results for remark in result.remarks
    )


def test_sines_that_no_fit_follows_are_left_out_and_end_nothing() -> None:
    hidden = [{"name": "clock_ratio", "parameters": {"error": 5e-3}}]
    run = fast_bench.measure({"procedure": "frequency_sweep", "axis": "x", "points": 3}, fast_bench.world(3, hidden))
    made = calibrate([run], "off", assumed=None)
    assert any("no sine to be fitted to the reference" in flag and "left out" in flag for flag in made.flags)
    assert made.find("unit_a_x.deviation") is not None
