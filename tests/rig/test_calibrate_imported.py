"""Imported records are calibrated as the bench's own are: the truth lies in the interval, whoever measured."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from imported_runs import STANDARD, kept, posed
from imported_sweeps import columns
from imported_sweeps import made as sweep
from imported_worlds import Sensor, Unit, motion, response, response_table, rotation
from lxml import etree

from rig.archive.records import Records
from rig.archive.runs import Runs
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration
from rig.calibrate.fitted import Assumed
from rig.certificate.dcc import xml
from rig.cli import cli
from rig.errors import BadInput
from rig.foreign.manifest import Standard
from rig.foreign.tables import Foreign
from rig.model import Term
from rig.shelf import effect_of

SHARED = Path(os.environ.get("RIG_SHARED", Path(__file__).resolve().parents[3] / "shared"))
GAIN, ZERO, ANGLES = np.array([1.02, 0.99, 1.005]), np.array([0.1, -0.2, 0.05]), (0.004, -0.008, 0.012)
SEEDS = (1, 2, 3, 4)


@dataclass(frozen=True)
class Kind:
    """How such data are made from a seed, and the true values."""

    made: Callable[[int], Foreign]
    true: Mapping[str, float]
    applied: str = ""  # a channel with sensitivity and offset


KINDS = {
    "rotation": Kind(
        lambda seed: rotation(Unit(rate_gain=(1.0, 1.0, 1.02)), seed, seconds=60.0),
        {"gyro_z.sensitivity": 1.02, "gyro_z.offset": 0.005, "gyro_x.offset": 0.01}, "gyro_z"),
    "motion": Kind(
        lambda seed: motion(Unit(rate_gain=(1.01, 0.99, 1.02), force_gain=(1.01, 0.98, 1.0)), seed, seconds=20.0),
        {"gyro_x.sensitivity": 1.01, "gyro_y.sensitivity": 0.99, "gyro_z.sensitivity": 1.02, "gyro_z.offset": 0.005,
         "acc_x.sensitivity": 1.01, "acc_y.sensitivity": 0.98, "acc_z.sensitivity": 1.0, "acc_x.offset": 0.1}, "acc_x"),
    "sweep": Kind(
        lambda seed: sweep(seed=seed, columns_=columns("m/s²"), levels=(0.3, 0.7, 1.0)),
        {"board.sensitivity": 0.963, "board.offset": -0.013}, "board"),
    "response": Kind(
        lambda seed: response([response_table(Sensor(gain=1.01).phasor, seed)]), {"acc.sensitivity": 1.01}),
    "poses": Kind(
        lambda seed: posed(seed, gain=GAIN, zero=ZERO, angles=ANGLES),
        {**{f"acc_{a}.sensitivity": float(g) for a, g in zip("xyz", GAIN, strict=True)},
         **{f"acc_{a}.offset": float(z) for a, z in zip("xyz", ZERO, strict=True)},
         **{f"acceleration.non_orthogonality_{n}": v for n, v in zip(("yz", "zy", "zx"), ANGLES, strict=True)}},
        "acc_y"),
}  # fmt: skip


def calibrated(folder: Path, *foreign: Foreign, assumed: Assumed | None = None, **changed: Any) -> Calibration:
    runs = [Records(Runs(folder).open(kept(one, folder, **changed))) for one in foreign]
    return calibrate(runs, "foreign", None, assumed or Assumed())


def said(runs: Path, *words: str) -> str:
    done = CliRunner().invoke(cli, [*words, "--runs", str(runs)], catch_exceptions=False, standalone_mode=False)
    return done.stdout


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_lies_within_the_interval(tmp_path: Path, kind: str) -> None:
    errors = []
    for seed in SEEDS:
        made = calibrated(tmp_path / str(seed), KINDS[kind].made(seed))
        assert not [r.key for r in made.results if r.status == "flagged"]
        for key, true in KINDS[kind].true.items():
            result = made.result(key)
            assert result.value is not None
            errors.append((result.value - true) / result.u)
    assert np.abs(errors).max() < 3.5
    assert np.mean(np.abs(errors) <= 2.0) >= 0.85


def test_the_zero_of_a_sweep_errs_as_much_as_it_states(tmp_path: Path) -> None:
    errors = []
    for seed in range(24):
        data = sweep(seed=seed, columns_=columns("m/s²"), levels=(0.3, 0.7, 1.0))
        result = calibrated(tmp_path / str(seed), data).result("board.offset")
        assert result.value is not None
        errors.append((result.value + 0.013) / result.u)
    assert 0.7 < float(np.sqrt(np.mean(np.square(errors)))) < 1.3


def test_zeros_that_differ_from_file_to_file_make_theirs_uncertain(tmp_path: Path) -> None:
    data = sweep(columns_=columns("m/s²"))
    steps = 2e-4 * np.random.default_rng(7).normal(size=len(data.tables))
    moved = [
        replace(one, values=one.values + np.array([0.0, 0.0, step]))
        for one, step in zip(data.tables, steps, strict=True)
    ]
    made = calibrated(tmp_path, replace(data, tables=tuple(moved)))
    result = made.result("board.offset")
    assert result.status == "determined"
    assert result.value == pytest.approx(-0.013 + steps.mean(), abs=3e-6)
    assert result.u == pytest.approx(2e-4 / np.sqrt(7.0), rel=0.5)
    assert any("zero output of board wanders by" in flag for flag in made.flags)


@pytest.mark.parametrize("kind", KINDS)
def test_certificate_page_and_files_are_written_and_say_that_nothing_is_traceable(tmp_path: Path, kind: str) -> None:
    runs = tmp_path / "runs"
    kept(KINDS[kind].made(1), runs)
    text = said(runs, "calibrate", "last", "--name", "one")
    assert "note: not traceable: " in text
    assert "SIMULATED" not in text
    said(runs, "certify", "last", "--name", "signed", "--out", str(tmp_path))
    assert (tmp_path / "signed.pdf").read_bytes().startswith(b"%PDF")
    whole = (tmp_path / "signed.xml").read_text(encoding="utf-8")
    assert "not traceable: the manifest of " in whole
    assert "SIMULATED" not in whole
    _validate(whole.encode())
    said(runs, "report", "last", "--out", str(tmp_path / "page.html"))
    assert "not traceable" in (tmp_path / "page.html").read_text(encoding="utf-8")
    for format in ("csv", "mat", "hdf5"):
        said(runs, "export", "one", "--to", format, "--out", str(tmp_path))
    with pytest.raises(BadInput, match="found"):
        said(runs, "export", "one", "--to", "kalibr", "--rate", "100", "--out", str(tmp_path))


def _validate(whole: bytes) -> None:
    path = SHARED / "dcc" / "dcc.xsd"
    if path.exists():
        schema = etree.XMLSchema(etree.parse(str(path)))
        assert schema.validate(etree.fromstring(whole)), schema.error_log


@pytest.mark.parametrize("kind", KINDS)
def test_the_exported_module_undoes_what_the_unit_does(tmp_path: Path, kind: str) -> None:
    runs, of = tmp_path / "runs", KINDS[kind]
    kept(of.made(1), runs)
    said(runs, "calibrate", "last", "--name", "one")
    if not of.applied:
        with pytest.raises(BadInput, match="no channel with both sensitivity and offset"):
            said(runs, "export", "one", "--to", "python", "--out", str(tmp_path))
        return
    said(runs, "export", "one", "--to", "python", "--out", str(tmp_path))
    spec = importlib.util.spec_from_file_location("one_calibration", tmp_path / "one_calibration.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    gain, zero = of.true[f"{of.applied}.sensitivity"], of.true[f"{of.applied}.offset"]
    assert module.apply(of.applied, gain * 3.0 + zero) == pytest.approx(3.0, abs=5e-3)


def test_a_standard_that_the_manifest_names_makes_the_chain(tmp_path: Path) -> None:
    made = calibrated(tmp_path, KINDS["poses"].made(1), standard=Standard(**STANDARD))
    assert not any("not traceable" in flag for flag in made.flags)
    assert made.model == "data sheet; besides, as no data sheet states it: non_orthogonality (acceleration)"
    whole = xml(made)
    assert b"PTB-7" in whole
    _validate(whole)


def test_a_gain_that_is_stated_is_a_line_of_the_budget(tmp_path: Path) -> None:
    data = KINDS["rotation"].made(1)
    doubtful = [
        one.model_copy(update={"gain_uncertainty": 0.01}) if one.column == "angle" else one
        for one in data.manifest.columns
    ]
    result = calibrated(tmp_path, data, columns=doubtful).result("gyro_z.sensitivity")
    line = next(one for one in result.contributions if one.name == "gain of angle")
    assert line.contribution == pytest.approx(0.01 * 1.02, rel=0.02)
    assert "u of its gain 1 %" in result.reference


def test_a_missing_effect_flags_and_the_model_with_it_does_not(tmp_path: Path) -> None:
    def late(seed: int) -> Foreign:
        return rotation(Unit(rate_gain=(1.0, 1.0, 1.02), rate_delay=0.02), seed, seconds=60.0, channels="r")

    bare = calibrated(tmp_path / "bare", late(1)).result("gyro_z.sensitivity")
    assert bare.status == "flagged"
    assert bare.verdict == "inconclusive"
    delay = Term(effect_of("delay"), "rate", {"time": 0.0})
    made = calibrated(tmp_path / "by", late(1), assumed=Assumed((delay,)))
    repaired = made.result("gyro_z.sensitivity")
    assert repaired.status == "determined"
    assert repaired.value is not None
    assert abs(repaired.value - 1.02) < 3.0 * repaired.u
    time = made.result("rate.delay_time")
    assert time.value == pytest.approx(0.02, abs=3.0 * time.u)


def test_of_two_experiments_the_better_counts_and_the_other_stands_beside_it(tmp_path: Path) -> None:
    unit = Unit(rate_gain=(1.0, 1.0, 1.02))
    made = calibrated(tmp_path, rotation(unit, 1, channels="r"), motion(unit, 2, seconds=20.0, channels="r"))
    result = made.result("gyro_z.sensitivity")
    assert any("model fitted to all records of the " in remark for remark in result.remarks)
    assert result.status == "determined"
    assert len([one for one in made.results if one.key == "gyro_z.sensitivity"]) == 1


def test_own_and_imported_runs_of_two_units_are_not_one_calibration(tmp_path: Path) -> None:
    foreign = Records(Runs(tmp_path).open(kept(KINDS["response"].made(1), tmp_path)))

    class Own:
        name = "own"
        header: Mapping[str, Any] = {"procedure": "frequency_sweep", "sensor": {"serial": "another"}}

    with pytest.raises(BadInput, match="found another unit than in own"):
        calibrate([foreign, Own()], "both")  # type: ignore[list-item]
