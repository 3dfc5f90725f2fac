"""Foreign files come in to the bit, in every format; what is wrong with them is found, said and not mended."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import foreign_data as made
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.archive.records import Records
from rig.archive.runs import Runs
from rig.errors import BadInput, ConfigError
from rig.foreign import readers as foreign_files
from rig.foreign.guessing import guess
from rig.foreign.importing import Read, keep, open_manifest
from rig.foreign.readers import Csv, columns
from rig.foreign.tables import foreign_of
from rig.foreign.text_dialects import written

Array = NDArray[np.float64]
QUICK = settings(deadline=None, max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
SMALL = {"t_s": np.arange(5) * 0.01, "w": np.array([1.0, -2.5, 1e-17, math.pi, 1e300])}


def opened(folder: Path, text: str, data: Mapping[str, Array]) -> Read:
    """A manifest and its one file `d.csv`, read."""
    (folder / "d.csv").write_bytes(made.csv_bytes(data))
    (folder / "m.yaml").write_text(text, encoding="utf-8")
    return open_manifest(folder / "m.yaml")


def kinds(read: Read) -> list[str]:
    return [one.kind for one in read.found]


def turning(folder: Path, data: Mapping[str, Array], **how: str) -> Read:
    return opened(folder, made.turning_manifest("d.csv", **how), data)


# ---- files


@pytest.mark.parametrize(
    ("form", "raw", "names"),
    [
        ("csv", made.csv_bytes(SMALL), ("t_s", "w")),
        ("csv", b"# by hand\n" + made.csv_bytes(SMALL, ";"), ("t_s", "w")),
        ("csv", made.csv_bytes(SMALL, "\t"), ("t_s", "w")),
        ("csv", made.csv_bytes(SMALL, " "), ("t_s", "w")),
        ("csv", made.csv_bytes(SMALL, ";", comma=True), ("t_s", "w")),
        ("npz", made.npz_bytes(SMALL), ("t_s", "w")),
        ("npy", made.npy_bytes(SMALL), ("array[0]", "array[1]")),
        ("mat", made.mat_bytes(SMALL), ("t_s", "w")),
        ("mat", made.mat_bytes({"imu": {"t": SMALL["t_s"], "w": np.stack([SMALL["w"]] * 3)}}), ("imu.t", "imu.w[1,:]")),
        ("hdf5", made.hdf5_bytes(SMALL), ("imu/t_s", "imu/w")),
    ],
)
def test_numbers_come_in_to_the_bit(form: foreign_files.Format, raw: bytes, names: tuple[str, ...]) -> None:
    how = written(raw) if form == "csv" else Csv()
    assert columns(raw, form, names, how).tobytes() == np.column_stack(list(SMALL.values())).tobytes()
    assert set(names) <= set(foreign_files.names(raw, form, how))


@given(st.lists(st.floats(), min_size=1, max_size=20))
def test_any_number_that_is_written_is_read(values: list[float]) -> None:
    raw = ("x,note\n" + "".join(f"{value!r},text\n" for value in values)).encode()
    assert np.array_equal(columns(raw, "csv", ["x"])[:, 0], np.array(values), equal_nan=True)


def test_an_empty_cell_is_no_number_and_a_wrong_one_is_named_by_its_line() -> None:
    found = columns(b"a,b\n1,\n# remark\n2,NA\n3,4\n", "csv", ["b"])[:, 0]
    assert np.array_equal(found, [np.nan, np.nan, 4.0], equal_nan=True)
    with pytest.raises(BadInput, match="line 4: found 'x' in column 'b', wanted a number"):
        columns(b"a,b\n1,2\n# remark\n2,x\n", "csv", ["b"])
    with pytest.raises(BadInput, match="decimal comma"):
        columns(b"a;b\n1,5;2\n", "csv", ["a"], Csv(";"))


@pytest.mark.parametrize("form", ["npy", "npz", "mat", "hdf5"])
@given(raw=st.binary(max_size=300))
@QUICK
def test_bytes_that_are_no_such_file_are_refused(form: foreign_files.Format, raw: bytes) -> None:
    with pytest.raises(BadInput):
        columns(raw, form, ["x"])


def test_a_big_text_file_is_read_within_a_second(tmp_path: Path) -> None:
    import time  # the processor's: others may keep it busy

    data = {name: np.random.default_rng(0).normal(size=40_000) for name in "abcdefg"}
    raw = made.csv_bytes(data)
    begun = time.process_time()
    columns(raw, "csv", ["a", "g"])
    assert len(raw) > 5_000_000
    assert time.process_time() - begun < 2.0


# ---- runs


def test_a_run_holds_what_the_file_held_and_reads_back(tmp_path: Path) -> None:
    data = made.turning(seconds=20.0)
    read = turning(tmp_path, data)
    runs = Runs(tmp_path / "runs")
    name = keep(read, runs)
    run = runs.open(name)
    assert (run.status, run.verify()) == ("completed", [])
    back = foreign_of(Records(run))
    assert back.manifest == read.manifest
    table = back.tables[0]
    for column in ("t_s", "gyro_z_dps"):
        assert table.of(column).tobytes() == data[column].tobytes()
    assert run.header["manifest"]["text"] == (tmp_path / "m.yaml").read_text(encoding="utf-8")


def test_findings_are_in_the_journal(tmp_path: Path) -> None:
    data = made.turning(seconds=20.0)
    data["gyro_z_dps"] *= -1.0
    read = turning(tmp_path, data)
    runs = Runs(tmp_path / "runs")
    found = foreign_of(Records(runs.open(keep(read, runs)))).found
    assert [one.as_json() for one in found] == [one.as_json() for one in read.found]
    assert [(one.channel, one.manifest_line is not None) for one in found] == [("gyro_z_dps", True)]
    assert "gyro_z_dps counts against the reference" in found[0].text


def test_nothing_is_written_if_a_file_or_a_column_is_missing(tmp_path: Path) -> None:
    data = made.turning(seconds=5.0)
    del data["gyro_x_dps"]
    with pytest.raises(
        ConfigError, match=r"m.yaml:11:12 columns\[1\].column: d.csv: found no column 'gyro_x_dps'.*did"
    ):
        turning(tmp_path, data)
    (tmp_path / "d.csv").unlink()
    with pytest.raises(ConfigError, match=r"m.yaml:6:16 files\[0\].path: found 'd.csv' .* unreadable"):
        open_manifest(tmp_path / "m.yaml")
    assert not (tmp_path / "runs").exists()


def test_a_segment_past_the_end_is_refused(tmp_path: Path) -> None:
    text = made.turning_manifest("d.csv") + "segments: [{first: 0, last: 100000}]\n"
    with pytest.raises(ConfigError, match="found row 100000, wanted at most 500"):
        opened(tmp_path, text, made.turning(seconds=5.0))


# ---- what is wrong with them


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_found_in_clean_data(tmp_path: Path, seed: int) -> None:
    assert turning(tmp_path, made.turning(seed=seed)).found == ()
    assert opened(tmp_path, made.tracked_manifest("d.csv"), made.tracked()).found == ()
    assert opened(tmp_path, made.responding_manifest("d.csv"), made.responding()).found == ()
    for frequency in (5.0, 37.0):
        text = made.shaken_manifest("d.csv", "mains: 60 Hz\n", f"frequency: {frequency} Hz")
        assert opened(tmp_path, text, made.shaken(frequency)).found == ()


@given(st.integers(100, 5000), st.integers(2, 300))
@QUICK
def test_missing_rows_are_found_and_counted(tmp_path: Path, first: int, count: int) -> None:
    data = {name: np.delete(v, slice(first, first + count)) for name, v in made.turning().items()}
    read = turning(tmp_path, data)
    assert kinds(read) == ["time_gaps"]
    assert f"about {count} samples are missing" in read.found[0].text
    assert f"before row {first}" in read.found[0].text


@given(st.sets(st.integers(10, 5900), min_size=1, max_size=5))
@QUICK
def test_time_stamps_that_are_there_twice_are_found(tmp_path: Path, rows: set[int]) -> None:
    data = made.turning()
    for row in sorted(rows):
        data["t_s"][row] = data["t_s"][row - 1]
    found = {one.kind: one.text for one in turning(tmp_path, data).found}
    assert f"row{'' if len(rows) == 1 else 's'} {min(rows)}" in found["time_duplicates"]
    assert "missing" not in found.get("time_gaps", "")


@given(st.integers(10, 5900), st.floats(0.05, 5.0))
@QUICK
def test_time_that_runs_backwards_is_found(tmp_path: Path, row: int, back: float) -> None:
    data = made.turning()
    data["t_s"][row:] -= back
    found = {one.kind: one.text for one in turning(tmp_path, data).found}
    assert any(f"at row {row}, the first" in found.get(kind, "") for kind in ("time_backwards", "time_set_back"))


def test_jitter_is_found_unless_it_is_stated(tmp_path: Path) -> None:
    data = made.turning()
    data["t_s"] = data["t_s"] + 2e-4 * np.random.default_rng(1).normal(size=len(data["t_s"]))
    read = turning(tmp_path, data)
    assert kinds(read) == ["time_jitter"]
    assert read.found[0].text.startswith(("time stamps jitter by 19", "time stamps jitter by 20"))
    assert turning(tmp_path, data, time="{column: t_s, unit: s, jitter: 0.5 ms}").found == ()


@given(st.integers(0, 5000), st.integers(1, 400))
@QUICK
def test_stretches_without_numbers_are_found(tmp_path: Path, first: int, count: int) -> None:
    data = made.turning()
    for name in ("gyro_x_dps", "gyro_z_dps"):
        data[name][first : first + count] = np.nan
    read = turning(tmp_path, data)
    share = f"gyro_x_dps, gyro_z_dps: {count} of 6000 rows are not numbers"
    assert [one.text for one in read.found] == [f"{share}, in 1 stretch, the longest {count} rows from row {first}"]


@given(st.sets(st.integers(0, 5999), min_size=1, max_size=4))
@QUICK
def test_rows_of_zeros_are_found(tmp_path: Path, rows: set[int]) -> None:
    data = made.turning()
    for name in made.TURNING:
        data[name][list(rows)] = 0.0
    found = {one.kind: one.text for one in turning(tmp_path, data).found}
    listed = ", ".join(str(row) for row in sorted(rows)[:3])
    assert f"all zeros: row{'' if len(rows) == 1 else 's'} {listed}" in found["zeros"]


@given(st.integers(100, 5000), st.integers(60, 500))
@QUICK
def test_a_frozen_channel_is_found(tmp_path: Path, first: int, count: int) -> None:
    data = made.turning()
    data["gyro_z_dps"][first : first + count] = data["gyro_z_dps"][first]
    found = {one.kind: one.text for one in turning(tmp_path, data).found}
    assert f"the longest {count} rows from row {first}" in found["frozen"]


@given(st.integers(100, 5000), st.integers(10, 200))
@QUICK
def test_whole_rows_that_repeat_are_found(tmp_path: Path, first: int, count: int) -> None:
    data = made.turning()
    for name in made.TURNING:
        data[name][first : first + count] = data[name][first]
    found = {one.kind: one.text for one in turning(tmp_path, data).found}
    assert f"the longest {count} rows from row {first}" in found["rows_repeat"]


@given(st.floats(60.0, 115.0))
@QUICK
def test_a_range_that_is_exceeded_is_found(tmp_path: Path, limit: float) -> None:
    data = made.turning()
    data["gyro_z_dps"] = np.clip(data["gyro_z_dps"], -limit, limit)
    assert kinds(turning(tmp_path, data)).count("clipped") == 2


def test_an_encoder_may_rest_while_gyros_make_noise(tmp_path: Path) -> None:
    data = made.turning()
    t = np.maximum(data["t_s"] - 20.0, 0.0) + np.minimum(data["t_s"], 10.0)  # stands still from 10 s to 20 s
    rate = ((data["t_s"] < 10.0) | (data["t_s"] > 20.0)) * 66.0 * np.cos(1.1 * t)
    data["encoder_deg"] = np.round(60.0 * np.sin(1.1 * t) / 0.1) * 0.1
    data["gyro_z_dps"] = rate + 5.0 * np.random.default_rng(1).normal(size=len(t))
    assert turning(tmp_path, data).found == ()


def test_coarse_steps_are_neither_frozen_nor_clipped(tmp_path: Path) -> None:
    data = made.turning()
    for name in ("acc_x_g", "acc_y_g", "acc_z_g"):
        data[name] = np.round(data[name] / 0.05) * 0.05
    assert turning(tmp_path, data).found == ()


@pytest.mark.parametrize(
    ("factor", "unit", "said"),
    [
        (math.pi / 180.0, "°/s", "gyro_z_dps in rad/s instead of °/s"),
        (180.0 / math.pi, "rad/s", "gyro_z_dps in °/s instead of rad/s"),
        (1000.0, "°/s", "time in"),
        (2.0, "°/s", "a factor of two is a sensitivity setting"),
    ],
)
def test_a_gyro_in_another_unit_than_stated_is_found(tmp_path: Path, factor: float, unit: str, said: str) -> None:
    data = made.turning()
    data["gyro_z_dps"] *= factor if unit == "°/s" else 1.0
    text = made.turning_manifest("d.csv").replace("unit: °/s, axis: z", f"unit: {unit}, axis: z")
    if factor == 1000.0:
        data["gyro_z_dps"] /= factor
        data["t_s"] *= factor
    read = opened(tmp_path, text, data)
    assert any(one.kind == "unit" and said in one.text for one in read.found), read.found


@pytest.mark.parametrize(("written_in", "stated"), [(9.80665, "g"), (1.0, "m/s²"), (1000.0, "g")])
def test_accelerometers_in_another_unit_than_stated_are_found(tmp_path: Path, written_in: float, stated: str) -> None:
    data = made.turning()
    for name in ("acc_x_g", "acc_y_g", "acc_z_g"):
        data[name] *= written_in
    read = opened(tmp_path, made.turning_manifest("d.csv").replace("unit: g", f"unit: {stated}"), data)
    right = {9.80665: "m/s²", 1.0: "g", 1000.0: "mg"}[written_in]
    assert kinds(read) == ["unit"]
    assert f"it would fit with {stated} being {right}" in read.found[0].text


def test_a_stated_sense_of_rotation_is_held_against_the_data(tmp_path: Path) -> None:
    text = made.turning_manifest("d.csv").replace("upright: true", "upright: true, sense: -1")
    assert kinds(opened(tmp_path, text, made.turning())) == ["sign"]
    data = made.turning()
    data["gyro_z_dps"] *= -1.0
    assert opened(tmp_path, text, data).found == ()


@given(st.sampled_from([-1.0, 1.0]), st.floats(4e-4, 3e-3))
@QUICK
def test_clocks_that_differ_are_found(tmp_path: Path, sign: float, ratio: float) -> None:
    data = made.turning()
    t = data["t_s"] * (1.0 + sign * ratio)
    data["gyro_z_dps"] = 66.0 * np.cos(1.1 * t) + 72.5 * np.cos(2.9 * t + 0.4)
    found = {one.kind: one.text for one in turning(tmp_path, data).found}
    said = float(found["clock"].split("differ by ")[1].removesuffix(" ppm"))
    assert said == pytest.approx(-sign * ratio * 1e6, rel=0.1)


@pytest.mark.parametrize("axis", "xyz")
def test_an_axis_that_counts_against_a_pose_track_is_found(tmp_path: Path, axis: str) -> None:
    data = made.tracked()
    data[f"gyro_{axis}"] *= -1.0
    read = opened(tmp_path, made.tracked_manifest("d.csv"), data)
    assert [(one.kind, one.channel) for one in read.found] == [("frame", f"gyro_{axis}")]
    assert f"gyro_{axis} shows −{axis} (a left-handed triad)" in read.found[0].text


def test_quaternions_the_other_way_round_are_found(tmp_path: Path) -> None:
    read = opened(tmp_path, made.tracked_manifest("d.csv", "world_to_body"), made.tracked())
    assert any("the attitude fits the gyros as 'body_to_world'" in one.text for one in read.found)


def test_the_polarity_of_a_response_is_found(tmp_path: Path) -> None:
    read = opened(tmp_path, made.responding_manifest("d.csv"), made.responding(math.pi))
    assert kinds(read) == ["polarity"]


def test_a_response_in_degrees_is_found(tmp_path: Path) -> None:
    data = made.responding()
    data["phase"] = np.degrees(data["phase"])
    read = opened(tmp_path, made.responding_manifest("d.csv"), data)
    assert any("it would fit with ° instead of rad" in one.text for one in read.found)


@given(st.floats(-0.04, 0.06).filter(lambda off: abs(off) > 4e-3), st.booleans())
@QUICK
def test_mains_lines_tell_the_drives_clock_from_the_recorders(tmp_path: Path, off: float, drive: bool) -> None:
    scale = 1.0 + off
    # 7 Hz: harmonics of 5 Hz would hide the mains, and so would those of 6.67 Hz
    data = made.shaken(7.0 * scale, mains=60.0 if drive else 60.0 * scale)
    read = opened(tmp_path, made.shaken_manifest("d.csv", "mains: 60 Hz\n", "frequency: 7 Hz"), data)
    assert kinds(read) == ["frequency"]
    assert ("so the drive is off, not the recorder" if drive else "the recorder's clock is off") in read.found[0].text


def test_without_mains_nobody_knows_whose_clock_is_off(tmp_path: Path) -> None:
    read = opened(tmp_path, made.shaken_manifest("d.csv"), made.shaken(5.2))
    assert "commanded 5 Hz, found 5.2 Hz (+4 %)" in read.found[0].text
    assert "nothing here tells whether the drive or the recorder is off" in read.found[0].text


@pytest.mark.parametrize(
    ("change", "kind"),
    [
        (lambda d: d | {"board": -d["board"]}, "sign"),
        (lambda d: d | {"board": d["board"] / 9.80665}, "unit"),
        (lambda d: d | {"board": made.shaken(5.05)["board"]}, "clock"),
    ],
)
def test_the_device_of_a_sweep_is_held_against_its_reference(
    tmp_path: Path, change: Callable[[dict[str, Array]], dict[str, Array]], kind: str
) -> None:
    assert kinds(opened(tmp_path, made.shaken_manifest("d.csv"), change(made.shaken()))) == [kind]


def test_the_same_file_twice_is_found(tmp_path: Path) -> None:
    text = made.turning_manifest("d.csv").replace("[{path: d.csv}]", "[{path: d.csv}, {path: e.csv}]")
    (tmp_path / "e.csv").write_bytes(made.csv_bytes(made.turning()))
    assert kinds(opened(tmp_path, text, made.turning())) == ["same_file"]


# ---- drafts


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (made.turning(), "rotation"),
        (made.tracked(), "motion"),
        (made.responding(), "response"),
        ({f"acc_{name}_m_s2": values for name, values in made.shaken().items() if name != "drive_V"}, "sweep"),
    ],
)
def test_a_draft_tells_the_kind_and_loads_once_it_is_filled_in(
    tmp_path: Path, data: Mapping[str, Array], kind: str
) -> None:
    (tmp_path / "d.csv").write_bytes(made.csv_bytes(data))
    draft = guess(tmp_path / "d.csv", tmp_path)
    assert draft.kind == kind
    (tmp_path / "m.yaml").write_text(filled(draft.text), encoding="utf-8")
    assert open_manifest(tmp_path / "m.yaml").manifest.kind == kind


def filled(text: str) -> str:
    """A draft after the person: what only they know."""
    for key, value in (("serial", "A1"), ("source", "here"), ("licence", "MIT"), ("rate", "1000 Hz")):
        text = text.replace(f'{key}: ""', f"{key}: {value}")
    si = {"rate": "rad/s", "acceleration": "m/s²", "position": "m", "angle": "rad"}
    for line in text.splitlines():
        for quantity, unit in si.items():
            if f"quantity: {quantity}," in line:
                done = line.replace('unit: ""', f"unit: {unit}")
                text = text.replace(line, done.replace('sensitivity: ""', f"sensitivity: 415 counts per {unit}"))
    return text


def test_a_unit_that_neither_name_nor_numbers_tell_is_left_to_the_person(tmp_path: Path) -> None:
    data = {"t": made.turning()["t_s"], "gyro_z": made.turning()["gyro_x_dps"]}
    (tmp_path / "d.csv").write_bytes(made.csv_bytes(data))
    draft = guess(tmp_path / "d.csv", tmp_path)
    assert "unit of gyro_z" in draft.to_fill
    assert '{column: gyro_z, quantity: rate, unit: "", axis: z}' in draft.text


@given(st.sampled_from(",;\t| "), st.booleans(), st.booleans())
@QUICK
def test_a_draft_tells_how_a_text_file_is_written(delimiter: str, header: bool, comma: bool) -> None:
    raw = made.csv_bytes(made.turning(seconds=1.0), delimiter, comma and delimiter != ",")
    raw = raw if header else raw.partition(b"\n")[2]
    how = written(raw)
    assert (how.delimiter, how.header, how.decimal) == (delimiter, header, "," if comma and delimiter != "," else ".")


REAL = (
    ("ptb-cem-mpu9250-shaker/MPU9250_PTB.csv", "response"),
    ("uiuc-mpu6050-encoder/yaw_medium_120s.csv", "rotation"),
    ("broad-imu-optitrack/07_undisturbed_fast_rotation_B_60s.csv", "motion"),
    ("imu-tk-xsens-multiposition/xsens_acc_gyro_raw.csv", "poses"),
    ("imucal-ferraris/example_ferraris_session.csv", "poses"),
    ("artslab-shaker-pcb/amplitude_5_impact_0.0_vibration_0.5.csv", "sweep"),
)


@pytest.mark.parametrize(("name", "kind"), REAL)
def test_a_draft_of_real_data_needs_only_what_it_asks_for(tmp_path: Path, name: str, kind: str) -> None:
    draft = guess(made.real(name), made.REAL)
    assert draft.kind == kind
    (tmp_path / "m.yaml").write_text(filled(draft.text), encoding="utf-8")
    assert open_manifest(tmp_path / "m.yaml", made.REAL).manifest.kind == kind


EUROC = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],"
    "a_RS_S_z [m s^-2]\n"
)


def test_a_header_behind_a_comment_sign_is_one(tmp_path: Path) -> None:
    rows = "".join(f"{1403636579758555392 + k * 5000000},0.1,0.2,0.3,9.{k % 9},0.1,0.2\n" for k in range(100))
    (tmp_path / "d.csv").write_text(EUROC + rows, encoding="utf-8")
    draft = guess(tmp_path / "d.csv", tmp_path)
    assert draft.to_fill == ("unit.serial", "provenance.source", "provenance.licence")
    (tmp_path / "m.yaml").write_text(filled(draft.text), encoding="utf-8")
    read = open_manifest(tmp_path / "m.yaml")
    assert [(one.quantity, one.unit, one.axis) for one in read.manifest.columns][2:4] == [
        ("rate", "rad/s", "z"),
        ("acceleration", "m/s²", "x"),
    ]


@pytest.mark.parametrize(
    ("raw", "ending"),
    [(made.npz_bytes(made.turning()), "npz"), (made.hdf5_bytes(made.turning()), "h5"), (made.npy_bytes(SMALL), "npy")],
)
def test_a_draft_of_an_array_file_needs_only_what_it_asks_for(tmp_path: Path, raw: bytes, ending: str) -> None:
    path = tmp_path / f"d.{ending}"
    path.write_bytes(raw)
    draft = guess(path, tmp_path)
    if "a column of the device" not in draft.to_fill:
        (tmp_path / "m.yaml").write_text(filled(draft.text), encoding="utf-8")
        assert open_manifest(tmp_path / "m.yaml").manifest.kind == "rotation"
    else:
        assert "# left out: array[0]: the name says no quantity" in draft.text
