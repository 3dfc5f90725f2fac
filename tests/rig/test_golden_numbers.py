"""Numbers that the physics of this bench is known to give, each through the program's own code where it has any."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from rig.calibrate import paper_method
from rig.parts.reading.vibration import filter_response
from rig.signals import tone
from rig.signals.rotation import Edges, Turns

RATE = 3125.0  # Hz
DEGREE = math.pi / 180.0
G = 9.80665  # m/s²
SPEEDS = (45.0, 100.0 / 3.0)


def edges_at(rpm: float, seconds: float = 60.0) -> NDArray[np.float64]:
    """Line edges of a constant speed (off by a hair, so that all phases occur) where the samples place them."""
    interval = 60.0 / rpm / 1000.0 * (1.0 + 1e-5 * math.sqrt(2.0))
    return (np.ceil((0.1234e-3 + interval * np.arange(int(seconds / interval))) * RATE) - 0.5) / RATE


def cosine(amplitude: float, cycles: int = 200) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Instants (s) and a cosine of 67 Hz over whole cycles, many phases."""
    instants = np.arange(50_000) * (cycles / 67.0 / 50_000)
    return instants, amplitude * np.cos(2.0 * math.pi * 67.0 * instants)


@pytest.mark.parametrize(
    ("rpm", "values", "errors", "rms"),
    [(45.0, (225.0, 281.25), (-0.1667, 0.0417), 0.0776), (100.0 / 3.0, (187.5, 225.0), (-0.0625, 0.125), 0.0908)],
)
def test_a_rate_from_one_line_takes_two_values_with_the_known_scatter(
    rpm: float, values: tuple[float, float], errors: tuple[float, float], rms: float
) -> None:
    rates = paper_method.reciprocal_rates(edges_at(rpm)) / DEGREE
    assert np.unique(np.round(rates, 6)) == pytest.approx(values)
    assert np.unique(np.round(rates, 6)) / (6.0 * rpm) - 1.0 == pytest.approx(errors, abs=5e-5)
    assert rates.std() / (6.0 * rpm) == pytest.approx(rms, abs=1e-4)


@pytest.mark.parametrize(("rpm", "bias"), [(45.0, 0.00694), (100.0 / 3.0, 0.00781)])
@pytest.mark.parametrize("lines", [1, 20])
def test_the_mean_of_line_rates_is_biased_and_averaging_them_does_not_help(rpm: float, bias: float, lines: int) -> None:
    rates = paper_method.moving_average(paper_method.reciprocal_rates(edges_at(rpm)), lines)
    assert rates.mean() / (6.0 * rpm * DEGREE) - 1.0 == pytest.approx(bias, abs=5e-5)


@pytest.mark.parametrize("rpm", SPEEDS)
def test_whole_angle_over_whole_time_is_right_within_ten_in_a_million(rpm: float) -> None:
    found = Turns(edges_at(rpm)[::1000], 1, 0.0).mean_rate
    assert abs(found / (6.0 * rpm * DEGREE) * (1.0 + 1e-5 * math.sqrt(2.0)) - 1.0) < 1e-5


@pytest.mark.parametrize(("lines", "slope"), [(1, 0.75), (20, 0.994)])
def test_least_squares_over_two_speeds_is_attenuated(lines: int, slope: float) -> None:
    rates, truth = [], []
    for rpm in SPEEDS:
        edges = Edges(edges_at(rpm), 1, np.empty(0), np.empty(0, np.int64), (), 0, 1.0 / RATE)
        rate = paper_method.held(edges, lines).rates  # one pair per line, both speeds for equally long
        rates.append(rate)
        truth.append(np.full(len(rate), 6.0 * rpm * DEGREE))
    found, _ = paper_method.least_squares_sensitivity(np.concatenate(truth), np.concatenate(rates))
    assert found == pytest.approx(slope, abs=0.003)


def test_a_clock_error_of_fifty_in_a_million_takes_a_tenth_of_the_amplitude_unless_the_frequency_is_free() -> None:
    instants = np.arange(31_250) / RATE
    values = np.cos(2.0 * math.pi * 500.0 * (1.0 + 50e-6) * instants + 0.3)
    assert tone.fit_three(instants, values, 500.0).magnitude == pytest.approx(0.900, abs=5e-4)
    free = tone.fit_four(instants, values, 500.0)
    assert free.magnitude == pytest.approx(1.0, abs=1e-9)
    assert free.frequency / 500.0 - 1.0 == pytest.approx(50e-6, abs=1e-10)


def test_a_quadratic_term_of_half_a_percent_rectifies_and_doubles() -> None:
    instants, a = cosine(1.0)  # in g
    found = tone.fit_three(instants, a + 0.005 / 2.0 * a**2, 67.0, harmonics=3)  # 0.5 % of 2 g at 2 g
    assert found.offset == pytest.approx(1.25e-3, abs=1e-6)
    assert abs(found.amplitudes[1]) == pytest.approx(0.00125, abs=1e-6)
    assert found.magnitude == pytest.approx(1.0, abs=1e-9)


def test_a_cubic_term_of_half_a_percent_raises_the_gain_and_triples() -> None:
    instants, a = cosine(1.0)
    found = tone.fit_three(instants, a + 0.005 / 4.0 * a**3, 67.0, harmonics=3)
    assert found.magnitude - 1.0 == pytest.approx(0.00094, abs=5e-6)
    assert abs(found.amplitudes[2]) == pytest.approx(0.00031, abs=5e-6)


def test_a_dead_zone_of_a_twentieth_takes_six_percent_of_the_gain() -> None:
    instants, a = cosine(1.0)
    dead = np.sign(a) * np.maximum(np.abs(a) - 0.05, 0.0)
    assert tone.fit_three(instants, dead, 67.0).magnitude == pytest.approx(0.936, abs=5e-4)


def test_four_butterworth_poles_at_half_their_corner() -> None:
    settings = {"mode": "low-pass", "response": "butterworth", "cutoff": 1000.0, "gain_db": 0.0}
    (found,) = filter_response(settings, np.array([500.0]))
    assert abs(found) - 1.0 == pytest.approx(-0.00195, abs=5e-6)
    assert np.angle(found) / DEGREE == pytest.approx(-78.0, abs=0.05)


def test_three_bessel_poles_at_a_tenth_of_their_corner() -> None:
    b, a = signal.bessel(3, 2.0 * math.pi * 5000.0, analog=True, norm="mag")
    (found,) = signal.freqs(b, a, [2.0 * math.pi * 500.0])[1]
    assert abs(found) - 1.0 == pytest.approx(-0.0031, abs=5e-5)
    assert np.angle(found) / DEGREE == pytest.approx(-10.06, abs=0.005)


def test_one_pole_at_half_its_corner() -> None:
    found = 1.0 / (1.0 + 0.5j)
    assert abs(found) - 1.0 == pytest.approx(-0.1056, abs=5e-5)
    assert np.angle(found) / DEGREE == pytest.approx(-26.57, abs=0.005)


def test_the_platter_pulls_a_fifth_of_g_at_a_tenth_of_a_metre() -> None:
    edges = Turns(np.arange(61) * 60.0 / 45.0, 1, 0.0)
    assert edges.mean_rate**2 * 0.1 == pytest.approx(2.2207, abs=5e-5)


@pytest.mark.parametrize(("frequency", "stroke", "velocity"), [(20.0, 621e-6, 78.0e-3), (500.0, 0.994e-6, 3.12e-3)])
def test_one_g_has_its_stroke_and_velocity(frequency: float, stroke: float, velocity: float) -> None:
    omega = 2.0 * math.pi * frequency
    instants = np.arange(200_000) * (20.0 / frequency / 200_000)
    found = abs(paper_method.integrated_amplitude(instants, G * np.cos(omega * instants), frequency))
    assert found == pytest.approx(velocity, rel=1e-3)
    assert found / omega == pytest.approx(stroke, rel=1e-3)
