"""What an effect does to a motion is undone to rounding; a filter, within the band and the error that it states."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.correction.chain import Channel, Undone
from rig.correction.correction import Correction, counts_to_volts
from rig.correction.dynamics import taps
from rig.correction.inverse import Bend
from rig.errors import BadInput
from rig.formula import formula_effect
from rig.model import Array, Channels, Local, Motion, Quantity, Stretches, Term, volts
from rig.shelf import shelf

RATE = 1000.0  # Hz
COUNT = 200
NAMES = ("α 1", "α 2", "α 3", "turn x", "turn y", "turn z")
QUANTITIES: tuple[Quantity, ...] = ("acceleration",) * 3 + ("rate",) * 3
SENSITIVITY = np.array([0.066, 0.065, -0.067, 0.21, 0.22, 0.2])
ZERO = np.array([2.5, 2.4, 2.6, 2.5, 2.45, 2.55])


def motion(seed: int, force: float = 20.0, rate: float = 4.0) -> Motion:
    """Any motion, with any temperature and supply."""
    chance = np.random.default_rng(seed)
    grid = Stretches(1.0 / RATE, ((0, COUNT),))
    forces, rates = (size * chance.uniform(-1.0, 1.0, (3, COUNT)) for size in (force, rate))
    time = np.arange(COUNT) / RATE
    return Motion(
        grid, "free", forces, rates, grid.rise(rates), np.zeros((3, COUNT)), 9.81,
        chance.uniform(-20.0, 60.0, COUNT), chance.uniform(4.8, 5.2, COUNT), 100.0 * time,
    )  # fmt: skip


def shown(moved: Motion, terms: Sequence[Term], pole: float = math.inf) -> Array:
    """Volts of two triads on their axes, with one output filter."""
    one = np.ones(6)
    channels = Channels(
        NAMES, np.array([q == "rate" for q in QUANTITIES]), np.array([0, 1, 2, 0, 1, 2]), np.arange(6), 0.0 * one,
        SENSITIVITY, 0.1 * one, pole * one, ("acc",) * 3 + ("gyro",) * 3,
    )  # fmt: skip
    return np.asarray(volts(moved, channels, Local(SENSITIVITY, pole * one, ZERO), terms), np.float64)


def correction(terms: Sequence[Term], pole: float | None = None) -> Correction:
    channels = tuple(
        Channel(name, quantity, k % 3, "acc" if k < 3 else "gyro", SENSITIVITY[k], ZERO[k], pole, slot=k,
                u_sensitivity=1e-4, u_zero=1e-3)
        for k, (name, quantity) in enumerate(zip(NAMES, QUANTITIES, strict=True))
    )  # fmt: skip
    return Correction("unit", channels, tuple(Undone(t.key, t.on, t.effect.inverse(t.at)) for t in terms))


def term(name: str, on: Quantity | None = None, **at: float) -> Term:
    effect = shelf()[name]
    return Term(effect, on or (effect.quantities[0] if len(effect.quantities) == 1 else None), at)


def truth(moved: Motion) -> Array:
    return np.concatenate([moved.force, moved.rate])


def conditions(moved: Motion) -> dict[str, Array]:
    return {"temperature": moved.temperature, "supply": moved.supply, "time": moved.elapsed}


def assert_same(found: Array, wanted: Array, limit: float) -> None:
    np.testing.assert_allclose(found, wanted, rtol=limit, atol=20.0 * limit)


def slow_motion(frequency: float, count: int = 2000) -> Motion:
    """A sine on every axis, each with its own phase, over gravity."""
    grid, time = Stretches(1.0 / RATE, ((0, count),)), np.arange(count) / RATE
    phases = 2.0 * math.pi * frequency * time + np.arange(6.0)[:, None]
    force, rate = 5.0 * np.sin(phases[:3]) + 9.81, 2.0 * np.sin(phases[3:])
    return Motion(
        grid, "free", force, rate, grid.rise(rate), np.zeros((3, count)), 9.81, np.full(count, 25.0),
        np.full(count, 5.0), time,
    )  # fmt: skip


STATIC: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "sensitivity": {"relative": (-0.2, 0.2)},
    "offset": {"shift": (-1.0, 1.0)},
    "quadratic": {"coefficient": (-0.005, 0.005)},
    "cubic": {"coefficient": (-2e-4, 2e-4)},
    "odd_quadratic": {"coefficient": (-0.005, 0.005)},
    "asymmetry": {"ratio": (-0.3, 0.3)},
    "supply_ratio": {"share": (0.0, 2.0)},
    "temperature_bias": {"coefficient": (-0.05, 0.05)},
    "temperature_scale": {"coefficient": (-0.003, 0.003)},
    "warm_up": {"shift": (-1.0, 1.0), "time_constant": (5.0, 500.0)},
    "buffer_gain": {"error": (-0.1, 0.1)},
    "cross_axis": {"share": (-0.2, 0.2)},
    "cross_axis_matrix": dict.fromkeys(("xy", "xz", "yx", "yz", "zx", "zy"), (-0.15, 0.15)),
    "non_orthogonality": {"yz": (-0.2, 0.2), "zy": (-0.2, 0.2), "zx": (-0.2, 0.2)},
    "g_sensitivity": {"coefficient": (-0.01, 0.01)},
    "lever_arm": {"x": (-0.01, 0.01), "y": (-0.01, 0.01), "z": (-0.01, 0.01)},
    "axis_offset": {"offset": (-0.005, 0.005)},
}
DYNAMIC: Mapping[str, Mapping[str, float]] = {
    "delay": {"time": 4.3e-3},
    "first_order_lag": {"time_constant": 3e-4},
    "bessel_filter": {"period": 1.0 / 400.0},
    "butterworth_filter": {"period": 1.0 / 300.0},
    "moving_average": {"window": 2e-3},
    "resonance": {"square": 900.0**-2, "loss": 2.0 * 0.1 / 900.0},
}


@st.composite
def a_static_term(draw: st.DrawFn, name: str) -> Term:
    effect = shelf()[name]
    at = {key: draw(st.floats(low, high)) for key, (low, high) in STATIC[name].items()}
    return Term(effect, draw(st.sampled_from(effect.quantities)), at)


@pytest.mark.parametrize("name", STATIC)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_a_static_effect_is_undone_to_rounding(name: str, data: st.DataObject) -> None:
    one, moved = data.draw(a_static_term(name)), motion(data.draw(st.integers(0, 10**6)))
    if name == "axis_offset":
        moved = Motion(**{**vars(moved), "place": "turntable"})
    seen = dict(zip(NAMES, shown(moved, [one]), strict=True))
    found = correction([one]).apply(seen, rate=RATE, **conditions(moved))
    assert_same(found.array, truth(moved), 1e-9)


@settings(max_examples=15, deadline=None)
@given(st.data())
def test_all_of_them_together_are_undone_in_the_order_of_the_chain(data: st.DataObject) -> None:
    names = data.draw(st.permutations([name for name in STATIC if name not in ("lever_arm", "axis_offset")]))
    small = [data.draw(a_static_term(name)) for name in names]
    terms = [Term(one.effect, one.on, {k: v if k == "time_constant" else 0.2 * v for k, v in one.at.items()})
             for one in small]  # fmt: skip
    moved = motion(data.draw(st.integers(0, 10**6)))
    found = correction(terms).apply(shown(moved, terms), **conditions(moved))
    assert_same(found.array, truth(moved), 1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.floats(-5e-3, 5e-3), st.floats(-0.05, 0.05))
def test_a_term_by_formula_is_taken_off_in_rounds(seed: int, bend: float, share: float) -> None:
    effect = formula_effect("own", "k * u**2 + n * y * exp(-t / c) + m * T", on="acceleration", starts={"c": (1.0,)})
    one, moved = Term(effect, "acceleration", {"k": bend, "n": share, "c": 5.0, "m": share}), motion(seed)
    whole = correction([one, term("cross_axis", "acceleration", share=0.1)])
    seen = shown(moved, [one, term("cross_axis", "acceleration", share=0.1)])
    assert_same(whole.apply(seen, **conditions(moved)).array, truth(moved), 1e-9)
    assert "temperature: not given, what follows it by a formula is not undone" in whole.apply(seen).said


def test_a_term_that_is_not_small_beside_the_input_gives_no_number_instead_of_a_wrong_one() -> None:
    effect = formula_effect("own", "k * u**2", on="acceleration")
    whole = correction([Term(effect, "acceleration", {"k": 0.2})])
    found = whole.apply(ZERO + 8.0 * SENSITIVITY)
    assert np.isnan(found.array[:3]).all()
    assert_same(found.array[3:], np.full(3, 8.0), 1e-12)


def test_crosstalk_is_undone_with_the_record_s_own_rise() -> None:
    one, moved = term("crosstalk", "acceleration", time_constant=2e-5), slow_motion(20.0)
    still = slice(5, -5)
    found = correction([one]).apply(shown(moved, [one]), rate=RATE)
    left = np.abs(found.array - truth(moved))[:, still].max()
    assert left < 1e-6
    without = correction([]).apply(shown(moved, [one]), rate=RATE)
    assert np.abs(without.array - truth(moved))[:, still].max() > 1e3 * left


@pytest.mark.parametrize("name", DYNAMIC)
@pytest.mark.parametrize("frequency", [5.0, 40.0, 110.0])
def test_a_filter_is_undone_in_its_band_within_what_it_states(name: str, frequency: float) -> None:
    effect = shelf()[name]
    on = "acceleration" if len(effect.quantities) > 1 else None
    one, moved = term(name, on, **DYNAMIC[name]), slow_motion(frequency)
    whole = correction([one], pole=200.0)
    found = whole.apply(shown(moved, [one], pole=200.0), rate=RATE)
    stated = whole.chains[0].taps(RATE)
    assert frequency < stated.band
    assert stated.error < 0.01
    away = slice(200, -200)  # from the ends, beyond which nothing is known
    left = np.abs(found.array - truth(moved))[:3, away].max()
    assert left < 5.0 * stated.error * 1.5 + 1e-3  # what the ends of the record leave in its middle
    raw = whole.apply(shown(moved, [one], pole=200.0))
    assert left < 0.2 * np.abs(raw.array - truth(moved))[:3, away].max()
    assert any("ms late" in sentence for sentence in raw.said)


def test_a_skew_of_the_scan_is_a_shift_in_time_by_slot() -> None:
    one = term("channel_skew", extra=1e-5)
    whole = correction([one])
    assert [one.lag for one in whole.chains] == pytest.approx([-1e-5 * slot for slot in range(6)], abs=1e-12)


def test_what_rests_comes_out_exactly_whatever_the_filters_are() -> None:
    terms = [term("butterworth_filter", "rate", period=1 / 80.0), term("delay", "acceleration", time=0.01)]
    seen = np.repeat((ZERO + SENSITIVITY * 3.0)[:, None], 50, axis=1)
    assert_same(correction(terms, pole=30.0).apply(seen, rate=RATE).array, np.full((6, 50), 3.0), 1e-13)


def test_beyond_the_range_where_the_output_rises_there_is_no_answer() -> None:
    bend = Bend(cubic=-1e-3)
    low, high = bend.range
    assert (low, high) == pytest.approx((-18.257, 18.257), abs=1e-3)
    u = np.array([low * 0.999, -1.0, 0.0, 2.0, high * 0.999])
    assert bend.straight(bend.bent(u)) == pytest.approx(u, rel=1e-9)
    assert np.isnan(bend.straight(np.array([1.01, -1.01]) * bend.bent(np.array(high)))).all()
    whole = correction([term("cubic", "acceleration", coefficient=-1e-3)])
    assert any("undone between -18.26 and 18.26 m/s²" in sentence for sentence in whole.said())
    found = whole.apply(np.where(np.arange(6) == 1, 9.0, ZERO)[:, None])
    assert np.isnan(found["α 2"]).all()
    assert np.isfinite(np.delete(found.array, 1, axis=0)).all()  # the others know nothing of it


@pytest.mark.parametrize("name", sorted(shelf()))
def test_every_effect_says_how_it_is_undone_or_why_not(name: str) -> None:
    effect = shelf()[name]
    at = {c.name: c.starts[-1] or c.step for c in effect.coordinates}
    for on in effect.quantities or (None,):
        said = correction([Term(effect, on, at)]).said()
        undone = name in {*STATIC, *DYNAMIC, "channel_skew", "crosstalk"}
        assert undone != any("nothing to undo, it belongs" in one or "not undone, " in one for one in said)
        assert not any("does not say how" in one for one in said)


def test_an_axis_that_no_channel_has_is_said_and_the_rest_is_undone() -> None:
    whole = correction([term("cross_axis", "acceleration", share=0.05)])
    seen = shown(motion(3), [term("cross_axis", "acceleration", share=0.05)])
    some = whole.apply({"α 2": seen[1], "α 3": seen[2]})
    assert any(one == "cross_axis (acceleration): not undone for α 3, found no channel of acceleration along x"
               for one in some.said)  # fmt: skip
    exact = seen[2] - ZERO[2]
    assert_same(some["α 3"], exact / SENSITIVITY[2], 1e-12)
    with pytest.raises(BadInput, match="found 'α 9', wanted some of α 1"):
        whole.apply({"α 9": 1.0})


def test_conditions_that_are_not_given_are_said_and_taken_as_nominal() -> None:
    terms = [term("temperature_bias", "rate", coefficient=0.01), term("warm_up", "rate", shift=0.1, time_constant=60.0)]
    found = correction(terms).apply(ZERO)
    assert_same(found.array, np.zeros(6), 1e-12)
    assert "temperature: not given, 25 °C assumed" in found.said
    assert "time: not given, long after the start assumed" in found.said


def test_uncertainty_is_that_of_zero_and_sensitivity() -> None:
    found = correction([]).apply(ZERO + 10.0 * SENSITIVITY)
    assert found.u["turn x"] == pytest.approx(math.hypot(1e-3, 10.0 * 1e-4) / 0.21)


@pytest.mark.parametrize(
    ("raw", "given", "found"),
    [
        (np.zeros((5, 3)), {}, "found the shape (5, 3), wanted 6 channels first"),
        ({}, {}, "found no channel"),
        ({"α 1": np.zeros(3), "α 2": np.zeros(4)}, {}, "wanted one for all"),
        ({"α 1": 2.5}, {"rate": 100.0}, "wanted a record and its rate"),
        ({"α 1": np.zeros(3)}, {"rate": -1.0}, "found -1.0"),
        ({"α 1": np.zeros(3)}, {"temperature": np.zeros(2)}, "wanted one for all"),
    ],
)
def test_what_cannot_be_corrected_is_refused(raw: Any, given: dict[str, Any], found: str) -> None:
    with pytest.raises(BadInput) as refused:
        correction([]).apply(raw, **given)
    assert found in str(refused.value)


def test_counts_become_volts() -> None:
    assert counts_to_volts([0, 65535]).tolist() == [-10.0, 10.0]


@pytest.mark.parametrize("late", [-0.0071, 0.0, 0.0123])
def test_a_shift_goes_either_way(late: float) -> None:
    found = taps(lambda f: np.asarray(np.exp(-2j * math.pi * f * late), np.complex128), RATE)
    time = np.arange(500) / RATE
    out = found(np.sin(2.0 * math.pi * 30.0 * (time - late)))
    assert out[100:-100] == pytest.approx(np.sin(2.0 * math.pi * 30.0 * time)[100:-100], abs=1e-3)
