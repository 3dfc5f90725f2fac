"""Tables of frequency responses: what comes back of a sensor that was put into one, and what is said of it."""

from __future__ import annotations

import math
from typing import Any

import imported_worlds as worlds
import numpy as np
import pytest
from imported_worlds import FREQUENCIES, Sensor, response, response_table

from rig.diagnose.conclusion import conclude
from rig.diagnose.diagnose import diagnose
from rig.errors import BadInput
from rig.fit import adequacy
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.parts.response import ResponseTable
from rig.shelf import effect_of, nothing_of, shelf

TRUE = Sensor(gain=1.02, delay=2e-3, window=3e-3)


def table(sensor: Sensor, seed: int = 1, **how: Any) -> Evidence:
    return worlds.evidence(response([response_table(sensor.phasor, seed, **how)]))


def fitted(evidence: Evidence, *names: str) -> Fit:
    return evidence.fitted([nothing_of(effect_of(name), "acceleration") for name in names])


def errors(found: Fit) -> dict[str, float]:
    """Gain, delay and window against the truth, in their standard uncertainties."""
    u = math.sqrt(found.covariance[found.layout.gains["acc"], found.layout.gains["acc"]])
    off = {"gain": (1.0 + found.state.gain["acc"] - TRUE.gain) / u}
    for k, (term, true) in enumerate(zip(found.state.terms, (TRUE.delay, TRUE.window), strict=True)):
        name, value = next(iter(term.at.items()))
        off[term.effect.name] = (value - true) / found.u(k)[name]
    return off


def from_near(evidence: Evidence) -> Fit:
    delay = nothing_of(effect_of("delay"), "acceleration").moved(time=1.5e-3)
    window = nothing_of(effect_of("moving_average"), "acceleration").moved(window=2e-3)
    return evidence.fitted([delay, window])


def test_gain_delay_and_window_come_back_within_three_uncertainties() -> None:
    found = from_near(table(TRUE))
    assert {name: off for name, off in errors(found).items() if abs(off) > 3.0} == {}
    assert found.u(0)["time"] < 2e-5


def test_error_over_stated_uncertainty_is_near_one_and_chi2_is_the_number_of_rows() -> None:
    fits = [from_near(table(TRUE, seed)) for seed in range(30)]
    offs = [errors(one) for one in fits]
    for name in ("gain", "delay", "moving_average"):
        assert math.sqrt(np.mean([one[name] ** 2 for one in offs])) == pytest.approx(1.0, abs=0.35), name
    assert np.mean([one.chi2 / (one.count - 3) for one in fits]) == pytest.approx(1.0, abs=0.1)


def test_phases_beyond_half_a_turn_are_one_delay() -> None:
    late = table(Sensor(delay=12e-3))  # three turns at 250 Hz, told modulo one
    found = diagnose(late)
    assert found.named == ("delay",)
    assert found.steps[0].taken.term.at["time"] == pytest.approx(12e-3, abs=3e-6)
    assert found.final.chi2 / found.final.count < 1.5


def test_an_opposite_sign_is_taken_as_sign_and_said() -> None:
    evidence = table(Sensor(gain=-0.99))
    assert evidence.parts[0].channels.sensitivity.tolist() == [-1.0]
    found = diagnose(evidence)
    assert found.verdict == "adequate"
    assert found.final.state.gain["acc"] == pytest.approx(-0.01, abs=2e-3)
    assert any("counts against the reference" in note for note in evidence.notes)
    assert not any("counts against" in note for note in table(Sensor(gain=0.99)).notes)


@pytest.mark.parametrize(("wrong", "verdict"), [(0.0, True), (1.0, True), (10.0, False)])
def test_a_reference_may_be_wrong_by_what_is_stated_in_every_repeat_alike(wrong: float, verdict: bool) -> None:
    assert adequacy.adequate(table(Sensor(1.01), seed=4, wrong=wrong).fitted()) is verdict


def test_stated_uncertainty_does_not_fall_with_the_number_of_repeats() -> None:
    few, many = (table(Sensor(), repeats=n, scatter=1e-4).fitted() for n in (3, 12))
    assert many.covariance[0, 0] == pytest.approx(few.covariance[0, 0], rel=0.05)
    few, many = (table(Sensor(), repeats=n, scatter=1e-2, stated=1e-5).fitted() for n in (3, 12))
    assert many.covariance[0, 0] == pytest.approx(
        few.covariance[0, 0] / 4.0, rel=0.6
    )  # three repeats tell scatter badly


def test_two_repeats_of_nothing_stated_are_enough_and_one_is_refused() -> None:
    assert diagnose(table(Sensor(1.01), repeats=3, stated=0.0)).verdict == "adequate"
    with pytest.raises(BadInput, match="neither repeats nor uncertainties"):
        table(Sensor(), repeats=1, stated=0.0)


@pytest.mark.parametrize("sensor", [Sensor(0.99, 5e-3, 3e-3), Sensor(1.01, 1e-4, 3e-3)])
def test_delay_and_moving_average_are_found_together(sensor: Sensor) -> None:
    found = diagnose(table(sensor, seed=3))
    assert found.verdict == "missing"
    assert sorted(found.named) == ["delay", "moving_average"]
    at = {term.effect.name: term.at for term in found.final.state.terms}
    assert at["delay"]["time"] == pytest.approx(sensor.delay, abs=1.5e-5)
    assert at["moving_average"]["window"] == pytest.approx(sensor.window, abs=2e-5)
    last = found.steps[-1].after
    assert last.chi2 == pytest.approx(found.final.chi2, rel=0.01)  # the ladder ends where the diagnosis ends


def test_what_is_excluded_is_said_with_the_error_that_it_leaves() -> None:
    found = conclude(table(Sensor(0.99, 5e-3, 3e-3), seed=3), [], shelf())
    first = [one for one in found.excluded if one.step == 1]
    assert len(first) >= 2
    refitted = [(one.error_after, one.why) for one in first if one.error_after is not None]
    assert refitted
    assert all(error > found.after + 1.0 and "times the noise" in why for error, why in refitted)
    assert all("removes far less" in one.why for one in first if one.error_after is None)
    taken = {one.effect for one in found.candidates}
    assert not taken & {one.effect for one in first}


def test_the_steps_of_a_pair_are_those_of_the_final_model() -> None:
    found = diagnose(table(Sensor(0.98, 2e-3, 1e-3), seed=3))
    assert sorted(found.named) == sorted(term.effect.name for term in found.final.state.terms)
    assert found.steps[-1].after.chi2 == pytest.approx(found.final.chi2, rel=0.01)


def test_a_file_that_is_marked_is_held_out_whole_and_else_every_third_frequency() -> None:
    tables = [response_table(Sensor().phasor, seed) for seed in (1, 2)]
    marked = worlds.evidence(response(tables, held=[1]))
    assert [part.held_out.all() or not part.held_out.any() for part in marked.parts] == [True, True]
    assert [bool(part.held_out.any()) for part in marked.parts] == [False, True]
    part = worlds.evidence(response(tables[:1])).parts[0]
    assert isinstance(part, ResponseTable)
    held = np.unique(part.data.frequency[part.data.held])
    np.testing.assert_allclose(held, FREQUENCIES[2::3])


def test_a_level_that_rises_with_frequency_is_said_to_hide_what_depends_on_it() -> None:
    blind = table(Sensor(), level=1.0 + FREQUENCIES).blind
    assert any("rises with frequency" in one for one in blind)
    assert not any("rises with frequency" in one for one in table(Sensor()).blind)


def test_a_clean_table_names_nothing() -> None:
    gains = 1.0 + 0.01 * np.random.default_rng(5).normal(size=6)
    found = [diagnose(table(Sensor(gain), seed)) for seed, gain in enumerate(gains.tolist())]
    assert [one.verdict for one in found] == ["adequate"] * 6
