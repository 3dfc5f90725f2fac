"""A model's file reads back as it was written, and names every mistake by its place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import fast_bench
import numpy as np
import pytest

from rig.archive.records import Recorded
from rig.diagnose.conclusion import conclude
from rig.diagnose.misfit import compare
from rig.errors import BadInput, ConfigError
from rig.fit.parameters import estimates
from rig.fit.quality import Place
from rig.formula import own_term
from rig.model import Term
from rig.repair import repair
from rig.repair.model_file import Model, as_text, load, path_of, save, terms_of
from rig.repair.repair import Bench, Repaired
from rig.shelf import shelf

HIDDEN = {"name": "cubic", "parameters": {"quantity": "acceleration", "coefficient": 3e-4}}
SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 8}
HEAD = "format: 1\nunit: SIM-CUBE-1\n"


@lru_cache(maxsize=1)
def records() -> Recorded:
    """A short sweep of a unit with a strong cubic nonlinearity."""
    return fast_bench.measure(SWEEP, fast_bench.world(5, [HIDDEN]))


@lru_cache(maxsize=1)
def bench() -> Bench:
    return repair.bench_of([records()], shelf())


@lru_cache(maxsize=1)
def repaired() -> Repaired:
    return repair.added(bench(), repair.new(bench(), "datasheet"), "cubic")


def written(folder: Path, text: str) -> Path:
    path = folder / "model.yaml"
    path.write_text(HEAD + text, encoding="utf-8")
    return path


def test_a_model_reads_back_as_it_was_written_and_predicts_the_same(tmp_path: Path) -> None:
    path = tmp_path / "models" / "unit.yaml"
    save(path, repaired().model)
    again = load(path, shelf())
    assert again == repaired().model
    (term,) = terms_of(again, shelf())
    (fitted,) = [one for one in repaired().fit.state.terms if not one.prior]
    assert (term.effect.name, term.on) == ("cubic", "acceleration")
    assert term.at["coefficient"] == pytest.approx(fitted.at["coefficient"], rel=1e-9)
    assert [one.name for one in path.parent.iterdir()] == ["unit.yaml"]  # no half-written file stays


def test_adding_the_missing_effect_brings_the_error_down_to_the_noise_on_held_out_data_too() -> None:
    start, add = repaired().model.history
    assert (start.action, add.action, add.effect) == ("start", "add", "cubic")
    assert start.error > 1.25
    assert start.heldout is not None
    assert add.heldout is not None
    assert start.heldout > 1.3
    assert add.error == pytest.approx(1.0, abs=0.1)
    assert add.heldout == pytest.approx(1.0, abs=0.15)
    assert add.noise == 1.0


def test_compare_diagnose_and_history_say_one_error_to_the_printed_digit() -> None:
    start, add = repaired().model.history
    before = compare(bench().evidence)
    after = compare(bench().evidence, terms_of(repaired().model, shelf()))
    said = conclude(bench().evidence, [], shelf())
    for step, found in ((start, before.errors), (add, after.errors)):
        assert f"{step.error:.4g}, {step.heldout:.4g}" == f"{found.error:.4g}, {found.heldout:.4g}"
        assert (step.worst_at, f"{step.worst:.3g}") == (found.worst.where, f"{found.worst.ratio:.3g}")
        there = math.nan if step.worst_heldout is None else step.worst_heldout  # nothing of a spectrum is held out
        assert f"{there:.3g}" == f"{found.worst.heldout:.3g}"
        assert step.place.size == found.worst.size
        assert (step.worst_error, step.worst_unit) == (pytest.approx(found.worst.error), found.worst.unit)
    assert said.taken[0].effect == "cubic"
    assert f"{said.error:.4g}, {said.after:.4g}" == f"{start.error:.4g}, {add.error:.4g}"
    assert f"{said.taken[0].error_after:.4g}" == f"{add.error:.4g}"
    assert f"{said.heldout_error:.4g}, {said.heldout_after:.4g}" == f"{start.heldout:.4g}, {add.heldout:.4g}"
    assert said.worst.size == before.errors.worst.size
    assert repaired().at(start.worst_at).ratio == pytest.approx(said.worst_after.ratio, rel=1e-3)
    assert said.worst_after.heldout < 1.5 < said.worst.heldout


def test_what_has_no_unit_is_said_in_per_cent() -> None:
    assert Place("", 2.0, 1.0, 0.00249, "1").size == "0.249 %"
    assert Place("", 2.0, 1.0, 0.00249, "m/s²").size == "0.00249 m/s²"
    assert Place("", 2.0).size == ""


def test_the_error_where_it_is_worst_is_its_ratio_times_the_noise_of_those_rows() -> None:
    start, _ = repaired().model.history
    name, _, domain = start.worst_at.partition(", ")
    part = next(one for one in bench().evidence.parts if domain in one.domains())
    row, mask = part.row_names.index(name), part.domains()[domain]
    noise = np.sqrt(np.mean(part.noise()[row][mask & part.counted.reshape(len(part.row_names), -1)[row]]))
    assert start.worst is not None
    assert start.worst_error == pytest.approx(start.worst * noise, rel=1e-6)
    assert start.worst_unit == "m/s²"


def test_the_true_parameter_is_within_its_expanded_uncertainty() -> None:
    found = repaired().model.effects[0].parameters["coefficient"]
    assert found.unit == "1/(m/s²)²"
    assert found.u is not None
    assert abs(found.value - HIDDEN["parameters"]["coefficient"]) < 3.0 * found.u  # type: ignore[index]


def test_the_time_of_a_step_is_the_bench_s_and_not_the_machine_s() -> None:
    newest = max(entry.t for entry in records().lines)
    assert repaired().after.when == pytest.approx(newest, abs=1e-3)


def test_two_versions_differ_only_where_the_model_does() -> None:
    again = repair.added(bench(), repair.new(bench(), "datasheet"), "cubic").model
    assert as_text(again) == as_text(repaired().model)
    other = again.model_copy(update={"simulated": False})
    lines = [set(as_text(one).splitlines()) for one in (again, other)]
    assert lines[0] ^ lines[1] == {"simulated: true", "simulated: false"}


def test_removing_what_was_added_brings_the_error_back() -> None:
    less = repair.removed(bench(), repaired().model, "cubic")
    assert less.model.effects == ()
    assert [step.action for step in less.model.history] == ["start", "add", "remove"]
    assert less.after.error == pytest.approx(less.model.history[0].error, rel=1e-4)


def test_the_paper_s_model_has_no_output_filter_and_fails() -> None:
    paper = repair.fitted(bench(), repair.new(bench(), "paper"))
    assert all(channel.pole is None for channel in paper.model.channels.values())
    assert paper.after.error > 3.0 * repaired().model.history[0].error


def test_covariance_is_that_of_the_fit_with_a_name_for_every_row() -> None:
    covariance = repaired().model.covariance
    assert covariance.order == ("cubic (acceleration).coefficient",)
    u = repaired().model.effects[0].coordinates["coefficient"].u
    assert u is not None
    assert covariance.values[0][0] == pytest.approx(u**2, rel=1e-4)


def test_a_model_written_by_hand_may_give_parameters_alone(tmp_path: Path) -> None:
    text = "effects:\n- effect: cubic\n  on: acceleration\n  parameters: {coefficient: {value: 2e-5}}\n"
    (term,) = terms_of(load(written(tmp_path, text), shelf()), shelf())
    assert term.at == {"coefficient": 2e-5}


@pytest.mark.parametrize("name", ["cubic", "output_filter"])
def test_a_formula_may_not_take_the_name_of_an_effect(name: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=rf"found the name '{name}' for a formula.*wanted a name of its own"):
        repair.added(bench(), repair.new(bench(), "datasheet"), name, "acceleration", "k * u**3")
    text = f"effects:\n- {{effect: {name}, formula: k * u**3, on: acceleration}}\n"
    with pytest.raises(ConfigError, match=rf":4:.*found the name '{name}' for a formula"):
        load(written(tmp_path, text), shelf())


def test_a_term_with_starts_and_channels_is_fitted_and_reads_back(tmp_path: Path) -> None:
    own = own_term("k*sin(u/w)", ["w=2 g", "w=1 g"], ["unit_a_x", "unit_b_x", "unit_c_x"])
    made = repair.added(bench(), repair.new(bench(), "datasheet"), "wave", "acceleration", own)
    assert made.before.error > 1.25
    assert made.after.error == pytest.approx(1.0, abs=0.1)  # the hidden cubic is the wave's third power
    save(tmp_path / "model.yaml", made.model)
    again = load(tmp_path / "model.yaml", shelf())
    (entry,) = again.effects
    assert entry.channels == own.channels
    assert (entry.units, entry.values) == ({"w": "m/s²"}, {"w": pytest.approx(2.0 * 9.80665)})
    assert repair.fitted(bench(), again).after.error == pytest.approx(made.after.error, rel=1e-3)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ((), (None, ())),
        (("rate",), ("rate", ())),
        (("gyro_yaw",), ("rate", ("gyro_yaw",))),
        (("unit_b_x", "unit_a_x"), ("acceleration", ("unit_b_x", "unit_a_x"))),
    ],
)
def test_channels_are_meant_by_quantity_or_by_name(words: tuple[str, ...], found: object) -> None:
    assert repair.channels_named(bench(), words) == found


@pytest.mark.parametrize(
    "words", [("unit_q_x",), ("gyro_yaw", "unit_a_x"), ("acceleration", "rate"), ("rate", "gyro_yaw")]
)
def test_channels_that_are_not_there_or_of_two_kinds_are_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(BadInput, match=r"--on: found .*, wanted"):
        repair.channels_named(bench(), words)


def test_a_term_by_formula_is_loaded_and_fitted(tmp_path: Path) -> None:
    text = "effects:\n- {effect: own, formula: k * u**3, on: acceleration, values: {k: 1e-5}}\n"
    model = load(written(tmp_path, text), shelf())
    (term,) = terms_of(model, shelf())
    assert (term.effect.name, term.on, term.at) == ("own", "acceleration", {"k": 1e-5})
    done = repair.fitted(bench(), model)
    save(tmp_path / "after.yaml", done.model)
    (again,) = load(tmp_path / "after.yaml", shelf()).effects
    assert again.formula == "k * u**3"
    cubic = repaired().model.effects[0].coordinates["coefficient"]
    cubic = repaired().model.effects[0].coordinates["coefficient"]
    assert again.coordinates["k"].value == pytest.approx(cubic.value, rel=1e-4)


@pytest.mark.parametrize(
    ("text", "place", "found", "wanted"),
    [
        ("effects:\n- {effect: cubik, on: rate}\n", ":4:12 effects[0].effect:", "'cubik'", "cubic"),
        ("effects:\n- {effect: cubic}\n", ":4:3 effects[0].on:", "nothing", "acceleration or rate"),
        ("effects:\n- {effect: rocking, on: rate}\n", "effects[0].on:", "'rate'", ""),
        ("start: blank\n", ":3:8 start:", "'blank'", "'datasheet', 'paper' or 'shared'"),
        ("begin: paper\n", ":3:1 begin:", "unknown key", "start"),
        (
            "effects:\n- effect: cubic\n  on: rate\n  coordinates: {coefficent: {value: 1}}\n",
            ":6:29 effects[0].coordinates.coefficent:", "unknown name", "coefficient",
        ),
        (
            "effects:\n- effect: delay\n  on: rate\n  coordinates: {time: {value: 1e-5}}\n"
            "  parameters: {time: {value: 2e-5}}\n",
            ":7:30 effects[0].parameters.time.value:", "2e-05", "1e-05",
        ),
        ("effects:\n- {effect: own, formula: k * u}\n", "effects[0].on:", "nothing", "acceleration or rate"),
        ("effects:\n- {effect: own, formula: k * (, on: rate}\n", ":4:26 effects[0].formula:", "found", "numbers"),
        ("covariance: {order: [a, b], values: [[1]]}\n", "covariance.values:", "another shape", "2 rows of 2"),
        ("channels: {unit_a_x: {sensitivity: {value: much}}}\n", ":3:44 channels.unit_a_x.sensitivity.value:",
         "'much'", "a number"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_by_line_column_key_found_and_wanted(
    tmp_path: Path, text: str, place: str, found: str, wanted: str
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load(path, shelf())
    said = str(caught.value)
    assert said.startswith(f"{path}:")
    assert place in said
    assert found in said.partition("found")[2] or found in said
    assert wanted in said.partition("wanted")[2]


def test_a_model_that_is_not_there_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="found no model, wanted"):
        load(tmp_path / "none.yaml")


def test_another_unit_s_model_is_refused(tmp_path: Path) -> None:
    save(tmp_path / "other.yaml", Model(unit="another"))
    with pytest.raises(BadInput, match="found a model of another, wanted one of SIM-CUBE-1"):
        repair.model_at(tmp_path / "other.yaml", bench(), None)


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("cubic", "another effect"),
        ("sensitivity", "an effect that a fit can see"),
        ("missed_counts", "wanted one"),
        ("lever_arm", "can act here"),
        ("cubik", "cubic"),
    ],
)
def test_an_effect_that_cannot_be_added_is_refused_with_the_reason(name: str, wanted: str) -> None:
    with pytest.raises(BadInput) as caught:
        repair.added(bench(), repaired().model, name, "acceleration" if name == "cubic" else None)
    assert wanted in str(caught.value)


def test_a_serial_number_cannot_lead_out_of_the_folder() -> None:
    assert path_of(Path("runs"), "../../x y").parent == Path("runs/models")


@pytest.mark.parametrize("angle", [0.3, math.pi - 1e-9, -2.0])
def test_uncertainties_of_size_and_phase_follow_from_those_of_the_components(angle: float) -> None:
    effect = shelf()["mains_hum"]
    at: Mapping[str, float] = effect.from_physical(
        {"amplitude": 2e-3, "third": 1e-3, "phase": angle, "phase_third": 0.0, "offset": 0.01}
    )
    count = sum(not c.searched for c in effect.coordinates)
    found = estimates(Term(effect, "acceleration", at), np.eye(count) * 1e-10)
    assert found["amplitude"].u == pytest.approx(1e-5, rel=1e-4)
    assert found["phase"].u == pytest.approx(1e-5 / 2e-3, rel=1e-4)
