"""Tumbles and records at rest on the rig's own bench are parts of a fit: gravity judges triads, rest the gyros."""

from __future__ import annotations

import statistics
from functools import lru_cache

import fast_bench
import pytest

from rig.cli.repair import verdict_text
from rig.diagnose.conclusion import concluded
from rig.diagnose.diagnose import diagnose
from rig.diagnose.misfit import compare
from rig.fit import adequacy
from rig.fit.evidence import Evidence, evidence_of
from rig.fit.fit import Fit, begin, fit
from rig.shelf import shelf


@lru_cache(maxsize=2)
def tumbled(name: str = "", poses: int = 24) -> Evidence:
    hidden = [{"name": name, "parameters": {"quantity": "acceleration", "coefficient": 2e-3}}] if name else []
    world = fast_bench.world(3, hidden)
    return evidence_of([fast_bench.measure({"procedure": "tumble", "poses": poses, "record": "2 s"}, world)])


def test_every_unit_is_a_part_and_a_clean_world_leaves_nothing_but_noise() -> None:
    evidence = tumbled()
    assert {part.experiment for part in evidence.parts} == {"poses"}
    assert len({part.name for part in evidence.parts}) == len(evidence.parts) == 4  # three triads and the gyros
    found = compare(evidence)
    assert adequacy.adequate(found.fit)
    for group in found.groups:
        assert 0.7 < group.ratio < 1.3
        assert group.heldout_ratio < 2.5


@pytest.mark.parametrize(("poses", "record"), [(24, "2 s"), (24, "5 s"), (6, "5 s")])
def test_squares_of_what_a_clean_tumble_leaves_are_as_many_as_its_degrees_of_freedom(poses: int, record: str) -> None:
    found = []
    for seed in range(1, 11):
        run = fast_bench.measure({"procedure": "tumble", "poses": poses, "record": record}, fast_bench.world(seed))
        fit = free_fit(evidence_of([run]))
        told = 12 + 9  # zeros, and sensitivities of the triads: gravity tells none of the gyros
        found.append(fit.chi2 / (fit.count - told))
    assert statistics.median(found) == pytest.approx(1.0, abs=0.1)


def free_fit(evidence: Evidence) -> Fit:
    """Nothing is believed of sensitivities."""
    return fit(evidence.parts, begin(evidence.parts, evidence.nuisances, free=True))


def test_sensitivities_by_gravity_are_those_of_a_sweep_within_their_uncertainty() -> None:
    world = fast_bench.world(3, [])
    swept = evidence_of([fast_bench.measure({"procedure": "frequency_sweep", "axis": "x"}, world)]).fitted()
    posed = tumbled().fitted()
    for name in ("unit_a_x", "unit_b_x"):
        us = [float(one.covariance[k, k]) ** 0.5 for one in (swept, posed) for k in (one.layout.gains[name],)]
        apart = swept.state.gain[name] - posed.state.gain[name]
        assert abs(apart) < 4.0 * (us[0] ** 2 + us[1] ** 2) ** 0.5
        assert us[1] < 2e-3


def test_a_nonlinearity_that_gravity_shows_is_named_from_poses_alone() -> None:
    found = diagnose(tumbled("quadratic"))
    assert found.verdict == "missing"
    assert "quadratic" in {one.name for step in found.steps for one in step.members}


@pytest.mark.parametrize("poses", [6, 12])
def test_few_poses_are_compared_and_said_to_be_few(poses: int) -> None:
    evidence = tumbled(poses=poses)
    assert adequacy.adequate(evidence.fitted())
    assert any("attitudes are fewer" in said for said in evidence.blind) == (poses < 9)


def test_a_record_at_rest_tells_the_zero_output_of_the_gyros_and_leaves_nothing_but_noise() -> None:
    evidence = evidence_of([fast_bench.measure({"procedure": "noise", "length": "60 s"}, fast_bench.world(3, []))])
    part = evidence.parts[0]
    assert all(part.channels.rates)
    assert [one.experiment for one in evidence.parts] == ["poses", "shaker"]  # means of the gyros, noise of all
    fit = evidence.fitted()
    assert adequacy.adequate(fit)
    assert fit.state.zero[0] == pytest.approx(2.5, abs=0.1)
    assert any("nobody says how the cube lay" in note for note in evidence.notes)


def test_a_zero_that_follows_the_temperature_is_seen_at_rest() -> None:
    hidden = {"name": "temperature_bias", "parameters": {"quantity": "rate", "coefficient": 0.02}}
    run = fast_bench.measure({"procedure": "noise", "length": "600 s"}, fast_bench.world(3, [hidden]))
    found = diagnose(evidence_of([run]))
    assert {"temperature_bias", "warm_up"} & {one.name for step in found.steps for one in step.members}


def test_six_poses_tell_a_triad_and_twelve_judge_it_too() -> None:
    few, enough = (diagnose(tumbled(poses=count)) for count in (6, 12))
    assert (few.verdict, enough.verdict) == ("undecided", "adequate")
    said = verdict_text(concluded(tumbled(poses=6), few, shelf()))
    assert "36 of 72, and the other 36 are too few for" in said
    assert said.endswith("take more poses, twelve or more")
