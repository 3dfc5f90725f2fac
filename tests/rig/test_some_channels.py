"""An effect that some channels alone have: stated, fitted, kept in the model's file, printed, taken out and undone."""

from __future__ import annotations

import cmath
import math
from pathlib import Path

import blind_worlds
import fast_bench
import numpy as np
import pytest
from imported_worlds import Unit, changed, evidence, motion

from fixtures.channels import Channel
from fixtures.imperfections import Array, Imperfection, Spectrum
from rig.cli.repair import candidate_text, history_text, repaired_text
from rig.diagnose import search
from rig.diagnose.conclusion import conclude
from rig.diagnose.diagnose import CHANCE, PER_COORDINATE, chance, diagnose
from rig.errors import BadInput, ConfigError
from rig.fit.evidence import evidence_of
from rig.model import Term
from rig.repair import repair
from rig.repair.correction import correction_of
from rig.repair.model_file import load, save, terms_of
from rig.repair.repair import Bench, Repaired, channels_named
from rig.shelf import effect_of, nothing_of, shelf

LATE = 1.3e-6  # s
BENT = 0.1  # (rad/s)⁻²
GYROS = ("gyro_x", "gyro_y", "gyro_z")


@pytest.fixture(scope="module")
def bench() -> Bench:
    """Free motion of a unit of which one gyro bends."""
    made = motion(Unit(), 6, seconds=40.0, rows=100.0)
    return Bench(evidence(changed(made, "gyro_y", lambda v: v + BENT * v**3)), shelf(), 0.0)


@pytest.fixture(scope="module")
def repaired(bench: Bench) -> Repaired:
    return repair.added(bench, repair.new(bench, "datasheet"), "cubic", "rate", channels=("gyro_y",))


def test_an_effect_of_one_channel_has_its_true_size_and_leaves_less_than_on_all(
    bench: Bench, repaired: Repaired
) -> None:
    (entry,) = repaired.model.effects
    found = entry.parameters["coefficient"]
    assert found.u is not None
    assert abs(found.value - BENT) < 4.0 * found.u
    everywhere = repair.added(bench, repair.new(bench, "datasheet"), "cubic", "rate")
    assert repaired.fit.objective < everywhere.fit.objective - 100.0


def test_the_other_channels_are_as_they_were(bench: Bench) -> None:
    (part,) = bench.evidence.parts
    state = bench.evidence.fitted().state
    term = Term(effect_of("cubic"), "rate", {"coefficient": 0.1}, only=("gyro_y",))
    moved = part.raw(state.local(part, 0), [term]) - part.raw(state.local(part, 0), [])
    changed = [name for name, row in zip(part.channels.names, moved, strict=True) if np.any(row != 0.0)]
    assert changed == ["gyro_y"]


def test_its_file_says_which_channels_and_gives_the_same_terms(repaired: Repaired, tmp_path: Path) -> None:
    path = tmp_path / "model.yaml"
    save(path, repaired.model)
    again = load(path, shelf())
    assert again == repaired.model
    (term,) = terms_of(again, shelf())
    assert (term.only, term.key) == (("gyro_y",), "cubic (gyro_y)")
    assert "  channels: [gyro_y]\n" in path.read_text(encoding="utf-8")


def test_what_is_printed_says_which_channels(repaired: Repaired) -> None:
    assert any(line.startswith("  cubic (gyro_y): coefficient = ") for line in repaired_text(repaired))
    assert "add cubic (gyro_y)" in history_text(repaired.model.history)[-1]


def test_beside_it_stands_another_one_and_each_can_be_taken_out(bench: Bench, repaired: Repaired) -> None:
    both = repair.added(bench, repaired.model, "cubic", "rate")
    assert [one.where for one in both.model.effects] == ["gyro_y", "rate"]
    left = repair.removed(bench, both.model, "cubic", "rate", ("gyro_y",))
    assert [one.where for one in left.model.effects] == ["rate"]
    with pytest.raises(BadInput, match="in the model already"):
        repair.added(bench, repaired.model, "cubic", "rate", channels=("gyro_y",))


def test_the_search_finds_which_channel_has_it_and_says_the_command_that_adds_it(bench: Bench) -> None:
    said = conclude(bench.evidence, (), bench.shelf)
    first = said.taken[0]
    assert (said.verdict, first.effect, first.channels) == ("missing", "cubic", ("gyro_y",))
    assert first.parameters["coefficient"].value == pytest.approx(BENT, rel=0.2)
    assert "cubic (cubic nonlinearity of gyro_y only)" in candidate_text(first, nearest=False)[0]
    assert said.diagnosis.steps[0].taken.term.key == "cubic (gyro_y)"


def test_what_all_channels_have_is_not_looked_for_in_one() -> None:
    made = motion(Unit(), 6, seconds=40.0, rows=100.0)
    for name in GYROS:
        made = changed(made, name, lambda v: v + BENT * v**3)
    found = evidence(made).fitted()
    assert [some for on, some, _ in search.narrower(found) if on == "rate"] == []


def test_the_best_of_so_many_channels_pays_for_them(bench: Bench) -> None:
    found = bench.evidence.fitted()
    everywhere, one = (
        search.scores(found, search.possible({"cubic": effect_of("cubic")}, found, only=only))[0]
        for only in ((), ("gyro_y",))
    )
    # by chance the best of m gains 2·ln m more than one; three gyros, and no unit among them
    assert chance(one) - chance(everywhere) == pytest.approx(2.0 * math.log(3))


def test_a_correction_undoes_it_in_that_channel_alone(repaired: Repaired) -> None:
    made = correction_of(repaired.model, shelf())
    bent = [name for name in made.names if made.chain(name).bends]
    assert bent == ["gyro_y"]
    true = np.linspace(-1.5, 1.5, 7)
    channel = made.chain("gyro_y").channel
    shown = channel.zero + channel.sensitivity * (true + BENT * true**3)
    assert made.only(["gyro_y"]).apply({"gyro_y": shown})["gyro_y"] == pytest.approx(true, abs=5e-3)


def test_channels_are_named_by_their_names_and_all_of_a_kind_are_no_restriction(bench: Bench) -> None:
    assert channels_named(bench, ["gyro_y"]) == ("rate", ("gyro_y",))
    assert channels_named(bench, GYROS) == ("rate", ())
    with pytest.raises(BadInput, match="wanted channels of one kind"):
        channels_named(bench, ["gyro_y", "acc_x"])


def test_what_belongs_to_everything_is_on_no_channel_by_itself(bench: Bench, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="wanted no channels: it belongs to all alike"):
        repair.added(bench, repair.new(bench, "datasheet"), "reference_delay", channels=("gyro_y",))
    path = tmp_path / "model.yaml"
    path.write_text("format: 1\nunit: made\neffects: [{effect: reference_delay, channels: [gyro_y]}]\n")
    with pytest.raises(ConfigError, match="it acts on everything alike"):
        load(path, shelf())
    assert nothing_of(effect_of("cubic"), "rate").only == ()


class Late(Imperfection):
    """One channel is late: an amplifier's filter."""

    name = "late"

    def response(self, channel: Channel, frequency: Array) -> Spectrum | float:
        return np.exp(-2j * cmath.pi * LATE * frequency) if channel.name == "unit_a_x" else 1.0


def test_a_delay_of_one_channel_is_in_the_class_of_the_skew_of_all_that_looks_alike() -> None:
    """The decoder's own delay takes up half of it; only a third unit, which is noisy, tells one from the other."""
    world = blind_worlds.with_more(fast_bench.world(12), [Late()])
    swept = fast_bench.measure({"procedure": "frequency_sweep", "axis": "x", "points": 8}, world)
    found = diagnose(evidence_of([swept]))
    (step,) = found.steps
    late = [one for one in step.members if (one.name, one.term.only) == ("delay", ("unit_a_x",))]
    assert late
    assert abs(late[0].term.at["time"] - LATE) < 4.0 * late[0].u["time"]
    assert max(one.probability for one in step.members) < 0.9


def test_what_only_shapes_an_effect_costs_as_much_as_what_has_a_size() -> None:
    rocking = nothing_of(effect_of("rocking"), None)
    assert chance(search.Score(rocking, rocking, 0.0, 1.0, 1)) == CHANCE + 2.0 * PER_COORDINATE
    seen = chance(search.Score(rocking, rocking, 0.0, 1.0, 1, size=3))
    assert seen == CHANCE + 2.0 * PER_COORDINATE
