"""Noise is part of the model: records at rest against data sheets, and what is louder than they allow."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import fast_bench
import numpy as np
import pytest

from rig.diagnose.conclusion import Conclusion, conclude
from rig.diagnose.diagnose import _changing, diagnose
from rig.diagnose.misfit import compare
from rig.fit import adequacy
from rig.fit.adequacy import unsteady
from rig.fit.evidence import Evidence, evidence_of
from rig.model import Local, Term
from rig.parts.noise_spectrum import SEEN, NoiseSpectrum
from rig.parts.reading.noise_spectrum import read as rested_parts
from rig.repair.model_file import Model
from rig.repair.repair import Bench, added, fitted
from rig.shelf import effect_of, shelf
from rig.signals.rest_lines import coarse_step, folded, strongest
from rig.signals.rest_spectrum import Bands, bands, of_line
from rig.signals.sheet_noise import Levels, Scatter, Sheet, mean_density

RATE, MAINS = 1000.0, 50.0
HIDDEN: dict[str, tuple[str, dict[str, Any]]] = {
    "clean": ("shaker", {}),
    "white": ("shaker", {"density": 2e-4, "quantity": "acceleration"}),
    "flicker": ("shaker", {"level": 1e-2, "quantity": "acceleration"}),
    "random_walk": ("turntable", {"coefficient": 1e-2, "quantity": "rate"}),
    "spur": ("shaker", {"amplitude": 3e-3, "frequency": 6.85, "quantity": "acceleration"}),
    "aliasing": ("shaker", {"amplitude": 2e-4, "frequency": 23456.0, "quantity": "acceleration"}),
    "quantisation": ("shaker", {"step": 1.3e-3}),
}


def rested(name: str) -> Evidence:
    """As long at rest as before and after a sweep in a world that hides this."""
    cables, parameters = HIDDEN[name]
    hidden = [{"name": name, "parameters": parameters}] if parameters else []
    run = fast_bench.measure({"procedure": "noise", "length": "35 s", "cables": cables}, fast_bench.world(5, hidden))
    return evidence_of([run])


@pytest.fixture(scope="module")
def evidences() -> dict[str, Evidence]:
    return {name: rested(name) for name in HIDDEN}


@pytest.fixture(scope="module")
def conclusions(evidences: dict[str, Evidence]) -> dict[str, Conclusion]:
    return {name: conclude(one, [], shelf()) for name, one in evidences.items()}


def test_too_short_a_rest_is_no_part() -> None:
    run = fast_bench.measure({"procedure": "noise", "length": "3 s"}, fast_bench.world(5))
    assert not rested_parts([run]).parts


def part_of(evidence: Evidence) -> NoiseSpectrum:
    return next(part for part in evidence.parts if isinstance(part, NoiseSpectrum))


def test_a_clean_record_is_adequate_and_nothing_is_named(conclusions: dict[str, Conclusion]) -> None:
    said = conclusions["clean"]
    assert said.verdict == "adequate"
    assert not said.candidates
    seen = {one.partition(":")[0] for one in said.cannot_see if "would not be seen in 35 s at rest" in one}
    assert {"white (acceleration)", "flicker (acceleration)", "random_walk (rate)"} <= seen


@pytest.mark.parametrize("name", [name for name in HIDDEN if name != "clean"])
def test_noise_that_is_hidden_is_named_as_strong_as_it_is(name: str, conclusions: dict[str, Conclusion]) -> None:
    said = conclusions[name]
    assert [one.effect for one in said.taken] == [name]
    assert said.verdict == "missing"
    parameter, true = next(iter(HIDDEN[name][1].items()))
    found = said.taken[0].parameters[parameter]
    assert found.u is not None
    assert abs(found.value - true) < 3.5 * found.u
    assert found.u < 0.12 * true


def test_what_stands_out_falls_to_the_noise(conclusions: dict[str, Conclusion]) -> None:
    """Of each kind, where it is worst; the line of the spur is in one band of a few dozen."""
    for name, said in conclusions.items():
        assert adequacy.adequate(said.diagnosis.final), name
        if name != "random_walk":  # in half a minute its rows together are seen, and no group of them
            assert adequacy.adequate(said.diagnosis.base) == (name == "clean"), name


def test_a_line_is_told_with_its_frequency_and_a_folded_one_with_what_it_was(
    conclusions: dict[str, Conclusion],
) -> None:
    for name in ("spur", "aliasing"):
        found = conclusions[name].taken[0].parameters["frequency"]
        assert found.u is not None
        assert abs(found.value - HIDDEN[name][1]["frequency"]) < 3.5 * found.u
        assert found.u < 0.01


def test_adding_it_brings_the_error_of_its_group_to_the_noise(evidences: dict[str, Evidence]) -> None:
    bench = Bench(evidences["white"], shelf(), 0.0)
    start = fitted(bench, Model(unit=bench.evidence.serial))
    after = added(bench, start.model, "white", "acceleration")
    assert start.after.worst is not None
    assert after.after.worst is not None
    assert start.after.worst > 2.0
    assert not adequacy.adequate(start.fit)
    assert adequacy.adequate(after.fit)
    assert after.after.error < 1.05 < start.after.error
    assert after.after.heldout is not None
    assert after.after.heldout < 1.1


def test_a_comparison_says_in_words_how_loud_it_is(evidences: dict[str, Evidence]) -> None:
    words = compare(evidences["white"]).worst[0].in_words
    assert words.startswith("noise above 50 Hz, ")
    assert "times the data sheet's, white" in words
    groups = {one.name: one for one in compare(evidences["clean"]).groups}
    assert groups["shaker, noise of gyros"].noise_from == ("averages",)
    # four rows that are mostly small, and the allowance for the shape of a density
    assert groups["shaker, noise of gyros"].ratio == pytest.approx(0.9, abs=0.2)


@pytest.mark.parametrize("name", ["white", "flicker", "random_walk"])
def test_what_would_just_be_seen_moves_the_bands_by_as_much_as_chance_hardly_does(
    name: str, evidences: dict[str, Evidence]
) -> None:
    part, effect = part_of(evidences["clean"]), effect_of(name)
    said = {line.split(":")[0]: float(line.split("less than ")[1].split()[0]) for line in part.faintest(effect)}
    assert list(said) == [f"{name} (acceleration)", f"{name} (rate)"]
    for on in effect.quantities:
        start = effect.starts(part.reference, on)[0]
        first, own = effect.parameters[0].name, effect.coordinates[0].name
        power = (said[f"{name} ({on})"] / effect.physical(start)[first]) ** 2
        local = Local(part.channels.sensitivity, part.channels.pole, part.zeros)
        there = Term(effect, on, {**start, own: power * start[own]})
        assert np.sum((part.raw(local, [there]) - part.raw(local, [])) ** 2) == pytest.approx(SEEN, rel=0.25)


@pytest.mark.parametrize("value", [0.0, math.nan])
def test_of_what_changes_no_band_no_size_is_said(
    value: float, evidences: dict[str, Evidence], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(NoiseSpectrum, "raw", lambda *_: np.full((1, 1), value))
    assert list(part_of(evidences["clean"]).faintest(effect_of("white"))) == []


def test_nothing_is_learned_of_sensitivity_and_pole_from_the_noise_of_the_sheet(evidences: dict[str, Evidence]) -> None:
    part = part_of(evidences["white"])
    local = Local(part.channels.sensitivity, part.channels.pole, part.zeros)
    assert not any(column.any() for column in part.own_columns(local, [], part.raw(local, [])))
    louder = replace(local, sensitivity=2.0 * local.sensitivity)
    assert np.array_equal(part.raw(louder, []), part.raw(local, []))
    term = Term(effect_of("white"), "acceleration", {"power": 4e-8})
    gain, pole, zero = part.own_columns(local, [term], part.raw(local, [term]))
    assert gain.any()
    assert not pole.any()
    assert not zero.any()


# numerics


def drawn(random: np.random.Generator, seconds: float, walk: float = 0.0, line: float = 0.0) -> np.ndarray:
    """White noise of density 2/RATE, a random walk of density 2·walk²/(2πf)², a line at 37 Hz, (n, 1)."""
    count = round(seconds * RATE)
    values = random.standard_normal(count) + np.cumsum(random.standard_normal(count)) * walk / math.sqrt(RATE)
    return np.asarray(values + line * np.cos(2.0 * math.pi * 37.0 * np.arange(count) / RATE))[:, None]


def test_bands_hold_the_density_and_scatter_as_their_degrees_of_freedom_say() -> None:
    random = np.random.default_rng(1)
    found = [one for _ in range(60) if (one := bands([drawn(random, 20.0)], RATE, MAINS)) is not None]
    power = np.array([one.power[0] for one in found])
    assert power.mean(axis=0) == pytest.approx(2.0 / RATE, rel=0.25)
    assert power.mean() == pytest.approx(2.0 / RATE, rel=0.02)
    relative = power.var(axis=0) / power.mean(axis=0) ** 2 * found[0].dof / 2.0
    assert relative.mean() == pytest.approx(1.0, abs=0.12)


def test_a_random_walk_is_as_strong_in_every_band_as_it_is() -> None:
    random = np.random.default_rng(2)
    found = bands([drawn(random, 30.0, walk=1.0) for _ in range(60)], RATE, MAINS)
    assert found is not None
    slow = found.high < 3.0
    wanted = (2.0 / (2.0 * math.pi * found.nodes) ** 2).mean(axis=1) + 2.0 / RATE
    off = np.log(found.power[0][slow] / wanted[slow]) / np.sqrt(2.0 / found.dof[slow])
    assert np.sqrt(np.mean(off**2)) < 1.7
    assert abs(off.mean()) < 0.8


def test_a_strong_line_stays_within_its_band_with_all_its_power() -> None:
    quiet, loud = (bands([drawn(np.random.default_rng(3), 30.0, line=line)], RATE, MAINS) for line in (0.0, 1.0))
    assert quiet is not None
    assert loud is not None
    here = (loud.low <= 37.0) & (loud.high > 37.0)
    assert loud.power[0][here] == pytest.approx(0.5 * of_line(loud, 37.0)[here], rel=0.06)
    assert loud.power[0][~here] == pytest.approx(quiet.power[0][~here], rel=0.05)


def test_what_a_line_adds_to_every_band_is_known_where_it_leaks_too() -> None:
    time = np.arange(5 * round(RATE)) / RATE
    for phase in (0.3, 2.0):
        found = bands([np.cos(2.0 * math.pi * 4.35 * time + phase)[:, None]], RATE, MAINS)
        assert found is not None
        near = np.flatnonzero((found.low < 8.0) & (found.high > 2.8))
        assert len(near) >= 3
        assert found.power[0][near] == pytest.approx(0.5 * of_line(found, 4.35)[near], rel=0.2)
        assert of_line(found, 4.35)[near].min() > 0.0


def test_the_mains_is_left_out() -> None:
    time = np.arange(30_000) / RATE
    hum = 5.0 * np.cos(2.0 * math.pi * MAINS * time) + 2.0 * np.cos(2.0 * math.pi * 3.0 * MAINS * time)
    noise = drawn(np.random.default_rng(4), 30.0)
    quiet, loud = (bands([noise + more], RATE, MAINS) for more in (0.0, hum[:, None]))
    assert quiet is not None
    assert loud is not None
    assert loud.power == pytest.approx(quiet.power, rel=0.1)


def test_too_short_a_record_has_no_bands() -> None:
    assert bands([np.zeros((4, 1))], RATE, MAINS) is None


def sheet(level: float = 1.0) -> Sheet:
    one = np.ones(1)
    return Sheet(level * one, 0.2 * one, 60.0 * one, 3.0 * one, 0.66 * one, 1e-6 * one)


def like(power: Sheet, at: list[float], more: float = 0.0) -> Bands:
    """Bands that hold exactly what a sheet says, its open logarithms being `at`."""
    sides = np.geomspace(0.1, 500.0, 40)
    nodes = np.sqrt(sides[:-1] * sides[1:])[:, None]
    density = power.spectrum(nodes, RATE, np.array([at]))[0].mean(axis=-1) + more
    return Bands(nodes, sides[:-1], sides[1:], density, np.full(39, 1e4), (), RATE, MAINS)


def test_the_derivatives_of_a_sheet_are_right() -> None:
    nodes = np.geomspace(0.1, 490.0, 12)[:, None]
    at = np.array([[0.2, -0.1, 0.5, 0.3]])
    _, slopes = sheet().spectrum(nodes, RATE, at)
    for k, slope in enumerate(slopes):
        step = 1e-5 * np.eye(4)[k]
        above, below = (sheet().spectrum(nodes, RATE, at + sign * step)[0] for sign in (1.0, -1.0))
        assert slope == pytest.approx((above - below) / 2e-5, rel=1e-6, abs=1e-9)


def test_what_a_sheet_leaves_open_is_found() -> None:
    true = [0.15, -0.05, 0.5, -0.4]
    assert Levels(sheet(), RATE, like(sheet(), true)).start()[0] == pytest.approx(true, abs=0.1)


def test_what_is_added_is_taken_off_before_the_levels_are_found() -> None:
    true = [0.15, -0.05, 0.5, -0.4]
    levels = Levels(sheet(), RATE, like(sheet(), true, more=0.1))
    assert np.abs(levels.start()[0] - true).max() > 0.3
    assert levels.with_added(levels.start(), np.full((1, 39), 0.1))[0][:3] == pytest.approx(true[:3], abs=0.1)


def test_bands_held_out_move_by_what_the_others_do_not_tell_of_the_sheet() -> None:
    """Twenty seconds at rest of 1500 sensors tell level, pole, corner and reach of each, for ten seconds more."""
    count, random = 1500, np.random.default_rng(8)
    whole = Sheet(*(np.full(count, float(one[0])) for one in vars(sheet()).values()))
    at = whole.known * random.normal(size=(count, 4))
    sides, nothing = np.geomspace(0.1, 500.0, 26), np.zeros((count, 25))
    nodes = np.sqrt(sides[:-1] * sides[1:])[:, None]
    density = whole.spectrum(nodes, RATE, at)[0].mean(axis=-1)
    told, held = (
        Bands(nodes, sides[:-1], sides[1:], density * random.chisquare(dof, density.shape) / dof, dof, (), RATE, MAINS)
        for dof in (np.maximum(2.0 * seconds * np.diff(sides), 10.0) for seconds in (20.0, 10.0))
    )
    levels = Levels(whole, RATE, told)
    known, seen = levels.start(), Scatter.of(held)
    moved = seen.deviates(mean_density(whole, RATE, held, known)) - seen.deviates(density)
    stated = levels.unsure(known, nothing, held, nothing)
    slow = sides[1:] < 50.0  # above, the shape of a sheet is the limit
    assert np.mean(moved[:, slow] ** 2) > 0.05
    assert np.sum(stated[:, slow] ** 2, axis=2).mean() == pytest.approx(np.mean(moved[:, slow] ** 2), rel=0.15)


def test_deviates_of_few_lines_are_normal() -> None:
    random = np.random.default_rng(5)
    dof = np.full(1, 11.0)
    found = Scatter(random.chisquare(11.0, (40_000, 1)) / 11.0, dof).deviates(np.ones(1))
    assert found.mean() == pytest.approx(0.0, abs=0.02)
    assert found.std() == pytest.approx(1.0, abs=0.02)
    assert np.mean(found < -3.0) < 0.003


def test_a_walk_is_seen_with_its_level_and_none_where_there_is_none() -> None:
    random = np.random.default_rng(6)
    both = np.array([True])
    own = Sheet(np.full(1, 2.0 / RATE), *(np.full(1, x) for x in (0.2, 1e4, 0.01, 0.66, 0.0)))
    for walk in (0.0, 0.3):
        found = bands([drawn(random, 30.0, walk=walk) for _ in range(20)], RATE, MAINS)
        assert found is not None
        level = Levels(own, RATE, found).walks(both, np.ones(1))[0]
        assert level == pytest.approx(2.0 * walk**2 / (2.0 * math.pi) ** 2, rel=0.35)


def lined(seed: int, frequency: float = 0.0, amplitude: float = 0.0, phases: bool = False) -> np.ndarray:
    """Six channels of white noise, a line in all of them converted one after the other, (n, 6)."""
    random = np.random.default_rng(seed)
    time = np.arange(20_000)[:, None] / RATE + 1e-5 * np.arange(6)
    turned = 2.0 * math.pi * frequency * time + (random.uniform(0.0, 6.0, 6) if phases else 0.0)
    return np.asarray(random.standard_normal((20_000, 6)) + amplitude * np.cos(turned))


def test_a_line_is_found_with_frequency_and_amplitude_and_none_in_noise() -> None:
    found = strongest([lined(1, 37.123, 0.08), lined(2, 37.123, 0.08)], RATE, MAINS)
    assert found is not None
    assert abs(found.frequency - 37.123) < 4.0 * found.u < 0.01
    assert np.all(np.abs(found.amplitude - 0.08) < 4.5 * found.u_amplitude)
    assert not any(strongest([lined(seed)], RATE, MAINS) for seed in range(12))


def test_a_line_at_a_multiple_of_the_mains_is_none() -> None:
    assert strongest([lined(1, 3.0 * MAINS, 0.3)], RATE, MAINS) is None


@pytest.mark.parametrize(("frequency", "was"), [(12_345.6, 12_345.6), (94_321.0, 5_679.0), (120.5, None)])
def test_a_folded_line_is_known_by_its_phases(frequency: float, was: float | None) -> None:
    """Modulo 100 kHz, and with either sign; a line below half the rate was not folded."""
    found = strongest([lined(3, frequency, 0.2)], RATE, MAINS)
    assert found is not None
    told = folded(found, 1e-5 * np.arange(6), RATE)
    assert (told is None) if was is None else told == pytest.approx(was, abs=0.01)
    other = strongest([lined(4, frequency, 0.2, phases=True)], RATE, MAINS)
    assert other is not None
    assert folded(other, 1e-5 * np.arange(6), RATE) is None


@pytest.mark.parametrize("step", [1.6, 3.3, 7.9])
def test_codes_that_are_left_out_tell_the_step(step: float) -> None:
    volts = np.random.default_rng(5).normal(0.3, 6.0, 50_000)
    found = coarse_step(np.round(step * np.round(volts / step)))
    assert found is not None
    assert abs(found[0] - step) < 3.5 * found[1]
    assert coarse_step(np.round(volts)) is None


def test_one_line_in_two_records_is_told_once_and_by_those_that_show_whether_it_was_folded() -> None:
    """Three gyros at rest on the shaker cannot say it, six on the turntable can."""
    hidden = {"name": "aliasing", "parameters": {"amplitude": 2.4e-4, "frequency": 28224.1, "quantity": "rate"}}
    world = fast_bench.world(1, [hidden])
    runs = [fast_bench.measure(one, world) for one in ({"procedure": "frequency_sweep", "points": 3},
                                                       {"procedure": "turntable", "revolutions": 3})]  # fmt: skip
    found = evidence_of(runs)
    shown = [one for part in found.parts if isinstance(part, NoiseSpectrum) for one in part.data.lines]
    assert [one.line.frequency for one in shown] == pytest.approx([99.108, 99.108], abs=0.01)
    assert [math.isfinite(one.folded) for one in shown] == [False, True]
    told = list(NoiseSpectrum.signs([part for part in found.parts if isinstance(part, NoiseSpectrum)]))
    assert [one.effect for one in told] == ["aliasing"]
    assert told[0].at["frequency"] == pytest.approx(50e3 - 28224.1, abs=0.1)  # which no phase tells from it


def test_a_fit_leaves_the_frequency_of_a_line_where_the_line_is(evidences: dict[str, Evidence]) -> None:
    for name in ("spur", "aliasing"):
        found = diagnose(evidences[name])
        (step,) = found.steps
        assert found.final.state.terms[-1].at["frequency"] == step.taken.term.at["frequency"]
        assert step.taken.u["frequency"] > 0.0


def test_what_removes_nothing_makes_no_record_unsteady_that_is_not(evidences: dict[str, Evidence]) -> None:
    """A weak line hardly moves a band: the fit with it may even leave more, by rounding."""
    found = diagnose(evidences["spur"])
    assert not unsteady(found.base)
    assert not _changing(found.final, found.base, found.steps)
