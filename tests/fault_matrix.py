"""`make faults`: every cell of the fault matrix in a process of its own, and docs/reference/faults.md of it.

What was said is kept in the folder `--out`, a file for each cell, and is used again as long as neither the cell nor
the sources have changed: an interrupted matrix goes on where it was.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import re
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fault_cells import cells
from fault_outcomes import BAD, OUTCOMES, Outcome, judged
from fault_page import page
from faulty_bench import Cell, Said, carried_out

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "reference" / "faults.md"
SOURCES = ("rig", "drivers", "procedures", "fixtures", "configs")
OWN = ("faulty_bench.py", "wire_proxy.py", "miswired.py", "in_process.py")
LIMIT = 600.0  # s of real time until a cell counts as hung: a busy machine may have twenty others to serve
EACH = 2.5  # s of processor time, about


def main() -> int:
    """Run what is asked for and missing; write the page if all is there. Exit 1 if any cell is as it must not be."""
    options = _options()
    chosen = [one for one in cells() if one.fault == "none" or all(word in one.name for word in options.only)]
    store = Store(options.out, options.stale)
    missing = [one for one in chosen if store.kept(one) is None]
    print(
        f"{len(chosen)} cells, {len(missing)} to run: about {len(missing) * EACH / 60 / options.jobs:.0f} min",
        flush=True,
    )
    for number, cell in enumerate(_run(missing, store, options.jobs), start=1):
        print(f"{number:>4} of {len(missing)}  {_line(cell, store)}", flush=True)
    outcomes = {cell: outcome_of(cell, store) for cell in chosen}
    for kind in OUTCOMES:
        print(f"{kind:<10} {sum(one.kind == kind for one in outcomes.values())}")
    for cell, one in outcomes.items():
        if one.kind in BAD:
            print(f"{one.kind}: {cell.name}: {one.words}")
    if not options.only:
        PAGE.write_text(page(outcomes, sum(store.is_stale(cell) for cell in chosen)), encoding="utf-8")
    return 1 if any(one.kind in BAD for one in outcomes.values()) else 0


class Store:
    """What was said in every cell, on disk."""

    def __init__(self, folder: Path, stale: bool = False) -> None:
        self.folder, self._stale, self._digest = folder, stale, _digest()
        folder.mkdir(parents=True, exist_ok=True)

    def path(self, cell: Cell) -> Path:
        """The cell's own file."""
        return self.folder / f"{hashlib.sha256((repr(cell.name)).encode()).hexdigest()[:16]}.json"

    def kept(self, cell: Cell) -> dict[str, Any] | None:
        """What is there of the cell as it is now: `said`, None in it for what hung."""
        try:
            found: dict[str, Any] = json.loads(self.path(cell).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return found if self._stale or found["of"] == self._of(cell) else None

    def is_stale(self, cell: Cell) -> bool:
        """Whether what is there was said with other sources, or of another cell by that name."""
        found = self.kept(cell)
        return found is not None and found["of"] != self._of(cell)

    def keep(self, cell: Cell, said: Said | None) -> None:
        """Write it down."""
        partial = self.path(cell).with_suffix(".part")
        body = {"cell": cell.name, "of": self._of(cell), "said": None if said is None else asdict(said)}
        partial.write_text(json.dumps(body), encoding="utf-8")
        partial.replace(self.path(cell))

    def said(self, cell: Cell) -> Said | None:
        """None if it hung. Raises KeyError if it was not run."""
        found = self.kept(cell)
        if found is None:
            raise KeyError(cell.name)
        return None if found["said"] is None else Said(**found["said"])

    def _of(self, cell: Cell) -> str:
        return hashlib.sha256(f"{_stated(cell)} {self._digest}".encode()).hexdigest()


def outcome_of(cell: Cell, store: Store) -> Outcome:
    """By number, against what the clean cell of the same procedure gave."""
    clean = store.said(next(one for one in cells() if one.procedure == cell.procedure and one.fault == "none"))
    return judged(store.said(cell), *(([], ()) if clean is None else (clean.rows, clean.flags)))


def _line(cell: Cell, store: Store) -> str:
    said = store.said(cell)
    try:
        one = outcome_of(cell, store)
    except KeyError:
        return f"{cell.name}"
    cost = "" if said is None else f" ({said.seconds:.1f} s, injected {said.injected})"
    return f"{one.kind:<9} {cell.name}{cost}: {one.words[:150]}"


def _stated(cell: Cell) -> str:
    """A cell in words that are the same in every process: functions by name only."""
    return re.sub(r" at 0x[0-9a-f]+", "", repr(cell))


def _digest() -> str:
    """Of everything that a cell's outcome can depend on."""
    found = hashlib.sha256()
    files = [path for name in SOURCES for path in (ROOT / name).rglob("*") if path.suffix in (".py", ".yaml")]
    for path in sorted([*files, *(ROOT / "tests" / name for name in OWN)]):
        found.update(path.read_bytes())
    return found.hexdigest()


def _run(missing: Iterable[Cell], store: Store, jobs: int) -> Iterator[Cell]:
    """Each in a child process, so many at a time; those that are done, as they are."""
    _load(store.folder)
    waiting = list(missing)[::-1]
    alive: dict[int, tuple[Cell, float]] = {}
    while waiting or alive:
        while waiting and len(alive) < jobs:
            cell = waiting.pop()
            if store.kept(cell) is None:  # else another matrix in the same folder was quicker
                alive[_begun(cell, store)] = (cell, time.monotonic())
        for pid, (cell, since) in list(alive.items()):
            over = time.monotonic() - since > LIMIT
            if over:
                os.killpg(pid, signal.SIGKILL)
            if os.waitpid(pid, 0 if over else os.WNOHANG)[0]:
                del alive[pid]
                if store.kept(cell) is None:
                    store.keep(cell, None)
                yield cell
        time.sleep(0.02)


def _begun(cell: Cell, store: Store) -> int:
    """The process that carries the cell out and keeps what was said."""
    if pid := os.fork():
        return pid
    os.setpgid(0, 0)
    folder = store.folder / f"cell-{os.getpid()}"
    code = 1
    try:
        folder.mkdir()
        store.keep(cell, carried_out(cell, folder))
        code = 0
    except Exception:  # noqa: BLE001 - the matrix itself is broken: say so, and go on
        traceback.print_exc()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(code)


def _load(folder: Path) -> None:
    """Load what a cell loads, so that no child needs to; threads of the bench must not be forked, so a child tells."""
    told = folder / "modules.json"
    if not os.fork():
        try:
            carried_out(Cell("sweep", "-", "none"), _fresh(folder / "first"))
            told.write_text(json.dumps(sorted(sys.modules)))
        finally:
            os._exit(0)
    os.wait()
    for name in json.loads(told.read_text()):
        if name.partition(".")[0] in ("rig", "drivers", "procedures", "pyvisa", "pyvisa_py", "serial", "matplotlib"):
            importlib.import_module(name)


def _fresh(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _options() -> Any:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "faults")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--stale", action="store_true", help="take what was said with other sources too")
    parser.add_argument("--only", action="append", default=[], help="only cells with this in their name")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
