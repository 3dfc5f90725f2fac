"""Text files as loggers write them: where the table begins, what its units are, and what is no number in it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import foreign_data as made
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.errors import BadInput, ConfigError
from rig.foreign.guessing import guess
from rig.foreign.importing import Read, open_manifest
from rig.foreign.readers import Csv, columns, names, read
from rig.foreign.text_dialects import written
from rig.foreign.text_files import units

Array = NDArray[np.float64]
AXES = "xyz"
NANOSECONDS = 1_700_000_000_000_000_000


def resting() -> dict[str, Array]:
    """t_s, acc_…_g, gyro_…_dps of 600 rows."""
    return {name: values[:600] for name, values in made.resting().items()}


def table(
    head: str, data: Mapping[str, Array], delimiter: str = ",", before: str = "", comma: bool = False, end: str = ""
) -> str:
    """Lines of a file: what stands before, its head, and rows that all end with `end`."""
    rows = (delimiter.join(f"{value:.9g}" for value in row) for row in np.column_stack(list(data.values())))
    lines = [(row.replace(".", ",") if comma else row) + end for row in rows]
    return "\n".join([before + head, *lines, ""])


def lvm() -> str:
    data = {name: resting()[name] for name in ("t_s", "acc_x_g", "acc_y_g", "acc_z_g")}
    before = (
        "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\tOne\n***End_of_Header***\t\n\t\n"
        "Channels\t3\t\nSamples\t600\t600\t600\t\nY_Unit_Label\tg\tg\tg\t\nX_Dimension\tTime\tTime\tTime\t\n"
        "***End_of_Header***\t\n"
    )
    return table("X_Value\tFront\tLeft\tAcc_Z\tComment", data, "\t", before, end="\t")


def of_ros(stamp: str) -> str:
    """As `rostopic echo -p` writes it, or with the stamp in two columns."""
    data = resting()
    values = [9.80665 * data[f"acc_{a}_g"] for a in AXES], [np.radians(data[f"gyro_{a}_dps"]) for a in AXES]
    whole = [NANOSECONDS + round(1e9 * t) for t in data["t_s"]]
    rows = []
    for k, (force, rate) in enumerate(zip(np.column_stack(values[0]), np.column_stack(values[1]), strict=True)):
        numbers = [*(f"{v:.6f}" for v in rate), "0.01", "0", *(f"{v:.6f}" for v in force)]
        when = [f"{whole[k] + 120_000}", f"{k}", f"{whole[k]}", "imu_link", "0", "0", "0", "1"]
        if stamp == "parts":
            when = [f"{whole[k] // 10**9}", f"{whole[k] % 10**9}"]
        rows.append(",".join([*when, *numbers]))
    head = "%time,field.header.seq,field.header.stamp,field.header.frame_id," + ",".join(
        f"field.orientation.{a}" for a in "xyzw"
    )
    prefix = "field." if stamp == "whole" else ""
    head = head if stamp == "whole" else "header.stamp.sec,header.stamp.nanosec"
    head += "".join(f",{prefix}angular_velocity.{a}" for a in AXES)
    head += f",{prefix}angular_velocity_covariance0,{prefix}angular_velocity_covariance1"
    head += "".join(f",{prefix}linear_acceleration.{a}" for a in AXES)
    return "\n".join([head, *rows, ""])


def px4() -> str:
    data = resting()
    found = {"timestamp": np.round(1e6 * data["t_s"]) + 5e6}
    found |= {f"gyro_rad[{k}]": np.radians(data[f"gyro_{a}_dps"]) for k, a in enumerate(AXES)}
    found["gyro_integral_dt"] = np.full(600, 4000.0)
    found |= {f"accelerometer_m_s2[{k}]": 9.80665 * data[f"acc_{a}_g"] for k, a in enumerate(AXES)}
    return table(",".join(found), found)


def magnitude_beside() -> str:
    data = resting()
    force = {f'"Acceleration {a} (m/s^2)"': 9.80665 * data[f"acc_{a}_g"] for a in AXES}
    size = np.linalg.norm(np.column_stack(list(force.values())), axis=1)
    found = {'"Time (s)"': data["t_s"], **force, '"Absolute acceleration (m/s^2)"': size}
    return table(",".join(found), found)


UNITS = "s,g,g,g,deg/s,deg/s,deg/s\n"
PLAIN = "time,acc_x,acc_y,acc_z,gyro_x,gyro_y,gyro_z\n"
STYLES: Mapping[str, tuple[str, str, int]] = {
    "LVM": (".lvm", lvm(), 3),
    "a line of units": (".csv", table(PLAIN + UNITS[:-1], resting()), 6),
    "lines before": (".csv", table(PLAIN + UNITS[:-1], resting(), before="Device: X7\nOperator,me\n\nRate: 100\n"), 6),
    "units alone": (".csv", table("x-axis,1 x\nsecond,g", dict(list(resting().items())[:2])), 1),
    "ROS, printed": (".csv", of_ros("whole"), 6),
    "ROS, in parts": (".csv", of_ros("parts"), 6),
    "PX4": (".csv", px4(), 6),
    "a magnitude": (".csv", magnitude_beside(), 3),
    "decimal comma": (".csv", table(";".join(resting()), resting(), ";", comma=True), 6),
}  # fmt: skip


def drafted(folder: Path, ending: str, text: str) -> Read:
    """The draft of a file, with no more than what it asks for filled in, imported."""
    (folder / f"d{ending}").write_text(text, encoding="utf-8")
    draft = guess(folder / f"d{ending}", folder)
    filled = draft.text
    for key in draft.to_fill:
        last = key.split(".")[-1]
        if key.startswith("axis of "):
            filled, count = re.subn('axis: ""', f"axis: {'yx'['Front' in key]}", filled, count=1)
        else:
            filled, count = re.subn(rf'{last}: ""', f"{last}: something", filled, count=1)
        assert count, (key, draft.text)
    (folder / "m.yaml").write_text(filled, encoding="utf-8")
    return open_manifest(folder / "m.yaml")


@pytest.mark.parametrize("style", STYLES)
def test_a_draft_of_what_a_logger_wrote_needs_no_more_than_it_asks_for(tmp_path: Path, style: str) -> None:
    ending, text, channels = STYLES[style]
    made_of = drafted(tmp_path, ending, text)
    data, (file,) = made_of.data, made_of.files
    device = data.manifest.of("device")
    assert len(device) == channels
    assert np.diff(data.time(file.table)) == pytest.approx(0.01, rel=1e-3)
    truth = resting()
    for column in device:
        scale = 9.80665 if column.quantity == "acceleration" else np.pi / 180.0
        name = f"acc_{column.axis}_g" if column.quantity == "acceleration" else f"gyro_{column.axis}_dps"
        assert data.si(file.table, column) == pytest.approx(scale * truth[name], abs=1e-5)


def test_an_axis_that_no_name_tells_is_asked_for_and_a_magnitude_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "d.lvm").write_text(lvm(), encoding="utf-8")
    assert guess(tmp_path / "d.lvm", tmp_path).to_fill[3:] == ("axis of Front", "axis of Left")
    (tmp_path / "d.csv").write_text(magnitude_beside(), encoding="utf-8")
    assert (
        "# left out: Absolute acceleration (m/s^2): acceleration of no axis" in guess(tmp_path / "d.csv", tmp_path).text
    )


# ---- lines


def test_lines_before_the_names_and_a_line_of_units_are_no_data() -> None:
    raw = b"made by hand\n# remark\nt,a\ns,g\n0,1\n1,2\n"
    how = Csv(skip=1, units=True)
    assert names(raw, "csv", how) == ("t", "a")
    assert units(raw, how) == ("s", "g")
    assert columns(raw, "csv", ["a"], how)[:, 0].tolist() == [1.0, 2.0]


def test_the_table_of_an_lvm_file_is_found_by_itself() -> None:
    raw = lvm().encode()
    assert units(raw, Csv("\t")) == ("s", "g", "g", "g", "")
    assert written(raw) == Csv("\t", skip=0)
    assert len(columns(raw, "csv", ["X_Value", "Acc_Z"], Csv("\t"))) == 600


@pytest.mark.parametrize("last", ["3,0.0", "3", "3,0.03,"])
def test_a_last_line_that_is_cut_is_left_out_and_said(last: str) -> None:
    raw = f"t,a,b,c\n0,1,2,3\n1,4,5,6\n2,7,8,9\n{last}".encode()
    found = read(raw, "csv", ["t", "a"])
    assert found.values.tolist() == [[0.0, 1.0], [1.0, 4.0], [2.0, 7.0]]
    assert [one.startswith("line 5, the last one, is cut after") for one in found.said] == [True]


def test_a_line_that_is_cut_amid_others_is_refused_by_its_number() -> None:
    with pytest.raises(BadInput, match="line 3: found 1 cells, wanted at least 2"):
        columns(b"t,a\n0,1\n1\n2,3\n", "csv", ["t", "a"])


def test_what_stands_for_a_missing_number_is_none_and_said() -> None:
    raw = b"t,a\n0,1\n1,--\n2,#N/A\n3,--\n4,5\n"
    found = read(raw, "csv", ["a"])
    assert np.array_equal(found.values[:, 0], [1.0, np.nan, np.nan, np.nan, 5.0], equal_nan=True)
    assert found.said == (
        "2 cells, the first in line 3, hold '--', which is taken as no number",
        "line 4 holds '#N/A', which is taken as no number",
    )


@pytest.mark.parametrize("cell", ["1.234", "-16.384", "1.234,5"])
def test_a_point_beside_decimal_commas_is_refused(cell: str) -> None:
    with pytest.raises(BadInput, match=f"line 3: found '{re.escape(cell)}' in column 'a'.*points that mark thousands"):
        columns(f"t;a\n0,5;-65\n1,5;{cell}\n".encode(), "csv", ["a"], Csv(";", decimal=","))


def test_what_is_odd_about_lines_is_a_finding_of_the_import(tmp_path: Path) -> None:
    text = made.csv_bytes(made.resting()).decode().replace("\n0.01,", "\n0.01,--,", 1)
    line = text.splitlines()[2].split(",")
    text = text.replace(",".join(line), ",".join([*line[:2], *line[3:]]), 1) + "20.0,0.0"
    (tmp_path / "d.csv").write_text(text, encoding="utf-8")
    (tmp_path / "m.yaml").write_text(made.resting_manifest("d.csv"), encoding="utf-8")
    read_in = open_manifest(tmp_path / "m.yaml")
    said = [one.text for one in read_in.found]
    assert any("line 2002, the last one, is cut after 2 of 7 cells" in one for one in said)
    assert any("line 3 holds '--'" in one for one in said)
    assert len(read_in.files[0].table.values) == 2000


def test_a_manifest_says_where_the_names_stand(tmp_path: Path) -> None:
    (tmp_path / "d.csv").write_bytes(b"by hand\n" + made.csv_bytes(made.resting()))
    (tmp_path / "m.yaml").write_text(made.resting_manifest("d.csv", "reading: {skip: 1}\n"), encoding="utf-8")
    assert len(open_manifest(tmp_path / "m.yaml").files[0].table.values) == 2000
    (tmp_path / "m.yaml").write_text(made.resting_manifest("d.csv"), encoding="utf-8")
    with pytest.raises(ConfigError, match="found no column 't_s'"):
        open_manifest(tmp_path / "m.yaml")


def test_a_sign_of_a_windows_code_page_in_a_comment_splits_no_line() -> None:
    """An ellipsis is byte 0x85 there, which splits a text that is read as Latin-1."""
    raw = b"# gyro \x85 z up\nt,a\n0,1\n1,2\n"
    assert names(raw, "csv", Csv()) == ("t", "a")
    assert columns(raw, "csv", ["a"]).tolist() == [[1.0], [2.0]]
    assert columns(raw.replace(b"\n", b"\r\n"), "csv", ["a"]).tolist() == [[1.0], [2.0]]
    assert columns(raw.replace(b"\n", b"\r"), "csv", ["a"]).tolist() == [[1.0], [2.0]]
