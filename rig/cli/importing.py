"""Other people's measurements: import them by a manifest, or have one drafted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli.onward import Carried, again, command, say_next
from rig.cli.options import json_option, print_json, runs_option

if TYPE_CHECKING:
    from rig.foreign.importing import Read
    from rig.foreign.manifest import Column


@click.command(name="import")
@click.argument("manifest", metavar="[MANIFEST]", required=False, type=click.Path(path_type=Path))
@click.option("--data", cls=Carried, type=click.Path(file_okay=False, path_type=Path), envvar="RIG_REAL_DATA",
              show_envvar=True, show_default="its own",
              help="Folder that the manifest's paths start from.")  # fmt: skip
@click.option("--guess", type=click.Path(path_type=Path), metavar="FILE",
              help="Draft a manifest from FILE instead, for you to finish.")  # fmt: skip
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), show_default="the terminal",
              help="Where the draft goes.")  # fmt: skip
@click.option("--schema", is_flag=True, help="Print the JSON schema of manifests instead.")
@click.option("--dry-run", is_flag=True, help="Read and check everything, and make no run.")
@runs_option
@json_option
def import_(
    manifest: Path | None, data: Path | None, guess: Path | None, output: Path | None, schema: bool, dry_run: bool,
    runs: Path, as_json: bool,
) -> None:  # fmt: skip
    """Make a sealed run out of the files that MANIFEST describes.

    Numbers are kept as they stand in the files. What looks wrong with them (time stamps, gaps, signs, units, clocks) is
    reported, kept in the run's journal, and not mended.

    \f
    How a manifest is written: [manifests](manifest.md). `--json` gives `run`, `unit`, `kind`, `simulated`, `files` (a
    list of `path`, `label`, `sha256`, `bytes`, `rows`, `rate`, `held_out`), `channels` (`name`, `role`, `quantity`) and
    `findings` (`kind`, `where`: the file, `channel`, `rows`: the first and the last, from 0, all `stretches` of them,
    `time` of the first and the last since the record's first row, s, `stamp` of the first as it stands in the file,
    `manifest_line` that names the column, whether they are `left_out` and `accepted`, and `text`); with `--guess` it
    gives `kind`, `manifest` (the draft) and `to_fill`.
    """
    if (manifest is not None) + (guess is not None) + schema != 1:
        raise click.UsageError("wanted one of MANIFEST, --guess FILE and --schema")
    if schema:
        _print_schema()
    elif guess is not None:
        _guess(guess, output, data, as_json)
    elif manifest is not None:
        _import(manifest, data, runs, dry_run, as_json)


def _print_schema() -> None:
    from rig.foreign.manifest import Manifest
    from rig.yaml.config import json_schema

    print_json(json_schema(Manifest))


def _import(manifest: Path, data: Path | None, runs: Path, dry_run: bool, as_json: bool) -> None:
    from rig.archive.runs import Runs
    from rig.foreign.importing import keep, open_manifest

    read = open_manifest(manifest, data)
    name = None if dry_run else keep(read, Runs(runs))
    if as_json:
        print_json(read_as_json(read, name))
        return
    click.echo("\n".join(read_text(read)))
    if name is None:
        click.echo("nothing was written")
        say_next(again(without="dry_run"))
    else:
        from rig.parts.reading.imported import comparable

        click.echo(f"run {name}")
        say_next(command("compare" if comparable(read.manifest) else "show", name))


def read_as_json(read: Read, name: str | None) -> dict[str, Any]:
    """What `rig import --json` prints."""
    from rig.foreign.importing import rate_of

    data = read.data
    return {
        "run": name,
        "unit": read.manifest.unit.serial,
        "kind": read.manifest.kind,
        "simulated": False,
        "files": [
            {"path": f.source.path, "label": f.table.label, "sha256": f.sha256, "bytes": f.size,
             "rows": len(f.table.values), "rate": rate_of(data, f.table), "held_out": f.table.held_out}
            for f in read.files
        ],
        "channels": [{"name": c.channel, "role": c.role, "quantity": c.quantity} for c in read.manifest.columns],
        "findings": [one.as_json() for one in read.found],
    }  # fmt: skip


def read_text(read: Read) -> list[str]:
    """What was read, channel by role, and what is wrong with it."""
    from rig.foreign.importing import rate_of
    from rig.foreign.manifest import KINDS

    made, data = read.manifest, read.data
    title = " ".join(part for part in (made.unit.maker, made.unit.model) if part)
    lines = [f"{KINDS[made.kind].title} of {made.unit.serial}" + (f" ({title})" if title else "")]
    width = max(len(file.table.label) for file in read.files)
    for file in read.files:
        rate = rate_of(data, file.table)
        rows = f"{len(file.table.values):>7} rows"
        span = f"  {rate:.6g} Hz  {len(file.table.values) / rate:.5g} s" if rate else ""
        held = "  held out" if file.table.held_out else ""
        lines.append(f"  {file.table.label:<{width}}  {rows}{span}{held}")
    for role in ("device", "reference", "drive", "condition"):
        named: dict[str, list[str]] = {}
        for column in made.columns:
            if column.role == role:
                named.setdefault(_of(column), []).append(column.channel)
        lines += [f"  {role}: {'; '.join(_who(*one) for one in named.items())}"] if named else []
    return [*lines, *found_text(read.found, len(read.files) > 1)]


def _who(what: str, channels: list[str]) -> str:
    return f"{what} {', '.join(channels)}"


def _of(column: Column) -> str:
    unit = column.sensitivity or column.unit
    return f"{column.quantity}{f' ({unit})' if unit else ''}"


def found_text(found: Any, several: bool) -> list[str]:
    """Findings as a person reads them."""
    if not found:
        return ["nothing looks wrong with the data"]
    head = f"found {len(found)} thing{'' if len(found) == 1 else 's'} to know, not mended (rows count from 0):"
    return [head, *(f"  {f'{one.where}: ' if several else ''}{one.text}" for one in found)]


def _guess(file: Path, output: Path | None, data: Path | None, as_json: bool) -> None:
    from rig.foreign.guessing import guess

    made = guess(file, data or (output.parent if output is not None else Path()))
    if as_json:
        print_json({"kind": made.kind, "manifest": made.text, "to_fill": list(made.to_fill)})
        return
    if output is None:
        click.echo(made.text, nl=False)
    else:
        _write_new(output, made.text)
    if made.to_fill:
        click.echo("to fill in by you: " + "; ".join(made.to_fill), err=True)
    drafted = command("import", "--guess", file, "-o", _free(file.stem)) if output is None else None
    filled = "filled in, next" if made.to_fill and output is not None else "next"
    click.echo(f"{filled}: {drafted or command('import', output)}", err=True)


def _free(stem: str) -> Path:
    """A file for a draft, here, that is not there yet."""
    names = (f"{stem}{number}.yaml" for number in ("", *(f"-{n}" for n in range(2, 100))))
    return next((path for path in map(Path, names) if not path.exists()), Path(f"{stem}.yaml"))


def _write_new(path: Path, text: str) -> None:
    """A draft that somebody has worked on is not written over."""
    from rig.errors import BadInput

    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except OSError as error:
        raise BadInput(f"{path}: found that it cannot be written ({error.strerror}), wanted a new file") from error
