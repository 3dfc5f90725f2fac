"""A kind of foreign data is a file of its own and an entry in one that is there; a new word for it, a line in another.

In a copy of the program a kind is added that nobody has heard of, with a part that has a word of its own. Everything
that knows kinds or words must then know it: import, comparison, repair, effects of one's own, model files, contracts.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import foreign_data as made
import numpy as np
import pytest
import test_contracts

ROOT = Path(__file__).parents[1]
KIND = "rig/foreign/manifest.py"
WORD = "rig/model.py"
READER = "rig/parts/reading/kinds/tilts.py"
ENTRY = """\
    "tilts": DataKind(
        "tilts on a dividing head", "tilted step by step on a dividing head", "time",
        keys=frozenset({"time", "gravity", "gravity.uncertainty", "standard"}), columns=TOLERANCE,
    ),
"""
LINE = '"tilts": "tilts on a dividing head", '
FILE = '''\
"""Foreign data of kind `tilts`: tilted step by step on a dividing head."""

from __future__ import annotations

from rig.foreign.tables import Foreign
from rig.parts.poses import Poses
from rig.parts.reading.poses import posed
from rig.parts.reading.reading import Reading


class Tilts(Poses):
    """Poses of which a dividing head says how they stood."""

    experiment = "tilts"


def read(foreign: Foreign) -> Reading:
    """Every file."""
    return Reading(tuple(Tilts(data) for data in posed(foreign)))
'''
OWN = '''"""Play of a dividing head."""

from rig.model import Coordinate, Effect, Parameter


class HeadPlay(Effect):
    stage = "transducer"
    title = "play of the head"
    equation = "u + play"
    quantities = ("acceleration",)
    places = ("tilts",)
    coordinates = (Coordinate("play", 1e-3),)
    parameters = (Parameter("play", "m/s²", (-1.0, 1.0), (1e-3, 1e-2)),)
    missing = "it wobbles"
    separate_by = "another head"
    source = "our own bench"
'''
MANIFEST = """\
format: 1
kind: tilts
unit: {serial: T1}
provenance: {source: a dividing head, licence: CC0-1.0}
files: [{path: tilts.csv}]
time: {rate: 100 Hz}
columns:
- {column: acc_x, quantity: acceleration, unit: m/s², axis: x}
- {column: acc_y, quantity: acceleration, unit: m/s², axis: y}
- {column: acc_z, quantity: acceleration, unit: m/s², axis: z}
"""


def planted(folder: Path, file: str, before: str, text: str) -> None:
    """Text put into a file of the copy, before the only place where this stands."""
    whole = (folder / file).read_text(encoding="utf-8")
    assert whole.count(before) == 1
    (folder / file).write_text(whole.replace(before, text + before), encoding="utf-8")


def copied(folder: Path, *, word: bool = True) -> Path:
    """The program with the kind, and with the word for it or without."""
    for name in ("rig", "drivers", "procedures", "fixtures"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "requirements-run.lock"):
        shutil.copy(ROOT / name, folder)
    planted(folder, KIND, '    "static": DataKind(', ENTRY)
    (folder / READER).write_text(FILE, encoding="utf-8")
    if word:
        planted(folder, WORD, '"poses": "poses against gravity"', LINE)
    return folder


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = copied(tmp_path_factory.mktemp("program"))
    (folder / "own").mkdir()
    (folder / "own" / "head_play.py").write_text(OWN, encoding="utf-8")
    random = np.random.default_rng(4)
    ways = np.array([way for way in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
    ways = random.permutation(np.tile(ways / np.linalg.norm(ways, axis=1)[:, None], (2, 1)))
    force = np.repeat(9.80665 * ways, 200, axis=0) * (1.02, 1.0, 0.99)
    shown = force + 0.01 * random.normal(size=force.shape)
    data = dict(zip(("acc_x", "acc_y", "acc_z"), shown.T, strict=True))
    (folder / "tilts.csv").write_bytes(made.csv_bytes(data))
    (folder / "tilts.yaml").write_text(MANIFEST, encoding="utf-8")
    rig(folder, "import", "tilts.yaml")
    return folder


def rig(folder: Path, *words: str, wanted: int = 0) -> str:
    """What a command of the copy says."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    command = [sys.executable, "-m", "rig", *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == wanted, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout + done.stderr


def as_json(folder: Path, *words: str) -> Any:
    return json.loads(rig(folder, *words, "--json"))


def test_besides_its_own_file_a_kind_changes_one_file_and_its_word_another(program: Path) -> None:
    copies = {one.relative_to(program).as_posix(): one for one in (program / "rig").rglob("*.py")}
    assert {name for name in copies if not (ROOT / name).exists()} == {READER}
    changed = {name for name in copies if name != READER and copies[name].read_bytes() != (ROOT / name).read_bytes()}
    assert changed == {KIND, WORD}
    assert (program / "pyproject.toml").read_bytes() == (ROOT / "pyproject.toml").read_bytes()


def test_the_contracts_hold_with_it(program: Path) -> None:
    said = test_contracts.checked(program)
    assert "Contracts:" in said
    assert ",0broken" in said


def test_its_runs_are_imported_compared_fitted_and_diagnosed(program: Path) -> None:
    assert "imported tilts on a dividing head of T1" in rig(program, "show", "last")
    found = as_json(program, "compare", "last")
    assert {one["experiment"] for one in found["groups"]} == {"tilts"}
    rig(program, "fit", "last")
    assert as_json(program, "diagnose", "last")["verdict"] == "adequate"
    results = as_json(program, "calibrate", "last")["results"]
    gains = {one["key"]: one["value"] for one in results if one["key"].endswith(".sensitivity")}
    assert {one["reference"] for one in results if one["value"]} == {"local gravity, 9.80665 m/s², u = 0.02 m/s²"}
    assert gains == pytest.approx(
        {"acc_x.sensitivity": 1.02, "acc_y.sensitivity": 1.0, "acc_z.sensitivity": 0.99}, rel=3e-3
    )


def test_effects_and_model_files_know_its_word(program: Path) -> None:
    one = as_json(program, "effects", "head_play", "--effects", "own")
    assert one["places"] == ["tilts"]
    assert "shows on: tilts on a dividing head" in rig(program, "effects", "head_play", "--effects", "own")
    assert as_json(program, "effects", "cubic")["places"][-2:] == ["tilts", "poses"]
    rig(program, "add", "bend", "last", "--formula", "k*u**2", "--on", "acceleration", "--model", "mine.yaml")
    text = (program / "mine.yaml").read_text(encoding="utf-8")
    changed = text.replace("  on: acceleration\n", "  on: acceleration\n  places: [tilts]\n", 1)
    assert changed != text
    (program / "mine.yaml").write_text(changed, encoding="utf-8")
    rig(program, "compare", "last", "--model", "mine.yaml")


def test_a_word_that_is_not_declared_is_known_to_nobody(tmp_path: Path) -> None:
    folder = copied(tmp_path, word=False)
    (folder / "own").mkdir()
    (folder / "own" / "head_play.py").write_text(OWN, encoding="utf-8")
    said = rig(folder, "effects", "head_play", "--effects", "own", wanted=2)
    assert "places: found ('tilts',), wanted a tuple of" in said
