"""A noise record as data."""

from __future__ import annotations

from dataclasses import replace

import pytest

from procedures.noise import Settings, expand
from rig.bench.steps import Ask, BenchFacts, Static


@pytest.mark.parametrize("cables", ["shaker", "turntable"])
def test_a_noise_run_connects_its_cables_lets_them_settle_and_records_once(facts: BenchFacts, cables: str) -> None:
    plan = expand(Settings.model_validate({"length": "10 min", "cables": cables}), facts)
    ask, static = plan.steps
    assert isinstance(ask, Ask)
    assert ask.request.settings == {"set": cables}
    assert isinstance(static, Static)
    assert (static.seconds, static.cables, static.purpose, static.settle) == (600.0, cables, "noise", 2.0)
    assert plan.points == 1
    assert plan.duration > 602.0
    assert plan.mistakes == ()


@pytest.mark.parametrize("length", ["0.5 s", "49 h"])
def test_a_length_out_of_reason_is_a_mistake_at_its_key(facts: BenchFacts, length: str) -> None:
    (mistake,) = expand(Settings.model_validate({"length": length}), facts).mistakes
    assert mistake.path == ("length",)
    assert "wanted 1 s to 48 h" in mistake.text


def test_a_bench_without_any_recorder_and_a_bad_length_are_told_together(facts: BenchFacts) -> None:
    plan = expand(Settings.model_validate({"length": "0 s"}), replace(facts, has=frozenset({"analyzer"})))
    assert [mistake.path for mistake in plan.mistakes] == [("length",), ("procedure",)]


def test_the_cube_alone_is_recorder_enough(facts: BenchFacts) -> None:
    assert expand(Settings(), replace(facts, has=frozenset({"cube"}))).mistakes == ()
