"""How close the estimators come to the Cramér–Rao bound: the error of many simulated calibrations ÷ the bound."""

from __future__ import annotations

import time

import numpy as np
import pytest

from rig.signals import tone
from rig.signals.line import fit_line
from rig.signals.rotation import KNOT, Edges, Track

DRAWS = 2000
WORST = 1.05


@pytest.mark.parametrize(("u_x", "u_y"), [(0.0, 0.05), (0.3, 0.05), (0.3, 0.0)])
def test_the_straight_line_is_at_its_cramer_rao_bound(u_x: float, u_y: float) -> None:
    x, slope, intercept = np.linspace(-10.0, 10.0, 50), 0.36, 1.65
    rng = np.random.default_rng(11)
    errors = np.empty((DRAWS, 2))
    for row in errors:
        line = fit_line(
            x + u_x * rng.standard_normal(x.size), intercept + slope * x + u_y * rng.standard_normal(x.size), u_x, u_y
        )
        row[:] = line.slope - slope, line.intercept - intercept
    design = np.column_stack([x, np.ones(x.size)])
    # With the true x unknown as well, eliminating them leaves the variance u_y² + slope²·u_x² per point.
    bound = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * (u_y**2 + slope**2 * u_x**2))
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / bound
    print(f"\nstraight line, u_x = {u_x}, u_y = {u_y}: RMSE/CRB slope {ratio[0]:.3f}, intercept {ratio[1]:.3f}")
    assert np.all(ratio <= WORST)


def test_the_sine_fit_is_at_its_cramer_rao_bound() -> None:
    rng, rate, count, frequency, sigma = np.random.default_rng(3), 3125.0, 2000, 121.3, 0.05
    t = np.arange(count) / rate
    truth = np.array([0.6, -0.8, 0.1, frequency])  # Re C, Im C, offset, Hz
    clean = 0.6 * np.cos(2 * np.pi * frequency * t) + 0.8 * np.sin(2 * np.pi * frequency * t) + 0.1
    three, four = np.empty((DRAWS, 3)), np.empty((DRAWS, 4))
    for known, free in zip(three, four, strict=True):
        values = clean + sigma * rng.standard_normal(count)
        one, other = tone.fit_three(t, values, frequency), tone.fit_four(t, values, frequency + 0.2)
        known[:] = [one.amplitude.real, one.amplitude.imag, one.offset] - truth[:3]
        free[:] = [other.amplitude.real, other.amplitude.imag, other.offset, other.frequency] - truth
    slope = 2 * np.pi * t * (-0.6 * np.sin(2 * np.pi * frequency * t) + 0.8 * np.cos(2 * np.pi * frequency * t))
    design = np.column_stack([tone.design(t, frequency), slope])
    for name, errors, columns in (("three", three, design[:, :3]), ("four", four, design)):
        bound = sigma * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
        ratio = np.sqrt(np.mean(errors**2, axis=0)) / bound
        print(f"\nsine fit, {name} parameters: RMSE/CRB {np.round(ratio, 3).tolist()}")
        assert np.all(ratio <= WORST)


def test_the_encoder_s_rate_is_at_its_cramer_rao_bound() -> None:
    """Edges whose times are uncertain by half a sample; the bound is that of the spline's own parameters."""
    rng, interval, omega = np.random.default_rng(5), 320e-6, 2 * np.pi * 0.75
    lines = np.arange(8000)
    exact = _inverted(lines * 2 * np.pi / 1000, omega)
    inside = np.linspace(exact[400], exact[-400], 300)
    errors, stated = [], []
    for _ in range(40):
        times = exact + interval * (rng.random(len(exact)) - 0.5)
        track = Track(Edges(times, 1, np.zeros(0), np.zeros(0, np.int64), (), 0, interval))
        errors.append(track.rate(inside) - _wow_rate(inside, omega))
        if not stated:
            stated = list(track.variance(inside)[1])
    ratio = float(np.sqrt(np.mean(np.square(errors)) / np.mean(stated)))
    print(f"\nencoder, local rate (knot every {KNOT} lines): RMSE/CRB {ratio:.3f}")
    assert ratio <= WORST


def _wow_rate(t: np.ndarray, omega: float) -> np.ndarray:
    return omega * (1 + 0.001 * np.cos(omega * t) + 0.0002 * np.cos(7.3 * omega * t))


def _inverted(angle: np.ndarray, omega: float) -> np.ndarray:
    """Times at which the platter with that rate has these angles, by Newton's method."""
    t = angle / omega
    for _ in range(20):
        reached = omega * t + 0.001 * np.sin(omega * t) + 0.0002 / 7.3 * np.sin(7.3 * omega * t)
        t = t - (reached - angle) / _wow_rate(t, omega)
    return t


def test_four_parameters_of_a_million_samples_are_fitted_much_faster_than_by_curve_fit() -> None:
    from scipy.optimize import curve_fit

    rng, count, rate, frequency = np.random.default_rng(1), 1_000_000, 3125.0, 123.4567
    t = (np.arange(count) - (count - 1) / 2) / rate  # about the middle, where phase and frequency are independent
    values = 1.3 * np.cos(2 * np.pi * frequency * t + 0.4) + 0.2 + 0.05 * rng.standard_normal(count)
    start = frequency + 0.3 * rate / count

    def model(x: np.ndarray, a: float, b: float, c: float, f: float) -> np.ndarray:
        return a * np.cos(2 * np.pi * f * x) - b * np.sin(2 * np.pi * f * x) + c

    first = tone.fit_three(t, values, start)
    guess = [first.amplitude.real, first.amplitude.imag, first.offset, start]
    ours, theirs = [], []
    for _ in range(3):
        begun = time.perf_counter()
        found = tone.fit_four(t, values, start, tolerance=1e-12)
        ours.append(time.perf_counter() - begun)
        begun = time.perf_counter()
        other, _ = curve_fit(model, t, values, p0=guess, ftol=1e-12, xtol=1e-12, gtol=1e-12)
        theirs.append(time.perf_counter() - begun)
    mine = np.array([found.amplitude.real, found.amplitude.imag, found.offset, found.frequency])
    apart = float(np.max(np.abs(mine / other - 1)))
    ratio = float(np.median(theirs) / np.median(ours))
    print(f"\nfour-parameter fit, 1e6 samples: {np.median(ours):.3f} s, curve_fit {np.median(theirs):.3f} s, "
          f"ratio {ratio:.1f}; answers apart by {apart:.1e}")  # fmt: skip
    assert ratio >= 5.0
    assert apart < 1e-9
