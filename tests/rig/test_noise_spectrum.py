"""Noise is part of the model: records at rest against data sheets, and what is louder than they allow."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import fast_bench
import numpy as np
import pytest

from rig.diagnose.conclusion import Conclusion, conclude
from rig.diagnose.misfit import compare
from rig.fit import adequacy
from rig.fit.evidence import Evidence, evidence_of
from rig.model import Local, Term
from rig.parts.noise_spectrum import NoiseSpectrum
from rig.repair.model_file import Model
from rig.repair.repair import Bench, added, fitted
from rig.shelf import effect_of, shelf
from rig.signals.rest_spectrum import Bands, bands
from rig.signals.sheet_noise import Levels, Scatter, Sheet

RATE, MAINS = 1000.0, 50.0
HIDDEN: dict[str, tuple[str, dict[str, Any]]] = {
    "clean": ("shaker", {}),
    "white": ("shaker", {"density": 2e-4, "quantity": "acceleration"}),
    "flicker": ("shaker", {"level": 1e-2, "quantity": "acceleration"}),
    "random_walk": ("turntable", {"coefficient": 1e-2, "quantity": "rate"}),
}


def rested(name: str) -> Evidence:
    """A minute at rest in a world that hides this."""
    cables, parameters = HIDDEN[name]
    hidden = [{"name": name, "parameters": parameters}] if parameters else []
    run = fast_bench.measure({"procedure": "noise", "length": "60 s", "cables": cables}, fast_bench.world(5, hidden))
    return evidence_of([run])


@pytest.fixture(scope="module")
def evidences() -> dict[str, Evidence]:
    return {name: rested(name) for name in HIDDEN}


@pytest.fixture(scope="module")
def conclusions(evidences: dict[str, Evidence]) -> dict[str, Conclusion]:
    return {name: conclude(one, [], shelf()) for name, one in evidences.items()}


def part_of(evidence: Evidence) -> NoiseSpectrum:
    return next(part for part in evidence.parts if isinstance(part, NoiseSpectrum))


def test_a_clean_record_is_adequate_and_nothing_is_named(conclusions: dict[str, Conclusion]) -> None:
    said = conclusions["clean"]
    assert said.verdict == "adequate"
    assert not said.candidates
    seen = {one.partition(":")[0] for one in said.cannot_see if "would not be seen in 60 s at rest" in one}
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
    assert found.u < 0.1 * true


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
    assert groups["shaker, noise of gyros"].ratio == pytest.approx(0.9, abs=0.2)  # four more rows, and the allowance for its shape


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
    assert loud.power[0][here] == pytest.approx(0.5 * loud.of_line[here], rel=0.06)
    assert loud.power[0][~here] == pytest.approx(quiet.power[0][~here], rel=0.05)


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
    return Bands(nodes, sides[:-1], sides[1:], density, np.full(39, 1e4), np.ones(39))


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
    assert levels.with_added(levels.start(), np.full((1, 39), 0.1))[0] == pytest.approx(true, abs=0.25)


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
