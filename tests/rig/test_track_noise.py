"""Noise of a device on a shaft that is known without any model: what its rests and its data sheet make of a verdict."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from imported_worlds import AXES, Unit, clean, evidence, rotation

from rig.diagnose.conclusion import conclude
from rig.diagnose.diagnose import diagnose
from rig.fit.adequacy import groups, unsteady
from rig.foreign.tables import Foreign
from rig.parts.track import TrackedMotion
from rig.shelf import shelf
from rig.signals.encoder_angle import encoder_track

WHITE = 2.0 * 2e-3**2 / 100.0  # (rad/s)²/Hz of the worlds' gyros: 2 mrad/s at 100 rows a second
SHEET = {"density": f"{math.sqrt(WHITE):.4g} (rad/s)/√Hz", "tolerance": "10 %"}


def turned(foreign: Foreign) -> TrackedMotion:
    (part,) = evidence(foreign).parts
    assert isinstance(part, TrackedMotion)
    return part


def stepped(foreign: Foreign, gain: float) -> Foreign:
    """The same with the gyro about the axis more sensitive in the second half."""
    (table,) = foreign.tables
    rows, column = table.values.copy(), table.names.index("gyro_z")
    rows[len(rows) // 2 :, column] *= gain
    return replace(foreign, tables=(replace(table, values=rows),))


def test_the_noise_of_a_device_that_stood_is_found_with_its_uncertainty() -> None:
    off = []
    for seed in range(8):
        part = turned(rotation(Unit(), seed, seconds=40.0, rest=10.0, channels="r"))
        for row in range(3):
            known = part.known(row)
            assert known is not None
            assert known.origin == part.origin(f"gyro_{AXES[row]}") == "at rest"
            density, u = float(known.model.density(3.0)), float(known.model.u_log(3.0))
            assert 0.05 < u < 0.25
            off.append(math.log(density / WHITE) / u)
    assert 0.6 < math.sqrt(float(np.mean(np.square(off)))) < 1.4


def test_with_a_rest_clean_records_are_adequate_and_nothing_is_left_but_noise() -> None:
    found = [diagnose(evidence(rotation(clean(seed), seed, rest=10.0, channels="r"))) for seed in range(10)]
    assert sum(one.verdict != "adequate" for one in found) <= 1
    assert not any(one.named for one in found)
    assert 0.8 < float(np.median([one.final.chi2 / one.final.count for one in found])) < 1.2


@pytest.mark.parametrize("seed", [0, 13])
def test_where_motion_begins_is_no_gain_that_creeps(seed: int) -> None:
    assert not unsteady(evidence(rotation(clean(seed), seed, rest=10.0, channels="r")).fitted())


def test_a_gain_that_steps_is_not_taken_for_noise_where_the_noise_is_known() -> None:
    foreign = stepped(rotation(Unit(), 3, rest=10.0, channels="r"), 1.023)
    assert diagnose(evidence(foreign)).verdict in ("missing", "unlisted")


def test_without_rest_or_data_sheet_the_verdict_is_undecided_and_says_how_large_the_error_is() -> None:
    said = conclude(evidence(rotation(Unit(), 1, channels="r")), [], shelf())
    assert said.verdict == "undecided"
    (group,) = said.untold
    assert group.noise_from == ("misfit",)
    assert group.unit == "rad/s"
    assert 1e-3 < group.error < 2e-2
    assert "record 30 s at rest" in group.to_know
    assert "noise" in group.to_know


def test_a_data_sheet_that_is_stated_stands_for_a_rest() -> None:
    foreign = rotation(Unit(), 1, channels="r", sheet=SHEET)
    assert turned(foreign).origin("gyro_z") == "data sheet"
    found = diagnose(evidence(foreign))
    assert found.verdict == "adequate"
    louder = {**SHEET, "density": f"{0.3 * math.sqrt(WHITE):.4g} (rad/s)/√Hz"}
    assert diagnose(evidence(rotation(Unit(), 1, channels="r", sheet=louder))).verdict != "adequate"


def test_a_rest_outweighs_a_data_sheet_that_is_unsure() -> None:
    sheet = {"density": f"{2.0 * math.sqrt(WHITE):.4g} (rad/s)/√Hz", "tolerance": "80 %"}
    known = turned(rotation(Unit(), 2, seconds=60.0, rest=25.0, channels="r", sheet=sheet)).known(2)
    assert known is not None
    assert float(known.model.density(3.0)) == pytest.approx(WHITE, rel=0.3)


# the reference


def swung(jitter: float, noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    t = np.arange(6000) / 100.0
    angle = np.sin(2.0 * np.pi * 0.7 * t) + 0.3 * np.sin(2.0 * np.pi * 1.9 * t)
    return t + jitter * random.normal(size=len(t)), angle + noise * random.normal(size=len(t))


@pytest.mark.parametrize("jitter", [0.0, 1e-3])
def test_jitter_of_time_stamps_shows_in_readings_that_scatter_with_the_rate(jitter: float) -> None:
    found = [encoder_track(*swung(jitter, 5e-4, seed), keep=7.5).jitter for seed in range(6)]
    assert found == pytest.approx([jitter] * 6, rel=0.15)


def test_the_band_ends_where_the_motion_no_longer_stands_above_the_references_noise() -> None:
    quiet, noisy = (encoder_track(*swung(0.0, noise, 1)) for noise in (1e-5, 1e-2))
    assert 1.9 < noisy.clear < 3.0
    assert noisy.clear <= quiet.clear < noisy.bandwidth * 4.0
    at = float(np.median(noisy.density[noisy.good]))
    assert at == pytest.approx(2.0 * 1e-2**2 / 100.0, rel=0.15)


def test_a_zero_that_creeps_by_what_one_sample_scatters_is_no_slow_noise() -> None:
    verdicts = []
    for seed in range(6):
        foreign = rotation(Unit(), seed, rest=10.0, channels="r", jitter=1e-4)
        (table,) = foreign.tables
        rows, t = table.values.copy(), table.of("t")
        rows[:, table.names.index("gyro_z")] += 2e-3 * (t - t[0]) / (t[-1] - t[0])
        verdicts.append(diagnose(evidence(replace(foreign, tables=(replace(table, values=rows),)))).verdict)
    assert "adequate" not in verdicts


def test_accelerometers_at_rest_on_a_level_axis_are_as_uncertain_as_the_code_on_which_the_encoder_stands() -> None:
    """No average of equal readings knows where within the code the axis stands: 0.4 mrad are 4 mm/s² of gravity."""
    squares = count = 0.0
    for seed in range(6):
        log = rotation(clean(seed), seed, seconds=40.0, rest=10.0, upright=False, jitter=1e-4)
        means = [one for one in groups(evidence(log).fitted()) if one.channel in ("acc_x", "acc_y")]
        squares += sum(one.chi2 for one in means if one.domain == "mean")
        count += sum(one.count for one in means if one.domain == "mean")
    assert 0.4 < squares / count < 1.5
