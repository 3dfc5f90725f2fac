"""`rig init`: example configs and procedures in the technician's own folder."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import click

from rig.cli.onward import command, say_next


@click.command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), default=Path())
def init(folder: Path) -> None:
    """Copy example configs and procedures into FOLDER (default: here). Existing files are kept as they are."""
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
    import importlib

    from rig.bench.procedure_file import file_model
    from rig.yaml import config

    root = config.shipped("benches/simulated.yaml").parent.parent
    for path in sorted(root.rglob("*.yaml")):
        yield Path("configs") / path.relative_to(root), path.read_text(encoding="utf-8")
    package = Path(next(iter(importlib.import_module("procedures").__path__)))
    for path in sorted(package.glob("*.yaml")):
        yield Path("procedures") / path.name, path.read_text(encoding="utf-8")
    schema = json.dumps(config.json_schema(file_model()), indent=2, ensure_ascii=False)
    yield Path("procedures") / "procedure.schema.json", schema + "\n"
