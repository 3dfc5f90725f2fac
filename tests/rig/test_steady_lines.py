"""Hum and other steady lines leave the noise of a record: its density is that of the same record without them."""

from __future__ import annotations

import math
import re

import fast_bench
import numpy as np
import pytest
from scipy.signal import lfilter

from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration
from rig.signals import noise
from rig.signals.spectrum import SEGMENT, WHOLE, Periodogram
from rig.signals.steady_lines import SteadyLine, lines_without, without_lines

RATE, POLE = 1000.0, 60.0
DENSITY = 2e-6  # unit²/Hz, one-sided


def quiet(seed: int, count: int, flicker: float = 0.0) -> np.ndarray:
    """White noise, and flicker, behind one pole."""
    rng = np.random.default_rng(seed)
    frequency = np.fft.rfftfreq(count, 1.0 / RATE)[1:]
    lines = np.sqrt((DENSITY + flicker / frequency) * RATE * count / 4.0)
    drawn = (rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines))) * lines
    values = np.fft.irfft(np.concatenate([[0.0], drawn]), count)
    rho = math.exp(-2.0 * math.pi * POLE / RATE)
    return np.asarray(lfilter([1.0 - rho], [1.0, -rho], values))


def density(values: np.ndarray) -> tuple[float, float, tuple[SteadyLine, ...]]:
    """White noise (unit²/Hz), its relative standard uncertainty, and the lines that were taken out."""
    lines, steady = lines_without(values, RATE)
    found = noise.fit_blocks(lines, step=0.0, pole=POLE)
    return found.model.white, found.u["white"] / found.model.white, steady


@pytest.mark.parametrize("seconds", [6, 40])
@pytest.mark.parametrize("amplitude", [0.003, 0.03, 1.0])
def test_a_density_is_that_of_the_noise_however_loud_the_hum(seconds: int, amplitude: float) -> None:
    values = quiet(1, round(seconds * RATE))
    t = np.arange(len(values)) / RATE
    hum = sum(a * np.cos(2 * math.pi * f * t + 1.0 / a) for f, a in ((50.0, amplitude), (150.0, 0.3 * amplitude)))
    without, u, none = density(values)
    assert none == ()
    found, _, steady = density(values + hum)
    assert abs(found / without - 1.0) < u
    if amplitude > 0.01:  # a weak one may be left in, where it matters as little
        assert [line.frequency for line in steady] == [pytest.approx(f, abs=0.05) for f in (50.0, 150.0)]
        assert steady[0].rms == pytest.approx(amplitude / math.sqrt(2.0), rel=0.02)


def test_without_taking_it_out_the_same_hum_spoils_the_density() -> None:
    values = quiet(1, 40_000)
    hum = 0.03 * np.cos(2 * math.pi * 50.0 * np.arange(len(values)) / RATE)
    heard = Periodogram(RATE)
    heard.feed(values + hum)
    spoiled = noise.fit_blocks(heard.result(), step=0.0, pole=POLE).model.white
    assert not 0.5 < spoiled / density(values)[0] < 2.0


def test_noise_alone_shows_no_line() -> None:
    for seed in range(40):
        assert lines_without(quiet(seed, 12_000, flicker=2e-6 * (seed % 3)), RATE)[1] == ()
        assert lines_without(np.cumsum(quiet(seed, 3 * SEGMENT)), RATE)[1] == ()  # ends that do not meet


def test_mains_that_wander_are_followed() -> None:
    values = quiet(3, 12 * SEGMENT)
    t = np.arange(len(values)) / RATE
    turned = 2 * math.pi * (50.0 * t + 0.03 * 40.0 / (2 * math.pi) * np.sin(2 * math.pi * t / 40.0))
    without, u, _ = density(values)
    found, _, steady = density(values + 0.1 * np.cos(turned))
    assert abs(found / without - 1.0) < 2.0 * u
    assert steady[0].rms == pytest.approx(0.1 / math.sqrt(2.0), rel=0.01)


def test_a_long_record_loses_its_lines_piece_by_piece() -> None:
    values = quiet(4, WHOLE + 3 * SEGMENT + 17)
    t = np.arange(len(values)) / RATE
    hum = 0.02 * np.cos(2 * math.pi * 60.0 * t)
    pieces = np.array_split(values + hum, 61)
    heard = Periodogram(RATE)
    for piece in pieces:
        heard.feed(piece)
    lines, (steady,) = without_lines(heard, lambda: pieces)
    assert steady.frequency == pytest.approx(60.0, abs=1e-3)
    assert steady.rms == pytest.approx(0.02 / math.sqrt(2.0), rel=0.01)
    found = noise.fit_blocks(lines, step=0.0, pole=POLE)
    without, u, _ = density(values)
    assert abs(found.model.white / without - 1.0) < u
    assert lines.variance == pytest.approx(float(np.var(values)), rel=0.01)
    assert lines.high.dof.sum() < len(values)


@pytest.mark.parametrize("rate", [10.0, 100.0])
@pytest.mark.parametrize("total", [3e2, 1e4])
def test_drift_is_no_line(rate: float, total: float) -> None:
    """A ramp has power in every second cosine line, and a slow wave is within a few of them."""
    white = np.random.default_rng(5).standard_normal(round(300.0 * rate))
    t = np.arange(len(white)) / rate
    for drift in (total * t / t[-1], 3.0 * np.sin(2.0 * math.pi * 0.012 * t) + 0.5 * np.sin(2.0 * math.pi * 0.03 * t)):
        lines, steady = lines_without(white + drift, rate)
        assert steady == ()
        assert lines.variance == pytest.approx(float(np.var(white + drift)), rel=1e-9)


def test_what_wavers_is_noise_however_narrow() -> None:
    """Noise through a resonance of 200 and of 1000 widths: its power in stretches goes up and down."""
    rng = np.random.default_rng(6)
    for q in (200.0, 1000.0):
        r, turn = math.exp(-math.pi * 40.0 / q / 500.0), 2.0 * math.pi * 40.0 / 500.0
        rung = lfilter([1.0], [1.0, -2.0 * r * math.cos(turn), r * r], rng.standard_normal(60_000))[20_000:]
        values = rng.standard_normal(len(rung)) + 0.5 * rung / rung.std()
        lines, steady = lines_without(values, 500.0)
        assert steady == ()
        assert lines.variance == pytest.approx(float(np.var(values)), rel=1e-9)


def test_what_cannot_be_told_from_something_else_stays() -> None:
    """A line beside half the sampling rate has a mirror image of its size; a comb of lines is no noise with a line."""
    white = np.random.default_rng(7).standard_normal(6_000)
    t = np.arange(len(white)) / 10.0
    comb = np.sum([np.sin(2.0 * math.pi * f * t) for f in np.arange(1.0, 4.5, 0.5)], axis=0)
    for more in (np.cos(math.pi * np.arange(len(white))), comb):
        lines, steady = lines_without(white + more, 10.0)
        assert steady == ()
        assert lines.variance == pytest.approx(float(np.var(white + more)), rel=1e-9)
    lines, steady = lines_without(white + np.sin(2.0 * math.pi * t), 10.0)
    assert [line.frequency for line in steady] == [pytest.approx(1.0, abs=0.01)]
    assert lines.variance == pytest.approx(float(np.var(white)), rel=0.02)


def hummed(amplitude: float) -> Calibration:
    hum = {"name": "mains_hum", "parameters": {"quantity": "acceleration", "amplitude": amplitude}}
    world = fast_bench.world(5, [hum] if amplitude else [])
    return calibrate([fast_bench.measure({"procedure": "noise", "length": "5 s"}, world)], "hummed")


def test_hum_on_the_bench_changes_no_noise_that_is_reported_and_is_said() -> None:
    plain = hummed(0.0)
    assert not any("steady" in one for one in plain.flags)
    for amplitude in (3e-4, 1e-3, 1e-2):
        found = hummed(amplitude)
        for row in found.results:
            before = plain.result(f"{row.channel}.{row.measurand}")
            assert row.status == before.status
            if row.value is not None and before.value is not None:
                assert abs(row.value - before.value) < before.u
        said = [row for row in found.of("deviation") if row.channel.startswith("unit")]
        (flag,) = (one for one in found.flags if one.startswith("steady lines are not counted as noise: "))
        assert " Hz (unit_a_x, unit_a_y, unit_a_z and " in flag
        told = re.compile(r"without the steady lines? at (49\.9\d|50(\.0\d)?) Hz")
        assert sum(any(told.match(one) for one in row.remarks) for row in said) >= (7 if amplitude < 1e-3 else 9)
        assert not any("steady" in one for row in found.results if row not in said for one in row.remarks)
