"""From records to certificates through the command line, on the simulated bench over its sockets."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import in_process
import numpy as np
import pages
import pytest

from rig.bench import control


def rig(runs: Path, *words: str) -> in_process.Done:
    return in_process.rig(*words, "--runs", str(runs))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Three short runs and one calibration, `first`."""
    folder = tmp_path_factory.mktemp("runs")
    for words in (
        ("sweep", "--axis", "x", "--points", "4"),
        ("turntable", "--rpm", "45", "--revolutions", "4"),
        ("noise", "--length", "20 s"),
    ):
        done = rig(folder, *words)
        assert done.returncode == 0, done.stderr
    done = rig(folder, "calibrate", "all", "--name", "first", "--json")
    assert done.returncode == 0, done.stderr
    (folder / "first.json").write_text(done.stdout)
    yield folder
    control.stop(folder / ".bench" / "simulated")


def test_every_value_has_its_uncertainty_and_every_gap_its_reason(runs: Path) -> None:
    said = json.loads((runs / "first.json").read_text())
    pages.assert_shown(said, pages.examples("rig calibrate")[0])
    assert said["simulated"] is True
    assert len(said["runs"]) == 3
    for result in said["results"]:
        assert (result["expanded"] > 0.0) if result["value"] is not None else result["remarks"]
    by_key = {result["key"]: result for result in said["results"]}
    assert by_key["unit_a_x.sensitivity"]["value"] * 9.80665 == pytest.approx(0.650, rel=0.03)
    assert by_key["unit_a_x.sensitivity"]["verdict"] == "pass"


def test_a_calibration_is_never_overwritten(runs: Path) -> None:
    again = json.loads(rig(runs, "calibrate", "all", "--name", "first", "--json").stdout)
    assert again["calibration"] == "first-2"


def test_the_certificate_is_written_twice_and_says_that_it_is_simulated(runs: Path, tmp_path: Path) -> None:
    done = rig(runs, "certify", "all", "--name", "signed", "--out", str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "signed.pdf").read_bytes().startswith(b"%PDF")
    whole = ElementTree.tostring(ElementTree.parse(tmp_path / "signed.xml").getroot(), "unicode")
    assert "SIMULATED" in whole
    assert "next: rig export" in done.stdout


def test_the_report_is_one_file_with_the_paper_s_tables_and_figures(runs: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    done = rig(runs, "report", "all", "--out", str(page))
    assert done.returncode == 0, done.stderr
    text = page.read_text(encoding="utf-8")
    for wanted in ("SIMULATED", "Table I", "Table II", "Figure 4", "Figure 5", "Figure 7", "Figure 8", "Figure 9"):
        assert wanted in text
    assert "<script src" not in text


@pytest.mark.parametrize(
    ("format", "code"), [("csv", 0), ("mat", 0), ("hdf5", 0), ("python", 0), ("ros2", 2), ("kalibr", 2)]
)
def test_every_format_is_written_or_says_what_is_missing(runs: Path, tmp_path: Path, format: str, code: int) -> None:
    done = rig(runs, "export", "first", "--to", format, "--rate", "200", "--out", str(tmp_path / "out"))
    assert done.returncode == code, done.stderr
    assert (tmp_path / "out").exists() == (code == 0)
    assert code == 0 or "wanted" in done.stderr


def test_two_calibrations_of_the_same_runs_agree(runs: Path) -> None:
    rig(runs, "calibrate", "all", "--name", "second")
    rows = json.loads(rig(runs, "compare-calibrations", "first", "second", "--json").stdout)
    assert rows
    assert all(row["agrees"] for row in rows)


def test_a_unit_is_calibrated_by_another_that_rode_with_it(runs: Path) -> None:
    first = json.loads((runs / "first.json").read_text())
    assert rig(runs, "turntable", "--rpm", "45", "--revolutions", "4").returncode == 0
    done = rig(runs, "qualify", "last", "--by", "first", "--reference", "gyro", "--name", "carried", "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    by_key = {result["key"]: result for result in said["results"]}
    before = {result["key"]: result for result in first["results"]}
    found, direct = by_key["backup_yaw.sensitivity"], before["backup_yaw.sensitivity"]
    assert found["value"] == pytest.approx(direct["value"], abs=2.0 * (found["u"] ** 2 + direct["u"] ** 2) ** 0.5)
    assert found["reference"] == "gyro_yaw by calibration first"
    assert [row["key"] for row in said["against"]] == ["backup_yaw.sensitivity"]
    shown = rig(runs, "qualify", "last", "--by", "first", "--reference", "gyro", "--last", "first").stdout
    assert "against the calibration first" in shown
    compared = json.loads(rig(runs, "compare-calibrations", "first", "carried", "--json").stdout)
    assert any(row["key"] == "backup_yaw.sensitivity" and row["agrees"] for row in compared)


@pytest.mark.parametrize(
    "words",
    [
        ("calibrate", "nothing"),
        ("qualify", "last", "--by", "nothing", "--reference", "gyro"),
        ("qualify", "all", "--by", "first", "--reference", "gyro"),
        ("calibrate", "all", "--name", "../x"),
        ("export", "nothing", "--to", "csv"),
        ("compare-calibrations", "first", "nothing"),
        ("export", "first", "--to", "kalibr", "--assume", "much"),
    ],
)
def test_what_cannot_be_used_is_refused(runs: Path, words: tuple[str, ...]) -> None:
    done = rig(runs, *words)
    assert done.returncode == 2
    assert "found" in done.stderr
    assert "wanted" in done.stderr


def test_somebody_elses_sweep_in_volts_joins_the_benchs_own_runs(runs: Path, tmp_path: Path) -> None:
    own = {one["key"]: one for one in json.loads((runs / "first.json").read_text())["results"]}
    gain, random = own["unit_a_x.sensitivity"]["value"], np.random.default_rng(3)
    t = np.arange(6000) / 1000.0
    files = []
    for number, level in enumerate((0.0, 2.0, 5.0)):
        base = level * np.sin(2.0 * np.pi * 20.13 * t)
        columns = np.column_stack([base + 0.01 * random.normal(size=len(t)), gain * base + 1.65])
        columns[:, 1] += 7e-4 * random.normal(size=len(t))
        np.savetxt(tmp_path / f"{number}.csv", columns, delimiter=",", header="ref,out", comments="", fmt="%.7f")
        setting = f"level: l{number}, frequency: 20 Hz" if number else "level: rest"
        files.append(f"- {{path: {number}.csv, settings: {{{setting}}}}}\n")
    head = "format: 1\nkind: sweep\nlabel: theirs\nunit: {serial: SIM-CUBE-1}\n"
    (tmp_path / "m.yaml").write_text(
        f"{head}provenance: {{source: a lab, licence: none}}\nfiles:\n{''.join(files)}time: {{rate: 1000 Hz}}\n"
        "columns:\n- {column: ref, quantity: acceleration, unit: m/s², role: reference, gain_uncertainty: 0.1 %}\n"
        "- {column: out, name: unit_a_x, quantity: voltage, unit: V, axis: x}\n",
        encoding="utf-8",
    )
    theirs = json.loads(rig(runs, "import", str(tmp_path / "m.yaml"), "--json").stdout)["run"]
    sweep = next(run.name for run in sorted(runs.iterdir()) if run.name.endswith("sweep-x"))
    done = rig(runs, "calibrate", sweep, theirs, "--name", "both", "--json")
    assert done.returncode == 0, done.stderr
    found = {one["key"]: one for one in json.loads(done.stdout)["results"]}
    both = found["unit_a_x.sensitivity"]
    assert both["unit"] == "V/(m/s²)"
    assert both["value"] == pytest.approx(gain, rel=0.002)
    assert both["u"] < 0.5 * own["unit_a_x.sensitivity"]["u"]
    assert "u of its gain 0.1 %" in both["reference"]
    assert any("vibrometer" in remark for remark in both["remarks"])
    assert both["verdict"] == "pass"
    assert found["unit_b_x.sensitivity"]["value"] == pytest.approx(own["unit_b_x.sensitivity"]["value"], rel=1e-3)
    for words in (("certify", sweep, theirs, "--out", str(tmp_path)), ("report", sweep, theirs)):
        done = rig(runs, *words)
        assert done.returncode == 0, done.stderr
