"""A unit calibrated from the Sensor Cube's own frames: true values, in agreement with the converter's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import fast_bench
import numpy as np
import pytest

from fixtures.world import World
from rig.calibrate.analyzer_route import apart
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration
from rig.errors import BadInput
from rig.parts.reading.cube_frames import frames
from rig.record import CubeSamples

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 10, "static": "5 s"}
NOISE = {"procedure": "noise", "length": "40 s", "cables": "turntable"}
TURNS = {"procedure": "turntable", "axis": "yaw", "revolutions": 8, "rest": "10 s"}
SENSORS = ("unit_a_x", "unit_b_x", "unit_c_x")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bench of the configurations, with converter and cube as recorders."""
    configs = fast_bench.BENCH.parents[1]
    text = fast_bench.BENCH.read_text(encoding="utf-8").replace("../", f"{configs}/")
    path = tmp_path_factory.mktemp("bench") / "bench.yaml"
    path.write_text(text.replace("[recorder, analyzer, scope]", "[recorder, cube]"), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def world() -> World:
    return fast_bench.world(21)


@pytest.fixture(scope="module")
def runs(world: World, bench: Path) -> list[fast_bench.MemoryRecords]:
    return [fast_bench.measure(one, world, bench=bench) for one in (SWEEP, NOISE, TURNS, {"procedure": "tumble"})]


@pytest.fixture(scope="module")
def by_cube(runs: list[fast_bench.MemoryRecords]) -> Calibration:
    return calibrate(runs, "cube", recorder="cube")


@pytest.fixture(scope="module")
def by_converter(runs: list[fast_bench.MemoryRecords]) -> Calibration:
    return calibrate(runs, "converter", assumed=None)


@pytest.mark.parametrize("channel", [*SENSORS, "gyro_yaw", "backup_yaw"])
def test_the_cubes_frames_give_the_true_sensitivity(by_cube: Calibration, world: World, channel: str) -> None:
    found = by_cube.result(f"{channel}.sensitivity")
    assert found.value is not None, found.remarks
    assert abs(found.value - world.truth["sensitivity"][channel]) < 3.5 * found.u
    assert found.check is not None
    assert abs(found.check.delta) < 3.0 * found.check.u_delta
    assert not any("leaves more than noise" in said for said in found.remarks)
    assert found.method.startswith("model fitted to all records")
    assert "recorded by the Sensor Cube itself" in found.method


@pytest.mark.parametrize(
    "key",
    [*(f"{name}.{what}" for name in SENSORS for what in ("sensitivity", "bandwidth", "sensitivity_gravity", "offset")),
     "gyro_yaw.sensitivity", "gyro_yaw.offset", "gyro_yaw.lag", "gyro_yaw.quadratic", "backup_yaw.sensitivity",
     "gyro_roll.cross_coupling_yaw", "unit_a_z.sensitivity_centripetal", "unit_a_x.nonlinearity"],
)  # fmt: skip
def test_both_recorders_agree_within_the_uncertainty_of_their_difference(
    by_cube: Calibration, by_converter: Calibration, key: str
) -> None:
    one, other = by_cube.result(key), by_converter.result(key)
    assert one.value is not None, one.remarks
    assert other.value is not None, other.remarks
    assert one.value != other.value
    assert abs(one.value - other.value) < 3.0 * apart(one, other)


def test_sensitivities_differ_by_far_less_than_the_vibrometers_gain(
    by_cube: Calibration, by_converter: Calibration
) -> None:
    one, other = by_cube.result("unit_a_x.sensitivity"), by_converter.result("unit_a_x.sensitivity")
    assert apart(one, other) < 0.2 * other.u


def test_noise_at_rest_is_that_of_the_sensor(by_cube: Calibration, by_converter: Calibration) -> None:
    one, other = (made.result("gyro_yaw.noise_density") for made in (by_cube, by_converter))
    assert one.value is not None
    assert other.value is not None
    assert abs(one.value - other.value) < 4.0 * math.hypot(one.u, other.u)


def test_the_cubes_clock_is_in_the_budgets(by_cube: Calibration) -> None:
    lag = {line.name: line for line in by_cube.result("gyro_yaw.lag").contributions}
    assert 1e-4 < lag["clock between the recorders"].contribution < 3e-3
    sensitivity = {line.name: line for line in by_cube.result("gyro_yaw.sensitivity").contributions}
    assert abs(sensitivity["clock between the recorders"].contribution) < 0.1 * sensitivity["noise and wandering"].u
    still = {line.name: line for line in by_cube.result("unit_a_x.sensitivity").contributions}
    assert abs(still["clock between the recorders"].contribution) < 1e-2 * still["noise of the records"].u


def test_phases_carry_the_uncertainty_of_the_clock_and_hold_the_truth(
    by_cube: Calibration, by_converter: Calibration
) -> None:
    ours, theirs = by_cube.responses["unit_a_x"][0], by_converter.responses["unit_a_x"][0]
    assert ours.frequency == theirs.frequency
    assert ours.uc_phase > 2.0 * math.pi * ours.frequency * 2e-4
    assert abs(math.remainder(ours.phase - theirs.phase, 2.0 * math.pi)) < 3.0 * ours.uc_phase


def test_what_needs_one_clock_is_not_determined_and_says_why(by_cube: Calibration, world: World, bench: Path) -> None:
    fast = fast_bench.measure({**SWEEP, "axis": "y", "points": 4, "levels": ["full"]}, world, bench=bench)
    sweep = fast_bench.measure({**SWEEP, "points": 4, "levels": ["full"]}, world, bench=bench)
    found = calibrate([sweep, fast], "both", recorder="cube").result("unit_a_x.cross_axis_y")
    assert found.value is None
    assert "clock" in found.remarks[0]


def test_a_sine_that_the_cube_cannot_show_is_left_out_and_said(by_cube: Calibration) -> None:
    assert any("what the cube's 1000 samples per second can show" in flag for flag in by_cube.flags)


def test_the_cubes_own_clock_is_found(runs: list[fast_bench.MemoryRecords], world: World) -> None:
    body = next(one for one in runs[1].points.values() if "cube" in one)
    found = frames(runs[1], body)
    samples = runs[1].samples(body["samples"])
    assert body["cube_gaps"] == 0
    # the record begins with the converter's, within the time that commands take
    assert abs(found.start - samples.start) < 0.2
    assert found.u_time < 1e-3


class Unwired:
    """A run whose converter saw nothing of the sensor; `lost` frames of the cube are gone."""

    def __init__(self, run: fast_bench.MemoryRecords, lost: slice = slice(0)) -> None:
        self._run, self._lost = run, lost
        stated = run.header["bench_file"]
        sensor = run.header["sensor"]["channels"]
        cables = {k: [f"spare {n}" if c in sensor else c for n, c in enumerate(v)] for k, v in stated["cables"].items()}
        self.header: Mapping[str, Any] = {**run.header, "bench_file": {**stated, "cables": cables}}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._run, name)

    def _renamed(self, samples: Any) -> Any:
        names = self._run.header["sensor"]["channels"]
        channels = tuple(replace(c, name=f"spare {c.slot}") if c.name in names else c for c in samples.channels)
        return replace(samples, channels=channels)

    def samples(self, name: str) -> Any:
        return self._renamed(self._run.samples(name))

    def pieces(self, name: str) -> Any:
        return (self._renamed(one) for one in self._run.pieces(name))

    def cube(self, name: str) -> CubeSamples:
        whole = self._run.cube(name)
        kept = np.ones(len(whole.sequence), bool)
        kept[self._lost] = False
        columns: Any = {n: getattr(whole, n)[kept] for n in
                        ("counts", "sequence", "device_us", "flags", "supply", "temperature")}  # fmt: skip
        return replace(whole, **columns)


def test_a_run_whose_only_recorder_of_the_sensor_is_the_cube_is_calibrated(
    runs: list[fast_bench.MemoryRecords], by_cube: Calibration
) -> None:
    made = calibrate([Unwired(run) for run in runs], "cube")
    for key in ("unit_a_x.sensitivity", "gyro_yaw.sensitivity", "unit_a_y.sensitivity_gravity", "unit_a_x.deviation"):
        assert made.result(key).value == pytest.approx(by_cube.result(key).value, rel=1e-12)
    with pytest.raises(BadInput, match="no record of the sensor by the converter"):
        calibrate([Unwired(run) for run in runs], "none", recorder="converter")


def test_lost_frames_stay_lost_and_values_stay_true(
    runs: list[fast_bench.MemoryRecords], by_cube: Calibration, world: World
) -> None:
    made = calibrate([Unwired(run, slice(400, 520)) for run in runs], "gaps", recorder="cube")
    for channel in ("unit_a_x", "gyro_yaw"):
        found, whole = made.result(f"{channel}.sensitivity"), by_cube.result(f"{channel}.sensitivity")
        assert found.value is not None
        assert abs(found.value - world.truth["sensitivity"][channel]) < 3.5 * found.u
        assert found.value != whole.value
        assert found.check is not None  # a model is fitted to what there is


def test_the_oscilloscope_can_be_asked_for() -> None:
    run = fast_bench.measure({**SWEEP, "points": 4}, fast_bench.world(22))
    by_scope, by_converter = (calibrate([run], one, assumed=None, recorder=one) for one in ("scope", "converter"))  # type: ignore[arg-type]
    one, other = (made.result("unit_a_x.sensitivity") for made in (by_scope, by_converter))
    assert "oscilloscope" in one.method
    assert one.value is not None
    assert other.value is not None
    assert 0.0 < abs(one.value - other.value) < 4.0 * apart(one, other)
    with pytest.raises(BadInput, match="no record of the sensor by the cube"):
        calibrate([run], "none", recorder="cube")


def test_a_sweep_that_only_the_oscilloscope_kept_is_calibrated_by_it(tmp_path: Path) -> None:
    path, world = tmp_path / "bench.yaml", fast_bench.world(22)
    text = fast_bench.BENCH.read_text(encoding="utf-8").replace("../", f"{fast_bench.BENCH.parents[1]}/")
    path.write_text(text.replace("[recorder, analyzer, scope]", "[scope]"), encoding="utf-8")
    document = {**SWEEP, "points": 3, "static": "0 s", "static_after": "0 s"}
    made = calibrate([fast_bench.measure(document, world, bench=path)], "alone")
    found = made.result("unit_a_x.sensitivity")
    assert found.value == pytest.approx(world.truth["sensitivity"]["unit_a_x"], abs=found.expanded)
    assert "oscilloscope" in found.method
