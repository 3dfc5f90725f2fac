"""The sine fit: against closed form, and against the estimation floor of a sine in white noise."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.errors import BadInput
from rig.signals.tone import fit_three, ratio

RATE = 3125.0


def sampled(amplitude: complex, frequency: float, instants: np.ndarray, offset: float = 0.0) -> np.ndarray:
    return np.real(amplitude * np.exp(2j * math.pi * frequency * instants)) + offset


@given(
    size=st.floats(1e-6, 1e3),
    phase=st.floats(-math.pi, math.pi),
    offset=st.floats(-10, 10),
    frequency=st.floats(20, 500),
    late=st.floats(0, 3e-4),
)
def test_a_noiseless_tone_comes_back_exactly_whatever_its_phase_and_the_channel_s_delay(
    size: float, phase: float, offset: float, frequency: float, late: float
) -> None:
    instants = np.arange(3125) / RATE + late
    given_amplitude = cmath.rect(size, phase)
    tone = fit_three(instants, sampled(given_amplitude, frequency, instants, offset), frequency)
    assert abs(tone.amplitude - given_amplitude) < 1e-9 * (size + abs(offset))
    assert tone.offset == pytest.approx(offset, abs=1e-9 * (size + 1))
    assert tone.residual_rms < 1e-9 * (size + abs(offset) + 1e-3)


def test_positive_phase_leads() -> None:
    instants = np.arange(1000) / RATE
    lead = fit_three(instants, np.cos(2 * math.pi * 50 * instants + 0.3), 50.0)
    assert lead.phase == pytest.approx(0.3)
    assert lead.magnitude == pytest.approx(1.0)


def test_a_sine_is_a_cosine_a_quarter_turn_late() -> None:
    instants = np.arange(1000) / RATE
    assert fit_three(instants, np.sin(2 * math.pi * 50 * instants), 50.0).amplitude == pytest.approx(-1j)


def test_on_whole_cycles_the_fit_is_the_discrete_fourier_coefficient() -> None:
    rng = np.random.default_rng(5)
    values = rng.normal(size=3125)
    tone = fit_three(np.arange(3125) / RATE, values, 40.0)
    assert tone.amplitude == pytest.approx(2 / 3125 * np.fft.rfft(values)[40])
    assert tone.offset == pytest.approx(values.mean())


def test_harmonics_and_drift_are_told_apart() -> None:
    t = np.arange(3125) / RATE
    values = sampled(1 + 2j, 80, t) + sampled(0.1 - 0.05j, 160, t) + sampled(0.02j, 240, t) + 0.7 + 0.3 * (t - t.mean())
    tone = fit_three(t, values, 80.0, harmonics=3, drift=True)
    assert tone.amplitudes == pytest.approx((1 + 2j, 0.1 - 0.05j, 0.02j))
    assert (tone.offset, tone.drift) == pytest.approx((0.7, 0.3))
    assert tone.dof == 3125 - 8


def test_uneven_instants_are_as_good_as_even_ones() -> None:
    t = np.sort(np.random.default_rng(1).uniform(0, 1, 400))
    assert fit_three(t, sampled(0.3 - 0.4j, 123.4, t, 2.0), 123.4).amplitude == pytest.approx(0.3 - 0.4j)


def test_scatter_over_many_seeds_is_the_floor_of_a_sine_in_white_noise() -> None:
    """N = 2000, fs = 3125 Hz, A = 1, σ = 0.05: u(A) = u(φ) = 1.58e-3, u(c) = 1.12e-3."""
    n, sigma = 2000, 0.05
    t = np.arange(n) / RATE
    clean = np.cos(2 * math.pi * 50 * t + 0.4)
    rng = np.random.default_rng(2)
    tones = [fit_three(t, clean + rng.normal(scale=sigma, size=n), 50.0) for _ in range(1500)]
    assert np.std([x.magnitude for x in tones]) == pytest.approx(1.58e-3, rel=0.06)
    assert np.std([x.phase for x in tones]) == pytest.approx(1.58e-3, rel=0.06)
    assert np.std([x.offset for x in tones]) == pytest.approx(1.12e-3, rel=0.06)
    assert np.mean([x.residual_rms for x in tones]) == pytest.approx(sigma, rel=0.003)
    assert np.mean([x.magnitude for x in tones]) == pytest.approx(1.0, abs=4 * 1.58e-3 / math.sqrt(1500))


def test_forgetting_a_channel_s_delay_costs_its_phase() -> None:
    """20 µs are 3.6° at 500 Hz."""
    nominal = np.arange(3125) / RATE
    true = nominal + 20e-6
    values = sampled(1.0, 500.0, true)
    assert math.degrees(fit_three(nominal, values, 500.0).phase) == pytest.approx(3.6)
    assert fit_three(true, values, 500.0).phase == pytest.approx(0.0, abs=1e-12)


def test_ratio_of_two_channels_does_not_depend_on_the_drive() -> None:
    t = np.arange(3125) / RATE
    late = t + 40e-6
    sensor, reference = sampled(2j * 0.3, 100, late), sampled(0.3, 100, t)
    assert ratio(fit_three(late, sensor, 100.0), fit_three(t, reference, 100.0)) == pytest.approx(2j)


T = np.arange(100) / RATE


@pytest.mark.parametrize(
    ("instants", "values", "frequency", "message"),
    [
        (T, np.full(100, np.nan), 50.0, "100 samples that are no numbers"),
        (T[:3], T[:3], 50.0, "found 3 samples, wanted more than the 3"),
        (T, T[:50], 50.0, "shapes"),
        (T.reshape(10, 10), T.reshape(10, 10), 50.0, "shapes"),
        (T, T, 0.0, "wanted a frequency above zero"),
        (T, T, math.inf, "wanted a frequency above zero"),
        (T, T, RATE / 2, "half the sampling rate"),
        (T, T, RATE, "cannot tell"),
        (np.zeros(100), T, 50.0, "cannot tell"),
        (T, T, 1e-4, "cannot tell"),
    ],
)
def test_samples_that_cannot_give_a_tone_are_refused(
    instants: np.ndarray, values: np.ndarray, frequency: float, message: str
) -> None:
    with pytest.raises(BadInput, match=message):
        fit_three(instants, values, frequency)


def test_no_harmonics_and_ratios_of_nothing_are_refused() -> None:
    with pytest.raises(BadInput, match="harmonics"):
        fit_three(T, T, 50.0, harmonics=0)
    tone, silence = fit_three(T, np.cos(T * 2 * math.pi * 50), 50.0), fit_three(T, np.zeros(100), 50.0)
    with pytest.raises(BadInput, match="no signal"):
        ratio(tone, silence)
    with pytest.raises(BadInput, match="60 Hz in one"):
        ratio(fit_three(T, T, 60.0), tone)
    with pytest.raises(BadInput, match="harmonic 2"):
        ratio(tone, tone, harmonic=2)
