"""The writing side of a run: an append-only journal, closed blocks beside it, and a seal at the end.

What is promised, and when: a line is with the operating system when `note` returns (it survives a killed process), and
on the disk within a second or at the seal. A block is on the disk, under its final name, before the journal says so.
Nothing is overwritten. The lock file is held as long as the writer lives, so that others can tell running from
interrupted.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.archive import journal
from rig.archive.durable import AppendOnly, NewFile, keeping, write_whole
from rig.archive.journal import BlockRef
from rig.errors import ArchiveError, BadInput, BenchUnreachable

JOURNAL, SEAL, LOCK, BLOCKS = "journal.jsonl", "seal.json", "lock", "blocks"
PIECE_BYTES = 8 * 1024 * 1024  # a stream's files are closed at this size
OUTCOMES = ("completed", "failed", "aborted")
Outcome = Literal["completed", "failed", "aborted"]

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


@dataclass(frozen=True)
class _Written:
    """How far the journal is: lines, last chain digest, bytes."""

    lines: int
    chain: str
    size: int


@dataclass(frozen=True)
class _Line:
    """A line on its way into the file, and how far the journal is once it is there."""

    kind: str
    body: Mapping[str, Any]
    then: _Written


class RunWriter:
    """Writes one run; made by `Runs.create` and `Runs.reopen`. Threads may share it."""

    def __init__(
        self,
        path: Path,
        lock: int,
        now: Callable[[], float],
        *,
        raw: bytes,
        taken: Iterable[str],
        points_total: int | None,
    ) -> None:
        """`lock` is the descriptor of the held lock, and is closed with the writer. `raw` is the sound journal so far,
        `taken` the names in the blocks folder."""
        self.path, self._lock, self._now = path, lock, now
        self._mutex = threading.Lock()
        self._taken, self._points_total = set(taken), points_total
        self._points: set[int] = set()
        self._blocks: dict[str, str] = {}
        self._written, self._last_time = _Written(0, journal.GENESIS, 0), 0.0
        for entry in journal.entries(raw):
            self._written = _Written(entry.n + 1, entry.chain, len(raw))
            self._last_time = entry.t
            self._count(entry.kind, entry.body)
        self._pending: _Line | None = None
        self._sealed = self._closed = False
        self._file = AppendOnly(path / JOURNAL)

    @property
    def name(self) -> str:
        """The run's name, which is its folder's."""
        return self.path.name

    @property
    def points_done(self) -> frozenset[int]:
        """Indices of the points in the journal."""
        return frozenset(self._points)

    def note(self, kind: str, **body: Any) -> int:
        """Append one line; returns its number. Raises ArchiveError; what was written before stays."""
        return self._append(kind, body)

    def point_done(self, index: int, body: Mapping[str, Any]) -> int:
        """A point of the plan is measured and all its blocks are closed."""
        return self._append("point", {**body, "index": index})

    def block(self, name: str, counts: ArrayLike, meta: Mapping[str, Any] | None = None) -> BlockRef:
        """Keep an array of numbers as a closed file; the reference is in the journal when this returns.

        `counts` may have any shape and any integer, real, complex or boolean type. `meta` says what they are: scale,
        unit, channels, sample instants.
        """
        array = _little_endian(counts)
        file = self._new_file(name, array.dtype)
        file.write(_bytes(array))
        return self._acknowledge(file, name, array.dtype, array.shape, meta or {}, 0)

    def block_stream(self, name: str, meta: Mapping[str, Any] | None = None) -> BlockStream:
        """Keep a long record in pieces, each a closed file of at most 8 MiB."""
        return BlockStream(self, name, meta or {})

    def sync(self) -> None:
        """Put the journal on the disk now. Raises ArchiveError."""
        self._file.sync()

    def seal(self, status: Outcome, reason: str = "") -> None:
        """End the run. Only a run with all its points is completed; raises ArchiveError otherwise."""
        if status not in OUTCOMES:
            raise BadInput(f"{self.name}: found the status '{status}', wanted {' or '.join(OUTCOMES)}")
        with self._mutex:
            self._settle()
            self._sealed = self._sealed or (self.path / SEAL).exists()
            self._refuse_if_over()
            self._refuse_missing_points(status)
            self._file.sync()
            body = self._seal_body(status, reason)
            data, _ = journal.line(0, self._time(), time.time(), "seal", body, journal.GENESIS)
            write_whole(self.path / SEAL, data)
            self._sealed = True
        self.close()

    def close(self) -> None:
        """Let go of the run; without a seal it is interrupted and can be resumed."""
        with self._mutex:
            if self._closed:
                return
            self._closed = True
        self._file.close()
        os.close(self._lock)

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def _append(self, kind: str, body: Mapping[str, Any]) -> int:
        with self._mutex:
            self._refuse_if_over()
            self._settle()
            before = self._written
            data, chain = journal.line(before.lines, self._time(), time.time(), kind, body, before.chain)
            then = _Written(before.lines + 1, chain, before.size + len(data))
            self._pending = _Line(kind, body, then)
            self._file.append(data, before.size)
            self._settle()
            return before.lines

    def _settle(self) -> None:
        """Count the line on its way if it is in the file: Ctrl-C may come between writing and counting."""
        line = self._pending
        if line is not None and not self._closed and self._file.size() == line.then.size:
            self._count(line.kind, line.body)
            self._written = line.then
        self._pending = None

    def _count(self, kind: str, body: Mapping[str, Any]) -> None:
        if kind == "point":
            self._points.add(int(body["index"]))
        elif kind == "block":
            self._blocks[str(body["file"])] = str(body["sha256"])

    def _seal_body(self, status: Outcome, reason: str) -> dict[str, Any]:
        with keeping(self.path / JOURNAL):
            raw = (self.path / JOURNAL).read_bytes()
        return {
            "status": status,
            "reason": reason,
            "lines": self._written.lines,
            "journal_sha256": hashlib.sha256(raw).hexdigest(),
            "points_done": len(self._points),
            "blocks": self._blocks,
        }

    def _refuse_missing_points(self, status: Outcome) -> None:
        missing = (self._points_total or 0) - len(self._points)
        if status == "completed" and missing > 0:
            found = f"{len(self._points)} of {self._points_total} points"
            raise ArchiveError(f"{self.name}: found {found}, wanted all of them in a completed run")

    def _time(self) -> float:
        """The bench's clock, or when it was last heard of: a lost bench must still be put on record."""
        with contextlib.suppress(BenchUnreachable):
            self._last_time = self._now()
        return self._last_time

    def _refuse_if_over(self) -> None:
        if self._sealed or self._closed:
            raise ArchiveError(f"{self.name}: found it {'sealed' if self._sealed else 'closed'}, wanted an open run")

    def _new_file(self, name: str, dtype: np.dtype[Any]) -> NewFile:
        """A file under a name that was never used in this run."""
        if not _NAME.fullmatch(name):
            raise BadInput(f"{self.name}: found the block name '{name}', wanted letters, digits, dots and dashes")
        with self._mutex:
            self._refuse_if_over()
            stem, count = name, 1
            while (file := f"{stem}.{dtype.str[1:]}") in self._taken:
                count += 1
                stem = f"{name}-{count}"
            self._taken.add(file)
        return NewFile(self.path / BLOCKS / file)

    def _acknowledge(
        self,
        file: NewFile,
        name: str,
        dtype: np.dtype[Any],
        shape: tuple[int, ...],
        meta: Mapping[str, Any],
        piece: int,
    ) -> BlockRef:
        file.close()
        reference = BlockRef(name, f"{BLOCKS}/{file.path.name}", dtype.str, shape, file.sha256, meta, piece)
        self._append("block", vars(reference))
        return reference


class BlockStream:
    """A long record of rows, kept in closed files of at most 8 MiB; memory holds no more than one `append`.

    The record ends at `close`, which says in the journal how many rows and pieces it has.
    """

    def __init__(self, writer: RunWriter, name: str, meta: Mapping[str, Any]) -> None:
        self._writer, self._name, self._meta = writer, name, meta
        self._file: NewFile | None = None
        self._form: tuple[np.dtype[Any], tuple[int, ...]] | None = None
        self._rows = 0  # in the open file
        self.rows, self.pieces = 0, 0

    def append(self, rows: ArrayLike) -> None:
        """Add rows, shape (n, …); the first call settles type and shape. Raises ArchiveError, BadInput."""
        array = _little_endian(rows)
        form = (array.dtype, array.shape[1:])
        if array.ndim == 0 or (self._form or form) != form:
            raise BadInput(f"{self._name}: found rows of {form}, wanted {self._form}, as before")
        self._form = form
        room = max(1, PIECE_BYTES // max(1, array[:1].nbytes))
        while len(array):
            part, array = array[: room - self._rows], array[room - self._rows :]
            self._write(part)
            if self._rows == room:
                self._close_piece()

    def close(self) -> None:
        """Close the last piece and put the record's length in the journal."""
        if self._file is not None:
            self._close_piece()
        self._writer.note("stream", name=self._name, rows=self.rows, pieces=self.pieces)

    def _write(self, part: NDArray[Any]) -> None:
        if self._file is None:
            self._file = self._writer._new_file(f"{self._name}-{self.pieces:04d}", part.dtype)
        try:
            self._file.write(_bytes(part))
        except ArchiveError:
            self._file, self._rows = None, 0  # given up; the pieces closed before stay
            raise
        self._rows += len(part)

    def _close_piece(self) -> None:
        assert self._file is not None
        assert self._form is not None
        dtype, tail = self._form
        file, self._file = self._file, None
        self._writer._acknowledge(file, self._name, dtype, (self._rows, *tail), self._meta, self.pieces)
        self.rows, self.pieces, self._rows = self.rows + self._rows, self.pieces + 1, 0


def _little_endian(counts: ArrayLike) -> NDArray[Any]:
    array = np.asarray(counts)
    if array.dtype.kind not in "biufc":
        raise BadInput(f"block: found elements of type {array.dtype}, wanted numbers")
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).reshape(array.shape)


def _bytes(array: NDArray[Any]) -> memoryview:
    return array.reshape(-1).view(np.uint8).data
