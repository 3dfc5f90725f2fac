"""Exports hold what the calibration holds, in the form that the reader's program wants, or are refused."""

from __future__ import annotations

import csv
import importlib.util
import json
import math
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import example_calibration
import h5py
import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.io import loadmat

from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import Calibration, ResponsePoint, Result, Source, not_determined, shown
from rig.errors import BadInput
from rig.export import FORMATS, apply, python_module, write
from rig.export.matlab import field_name
from rig.export.selection import cross_axis, yaml_float
from rig.yaml.config import shipped

CUBE: dict[str, Any] = yaml.safe_load(shipped("sensors/simulated_cube.yaml").read_text(encoding="utf-8"))

G = 9.80665
DEGREE = math.pi / 180.0
LINEAR, ANGULAR = "m/s²", "rad/s"
CROSS = [[1.0, 0.012, -0.007], [0.004, 1.0, 0.02], [-0.015, 0.009, 1.0]]
TRIADS = {
    "unit_a": ("unit_a_x", "unit_a_y", "unit_a_z"),
    "gyro": ("gyro_roll", "gyro_yaw", "gyro_pitch"),
    "backup": ("backup_roll", "backup_yaw", "backup_pitch"),
}
MOTION = {"unit_a": (1.5, 9.8, -2.25), "gyro": (0.5, -3.4907, 0.125)}


def result(channel: str, measurand: str, value: float, unit: str, relative: float = 0.004) -> Result:
    gain = Contribution("vibrometer gain", "B", "normal", relative, "1", value, source="LDV-1")
    scatter = Contribution("repeatability", "A", "t", abs(value) * 1e-4, unit, 1.0, dof=9)
    return Result(channel, measurand, measurand.replace("_", " "), value, unit, Budget((gain, scatter)), "fit", "LDV-1")


def channel_results(channel: str, place: int) -> list[Result]:
    unit = LINEAR if channel.startswith("unit") else ANGULAR
    sensitivity = (0.65 / G if unit == LINEAR else 3.6e-3 / DEGREE) * (1.0 + 0.01 * place)
    return [
        result(channel, "sensitivity", sensitivity, f"V/({unit})"),
        result(channel, "offset", 2.5 + 0.01 * place, "V", 1e-4),
        result(channel, "deviation", 0.0147 * (1.0 + 0.1 * place), unit),
        result(channel, "noise_density", 4.2e-4 * (1.0 + 0.1 * place), f"({unit})/√Hz"),
        result(channel, "random_walk", 2e-05 / (1.0 + place), f"({unit})·√Hz"),
    ]


def points() -> tuple[ResponsePoint, ...]:
    shape = [(20.0 * 1.15**k, 0.0663 / math.hypot(1.0, 0.05 * k), ("a, b", "c") if k > 20 else ()) for k in range(24)]
    return tuple(
        ResponsePoint(f, "full", 4.9, m, -0.005 * f, 1e-6, 2e-5, 3e-4, 1e-3, 0.002, "r1", flags)
        for f, m, flags in shape
    )


@pytest.fixture
def cube() -> Calibration:
    results = [r for t in ("unit_a", "gyro") for place, c in enumerate(TRIADS[t]) for r in channel_results(c, place)]
    for row, own in zip(CROSS, "xyz", strict=True):
        for value, other in zip(row, "xyz", strict=True):
            if other != own:
                results.append(result(f"unit_a_{own}", f"cross_axis_{other}", value, "1"))
    results.append(not_determined("unit_a_x", "bias_instability", "bias instability", "m/s²", "record too short, 60 s"))
    results.append(not_determined("unit_b_x", "sensitivity", "sensitivity", "V/(m/s²)", 'the "mount", loose\nagain'))
    return Calibration(
        name="cube-2026.1",
        sensor="Sensor Cube",
        serial="SIM-CUBE-1",
        made=1_700_000_000.5,
        simulated=True,
        sources=(Source("r1", "frequency_sweep", "completed", "ab" * 32, 1.7e9),),
        standards=({"name": "LDV-1", "value": 1.0},),
        conditions={"temperature": (23.1, 22.9, 23.4), "supply": (5.002, 4.999, 5.004)},
        results=tuple(results),
        responses={"unit_a_x": points()},
        unit=CUBE,
    )


def without(calibration: Calibration, *keys: str) -> Calibration:
    gone = tuple(
        not_determined(r.channel, r.measurand, r.title, r.unit, "record too short") if r.key in keys else r
        for r in calibration.results
    )
    return replace(calibration, results=gone)


def with_results(calibration: Calibration, *more: Result) -> Calibration:
    return replace(calibration, results=calibration.results + more)


def written(calibration: Calibration, format: str, folder: Path, **options: Any) -> str:
    return write(calibration, format, folder, **options)[0].read_text("utf-8")


# --- all formats


def test_every_format_writes_files_named_after_the_calibration_and_leaves_nothing_else(
    cube: Calibration, tmp_path: Path
) -> None:
    paths = [path for name in FORMATS for path in write(cube, name, tmp_path / "new" / "folder", rate=200.0)]
    assert sorted(path.name for path in paths) == sorted(p.name for p in (tmp_path / "new" / "folder").iterdir())
    assert {path.name for path in paths} == {
        "cube-2026.1.imu.yaml",
        "cube-2026.1.ros2.yaml",
        "cube-2026.1.results.csv",
        "cube-2026.1.responses.csv",
        "cube-2026.1.mat",
        "cube-2026.1.h5",
        "cube_2026_1_calibration.py",
    }
    suffixes = [suffix for one in FORMATS.values() for suffix in one.suffixes]
    assert all(any(path.name.endswith(suffix) for suffix in suffixes) for path in paths)


@pytest.mark.parametrize("name", FORMATS)
def test_the_example_calibration_can_be_written_in_every_format(name: str, tmp_path: Path) -> None:
    assumed = {"accelerometer_random_walk": 1e-5, "gyroscope_random_walk": 1e-6} if name == "kalibr" else {}
    paths = write(example_calibration.example(), name, tmp_path, rate=200.0, assumed=assumed)
    assert all(path.stat().st_size > 0 for path in paths)


@pytest.mark.parametrize("name", FORMATS)
def test_the_same_calibration_gives_the_same_bytes(name: str, cube: Calibration, tmp_path: Path) -> None:
    first, second = (write(cube, name, tmp_path / part, rate=200.0) for part in "ab")
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_says_that_the_numbers_are_simulated(name: str, cube: Calibration, tmp_path: Path) -> None:
    (simulated, *_), (real, *_) = (
        write(replace(cube, simulated=flag), name, tmp_path / str(flag), rate=200.0) for flag in (True, False)
    )
    word = b",true," if name == "csv" else b"SIMULATED"
    assert word in simulated.read_bytes()
    assert word not in real.read_bytes()


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"format": "xml"}, "found 'xml', wanted one of kalibr, ros2, csv, mat, hdf5, python"),
        ({"format": "ros2", "unit": "unit_q"}, "found 'unit_q', wanted one of unit_a, unit_b, unit_c"),
        ({"format": "ros2", "gyros": "spare"}, "found 'spare', wanted one of gyro, backup"),
        ({"format": "kalibr"}, "found no rate"),
        ({"format": "kalibr", "rate": math.inf}, "found the rate inf Hz"),
        ({"format": "kalibr", "rate": 200.0, "topic": "imu 0\nupdate_rate: 1"}, "found the topic"),
        ({"format": "kalibr", "rate": 200.0, "assumed": {"scale": 1.0}}, "found 'scale' assumed"),
        ({"format": "kalibr", "rate": 200.0, "assumed": {"gyroscope_random_walk": 0.0}}, "found 0.0 assumed"),
        ({"format": "kalibr", "rate": 200.0, "unit": "unit_b"}, "unit_b_x.noise_density"),
        ({"format": "ros2", "unit": "unit_b", "gyros": "backup"}, "found no sensitivity of unit_b or backup"),
    ],
)
def test_what_cannot_be_written_is_refused_and_no_file_appears(
    options: dict[str, Any], found: str, cube: Calibration, tmp_path: Path
) -> None:
    with pytest.raises(BadInput) as refused:
        write(cube, folder=tmp_path / "out", **options)
    assert found in str(refused.value)
    assert not (tmp_path / "out").exists()


def test_a_name_that_leads_out_of_the_folder_is_refused(cube: Calibration, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="wanted a plain file name"):
        write(replace(cube, name="../elsewhere"), "csv", tmp_path)


# --- Kalibr


def test_kalibr_gets_the_worst_axis_of_each_triad_in_its_own_keys(cube: Calibration, tmp_path: Path) -> None:
    page = written(cube, "kalibr", tmp_path, rate=200.0, topic="/imu/raw")
    assert yaml.safe_load(page) == {
        "accelerometer_noise_density": pytest.approx(5.04e-4, rel=1e-12),
        "accelerometer_random_walk": 2e-05,
        "gyroscope_noise_density": pytest.approx(5.04e-4, rel=1e-12),
        "gyroscope_random_walk": 2e-05,
        "rostopic": "/imu/raw",
        "update_rate": 200.0,
    }
    assert "serial SIM-CUBE-1" in page
    assert "# unit_a_z.noise_density: 51.39 ± 0.40 µg/√Hz" in page
    assert "ASSUMED" not in page


def test_a_random_walk_that_was_not_determined_is_refused_with_the_record_that_would_determine_it(
    cube: Calibration, tmp_path: Path
) -> None:
    short = without(cube, "gyro_yaw.random_walk")
    with pytest.raises(BadInput) as refused:
        write(short, "kalibr", tmp_path, rate=200.0)
    message = str(refused.value)
    assert "gyro_yaw.random_walk (record too short)" in message
    assert "rig noise --length 1 h" in message
    assert "assumed gyroscope_random_walk" in message
    assert list(tmp_path.iterdir()) == []


def test_an_assumed_value_is_marked_in_the_file_and_only_taken_where_none_was_determined(
    cube: Calibration, tmp_path: Path
) -> None:
    assumed = {"gyroscope_random_walk": 3e-06}
    page = written(without(cube, "gyro_yaw.random_walk"), "kalibr", tmp_path, rate=200.0, assumed=assumed)
    assert yaml.safe_load(page)["gyroscope_random_walk"] == 3e-06
    assert [line for line in page.splitlines() if "ASSUMED" in line and "gyroscope_random_walk" in line]
    with pytest.raises(BadInput, match="although it was determined"):
        write(cube, "kalibr", tmp_path / "again", rate=200.0, assumed=assumed)


def test_noise_that_kalibr_would_not_take_is_refused(cube: Calibration, tmp_path: Path) -> None:
    silent = [replace(r, value=0.0) if r.measurand == "noise_density" else r for r in cube.results]
    with pytest.raises(BadInput, match="wanted more than 0"):
        write(replace(cube, results=tuple(silent)), "kalibr", tmp_path, rate=200.0)


def test_a_value_without_its_uncertainty_is_not_handed_to_a_robot(cube: Calibration, tmp_path: Path) -> None:
    bare = [replace(r, budget=None) if r.key == "unit_a_x.sensitivity" else r for r in cube.results]
    with pytest.raises(BadInput, match="wanted its uncertainty too"):
        write(replace(cube, results=tuple(bare)), "ros2", tmp_path)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_float_in_yaml_reads_back_as_the_same_float(value: float) -> None:
    read = yaml.safe_load(yaml_float(value))
    assert isinstance(read, float)
    assert math.copysign(1.0, read) == math.copysign(1.0, value)
    assert read == value


# --- ROS 2


def leaves(tree: dict[str, Any], path: str = "") -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for name, value in tree.items():
        found += leaves(value, f"{path}{name}.") if isinstance(value, dict) else [(path + name, value)]
    return found


def test_ros_parameters_have_only_legal_types(cube: Calibration, tmp_path: Path) -> None:
    tree = yaml.safe_load(written(cube, "ros2", tmp_path))
    assert list(tree) == ["/**"]
    assert list(tree["/**"]) == ["ros__parameters"]
    for name, value in leaves(tree["/**"]["ros__parameters"]):
        kinds = {type(item) for item in value} if isinstance(value, list) else {type(value)}
        assert kinds in ({float}, {str}, {bool}), name
        assert value != [], name


def test_ros_parameters_undo_scale_bias_and_misalignment(cube: Calibration, tmp_path: Path) -> None:
    parameters = yaml.safe_load(written(cube, "ros2", tmp_path))["/**"]["ros__parameters"]
    own = parameters["linear_acceleration"]
    matrix = np.reshape(own["misalignment"], (3, 3))
    readings = (np.array(voltages("unit_a")) - own["bias"]) / own["scale"]
    assert np.linalg.solve(matrix, readings) == pytest.approx(MOTION["unit_a"], rel=1e-12)
    assert own["channels"] == list(TRIADS["unit_a"])
    assert own["scale_expanded_uncertainty"] == [cube.result(f"{c}.sensitivity").expanded for c in own["channels"]]
    assert parameters["angular_velocity"]["channels"] == ["gyro_roll", "gyro_yaw", "gyro_pitch"]
    assert parameters["angular_velocity"]["misalignment_determined"] is False
    assert "misalignment" not in parameters["angular_velocity"]


def test_ros_covariances_are_the_variance_of_the_noise_on_the_diagonal(cube: Calibration, tmp_path: Path) -> None:
    parameters = yaml.safe_load(written(cube, "ros2", tmp_path))["/**"]["ros__parameters"]
    matrix = np.reshape(parameters["linear_acceleration_covariance"], (3, 3))
    deviations = [cube.result(f"{channel}.deviation").value for channel in TRIADS["unit_a"]]
    assert np.array_equal(matrix, np.diag(np.square(deviations)))
    assert parameters["orientation_covariance"][0] == -1.0


def test_the_ros_body_frame_has_z_where_the_cube_has_y(cube: Calibration, tmp_path: Path) -> None:
    rotation = np.reshape(
        yaml.safe_load(written(cube, "ros2", tmp_path))["/**"]["ros__parameters"]["body_from_cube"], (3, 3)
    )
    assert rotation @ [1, 0, 0] == pytest.approx([1, 0, 0])
    assert rotation @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_a_triad_that_was_not_calibrated_is_declared_unknown_and_half_a_triad_is_refused(
    cube: Calibration, tmp_path: Path
) -> None:
    parameters = yaml.safe_load(written(cube, "ros2", tmp_path, gyros="backup"))["/**"]["ros__parameters"]
    assert parameters["angular_velocity_covariance"][0] == -1.0
    assert "angular_velocity" not in parameters
    with pytest.raises(BadInput, match=r"gyro_roll\.offset"):
        write(without(cube, "gyro_roll.offset"), "ros2", tmp_path)


def test_five_of_six_cross_axis_entries_are_no_matrix(cube: Calibration) -> None:
    triad = cube.under_test.triad("unit_a")
    assert cross_axis(cube, triad) == CROSS
    assert cross_axis(without(cube, "unit_a_z.cross_axis_x"), triad) is None


def alone(cube: Calibration) -> Calibration:
    """The same of a sensor with one accelerometer and one gyro."""
    kept = {name: CUBE["channels"][name] for name in ("unit_a_y", "gyro_yaw")}
    results = tuple(r for r in cube.results if r.channel in kept)
    return replace(cube, results=results, responses={}, unit={**CUBE, "channels": kept, "units": {}})


def test_a_sensor_of_single_axes_goes_into_tables_and_the_module(cube: Calibration, tmp_path: Path) -> None:
    for name in ("csv", "mat", "hdf5"):
        assert write(alone(cube), name, tmp_path)
    module = loaded(write(alone(cube), "python", tmp_path)[0])
    assert (set(module.CHANNELS), module.TRIADS) == ({"unit_a_y", "gyro_yaw"}, {})


@pytest.mark.parametrize("format", ["kalibr", "ros2"])
def test_what_needs_a_triad_says_which_axes_there_are_and_what_takes_them(
    format: str, cube: Calibration, tmp_path: Path
) -> None:
    with pytest.raises(BadInput, match="found unit_a along y alone, wanted a triad: channels along x, y and z; single"):
        write(alone(cube), format, tmp_path, rate=200.0)
    none = replace(alone(cube), unit={**CUBE, "channels": {"unit_a_y": CUBE["channels"]["unit_a_y"]}, "units": {}})
    with pytest.raises(BadInput, match="found 'gyro', wanted none: there are no gyros"):
        write(none, format, tmp_path, rate=200.0, gyros="gyro")


def test_a_calibration_from_before_the_sensor_was_kept_has_the_units_that_its_names_say(cube: Calibration) -> None:
    older = replace(cube, unit={}).under_test
    assert older.triad("gyro").names == cube.under_test.triad("gyro").names
    assert older.primary is not None
    assert older.primary.names == ("unit_a_x", "unit_a_y", "unit_a_z")


# --- CSV


def test_the_table_reads_back_to_the_same_floats(cube: Calibration, tmp_path: Path) -> None:
    results, _ = write(cube, "csv", tmp_path)
    assert len(results.read_bytes().split(b"\r\n")) == 1 + len(cube.results) + 1
    with results.open(newline="", encoding="utf-8") as file:
        rows = {row["key"]: row for row in csv.DictReader(file)}
    assert list(rows) == [r.key for r in cube.results]
    for r in cube.results:
        row = rows[r.key]
        if r.value is not None:
            read = [float(row[name]) for name in ("value", "u", "dof", "k", "U")]
            assert read == [r.value, r.u, r.dof, r.coverage_factor, r.expanded]
            assert (float(row["shown_value"]), float(row["shown_U"]), row["shown_unit"]) == shown(r)
        assert (row["unit"], row["status"], row["remarks"]) == (r.unit, r.status, "; ".join(r.remarks))


def test_what_was_not_determined_has_a_reason_and_no_number(cube: Calibration, tmp_path: Path) -> None:
    with write(cube, "csv", tmp_path)[0].open(newline="", encoding="utf-8") as file:
        (row,) = (row for row in csv.DictReader(file) if row["key"] == "unit_a_x.bias_instability")
    assert [row[name] for name in ("value", "u", "dof", "k", "U", "shown_value", "shown_U")] == [""] * 7
    assert row["remarks"] == "record too short, 60 s"


def test_the_table_of_responses_has_a_row_a_point(cube: Calibration, tmp_path: Path) -> None:
    with write(cube, "csv", tmp_path)[1].open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["magnitude"]) for row in rows] == [p.magnitude for p in points()]
    assert {row["channel"] for row in rows} == {"unit_a_x"}
    assert rows[-1]["flags"] == "a, b; c"


# --- MAT and HDF5


def test_the_mat_file_reads_back_to_the_same_numbers(cube: Calibration, tmp_path: Path) -> None:
    found = loadmat(write(cube, "mat", tmp_path)[0], simplify_cells=True)["calibration"]
    assert (found["name"], found["serial"], bool(found["simulated"])) == (cube.name, cube.serial, True)
    for r in cube.results:
        entry = found["channels"][r.channel][r.measurand]
        assert np.array_equal(
            [entry[n] for n in ("value", "u", "dof", "k", "expanded")],
            [math.nan if r.value is None else r.value, r.u, r.dof, r.coverage_factor, r.expanded],
            equal_nan=True,
        ), r.key
        assert entry["unit"] == r.unit
    assert np.array_equal(found["responses"]["unit_a_x"]["phase"], [p.phase for p in points()])
    assert np.array_equal(found["conditions"]["supply"], cube.conditions["supply"])
    assert np.array_equal(found["covariance"]["sensitivity"], cube.covariance(list(found["covariance"]["keys"])))


def test_names_become_legal_matlab_fields_or_are_refused() -> None:
    assert field_name("cross_axis_x") == "cross_axis_x"
    assert field_name("3.5 Hz") == "x3_5_Hz"
    with pytest.raises(BadInput, match="at most 63"):
        field_name("n" * 64)


def test_two_channels_that_matlab_would_name_alike_are_refused(cube: Calibration, tmp_path: Path) -> None:
    twins = with_results(cube, result("a-b", "offset", 1.0, "V"), result("a_b", "offset", 1.0, "V"))
    with pytest.raises(BadInput, match="call 'a_b'"):
        write(twins, "mat", tmp_path)


def test_hdf5_holds_values_with_units_responses_and_the_covariance(cube: Calibration, tmp_path: Path) -> None:
    with h5py.File(write(cube, "hdf5", tmp_path)[0], "r") as file:
        assert (file.attrs["name"], file.attrs["serial"], bool(file.attrs["simulated"])) == (
            cube.name,
            cube.serial,
            True,
        )
        for r in cube.results:
            entry = file[f"channels/{r.channel}/{r.measurand}"]
            assert np.array_equal(entry[()], math.nan if r.value is None else r.value, equal_nan=True)
            assert (entry.attrs["unit"], entry.attrs["status"], list(entry.attrs["remarks"])) == (
                r.unit,
                r.status,
                list(r.remarks),
            )
            assert entry.attrs.get("u", math.nan) == pytest.approx(r.u, rel=0, nan_ok=True)
        response = file["responses/unit_a_x"]
        assert np.array_equal(response["magnitude"], [p.magnitude for p in points()])
        assert dict(zip(response.dtype.names, response.attrs["units"], strict=True))["magnitude"] == "V/(m/s²)"
        matrix = file["covariance/sensitivity"]
        assert np.array_equal(matrix[()], cube.covariance(list(matrix.attrs["keys"])))
        budget = file["budgets/unit_a_x/sensitivity"]
        assert [name.decode() for name in budget["name"]] == ["vibrometer gain", "repeatability"]
        assert list(budget["u"]) == [c.u for c in cube.result("unit_a_x.sensitivity").contributions]


def test_sensitivities_measured_against_one_reference_are_correlated_in_the_file(
    cube: Calibration, tmp_path: Path
) -> None:
    with h5py.File(write(cube, "hdf5", tmp_path)[0], "r") as file:
        matrix = file["covariance/sensitivity"][()]
    deviations = np.sqrt(np.diag(matrix))
    assert np.all(matrix / np.outer(deviations, deviations) > 0.99)


# --- the Python module


def voltages(triad: str, cross: Sequence[Sequence[float]] = CROSS) -> list[float]:
    """What the channels of the made-up cube put out in MOTION, V."""
    nominal = 0.65 / G if triad == "unit_a" else 3.6e-3 / DEGREE
    matrix = cross if triad == "unit_a" else np.eye(3)
    seen = np.asarray(matrix) @ MOTION[triad]
    return [nominal * (1.0 + 0.01 * k) * value + 2.5 + 0.01 * k for k, value in enumerate(seen)]


def counts(volts: float) -> int:
    return round((volts + 10.0) / 20.0 * 65535.0)


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def exported(cube: Calibration, tmp_path: Path) -> ModuleType:
    return loaded(write(cube, "python", tmp_path)[0])


def test_the_module_turns_raw_counts_into_the_truth_without_anything_installed(
    cube: Calibration, tmp_path: Path
) -> None:
    path = write(cube, "python", tmp_path)[0]
    raw = {triad: [[counts(v)] * 2 for v in voltages(triad)] for triad in MOTION}
    program = (
        f"import json, sys; sys.path.insert(0, {str(tmp_path)!r}); import {path.stem} as cube; raw = {raw!r}\n"
        "print(json.dumps({t: cube.apply_triad(t, [cube.counts_to_volts(c) for c in raw[t]]) for t in raw}))\n"
        "assert not {'numpy', 'yaml', 'rig'} & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-I", "-S", "-c", program], capture_output=True, text=True, check=True)
    for triad, axes in json.loads(done.stdout).items():
        step = 20.0 / 65535.0 / (0.65 / G if triad == "unit_a" else 3.6e-3 / DEGREE)
        for samples, truth in zip(axes, MOTION[triad], strict=True):
            assert samples == pytest.approx([truth] * 2, abs=0.55 * step)


@pytest.mark.parametrize("form", [float, lambda v: [v], lambda v: (v, v), lambda v: np.full((2, 3), v)])
def test_floats_lists_and_arrays_give_the_same_numbers(form: Callable[[float], Any], exported: ModuleType) -> None:
    volts = voltages("unit_a")
    got = exported.apply_triad("unit_a", [form(v) for v in volts])
    for samples, truth in zip(got, MOTION["unit_a"], strict=True):
        assert np.shape(samples) == np.shape(form(1.0))
        assert np.asarray(samples) == pytest.approx(truth, rel=1e-12)


def test_counts_become_the_volts_of_the_record(exported: ModuleType) -> None:
    assert exported.counts_to_volts([0, 65535]) == [-10.0, 10.0]
    assert exported.counts_to_volts(np.array([0, 65535], np.uint16), 0.0, 5.0).tolist() == [0.0, 5.0]


def test_without_a_cross_axis_matrix_each_axis_is_applied_alone(cube: Calibration, tmp_path: Path) -> None:
    module = loaded(write(without(cube, "unit_a_z.cross_axis_x"), "python", tmp_path)[0])
    assert module.CROSS_AXIS["unit_a"] is None
    straight = voltages("unit_a", np.eye(3).tolist())
    assert module.apply_triad("unit_a", straight) == pytest.approx(list(MOTION["unit_a"]), rel=1e-12)


def test_the_uncertainty_travels_with_the_numbers(cube: Calibration, exported: ModuleType) -> None:
    wanted = cube.result("gyro_yaw.sensitivity")
    found = exported.UNCERTAINTY["gyro_yaw"]["sensitivity"]
    assert (found["u"], found["k"], found["expanded"]) == (wanted.u, wanted.coverage_factor, wanted.expanded)
    assert exported.PROVENANCE["simulated"] is True
    assert "SIMULATED" in (exported.__doc__ or "")
    assert "unit_a_x.sensitivity: 650.0 ± 5.1 mV/g" in (exported.__doc__ or "")


def test_a_ratiometric_channel_follows_its_supply(cube: Calibration, tmp_path: Path) -> None:
    module = loaded(write(with_results(cube, result("gyro_yaw", "supply_ratio", 1.0, "1")), "python", tmp_path)[0])
    volts = voltages("gyro")[1]
    supplies = [5.002, 4.9, 5.1]
    seen = [volts * supply / 5.002 for supply in supplies]
    assert module.apply("gyro_yaw", seen, supply=supplies) == pytest.approx([MOTION["gyro"][1]] * 3, rel=1e-12)
    assert module.apply("gyro_yaw", seen[1], supply=4.9) == pytest.approx(MOTION["gyro"][1], rel=1e-12)


@pytest.mark.parametrize(
    ("call", "found"),
    [
        (lambda m: m.apply("unit_a_x", 2.5, supply=5.0), "its influence was not determined"),
        (lambda m: m.apply("unit_b_x", 2.5), 'the "mount", loose again'),
        (lambda m: m.apply("unit_d_x", 2.5), "found the channel 'unit_d_x'"),
        (lambda m: m.apply_triad("unit_b", (2.5, 2.5, 2.5)), "found the triad 'unit_b'"),
    ],
)
def test_the_module_refuses_what_it_does_not_know(
    call: Callable[[ModuleType], Any], found: str, exported: ModuleType
) -> None:
    with pytest.raises(ValueError, match=found):
        call(exported)


def test_a_calibration_without_any_zero_output_makes_no_module(cube: Calibration, tmp_path: Path) -> None:
    bare = without(cube, *(r.key for r in cube.of("offset")))
    with pytest.raises(BadInput, match="rig noise"):
        write(bare, "python", tmp_path)


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=40), st.text(max_size=40))
@example('"""\nimport os', "x")
@example("\\N{x}", "back\\")
@example("a\nb\x00\u2028", '"')
def test_no_text_in_a_calibration_can_leave_its_place_in_the_module(serial: str, remark: str) -> None:
    plain = result("unit_a_x", "sensitivity", 0.066, "V/(m/s²)")
    made = Calibration(
        name="c", sensor=serial, serial=serial, made=0.0, simulated=False, sources=(), standards=(), conditions={},
        results=(replace(plain, status="flagged", remarks=(remark,)), result("unit_a_x", "offset", 2.5, "V")),
        flags=(remark,),
    )  # fmt: skip
    (source,) = python_module.files(made, python_module.Choice()).values()
    module: dict[str, Any] = {}
    exec(compile(source, "c_calibration.py", "exec"), module)
    assert module["PROVENANCE"]["serial"] == serial
    assert module["apply"]("unit_a_x", 2.566) == pytest.approx(1.0)


@given(st.lists(st.floats(-0.2, 0.2), min_size=9, max_size=9))
def test_the_inverse_undoes_the_matrix(small: list[float]) -> None:
    matrix = np.eye(3) + np.reshape(small, (3, 3))
    assert np.array(apply.inverse(matrix.tolist())) @ matrix == pytest.approx(np.eye(3), abs=1e-12)
