"""What a disk may hold after a power cut: a run's calls to the operating system, replayed up to any moment.

Nothing is taken for granted but what POSIX promises. What was written to a file since its last sync is there up to some
byte; or, where there may be holes, each write by itself is there, lost, cut short, or zeros with what came later behind
it. Names made and changed in a folder since its last sync are there up to some moment. `faults` says what is not as
promised: the lines that were on the disk, whatever else was not, and that a run is over if its seal was.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

from rig.archive.reader import SEAL, Run
from rig.archive.runs import Runs


@dataclass
class _File:
    """What was ever written: `writes` of (number of the call, offset, bytes), and at which calls it was synced."""

    writes: list[tuple[int, int, bytes]] = field(default_factory=list)
    synced: list[int] = field(default_factory=list)


@dataclass
class _Folder:
    """Changes of its names, (number of the call, name, what it is or None where it goes), and when it was synced."""

    changes: list[tuple[int, str, _File | _Folder | None]] = field(default_factory=list)
    synced: list[int] = field(default_factory=list)

    def names(self, until: int) -> dict[str, _File | _Folder]:
        """As they are after so many calls."""
        found: dict[str, _File | _Folder] = {}
        for number, name, what in self.changes:
            if number < until and what is None:
                found.pop(name, None)
            elif number < until and what is not None:
                found[name] = what
        return found


@dataclass(frozen=True)
class Cut:
    """A power cut after so many calls: what draws what was on the disk (None: all of it), and whether holes may be."""

    moment: int
    rng: random.Random | None = None
    holes: bool = False


class Disk:
    """Watches what is done below a folder while `watched`; `calls` counts."""

    def __init__(self, root: Path) -> None:
        self.root, self.calls = root.resolve(), 0
        self._tree, self._handles = _Folder(), dict[int, tuple[_File | _Folder, int]]()
        self._lock, self._plain = threading.RLock(), {name: getattr(os, name) for name in WATCHED}

    def watched(self) -> Any:
        """For a `with` statement."""
        return mock.patch.multiple(os, **{name: getattr(self, f"_{name}") for name in WATCHED})

    def cuts(self, count: int, seed: int, holes: bool) -> Iterator[Cut]:
        """Moments, every one as likely as another."""
        rng = random.Random(seed)
        for _ in range(count):
            yield Cut(rng.randrange(1, self.calls + 1), random.Random(rng.random()), holes)

    def laid_out(self, cut: Cut, folder: Path) -> None:
        """Make a folder of what the disk held: what surely was there, and of the rest what is drawn."""
        self._lay(self._tree, cut, folder)

    def runs(self, moment: int) -> list[str]:
        """Names of folders below `runs` by then."""
        made = self._tree.names(moment).get("runs")
        return (
            sorted(n for n, one in made.names(moment).items() if isinstance(one, _Folder))
            if isinstance(made, _Folder)
            else []
        )

    def sealed(self, moment: int, name: str) -> bool:
        """Whether the seal of a run was on the disk by then."""
        folder = self._tree.names(moment)["runs"].names(moment)[name]  # type: ignore[union-attr]
        assert isinstance(folder, _Folder)
        return SEAL in folder.names(max((when for when in folder.synced if when < moment), default=0))

    def promised(self, moment: int, journal: str) -> list[Mapping[str, Any]]:
        """Lines of a journal that were on the disk by then: written whole, and synced afterwards."""
        place: _File | _Folder = self._tree
        for name in Path(journal).parts:
            found = place.names(moment).get(name) if isinstance(place, _Folder) else None
            if found is None or not any(when < moment for when in place.synced):
                return []
            place = found
        assert isinstance(place, _File)
        last = max((when for when in place.synced if when < moment), default=0)
        raw = b"".join(data for when, _, data in place.writes if when < last)
        return [json.loads(line) for line in raw.split(b"\n") if line]

    def _lay(self, place: _Folder, cut: Cut, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        surely = max((when for when in place.synced if when < cut.moment), default=0)
        drawn = cut.moment if cut.rng is None else cut.rng.randint(surely, cut.moment)
        until = drawn if cut.rng is None else cut.rng.choice([surely, cut.moment, drawn])
        for name, what in place.names(until).items():
            if isinstance(what, _Folder):
                self._lay(what, cut, folder / name)
            else:
                (folder / name).write_bytes(_content(what, cut))

    def _place(self, path: Any) -> tuple[_Folder, str] | None:
        """The folder and name of a path below the root; None of any other."""
        if isinstance(path, int):
            return None
        whole = Path(os.path.abspath(os.fspath(path)))
        if not whole.is_relative_to(self.root) or whole == self.root:
            return None
        place = self._tree
        for name in whole.relative_to(self.root).parts[:-1]:
            found = place.names(self.calls).get(name)
            if not isinstance(found, _Folder):
                return None
            place = found
        return place, whole.name

    def _made(self, place: _Folder, name: str, what: _File | _Folder | None) -> None:
        place.changes.append((self.calls, name, what))
        self.calls += 1

    def _open(self, path: Any, flags: int, mode: int = 0o777, **more: Any) -> int:
        with self._lock:
            descriptor: int = self._plain["open"](path, flags, mode, **more)
            where = self._place(path)
            if where is None:
                if not isinstance(path, int) and Path(os.path.abspath(os.fspath(path))) == self.root:
                    self._handles[descriptor] = self._tree, 0
                return descriptor
            place, name = where
            known = place.names(self.calls).get(name)
            if known is None:
                known = _File()
                self._made(place, name, known)
            size = len(_content(known, Cut(self.calls))) if isinstance(known, _File) else 0
            self._handles[descriptor] = known, size if flags & os.O_APPEND else 0
            return descriptor

    def _write(self, descriptor: int, data: Any) -> int:
        with self._lock:
            count: int = self._plain["write"](descriptor, data)
            file, at = self._handles.get(descriptor, (None, 0))
            if isinstance(file, _File):
                file.writes.append((self.calls, at, bytes(data)[:count]))
                self._handles[descriptor] = file, at + count
                self.calls += 1
            return count

    def _sync(self, name: str, descriptor: int) -> None:
        with self._lock:
            self._plain[name](descriptor)
            if descriptor in self._handles:
                self._handles[descriptor][0].synced.append(self.calls)
                self.calls += 1

    def _fsync(self, descriptor: int) -> None:
        self._sync("fsync", descriptor)

    def _fdatasync(self, descriptor: int) -> None:
        self._sync("fdatasync", descriptor)

    def _close(self, descriptor: int) -> None:
        with self._lock:
            self._plain["close"](descriptor)
            self._handles.pop(descriptor, None)

    def _unlink(self, path: Any, **named: Any) -> None:
        assert self._place(path) is None, "a file that goes"
        self._plain["unlink"](path, **named)

    def _truncate(self, path: Any, length: int) -> None:
        assert self._place(path) is None, "a file cut short"
        self._plain["truncate"](path, length)

    def _ftruncate(self, descriptor: int, length: int) -> None:
        assert descriptor not in self._handles, "a file cut short"
        self._plain["ftruncate"](descriptor, length)

    def _mkdir(self, path: Any, *more: Any, **named: Any) -> None:
        with self._lock:
            self._plain["mkdir"](path, *more, **named)
            if (where := self._place(path)) is not None:
                self._made(*where, _Folder())

    def _rename(self, old: Any, new: Any, **named: Any) -> None:
        with self._lock:
            self._plain["rename"](old, new, **named)
            if (where := self._place(old)) is not None and (there := self._place(new)) is not None:
                assert where[0] is there[0], "a file that moves between folders"
                moved = where[0].names(self.calls)[where[1]]
                number = self.calls
                where[0].changes += [(number, where[1], None), (number, there[1], moved)]  # both or none
                self.calls += 1


def _content(file: _File, cut: Cut) -> bytes:
    """What there is of a file."""
    surely = max((when for when in file.synced if when < cut.moment), default=0)
    found = bytearray()
    rng = cut.rng
    for number, at, data in file.writes:
        if number >= cut.moment:
            break
        kind = "whole"
        if rng is not None and number >= surely:
            kind = rng.choice(("whole", "whole", "lost", "cut", "hole") if cut.holes else ("whole", "whole", "cut"))
        kept = data[: rng.randrange(len(data))] if kind == "cut" and rng is not None else data
        end = at + len(kept)
        if kind != "lost":
            found.extend(bytes(max(end - len(found), 0)))
        if kind in ("whole", "cut"):
            found[at:end] = kept
        if kind == "cut" and not cut.holes:
            break
    return bytes(found)


WATCHED = ("open", "write", "fsync", "fdatasync", "close", "mkdir", "rename", "unlink", "truncate", "ftruncate")


def faults(disk: Disk, cut: Cut, folder: Path) -> Iterator[str]:
    """What is not as promised when the machine comes up again, in `folder`, with runs below `runs`."""
    disk.laid_out(cut, folder)
    archive = Runs(folder / "runs")
    for name in disk.runs(cut.moment):
        promised = disk.promised(cut.moment, f"runs/{name}/journal.jsonl")
        found = {run.name: run for run in archive.list()}.get(name)
        if found is None and promised:
            yield f"{name}: gone with {len(promised)} lines"
        elif found is not None and promised:
            yield from _faults_of(archive, found, promised, cut.holes)
            if disk.sealed(cut.moment, name) and Run(found.path).status != "completed":
                yield f"{name} is {Run(found.path).status}: its seal was on the disk"


def _faults_of(archive: Runs, run: Run, promised: Sequence[Mapping[str, Any]], holes: bool) -> Iterator[str]:
    """Of one run: its promised lines and blocks are read; without holes it goes on where it was, and is sound then."""
    lines = [entry.n for entry in run.lines()]
    if lines[: len(promised)] != [line["n"] for line in promised]:
        yield f"{run.name}: {len(lines)} lines, promised were {len(promised)}"
        return
    points = {line["body"]["index"] for line in promised if line["kind"] == "point"}
    if lost := points - run.points().keys():
        yield f"{run.name}: lost points {sorted(lost)}"
    for block in (line["body"] for line in promised if line["kind"] == "block"):
        kept = run.path / block["file"]
        if not kept.exists() or hashlib.sha256(kept.read_bytes()).hexdigest() != block["sha256"]:
            yield f"{run.name}: lost {block['file']}"
    status = run.status
    if status == "interrupted":
        with archive.reopen(run.name) as writer:
            if not points <= writer.points_done:
                yield f"{run.name}: goes on without {sorted(points - writer.points_done)}"
    if status != "damaged" and (wrong := Run(run.path).verify()):
        yield f"{run.name}: {wrong}"
    if status not in ("interrupted", "completed", *(["damaged"] if holes else [])):
        yield f"{run.name} is {status}: {run.verify()}"
