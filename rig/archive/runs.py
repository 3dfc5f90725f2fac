"""Runs on disk: find them, read them back, check them, go on with them.

    <root>/2026-11-24T105500-sweep-x/
        journal.jsonl     what happened, line by line, each chained to the one before (rig.archive.journal)
        blocks/           raw numbers, closed files that the journal names with their digests
        seal.json         how it ended, with the journal's digest; a run without it is running or interrupted
        lock              held by the process that writes
        journal.torn      half a line that a power cut left, moved here when the run was resumed

The folders are the catalogue: nothing else has to be kept in step with them.
"""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.archive import journal
from rig.archive.durable import keeping, sync_folder, take_lock, waited_for, write_whole
from rig.archive.journal import BlockRef, Entry
from rig.archive.reader import Run, Status
from rig.archive.writer import BLOCKS, JOURNAL, LOCK, BlockStream, RunWriter
from rig.errors import ArchiveError, BadInput

__all__ = ["BlockRef", "BlockStream", "Entry", "Run", "RunWriter", "Runs", "Status"]


@dataclass(frozen=True)
class Runs:
    """All runs of a folder. `now` is the bench's clock (s since 1970 UTC), for the lines that will be written."""

    root: Path
    now: Callable[[], float] = time.time

    def create(self, procedure: str, header: Mapping[str, Any], label: str | None = None) -> RunWriter:
        """Begin a run; its name is the bench's time and `label` (default: the procedure): `2026-11-24T105500-sweep-x`.

        `header` should have `simulated` (bool) and `points_total` (int). Raises ArchiveError.
        """
        new = [one for one in (self.root, *self.root.parents) if not one.is_dir()]
        with keeping(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
        with keeping(self.root), waited_for(self.root / ".lock"):
            number = max((_sequence(run) for run in self.list()), default=0) + 1
            path = _new_folder(self.root, label or procedure, self.now())
            (path / BLOCKS).mkdir()
            lock = take_lock(path / LOCK)
            with _on_failure(lambda: os.close(lock)):
                writer = _writer(path, lock, self.now, b"", header)
            with _on_failure(writer.close):
                writer.note("header", **{**header, "run": path.name, "procedure": procedure, "sequence": number})
        with _on_failure(writer.close), keeping(path):
            writer.sync()
            for folder in (path, self.root, *(one.parent for one in new)):  # the first run of a root makes that too
                sync_folder(folder)
        return writer

    def list(self) -> Sequence[Run]:
        """Every run, oldest first: by the numbers that they were given, whatever the clock did meanwhile."""
        if not self.root.is_dir():
            return []
        with keeping(self.root), os.scandir(self.root) as folder:
            runs = [Run(Path(item.path)) for item in folder if _has_journal(item.path)]
        return _in_order(runs)

    def open(self, name: str) -> Run:
        """The run of that name; `last` is the newest. Raises BadInput if there is none."""
        runs = self.list()
        if not runs:
            raise BadInput(f"{self.root}: found no run, wanted one (`rig sweep --axis x` makes one)")
        if name == "last":
            return runs[-1]
        for run in runs:
            if run.name == name:
                return run
        near = difflib.get_close_matches(name, [run.name for run in runs], n=1)
        hint = near[0] if near else runs[-1].name
        raise BadInput(f"{self.root}: found no run '{name}', wanted one of {len(runs)} such as {hint}")

    def reopen(self, name: str) -> RunWriter:
        """Go on with an interrupted run, after checking all that is closed.

        Half a line left by a power cut is moved to `journal.torn`; nothing else is changed. Raises BadInput if the run
        is not interrupted, ArchiveError if it is not sound.
        """
        run = self.open(name)
        if run.status != "interrupted":
            raise BadInput(f"{run.name}: found it {run.status}, wanted an interrupted run")
        with keeping(run.path):
            lock = take_lock(run.path / LOCK)
        with _on_failure(lambda: os.close(lock)), keeping(run.path):
            _refuse_damage(run)
            torn = _set_torn_line_aside(run)
            writer = _writer(run.path, lock, self.now, (run.path / JOURNAL).read_bytes(), run.header)
        with _on_failure(writer.close):
            writer.note("resumed", points_done=len(writer.points_done), torn=torn)
            writer.sync()
        return writer


def _writer(path: Path, lock: int, now: Callable[[], float], raw: bytes, header: Mapping[str, Any]) -> RunWriter:
    taken = os.listdir(path / BLOCKS)
    return RunWriter(path, lock, now, raw=raw, taken=taken, points_total=header.get("points_total"))


@contextlib.contextmanager
def _on_failure(tidy: Callable[[], object]) -> Iterator[None]:
    try:
        yield
    except BaseException:
        tidy()
        raise


def _refuse_damage(run: Run) -> None:
    if run.seal is not None:  # sealed while we waited for the lock
        raise BadInput(f"{run.name}: found it sealed, wanted an interrupted run")
    if problems := run.verify():
        raise ArchiveError(f"{run.name}: found damage, wanted a sound run\n" + "\n".join(problems))


def _new_folder(root: Path, label: str, now: float) -> Path:
    """A new folder named after the bench's time, as what is dated within; making it is what claims the name."""
    slug = re.sub(r"[^a-z0-9]+", "-", label.lower()).strip("-") or "run"
    stem, count = f"{time.strftime('%Y-%m-%dT%H%M%S', time.gmtime(now))}-{slug}", 1
    while True:
        path = root / (stem if count == 1 else f"{stem}-{count}")
        try:
            path.mkdir()
            return path
        except FileExistsError:
            count += 1


def _set_torn_line_aside(run: Run) -> dict[str, Any] | None:
    """Move half a line at the end of the journal into a file of its own; says which, or None if there is none."""
    raw = (run.path / JOURNAL).read_bytes()
    _, torn = journal.split(raw)
    if not torn:
        return None
    count = sum(1 for _ in run.path.glob("journal.torn*"))
    aside = run.path / (f"journal.torn-{count + 1}" if count else "journal.torn")
    write_whole(aside, torn)
    os.truncate(run.path / JOURNAL, len(raw) - len(torn))
    return {"file": aside.name, "bytes": len(torn), "sha256": hashlib.sha256(torn).hexdigest()}


def _has_journal(folder: str) -> bool:
    """Whether a folder is a run: one that died before its header was written never began."""
    try:
        return os.stat(f"{folder}/{JOURNAL}").st_size > 0
    except OSError:
        return False


def _sequence(run: Run) -> int:
    """The number that a run was given; 0 if its header is damaged, or of before runs were numbered."""
    try:
        return int(run.header.get("sequence", 0))
    except ArchiveError:
        return 0


def _in_order(runs: Sequence[Run]) -> list[Run]:
    """By number; what has none stands behind the last that began before it."""
    known = [(_begun(run), run.name, _sequence(run), run) for run in runs]
    keyed, so_far = [], 0
    for begun, name, number, run in sorted(known, key=lambda one: one[:2]):
        so_far = max(so_far, number)
        keyed.append((number or so_far, begun, name, run))
    return [run for *_, run in sorted(keyed, key=lambda one: one[:3])]


def _begun(run: Run) -> float:
    """When a run began, by the machine's clock; a damaged one by its file's time."""
    try:
        return run.header_entry.wall
    except ArchiveError:
        return (run.path / JOURNAL).stat().st_mtime
