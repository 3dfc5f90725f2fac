"""`rig import` as a person uses it: a run out of foreign files, what is wrong with them, and a draft to begin with."""

from __future__ import annotations

import json
from pathlib import Path

import foreign_data as made
import in_process
import numpy as np
import pytest
from jsonschema import Draft202012Validator

ROOT = Path(__file__).parents[1]
SHIPPED = ROOT / "configs" / "imports"


def rig(folder: Path, *words: str, wanted: int = 0) -> in_process.Done:
    done = in_process.rig(*words, folder=folder, RIG_RUNS=str(folder / "runs"))
    assert done.returncode == wanted, (words, done.stdout[-1500:], done.stderr[-1500:])
    assert "Traceback" not in done.stderr
    return done


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A swung case whose gyro counts backwards, and its manifest."""
    data = made.turning(seconds=20.0)
    data["gyro_z_dps"] *= -1.0
    (tmp_path / "swing.csv").write_bytes(made.csv_bytes(data))
    (tmp_path / "swing.yaml").write_text(made.turning_manifest("swing.csv"), encoding="utf-8")
    return tmp_path


def test_import_show_runs_and_verify_go_together(folder: Path) -> None:
    said = rig(folder, "import", "swing.yaml").stdout
    assert "2000 rows  100 Hz" in said
    assert "gyro_z_dps counts against the reference" in said
    assert said.splitlines()[-1].startswith("next: rig compare 20")
    shown = rig(folder, "show").stdout
    assert "imported rotation of A1: completed, 1 of 1 files" in shown
    assert "found on import: swing: gyro_z_dps counts against the reference" in shown
    assert "1 of 1" in rig(folder, "runs").stdout
    assert "sound (completed" in rig(folder, "verify").stdout


def test_import_as_json(folder: Path) -> None:
    said = json.loads(rig(folder, "import", "swing.yaml", "--json").stdout)
    assert said["files"][0]["rate"] == pytest.approx(100.0)
    assert [one["kind"] for one in said["findings"]] == ["sign"]
    assert (folder / "runs" / said["run"] / "seal.json").exists()


def test_a_bad_manifest_ends_with_exit_2_and_no_run(folder: Path) -> None:
    text = made.turning_manifest("swing.csv").replace("gyro_x_dps", "gyro_q_dps")
    (folder / "swing.yaml").write_text(text, encoding="utf-8")
    done = rig(folder, "import", "swing.yaml", wanted=2)
    assert "swing.yaml:11:12 columns[1].column: swing.csv: found no column 'gyro_q_dps'" in done.stderr
    assert "did you mean" in done.stderr
    assert not (folder / "runs").exists()
    rig(folder, "import", wanted=2)
    rig(folder, "import", "nowhere.yaml", wanted=2)


def test_a_dry_run_checks_and_writes_nothing(folder: Path) -> None:
    assert "counts against" in rig(folder, "import", "swing.yaml", "--dry-run").stdout
    assert not (folder / "runs").exists()


def test_data_elsewhere_are_found_by_data(folder: Path) -> None:
    (folder / "here").mkdir()
    (folder / "swing.yaml").rename(folder / "here" / "swing.yaml")
    assert "unreadable" in rig(folder, "import", "here/swing.yaml", wanted=2).stderr
    rig(folder, "import", "here/swing.yaml", "--data", ".")


def test_the_schema_is_one(folder: Path) -> None:
    schema = json.loads(rig(folder, "import", "--schema").stdout)
    Draft202012Validator.check_schema(schema)
    assert "columns" in schema["properties"]


def test_a_draft_filled_in_by_hand_is_imported(folder: Path) -> None:
    done = rig(folder, "import", "--guess", "swing.csv", "-o", "draft.yaml")
    assert "to fill in by you: unit.serial; provenance.source; provenance.licence" in done.stderr
    text = (folder / "draft.yaml").read_text(encoding="utf-8")
    assert "# found: gyro_z_dps counts against the reference" in text
    for key in ("serial", "source", "licence"):
        text = text.replace(f'{key}: ""', f"{key}: mine")
    (folder / "filled.yaml").write_text(text, encoding="utf-8")
    assert "next: rig compare 20" in rig(folder, "import", "filled.yaml").stdout
    assert ":16 unit.serial: found ''" in rig(folder, "import", "draft.yaml", wanted=2).stderr


def test_a_draft_is_not_written_over_another(folder: Path) -> None:
    rig(folder, "import", "--guess", "swing.csv", "-o", "draft.yaml")
    (folder / "draft.yaml").write_text("mine by now\n", encoding="utf-8")
    assert "draft.yaml" in rig(folder, "import", "--guess", "swing.csv", "-o", "draft.yaml", wanted=2).stderr
    assert (folder / "draft.yaml").read_text(encoding="utf-8") == "mine by now\n"


REAL = {
    "artslab-shaker": ["commanded 5 Hz, found 5.172 Hz (+3.4 %)", "so the drive is off, not the recorder"],
    "uiuc-yaw-medium": ["3 time stamps are the same as the one before", "gyro_z counts against the reference"],
    "uiuc-yaw-slow": ["gyro_z counts against the reference"],
    "uiuc-roll-slow": ["22 time stamps are the same as the one before"],
    "cem-mpu9250": ["near 180°: the device counts against the reference (polarity)"],
    "ptb-mpu9250": ["nothing looks wrong with the data"],
    "broad-07": ["nothing looks wrong with the data"],
    "xsens-multiposition": ["contradict gravity", "times what is stated"],
    "ferraris-session": ["nothing looks wrong with the data"],
    "uiuc-pitch-medium": ["acc_y: 6 rows stand alone, far from the rows beside"],
}


@pytest.mark.parametrize("name", sorted(path.stem for path in SHIPPED.glob("*.yaml")))
def test_real_data_come_in_with_what_is_known_of_them(tmp_path: Path, name: str) -> None:
    made.real("")
    said = rig(tmp_path, "import", str(SHIPPED / f"{name}.yaml"), "--data", str(made.REAL)).stdout
    for text in REAL[name]:
        assert text in said


def test_numbers_of_a_real_file_are_kept_to_the_bit(tmp_path: Path) -> None:
    from rig.archive.records import Records
    from rig.archive.runs import Runs
    from rig.foreign.tables import foreign_of

    path = made.real("imucal-ferraris/example_ferraris_session.csv")
    rig(tmp_path, "import", str(SHIPPED / "ferraris-session.yaml"), "--data", str(made.REAL))
    table = foreign_of(Records(Runs(tmp_path / "runs").open("last"))).tables[0]
    whole = np.genfromtxt(path, delimiter=",", names=True)
    assert np.array_equal(table.of("gyr_z"), whole["gyr_z"])
