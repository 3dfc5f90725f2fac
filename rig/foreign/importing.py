"""Foreign data into the archive: read every file, check them all, and only then make the run.

    read = open_manifest(Path("manifest.yaml"), Path("data"))     # BadInput with every mistake: nothing was written
    made = keep(read, Runs(Path("runs")))                         # a sealed run

Numbers are kept as they stand in the files; what looks wrong with them is in the journal, in words.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig.archive.records import IMPORT
from rig.archive.runs import Runs
from rig.errors import BadInput, ConfigError, Problem
from rig.foreign import readers as foreign_files
from rig.foreign.checks import findings
from rig.foreign.finding import Finding
from rig.foreign.manifest import KINDS, Manifest, Reading, Source, as_json
from rig.foreign.manifest_file import load
from rig.foreign.tables import Array, Foreign, Table, lines_of, without_missing
from rig.yaml import config, document
from rig.yaml.document import Document, KeyPath


@dataclass(frozen=True)
class File:
    """One file as it was read."""

    source: Source
    sha256: str
    size: int  # bytes
    table: Table
    odd: tuple[str, ...] = ()  # lines that hold something else than numbers


@dataclass(frozen=True)
class Read:
    """A manifest with all its files, and what is wrong with them."""

    path: Path
    text: bytes
    manifest: Manifest
    files: tuple[File, ...]
    found: tuple[Finding, ...]

    @property
    def data(self) -> Foreign:
        """As the analysis will see it."""
        written = document.read_text(self.text.decode(), str(self.path))
        data = foreign(self.manifest, [file.table for file in self.files], self.found)
        return replace(data, lines=lines_of(written, self.manifest))


def foreign(made: Manifest, tables: Sequence[Table], found: Sequence[Finding] = ()) -> Foreign:
    """Imported data that are not in the archive yet."""
    whole = tuple(without_missing(made, table) for table in tables)
    return Foreign(made.label, made, whole, tuple(found))


def open_manifest(path: Path, folder: Path | None = None) -> Read:
    """Read a manifest and all its files, whose paths are from `folder` (default: the manifest's).

    Raises ConfigError with every mistake by file, line and column.
    """
    made = load(path)
    written = config.read(path)
    problems: list[Problem] = []
    files: list[File] = []
    for number, source in enumerate(made.files):
        try:
            files.append(_read(written, made, number, source, folder or path.parent))
        except ConfigError as error:
            problems += error.problems
    problems += _of_segments(written, made, files)
    if problems:
        raise ConfigError(sorted(set(problems)))
    read = Read(path, path.read_bytes(), made, tuple(files), (*_twice(files), *_odd(files)))
    return replace(read, found=(*read.found, *findings(read.data)))


def csv_of(reading: Reading) -> foreign_files.Csv:
    """How a manifest says that its text files are written."""
    return foreign_files.Csv(
        reading.delimiter, reading.comment, reading.header, reading.decimal, reading.skip, reading.units
    )


def wanted(made: Manifest) -> tuple[str, ...]:
    """Columns that are kept: time stamps, columns, and their uncertainties; each once."""
    stamps = [made.time.column] if made.time is not None and made.time.column is not None else []
    named = [one.column for one in made.columns]
    beside = [one.uncertainty_column for one in made.columns if one.uncertainty_column is not None]
    return tuple(dict.fromkeys([*stamps, *named, *beside]))


def _read(written: Document, made: Manifest, number: int, source: Source, folder: Path) -> File:
    at: KeyPath = ("files", number, "path")
    path = folder / source.path
    try:
        raw = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        text = f"found '{source.path}' in {folder} unreadable ({reason}), wanted a file (--data names another folder)"
        raise ConfigError([written.problem(at, text)]) from error
    try:
        form = made.reading.format or foreign_files.format_of(path.name)
        there = foreign_files.names(raw, form, csv_of(made.reading))
        _refuse_absent(written, made, there, source)
        names = wanted(made)
        columns = foreign_files.read(raw, form, names, csv_of(made.reading))
    except ConfigError:
        raise
    except BadInput as error:
        raise ConfigError([written.problem(at, f"{source.path}: {error}")]) from error
    values = columns.values
    if KINDS[made.kind].timed and len(values) < 2:
        raise ConfigError([written.problem(at, f"{source.path}: found {len(values)} row, wanted a record")])
    table = Table(source.label or path.stem, names, values, dict(source.settings), source.held_out)
    return File(source, hashlib.sha256(raw).hexdigest(), len(raw), table, columns.said)


def _refuse_absent(written: Document, made: Manifest, there: Sequence[str], source: Source) -> None:
    """Columns that the file does not have, at the lines that name them."""
    problems = [
        written.problem(at, f"{source.path}: {foreign_files.no_column(name, there)}")
        for at, name in _places(made)
        if "[" not in name and name not in there and not any(one.startswith(f"{name}[") for one in there)
    ]
    if problems:
        raise ConfigError(problems)


def _places(made: Manifest) -> Iterator[tuple[KeyPath, str]]:
    if made.time is not None and made.time.column is not None:
        yield ("time", "column"), made.time.column
    for number, one in enumerate(made.columns):
        yield ("columns", number, "column"), one.column
        if one.uncertainty_column is not None:
            yield ("columns", number, "uncertainty_column"), one.uncertainty_column


def _of_segments(written: Document, made: Manifest, files: Sequence[File]) -> Iterator[Problem]:
    shortest = min((len(file.table.values) for file in files), default=0)
    for number, one in enumerate(made.segments):
        if made.kind == "rotation" and one.up is None:
            yield written.problem(("segments", number), "found no key 'up', wanted it to say how the case stood")
        if files and one.last > shortest:
            text = f"found row {one.last}, wanted at most {shortest}, which is where the file ends"
            yield written.problem(("segments", number, "last"), text)


def _twice(files: Sequence[File]) -> Iterator[Finding]:
    """Files with the same contents, byte for byte."""
    seen: dict[str, str] = {}
    for file in files:
        if file.sha256 in seen:
            text = f"{file.source.path} has the same contents as {seen[file.sha256]}, byte for byte"
            yield Finding("same_file", file.table.label, text)
        seen.setdefault(file.sha256, file.source.path)


def _odd(files: Sequence[File]) -> Iterator[Finding]:
    for file in files:
        yield from (Finding("lines", file.table.label, text) for text in file.odd)


def keep(read: Read, runs: Runs) -> str:
    """Make the run: a block and a point for every file, what was found, and the seal. Returns its name."""
    with runs.create(IMPORT, _header(read, runs), label=read.manifest.label) as writer:
        for one in read.found:
            writer.note("finding", found=one.as_json())
        for index, file in enumerate(read.files):
            name = f"file-{index:04d}"
            writer.block(name, file.table.values, {"columns": list(file.table.names), "file": file.source.path})
            writer.point_done(index, _point(file, name))
        writer.seal("completed")
        return writer.name


def _header(read: Read, runs: Runs) -> dict[str, Any]:
    made = read.manifest
    return {
        "simulated": False,
        "title": f"imported {KINDS[made.kind].title} of {made.unit.serial}",
        "started": runs.now(),
        "points_total": len(read.files),
        "imported": as_json(made),
        "sensor": {**made.unit.model_dump(), "channels": {}},
        "standards": list(_standards(made)),
        "overdue_overridden": [],
        "program": config.program_version(),
        "sources": [{"path": f.source.path, "sha256": f.sha256, "bytes": f.size} for f in read.files],
        "manifest": {
            "path": str(read.path),
            "sha256": hashlib.sha256(read.text).hexdigest(),
            "text": read.text.decode(),
        },
    }


def _standards(made: Manifest) -> Iterator[dict[str, Any]]:
    """What the manifest names, as a bench file would."""
    if made.standard is not None:
        stated = {key: value or "not stated" for key, value in made.standard.model_dump().items()}
        yield {"standard": stated.pop("name"), **stated, "values": {}}


def _point(file: File, block: str) -> dict[str, Any]:
    return {
        "label": file.table.label,
        "settings": dict(file.table.settings),
        "held_out": file.table.held_out,
        "table": block,
        "file": file.source.path,
        "sha256": file.sha256,
    }


def rate_of(data: Foreign, table: Table) -> float | None:
    """Usual samples per second, Hz; None for a table without time."""
    if data.manifest.time is None:
        return None
    stamps: Array = data.time(table)
    steps = np.diff(stamps)
    steps = steps[np.isfinite(steps) & (steps > 0.0)]
    # the mean of what is usual: time stamps are often rounded more coarsely than they were taken
    usual = steps[(steps > 0.5 * np.median(steps)) & (steps < 1.5 * np.median(steps))] if len(steps) else steps
    return float(1.0 / np.mean(usual)) if len(usual) else None
