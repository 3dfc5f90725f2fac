"""The blind test: hide an effect in a simulated world, seal the answer, diagnose the records, then score.

    python tests/benchmarks/blind.py --worlds 30 --out blind [--only one] [--only next] [--wire 20] [--peers]

`--worlds` is the number of worlds for each effect that is scored by name; the other tables keep their proportion to it
(30 makes the whole study). `next` looks again at worlds of `one` that were not exact, after one more measurement;
`wire` does everything by the commands that a user has, over sockets. A study that was interrupted goes on where it was:
worlds with a result are not done again.
Answers, results and the page with the tables are in the folder. Every world uses one thread, all cores are used.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded

import argparse
import hashlib
import json
import statistics
import sys
import time
import zlib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

sys.path.insert(0, str(Path(__file__).parents[1]))

import blind_imports
import blind_next
import blind_page
import blind_peers
import blind_scores
import blind_trials
import blind_wire
import blind_worlds
from blind_worlds import Answer, Case

import rig

EVERYTHING = (*blind_worlds.TABLES, "next", "wire")
Placed = TypeVar("Placed", Case, Answer)
SLOWEST_FIRST = ("turntable", "shaker")  # then imported records
ENGINE = (
    "fit/*.py", "diagnose/*.py", "parts/**/*.py", "signals/*.py", "effects/*.py", "formula.py", "model.py", "motion.py",
)  # fmt: skip
SECONDS = {
    "shaker": 20.0,
    "turntable": 25.0,
    **dict.fromkeys(blind_imports.KINDS, 1.0),
}  # of a world on one core, where no result tells yet


def main() -> int:
    """Run what is missing of the study and print its tables."""
    asked = _asked()
    if asked.slice:
        return _sliced(Path(asked.slice))
    folder, wanted = Path(asked.out), asked.only or EVERYTHING
    if asked.peers and not blind_peers.pysindy_there():
        print("found no pysindy, wanted it for --peers; next: make blind PEERS=1, which installs it")
        return 2
    _note_engine(folder)
    cases = blind_worlds.cases(asked.worlds, [one for one in wanted if one in blind_worlds.TABLES], asked.series)
    _diagnosed(cases, folder, asked)
    if "next" in wanted:
        _measured_again(folder, asked)
    if "wire" in wanted:
        _over_the_wire(folder, asked)
    if asked.peers:
        _shown_to_peers(cases, folder, asked)
    page = page_of(folder, _made_by(asked), len(cases))
    written = Path(asked.page) if asked.page else folder / "table.md"
    written.write_text(page, encoding="utf-8")
    print(page)
    print(f"next: read {written}; a world's answer and diagnosis are in {folder / 'results'}")
    return 0


def _diagnosed(cases: Sequence[Case], folder: Path, asked: argparse.Namespace) -> None:
    missing = [case for case in cases if not (folder / "results" / f"{case.id}.json").exists()]
    print(expected(missing, folder, asked.processes), flush=True)
    _carried_out(partial(blind_trials.trial, folder=folder), _slow_first(missing), asked.processes, "diagnosed")


def expected(missing: Sequence[Case], folder: Path, processes: int) -> str:
    """How long the worlds that have no result yet will take, by those that have one."""
    took: dict[str, list[float]] = {}
    for path in (folder / "results").glob("*.json"):
        result = json.loads(path.read_text(encoding="utf-8"))
        if "took" in result:
            took.setdefault(result["bench"], []).append(float(result["took"]))
    each = {**SECONDS, **{bench: statistics.median(values) for bench, values in took.items()}}
    hours = sum(each[case.bench] for case in missing) / 3600.0 / max(min(processes, len(missing)), 1)
    return f"{len(missing)} worlds to diagnose, about {hours:.1f} h on {processes} cores"


def _measured_again(folder: Path, asked: argparse.Namespace) -> None:
    chosen = blind_next.chosen(blind_scores.trials(folder), asked.worlds)
    missing = [one for one in chosen if not (folder / blind_next.FOLDER / f"{one.id}.json").exists()]
    _carried_out(partial(blind_next.again, folder=folder), _slow_first(missing), asked.processes, "measured again")


def _over_the_wire(folder: Path, asked: argparse.Namespace) -> None:
    count = blind_wire.count(asked.worlds) if asked.wire is None else asked.wire
    missing = [n for n in blind_wire.seeds(count, asked.series) if not blind_wire.place(n, folder).exists()]
    _carried_out(partial(blind_wire.tried, folder=folder), missing, asked.processes, "done over the wire")


def _shown_to_peers(cases: Sequence[Case], folder: Path, asked: argparse.Namespace) -> None:
    compared = [case for case in cases if case.table in ("clean", "one")]
    missing = [case for case in compared if not (folder / "peers" / f"{case.id}.json").exists()]
    _carried_out(partial(blind_peers.compared, folder=folder), _slow_first(missing), asked.processes, "shown to peers")


def _made_by(asked: argparse.Namespace) -> str:
    """The command that makes this study again."""
    only = f' ONLY="{" ".join(asked.only)}"' if asked.only else ""
    wire = "" if asked.wire is None else f" WIRE={asked.wire}"
    series = "" if asked.series == "1" else f" SERIES={asked.series}"
    return f"make blind N={asked.worlds}{series}{only}{wire}{' PEERS=1' if asked.peers else ''}"


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--worlds", type=int, default=30, metavar="N", help="worlds for each effect by name (30)")
    parser.add_argument("--out", default="runs/blind", metavar="FOLDER", help="where answers and results are kept")
    parser.add_argument("--only", action="append", choices=EVERYTHING, help="one table; may be repeated")
    parser.add_argument("--wire", type=int, metavar="W", help="worlds over the wire (two thirds of N, at least 2)")
    parser.add_argument("--peers", action="store_true", help="also pysindy, lasso and forward selection")
    parser.add_argument("--page", metavar="FILE", help="where the tables are written (table.md in the folder)")
    parser.add_argument("--series", default="1", help="another name draws other worlds")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, metavar="P", help="all cores")
    parser.add_argument("--slice", metavar="FILE", help="only draw the worlds of the test suite anew")
    return parser.parse_args()


def _sliced(path: Path) -> int:
    """Write the worlds of the test suite's slice, so that it need not size them every time."""
    kinds = path.with_name("blind_kinds.json")
    for to, cases in ((path, blind_worlds.slice_of_all()), (kinds, blind_worlds.slice_of_kinds())):
        blind_worlds.write(to, {"answers": [asdict(blind_worlds.drawn(case)) for case in cases]})
    print(
        f"next: look at {path} and {kinds}, and run pytest tests/rig/test_blind_slice.py tests/rig/test_blind_kinds.py"
    )
    return 0


def _slow_first(items: Sequence[Placed]) -> list[Placed]:
    """The slow ones first; those of each bench mixed, so that a study that was interrupted tells of all."""
    order = {bench: place for place, bench in enumerate(SLOWEST_FIRST)}
    return sorted(items, key=lambda one: (order.get(one.bench, len(order)), zlib.crc32(f"order {one.id}".encode())))


def _carried_out(work: Callable[[Any], object], items: Sequence[Any], processes: int, done: str) -> None:
    """Do the work for all items on all cores, in this order, and say from time to time how far it is."""
    if not items:
        return
    begun = said = time.monotonic()
    with ProcessPoolExecutor(processes) as pool:
        waiting = [pool.submit(work, one) for one in items]
        for number, one in enumerate(as_completed(waiting), 1):
            one.result()
            if time.monotonic() - said > 10.0 or number == len(items):
                said = time.monotonic()
                print(f"{number} of {len(items)} {done}, {said - begun:.0f} s", flush=True)


def _note_engine(folder: Path) -> None:
    """Say so if the program has changed since the folder's first results."""
    root = Path(rig.__file__).parent
    total = hashlib.sha256()
    for path in sorted(path for pattern in ENGINE for path in root.glob(pattern)):
        total.update(path.read_bytes())
    note = folder / "program.json"
    if not note.exists():
        blind_worlds.write(note, {"digest": total.hexdigest()})
    elif json.loads(note.read_text(encoding="utf-8"))["digest"] != total.hexdigest():
        print(f"note: the program has changed since {folder} was begun; its results are kept, remove it to begin anew")


def page_of(folder: Path, made_by: str, asked: int) -> str:
    """The page of all results in a folder; `asked` is how many worlds the command makes."""
    found = blind_scores.trials(folder)
    pairs = []
    for one in found:
        path = folder / "peers" / f"{one.answer.id}.json"
        if path.exists():
            pairs.append((one.answer, json.loads(path.read_text(encoding="utf-8")), one.result))
    peers = blind_peers.table(pairs) if pairs else ()
    return blind_page.page(
        blind_page.Study(made_by, found, blind_next.trials(folder), blind_wire.found(folder), peers, asked)
    )


if __name__ == "__main__":
    raise SystemExit(main())
