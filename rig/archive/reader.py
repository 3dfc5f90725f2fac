"""The reading side of a run: its status, its lines and numbers, and whether all of it is as it was written."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rig.archive import journal
from rig.archive.durable import keeping, lock_is_held, write_whole
from rig.archive.guard_log import GUARD_LOG, GuardLog
from rig.archive.journal import BlockRef, BrokenLineError, Entry
from rig.archive.writer import JOURNAL, LOCK, SEAL
from rig.errors import ArchiveError, BadInput

UNMET = "unmet.json"  # what an `expect` missed, judged when the record was whole already

Status = Literal["running", "interrupted", "completed", "failed", "aborted", "damaged"]


@dataclass(frozen=True)
class Run:
    """One run, for reading, while it is written or years later."""

    path: Path

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def status(self) -> Status:
        """`running` if a live process holds the lock, `interrupted` without lock and seal, else what the seal says.

        `damaged` if the journal or the seal are not as they were written; `verify` says more, also of the blocks.
        """
        if lock_is_held(self.path / LOCK):
            return "running"
        try:
            seal = self.seal
            self._refuse_damage(seal)
        except ArchiveError:
            return "damaged"
        status: Status = "interrupted" if seal is None else seal.body["status"]
        return status

    @cached_property
    def header_entry(self) -> Entry:
        """The journal's first line; raises ArchiveError if it is damaged."""
        with keeping(self.path / JOURNAL), open(self.path / JOURNAL, "rb") as file:
            first = file.readline()
        try:
            return journal.read_line(first, journal.GENESIS, 0)
        except BrokenLineError as error:
            raise ArchiveError(f"{self.path / JOURNAL}: line 1: {error}") from error

    @property
    def header(self) -> Mapping[str, Any]:
        """What was known before the first step: procedure, settings, instruments, standards, program."""
        return self.header_entry.body

    @property
    def seal(self) -> Entry | None:
        """The seal, None without one; raises ArchiveError if it is damaged."""
        try:
            raw = (self.path / SEAL).read_bytes()
        except FileNotFoundError:
            return None
        try:
            return journal.read_line(raw, journal.GENESIS, 0)
        except BrokenLineError as error:
            raise ArchiveError(f"{SEAL}: {error}") from error

    def lines(self) -> Iterator[Entry]:
        """Every line of the journal, oldest first, up to a torn last one, or a damaged one: then the status says so.

        Raises ArchiveError if not even the header can be read.
        """
        yield self.header_entry
        with contextlib.suppress(BrokenLineError):
            yield from itertools.islice(journal.entries(self._raw()), 1, None)

    def points(self) -> dict[int, Mapping[str, Any]]:
        """Bodies of the points done, by index; of a point measured twice, the later."""
        return points_of(self.lines())

    def blocks(self) -> dict[str, tuple[BlockRef, ...]]:
        """Blocks by name, each with its pieces in order; of a name used twice, the later."""
        return blocks_of(self.lines())

    def block(self, name: str) -> NDArray[Any]:
        """The numbers of a block, mapped from the file (read-only); the pieces of a stream are joined in memory.

        Raises BadInput for an unknown name, ArchiveError if the file is missing or too short.
        """
        return self.joined(name, self.blocks().get(name, ()))

    def joined(self, name: str, references: Sequence[BlockRef]) -> NDArray[Any]:
        """The numbers of a block whose pieces are known, as `block` gives them."""
        if not references:
            raise BadInput(f"{self.name}: found no block '{name}', wanted one of the journal's")
        pieces = [self.read(reference) for reference in references]
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)

    def read(self, reference: BlockRef) -> NDArray[Any]:
        """The numbers of one file, mapped and read-only."""
        path, dtype = self.path / reference.file, _numbers(reference)
        wanted = int(np.prod(reference.shape, dtype=np.int64)) * dtype.itemsize
        found = path.stat().st_size if path.exists() else -1
        if found != wanted:
            size = "no file" if found < 0 else f"{found} bytes"
            raise ArchiveError(f"{path}: found {size}, wanted {wanted} bytes")
        if not wanted:
            return np.empty(reference.shape, dtype)
        return np.memmap(path, dtype=dtype, mode="r", shape=reference.shape)

    def summary(self) -> dict[str, Any]:
        """What `show` prints as JSON; unknown is None in a damaged run."""
        status = self.status
        try:
            header: Mapping[str, Any] = self.header
            done: int | None = self._points_done(status)
        except ArchiveError:
            header, done = {}, None
        return {
            "run": self.name,
            "procedure": header.get("procedure"),
            "status": status,
            "points_done": done,
            "points_total": header.get("points_total"),
            "simulated": header.get("simulated"),
            "path": str(self.path),
            "not_safe": self.not_safe if status != "running" else None,
            "unmet": list(self.unmet),
        }

    @property
    def unmet(self) -> Sequence[str]:
        """What the procedure's `expect` missed when the run was concluded; nothing if all was met, or none judged."""
        try:
            found = json.loads((self.path / UNMET).read_bytes())
        except (OSError, ValueError):
            return ()
        return tuple(map(str, found)) if isinstance(found, list) else ()

    def keep_unmet(self, missed: Sequence[str]) -> None:
        """Keep it beside the sealed record. Raises ArchiveError."""
        write_whole(self.path / UNMET, json.dumps(list(missed), ensure_ascii=False).encode())

    @property
    def not_safe(self) -> str | None:
        """What this run has left energised as far as is known, by the log of its guard; None if nothing."""
        return GuardLog(self.path / GUARD_LOG).not_safe()

    def verify(self) -> list[str]:
        """Everything that is closed but not as it was written, as `file: found …, wanted …`; empty if all is sound."""
        entries, problems = self._verified_lines()
        problems += [text for entry in entries for text in self._block_problems(entry)]
        problems += [text for entry in entries if entry.kind == "resumed" for text in self._torn_problems(entry)]
        return problems + self._seal_problems(entries)

    def _raw(self) -> bytes:
        with keeping(self.path / JOURNAL):
            return (self.path / JOURNAL).read_bytes()

    def _points_done(self, status: Status) -> int:
        """As the seal says without reading the journal, unless what stands there can no longer all be read."""
        seal = None if status == "damaged" else self.seal
        return len(self.points()) if seal is None else int(seal.body["points_done"])

    def _refuse_damage(self, seal: Entry | None) -> None:
        """Raises ArchiveError if the journal is not that of the seal, or without one, is broken anywhere."""
        raw = self._raw()
        if seal is None:
            try:
                sound = sum(1 for _ in journal.entries(raw)) > 0
            except BrokenLineError:
                sound = False
        else:
            sound = hashlib.sha256(raw).hexdigest() == seal.body["journal_sha256"]
        if not sound:
            raise ArchiveError(f"{self.path / JOURNAL}: found it damaged, wanted it as it was written")

    def _verified_lines(self) -> tuple[list[Entry], list[str]]:
        entries: list[Entry] = []
        problems: list[str] = []
        lines, torn = journal.split(self._raw())
        chain = journal.GENESIS
        at = 0
        for n, raw in enumerate(lines):
            try:
                entries.append(journal.read_line(raw, chain, n))
            except BrokenLineError as error:
                problems.append(f"{JOURNAL} line {n + 1}, from byte {at}: {error}")
            chain = journal.claimed_chain(raw)
            at += len(raw)
        if not lines:
            problems.append(f"{JOURNAL}: found no line, wanted a header")
        if torn and _is_line(torn[:-1] + b"\n", chain, len(lines)):  # whole but for its end: changed, not torn
            problems.append(f"{JOURNAL} line {len(lines) + 1}: found a changed line end, wanted a new line")
        return entries, problems

    def _block_problems(self, entry: Entry) -> list[str]:
        if entry.kind != "block":
            return []
        reference = BlockRef.of(entry)
        try:
            digest = _file_digest(self.path / reference.file)
        except OSError as error:
            return [f"{reference.file}: found {error.strerror}, wanted the block of line {entry.n + 1}"]
        if digest != reference.sha256:
            return [f"{reference.file}: found contents that do not match line {entry.n + 1}, wanted them as written"]
        return []

    def _torn_problems(self, entry: Entry) -> list[str]:
        torn = entry.body["torn"]
        if torn is None:
            return []
        path = self.path / torn["file"]
        if not path.exists() or _file_digest(path) != torn["sha256"]:
            return [f"{torn['file']}: found it missing or changed, wanted the torn line as it was"]
        return []

    def _seal_problems(self, entries: list[Entry]) -> list[str]:
        try:
            seal = self.seal
        except ArchiveError as error:
            return [str(error)]
        if seal is None:
            return []
        problems = []
        if hashlib.sha256(self._raw()).hexdigest() != seal.body["journal_sha256"]:
            problems.append(f"{JOURNAL}: found another journal than the sealed one, wanted {seal.body['lines']} lines")
        acknowledged = {entry.body["file"]: entry.body["sha256"] for entry in entries if entry.kind == "block"}
        if acknowledged != seal.body["blocks"]:
            problems.append(f"{SEAL}: found other blocks than in the journal, wanted the same")
        return problems


def _numbers(reference: BlockRef) -> np.dtype[Any]:
    """The kind of numbers of a block; ArchiveError if it is none."""
    wanted = f"block {reference.name}: found numbers of the kind {reference.dtype!r}, wanted one such as '<u2'"
    try:
        dtype = np.dtype(reference.dtype)
    except (TypeError, ValueError):
        raise ArchiveError(wanted) from None
    if dtype.kind not in "uifcb" or min(reference.shape, default=0) < 0:
        raise ArchiveError(wanted)
    return dtype


def points_of(lines: Iterable[Entry]) -> dict[int, Mapping[str, Any]]:
    """Bodies of the points done, by index; of a point measured twice, the later."""
    return {int(entry.body["index"]): entry.body for entry in lines if entry.kind == "point"}


def blocks_of(lines: Iterable[Entry]) -> dict[str, tuple[BlockRef, ...]]:
    """Blocks by name, each with its pieces in order; of a name used twice, the later."""
    found: dict[str, tuple[BlockRef, ...]] = {}
    for entry in lines:
        if entry.kind == "block":
            reference = BlockRef.of(entry)
            before = found.get(reference.name, ()) if reference.piece else ()
            found[reference.name] = (*before, reference)
    return found


def _is_line(raw: bytes, chain: str, n: int) -> bool:
    try:
        journal.read_line(raw, chain, n)
    except BrokenLineError:
        return False
    return True


def _file_digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
