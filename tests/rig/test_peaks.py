"""What resonates is looked for at the peaks of a response, and beside others of the dynamics away from nought."""

from __future__ import annotations

import cmath
import math

import fast_bench
import imported_worlds as worlds
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from imported_worlds import response, response_table
from scipy.signal import find_peaks

from rig.diagnose.diagnose import diagnose
from rig.fit.evidence import evidence_of
from rig.repair import repair
from rig.repair.repair import Bench
from rig.shelf import shelf
from rig.signals.peaks import peaks, prominences

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 9}
SHARP = {"name": "resonance", "parameters": {"frequency": 120.0, "damping": 0.02}}


def test_peaks_are_where_a_response_stands_out_and_half_way_to_the_points_beside() -> None:
    frequency = np.geomspace(20.0, 500.0, 25)
    size = np.array([abs(1.0 / complex(1.0 - (f / 120.0) ** 2, 0.04 * f / 120.0)) for f in frequency])
    found = peaks(np.repeat(frequency, 2), np.repeat(size, 2))
    assert len(found) == 3
    assert np.abs(np.log(found / 120.0)).min() < 0.5 * math.log(frequency[1] / frequency[0])
    assert not len(peaks(frequency, np.linspace(1.0, 3.0, 25)))
    assert not len(peaks(frequency, 1.0 + 0.02 * np.cos(np.arange(25.0))))


@given(st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=40, unique=True))
def test_how_far_a_peak_stands_out_is_as_scipy_has_it(heights: list[float]) -> None:
    height = np.array(heights)
    at, known = find_peaks(height, prominence=0.0)
    expected = np.zeros(len(height))
    expected[at] = known["prominences"]
    assert np.array_equal(prominences(height), expected)


def test_a_sharp_resonance_within_the_band_is_found() -> None:
    made = diagnose(evidence_of([fast_bench.measure(SWEEP, fast_bench.world(5, [SHARP]))]))
    assert (made.verdict, made.named) == ("missing", ("resonance",))
    (found,) = [one for one in made.final.state.terms if one.effect.name == "resonance"]
    physical = found.effect.physical(found.at)
    assert physical == pytest.approx({"frequency": 120.0, "damping": 0.02}, rel=1e-3)


def test_a_lag_is_added_beside_a_delay_as_well_as_a_delay_beside_a_lag() -> None:
    def phasor(frequency: float) -> complex:
        turn = 2.0 * math.pi * frequency * 1e-3
        return 0.99 / complex(1.0, turn) * cmath.exp(-1j * turn)

    bench = Bench(worlds.evidence(response([response_table(phasor, 3)])), shelf(), 0.0)
    errors = []
    for order in (("delay", "first_order_lag"), ("first_order_lag", "delay")):
        model = repair.new(bench, "datasheet")
        for name in order:
            done = repair.added(bench, model, name, "acceleration")
            model = done.model
        errors.append(done.after.error)
    assert errors[0] == pytest.approx(errors[1], rel=1e-4)
    assert errors[0] < 1.2
