"""`rig init`: example configs and procedures, and schemas for an editor, in the technician's own folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from rig.cli.onward import command, say_next

SCHEMAS = "schemas"  # their folder beside `configs` and `procedures`


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), default=Path())
def init(folder: Path) -> None:
    """Copy example configs and procedures into FOLDER (default: here). Existing files are kept as they are.

    Schemas go along, by which an editor completes and checks every kind of YAML file; the first line of each example
    says where its own is.

    \f
    More of them: [schemas](schemas.md).
    """
    kept = 0
    for target, text in _examples():
        path = folder / target
        if path.exists():
            kept += 1
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        click.echo(f"  {path}")
    if kept:
        click.echo(f"  {kept} files were there already and are kept")
    say_next(command("run", folder / "procedures" / "sweep_x.yaml", "--dry-run"))


def _examples() -> Iterator[tuple[Path, str]]:
    """Where each file goes, and its text, which says where its schema is."""
    import importlib

    from rig.yaml import config

    folders = {
        "configs": config.shipped("."),
        "procedures": Path(next(iter(importlib.import_module("procedures").__path__))),
    }
    for name, folder in folders.items():
        for path in sorted(folder.rglob("*.yaml")):
            text = path.read_text(encoding="utf-8").replace(config.SCHEMAS.as_posix(), SCHEMAS)
            yield Path(name) / path.relative_to(folder), text
    for path in sorted(config.schemas().glob("*.json")):
        yield Path(SCHEMAS) / path.name, path.read_text(encoding="utf-8")
