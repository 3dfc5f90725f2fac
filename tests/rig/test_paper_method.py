"""The paper's estimators: their printed formulas, and the bias that they are known to have."""

from __future__ import annotations

import math

import fast_bench
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.calibrate import paper_method
from rig.errors import BadInput
from rig.parts.reading.vibration import chain_of, sine_points
from rig.sensor import Sensor
from rig.signals.rotation import Edges, turns

RATE = 3125.0  # Hz
RPM = 2.0 * math.pi / 60.0
SPEEDS = pytest.mark.parametrize(("rpm", "bias"), [(45.0, 0.00694), (100.0 / 3.0, 0.00781)])


def sampled_edges(true: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges as the converter's samples place them: in the middle between two samples."""
    return (np.ceil(true * RATE) - 0.5) / RATE


def edges_at(rpm: float, seconds: float = 60.0) -> NDArray[np.float64]:
    """Edges of a constant speed that is off by a hair, so that they drift through all phases of the sampling."""
    interval = 60.0 / rpm / 1000.0 * (1.0 + 1e-5 * math.sqrt(2.0))
    return sampled_edges(0.1234e-3 + interval * np.arange(int(seconds / interval)))


@SPEEDS
def test_the_mean_of_reciprocal_intervals_is_too_high_by_the_published_bias(rpm: float, bias: float) -> None:
    rates = paper_method.reciprocal_rates(edges_at(rpm))
    assert rates.mean() / (rpm * RPM) - 1.0 == pytest.approx(bias, abs=5e-5)


@SPEEDS
def test_a_moving_average_of_the_rates_leaves_the_bias_as_it_is(rpm: float, bias: float) -> None:
    rates = paper_method.moving_average(paper_method.reciprocal_rates(edges_at(rpm)), 20)
    assert rates.mean() / (rpm * RPM) - 1.0 == pytest.approx(bias, abs=5e-5)
    assert rates.std() < 0.02 * rates.mean()


def attenuation(lines: int, *, by_sample: bool) -> float:
    """Slope over two speeds of equal duration, relative to the truth, with one pair per line or one per sample."""
    rates, truth = [], []
    for rpm in (45.0, 100.0 / 3.0):
        edges = Edges(edges_at(rpm), 1, np.empty(0), np.empty(0, np.int64), (), 0, 1.0 / RATE)
        reference = paper_method.held(edges, lines)
        if by_sample:
            inside, rate = reference.at(np.arange(round(55.0 * RATE)) / RATE + 1.0)
            assert inside.all()
        rates.append(rate if by_sample else reference.rates)
        truth.append(np.full(len(rates[-1]), rpm * RPM))
    return paper_method.least_squares_sensitivity(np.concatenate(truth), np.concatenate(rates))[0]


@pytest.mark.parametrize(("lines", "slope"), [(1, 0.75), (20, 0.994)])
def test_least_squares_over_two_speeds_is_attenuated_by_the_reference_scatter(lines: int, slope: float) -> None:
    assert attenuation(lines, by_sample=False) == pytest.approx(slope, abs=0.003)


def test_a_reference_held_from_sample_to_sample_is_attenuated_a_little_less() -> None:
    assert attenuation(1, by_sample=True) == pytest.approx(0.764, abs=0.003)
    assert attenuation(20, by_sample=True) == pytest.approx(0.994, abs=0.003)


@pytest.mark.parametrize(("lines", "bias"), [(1, -0.0016), (20, -0.0069)])
def test_the_mean_ratio_of_a_gyro_without_offset_is_too_low(lines: int, bias: float) -> None:
    edges = Edges(edges_at(45.0), 1, np.empty(0), np.empty(0, np.int64), (), 0, 1.0 / RATE)
    _, rate = paper_method.held(edges, lines).at(np.arange(round(55.0 * RATE)) / RATE + 1.0)
    found = paper_method.mean_sensitivity(np.full(len(rate), 0.2 * 45.0 * RPM), rate)
    assert found / 0.2 - 1.0 == pytest.approx(bias, abs=2e-4)


def test_whole_revolutions_are_right_within_ten_in_a_million_with_wow_and_eccentricity() -> None:
    speed = 45.0 * RPM
    fine = np.arange(0.0, 42.0, 1e-4)
    wow = 0.002 / 1.7 * np.sin(1.7 * speed * fine)  # 0.2 % of the speed, not once per turn
    once = 0.001 * np.sin(speed * fine)  # the disk's own once-per-turn error, in rad
    times = np.interp(np.arange(30 * 1000) * 2.0 * math.pi / 1000.0, speed * fine + wow + once, fine)
    index = np.arange(100, len(times) - 1, 1000)
    mark = times[index] + 1e-4
    edges = Edges(sampled_edges(times), 1, mark, index, (), 0, 1.0 / RATE)
    found = turns(edges)
    ends = np.interp(times[[index[0] + 1, index[-1] + 1]], fine, speed * fine + wow)
    true = float(np.diff(ends)[0]) / float(times[index[-1] + 1] - times[index[0] + 1])
    assert found.mean_rate == pytest.approx(true, rel=1e-5)
    rates = paper_method.reciprocal_rates(edges.times)
    assert rates.mean() / true - 1.0 > 5e-3


def test_the_ratiometric_voltage_is_the_output_about_half_the_supply() -> None:
    assert paper_method.v_r(np.array([2.5, 3.0]), 5.0) == pytest.approx([0.0, 0.5])
    assert paper_method.v_r(np.array([2.6 * 1.01]), 5.05) == pytest.approx([0.1])


def test_an_offset_moves_the_mean_ratio_and_not_the_line() -> None:
    rate = np.repeat([200.0, 270.0], 50)
    v = 3.6e-3 * rate + 0.010
    assert paper_method.mean_sensitivity(v, rate) / 3.6e-3 - 1.0 == pytest.approx(0.012, abs=2e-4)
    slope, intercept = paper_method.least_squares_sensitivity(v, rate)
    assert (slope, intercept) == (pytest.approx(3.6e-3, rel=1e-12), pytest.approx(0.010, rel=1e-9))


def test_equation_eight_gives_back_the_line_that_was_put_in() -> None:
    frequency, volts = np.array([20.0, 67.0, 250.0, 500.0]), np.array([0.1, 0.2, 0.3, 0.35])
    velocity = (15.0 * volts + 0.02) / (2.0 * math.pi * frequency)
    assert paper_method.least_squares(volts, frequency, velocity) == (pytest.approx(15.0), pytest.approx(0.02))


@pytest.mark.parametrize(("frequency", "loss"), [(67.0, 0.0015), (500.0, 0.0857)])
def test_integrating_the_record_loses_what_the_trapezoidal_rule_loses(frequency: float, loss: float) -> None:
    instants = np.arange(9375) / RATE
    volts = 2.5 + 0.3 * np.cos(2.0 * math.pi * frequency * instants + 0.4)
    found = paper_method.integrated_amplitude(instants, volts, frequency)
    x = math.pi * frequency / RATE
    assert abs(found) * 2.0 * math.pi * frequency / 0.3 == pytest.approx(x / math.tan(x), rel=2e-5)
    assert 1.0 - x / math.tan(x) == pytest.approx(loss, abs=5e-5)


def test_rates_that_do_not_exist_are_refused() -> None:
    with pytest.raises(BadInput, match="wanted at least two"):
        paper_method.reciprocal_rates(np.array([1.0]))
    with pytest.raises(BadInput, match="wanted at least the 20"):
        paper_method.moving_average(np.ones(5), 20)
    with pytest.raises(BadInput, match="rate of zero"):
        paper_method.mean_sensitivity(np.ones(3), np.array([1.0, 0.0, 1.0]))
    with pytest.raises(BadInput, match="without any spread"):
        paper_method.least_squares_sensitivity(np.ones(3), np.full(3, 4.7))


@pytest.mark.parametrize("inverted", [False, True])
def test_a_turntable_run_shows_the_bias_of_every_estimate(inverted: bool) -> None:
    world = fast_bench.world(5)
    document = {"procedure": "turntable", "speed": "45 rpm", "axis": "roll", "revolutions": 6, "rest": "1 s"}
    records = fast_bench.measure({**document, "inverted": inverted}, world)
    rows = paper_method.gyro_rows(records, Sensor.of(records.header))
    assert {row.row for row in rows} == {"Roll", "Backup Gyros"}
    assert [row.estimate for row in rows if row.channel == "gyro_roll"] == [
        "eq. 13, mean, raw intervals",
        "eq. 12, least squares, raw",
        "eq. 13, mean, moving average of 20 lines",
        "eq. 12, least squares, moving average of 20 lines",
    ]
    for row in rows:
        ratio = row.value / world.truth["sensitivity"][row.channel]
        assert row.ours == f"{row.channel}.sensitivity"
        raw_line = row.estimate == "eq. 12, least squares, raw"  # spin-up and coast-down spread the rates
        assert 0.9 < ratio < 0.97 if raw_line else ratio == pytest.approx(1.0, abs=0.03), row.estimate


def test_a_sweep_shows_the_output_filter_in_the_line_over_all_frequencies() -> None:
    world = fast_bench.world(5)
    records = fast_bench.measure({"procedure": "frequency_sweep", "axis": "x", "points": 8, "static": "1 s"}, world)
    points, sensor = sine_points(records, chain_of(records)), Sensor.of(records.header)
    rows = paper_method.accelerometer_rows(points, sensor, [records])
    assert {(row.row, row.channel) for row in rows} == {
        ("2g Unit", "unit_a_x"), ("2g Unit", "unit_b_x"), ("10g Unit", "unit_c_x"),
    }  # fmt: skip
    ratios = {row.estimate: row.value / world.truth["sensitivity"][row.channel] for row in rows if "a_x" in row.channel}
    assert ratios["eq. 8, least squares, all frequencies"] < 0.97
    assert ratios["eq. 8, least squares, up to 100 Hz"] == pytest.approx(1.0, abs=0.05)
    assert next(value for key, value in ratios.items() if "integrated" in key) == pytest.approx(0.985, abs=0.02)
