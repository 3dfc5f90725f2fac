"""Straight lines and polynomials against published fits, certified data, and many simulated calibrations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.signals.line import fit_line, fit_polynomial, gls, odd_even

Floats = NDArray[np.float64]


def numbers(text: str) -> Floats:
    """A table of numbers as it is printed."""
    return np.array(text.split(), float)


# Pearson (1901) with the weights of York (1966)
PEARSON_X = np.array([0.0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
PEARSON_Y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
PEARSON_U_X = 1 / np.sqrt([1000, 1000, 500, 800, 200, 80, 60, 20, 1.8, 1])
PEARSON_U_Y = 1 / np.sqrt([1, 1.8, 4, 8, 20, 20, 70, 70, 100, 500])

# NIST StRD Norris, (y, x)
NORRIS = numbers(
    """
    0.1 0.2 338.8 337.4 118.1 118.2 888.0 884.6 9.2 10.1 228.1 226.5 668.5 666.3 998.5 996.3 449.1 448.6 778.9 777.0
    559.2 558.2 0.3 0.4 0.1 0.6 778.1 775.5 668.8 666.9 339.3 338.0 448.9 447.5 10.8 11.6 557.7 556.0 228.3 228.1
    998.0 995.8 888.8 887.6 119.6 120.2 0.3 0.3 0.6 0.3 557.6 556.8 339.3 339.1 888.0 887.2 998.5 999.0 778.9 779.0
    10.2 11.1 117.6 118.3 228.9 229.2 668.4 669.1 449.2 448.9 0.2 0.5
    """
).reshape(-1, 2)

# NIST StRD Pontius: deflection of a load cell, 20 loads twice
PONTIUS_X = np.tile(150_000.0 * np.arange(1, 21), 2)
PONTIUS_Y = numbers(
    """
    .11019 .21956 .32949 .43899 .54803 .65694 .76562 .87487 .98292 1.09146 1.20001 1.30822 1.41599 1.52399 1.63194
    1.73947 1.84646 1.95392 2.06128 2.16844 .11052 .22018 .32939 .43886 .54798 .65739 .76596 .87474 .98300 1.09150
    1.20004 1.30818 1.41613 1.52408 1.63159 1.73965 1.84696 1.95445 2.06177 2.16829
    """
)

# NIST StRD Longley: y, then six nearly collinear columns
LONGLEY = numbers(
    """
    60323 83.0 234289 2356 1590 107608 1947   61122 88.5 259426 2325 1456 108632 1948
    60171 88.2 258054 3682 1616 109773 1949   61187 89.5 284599 3351 1650 110929 1950
    63221 96.2 328975 2099 3099 112075 1951   63639 98.1 346999 1932 3594 113270 1952
    64989 99.0 365385 1870 3547 115094 1953   63761 100.0 363112 3578 3350 116219 1954
    66019 101.2 397469 2904 3048 117388 1955  67857 104.6 419180 2822 2857 118734 1956
    68169 108.4 442769 2936 2798 120445 1957  66513 110.8 444546 4681 2637 121950 1958
    68655 112.6 482704 3813 2552 123366 1959  69564 114.2 502601 3931 2514 125368 1960
    69331 115.7 518173 4806 2572 127852 1961  70551 116.9 554894 4007 2827 130081 1962
    """
).reshape(16, 7)


def test_pearsons_data_with_yorks_weights_give_the_published_digits() -> None:
    line = fit_line(PEARSON_X, PEARSON_Y, PEARSON_U_X, PEARSON_U_Y)
    assert f"{line.slope:.9f}" == "-0.480533407"
    assert f"{line.intercept:.8f}" == "5.47991022"
    assert f"{line.u_slope:.10f}" == "0.0579850090"
    assert f"{line.u_intercept:.9f}" == "0.294970735"
    assert f"{line.chi2 / line.dof:.9f}" == "1.483294149"


def test_the_polynomial_of_first_order_is_the_same_line() -> None:
    line = fit_line(PEARSON_X, PEARSON_Y, PEARSON_U_X, PEARSON_U_Y)
    same = fit_polynomial(PEARSON_X, PEARSON_Y, 1, PEARSON_U_X, PEARSON_U_Y)
    assert same.coefficients == pytest.approx([line.intercept, line.slope], rel=1e-9)
    assert same.chi2 == pytest.approx(line.chi2, rel=1e-9)
    assert same.covariance == pytest.approx(line.covariance[::-1, ::-1], rel=1e-6)
    full = fit_polynomial(PEARSON_X, PEARSON_Y, 1, PEARSON_U_X, covariance=np.diag(PEARSON_U_Y**2))
    assert full.coefficients == pytest.approx(same.coefficients, rel=1e-9)


def test_turning_the_axes_round_gives_the_inverse_line() -> None:
    line = fit_line(PEARSON_X, PEARSON_Y, PEARSON_U_X, PEARSON_U_Y)
    turned = fit_line(PEARSON_Y, PEARSON_X, PEARSON_U_Y, PEARSON_U_X)
    assert turned.slope == pytest.approx(1 / line.slope, rel=1e-9)
    assert turned.intercept == pytest.approx(-line.intercept / line.slope, rel=1e-9)


def test_norris_has_its_certified_values() -> None:
    line = fit_line(NORRIS[:, 1], NORRIS[:, 0], u_y=1.0).scaled()
    assert line.slope == pytest.approx(1.00211681802045, rel=2e-14)
    assert line.intercept == pytest.approx(-0.262323073774029, rel=1e-12)
    assert line.u_slope == pytest.approx(0.429796848199937e-03, rel=1e-12)
    assert line.u_intercept == pytest.approx(0.232818234301152, rel=1e-12)
    assert line.chi2 == pytest.approx(26.6173985294224, rel=1e-12)


def test_pontius_has_its_certified_values() -> None:
    curve = fit_polynomial(PONTIUS_X, PONTIUS_Y, 2, u_y=1.0).scaled()
    assert curve.coefficients == pytest.approx(
        [0.673565789473684e-03, 0.732059160401003e-06, -0.316081871345029e-14], rel=1e-11
    )
    assert np.sqrt(np.diag(curve.covariance)) == pytest.approx(
        [0.107938612033077e-03, 0.157817399981659e-09, 0.486652849992036e-16], rel=1e-11, abs=0
    )


def test_longley_has_its_certified_values() -> None:
    fit = gls(np.column_stack([np.ones(16), LONGLEY[:, 1:]]), LONGLEY[:, 0], np.ones(16))
    wanted = [-3482258.63459582, 15.0618722713733, -0.0358191792925910, -2.02022980381683]
    wanted += [-1.03322686717359, -0.0511041056535807, 1829.15146461355]
    u = [890420.383607373, 84.9149257747669, 0.0334910077722432, 0.488399681651699]
    u += [0.214274163161675, 0.226073200069370, 455.478499142212]
    assert fit.parameters == pytest.approx(wanted, rel=1e-10)
    assert fit.u * math.sqrt(fit.chi2 / fit.dof) == pytest.approx(u, rel=1e-10)


def calibrations(u_x: float, u_y: float, r: float = 0.0, count: int = 600) -> Floats:
    """(error of slope, of intercept) ÷ stated sigma, and chi2/dof, of many simulated calibrations; shape (count, 3)."""
    x, slope, intercept = np.linspace(-10, 10, 12), 0.36, 1.65
    factor = np.linalg.cholesky([[u_x**2 + 1e-300, r * u_x * u_y], [r * u_x * u_y, u_y**2]])
    rows = []
    for seed in range(count):
        e_x, e_y = factor @ np.random.default_rng(seed).standard_normal((2, x.size))
        line = fit_line(x + e_x, intercept + slope * x + e_y, u_x, u_y, r)
        errors = ((line.slope - slope) / line.u_slope, (line.intercept - intercept) / line.u_intercept)
        rows.append([*errors, line.chi2 / line.dof])
    return np.array(rows)


@pytest.mark.parametrize(("u_x", "u_y", "r"), [(0.0, 0.1, 0.0), (0.5, 0.1, 0.0), (0.5, 0.1, 0.6), (0.5, 0.1, -0.6)])
def test_errors_over_sigma_are_near_one_whichever_variable_is_uncertain(u_x: float, u_y: float, r: float) -> None:
    rows = calibrations(u_x, u_y, r)
    assert np.std(rows[:, :2], axis=0) == pytest.approx([1, 1], abs=0.12)
    assert np.abs(np.mean(rows[:, :2], axis=0)).max() < 4 / math.sqrt(len(rows))
    assert np.mean(rows[:, 2]) == pytest.approx(1, abs=0.07)


def line_rates(rpm: float, seed: int) -> tuple[float, Floats]:
    """True rate and the rates of single encoder lines, °/s: 1000 lines, edges seen at the next of 3125 samples/s."""
    rate = 6 * rpm
    times = (np.arange(4001) + np.random.default_rng(seed).uniform()) * 0.36 / rate
    return rate, 0.36 * 3125 / np.diff(np.ceil(times * 3125))


def test_raw_line_rates_at_two_speeds_attenuate_ordinary_least_squares_to_three_quarters_and_york_not() -> None:
    measured = [line_rates(rpm, 1) for rpm in (100 / 3, 45.0)]
    true = np.concatenate([np.full(rates.size, rate) for rate, rates in measured])
    rates = np.concatenate([rates for _, rates in measured])
    u_x = np.concatenate([np.full(rates.size, math.sqrt(np.mean((rates - rate) ** 2))) for rate, rates in measured])
    volts = 2.5 + 3.6e-3 * true + 1e-4 * np.random.default_rng(2).standard_normal(true.size)
    ordinary = fit_line(rates, volts, u_y=1e-4)
    assert ordinary.slope / 3.6e-3 == pytest.approx(0.75, abs=0.015)
    # The mean of the reciprocals is 0.7 % too large at both speeds, which no fit can take out.
    assert fit_line(rates, volts, u_x, 1e-4).slope / 3.6e-3 == pytest.approx(0.9925, abs=0.02)


def test_the_average_over_twenty_lines_attenuates_by_six_thousandths_only() -> None:
    measured = [line_rates(rpm, 1) for rpm in (100 / 3, 45.0)]
    averages = [np.convolve(rates, np.full(20, 1 / 20), "valid") for _, rates in measured]
    true = np.concatenate([np.full(mean.size, rate) for (rate, _), mean in zip(measured, averages, strict=True)])
    assert fit_line(np.concatenate(averages), 3.6e-3 * true, u_y=1e-4).slope / 3.6e-3 == pytest.approx(0.994, abs=0.006)


def test_the_cubic_of_a_sensor_is_not_attenuated_by_an_uncertain_reference() -> None:
    x, wanted = np.linspace(-2, 2, 40), np.array([1.65, 0.3, 0.0, 0.02])
    errors = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        y = wanted[0] + wanted[1] * x + wanted[3] * x**3 + 0.004 * rng.standard_normal(x.size)
        fit = fit_polynomial(x + 0.02 * rng.standard_normal(x.size), y, 3, 0.02, 0.004)
        errors.append((fit.coefficients - wanted) / np.sqrt(np.diag(fit.covariance)))
    assert np.std(errors, axis=0) == pytest.approx(np.ones(4), abs=0.2)
    assert np.abs(np.mean(errors, axis=0)).max() < 4 / math.sqrt(150)


def test_a_common_error_of_y_goes_into_the_intercept_alone() -> None:
    x = np.linspace(0, 1, 20)
    fit = fit_polynomial(x, 2 + 3 * x, 1, covariance=1e-4 * np.eye(20) + 0.01)
    alone = fit_polynomial(x, 2 + 3 * x, 1, u_y=0.01)
    assert fit.coefficients == pytest.approx([2, 3], rel=1e-9)
    assert fit.covariance[1, 1] == pytest.approx(alone.covariance[1, 1], rel=1e-9)
    assert fit.covariance[0, 0] == pytest.approx(alone.covariance[0, 0] + 0.01, rel=1e-9)


@given(st.lists(st.floats(-5, 5), min_size=4, max_size=4), st.floats(-3, 3))
def test_odd_and_even_part_add_up_to_the_curve_and_have_their_parity(c: list[float], at: float) -> None:
    x = np.linspace(-2, 2, 9)
    curve = fit_polynomial(x, c[0] + c[1] * x + c[2] * x**2 + c[3] * x**3, 3, u_y=0.1)
    odd, even = odd_even(curve)
    assert odd.value(at) + even.value(at) == pytest.approx(curve.value(at), abs=1e-9)
    assert odd.value(-at) == pytest.approx(-odd.value(at), abs=1e-12)
    assert even.value(-at) == pytest.approx(even.value(at), abs=1e-12)


def test_the_uncertainty_of_the_line_is_smallest_in_the_middle() -> None:
    line = fit_line(PEARSON_X, PEARSON_Y, PEARSON_U_X, PEARSON_U_Y)
    assert line.u(0.0) == pytest.approx(line.u_intercept)
    assert line.u(5.0) < line.u(0.0)
    assert line.u(3.0) == pytest.approx(line.polynomial().u(3.0))


def test_columns_that_cannot_be_told_apart_are_named() -> None:
    x = np.linspace(0, 1, 10)
    with pytest.raises(BadInput, match=r"told apart: gain, range;"):
        gls(np.column_stack([np.ones(10), x, 2 * x]), x, np.ones(10), ["offset", "gain", "range"])
    with pytest.raises(BadInput, match=r"told apart: tilt;"):
        gls(np.column_stack([np.ones(10), 0 * x]), x, np.ones(10), ["offset", "tilt"])


def test_what_cannot_be_fitted_is_refused() -> None:
    x = np.array([1.0, 2.0, 3.0])
    for arguments, text in (
        ((np.ones(3), x, 0.0, 1.0), "two different x"),
        ((x, x), "u_x = u_y = 0"),
        ((x, x[:2], 0.0, 1.0), "shapes"),
        ((x, x * np.nan, 0.0, 1.0), "finite"),
        ((x, x, -1.0, 1.0), "u_x"),
        ((x, x, 1.0, 1.0, 1.0), "correlation"),
    ):
        with pytest.raises(BadInput, match=text):
            fit_line(*arguments)
    with pytest.raises(BadInput, match="3 points for 4"):
        fit_polynomial(x, x, 3, u_y=1.0)
    with pytest.raises(BadInput, match="positive definite"):
        gls(np.ones((2, 1)), [1.0, 2.0], [[1.0, 2.0], [2.0, 1.0]])
    with pytest.raises(BadInput, match="degrees of freedom"):
        fit_line([0.0, 1.0], [0.0, 1.0], u_y=1.0).scaled()
