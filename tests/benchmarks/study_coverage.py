"""Do the stated intervals hold the truth? Two hundred worlds, each with its own errors of every reference.

Each seed draws the cube, the noise and the true error of every reference within its stated uncertainty; a sweep, a
turntable run and records at rest are measured in-process, calibrated, and compared with what was drawn. The axis goes
round with the seed. RIG_SEEDS sets the number of worlds (200 by default, about ten minutes on two cores).
"""

from __future__ import annotations

import math
import os
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import fast_bench
import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from fixtures.noise import HIGHEST, PROCESSES, RATIO, STEP
from fixtures.world import World
from rig.calibrate import accelerometers, calibrate, gyros
from rig.calibrate.calibration import Calibration, Result
from rig.calibrate.resting import LOWEST, Resting
from rig.parts.reading.revolutions import rotation_of
from rig.parts.reading.vibration import chain_of, sine_points
from rig.sensor import Sensor
from rig.signals.noise import NoiseModel

SEEDS = int(os.environ.get("RIG_SEEDS", "200"))
EXACT = ("converter gain", "asymmetry, unseen here", "nonlinearity, unseen here")  # what these worlds have none of
GYROS = ("pitch", "roll", "yaw")
Row = tuple[str, float, float, bool]  # quantity, error ÷ u, u ÷ bound, inside


def flicker_density(f: NDArray[np.float64]) -> NDArray[np.float64]:
    """One-sided density, 1/Hz, of the twin's flicker for a coefficient of one; f in Hz, same shape.

    A sum of first-order autoregressions at nodes Δ apart, joined by straight lines: the nodes' density times sinc⁴(fΔ).
    """
    total = np.zeros_like(f)
    rho = math.exp(-STEP)
    for k in range(PROCESSES):
        apart = STEP / (2.0 * math.pi * HIGHEST / RATIO**k)
        nodes = (1.0 - rho * rho) / (1.0 - 2.0 * rho * np.cos(2.0 * math.pi * f * apart) + rho * rho)
        total += 2.0 * apart * nodes * np.sinc(f * apart) ** 4
    return total * math.log(RATIO)


def true_deviation(world: World, channel: str) -> float:
    """Rms above 1/30 Hz of what the twin adds, SI: a white process behind its pole, and flicker."""
    noise = world.physics.channels[channel].noise
    f = np.geomspace(LOWEST, 3125.0 / 2.0, 20_000)
    power = noise.white**2 + noise.flicker * float(np.trapezoid(flicker_density(f), f))
    return math.sqrt(power) / world.truth["sensitivity"][channel]


def true_noise(world: World, channel: str, found: Resting) -> Resting:
    """The noise as it was drawn, in place of what was estimated; flicker as between 0.01 and 5 Hz."""
    noise, model = world.physics.channels[channel].noise, found.fit.model
    f = np.geomspace(0.01, 5.0, 400)
    flicker = noise.flicker * float(np.mean(f * flicker_density(f)))
    white = noise.white**2 / (math.pi / 2.0 * noise.pole)
    known = NoiseModel(model.rate, white, noise.pole, flicker, 0.0, model.quantisation)
    return replace(found, fit=replace(found.fit, model=known))


def one_world(seed: int) -> list[Row]:
    """Every tabulated quantity of one world."""
    world = fast_bench.world(seed)
    axis, gyro = "xyz"[seed % 3], GYROS[seed % 3]
    documents = (
        {"procedure": "noise", "length": "120 s", "cables": "shaker"},
        {"procedure": "noise", "length": "120 s", "cables": "turntable"},
        {"procedure": "frequency_sweep", "axis": axis},
        {"procedure": "turntable", "axis": gyro},
    )
    runs = [fast_bench.measure(document, world) for document in documents]
    made = calibrate.calibrate(runs, f"seed {seed}")
    bounds = _bounds(world, made, runs, axis, gyro)
    rows = []
    for channel in (f"unit_a_{axis}", f"unit_b_{axis}", f"unit_c_{axis}", f"gyro_{gyro}", f"backup_{gyro}"):
        unit = channel.rpartition("_")[0]
        truths = {
            "sensitivity": world.truth["sensitivity"][channel],
            "offset": world.truth["zero"][channel],
            "deviation": true_deviation(world, channel),
        }
        for measurand, truth in truths.items():
            result = made.result(f"{channel}.{measurand}")
            rows.append(_row(f"{unit} {measurand}", result, truth, bounds.get(result.key, math.nan)))
            if (one := result.check) is not None:  # the direct estimate: Δ in units of u(Δ), two of which 95 % keep
                rows.append((f"{unit} {measurand}, Δ", one.delta / one.u_delta, math.nan, one.agrees))
    return rows


def _row(quantity: str, result: Result, truth: float, bound: float) -> Row:
    assert result.value is not None, result.remarks
    error, u = result.value - truth, math.hypot(*(c.contribution for c in result.contributions if c.name not in EXACT))
    return quantity, error / u, u / bound, abs(error) <= result.coverage_factor * u


def _bounds(
    world: World, made: Calibration, runs: list[fast_bench.MemoryRecords], axis: str, gyro: str
) -> dict[str, float]:
    """Cramér–Rao bound with the noise as drawn, combined with the reference's terms, by result."""
    bounds = {}
    sweep, turning = runs[2], runs[3]
    chain, sensor = chain_of(sweep), Sensor.of(sweep.header)
    points = sine_points(sweep, chain)
    seconds = 3125 / 3125.0
    for unit in ("unit_a", "unit_b", "unit_c"):
        name = f"{unit}_{axis}"
        result, noise = made.result(f"{name}.sensitivity"), made_noise(runs, name)
        drawn = true_noise(world, name, noise).fit.model
        exact = []
        for p in points:
            line = p.lines[name]
            variance = np.full(len(line.variance), float(drawn.density(p.frequency)) / seconds)
            exact.append(replace(p, lines={name: replace(line, variance=variance)}))
        bandwidth = sensor.channel(name).bandwidth
        fit = accelerometers.fit_channel(accelerometers.observed(exact, name), name, chain, bandwidth)
        reference = math.hypot(*(c.contribution for c in result.contributions if c.kind == "B" and c.name not in EXACT))
        bounds[result.key] = math.hypot(fit.sensitivity * fit.adjustment.u_noise("log_sensitivity"), reference)
    channels = [c for c in turning.header["bench_file"]["cables"]["turntable"] if c in sensor]
    rotation = rotation_of(turning, channels, sensor)
    setup = gyros.Setup(chain.time_base, 0.0, 0.0, 9.81, None, {}, {})
    for name in (f"gyro_{gyro}", f"backup_{gyro}"):
        result, noise = made.result(f"{name}.sensitivity"), made_noise(runs, name)
        fit = gyros.fit_gyro([rotation], name, true_noise(world, name, noise), setup)
        reference = math.hypot(*(c.contribution for c in result.contributions if c.kind == "B" and c.name not in EXACT))
        bounds[result.key] = math.hypot(float(fit.solution.u[-1]), reference)
    return bounds


def made_noise(runs: list[fast_bench.MemoryRecords], name: str) -> Resting:
    """The noise that the calibration used."""
    from rig.calibrate.resting import noise_of

    poles = {c.name: c.bandwidth for c in Sensor.of(runs[0].header).channels}
    return noise_of(runs, [name], poles)[0][name]


def test_the_truth_lies_inside_the_stated_intervals_as_often_as_they_say() -> None:
    found: dict[str, list[Row]] = defaultdict(list)
    with ProcessPoolExecutor(max_workers=min(2, os.cpu_count() or 1)) as pool:
        for rows in pool.map(one_world, range(1000, 1000 + SEEDS), chunksize=2):
            for row in rows:
                found[row[0]].append(row)
    low, high = (int(n) for n in binom.ppf([0.005, 0.995], SEEDS, 0.95))
    print(f"\n{SEEDS} worlds; of 95 % intervals {low} to {high} should hold the truth (binomial 99 % band)")
    outside, wide = [], []
    for quantity, rows in found.items():
        inside = sum(row[3] for row in rows)
        spread, ratio = float(np.sqrt(np.mean([r[1] ** 2 for r in rows]))), float(np.median([r[2] for r in rows]))
        bias = float(np.mean([r[1] for r in rows]))
        print(f"  {quantity:<24} {inside:>4} inside  error/u: mean {bias:+.2f} rms {spread:.2f}  u/bound {ratio:.3f}")
        # a zero output has no true value apart from flicker of no lowest frequency: shown, not judged
        # u(Δ) has a tenth of slack in it, so more than 95 % may agree
        fine = low <= inside <= high or "offset" in quantity or (quantity.endswith("Δ") and inside >= low)
        outside += [] if fine else [quantity]
        wide += [quantity] if ratio > 1.2 else []
    assert not outside, f"coverage outside the band: {outside}"
    assert not wide, f"wider than 1.2 times the bound: {wide}"
