"""A turntable run as data: phases, senses, speeds, and mistakes before anything turns."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from procedures.turntable import Settings, expand, speed_of
from rig.bench.benchfile import describe
from rig.bench.steps import Ask, BenchFacts, Plan, Spin, Static
from rig.errors import BadInput
from rig.yaml.config import shipped

BENCH = describe(shipped("benches/simulated.yaml")).facts()


def made(**settings: Any) -> Settings:
    return Settings.model_validate(settings)


def phases(plan: Plan) -> list[str]:
    return [step.phase if isinstance(step, Spin) else step.label for step in plan.steps]


def spins(plan: Plan) -> list[Spin]:
    return [step for step in plan.steps if isinstance(step, Spin)]


def test_a_run_is_cables_mount_rest_spin_up_hold_coast_down_rest(facts: BenchFacts) -> None:
    plan = expand(made(), facts)
    assert phases(plan) == ["cables", "mount", "rest before", "spin_up", "hold", "coast_down", "rest after"]
    assert plan.points == 5
    assert plan.mistakes == ()
    actions = ["cables", "mount_on_turntable", "turntable_speed", "turntable_speed"]
    assert [request.action for request in plan.requests] == actions
    assert [r.settings.get("rpm") for r in plan.requests[2:]] == [pytest.approx(45.0), 0.0]


def test_a_hold_lasts_its_whole_revolutions(facts: BenchFacts) -> None:
    plan = expand(made(revolutions=6, speed="33 1/3 rpm"), facts)
    hold = next(spin for spin in spins(plan) if spin.phase == "hold")
    assert (hold.revolutions, hold.rpm) == (6, pytest.approx(100.0 / 3.0))
    assert hold.duration == pytest.approx(6 * 1.8)


def test_all_gives_both_speeds_in_both_senses_with_the_cube_turned_over_once(facts: BenchFacts) -> None:
    plan = expand(made(all=True), facts)
    holds = [(round(s.rpm, 1), s.inverted) for s in spins(plan) if s.phase == "hold"]
    assert holds == [(45.0, False), (33.3, False), (45.0, True), (33.3, True)]
    mounts = [
        step.request.settings["inverted"] for step in plan.steps if isinstance(step, Ask) and step.label == "mount"
    ]
    assert mounts == [False, True]


def test_all_begins_with_the_speed_and_the_sense_asked_for(facts: BenchFacts) -> None:
    plan = expand(made(all=True, speed="33 1/3 rpm", inverted=True), facts)
    holds = [(round(s.rpm, 1), s.inverted) for s in spins(plan) if s.phase == "hold"]
    assert holds == [(33.3, True), (45.0, True), (33.3, False), (45.0, False)]


def test_touches_stand_between_hold_and_coast_down_and_are_light(facts: BenchFacts) -> None:
    plan = expand(made(perturb=True), facts)
    touches = [spin for spin in spins(plan) if spin.phase == "perturbed"]
    assert [spin.fraction for spin in touches] == [-0.06, -0.03, 0.03]
    assert phases(plan)[3:8] == ["spin_up", "hold", "perturbed", "perturbed", "perturbed"]
    assert sum(request.action == "touch" for request in plan.requests) == 3


def test_records_at_rest_are_on_the_turntable_cables(facts: BenchFacts) -> None:
    rests = [step for step in expand(made(rest="7 s"), facts).steps if isinstance(step, Static)]
    assert [(rest.seconds, rest.cables, rest.purpose) for rest in rests] == [
        (7.0, "turntable", "rest_before"),
        (7.0, "turntable", "rest_after"),
    ]


def test_the_mount_card_says_axis_side_radius_and_angle_in_the_units_of_the_workshop(facts: BenchFacts) -> None:
    settings = made(axis="pitch", inverted=True, radius="80 mm", angle="90°")
    mount = next(r for r in expand(settings, facts).requests if r.action == "mount_on_turntable")
    for words in ("pitch gyro", "upside down", "80 mm", "90°"):
        assert words in mount.text
    assert mount.settings["radius"] == pytest.approx(0.08)
    assert mount.settings["angle"] == pytest.approx(math.pi / 2)


def test_every_mistake_is_told_at_once_with_its_key(facts: BenchFacts) -> None:
    plan = expand(made(speed="78 rpm", rest="0.5 s"), replace(facts, has=frozenset()))
    assert [mistake.path for mistake in plan.mistakes] == [("speed",), ("rest",), ("procedure",), ("procedure",)]
    assert "found 78 rpm, wanted 33 1/3 rpm or 45 rpm" in plan.mistakes[0].text


THIRTY_THREE = ("33", "33.3", "33.33", "33.333", "33.3333333", "33 1/3", "33⅓", "33 ⅓", "100/3", "200 °/s")


@pytest.mark.parametrize("text", THIRTY_THREE)
def test_any_spelling_of_a_speed_is_the_selectors_own(text: str, facts: BenchFacts) -> None:
    assert speed_of(text) == speed_of(f"{text} rpm".replace("°/s rpm", "°/s")) == "33 1/3 rpm"
    plan = expand(made(speed=text if "°" in text else f"{text} rpm"), facts)
    assert not plan.mistakes
    assert all(abs(spin.rpm - 100.0 / 3.0) < 1e-9 for spin in spins(plan))  # the selector takes no other


@pytest.mark.parametrize("text", ["33.4", "34", "32", "45.1", "0", "-45", "78", "33 1/2", "fast", ""])
def test_a_speed_that_the_turntable_lacks_is_refused_with_those_it_has(text: str, facts: BenchFacts) -> None:
    with pytest.raises(BadInput, match="wanted a speed of the turntable: 33 1/3 rpm or 45 rpm"):
        speed_of(text)
    if text not in ("fast", ""):
        mistakes = expand(made(speed=f"{text} rpm"), facts).mistakes
        assert "wanted 33 1/3 rpm or 45 rpm" in mistakes[0].text


def test_a_converter_too_slow_for_the_encoder_lines_is_a_mistake(facts: BenchFacts) -> None:
    (mistake,) = expand(made(), replace(facts, scan_rate=1000.0)).mistakes
    assert mistake.path == ("speed",)
    assert "found 750 encoder lines per second, wanted at most half of 1000 Hz" in mistake.text


@given(
    rpm=st.floats(0.0, 200.0),
    rest=st.floats(0.0, 50_000.0),
    revolutions=st.integers(2, 10_000),
    flags=st.tuples(st.booleans(), st.booleans(), st.booleans()),
)
def test_any_settings_give_a_run_with_rest_at_both_ends_or_mistakes(
    rpm: float, rest: float, revolutions: int, flags: tuple[bool, bool, bool]
) -> None:
    inverted, everything, perturb = flags
    settings = made(
        speed=f"{rpm} rpm",
        rest=f"{rest} s",
        revolutions=revolutions,
        inverted=inverted,
        all=everything,
        perturb=perturb,
    )
    plan = expand(settings, BENCH)
    if plan.mistakes:
        assert {mistake.path[0] for mistake in plan.mistakes} <= {"speed", "rest"}
        return
    found = phases(plan)
    assert found.count("spin_up") == found.count("hold") == found.count("coast_down") == (4 if everything else 1)
    assert found.count("rest before") == found.count("rest after") == (2 if everything else 1)
    assert all(step.duration > 0 for step in plan.steps)
