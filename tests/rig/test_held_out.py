"""What is held out decides: no choice sees those rows, and no model is called adequate before they were asked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import blind_imports
import blind_laws
import fast_bench
import imported_sweeps
import imported_worlds as worlds
import numpy as np
import pytest
from blind_imports import Record
from imported_worlds import Sensor, response, response_table
from numpy.typing import NDArray

from rig.cli.repair import verdict_text
from rig.diagnose.conclusion import concluded
from rig.diagnose.diagnose import diagnose
from rig.fit import adequacy
from rig.fit import fit as fitting
from rig.fit.evidence import Evidence, evidence_of
from rig.fit.quality import errors_of
from rig.fit.tails import deviate, limit, log_tail
from rig.parts.part import Part
from rig.parts.platter import Platter
from rig.parts.response import ResponseTable
from rig.parts.sweep import Sweep
from rig.shelf import shelf
from rig.signals.blocks import inward, spread

LATE = Sensor(gain=1.01, delay=2e-3)


def table(sensor: Sensor, seed: int = 1, **how: Any) -> Evidence:
    return worlds.evidence(response([response_table(sensor.phasor, seed, **how)]))


def changed(evidence: Evidence, factor: float) -> Evidence:
    """The same with every response that is held out so many times as large."""
    parts = []
    for part in evidence.parts:
        assert isinstance(part, ResponseTable)
        ratio = np.where(part.data.held, factor, 1.0) * part.data.ratio
        parts.append(ResponseTable(replace(part.data, ratio=ratio)))
    return replace(evidence, parts=tuple(parts))


def measured(document: Mapping[str, object]) -> tuple[Part, ...]:
    return evidence_of([fast_bench.measure(dict(document), fast_bench.world(3, []))]).parts


@pytest.fixture(scope="module")
def sweep() -> Sweep:
    parts = measured({"procedure": "frequency_sweep", "axis": "x", "points": 8})
    return next(part for part in parts if isinstance(part, Sweep))


@pytest.fixture(scope="module")
def turntable() -> Platter:
    parts = measured({"procedure": "turntable", "revolutions": 10, "rest": "30 s"})
    return next(part for part in parts if isinstance(part, Platter))


def shares(states: Sequence[object], held: NDArray[np.bool_]) -> dict[object, tuple[int, float]]:
    """How many blocks each state has, and what share of them is held out."""
    found: dict[object, list[bool]] = {}
    for state, out in zip(states, held.tolist(), strict=True):
        found.setdefault(state, []).append(out)
    return {state: (len(marks), sum(marks) / len(marks)) for state, marks in found.items()}


def test_every_third_block_of_every_state_is_held_out_and_none_that_is_alone() -> None:
    states = ["rest"] * 6 + ["ramp"] + ["fast"] * 5 + ["slow"] * 7 + ["rest"] * 3
    held = spread(states)
    found = shares(states, held)
    assert found["ramp"] == (1, 0.0)
    assert all(0.2 <= share <= 0.5 for state, (_, share) in found.items() if state != "ramp")
    assert int(held.sum()) == 21 // 3
    assert int(spread(states, 0.4).sum()) == math.floor(0.4 * 21)
    assert not spread(["a", "b", "c"]).any()


def test_of_three_levels_that_are_met_once_the_middle_one_is_held_out() -> None:
    """Held out in their order, every highest would judge a model where it was never fitted."""
    levels = np.array([0.0, 0.1, 0.3, 0.9, 0.2, 0.8, 0.5, 0.4])
    some = levels > 0.0
    held = inward(spread(["rest", *["driven"] * 7]), levels, some)
    assert levels[held].tolist() == [0.3, 0.5]
    assert inward(held, levels, np.zeros(8, np.bool_)).tolist() == held.tolist()


def test_a_cubic_that_shows_at_the_highest_levels_alone_is_named() -> None:
    """Each of two frequencies once at three rising levels."""
    record = Record("sweep", 1341231747, blind_laws.law_of("cubic"), {"size": 8e-4, "on": "acceleration"})
    diagnosis = diagnose(blind_imports.evidence(record.made()))
    assert (diagnosis.verdict, diagnosis.named) == ("missing", ("cubic",))


def test_a_sweep_holds_out_of_every_level_and_of_rest_early_and_late(sweep: Sweep) -> None:
    data = sweep.data
    held = sweep.held_out.reshape(len(data.channels.names), len(data.index), -1)[0, :, 0]
    states = [(level, bool(driven)) for level, driven in zip(data.level, data.driven, strict=True)]
    found = shares(states, held)
    assert len(found) == 3
    assert all(count > 2 and 0.2 < share < 0.45 for count, share in found.values())
    assert all(piece.any() for piece in np.array_split(held, 3))


def test_a_turntable_run_holds_out_of_rest_of_every_speed_and_of_what_lies_between(turntable: Platter) -> None:
    states = turntable.of.states
    held = turntable.held_out[: len(states)]  # the means of the stretches come first
    found = shares(states, held)
    assert {what for what, _ in found} >= {"rest", "ramp", "45"}
    assert all(0.15 < share < 0.6 for count, share in found.values() if count > 2)


@pytest.mark.parametrize("kind", ["sweep", "turntable"])
def test_nothing_that_is_held_out_is_in_a_row_that_is_fitted(kind: str, request: pytest.FixtureRequest) -> None:
    """Means that wander together are made independent with those held out last."""
    part = request.getfixturevalue(kind)
    shifted = part.data.observed.copy()
    if kind == "sweep":
        held = part.held_out.reshape(len(part.channels.names), len(part.data.index), -1)[0, :, 0]
        shifted[:, held] += 1e-3
    else:
        for (begin, end), out in zip(part.data.stretches, part.held_out[: len(part.data.stretches)], strict=True):
            shifted[:, begin:end] += 1e-3 * out
    change = part.target - type(part)(replace(part.data, observed=shifted)).target
    assert np.abs(change[part.held_out & part.counted]).max() > 1.0
    assert np.abs(change[~part.held_out]).max() < 1e-6


def test_the_error_of_a_mean_is_that_of_the_mean_and_not_of_a_window(turntable: Platter) -> None:
    evidence = Evidence((turntable,), (), ("one",), "made", True, ())
    domain, name = "mean, at rest", turntable.row_names[0]
    place = errors_of(evidence, evidence.fitted()).at(evidence.fitted(), f"{name}, {domain}")
    lengths = [end - begin for begin, end in turntable.data.stretches]
    variance = turntable.noise()[0][: len(lengths)] / lengths
    here = turntable.domains()[domain][: len(lengths)]
    assert place.error == pytest.approx(place.ratio * math.sqrt(np.mean(variance[here])), rel=0.1)


def test_tails_have_the_published_points_of_f_and_of_chi_squared() -> None:
    one_in_a_hundred, one_in_a_thousand = 2.3263, 3.0902
    assert deviate(10 * 2.632, 10, math.sqrt(2.0 / 60.0)) == pytest.approx(one_in_a_hundred, abs=1e-3)  # F(10, 60)
    assert deviate(18.467, 4, 0.0) == pytest.approx(one_in_a_thousand, abs=1e-3)  # χ² of four
    assert limit(0.01, 1) == pytest.approx(one_in_a_hundred, abs=1e-3)


def test_of_few_rows_five_standard_deviations_are_nothing_much_and_of_many_they_are() -> None:
    few, many = (n * (1.0 + 5.0 * math.sqrt(2.0 / n)) for n in (4, 4000))
    assert deviate(few, 4, 0.0) < 3.1
    assert deviate(many, 4000, 0.0) > 4.8


@pytest.mark.parametrize("count", [1, 4, 60, 3000])
def test_a_larger_error_is_always_more_unusual_however_far_out(count: int) -> None:
    for allowance in (0.0, 0.06, 0.3):
        found = [deviate(ratio * count, count, allowance) for ratio in np.geomspace(1.0, 1e9, 300)]
        assert np.all(np.isfinite(found))
        assert np.all(np.diff(found) > 0.0)
        assert np.all(np.diff([log_tail(ratio, count, allowance) for ratio in np.geomspace(1.0, 1e9, 300)]) < 0.0)


def test_what_a_fit_does_not_know_of_its_parameters_is_no_misfit_of_the_rows_that_it_left_out() -> None:
    """Sixty tables of six frequencies: two of them are held out, and the gain is found from the other four."""
    plain, judged, rows = 0.0, 0.0, 0
    for seed in range(60):
        evidence = table(Sensor(gain=1.01), seed, frequency=np.geomspace(10.0, 250.0, 6), repeats=1, wrong=0.0)
        trained = fitting.fit(evidence.parts, evidence.start(), use=evidence.training)
        left = fitting.residual(evidence.parts, trained.state)[~evidence.training]
        normal, out = trained.normal, np.flatnonzero(~evidence.training)
        (block,) = fitting.linearised(evidence.parts, trained.state).blocks
        plain, rows = plain + float(left @ left), rows + len(left)
        judged += adequacy.distance(left, block.matrix[out], block.columns, normal)
    assert rows == 60 * 2 * 2
    assert judged < plain
    assert judged / rows == pytest.approx(1.0, abs=0.25)


def test_the_distance_of_rows_left_out_is_that_of_their_own_and_the_parameters_covariance() -> None:
    random = np.random.default_rng(1)
    matrix, fitted, left = random.normal(size=(5, 3)), random.normal(size=(9, 3)), random.normal(size=5)
    normal = np.zeros((4, 4))
    normal[1:, 1:] = fitted.T @ fitted
    whole = np.eye(5) + matrix @ np.linalg.inv(fitted.T @ fitted) @ matrix.T
    found = adequacy.distance(left, matrix, np.array([1, 2, 3]), normal)
    assert found == pytest.approx(float(left @ np.linalg.solve(whole, left)))


def test_what_a_part_finds_for_itself_counts_as_parameters_that_are_known_to_one() -> None:
    random = np.random.default_rng(2)
    matrix, unsure, left = random.normal(size=(5, 2)), random.normal(size=(5, 3)), random.normal(size=5)
    whole = np.eye(5) + 0.25 * matrix @ matrix.T + unsure @ unsure.T
    found = adequacy.distance(left, matrix, np.array([0, 1]), 4.0 * np.eye(2), unsure)
    assert found == pytest.approx(float(left @ np.linalg.solve(whole, left)))


def test_levels_that_are_all_met_once_and_none_of_which_can_be_spared_leave_a_clean_sweep_undecided() -> None:
    two, three = (worlds.evidence(imported_sweeps.made(levels=levels)) for levels in ((0.3, 1.0), (0.3, 0.5, 1.0)))
    said = verdict_text(concluded(two, diagnose(two), shelf()))
    assert "(0 of 23, what was met once is kept): take more levels or frequencies, or each again" in said
    assert diagnose(three).verdict == "adequate"


def test_what_a_fit_does_not_determine_takes_from_rows_left_out_all_that_it_can() -> None:
    left = np.array([30.0, 31.0, 29.0])
    found = adequacy.distance(left, np.ones((3, 1)), np.array([0]), np.zeros((1, 1)))
    assert found == pytest.approx(2.0)  # what is left beside their mean


def test_no_choice_sees_the_rows_that_are_held_out() -> None:
    evidence = table(LATE)
    true, other = diagnose(evidence), diagnose(changed(evidence, 1.05))
    for found in (true, other):
        assert found.steps[0].taken.name == "delay"
    assert true.trained is not None
    assert other.trained is not None
    assert other.trained.chi2 == pytest.approx(true.trained.chi2, rel=1e-6)
    assert (true.verdict, other.verdict) == ("missing", "unlisted")


def test_a_model_that_holds_only_where_it_was_fitted_is_not_adequate() -> None:
    assert diagnose(table(Sensor(gain=1.01))).verdict == "adequate"
    assert diagnose(changed(table(Sensor(gain=1.01)), 1.05)).verdict == "unlisted"


def test_with_too_few_rows_held_out_that_is_said_and_nothing_is_called_adequate() -> None:
    evidence = table(Sensor(gain=1.01), frequency=np.geomspace(10.0, 250.0, 5), repeats=1)
    found = diagnose(evidence)
    assert found.held == ()
    assert found.verdict == "undecided"
    said = verdict_text(concluded(evidence, found, shelf()))
    assert "too few rows are held out to judge by (" in said
    assert "take more frequencies" in said
    assert "nan" not in said
