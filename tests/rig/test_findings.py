"""What import finds is a value that every command gives: what, where, in which rows, when, and the manifest's line."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from imported_worlds import Unit, rotation

from rig.cli import cli
from rig.foreign.finding import stretches_of
from rig.foreign.tables import Foreign

LATE = 1000.0  # s, at which the logger's clock began
ROWS = (2222, 4567)
MANIFEST = """format: 1
kind: rotation
unit: {serial: made}
provenance: {source: made for a test, licence: none}
files: [{path: log.csv}]
time: {column: t, unit: s}
rotation: {axis: z, upright: true}
compared: {rate_band: 5 Hz, force_band: 5 Hz}
columns:
- {column: angle, quantity: angle, unit: rad, role: reference}
- {column: gyro_x, quantity: rate, unit: rad/s, axis: x, tolerance: 3 %}
- {column: gyro_y, quantity: rate, unit: rad/s, axis: y, tolerance: 3 %}
- {column: gyro_z, quantity: rate, unit: rad/s, axis: z, tolerance: 3 %}
"""
COLUMNS = ("t", "angle", "gyro_x", "gyro_y", "gyro_z")


def glitchy() -> Foreign:
    made = rotation(Unit(), 3, rest=10.0, channels="r", jitter=1e-4, doubled=0.0)
    values = made.tables[0].values
    values[:, 0] += LATE
    values[list(ROWS), 4] = -9.0
    return made


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A logger's file and its manifest."""
    folder, made = tmp_path_factory.mktemp("findings"), glitchy()
    numbers = made.tables[0].values[:, [made.tables[0].names.index(name) for name in COLUMNS]]
    np.savetxt(folder / "log.csv", numbers, delimiter=",", header=",".join(COLUMNS), comments="", fmt="%.9g")
    (folder / "log.yaml").write_text(MANIFEST, encoding="utf-8")
    return folder


def said(folder: Path, *words: str, as_json: bool = True) -> Any:
    more = ("--runs", str(folder / "runs"), *(("--json",) if as_json else ()))
    done = CliRunner().invoke(cli, [*words, *more], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout) if as_json else done.output


def left_out(answer: Any) -> list[Any]:
    return [one for one in answer["findings"] if one["left_out"]]


def test_every_command_gives_what_was_found_as_the_same_value(folder: Path) -> None:
    (found,) = left_out(said(folder, "import", str(folder / "log.yaml")))
    written = (folder / "log.yaml").read_text(encoding="utf-8").splitlines()
    stamps = np.loadtxt(folder / "log.csv", delimiter=",", skiprows=1, usecols=0)
    assert (found["kind"], found["channel"], found["where"]) == ("alone", "gyro_z", "log")
    assert (found["rows"], found["stretches"]) == (list(ROWS), [[row, row] for row in ROWS])
    assert "column: gyro_z" in written[found["manifest_line"] - 1]
    assert found["stamp"] == pytest.approx(stamps[ROWS[0]])
    assert found["time"] == pytest.approx(stamps[list(ROWS)] - stamps[0], abs=1e-6)
    assert (found["left_out"], found["accepted"]) == (True, False)
    for command in ("show", "compare", "diagnose"):
        assert left_out(said(folder, command, "last")) == [found]
        words = said(folder, command, "last", as_json=False)
        assert f"gyro_z: 2 rows stand alone, far from the rows beside: rows {ROWS[0]}, {ROWS[1]}" in words
    assert said(folder, "diagnose", "last")["verdict"] == "undecided"


def test_what_was_looked_at_and_accepted_is_left_out_and_no_longer_doubted(folder: Path) -> None:
    accepted = MANIFEST.replace("axis: z, tolerance", "axis: z, findings: accepted, tolerance")
    (folder / "accepted.yaml").write_text(accepted, encoding="utf-8")
    (found,) = left_out(said(folder, "import", str(folder / "accepted.yaml")))
    assert (found["left_out"], found["accepted"]) == (True, True)
    assert said(folder, "diagnose", "last")["verdict"] == "adequate"


@given(st.sets(st.integers(0, 40), min_size=1))
def test_stretches_hold_every_row_once(rows: set[int]) -> None:
    found = stretches_of(np.array(sorted(rows)))
    assert [row for first, last in found for row in range(first, last + 1)] == sorted(rows)
    assert all(later[0] > before[1] + 1 for before, later in itertools.pairwise(found))
