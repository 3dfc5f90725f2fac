"""The import contracts hold what they say: a wrong import planted in a copy of the program breaks the right one."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PLANTED = {
    "From record to verdict": ("rig/parts/part.py", "rig.fit.fit"),
    "Fixtures know": ("fixtures/channels.py", "rig.units"),
    "Drivers know": ("drivers/encoder.py", "rig.archive.records"),
    "Procedures know": ("procedures/noise.py", "rig.fit.fit"),
    "The program loads": ("rig/bench/steps.py", "drivers.encoder"),
    "An effect knows": ("rig/effects/cubic.py", "rig.archive.records"),
}


def contracts(folder: Path) -> list[str]:
    """Names of the contracts."""
    tables = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    return [str(contract["name"]) for contract in tables["contracts"]]


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
    for file, module in PLANTED.values():
        path = tmp_path / file
        planted = f"\n\ndef _planted() -> None:\n    import {module}\n"
        path.write_text(path.read_text(encoding="utf-8") + planted, encoding="utf-8")
    (tmp_path / "rig" / "attic.py").write_text('"""A room that no floor names."""\n', encoding="utf-8")
    said = checked(tmp_path)
    names = contracts(tmp_path)
    assert len(names) == len(PLANTED)
    for name in names:
        assert any(name.startswith(begin) for begin in PLANTED)
        assert f"{''.join(name.split())}BROKEN" in said, f"{name}: kept in spite of what was planted"
    assert "-rig.attic" in said
