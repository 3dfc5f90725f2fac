"""The noise of imported records at rest is calibrated, and reaches the files that robots load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from imported_runs import kept, rested
from imported_worlds import Unit, rotation

from rig.archive.records import Records
from rig.archive.runs import Runs
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration
from rig.cli import cli
from rig.errors import BadInput
from rig.foreign.tables import Foreign

FORCE, RATE, WALK = 2e-3, 1e-4, 6e-5
CHANNELS = [*(f"acc_{a}" for a in "xyz"), *(f"gyro_{a}" for a in "xyz")]


def calibrated(folder: Path, *foreign: Foreign) -> Calibration:
    return calibrate([Records(Runs(folder).open(kept(one, folder))) for one in foreign], "still")


def said(runs: Path, *words: str) -> str:
    done = CliRunner().invoke(cli, [*words, "--runs", str(runs)], catch_exceptions=False, standalone_mode=False)
    return done.stdout


def test_density_and_random_walk_err_as_much_as_they_state(tmp_path: Path) -> None:
    pulls = []
    for seed in range(5):
        made = calibrated(tmp_path / str(seed), rested(seed, force=FORCE, rate=RATE, walk=WALK))
        for channel in CHANNELS:
            density = made.result(f"{channel}.noise_density")
            assert density.value is not None
            pulls.append((density.value - (FORCE if channel[0] == "a" else RATE)) / density.u)
        walks = [made.result(f"{channel}.random_walk") for channel in CHANNELS[3:]]
        pulls += [(float(one.value or 0.0) - WALK) / one.u for one in walks if one.determined]
        assert [made.find(f"{channel}.random_walk") for channel in CHANNELS[:3]] == [None] * 3
    assert len(pulls) >= 40
    assert 0.7 < float(np.sqrt(np.mean(np.square(pulls)))) < 1.4


def test_the_deviation_is_that_of_the_samples_in_si(tmp_path: Path) -> None:
    made = calibrated(tmp_path, rested(1, force=FORCE, rate=RATE))
    assert made.result("acc_z.deviation").value == pytest.approx(FORCE * np.sqrt(50.0 * 2.0), rel=0.03)
    assert any("noise is in SI by the sensitivity that the manifest states" in flag for flag in made.flags)
    assert made.model == ""


def test_a_stated_tolerance_is_a_line_of_the_budget_and_an_unstated_one_is_said(tmp_path: Path) -> None:
    bare = calibrated(tmp_path / "bare", rested(1, force=FORCE, rate=RATE)).result("acc_x.noise_density")
    assert any("not stated and not in the budget" in remark for remark in bare.remarks)
    made = calibrated(tmp_path / "by", rested(1, force=FORCE, rate=RATE, tolerance="6 %"))
    stated = made.result("acc_x.noise_density")
    assert stated.u == pytest.approx(np.hypot(bare.u, 0.06 / np.sqrt(3.0) * FORCE), rel=0.05)


def test_a_calibrated_sensitivity_refers_the_noise_to_the_input(tmp_path: Path) -> None:
    still = rested(2, force=FORCE, rate=RATE)
    turned = rotation(Unit(rate_gain=(1.0, 1.0, 1.25)), 1, seconds=60.0, channels="r")
    turned = replace(turned, manifest=turned.manifest.model_copy(update={"unit": still.manifest.unit}))
    made = calibrated(tmp_path, still, turned)
    assert made.result("gyro_z.sensitivity").value == pytest.approx(1.25, rel=0.01)
    assert made.result("gyro_z.noise_density").value == pytest.approx(RATE / 1.25, rel=0.05)
    assert made.result("gyro_z.noise_density").reference == "own sensitivity"
    assert made.result("acc_z.noise_density").value == pytest.approx(FORCE, rel=0.05)


def test_the_longest_record_counts(tmp_path: Path) -> None:
    short, long = rested(3, force=2.0 * FORCE, rate=RATE, rows=2000), rested(4, force=FORCE, rate=RATE)
    made = calibrated(tmp_path, short, long)
    assert made.result("acc_x.noise_density").value == pytest.approx(FORCE, rel=0.05)
    assert "200 s at rest" in made.result("acc_x.noise_density").method


def test_kalibr_and_ros_2_get_the_worst_axis_and_every_variance(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    kept(rested(0, force=FORCE, rate=RATE, walk=WALK), runs)
    text = said(runs, "calibrate", "last", "--name", "still")
    assert "next: rig export still --to ros2" in text
    assert "gyro_x.noise_density" in text
    made = calibrated(tmp_path / "again", rested(0, force=FORCE, rate=RATE, walk=WALK))
    with pytest.raises(BadInput, match=r"found no acc_x\.random_walk .*, wanted it from a long static record, or"):
        said(runs, "export", "still", "--to", "kalibr", "--rate", "100", "--out", str(tmp_path))
    assumed = ("--assume", "accelerometer_random_walk=1e-5")
    said(runs, "export", "still", "--to", "kalibr", "--rate", "100", "--out", str(tmp_path), *assumed)
    kalibr = yaml.safe_load((tmp_path / "still.imu.yaml").read_text(encoding="utf-8"))
    for key in ("noise_density", "random_walk"):
        worst = max(made.result(f"{channel}.{key}").value or 0.0 for channel in CHANNELS[3:])
        assert kalibr[f"gyroscope_{key}"] == pytest.approx(worst, rel=1e-12)
    assert kalibr["accelerometer_noise_density"] == pytest.approx(FORCE, rel=0.05)
    said(runs, "export", "still", "--to", "ros2", "--out", str(tmp_path))
    own = yaml.safe_load((tmp_path / "still.ros2.yaml").read_text(encoding="utf-8"))["/**"]["ros__parameters"]
    variance = np.diag(np.reshape(own["linear_acceleration_covariance"], (3, 3)))
    assert variance == pytest.approx(100.0 * FORCE**2, rel=0.05)
    assert own["angular_velocity"]["random_walk"] == [made.result(f"{c}.random_walk").value for c in CHANNELS[3:]]
    assert not {"scale", "bias"} & set(own["angular_velocity"])
    assert "body_from_cube" not in own


def test_certificate_and_page_of_noise_alone_are_written(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    kept(rested(1, force=FORCE, rate=RATE), runs)
    said(runs, "certify", "last", "--name", "signed", "--out", str(tmp_path))
    assert (tmp_path / "signed.pdf").read_bytes().startswith(b"%PDF")
    said(runs, "report", "last", "--out", str(tmp_path / "page.html"))
    assert "noise density" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_a_record_that_says_nothing_of_noise_is_refused(tmp_path: Path) -> None:
    still = rested(1, force=FORCE, rate=RATE, rows=10)
    with pytest.raises(BadInput, match="found nothing that determines a value, wanted records with motion, or at rest"):
        calibrated(tmp_path, still)


def test_units_of_two_serials_are_not_one_calibration(tmp_path: Path) -> None:
    still = rested(1, force=FORCE, rate=RATE)
    other = replace(still, manifest=still.manifest.model_copy(update={"unit": still.manifest.unit.model_copy(
        update={"serial": "B"})}))  # fmt: skip
    with pytest.raises(BadInput, match="found another unit"):
        calibrated(tmp_path, still, other)
