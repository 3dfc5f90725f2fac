"""Tests of instruments and metadata: whose clock is off, the recorder's or the drive's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imported_sweeps import DRIVE, MAINS, made

from rig.diagnose.instruments import findings
from rig.fit.evidence import Evidence
from rig.parts.reading.imported_sweep import sweeps
from rig.parts.sweep import Sweep
from rig.parts.sweep_lines import mains_seen
from rig.parts.sweep_records import SweepRecords
from rig.parts.sweep_signs import drive_off
from rig.shelf import shelf


def _names(data: SweepRecords) -> list[str]:
    evidence = Evidence((Sweep(data),), (), (data.run,), "board", False, ())
    return [one.term.effect.name for one in findings(evidence, shelf(), set())]


def test_mains_lines_come_out_at_the_frequency_they_have_within_what_is_stated() -> None:
    pulls = []
    for seed in range(5):
        data = sweeps(made(mains=60.013, seed=seed, levels=(0.5,)))[0]
        seen = mains_seen(data.leftovers, MAINS)
        assert seen is not None
        pulls.append((seen.frequency - 60.013) / seen.u)
        assert seen.strongest == pytest.approx((120.026, 240.052), abs=0.005)
    assert float(np.sqrt(np.mean(np.square(pulls)))) < 2.0


def test_a_drive_that_is_off_while_mains_lines_are_right_is_no_fault_of_the_recorder() -> None:
    data = sweeps(made(drive=DRIVE))[0]
    assert drive_off(data)
    assert _names(data) == []


def test_a_recorder_that_is_off_shifts_mains_lines_too_and_is_found() -> None:
    data = sweeps(made(drive=5.0 * 1.004, mains=60.0 * 1.004))[0]
    assert not drive_off(data)
    assert _names(data) == ["clock_ratio"]
    far = sweeps(made(drive=5.0 * 1.034, mains=60.0 * 1.034))[0]
    assert _names(far) == ["clock_ratio"]


def test_mains_lines_that_are_off_too_do_not_clear_the_recorder() -> None:
    assert not drive_off(sweeps(made(drive=5.0 * 1.02, mains=60.0 * 1.0045))[0])
    assert drive_off(sweeps(made(drive=5.0 * 1.02, mains=60.0 * 1.0015))[0])


def test_without_mains_lines_nobody_can_say_that_the_recorder_is_right() -> None:
    data = sweeps(made(hum=0.0))[0]
    assert _names(data) == ["clock_ratio"]
    assert _names(replace(sweeps(made())[0], mains=float("nan"))) == ["clock_ratio"]
    assert mains_seen(data.leftovers, MAINS) is None


def test_an_imported_sweep_has_no_vibrometer_that_could_drop_out() -> None:
    assert "ldv_dropout" not in _names(sweeps(made(rattle=0.5))[0])
