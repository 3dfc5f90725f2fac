"""Measurements of others, from import to repair through the commands: what has to come out of each data set.

The data are not part of the project: RIG_REAL_DATA names their folder (default: shared/data beside the project). Where
it is not there these tests are skipped and say so.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from real_data import SECTIONS
from real_data_desk import IMPORTS, ROOT, Desk
from real_data_encoder import push_of
from real_data_motion import wide_manifest
from real_data_poses import turns

from rig.foreign.tables import foreign_of
from rig.notebook import open_run

DATA = Path(os.environ.get("RIG_REAL_DATA", str(ROOT.parent / "shared" / "data")))
PAGE = ROOT / "docs" / "real-data.md"

needs_data = pytest.mark.skipif(
    not all((DATA / name).is_dir() for name in SECTIONS), reason=f"{DATA}: found no real data, wanted RIG_REAL_DATA"
)


def imported(folder: Path, manifest: str) -> tuple[Desk, Mapping[str, Any]]:
    """A folder of runs with one data set in it, and what import said."""
    desk = Desk(DATA, folder / "runs", folder / "images")
    return desk, desk.imported(IMPORTS / manifest)


def error(desk: Desk, group: str, *words: str) -> float:
    """Error of a group of channels, SI, as `rig compare` gives it."""
    found = desk.asked("compare", "last", *words)["groups"]
    return next(float(one["error"]) for one in found if group in one["name"])


def value(desk: Desk, effect: str, name: str, *words: str) -> float:
    """A parameter of an effect as `rig add` or `rig fit` left it."""
    effects = desk.asked("fit", "last", *words)["effects"]
    return next(float(one["parameters"][name]["value"]) for one in effects if one["effect"] == effect)


def added(desk: Desk, *effects: tuple[str, ...]) -> None:
    """Add effects one after another."""
    for effect, *words in effects:
        desk.text("add", effect, "last", *words)


@needs_data
@pytest.mark.slow
def test_a_response_of_two_institutes_is_a_delay_and_a_moving_average(tmp_path: Path) -> None:
    desk, _ = imported(tmp_path, "ptb-mpu9250.yaml")
    before = error(desk, "response")
    said = desk.asked("diagnose", "last")
    assert said["verdict"] == "missing"
    assert [one["effect"] for one in said["candidates"] if one["taken"]] == ["delay", "moving_average"]
    below = {one["effect"].partition(" ")[0]: one for one in said["excluded"]}
    assert (below["first_order_lag"]["error_after"] or 100.0) > 10.0  # null: it removes far less
    assert below["resonance"]["error_after"] is None
    added(desk, ("delay", "--on", "acceleration"), ("moving_average", "--on", "acceleration"))
    after = error(desk, "response")
    assert after < 0.001
    assert before / after > 500.0
    assert value(desk, "moving_average", "window") == pytest.approx(2.017e-3, abs=5e-6)
    desk.imported(IMPORTS / "cem-mpu9250.yaml")
    other = desk.asked("compare", "last", "--as-is")
    assert other["shape_holds"]
    assert other["levels"][0]["relative"] == pytest.approx(-0.003, abs=0.001)
    assert "polarity" in desk.text("compare", "last", "--as-is")


@needs_data
@pytest.mark.slow
def test_gyros_on_a_stepper_are_twelve_milliseconds_late(tmp_path: Path) -> None:
    desk, said = imported(tmp_path, "uiuc-yaw-medium.yaml")
    assert any("gyro_z counts against the reference" in one["text"] for one in said["findings"])
    before = error(desk, "gyros")
    found = desk.asked("diagnose", "last")
    assert found["verdict"] == "missing"
    late = [one for one in found["candidates"] if one["effect"] == "delay"]
    assert late
    assert late[0]["parameters"]["time"]["value"] == pytest.approx(12e-3, abs=0.5e-3)
    assert any("one and the same" in one for one in found["cannot_see"])
    added(desk, ("reference_tilt",), ("delay", "--on", "rate"))
    assert before / error(desk, "gyros") > 3.0


@needs_data
@pytest.mark.slow
def test_accelerometers_on_a_stepper_are_nine_milliseconds_late(tmp_path: Path) -> None:
    desk, _ = imported(tmp_path, "uiuc-pitch-medium.yaml")
    before = error(desk, "accelerometers")
    added(desk, ("reference_tilt",), ("reference_delay",), ("delay", "--on", "rate"))
    common, more = value(desk, "reference_delay", "time"), value(desk, "delay", "time")
    assert -common == pytest.approx(8.9e-3, abs=0.9e-3)
    assert more - common == pytest.approx(12e-3, abs=0.5e-3)
    assert before / error(desk, "accelerometers") > 3.0


@needs_data
@pytest.mark.parametrize(("manifest", "near"), [("uiuc-yaw-medium.yaml", 46.7), ("uiuc-yaw-slow.yaml", 12.8)])
def test_the_stepper_shakes_gyro_and_encoder_alike_where_its_speed_says(
    manifest: str, near: float, tmp_path: Path
) -> None:
    desk, _ = imported(tmp_path, manifest)
    line = push_of(foreign_of(open_run(desk.runs / "last")))
    assert line is not None
    assert line.frequency == pytest.approx(near, abs=0.15)
    assert line.frequency == pytest.approx(line.speed / 3.6, rel=0.02)
    assert 0.5 < line.gyro / line.encoder < 1.0  # both have it; the gyro filters the faster one
    assert "real motion above the band, in gyro and encoder alike" in desk.text("compare", "last")


@needs_data
@pytest.mark.slow
def test_up_to_20_hz_the_gyros_reach_their_bar_and_the_accelerometers_keep_the_cameras_noise(tmp_path: Path) -> None:
    desk = Desk(DATA, tmp_path / "runs", tmp_path / "images")
    desk.imported(wide_manifest(tmp_path))
    added(desk, ("reference_delay",), ("lever_arm",), ("delay", "--on", "rate"))
    assert error(desk, "gyros") < 0.075
    assert 0.48 < error(desk, "accelerometers") < 0.57  # the bar is 0.48, missed: see the page
    assert value(desk, "lever_arm", "length") == pytest.approx(7.5e-3, abs=0.3e-3)


@needs_data
@pytest.mark.slow
def test_free_motion_gives_offset_of_time_and_lever_arm_together(tmp_path: Path) -> None:
    desk, _ = imported(tmp_path, "broad-07.yaml")
    found = desk.asked("diagnose", "last")
    named = {one["effect"] for one in found["candidates"]}
    assert {"reference_delay", "lever_arm", "delay"} <= named
    assert any("offset of the reference's time stamps are one and the same" in one for one in found["cannot_see"])
    added(desk, ("reference_delay",), ("lever_arm",), ("delay", "--on", "rate"))
    assert value(desk, "lever_arm", "length") == pytest.approx(7.5e-3, abs=0.3e-3)
    assert value(desk, "lever_arm", "y") == pytest.approx(-1.8e-3, abs=0.3e-3)
    assert error(desk, "gyros") < 0.075
    assert error(desk, "accelerometers") < 0.48


@needs_data
def test_poses_of_a_hand_held_unit_want_three_sensitivities_and_three_angles(tmp_path: Path) -> None:
    desk, _ = imported(tmp_path, "xsens-multiposition.yaml")
    first = error(desk, "gravity", "--start", "shared")
    desk.text("fit", "last", "--start", "shared")
    added(desk, ("own_sensitivity",))
    second = error(desk, "gravity")
    added(desk, ("non_orthogonality", "--on", "acceleration"))
    assert first == pytest.approx(0.037, abs=0.002)
    assert second < first
    assert error(desk, "gravity") < 0.0012


@needs_data
def test_turns_by_hand_integrate_to_whole_turns_after_calibration(tmp_path: Path) -> None:
    desk, _ = imported(tmp_path, "ferraris-session.yaml")
    assert error(desk, "gravity", "--start", "shared") > 0.05
    desk.text("fit", "last", "--start", "shared")
    added(desk, ("own_sensitivity",))
    assert error(desk, "gravity") < 0.0024
    assert desk.asked("diagnose", "last")["verdict"] == "adequate"
    model = yaml.safe_load((desk.runs / "models" / "imucal-example.yaml").read_text(encoding="utf-8"))
    for axis, (read, _, calibrated, *_) in turns(DATA, model):
        assert abs(abs(read) - 360.0) > 0.5, axis
        assert calibrated == pytest.approx(-360.0, abs=0.1), axis


@needs_data
@pytest.mark.slow
def test_a_distorting_shaker_is_blamed_and_not_the_board_on_it(tmp_path: Path) -> None:
    desk, said = imported(tmp_path, "artslab-shaker.yaml")
    assert any(
        "+3.4 %" in one["text"] and "the drive is off, not the recorder" in one["text"] for one in said["findings"]
    )
    text = desk.text("compare", "last")
    assert "the distortion is the shaker's, not the sensor's" in text
    assert "mains lines at rest" in text
    gain = text.partition("board over reference is ")[2].split(" ")
    assert float(gain[0]) == pytest.approx(0.963, abs=0.002)
    assert float(gain[2]) < 0.003


def test_the_page_names_every_data_set_with_source_licence_and_figures() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for name in SECTIONS:
        section = page.partition(f"\n## {name}:")[2].partition("\n## ")[0]
        assert "Source: https://" in section, name
        assert "Licence: " in section, name
        pictures = [part.partition(")")[0] for part in section.split("](images/")[1:]]
        assert pictures, name
        assert all((PAGE.parent / "images" / one).exists() for one in pictures), name
