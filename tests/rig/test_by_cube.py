"""The Sensor Cube's own frames as parts of a fit: values on the model are true and agree with the direct estimates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fast_bench
import numpy as np
import pytest

from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration
from rig.fit import adequacy
from rig.fit.evidence import evidence_of
from rig.fit.fit import begin, fit
from rig.parts.reading import by_cube
from rig.parts.sweep import Sweep
from rig.report import run_figures

SEEDS = range(41, 45)
RUNS = (
    {"procedure": "frequency_sweep", "axis": "x", "points": 10},
    {"procedure": "turntable", "axis": "yaw", "revolutions": 8, "rest": "10 s"},
    {"procedure": "noise", "length": "40 s", "cables": "turntable"},
    {"procedure": "tumble", "poses": 24},
)
TRUTH = {"sensitivity": "sensitivity", "sensitivity_gravity": "sensitivity", "sensitivity_centripetal": "sensitivity",
         "bandwidth": "pole", "offset": "zero"}  # fmt: skip


@cache
def recorded(seed: int) -> tuple[fast_bench.MemoryRecords, ...]:
    """On the bench of the configurations, with converter and cube as recorders."""
    return kept_by("[recorder, cube]", seed, *RUNS)


def kept_by(recorders: str, seed: int, *procedures: Mapping[str, Any]) -> tuple[fast_bench.MemoryRecords, ...]:
    configs, world = fast_bench.BENCH.parents[1], fast_bench.world(seed)
    text = fast_bench.BENCH.read_text(encoding="utf-8").replace("../", f"{configs}/")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "bench.yaml"
        path.write_text(text.replace("[recorder, analyzer, scope]", recorders), encoding="utf-8")
        return tuple(fast_bench.measure(one, world, bench=path) for one in procedures)


@cache
def made(seed: int, recorder: str = "cube") -> Calibration:
    return calibrate(list(recorded(seed)), recorder, recorder=recorder)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", SEEDS)
def test_values_stand_on_the_model_and_on_a_direct_estimate(seed: int) -> None:
    """Of every world in a test of its own: four in one take longer than a test may on a busy machine."""
    for measurand in TRUTH:
        results = list(made(seed).of(measurand))
        assert len(results) >= 2
        for result in results:
            assert result.check is not None
            assert not any("leaves more than noise" in said for said in result.remarks)
            assert result.value is not None


@pytest.mark.parametrize("measurand", sorted(TRUTH))
def test_values_are_true_within_their_uncertainty_and_agree_with_the_direct_ones(measurand: str) -> None:
    away, delta = [], []
    for seed in SEEDS:
        true = fast_bench.world(seed).truth[TRUTH[measurand]]
        for result in made(seed).of(measurand):
            assert result.check is not None
            assert not any("leaves more than noise" in said for said in result.remarks)
            assert result.value is not None
            away.append((result.value - true[result.channel]) / result.expanded)
            delta.append(result.check.delta / result.check.u_delta)
    assert len(away) >= 2 * len(SEEDS)
    assert np.mean(np.abs(away) < 1.0) > 0.85
    assert np.abs(away).max() < 1.7
    assert np.mean(np.abs(delta) < 2.0) > 0.8
    assert math.sqrt(float(np.mean(np.square(delta)))) < 1.4


def test_both_recorders_agree_better_than_the_uncertainty_of_the_vibrometer() -> None:
    for channel in ("unit_a_x", "unit_b_x"):
        one, other = (made(41, by).result(f"{channel}.sensitivity") for by in ("cube", "converter"))
        noise = [
            line.u for result in (one, other) for line in result.contributions if line.name == "noise of the records"
        ]
        assert one.value != other.value
        assert abs(float(one.value or 0.0) - float(other.value or 0.0)) < 3.0 * math.hypot(*noise)


def test_a_sweep_leaves_nothing_but_noise_in_every_kind_of_line() -> None:
    evidence = evidence_of(recorded(41)[:1], by_cube.read)
    found = fit(evidence.parts, begin(evidence.parts, evidence.nuisances, free=True))
    assert adequacy.adequate(found)
    rows: dict[str, list[adequacy.Group]] = {}
    for group in adequacy.groups(found):
        rows.setdefault(group.domain, []).append(group)
    for domain in ("mean", "1f", "2f", "3f", "mains"):
        count = sum(one.count for one in rows[domain])
        assert sum(one.chi2 for one in rows[domain]) / count == pytest.approx(1.0, abs=0.2), domain


def test_every_sine_has_a_time_of_its_own_that_costs_no_sensitivity() -> None:
    """Were all records late by one time, a sensitivity would be as uncertain as with it."""
    evidence = evidence_of(recorded(41)[:1], by_cube.read)
    (part,) = (one for one in evidence.parts if isinstance(one, Sweep))
    (clock,) = (term for term in evidence.nuisances if term.effect.name == "recorder_clock")
    assert len(clock.at) == int(part.data.driven.sum())
    assert list(clock.prior.values()) == pytest.approx([6.5e-4] * len(clock.at), rel=0.2)
    known = tuple(term for term in evidence.nuisances if term is not clock)
    with_times = fit(evidence.parts, begin(evidence.parts, evidence.nuisances, free=True))
    without = fit(evidence.parts, begin(evidence.parts, known, free=True))
    gain = with_times.layout.gains["unit_a_x"]
    assert without.chi2 > with_times.chi2 + 1000.0  # the filters' phases are not the data sheet's
    assert with_times.covariance[gain, gain] < 1.5**2 * without.covariance[gain, gain]


def test_harmonics_that_others_fall_on_at_the_cubes_rate_are_left_out() -> None:
    (part,) = (one for one in evidence_of(recorded(41)[:1], by_cube.read).parts if isinstance(one, Sweep))
    rate = 1000.0
    for p in np.flatnonzero(part.data.driven):
        f = float(part.data.frequency[p])
        kept = np.flatnonzero(np.isfinite(part.data.variance[0, p, 1:6])) + 1
        assert 1 in kept
        for k in kept:
            assert k * f < 0.45 * rate
            others = [m * f for m in range(1, 13) if m != k]
            assert min(abs(abs(m - rate * round(m / rate)) - k * f) for m in others) >= 3.0


@pytest.mark.parametrize(
    "procedure", [{"procedure": "tumble", "record": "1 s"}, {"procedure": "noise", "length": "5 s"}]
)
def test_what_the_cube_alone_kept_is_no_figure_of_the_converter_and_no_error(procedure: Mapping[str, Any]) -> None:
    (records,) = kept_by("[cube]", 41, procedure)
    assert run_figures.poses(records) is None
    assert run_figures.density(records) is None


def test_samples_that_are_no_measurement_are_told_by_whatever_recorder_kept_them() -> None:
    (tumble,) = kept_by("[cube]", 41, {"procedure": "tumble", "record": "1 s"})
    sweep = {"procedure": "frequency_sweep", "axis": "x", "points": 3, "static": "0 s", "static_after": "0 s"}
    (shaken,) = kept_by("[scope]", 41, sweep)
    for records, kept, size in ((tumble, "cube", 4000), (shaken, "traces", 20.0)):
        assert not spiked(records)
        values = records.block(next(body[kept] for body in records.points.values())).copy()
        row = values[:, 0] if kept == "cube" else values[1]
        row[300] += size
        records.arrays[next(body[kept] for body in records.points.values())] = [values]
        assert spiked(records)


def spiked(records: fast_bench.MemoryRecords) -> bool:
    """Whether the sensitivity of unit A x is flagged for its samples."""
    found = calibrate([records], "alone").results
    (row,) = (one for one in found if one.key.startswith("unit_a_x.sensitivity"))
    return row.status == "flagged" and "samples that are no measurement" in row.remarks[-1]
