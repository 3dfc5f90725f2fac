"""Imported sweeps: what comes out of sines that were made here, and of a real shaker with two accelerometers."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import imported_sweeps
import numpy as np
import pytest
from imported_sweeps import DRIVE, INTERVAL, columns, distorted, made, real

from rig.diagnose.diagnose import diagnose
from rig.diagnose.misfit import compare
from rig.errors import BadInput
from rig.fit import adequacy
from rig.fit.evidence import Evidence
from rig.foreign.tables import Foreign
from rig.parts import sweep_lines
from rig.parts.reading.imported_sweep import sweeps
from rig.parts.reading.shaker_distortion import distortions, gains
from rig.parts.sweep import Sweep
from rig.parts.sweep_lines import separated
from rig.parts.sweep_records import SweepRecords


def _evidence(data: SweepRecords) -> Evidence:
    return Evidence((Sweep(data),), (), (data.run,), "board", False, data.notes)


@lru_cache(maxsize=4)
def _real(unit: str = "") -> SweepRecords:
    return sweeps(real(unit=unit))[0]


def _said(data: SweepRecords, word: str) -> str:
    return " ".join(note for note in data.notes if word in note)


def test_the_driven_frequency_is_found_though_another_was_commanded() -> None:
    data = sweeps(made())[0]
    assert data.nominal[1:] == pytest.approx(5.0)
    assert data.frequency[1:] == pytest.approx(DRIVE, abs=1e-5)
    assert data.frequency[0] == data.nominal[0] == 0.0
    assert (data.level[0], data.index[0]) == ("rest", -1)


def test_the_gain_of_two_accelerometers_errs_as_much_as_it_states() -> None:
    pulls = []
    for seed in range(6):
        data = sweeps(made(seed=seed, rattle=0.3))[0]
        pulls += [(one.magnitude - 0.963) / one.u for one in gains(data)]
    assert 0.6 < float(np.std(pulls)) < 1.5
    assert abs(float(np.mean(pulls))) < 0.7


def test_a_device_with_a_gain_alone_leaves_nothing_but_noise_however_much_the_shaker_distorts_and_rattles() -> None:
    data = sweeps(made(shaker=distorted, rattle=0.3))[0]
    found = _evidence(data).fitted()
    assert found.chi2 / found.count == pytest.approx(1.0, abs=0.45)
    assert adequacy.adequate(found)
    assert 1.0 + found.state.gain["board"] == pytest.approx(0.963, abs=2e-4)
    assert diagnose(_evidence(data)).verdict == "adequate"


def test_motion_between_the_lines_is_not_noise() -> None:
    quiet, loud = (sweeps(made(rattle=rattle))[0] for rattle in (0.0, 1.0))
    assert np.nanmax(loud.variance / quiet.variance) < 4.0
    spread = np.abs(loud.leftovers[-1].reference).mean() / np.abs(quiet.leftovers[-1].reference).mean()
    assert spread > 3.0


def test_the_noise_of_a_reference_that_two_devices_share_is_told_from_theirs() -> None:
    both = [*columns(), {"column": "twin", "quantity": "unstated", "axis": "z"}]
    foreign = made(columns_=both)
    random = np.random.default_rng(7)
    tables = []
    for table in foreign.tables:
        base = table.of("base") + 10.0 * imported_sweeps.NOISE * random.normal(size=len(table.values))
        twin = 0.9 * (table.of("board") + 0.013) / 0.963 + imported_sweeps.NOISE * random.normal(size=len(base))
        values = np.column_stack([table.of("drive"), base, table.of("board"), twin])
        tables.append(replace(table, names=("drive", "base", "board", "twin"), values=values))
    data = sweeps(replace(foreign, tables=tuple(tables)))[0]
    expected = 101.0 * imported_sweeps.NOISE**2 * 2.0 / imported_sweeps.SAMPLES
    assert np.nanmean(data.reference_variance[:, 1:]) == pytest.approx(expected, rel=0.3)
    assert np.nanmean(data.variance[0, :, 1:6]) < 0.3 * expected


def test_a_channel_that_is_sampled_late_by_a_stated_time_shows_no_delay() -> None:
    late = 2e-3
    stated = sweeps(made(late=late, columns_=columns(delay="2 ms")))[0]
    assert [one.phase for one in gains(stated)] == pytest.approx([0.0] * len(gains(stated)), abs=2e-3)
    bare = sweeps(made(late=late))[0]
    assert gains(bare)[-1].phase == pytest.approx(2.0 * np.pi * DRIVE * late, rel=0.02)


def test_a_delay_that_nobody_stated_is_found_in_the_harmonics() -> None:
    data = sweeps(made(late=-1e-3, shaker=distorted))[0]
    step = diagnose(_evidence(data)).steps[0]
    delay = next(one for one in step.members if one.name == "delay")
    assert delay.term.at["time"] == pytest.approx(1e-3, rel=0.02)


def test_harmonics_of_both_channels_are_called_the_shakers() -> None:
    data = sweeps(made(shaker=distorted))[0]
    assert [one.whose for one in distortions(data)] == ["shaker"]
    assert "the shaker's, not the sensor's" in _said(data, "distortion")
    assert "does not follow its drive in proportion" in _said(data, "reference over drive")


def test_harmonics_that_the_device_makes_are_called_its_own() -> None:
    data = sweeps(made(board=lambda a: 0.963 * (a + 0.04 * a**2)))[0]
    assert [one.whose for one in distortions(data)] == ["device"]
    assert "the sensor's own, not the shaker's" in _said(data, "distortion")
    assert not _said(data, "does not follow its drive")
    found = diagnose(_evidence(data))
    assert found.named == ("quadratic",)
    assert found.steps[0].taken.term.at["coefficient"] == pytest.approx(0.04, rel=0.01)


def test_harmonics_of_either_are_told_apart() -> None:
    data = sweeps(made(shaker=distorted, board=lambda a: 0.963 * a + 0.4 * a**2))[0]
    assert [one.whose for one in distortions(data)] == ["both"]


def test_no_distortion_is_said_to_be_none() -> None:
    assert "no distortion" in _said(sweeps(made())[0], "distortion")


def test_mains_lines_beside_a_harmonic_are_kept_apart() -> None:
    # the twelfth harmonic of 5.01 Hz lies 0.12 Hz beside 60 Hz: not to be told apart; that of 5.172 Hz is
    for drive in (5.01, DRIVE):
        data = sweeps(made(drive=drive, hum=0.02))[0]
        assert [one.magnitude for one in gains(data)] == pytest.approx([0.963] * len(gains(data)), abs=1e-3)
    assert "120.0, 240.0 Hz" in _said(data, "mains lines at rest")


def test_a_mains_line_that_coincides_with_a_harmonic_stays_with_it() -> None:
    t = np.asarray(INTERVAL * np.arange(imported_sweeps.SAMPLES), np.float64)
    values = imported_sweeps.waveform(t, 5.01, [1.0, *[0.0] * 10, 0.2])[:, None]
    one, other = (separated(t, values, 1.0 / INTERVAL, drive, 60.0) for drive in (5.01, DRIVE))
    assert 60.0 not in one.mains
    assert 60.0 in other.mains
    assert one.harmonics[0, 11] == pytest.approx(0.2, abs=1e-9)


def test_a_drive_that_is_off_is_reported_when_mains_lines_are_right() -> None:
    assert "the drive runs 3.4% fast: commanded 5 Hz, found 5.172 Hz" in _said(sweeps(made())[0], "drive runs")
    assert "4.0% slow" in _said(sweeps(made(drive=4.8))[0], "drive runs")


def test_units_that_nobody_stated_are_said_to_be_unstated_and_g_is_converted() -> None:
    bare, stated = sweeps(made())[0], sweeps(made(columns_=columns("g")))[0]
    assert "not stated" in _said(bare, "unit of base, board")
    assert not _said(stated, "not stated")
    assert np.abs(stated.shown[1:, 1]) == pytest.approx(9.80665 * np.abs(bare.shown[1:, 1]))
    assert [one.magnitude for one in gains(stated)] == pytest.approx([one.magnitude for one in gains(bare)])


def test_a_sweep_without_a_recorded_drive_takes_the_frequency_from_the_reference() -> None:
    data = sweeps(made(columns_=columns()[1:], shaker=distorted))[0]
    assert data.frequency[1:] == pytest.approx(DRIVE, abs=2e-3)
    assert not _said(data, "reference over drive")


def _broken(change: str) -> Foreign:
    foreign = made(levels=(0.5,))
    table = foreign.tables[1]
    values = table.values.copy()
    if change == "gap":
        values[100:110, 1] = np.nan
    elif change == "silent":
        values[:, 0] = np.random.default_rng(0).normal(size=len(values))
    settings = {"frequency": "five"} if change == "text" else table.settings
    return replace(foreign, tables=(foreign.tables[0], replace(table, values=values, settings=settings)))


@pytest.mark.parametrize(
    ("change", "said"),
    [("gap", "file 1: found 10 rows that are no numbers"), ("silent", "found no line near 5 Hz"),
     ("text", "settings.frequency: found 'five'")],
)  # fmt: skip
def test_a_record_that_cannot_be_used_is_refused_with_what_was_wanted(change: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        sweeps(_broken(change))


def test_a_run_of_another_kind_has_no_sweeps() -> None:
    assert sweeps(made(kind="motion")) == []


# the real shaker


def test_the_real_boards_gain_is_0_963_at_every_level() -> None:
    found = gains(_real())
    assert len(found) == 10
    assert [one.magnitude for one in found] == pytest.approx([0.963] * 10, abs=0.002)
    assert max(one.u for one in found) < 4e-4
    assert "0.9625 ± 0.0023 at every level" in _said(_real(), "over reference")


def test_the_real_drive_runs_fast_and_not_the_recorder() -> None:
    assert _real().frequency[1:] == pytest.approx(5.17206, abs=2e-5)
    assert "the drive runs 3.4% fast: commanded 5 Hz, found 5.172 Hz, while mains lines come out at 120.0" in _said(
        _real(), "drive runs"
    )


def test_the_real_distortion_is_the_shakers() -> None:
    only = distortions(_real())[0]
    assert only.whose == "shaker"
    assert only.share < 0.02
    assert only.reference == pytest.approx(0.309, abs=0.003)
    assert "0.568 at amplifier 5, command 0.1" in _said(_real(), "reference over drive")
    assert "0.608 at amplifier 5, command 0.5" in _said(_real(), "reference over drive")
    shown = np.abs(_real().shown[1:, 2:] / _real().shown[1:, 1:2])
    assert shown[0, :2] == pytest.approx([0.059, 0.009], abs=1e-3)
    assert shown[-1, :2] == pytest.approx([0.149, 0.277], abs=2e-3)


def test_ten_harmonics_take_a_one_sine_residual_of_the_real_base_from_0_192_to_0_021() -> None:
    from rig.signals import tone

    table = real("amplitude_5_impact_0.0_vibration_1.csv").tables[0]
    t, base = INTERVAL * np.arange(len(table.values)), table.of("base")
    left = [tone.fit_three(t, base, float(_real().frequency[-1]), count).residual_rms for count in (1, 10)]
    assert left == pytest.approx([0.192, 0.021], abs=5e-4)


def test_a_gain_takes_the_real_error_down_and_what_is_left_is_not_called_the_vibrometers() -> None:
    evidence = _evidence(_real("g"))
    assert compare(evidence).groups[0].error < 0.05  # m/s², of 2.7 m/s²
    found = diagnose(evidence)
    assert not [name for name in found.named if name.startswith("ldv_")]
    assert found.final.chi2 < 0.4 * found.base.chi2
    assert found.verdict == "unlisted"


def test_no_command_of_the_bench_is_advised_for_a_sweep_that_somebody_else_made() -> None:
    part = Sweep(sweeps(made(levels=(0.3, 1.0)))[0])
    (said,) = part.said_of_ripple(None)
    assert "mounted once more" in said
    assert "rig " not in said


@pytest.mark.parametrize(("harmonics", "lines"), [(1, 0), (7, 3), (40, 11), (0, 2)])
def test_products_of_harmonics_follow_from_their_sums(harmonics: int, lines: int) -> None:
    t = np.sort(np.random.default_rng(harmonics).uniform(0.0, 2.0, 1500))  # no even spacing is needed
    rows = sweep_lines._rows(t, harmonics, 7.3, 50.0 + 60.0 * np.arange(lines))
    assert sweep_lines._gram(rows, harmonics) == pytest.approx(rows @ rows.T, abs=1e-9 * len(t))
