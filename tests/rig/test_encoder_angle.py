"""Encoder motion: from a log with steps, jitter, doubles and holes, from sampled lines, and from a real log."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfiltfilt

from rig.errors import BadInput
from rig.signals.encoder_angle import AngleTrack, angle_of_lines, encoder_track, quadrature_track

Array = NDArray[np.float64]
DATA = Path(os.environ.get("RIG_REAL_DATA", Path(__file__).parents[3] / "shared" / "data"))
STEP = 2.0 * np.pi / 4096  # 0.088°
FREQUENCIES = np.array([0.25, 0.7, 1.6, 3.1])
AMPLITUDES = np.array([4.0, 0.8, 0.2, 0.06])


def motion(time: Array, derivative: int = 0) -> Array:
    """Swings of more than a turn, rad and its derivatives."""
    turn = 2.0 * np.pi * FREQUENCIES[:, None]
    argument = turn * time + np.array([0.3, 1.0, 2.0, 4.0])[:, None] + derivative * np.pi / 2.0
    return np.asarray((AMPLITUDES[:, None] * turn**derivative * np.sin(argument)).sum(axis=0))


def logged(seed: int, count: int = 6000, jitter: float = 1e-3) -> tuple[Array, Array]:
    """Stamps in whole milliseconds, angles in steps and wrapped, read at jittery instants."""
    rng = np.random.default_rng(seed)
    instants = 0.01 * np.arange(count) + jitter * rng.uniform(-0.5, 0.5, count)
    angle = np.round(motion(instants) / STEP) * STEP % (2.0 * np.pi)
    return np.round(instants, 3), angle


def tracked(time: Array, angle: Array, **more: float) -> AngleTrack:
    known: dict[str, float] = {"u_angle": STEP / 12**0.5, "u_time": 1e-3 / 12**0.5} | more
    return encoder_track(time, angle, **known)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_error_is_small_against_the_motion_and_is_what_the_uncertainty_says() -> None:
    ratios = []
    for seed in range(6):
        track = tracked(*logged(seed))
        offset = np.round((track.angle - motion(track.time)).mean() / (2 * np.pi)) * 2 * np.pi
        errors = [track.angle - offset - motion(track.time), track.rate - motion(track.time, 1)]
        errors.append(track.acceleration - motion(track.time, 2))
        stated = [track.u_angle, track.u_rate, track.u_acceleration]
        assert rms(errors[1][track.good]) < 0.01 * rms(motion(track.time, 1))
        assert rms(errors[2][track.good]) < 0.03 * rms(motion(track.time, 2))
        assert track.good.mean() > 0.95
        ratios.append([rms((error / u)[track.good]) for error, u in zip(errors, stated, strict=True)])
    assert (np.mean(ratios, axis=0) > 0.7).all(), np.mean(ratios, axis=0)
    assert (np.mean(ratios, axis=0) < 1.2).all(), np.mean(ratios, axis=0)


def test_the_angle_runs_on_over_a_full_turn() -> None:
    track = tracked(*logged(1))
    assert np.ptp(track.angle) == pytest.approx(np.ptp(motion(track.time)), abs=0.01)
    assert np.ptp(track.angle) > 2.0 * np.pi


def test_stamps_that_do_not_increase_are_dropped_and_counted_and_change_little() -> None:
    time, angle = logged(2)
    doubled = time.copy()
    doubled[[500, 1500, 2500]] = doubled[[499, 1499, 2499]]
    doubled[3000] = doubled[2990]
    track, plain = tracked(doubled, angle), tracked(time, angle)
    assert track.dropped == 4
    assert track.notes[0] == "dropped 4 of 6000 rows: their time stamp did not increase"
    assert plain.dropped == 0
    assert rms(track.rate - plain.rate) < 0.5 * float(np.median(plain.u_rate))


def test_missing_rows_are_told_and_not_good_where_they_are_many() -> None:
    time, angle = logged(3)
    kept = np.ones(len(time), bool)
    kept[2000:2060] = False  # 0.6 s
    angle[4000:4002] = np.nan
    track = tracked(time[kept], angle[kept])
    assert not track.good[(track.time > 20.0) & (track.time < 20.58)].any()
    assert track.good[(track.time > 40.0) & (track.time < 40.02)].all()
    assert track.u_rate[np.argmin(abs(track.time - 20.3))] > 3.0 * np.median(track.u_rate)
    assert "left out 2 of 5940 rows: no number in them" in track.notes
    assert any(note.startswith("1 gaps longer than 0.05 s") for note in track.notes)


def test_the_grid_is_even_and_as_asked_for() -> None:
    track = tracked(*logged(4), interval=0.004)
    np.testing.assert_allclose(np.diff(track.time), 0.004)
    assert rms((track.rate - motion(track.time, 1))[track.good]) < 0.01 * rms(motion(track.time, 1))


def test_the_band_asked_for_is_kept_and_costs_noise() -> None:
    track, quiet = tracked(*logged(5), keep=20.0), tracked(*logged(5))
    assert track.kept == pytest.approx(20.0)
    assert np.median(track.u_acceleration) > 3.0 * np.median(quiet.u_acceleration)


def test_a_band_beyond_the_samples_is_refused() -> None:
    with pytest.raises(BadInput, match="found 60 Hz to keep, wanted a frequency up to 40 Hz"):
        tracked(*logged(5), keep=60.0)


def test_an_encoder_that_stands_has_no_rate_and_the_uncertainty_of_its_step() -> None:
    track = tracked(0.01 * np.arange(2000), np.full(2000, 1.0))
    np.testing.assert_allclose(track.rate, 0.0, atol=1e-9)
    assert 0.0 < np.median(track.u_angle) < STEP


def test_the_stated_noise_is_a_floor_for_the_uncertainty() -> None:
    time, angle = logged(6)
    coarse = encoder_track(time, angle, u_angle=20.0 * STEP)
    assert np.median(coarse.u_rate) > 3.0 * np.median(tracked(time, angle).u_rate)


@pytest.mark.parametrize(
    ("time", "angle", "told"),
    [
        (np.arange(100.0), np.zeros(99), "wanted one angle per time"),
        (np.arange(10.0), np.zeros(10), "found 10 samples, wanted 64 or more"),
        (np.zeros(1000), np.zeros(1000), "found 1 samples"),
    ],
)
def test_what_cannot_be_a_track_is_refused(time: Array, angle: Array, told: str) -> None:
    with pytest.raises(BadInput) as caught:
        encoder_track(time, angle)
    assert told in str(caught.value)


LINES = 500


def swung(time: Array, derivative: int = 0) -> Array:
    """There and back over more than a turn, rad."""
    turn = 2.0 * np.pi * np.array([0.2, 0.9])[:, None]
    sizes = np.array([4.0, 0.15])[:, None]
    return np.asarray((sizes * turn**derivative * np.sin(turn * time + derivative * np.pi / 2.0)).sum(axis=0))


def outputs(angle: Array, sense: int = 1) -> tuple[Array, Array, Array]:
    """Volts of A, B and index of a disk at this angle (rad): A leads B when the angle grows, if sense is +1."""
    place = sense * angle * LINES / (2.0 * np.pi)
    a, b = np.cos(2.0 * np.pi * place) > 0.0, np.sin(2.0 * np.pi * place) > 0.0
    turn = (angle / (2.0 * np.pi) + 0.5) % 1.0 - 0.5
    return 4.0 * a + 0.2, 4.0 * b + 0.2, 4.0 * (np.abs(turn * LINES) < 0.25) + 0.2


@pytest.mark.parametrize("sense", [1, -1])
def test_sampled_lines_give_angle_and_rate_there_and_back(sense: int) -> None:
    time = np.arange(0.0, 12.0, 1e-4)
    a, b, index = outputs(swung(time), sense)
    track = quadrature_track(time, a, b, index, lines=LINES, a_leads=1 if sense > 0 else -1, interval=0.005)
    quarter = 2.0 * np.pi / (4 * LINES)
    assert np.abs((track.angle - swung(track.time))[track.good]).max() < quarter
    assert rms((track.rate - swung(track.time, 1))[track.good]) < 0.01 * rms(swung(track.time, 1))
    assert 0.4 < rms(((track.rate - swung(track.time, 1)) / track.u_rate)[track.good]) < 1.3
    assert track.notes[0].endswith("index pulses: angle zero is the first")


def test_the_index_ties_the_angle_to_the_disk_wherever_the_record_begins() -> None:
    time = np.arange(0.0, 6.0, 1e-4)
    turning = 1.3 + 2.5 * time
    a, b, index = outputs(turning)
    track = quadrature_track(time, a, b, index, lines=LINES, interval=0.005)
    off = (track.angle - (1.3 + 2.5 * track.time)) / (2.0 * np.pi)
    np.testing.assert_allclose((off - np.round(off))[track.good] * 2.0 * np.pi, 0.0, atol=2.0 * np.pi / (8 * LINES))
    free = quadrature_track(time, a, b, lines=LINES, interval=0.005)
    assert free.notes[0] == "no index pulse: angle zero is the first edge"


def test_the_angle_at_every_sample_is_within_a_state_of_the_disk() -> None:
    time = np.arange(0.0, 6.0, 1e-4)
    angle = angle_of_lines(time, *outputs(swung(time)), lines=LINES)
    moving = (time > 0.01) & (time < 5.99)
    assert np.abs((angle - swung(time))[moving]).max() < 2.0 * np.pi / (4 * LINES)


def test_lines_lost_between_two_index_pulses_are_told() -> None:
    time = np.arange(0.0, 8.0, 1e-4)
    turning = 2.5 * time
    a, b, index = outputs(turning)
    a[30000:31000], b[30000:31000] = a[30000], b[30000]  # the cable was loose for 0.1 s: 20 lines
    track = quadrature_track(time, a, b, index, lines=LINES, interval=0.005)
    assert track.notes[1].startswith("from one index pulse to the next 1 of 2 are no whole turns, off by up to")


def test_a_platter_that_stops_and_goes_on_is_known_to_stand() -> None:
    time = np.arange(0.0, 9.0, 1e-4)
    speed = 2.5 * (np.tanh((3.0 - time) / 0.1) + np.tanh((time - 6.0) / 0.1) + 2.0) / 2.0
    turning = np.cumsum(speed) * 1e-4
    a, b, index = outputs(turning)
    track = quadrature_track(time, a, b, index, lines=LINES, interval=0.005)
    standing = (track.time > 3.4) & (track.time < 5.6)
    assert rms(track.rate[standing]) < 0.01
    assert np.abs(np.diff(track.angle[standing])).max() < 1e-4


def test_a_state_shorter_than_a_sample_is_followed_by_whole_lines_if_the_platter_turns_one_way() -> None:
    time = np.arange(0.0, 12.0, 1.7e-3)  # 3 samples to a line
    a, b, _ = outputs(-2.5 * time)
    track = quadrature_track(time, a, b, lines=LINES, interval=0.01)
    assert track.rate[track.good].mean() == pytest.approx(-2.5, rel=1e-3)
    assert "lines were counted by one edge of A" in " ".join(track.notes)
    a, b, _ = outputs(swung(time))
    with pytest.raises(BadInput, match="in both directions"):
        quadrature_track(time, a, b, lines=LINES)


@pytest.mark.parametrize(("sample", "lines"), [(7e-3, LINES), (1e-4, 512)])
def test_index_pulses_refuse_a_sampling_too_slow_or_a_wrong_number_of_lines(sample: float, lines: int) -> None:
    time = np.arange(0.0, 12.0, sample)
    a, b, _ = outputs(2.5 * time)
    index = np.where(np.mod(2.5 * time + 0.1, 2.0 * np.pi) < 0.2, 4.0, 0.0)
    with pytest.raises(BadInput, match="wanted whole turns"):
        quadrature_track(time, a, b, index, lines=lines)


def test_a_disk_that_stands_is_refused() -> None:
    time = np.arange(0.0, 6.0, 1e-3)
    with pytest.raises(BadInput, match="wanted a platter that turns"):
        quadrature_track(time, np.full(6000, 4.0), np.zeros(6000), lines=LINES)


# A real log: a stepper-driven rig, encoder of 0.088°, 100 Hz, gyro mounted upside down (yaw, 120 s).


@pytest.fixture(scope="module")
def yaw() -> tuple[AngleTrack, Array]:
    path = DATA / "uiuc-mpu6050-encoder" / "yaw_medium_120s.csv"
    if not path.exists():
        pytest.skip(f"no {path}: set RIG_REAL_DATA to the folder with the real measurements")
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    track = encoder_track(
        table[:, 0], np.radians(table[:, 1]), interval=0.01, u_angle=np.radians(0.088) / 12**0.5, u_time=3e-4
    )
    first = np.append(True, np.diff(np.maximum.accumulate(table[:, 0])) > 0.0)
    return track, np.interp(track.time, table[first, 0], table[first, 4])


def test_the_real_gyro_turns_the_other_way_and_12_ms_late(yaw: tuple[AngleTrack, Array]) -> None:
    track, gyro = yaw
    assert track.dropped == 3
    sections = butter(4, 5.0, fs=100.0, output="sos")
    wanted = sosfiltfilt(sections, gyro)
    kept = track.good & (track.time > 1.0) & (track.time < track.time[-1] - 1.0)

    def error(delay: float) -> float:
        rate = sosfiltfilt(sections, np.interp(track.time - delay, track.time, np.degrees(track.rate)))
        assert np.corrcoef(rate, wanted)[0, 1] < -0.9
        columns = np.stack([-rate, np.ones_like(rate)], axis=1)[kept]
        return rms(wanted[kept] - columns @ np.linalg.lstsq(columns, wanted[kept], rcond=None)[0])

    naive = rms(wanted[kept] + sosfiltfilt(sections, np.degrees(track.rate))[kept])
    assert 11.0 < naive < 12.5
    best = minimize_scalar(error, bounds=(0.0, 0.03), method="bounded")
    assert best.x == pytest.approx(12.0e-3, abs=0.5e-3)
    assert best.fun < naive / 3.0
    assert best.fun < 3.0
