"""Where a model fails, against worlds in which what is missing is known, and tests of noise against known numbers."""

from __future__ import annotations

import json
import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import fast_bench
import numpy as np
import pytest

from rig.cli.repair import worst_text
from rig.diagnose.misfit import Comparison, compare
from rig.diagnose.misfit_cells import cells, tables
from rig.diagnose.whiteness import fisher_g, ljung_box, runs
from rig.errors import BadInput
from rig.fit.evidence import Evidence, evidence_of
from rig.fit.tails import deviate
from rig.model import Term
from rig.shelf import shelf

SWEEP = {"procedure": "frequency_sweep", "axis": "x"}
TURN = {"procedure": "turntable"}


@lru_cache(maxsize=8)
def _evidence(procedure: str, seed: int, name: str = "", **parameters: Any) -> Evidence:
    hidden = [{"name": name, "parameters": parameters}] if name else []
    document = SWEEP if procedure == "sweep" else TURN
    return evidence_of([fast_bench.measure(document, fast_bench.world(seed, hidden))])


def _lag() -> Evidence:
    return _evidence("sweep", 1, "first_order_lag", time_constant=4e-5, quantity="acceleration")


def _quadratic() -> Evidence:
    return _evidence("sweep", 1, "quadratic", coefficient=8e-4, quantity="acceleration")


def _compared(evidence: Evidence) -> Comparison:
    return compare(evidence)


@pytest.mark.parametrize(("procedure", "seed"), [("sweep", 1), ("sweep", 7), ("turn", 1)])
def test_a_clean_world_leaves_nothing_but_noise(procedure: str, seed: int) -> None:
    found = _compared(_evidence(procedure, seed))
    assert len(found.worst) == 3
    assert not any(one.stands_out for one in found.worst)
    assert all(one.in_words.startswith("nothing stands out") for one in found.worst)
    for group in found.groups:
        assert 0.85 < group.ratio < 1.2
        assert group.heldout_ratio < 1.2
        assert group.error == pytest.approx(group.noise * group.ratio)


def test_a_hidden_lag_is_a_phase_that_grows_as_f_at_both_levels_alike() -> None:
    worst = _compared(_lag()).worst
    words = next(one.in_words for one in worst if one.component == "phase")
    assert words == worst[0].in_words
    assert "grows as f," in words
    assert "same at both levels" in words
    assert "unit A x" in words
    assert "unit B x" in words
    assert "gyro" not in words
    magnitude = next(one.in_words for one in worst if one.component == "magnitude")
    assert "grows as f²" in magnitude


def test_a_hidden_quadratic_is_a_second_harmonic_as_the_square_of_the_level() -> None:
    first = _compared(_quadratic()).worst[0]
    assert first.in_words.startswith("2f, ")
    assert "as the square of the level" in first.in_words
    assert first.channels == ("unit_a_x", "unit_b_x")
    assert first.ratio > 3.0


def test_adding_the_missing_effect_brings_the_error_down_to_the_noise_on_held_out_points_too() -> None:
    before = _compared(_quadratic())
    term = Term(shelf()["quadratic"], "acceleration", {c.name: 0.0 for c in shelf()["quadratic"].coordinates})
    after = compare(_quadratic(), [term])
    assert before.groups[0].ratio > 1.5
    assert before.groups[0].heldout_ratio > 1.5
    assert after.groups[0].ratio < 1.1
    assert after.groups[0].heldout_ratio < 1.2
    assert before.groups[0].noise == pytest.approx(after.groups[0].noise, rel=0.01)


def test_a_sensitivity_that_follows_the_temperature_is_said_to() -> None:
    evidence = _evidence("sweep", 1, "temperature_scale", coefficient=6e-3, quantity="acceleration")
    first = _compared(evidence).worst[0]
    assert first.component == "magnitude"
    assert "follows " in first.in_words
    assert "temperature" in first.in_words


def test_an_eccentric_encoder_is_seen_once_per_revolution() -> None:
    first = _compared(_evidence("turn", 1, "encoder_eccentricity", ratio=8e-3, direction=1.0)).worst[0]
    assert first.stands_out
    assert "once per revolution" in first.in_words
    assert "yaw" in first.in_words


def test_a_reference_that_would_have_to_leave_its_stated_uncertainty_is_a_misfit_in_those_words() -> None:
    found = _compared(_evidence("sweep", 1, "ldv_delay", time=5e-5))
    (pull,) = found.references
    assert pull.effect == "ldv_delay"
    assert 10.0 < pull.times < 60.0
    words = f"the delay of the vibrometer's decoder would have to be {pull.times:.2g} times its stated uncertainty off"
    assert f"  {words}" in worst_text(found)
    assert found.as_json([])["references"][0]["in_words"] == words
    assert _compared(_evidence("sweep", 1)).references == ()


def test_the_paper_s_model_without_filters_fails_in_magnitude_and_in_phase_that_grows_as_f() -> None:
    found = compare(_evidence("sweep", 1), poles=False)
    words = {one.component: one.in_words for one in found.worst}
    assert all(one.stands_out for one in found.worst[:2])
    assert "grows as f²" in words["magnitude"]
    assert "grows as f," in words["phase"]
    assert "unit A x, unit B x" in words["phase"]


def test_the_noise_is_the_same_whatever_the_model() -> None:
    good, bad = (compare(_evidence("sweep", 1), poles=poles) for poles in (True, False))
    for one, other in zip(good.groups, bad.groups, strict=True):
        assert one.noise == pytest.approx(other.noise)


def test_the_noise_of_a_two_g_unit_is_that_of_its_data_sheet() -> None:
    # 1.5 mg rms over 628 Hz of noise bandwidth; a line of one second has 4·density, magnitudes of both parts together
    group = next(one for one in _compared(_evidence("sweep", 1)).groups if one.channels[0] == "unit_a_x")
    density = (1.5e-3 * 9.80665) ** 2 / (math.pi / 2.0 * 400.0)
    assert group.noise == pytest.approx(math.sqrt(4.0 * density), rel=0.6)


def test_json_has_the_keys_that_are_promised_and_only_finite_numbers() -> None:
    made = _compared(_lag()).as_json([Path("a.svg")])
    text = json.dumps(made, allow_nan=False)
    assert json.loads(text)["figures"] == ["a.svg"]
    assert set(made) == {"groups", "error", "heldout_error", "worst_at", "worst", "references", "findings", "figures"}
    assert set(made["groups"][0]) == {
        "name", "channels", "experiment", "error", "noise", "unit", "ratio", "heldout_ratio", "heldout_error",
        "noise_from",
    }  # fmt: skip
    assert set(made["worst"][0]) == {"where", "ratio", "in_words"}


def test_cells_of_one_kind_share_all_rows_out_among_themselves() -> None:
    table = tables(_evidence("sweep", 1).fitted())[0]
    whole = sum(one.chi2 for one in cells(table) if one.cut is None and len(one.rows) == 1)
    assert whole == pytest.approx(float(table.squares[table.used].sum()))
    levels = [one for one in cells(table) if one.cut is not None and one.cut.kind == "level" and one.rows == (0,)]
    assert sum(one.count for one in levels) == int(table.used[0].sum())


def test_the_deviate_of_chi_squared_is_normal_but_for_the_allowance() -> None:
    draws = np.random.default_rng(3).chisquare(6.0, 20000)
    z = np.array([deviate(float(one), 6, 0.06) for one in draws])
    assert abs(z.mean()) < 0.03
    assert float(np.std(z)) == pytest.approx(1.0, abs=0.03)
    assert float(np.mean(z > 3.0)) < 3e-3
    assert deviate(2.0e4, 10000, 0.06) < (2.0e4 - 1e4) / math.sqrt(2e4)


def test_runs_agree_with_a_sequence_counted_by_hand() -> None:
    # ++ -- + --- ++ : 5 plus, 5 minus, 5 runs; expected 6, variance 50·40/(100·9)
    values = np.array([1, 1, -1, -1, 1, -1, -1, -1, 1, 1], float)
    found = runs(values)
    assert found.statistic == pytest.approx(-1.0 / math.sqrt(50.0 * 40.0 / 900.0))


def test_noise_passes_the_tests_of_whiteness_as_often_as_it_should() -> None:
    rng = np.random.default_rng(5)
    chances = np.array(
        [
            [runs(x).probability, ljung_box(x).probability, fisher_g(rng.exponential(size=60)).probability]
            for x in rng.normal(size=(400, 120))
        ]
    )
    for level in (0.05, 0.3):
        assert np.all(np.abs(np.mean(chances < level, axis=0) - level) < 5.0 * math.sqrt(level * (1 - level) / 400))


def test_a_drift_fails_runs_and_ljung_box_and_a_line_fails_fisher_s_g() -> None:
    rng = np.random.default_rng(6)
    drift = np.linspace(-2.0, 2.0, 60) + rng.normal(size=60)
    assert runs(drift).probability < 1e-3
    assert ljung_box(drift).probability < 1e-6
    powers = rng.exponential(size=200)
    powers[40] += 25.0
    assert fisher_g(powers).probability < 1e-5


def test_fisher_s_g_has_the_published_five_per_cent_points() -> None:
    # Fisher (1929), table: m = 10, g = 0.4450; m = 20, g = 0.2705; m = 50, g = 0.1313
    for m, g in ((10, 0.4450), (20, 0.2705), (50, 0.1313)):
        powers = np.full(m, (1.0 - g) / (m - 1))
        powers[0] = g
        assert fisher_g(powers).probability == pytest.approx(0.05, rel=0.02)


def test_too_few_values_are_refused() -> None:
    with pytest.raises(BadInput, match="found 3 values, wanted at least 8"):
        runs(np.ones(3))
