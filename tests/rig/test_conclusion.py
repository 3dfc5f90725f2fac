"""What a diagnosis says: a verdict with reasons, probabilities that claim no more than is known, and blind spots."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import fast_bench
import pytest

from rig.diagnose.conclusion import OUTPUT_FILTER, Conclusion, conclude
from rig.diagnose.diagnose import diagnose
from rig.diagnose.unseen import cannot_see
from rig.fit.evidence import evidence_of
from rig.fit.parameters import Estimate, plausible
from rig.model import Term
from rig.repair import repair
from rig.repair.repair import Bench
from rig.shelf import shelf

CUBIC = {"name": "cubic", "parameters": {"quantity": "acceleration", "coefficient": 3e-4}}
TWO = (
    {"name": "asymmetry", "parameters": {"quantity": "acceleration"}},
    {"name": "quadratic", "parameters": {"quantity": "acceleration", "coefficient": 1e-3}},
)
LEVELLED = ("cubic", "odd_quadratic", "saturation", "asymmetry", "quadratic", "dead_zone", "hysteresis")


@lru_cache(maxsize=2)
def sweep(hidden: bool) -> Bench:
    world = fast_bench.world(5, [CUBIC] if hidden else [])
    return repair.bench_of(
        [fast_bench.measure({"procedure": "frequency_sweep", "axis": "x", "points": 8}, world)], shelf()
    )


@lru_cache(maxsize=1)
def two() -> tuple[Bench, Conclusion]:
    """A sweep with two effects that look alike, and what a diagnosis says of it."""
    records = fast_bench.measure(
        {"procedure": "frequency_sweep", "axis": "x", "points": 8}, fast_bench.world(5, list(TWO))
    )
    bench = repair.bench_of([records], shelf())
    return bench, conclude(bench.evidence, [], shelf())


@lru_cache(maxsize=1)
def unlisted() -> Conclusion:
    """The same sweep with nothing on the shelf that knows of levels."""
    kept = {name: effect for name, effect in shelf().items() if name not in LEVELLED}
    return conclude(sweep(True).evidence, [], kept)


def test_a_clean_unit_needs_nothing_and_still_the_limits_are_told() -> None:
    said = conclude(sweep(False).evidence, [], shelf())
    assert said.verdict == "adequate"
    assert said.candidates == ()
    assert said.description == ""
    assert said.cannot_see


def test_naming_the_missing_effect_brings_the_worst_error_down_to_the_noise() -> None:
    said = conclude(sweep(True).evidence, [], shelf())
    assert said.taken[0].effect == "cubic"
    assert said.worst.ratio > 3.0
    assert said.worst_after.ratio < 1.5


def test_of_two_effects_the_first_has_the_size_that_it_has_beside_the_second() -> None:
    _, said = two()
    assert [one.effect for one in said.taken] == ["quadratic", "asymmetry"]
    found = said.taken[0].parameters["coefficient"]
    assert found.u is not None
    assert abs(found.value - 1e-3) < 3.0 * found.u  # alone it would be a third larger, and said to be known to 1 %
    final = {term.effect.name: term.at for term in said.diagnosis.final.state.terms if not term.prior}
    for one in said.taken:
        assert {name: value.value for name, value in one.parameters.items()} == pytest.approx(final[one.effect])
    written = said.candidates[0].as_json()["parameters"]["coefficient"]
    assert written == {"value": found.value, "unit": "1/(m/s²)", "u": found.u}


def test_a_model_with_both_effects_keeps_what_the_diagnosis_said_of_each() -> None:
    bench, said = two()
    model = repair.new(bench, "datasheet")
    for one in said.taken:
        model = repair.added(bench, model, one.effect, one.on).model
    kept = {entry.effect: entry.parameters for entry in model.effects}
    for one in said.taken:
        for name, value in one.parameters.items():
            assert value.u is not None
            assert kept[one.effect][name].value == pytest.approx(value.value, abs=0.05 * value.u)
            assert kept[one.effect][name].u == pytest.approx(value.u, rel=0.05)


def test_the_corners_of_the_output_filter_are_those_beside_what_else_is_missing() -> None:
    bench = sweep(True)
    said = conclude(bench.evidence, [], shelf(), poles=False)
    assert [one.effect for one in said.taken] == [OUTPUT_FILTER, "cubic"]
    corner = said.taken[0].parameters["corner unit_a_x"].value
    final = said.diagnosis.final
    number = final.parts[0].channels.names.index("unit_a_x")
    assert corner == pytest.approx(float(final.state.local(final.parts[0], 0).pole[number]))


def test_what_no_shelf_has_is_unlisted_and_its_nearest_is_never_called_likely() -> None:
    said = unlisted()
    assert said.verdict == "unlisted"
    assert said.description.startswith("near") or said.description.startswith("nothing")
    assert "times the noise" in said.description
    assert all(one.probability <= 0.5 for one in said.candidates)


def test_the_paper_s_model_is_told_that_it_lacks_the_output_filter_and_adding_it_mends_it() -> None:
    bench = sweep(False)
    said = conclude(bench.evidence, [], shelf(), poles=False)
    assert said.verdict == "missing"
    assert [one.effect for one in said.taken] == [OUTPUT_FILTER]
    assert said.taken[0].parameters["corner unit_a_x"].value == pytest.approx(400.0, rel=0.15)
    done = repair.added(bench, repair.new(bench, "paper"), OUTPUT_FILTER)
    assert done.before.error > 20.0
    assert done.after.error == pytest.approx(1.0, abs=0.1)
    back = repair.removed(bench, done.model, OUTPUT_FILTER)
    assert back.after.error == pytest.approx(done.before.error, rel=1e-3)


def test_one_sense_of_rotation_and_the_want_of_a_sweep_are_told() -> None:
    turning = {"procedure": "turntable", "revolutions": 6}
    bench = repair.bench_of([fast_bench.measure(turning, fast_bench.world(6))], shelf())
    said = "\n".join(cannot_see(bench.evidence, (), bench.shelf, ("gyro_yaw: a unit is wrong",)))
    assert "one sense of rotation only" in said
    assert "no sweep" in said
    assert "no static record on the turntable" not in said
    assert "gyro_yaw: a unit is wrong" in said


def test_an_effect_of_the_fitted_sensitivity_is_never_seen() -> None:
    said = cannot_see(sweep(False).evidence, (), shelf())
    assert any(line.startswith("buffer_gain: ") for line in said)


@pytest.mark.parametrize(("value", "wanted"), [(1e-5, True), (-9e-5, True), (1e-4, False), (5e-7, False)])
def test_a_size_is_plausible_within_three_times_what_is_usual(value: float, wanted: bool) -> None:
    assert plausible(Term(shelf()["cubic"], "acceleration", {"coefficient": value})) == wanted


@pytest.mark.parametrize(
    ("value", "unit", "u", "text"),
    [
        (5.1e-5, "s", 1.5e-6, "51.0 ± 3.0 µs"),
        (1e-4, "1/(m/s²)²", 2.5e-6, "0.962 ± 0.048 %/g²"),
        (0.0, "V", 1e-3, "0.0 ± 2.0 mV"),
        (4e-4, "1", 1e-4, "400 ± 200 ppm"),
        (2e-3, "(rad/s)/(m/s²)", 1e-4, "1.12 ± 0.11 (°/s)/g"),
        (0.02, "m", None, "20 mm"),
        (3.0, "furlong", None, "3 furlong"),
    ],
)
def test_a_parameter_is_shown_in_a_laboratory_s_unit_with_expanded_uncertainty(
    value: float, unit: str, u: float | None, text: str
) -> None:
    assert Estimate(value, unit, u).text == text


def test_every_unit_of_the_shelf_has_a_laboratory_s_unit() -> None:
    from rig.fit.parameters import KINDS, LABORATORY

    units: set[Any] = set()
    for effect in shelf().values():
        for on in effect.quantities or (None,):
            units |= set(effect.units(on))
    assert units - {"(m/s)/V", "1/m"} <= set(KINDS) | set(LABORATORY)


def test_a_clipping_limit_is_no_better_known_than_the_gain_of_the_vibrometer() -> None:
    hidden = [{"name": "saturation", "parameters": {"limit": 4.8, "quantity": "acceleration"}}]
    document = {"procedure": "frequency_sweep", "axis": "x"}
    found = diagnose(evidence_of([fast_bench.measure(document, fast_bench.world(7, hidden))]))
    (step,) = found.steps
    assert step.taken.name == "saturation"
    at, u = step.taken.term.at["limit"], step.taken.u["limit"]
    assert 0.003 < u / at < 0.006  # the certificate says 1 % with k = 2
    assert abs(found.final.state.terms[-1].at["limit"] - 4.8) < 2.0 * u
