"""Noise density of records whose density is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rig.errors import BadInput
from rig.signals import spectrum


def white(seed: int, n: int, rate: float, density: float) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n) * math.sqrt(density * rate / 2)


def test_white_noise_shows_its_density_with_the_scatter_its_degrees_of_freedom_promise() -> None:
    found = spectrum.welch(white(1, 400_000, 1000.0, 3.0), 1000.0, 1.0)
    inner = slice(1, -1)
    assert found.density[inner].mean() == pytest.approx(3.0, rel=0.01)
    scatter = (found.density[inner] / 3.0).std() * math.sqrt(found.dof[0] / 2)
    assert scatter == pytest.approx(1.0, abs=0.15)


def test_a_sine_has_its_power_under_the_line() -> None:
    t = np.arange(20_000) / 1000.0
    found = spectrum.welch(2.0 * np.sin(2 * np.pi * 100.0 * t), 1000.0, 1.0)
    assert found.density.sum() * 1.0 == pytest.approx(2.0, rel=1e-6)
    assert found.frequency[np.argmax(found.density)] == pytest.approx(100.0)


def test_feeding_in_pieces_changes_nothing() -> None:
    values = white(2, 30_000, 100.0, 1.0)
    pieces, lines = spectrum.Welch(100.0, 5.0), spectrum.Periodogram(100.0)
    for piece in np.split(values, [1, 700, 12_345]):
        pieces.feed(piece)
        lines.feed(piece)
    whole = spectrum.Periodogram(100.0)
    whole.feed(values)
    assert pieces.result().density == pytest.approx(spectrum.welch(values, 100.0, 5.0).density, rel=1e-9)
    assert lines.result().low == pytest.approx(whole.result().low, rel=1e-9, abs=1e-12)


def test_a_record_longer_than_the_buffer_keeps_the_density_at_every_frequency() -> None:
    periodogram = spectrum.Periodogram(1000.0, per_decade=5.0)
    for seed in range(15):
        periodogram.feed(white(seed, 100_000, 1000.0, 3.0) + 40.0)
    lines = periodogram.result()
    assert lines.seconds == pytest.approx(1500.0, abs=0.1)
    assert (lines.low**2).mean() == pytest.approx(3.0, rel=4 * math.sqrt(2 / lines.low.size))
    sigma = np.sqrt(2 / lines.high.dof)
    assert np.abs((lines.high.density / 3.0 - 1) / sigma).max() < 4.5


def test_a_slope_is_found_in_the_lines_as_the_closed_form_says() -> None:
    rate, n = 50.0, 4000
    periodogram = spectrum.Periodogram(rate)
    periodogram.feed(0.7 * np.arange(n) / rate)
    lines = periodogram.result()
    assert lines.low == pytest.approx(0.7 * lines.ramp, rel=1e-6, abs=1e-9)


def test_bins_average_lines_and_count_them() -> None:
    f = np.arange(1, 1001.0)
    bins = spectrum.log_bins(f, np.full(1000, 2.0), 10)
    assert bins.dof.sum() == 1000
    assert bins.density == pytest.approx(np.full(bins.density.size, 2.0))
    assert bins.frequency[0] == pytest.approx(1.0)


def test_the_noise_bandwidth_of_one_pole_is_half_pi_times_its_corner() -> None:
    f = np.linspace(0.01, 20_000, 400_000)
    density = spectrum.Density(f, 5 / (1 + (f / 40.0) ** 2), np.full(f.shape, 2.0))
    assert spectrum.noise_bandwidth(density, (0.01, 1.0)) == pytest.approx(40 * math.pi / 2, rel=0.005)


def test_records_that_cannot_be_used_are_refused() -> None:
    with pytest.raises(BadInput, match="shorter than one segment"):
        spectrum.welch(np.ones(10), 10.0, 5.0)
    constant = spectrum.Periodogram(10.0)
    constant.feed(np.ones(100))
    with pytest.raises(BadInput, match="constant"):
        constant.result()
    with pytest.raises(BadInput, match="not finite"):
        constant.feed([math.nan])
