"""What temperature and supply will be in a run that has not been made: no rise is promised twice."""

from __future__ import annotations

import math

import fast_bench
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.fit.evidence import evidence_of
from rig.parts.conditions import continued
from rig.parts.platter import Platter

TURNS = {"procedure": "turntable", "all": True, "revolutions": 4, "rest": "5 s"}


@settings(deadline=None, max_examples=40)
@given(st.floats(-10.0, 10.0), st.floats(0.5, 8.0), st.floats(0.2, 1.4), st.floats(0.0, 20.0))
def test_what_settles_exponentially_goes_on_settling(last: float, rise: float, slowness: float, later: float) -> None:
    time = np.linspace(0.0, 400.0, 200)

    def course(at: np.ndarray) -> np.ndarray:
        return np.asarray(last - rise * np.exp(-at / (400.0 * slowness)))

    at = 400.0 * (1.0 + later) + np.linspace(0.0, 50.0, 5)
    assert continued(time, course(time), at) == pytest.approx(course(at), abs=0.03 * rise)
    mixed = np.random.default_rng(1).permutation(time)  # readings need not stand in order
    assert continued(mixed, course(mixed), at) == pytest.approx(course(at), abs=0.03 * rise)


@pytest.mark.parametrize(
    "values",
    [
        np.where(np.arange(200) < 140, 5.0, 5.25),  # a supply that was set anew
        24.0 + np.linspace(0.0, 0.5, 200),
        24.0 + np.linspace(0.0, 0.7, 200) ** 2,
        24.0 + np.random.default_rng(1).normal(0.0, 0.01, 200),
    ],
)
def test_what_does_not_settle_is_taken_to_stay(values: np.ndarray) -> None:
    time = np.linspace(0.0, 100.0, 200)
    assert continued(time, values, np.array([1000.0, 1100.0])) == pytest.approx([values[-1]] * 2)


def test_what_nobody_logged_stays_unknown_and_what_stands_still_does() -> None:
    time, at = np.linspace(0.0, 10.0, 20), np.array([100.0, 200.0])
    assert np.isnan(continued(time, np.full(20, math.nan), at)).all()
    assert continued(time, np.full(20, 24.5), at) == pytest.approx([24.5, 24.5])
    assert continued(time[:1], np.array([24.5]), at) == pytest.approx([24.5, 24.5])


def test_a_later_turntable_run_does_not_warm_up_again() -> None:
    (part,) = (one for one in evidence_of([fast_bench.measure(TURNS, fast_bench.world(3))]).parts
               if isinstance(one, Platter))  # fmt: skip
    (later,) = (option.part() for option in part.options() if option.name == "later")
    assert isinstance(later, Platter)
    assert np.ptp(later.data.temperature) < 0.4 * np.ptp(part.data.temperature)
    assert later.data.temperature[0] > part.data.temperature[-1]
