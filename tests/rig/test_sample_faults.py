"""Samples that are no measurement, in records made here: found where they are, left out, and no model adequate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import imported_runs
import imported_sweeps
import numpy as np
import pytest
from imported_worlds import Unit, clean, evidence, rotation

from rig.diagnose.conclusion import conclude
from rig.diagnose.diagnose import diagnose
from rig.fit.adequacy import adequate, unsteady
from rig.fit.quality import error_of
from rig.foreign.faults import faults
from rig.foreign.finding import Finding
from rig.foreign.tables import Foreign
from rig.parts.track import TrackedMotion
from rig.shelf import shelf

Array = np.ndarray
GAIN = 1.015
LEVELS = (0.3, 0.6, 1.0)  # of a sweep


def spoilt(foreign: Foreign, name: str, change: Callable[[Array], Array]) -> Foreign:
    """The same with one column of every file changed."""
    tables = []
    for table in foreign.tables:
        values, column = table.values.copy(), table.names.index(name)
        values[:, column] = change(values[:, column].copy())
        tables.append(replace(table, values=values))
    return replace(foreign, tables=tuple(tables))


def turned(seed: int = 1) -> Foreign:
    return rotation(Unit(rate_gain=(1.0, 1.0, GAIN)), seed, rest=10.0, channels="r", jitter=1e-4)


def found(foreign: Foreign) -> list[Finding]:
    return [one for t in foreign.tables for c in foreign.manifest.columns for one in faults(foreign, t, c)]


def put(rows: list[int], value: float) -> Callable[[Array], Array]:
    def change(values: Array) -> Array:
        values[rows] = value
        return values

    return change


def cut(values: Array) -> Array:
    return np.clip(values, -2.4, 2.4)


def stuck(values: Array) -> Array:
    values[3000:3150] = values[3000]
    return values


def stretch(values: Array) -> Array:
    values[1350:3850] = values[1350]
    return values


def jumped(values: Array) -> Array:
    values[3333:] = np.mod(values[3333:] - 0.2, 2.0 * math.pi)
    return values


def held(values: Array) -> Array:
    values[2500:2506] = values[2500]
    return values


def touched(values: Array) -> Array:
    return np.minimum(values, np.sort(values)[-4])  # the four largest are one number


def slipped(values: Array) -> Array:
    values[3333:] = np.mod(values[3333:] + 0.03, 2.0 * math.pi)
    return values


CASES: dict[str, tuple[str, Callable[[Array], Array], str, int]] = {
    "glitches": ("gyro_z", put([2222, 4567], -9.0), "alone", 2),
    "a glitch of two rows": ("gyro_z", put([2500, 2501], -9.0), "alone", 2),
    "sentinels": ("gyro_z", put([1500, 1501, 1502, 1503, 4000, 5000], -100.0), "marks", 6),
    "cut off": ("gyro_z", cut, "clipped", 0),
    "held for six rows": ("gyro_z", held, "frozen", 6),
    "cut off at one peak": ("gyro_z", touched, "clipped", 4),
    "a reference that slips by what it turns in two rows": ("angle", slipped, "reference_step", 1),
    "stuck": ("gyro_z", stuck, "frozen", 150),
    "a reference that jumps": ("angle", jumped, "reference_step", 1),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_no_measurement_is_found_in_its_rows_and_nowhere_else(case: str) -> None:
    name, change, kind, rows = CASES[case]
    one, *more = found(spoilt(turned(), name, change))
    assert {one.kind, *(other.kind for other in more)} == {kind}
    assert one.channel == name
    total = sum(len(other.rows) for other in (one, *more))
    assert total == pytest.approx(rows, rel=0.05) if rows else total > 100


def test_where_a_stuck_channel_lets_go_no_row_is_blamed_besides() -> None:
    clean = turned()
    for first in range(1500, 5000, 250):
        (one,) = found(spoilt(clean, "gyro_z", put(list(range(first, first + 150)), 0.123)))
        assert (one.kind, one.stretches) == ("frozen", ((first, first + 149),))


def test_an_encoder_that_rests_and_a_sine_that_comes_back_to_where_it_was_are_no_faults() -> None:
    slow = rotation(Unit(), 4, rest=30.0, channels="r", jitter=1e-4, steps=math.radians(1.0))
    assert not found(slow)
    foreign = imported_sweeps.made(levels=())
    exact = np.sin(2.0 * np.pi * np.arange(imported_sweeps.SAMPLES) / 40.0)
    assert not [one for one in found(spoilt(foreign, "drive", lambda values: exact)) if one.channel == "drive"]


@pytest.mark.parametrize(("level", "rest"), [(2.4, 10.0), (1.0, 10.0), (1.5, 0.0)])
def test_a_gyro_that_is_cut_off_at_every_swing_is_compared_between(level: float, rest: float) -> None:
    seed = round(10.0 * level)
    turning = rotation(Unit(rate_gain=(1.0, 1.0, GAIN)), seed, rest=rest, channels="r", jitter=1e-4)
    cut_off = evidence(spoilt(turning, "gyro_z", lambda values: np.clip(values, -level, level)))
    assert diagnose(cut_off).verdict == "undecided"
    fit = cut_off.fitted()
    z = fit.layout.gains["gyro_z"]
    u = math.sqrt(fit.covariance[z, z])
    assert u < 1e-3
    assert 1.0 + fit.state.gain["gyro_z"] == pytest.approx(GAIN, abs=3.0 * u)
    assert 0.8 < error_of(fit) < 1.15


@pytest.mark.parametrize("case", CASES)
def test_a_record_with_it_is_not_called_adequate_and_gives_the_sensitivity_all_the_same(case: str) -> None:
    name, change, _, _ = CASES[case]
    bad = evidence(spoilt(turned(), name, change))
    said = conclude(bad, [], shelf())
    assert said.verdict == "undecided"
    assert not said.untold
    assert len(said.faults) >= 1
    fit = said.diagnosis.base
    z = fit.layout.gains["gyro_z"]
    gain, u = 1.0 + fit.state.gain["gyro_z"], math.sqrt(fit.covariance[z, z])
    assert gain == pytest.approx(GAIN, abs=max(4.0 * u, 1e-4))
    part = bad.parts[0]
    assert isinstance(part, TrackedMotion)
    noise = part.known(2)
    assert noise is not None
    assert math.sqrt(float(noise.model.density(3.0)) * 50.0) == pytest.approx(2e-3, rel=0.25)


def test_clean_records_and_knocks_have_no_faults() -> None:
    assert not [one for seed in range(12) for one in found(rotation(Unit(), seed, rest=5.0))]
    random = np.random.default_rng(2)

    def knocked(values: Array) -> Array:
        for at in (900, 2700, 4100):
            values[at : at + 6] += 3.0 * random.normal(size=6)
        return values

    assert not found(spoilt(turned(), "gyro_z", knocked))
    jolted = spoilt(spoilt(turned(), "gyro_x", put([2500], 0.04)), "gyro_y", put([2500], -0.06))
    assert not found(jolted)  # both felt it


@pytest.mark.parametrize("seed", [5, 72])
def test_two_stamps_that_come_close_are_no_step_of_the_reference(seed: int) -> None:
    assert not found(rotation(clean(seed), seed, rest=10.0, channels="r"))


def test_a_clean_record_of_the_same_device_is_adequate() -> None:
    assert diagnose(evidence(turned())).verdict == "adequate"


def slowly(values: Array) -> Array:
    return values * (1.0 + 0.002 * np.linspace(0.0, 1.0, len(values)))


def later(values: Array) -> Array:
    return values * np.where(np.arange(len(values)) < 5000, 1.0, 1.001)


@pytest.mark.parametrize("change", [slowly, later])
def test_a_gain_that_creeps_or_steps_in_the_course_of_a_record_is_no_effect_and_no_noise(
    change: Callable[[Array], Array],
) -> None:
    """χ² of all rows hides what is small beside their number; a gain of its own in every stretch does not."""
    clean = rotation(Unit(rate_gain=(1.0, 1.0, GAIN)), 1, rest=10.0, seconds=90.0, channels="r", jitter=4e-4)
    bad = evidence(spoilt(clean, "gyro_z", change))
    fit = bad.fitted()
    assert adequate(fit)
    assert {one.channel for one in unsteady(fit)} == {"gyro_z"}
    assert not unsteady(evidence(clean).fitted())
    said = conclude(bad, [], shelf())
    assert said.verdict == "unlisted"
    assert not said.taken
    assert "its gain in the course of time of gyro_z" in said.description or "a trend" in said.description


@pytest.mark.parametrize(
    "change", [put([700, 1900], 99.0), lambda v: np.where(np.arange(len(v)) // 150 == 9, v[1350], v)]
)
def test_a_sweep_is_fitted_without_such_samples(change: Callable[[Array], Array]) -> None:
    foreign = imported_sweeps.made(levels=LEVELS)
    bad = spoilt(foreign, "board", change)
    assert found(bad)
    fits = [evidence(one).fitted() for one in (foreign, bad)]
    gains = [fit.state.gain["board"] for fit in fits]
    u = math.sqrt(fits[0].covariance[(z := fits[0].layout.gains["board"]), z])
    assert gains[1] == pytest.approx(gains[0], abs=2.0 * u)
    assert diagnose(evidence(bad)).verdict != "adequate"


def test_rows_that_are_filled_in_make_no_sweep_more_certain() -> None:
    clean = imported_sweeps.made(levels=LEVELS)
    bad = spoilt(clean, "board", stretch)
    assert found(bad)
    u = [
        math.sqrt(fit.covariance[(z := fit.layout.gains["board"]), z])
        for fit in (evidence(clean).fitted(), evidence(bad).fitted())
    ]
    assert 1.02 < u[1] / u[0] < 1.6


def test_a_pose_is_fitted_without_a_row_that_stands_for_nothing() -> None:
    clean = imported_runs.posed(1, gain=np.ones(3), zero=np.zeros(3))
    bad = spoilt(clean, "acc_x", put([int(len(clean.tables[0].values) // 2)], -99999.0))
    gains = [list(evidence(one).fitted().state.gain.values()) for one in (clean, bad)]
    assert gains[1] == pytest.approx(gains[0], abs=5e-4)


def test_the_noise_of_a_case_that_swings_a_little_while_it_rests_is_not_its_motion() -> None:
    foreign = turned(3)
    (table,) = foreign.tables
    t, values = table.of("t"), table.values.copy()
    swing = np.where(t < 10.0, 0.016 * np.sin(2.0 * np.pi * t), 0.0)
    values[:, table.names.index("gyro_z")] += GAIN * swing
    turn = np.where(t < 10.0, 0.016 * (1.0 - np.cos(2.0 * np.pi * t)) / (2.0 * np.pi), 0.0)
    values[:, table.names.index("angle")] = np.mod(values[:, table.names.index("angle")] + turn, 2.0 * np.pi)
    part = evidence(replace(foreign, tables=(replace(table, values=values),))).parts[0]
    assert isinstance(part, TrackedMotion)
    known = part.known(2)
    assert known is not None
    assert math.sqrt(float(known.model.density(3.0)) * 50.0) == pytest.approx(2e-3, rel=0.35)
