"""A sensor is a value: what belongs together is stated or follows from the order of the file, never from a name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import yaml

from fixtures.channels import sensors as drawn
from rig.errors import BadInput
from rig.sensor import Sensor
from rig.yaml.config import shipped

CUBE: dict[str, Any] = yaml.safe_load(shipped("sensors/simulated_cube.yaml").read_text(encoding="utf-8"))


def older() -> dict[str, Any]:
    """The cube as files and runs had it before they named units."""
    kept = {n: {k: v for k, v in row.items() if k != "unit"} for n, row in CUBE["channels"].items()}
    return {"sensor": "Sensor Cube", "serial": "SIM-CUBE-1", "channels": kept}


def renamed(file: dict[str, Any]) -> dict[str, Any]:
    return {**file, "channels": {f"ω{n}": row for n, row in enumerate(file["channels"].values())}}


def places(sensor: Sensor) -> list[list[int]]:
    """Channels of every triad by their place in the file."""
    return [[sensor.names.index(name) for name in triad.names] for triad in sensor.triads]


def test_older_files_have_the_units_that_the_shipped_one_names() -> None:
    assert Sensor.stated(older()) == Sensor.stated(CUBE)


@pytest.mark.parametrize("file", [CUBE, older()], ids=["units named", "older"])
def test_names_of_channels_decide_nothing(file: dict[str, Any]) -> None:
    sensor, other = Sensor.stated(file), Sensor.stated(renamed(file))
    assert places(sensor) == places(other)
    assert [t.title for t in other.triads] == ["unit A", "unit B", "unit C", "gyros", "backup gyros"]
    assert [t.colour for t in other.triads] == [t.colour for t in sensor.triads]
    assert other.primary is not None
    assert other.primary.title == "unit A"
    assert [other.names.index(c.name) for c in other.about("yaw")] == [11, 14]
    assert [c.word for c in other.along("z")] == ["z", "z", "z"]


def test_a_triad_is_in_the_order_of_the_axes_and_knows_whether_it_is_whole() -> None:
    gyros = Sensor.stated(CUBE).triad("gyro")
    assert gyros.names == ("gyro_roll", "gyro_yaw", "gyro_pitch")
    assert gyros.is_whole
    assert gyros.letter == ""
    alone = Sensor.stated({**CUBE, "units": {}, "channels": {"a": CUBE["channels"]["unit_a_y"]}})
    assert alone.triads[0].axes == ("y",)
    assert not alone.triads[0].is_whole
    assert alone.triads[0].along("x") is None


def test_the_primary_unit_is_the_file_s_choice_else_the_first_one_of_accelerometers() -> None:
    other = Sensor.stated({**CUBE, "primary": "unit_c"})
    assert other.primary is not None
    assert other.primary.letter == "C"
    gyros = {name: row for name, row in CUBE["channels"].items() if row["quantity"] == "rate"}
    assert Sensor.stated({**CUBE, "channels": gyros, "primary": None}).primary is None


def test_what_is_not_there_is_said_with_what_is() -> None:
    sensor = Sensor.stated(CUBE)
    with pytest.raises(BadInput, match="found no channel 'gyro_up', wanted one of unit_a_x"):
        sensor.channel("gyro_up")
    with pytest.raises(BadInput, match="found no unit 'spare', wanted one of unit_a, unit_b, unit_c, gyro, backup"):
        sensor.triad("spare")


def test_noise_by_the_data_sheet_covers_what_clean_worlds_draw() -> None:
    sensor = Sensor.stated(CUBE)
    for seed in range(200):
        for name, one in drawn(seed).items():
            sheet = sensor.channel(name).noise
            assert sheet is not None
            density = one.noise.white / one.sensitivity / math.sqrt(math.pi / 2.0 * one.pole)
            assert abs(density / sheet.density - 1.0) < sheet.tolerance, (name, density / sheet.density)
            corner = one.noise.flicker / (one.noise.white**2 / (math.pi / 2.0 * one.pole))
            assert sheet.corner[0] <= corner * (1 + 1e-9)
            assert corner <= sheet.corner[1] * (1 + 1e-9)


def test_of_recorded_channels_one_of_each_part_is_shown() -> None:
    names = np.array(Sensor.stated(CUBE).names)
    shown = Sensor.stated(CUBE).samples(names[[4, 7, 8, 11]])
    assert [one.name for one in shown] == ["unit_b_y", "unit_c_y", "gyro_yaw"]
