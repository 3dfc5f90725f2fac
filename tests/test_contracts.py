"""The import contracts hold what they say: a wrong import planted in a copy of the program breaks the right one."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PLANTED = {
    "Fixtures know numpy, PyYAML and the standard library: nothing of the program they test": (
        "fixtures/channels.py", "rig.units",
    ),
    "Drivers know records, units, errors, the decoder of an encoder and the room they stand in": (
        "drivers/encoder.py", "rig.archive.records",
    ),
    "Procedures know steps, roles, units and errors": ("procedures/noise.py", "rig.fit.fit"),
    "The program loads drivers and procedures by name and never knows the twins": (
        "rig/bench/steps.py", "drivers.encoder",
    ),
    "An effect knows the model it is part of, how it is undone, the motion, and units": (
        "rig/effects/cubic.py", "rig.archive.records",
    ),
    "Readers of kinds of foreign data do not know one another": (
        "rig/parts/reading/kinds/poses.py", "rig.parts.reading.kinds.sweep",
    ),
}  # fmt: skip


def contracts(folder: Path) -> list[dict[str, Any]]:
    """The contracts of a program."""
    settings = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))
    return list(settings["tool"]["importlinter"]["contracts"])


def planted(contract: dict[str, Any]) -> tuple[str, str]:
    """A file, and an import that the contract forbids in it: of the upper floor in the lowest, for layers."""
    if contract["name"] in PLANTED:
        return PLANTED[contract["name"]]
    container, floors = contract["containers"][0], contract["layers"]
    low, high = floors[-1].split(" | ")[0], floors[0].split(" | ")[0]
    place = ROOT / container.replace(".", "/") / low
    file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    return str(file.relative_to(ROOT)), f"{container}.{high}"


def checked(folder: Path) -> str:
    """What the linter says of a folder, without white space: it wraps names as it likes."""
    script = (
        "import sys; sys.path.insert(0, '.')\n"
        "from importlinter.cli import lint_imports\n"
        "sys.exit(lint_imports(config_filename='pyproject.toml', no_cache=True))"
    )
    command = [sys.executable, "-P", "-c", script]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return "".join(done.stdout.split())


def test_every_contract_is_broken_by_an_import_that_it_forbids(tmp_path: Path) -> None:
    for name in ("rig", "drivers", "procedures", "fixtures"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    everything = contracts(tmp_path)
    for number, contract in enumerate(everything):
        file, module = planted(contract)
        path = tmp_path / file
        text = f"{path.read_text(encoding='utf-8')}\n\ndef _planted_{number}() -> None:\n    import {module}\n"
        path.write_text(text, encoding="utf-8")
    (tmp_path / "rig" / "attic.py").write_text('"""A room that no floor names."""\n', encoding="utf-8")
    said = checked(tmp_path)
    for contract in everything:
        assert f"{''.join(contract['name'].split())}BROKEN" in said, f"{contract['name']}: kept in spite of its plant"
    assert "-rig.attic" in said
