"""The grids and the motion: against harmonics and filtered sines in closed form, and a turning arm by hand."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.fft import next_fast_len

from rig.motion import MARGIN, ORDERS, PHASES, Array, Complexes, Motion, Periods, Response, Stretches, rigid

HARMONICS = np.array([[1.5, 2.0 - 1.0j, 0.3j, 0.1, -0.2, 0.05j], [-1.0, 3j, 0, 0, 0.5, 0]], np.complex128)
TAU = 0.05  # s
INTERVAL = 0.01  # s


def unchanged(frequency: Array) -> Complexes:
    return np.ones(frequency.shape, np.complex128)


def one_pole(frequency: Array) -> Complexes:
    return np.asarray(1.0 / (1.0 + 2j * math.pi * TAU * frequency))


def delayed(frequency: Array) -> Complexes:
    return np.asarray(np.exp(-2j * math.pi * TAU * frequency))


def turntable(rate: float, turning: float) -> Motion:
    """One instant of a turn about z, in rad/s and rad/s²."""
    nothing, one = np.zeros((3, 1)), np.zeros(1)
    about = np.array([[0.0], [0.0], [1.0]])
    return Motion(
        Stretches(INTERVAL, ((0, 1),)), "turntable", nothing, rate * about, turning * about, about, 9.81, one, one, one
    )


def test_the_harmonics_of_a_known_waveform_are_found() -> None:
    phase = 2.0 * math.pi * np.arange(PHASES) / PHASES
    wave = (0.5 + 2.0 * np.cos(phase + 0.3) + 0.1 * np.sin(5.0 * phase))[None]
    found = Periods(np.array([50.0])).observed(wave, unchanged)
    assert found == pytest.approx(np.array([[0.5, 2.0 * np.exp(0.3j), 0, 0, 0, -0.1j]]))


def test_a_waveform_gives_its_harmonics_back() -> None:
    grid = Periods(np.array([50.0, 200.0]))
    assert grid.observed(grid.waveform(HARMONICS), unchanged) == pytest.approx(HARMONICS)


def test_a_filter_acts_on_each_harmonic_at_its_own_frequency() -> None:
    grid = Periods(np.array([50.0, 200.0]))
    orders = np.arange(ORDERS)
    response = 1.0 / (1.0 + 2j * math.pi * TAU * np.array([[50.0], [200.0]]) * orders)
    assert grid.observed(grid.waveform(HARMONICS), one_pole) == pytest.approx(HARMONICS * response)


def test_a_slow_sine_comes_out_of_one_pole_smaller_and_later_as_it_should_away_from_the_ends() -> None:
    time = np.arange(1500) * INTERVAL
    frequency = 0.75
    found = Stretches(INTERVAL, ((0, 1500),)).observed(np.sin(2.0 * math.pi * frequency * time)[None], one_pole)[0]
    turn = 2.0 * math.pi * frequency * TAU
    expected = np.sin(2.0 * math.pi * frequency * time - math.atan(turn)) / math.hypot(1.0, turn)
    inner = slice(100, -100)  # ends: 20 time constants
    assert found[inner] == pytest.approx(expected[inner], abs=1e-4)


@pytest.mark.parametrize("response", [one_pole, delayed])
def test_a_ramp_is_late_by_exactly_the_delay_at_low_frequencies(response: Response) -> None:
    time = np.arange(400) * INTERVAL
    found = Stretches(INTERVAL, ((0, 400),)).observed(np.asarray(2.0 + 3.0 * time), response)
    assert found == pytest.approx(2.0 + 3.0 * (time - TAU), abs=1e-6)


def test_a_constant_stays_and_records_know_nothing_of_each_other() -> None:
    signal = np.concatenate([np.full(300, 2.0), np.full(1, 7.0), np.full(200, -5.0)])
    grid = Stretches(INTERVAL, ((0, 300), (300, 301), (301, 501)))
    assert grid.observed(signal, one_pole) == pytest.approx(signal)


def test_a_filter_does_not_carry_the_end_of_a_record_to_its_beginning() -> None:
    bump = np.zeros(400)
    bump[-30:-10] = 1.0
    found = Stretches(INTERVAL, ((0, 400),)).observed(bump, one_pole)
    assert np.abs(found[:300]).max() < 1e-4


def test_the_rise_of_a_sine_is_a_cosine() -> None:
    grid = Periods(np.array([50.0]))
    wave = grid.waveform(np.array([[0, -1j, 0, 0, 0, 0]], np.complex128))
    rise = grid.observed(grid.rise(wave), unchanged)
    assert rise[0, 1] == pytest.approx(2.0 * math.pi * 50.0, rel=2e-4)


def test_the_rise_of_a_ramp_is_its_slope_in_every_record() -> None:
    grid = Stretches(INTERVAL, ((0, 50), (50, 120)))
    signal = np.concatenate([3.0 * INTERVAL * np.arange(50), 7.0 - 2.0 * INTERVAL * np.arange(70)])
    assert grid.rise(signal) == pytest.approx(np.repeat([3.0, -2.0], [50, 70]))


@pytest.mark.parametrize(
    ("rate", "turning", "felt"),
    [
        (math.pi * 1.5, 0.0, (-2.2207, 0.0, 0.0)),  # 45 rpm: ω²r inward
        (-math.pi * 1.5, 0.0, (-2.2207, 0.0, 0.0)),  # the same the other way round
        (0.0, 2.0, (0.0, 0.2, 0.0)),  # αr along the tangent
        (2.0, -3.0, (-0.4, -0.3, 0.0)),
    ],
)
def test_a_point_ten_centimetres_out_feels_inward_and_along_the_tangent(
    rate: float, turning: float, felt: tuple[float, float, float]
) -> None:
    found = rigid(turntable(rate, turning), np.array([0.1, 0.0, 0.02]))
    assert found[:, 0] == pytest.approx(felt, abs=5e-5)


def test_the_source_pushes_against_the_acceleration_and_the_drive_is_what_was_given() -> None:
    grid = Periods(np.array([50.0, 200.0]))
    nothing, one = np.zeros((3, 2, PHASES)), np.zeros(2)
    upright = np.zeros((3, 2))
    along = np.array([[0, 2.0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]], np.complex128)
    motion = Motion(
        grid,
        "shaker",
        nothing,
        nothing,
        nothing,
        upright,
        9.81,
        one,
        one,
        one,
        along=along,
        source=np.array([0.5, 0.0]),
    )
    phase = 2.0 * math.pi * np.arange(PHASES) / PHASES
    assert motion.drive_waveform() == pytest.approx(np.array([-0.5 * np.cos(phase), np.zeros(PHASES)]))
    assert motion.driven_by(np.full((2, ORDERS), 2j)) == pytest.approx(np.array([-4.0 * np.sin(phase), 0.0 * phase]))


def test_only_sines_drive() -> None:
    with pytest.raises(TypeError, match="not driven by sines"):
        turntable(1.0, 0.0).drive_waveform()


@given(
    lengths=st.lists(st.integers(1, 90), min_size=1, max_size=5),
    busy=st.lists(st.booleans(), min_size=3, max_size=3),
    seed=st.integers(0, 2**16),
)
def test_records_filtered_together_come_out_as_each_channel_of_each_record_alone(
    lengths: list[int], busy: list[bool], seed: int
) -> None:
    ends = np.cumsum([0, *lengths])
    bounds = tuple((int(b), int(e)) for b, e in itertools.pairwise(ends))
    signal = np.random.default_rng(seed).normal(size=(3, int(ends[-1]))) * np.array(busy)[:, None] + 2.0
    poles = np.array([3.0, 10.0, 40.0])[:, None]
    found = Stretches(INTERVAL, bounds).observed(signal, lambda f: np.asarray(1.0 / (1.0 + 1j * f / poles)))
    for channel, pole in enumerate(poles[:, 0]):
        for begin, end in bounds:
            alone = one_record(signal[channel, begin:end], float(pole))
            assert found[channel, begin:end] == pytest.approx(alone, rel=1e-12, abs=1e-12)


def one_record(signal: Array, pole: float) -> Array:
    """One channel of one record, step by step: the line through both ends, then what is left, by a plain transform."""
    count, slope = len(signal), (signal[-1] - signal[0]) / max(len(signal) - 1, 1)
    line = signal[0] + slope * np.arange(count)
    whole = next_fast_len(count + MARGIN, real=True)
    passed = 1.0 / (1.0 + 1j * np.fft.rfftfreq(whole, INTERVAL) / pole)
    turned = np.fft.irfft(np.fft.rfft(signal - line, whole) * passed, whole)[:count]
    late = (1.0 / (1.0 + 1e-3j / pole)).imag / (2.0 * math.pi * 1e-3)
    return np.asarray(turned + line + slope / INTERVAL * late)


def test_what_leaks_away_is_remembered_from_record_to_record_of_a_line_of_time() -> None:
    """A step that a first-order high-pass forgets as e^(−t/τ), seen in two records with a second between them."""
    corner = 0.2
    settling = 1.0 / (2.0 * math.pi * corner)
    time = np.concatenate([np.arange(300), np.arange(400, 700)]) * INTERVAL
    stepped = 3.0 + 2.0 * (time >= 1.0)
    grid = Stretches(INTERVAL, ((0, 300), (300, 600)), ((0, 0), (0, 400)))
    expected = np.where(time >= 1.0, 2.0 * np.exp(-(time - 1.0) / settling), 0.0)
    found = grid.leaked(np.array([stepped, -stepped]), corner)
    assert found == pytest.approx(np.array([expected, -expected]), abs=2.0 * INTERVAL / settling)
    apart = Stretches(INTERVAL, ((0, 300), (300, 600))).leaked(stepped[None], corner)[0]
    assert np.all(apart[300:] == pytest.approx(0.0, abs=1e-12))  # another mounting: it has stood there for long


def test_a_sine_behind_a_high_pass_is_the_same_on_both_grids() -> None:
    f, corner = 0.5, 0.2
    time = np.arange(4000) * INTERVAL
    found = Stretches(INTERVAL, ((0, 4000),)).leaked(np.sin(2.0 * math.pi * f * time)[None], corner)[0]
    whole = time > time[-1] - 10.0 / f
    seen = 2.0 * np.mean(found[whole] * np.exp(-2j * math.pi * f * time[whole]))
    one = Periods(np.array([f])).leaked(np.array([[0.0, -1j, 0.0, 0.0, 0.0, 0.0]]), corner)[0, 1]
    assert seen == pytest.approx(one, abs=2e-3)
