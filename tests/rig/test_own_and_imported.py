"""The bench's own runs and somebody else's of the same unit are one calibration where both are in volts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from example_calibration import example
from imported_runs import STANDARD, kept
from imported_sweeps import made
from imported_worlds import Sensor, Unit, response, response_table, rotation

from rig.archive.records import Records
from rig.archive.runs import Runs
from rig.calibrate import imported
from rig.calibrate.calibration import Calibration
from rig.calibrate.fitted import Assumed
from rig.calibrate.merging import in_volts, together
from rig.errors import BadInput
from rig.foreign.manifest import Column
from rig.foreign.tables import Foreign

OWN = example()
GAIN = OWN.result("unit_a_x.sensitivity").value or 0.0
ZERO = OWN.result("unit_a_x.offset").value or 0.0


def columns(gain_uncertainty: str = "", **device: Any) -> list[dict[str, Any]]:
    known = {"gain_uncertainty": gain_uncertainty} if gain_uncertainty else {}
    return [
        {"column": "base", "quantity": "acceleration", "unit": "m/s²", "role": "reference", **known},
        {"column": "board", "name": "unit_a_x", "quantity": "voltage", "unit": "V", "axis": "x", **device},
    ]


def theirs(folder: Path, ratio: float = 1.0, volts: bool = True, **changed: Any) -> Calibration:
    """A sweep of the same unit by somebody else, in V."""
    data = made(board=lambda a: ratio * GAIN * a + ZERO + 0.013, hum=0.0, levels=(0.3, 0.7, 1.0), **changed)
    return of(folder, data, volts)


def of(folder: Path, data: Foreign, volts: bool = True) -> Calibration:
    run = Records(Runs(folder).open(kept(data, folder)))
    return imported.calibration([run], "theirs", (), Assumed(), volts)


@pytest.mark.parametrize("volts", [False, True])
def test_a_voltage_beside_an_acceleration_is_calibrated_in_volts(tmp_path: Path, volts: bool) -> None:
    found = theirs(tmp_path, volts=volts, columns_=columns())
    result, zero = found.result("unit_a_x.sensitivity"), found.result("unit_a_x.offset")
    assert (result.unit, result.title, zero.unit) == ("V/(m/s²)", "sensitivity", "V")
    assert result.value == pytest.approx(GAIN, rel=3.0 * result.u / GAIN)
    assert zero.value == pytest.approx(ZERO, abs=4.0 * zero.u)


def test_a_stated_sensitivity_in_volts_turns_a_ratio_back_into_volts() -> None:
    column = Column(column="out", quantity="rate", axis="z", sensitivity="200 mV per rad/s", zero=2500.0)
    assert (column.volts, column.zero_volts) == (pytest.approx(0.2), pytest.approx(2.5))
    assert Column(column="out", quantity="rate", axis="z", sensitivity="200 counts per rad/s").volts is None
    ratio = replace(OWN.result("gyro_yaw.sensitivity"), value=1.02, unit="1")
    found = in_volts(ratio, column)
    assert (found.value, found.unit) == (pytest.approx(0.204), "V/(rad/s)")
    assert found.u == pytest.approx(0.2 * ratio.u)
    zero = replace(OWN.result("gyro_yaw.offset"), value=0.01, unit="rad/s")
    assert in_volts(zero, column).value == pytest.approx(2.502)


def test_the_better_value_is_kept_with_its_reference_and_the_other_stands_beside_it(tmp_path: Path) -> None:
    other = theirs(tmp_path, columns_=columns("0.05 %"), standard=STANDARD)
    both = together(OWN, other)
    result = both.result("unit_a_x.sensitivity")
    assert result.u == pytest.approx(5e-4 * GAIN, rel=0.1)
    assert "u of its gain 0.05 %" in result.reference
    assert any(OWN.result("unit_a_x.sensitivity").method in remark for remark in result.remarks)
    assert both.result("unit_b_x.sensitivity") == OWN.result("unit_b_x.sensitivity")
    assert any(one["certificate"] == STANDARD["certificate"] for one in both.standards if "certificate" in one)
    assert {*OWN.flags, *other.flags} <= set(both.flags)


def test_a_reference_of_unstated_uncertainty_is_never_the_better_one(tmp_path: Path) -> None:
    other = theirs(tmp_path, columns_=columns())
    assert other.result("unit_a_x.sensitivity").u < OWN.result("unit_a_x.sensitivity").u
    both = together(OWN, other)
    for key in ("unit_a_x.sensitivity", "unit_a_x.offset"):
        assert both.result(key).value == OWN.result(key).value
        assert any("model fitted to all records of the shaker" in remark for remark in both.result(key).remarks)
    assert any("not traceable: the manifest of " in flag for flag in both.flags)


def test_values_that_differ_by_more_than_their_uncertainties_are_flagged(tmp_path: Path) -> None:
    other = theirs(tmp_path, ratio=1.2, columns_=columns("0.05 %"))
    result = together(OWN, other).result("unit_a_x.sensitivity")
    assert result.status == "flagged"
    assert "experiments differ by more than their uncertainties" in result.remarks


@pytest.mark.parametrize("unit", ["V/(m/s²)", "mV/g"])
def test_a_response_in_volts_is_one_too(tmp_path: Path, unit: str) -> None:
    table = response_table(Sensor(gain=GAIN).phasor, 3)
    table[:, 2:4] *= {"V/(m/s²)": 1.0, "mV/g": 1e3 * 9.80665}[unit]
    data = response([table])
    named = [
        one.model_copy(update={"unit": unit, "name": "unit_a_x"}) if one.quantity == "magnitude" else one
        for one in data.manifest.columns
    ]
    found = of(tmp_path, replace(data, manifest=data.manifest.model_copy(update={"columns": named})))
    result = found.result("unit_a_x.sensitivity")
    assert (result.unit, result.value) == ("V/(m/s²)", pytest.approx(GAIN, rel=4.0 * result.u / GAIN))
    assert result.u < 0.01 * GAIN
    assert any("imported values are in volts" in flag for flag in found.flags)


def test_ratios_to_stated_si_are_refused_beside_volts(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="found gyro_x in rad/s beside runs that a bench recorded in volts"):
        of(tmp_path, rotation(Unit(), 1, seconds=30.0, channels="r"))
    with pytest.raises(BadInput, match="found acc in no unit beside runs"):
        of(tmp_path, response([response_table(Sensor().phasor, 1)]))
