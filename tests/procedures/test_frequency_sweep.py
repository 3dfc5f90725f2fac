"""A frequency sweep as data: steps, levels and limits are right before anything moves."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from procedures.frequency_sweep import Settings, expand, frequencies
from rig.bench.benchfile import describe
from rig.bench.steps import AlignBeam, Ask, BenchFacts, Plan, SetFilter, Sine, Static
from rig.yaml.config import shipped

G = 9.80665
BENCH = describe(shipped("benches/simulated.yaml")).facts()


def made(**given: Any) -> Settings:
    return Settings.model_validate(given)


def sines(plan: Plan) -> list[Sine]:
    return [step for step in plan.steps if isinstance(step, Sine)]


def omega(sine: Sine) -> float:
    return 2.0 * math.pi * sine.frequency


def paths(plan: Plan) -> set[tuple[str | int, ...]]:
    return {mistake.path for mistake in plan.mistakes}


def test_a_small_sweep_is_set_up_rest_points_rest(facts: BenchFacts) -> None:
    plan = expand(Settings(points=2, levels=("full",), order="ascending"), facts)
    kinds = [Ask, SetFilter, Ask, Ask, AlignBeam, Static, Sine, Sine, Static]
    assert [type(step) for step in plan.steps] == kinds
    # 500 Hz itself is a mains line, so the highest frequency lies just outside the hertz around it.
    labels = ["cables", "filter", "mount", "plug", "beam", "static before", "20 Hz full", "498 Hz full", "static after"]
    assert [step.label for step in plan.steps] == labels
    assert plan.points == 2
    assert plan.mistakes == ()
    actions = ["cables", "set_filter", "filter_test", "filter_test", "mount_on_shaker", "plug_analyzer", "align_beam"]
    assert [request.action for request in plan.requests] == actions


@pytest.mark.parametrize(("axis", "up"), [("x", "y"), ("y", "z"), ("z", "x")])
def test_the_cube_is_mounted_with_the_axis_along_the_drive_and_the_next_one_up(
    facts: BenchFacts, axis: str, up: str
) -> None:
    plan = expand(Settings.model_validate({"axis": axis, "points": 1}), facts)
    mount, plug = (r for r in plan.requests if r.action in ("mount_on_shaker", "plug_analyzer"))
    assert f"{axis} along the drive and {up} up" in mount.text
    assert mount.settings == {"axis": axis}
    assert plug.settings == {"input": 2, "slot": 2 + "xyz".index(axis)}
    assert {sine.axis for sine in sines(plan)} == {axis}


def test_a_sweep_without_rest_records_has_none(facts: BenchFacts) -> None:
    plan = expand(made(points=1, static="0 s"), facts)
    assert not any(isinstance(step, Static) for step in plan.steps)


def test_the_default_sweep_has_24_frequencies_at_two_levels_from_20_to_500_hz(facts: BenchFacts) -> None:
    found = sines(expand(Settings(), facts))
    assert len(found) == 48
    grid = sorted({sine.frequency for sine in found})
    assert (len(grid), grid[0]) == (24, 20.0)
    assert 497.0 <= grid[-1] <= 500.0
    ratio = 25.0 ** (1 / 23)
    # Whole cycles, mains and neighbours move a frequency by a few hertz, no more.
    assert all(abs(f - 20.0 * ratio**i) <= 3.0 for i, f in enumerate(grid))


def test_full_level_is_80_micrometres_at_20_hz_and_half_a_g_from_40_hz(facts: BenchFacts) -> None:
    full = {sine.frequency: sine for sine in sines(expand(Settings(levels=("full",)), facts))}
    assert full[20.0].acceleration / G == pytest.approx(0.129, abs=0.001)
    for sine in full.values():
        stroke = sine.acceleration / omega(sine) ** 2
        assert stroke <= 80e-6 * (1 + 1e-9)
        if sine.frequency < 39:
            assert stroke == pytest.approx(80e-6)
        if sine.frequency > 40:
            assert sine.acceleration == pytest.approx(0.5 * G)


@pytest.mark.parametrize(("level", "share"), [("half", 0.5), ("quarter", 0.25), ("eighth", 0.125)])
def test_a_lower_level_is_its_share_of_full_at_every_frequency(facts: BenchFacts, level: str, share: float) -> None:
    plan = expand(Settings.model_validate({"points": 6, "levels": ("full", level)}), facts)
    by = {(s.frequency, s.level): s.acceleration for s in sines(plan)}
    for frequency, name in by:
        if name == level:
            assert by[frequency, level] == pytest.approx(share * by[frequency, "full"])


def test_holding_velocity_gives_one_velocity_within_every_limit(facts: BenchFacts) -> None:
    plan = expand(Settings(level="velocity", levels=("full",)), facts)
    assert plan.mistakes == ()
    speeds = [sine.acceleration / omega(sine) for sine in sines(plan)]
    assert speeds == pytest.approx([speeds[0]] * len(speeds))
    assert all(sine.target == pytest.approx(speeds[0]) for sine in sines(plan))
    # The highest frequency decides: 0.5 g there.
    top = max(sines(plan), key=lambda sine: sine.frequency)
    assert top.acceleration == pytest.approx(0.5 * G)


def test_holding_drive_gives_one_stroke_because_the_drive_is_proportional_to_it(facts: BenchFacts) -> None:
    plan = expand(Settings(level="drive", levels=("full",)), facts)
    assert plan.mistakes == ()
    for sine in sines(plan):
        assert sine.acceleration == pytest.approx(sine.target * facts.drive_constant * omega(sine) ** 2)
    assert len({round(sine.target, 12) for sine in sines(plan)}) == 1


def test_random_order_is_the_same_for_the_same_seed_and_holds_the_same_points(facts: BenchFacts) -> None:
    def order(**given: Any) -> list[str]:
        return [sine.label for sine in sines(expand(Settings(points=8, **given), facts))]

    assert order(seed=3) == order(seed=3)
    assert order(seed=3) != order(seed=4)
    assert sorted(order(seed=3)) == sorted(order(order="ascending"))
    full = order(order="ascending", levels=("full",))
    assert full == sorted(full, key=lambda label: float(label.split()[0]))


@given(
    start=st.floats(0.5, 1500.0),
    stop=st.floats(0.5, 1500.0),
    points=st.integers(1, 60),
    record=st.floats(0.05, 5.0),
    hold=st.sampled_from(["acceleration", "velocity", "drive"]),
)
def test_a_sweep_is_within_limits_whole_cycles_and_clear_of_mains_or_its_mistakes_say_why(
    start: float, stop: float, points: int, record: float, hold: str
) -> None:
    given_as = {"start": f"{start} Hz", "stop": f"{stop} Hz", "points": points, "record": f"{record} s", "level": hold}
    settings = made(**given_as)
    plan = expand(settings, BENCH)
    if plan.mistakes:
        assert all(", wanted " in mistake.text and mistake.text.startswith("found ") for mistake in plan.mistakes)
        assert all(mistake.path[0] in Settings.model_fields for mistake in plan.mistakes)
        return
    found = sines(plan)
    assert len(found) == 2 * points
    assert len({sine.frequency for sine in found}) == points
    for sine in found:
        cycles = sine.frequency * sine.scans / BENCH.scan_rate
        assert cycles == pytest.approx(round(cycles), abs=1e-6)
        assert cycles >= 1 - 1e-9
        assert abs(sine.frequency - 50.0 * round(sine.frequency / 50.0)) > 1.0
        assert start - 1e-6 <= sine.frequency <= stop + 1e-6
        assert sine.scans >= record * BENCH.scan_rate - 1e-6
        assert 0 < sine.acceleration <= BENCH.limits.acceleration * (1 + 1e-9)
        assert sine.acceleration / omega(sine) <= BENCH.limits.velocity * (1 + 1e-9)
        assert sine.acceleration / omega(sine) ** 2 <= BENCH.limits.stroke * (1 + 1e-9)
        assert sine.acceleration / omega(sine) ** 2 / BENCH.drive_constant <= BENCH.limits.source * (1 + 1e-9)
    assert plan.duration > 0


def test_the_mains_of_the_bench_decides_what_is_kept_clear_of(facts: BenchFacts) -> None:
    grid = frequencies(Settings(points=60), replace(facts, mains=60.0))
    assert all(abs(f - 60.0 * round(f / 60.0)) > 1.0 for f in grid)
    near = made(start="49.5 Hz", stop="50.5 Hz", points=1)
    assert frequencies(near, replace(facts, mains=60.0)) == [50.0]
    assert paths(expand(near, facts)) == {("points",)}


def test_every_mistake_of_the_settings_is_told_at_once_with_its_key(facts: BenchFacts) -> None:
    wrong = made(
        start="0.5 Hz",
        stop="0.2 Hz",
        levels=("full", "full"),
        record="0 s",
        settle="0.1 s",
        limits={"acceleration": "2 g", "stroke": "1 m"},
        expect={"sensitivity": {"within": ("670 mV/g", "630 mV/g")}},
    )
    assert paths(expand(wrong, replace(facts, has=frozenset()))) == {
        ("start",),
        ("stop",),
        ("levels",),
        ("record",),
        ("settle",),
        ("procedure",),
        ("limits", "acceleration"),
        ("limits", "stroke"),
        ("expect", "sensitivity", "within"),
    }


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ({"acceleration": "0.3 g"}, "found acceleration 0.5 g at"),
        ({"stroke": "50 µm"}, "found stroke 80 µm at 20 Hz full, wanted at most 50 µm"),
    ],
)
def test_a_tighter_limit_of_the_file_refuses_the_level_and_names_the_point(
    facts: BenchFacts, limits: dict[str, str], said: str
) -> None:
    mistakes = expand(made(limits=limits), facts).mistakes
    assert [mistake.path for mistake in mistakes] == [("levels",)]
    assert said in mistakes[0].text


def test_a_bench_that_may_move_less_refuses_the_same_sweep(facts: BenchFacts) -> None:
    weak = replace(facts, limits=replace(facts.limits, velocity=1e-3, source=0.5))
    texts = [mistake.text for mistake in expand(made(), weak).mistakes]
    assert [text.split()[1] for text in texts] == ["velocity", "source"]
    assert all("wanted at most" in text for text in texts)


def test_more_frequencies_than_fit_are_a_mistake_that_says_how_many_do(facts: BenchFacts) -> None:
    (mistake,) = expand(made(start="20 Hz", stop="30 Hz", points=50), facts).mistakes
    assert mistake.path == ("points",)
    assert mistake.text.startswith("found 50, wanted at most 11")


def test_a_frequency_beyond_the_converter_is_a_mistake(facts: BenchFacts) -> None:
    (mistake,) = expand(made(stop="1300 Hz"), facts).mistakes
    assert (mistake.path, "at most 1221 Hz" in mistake.text) == (("stop",), True)


def test_expected_sensitivities_stand_in_the_plan_in_si(facts: BenchFacts) -> None:
    plan = expand(made(expect={"sensitivity": {"within": ("630 mV/g", "670 mV/g")}}), facts)
    assert plan.expect["unit_a_x.sensitivity"] == pytest.approx((0.63 / G, 0.67 / G))
