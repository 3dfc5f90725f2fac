"""The blind test: hide an effect in a simulated world, seal the answer, diagnose the records, then score.

    python tests/benchmarks/blind.py --worlds 30 --out blind [--only one] [--peers]

`--worlds` is the number of worlds for each effect that is scored by name; the other tables keep their proportion to it
(30 makes the whole study). A study that was interrupted goes on where it was: worlds with a result are not done again.
Answers, results and the page with the tables are in the folder. Every world uses one thread, all cores are used.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import blind_peers
import blind_scores
import blind_trials
import blind_worlds
from blind_worlds import Case

import rig

SLOWEST_FIRST = ("turntable", "shaker")
ENGINE = ("estimate/*.py", "effects/*.py", "model.py", "motion.py")


def main() -> int:
    """Run what is missing of the study and print its tables."""
    asked = _asked()
    if asked.slice:
        return _sliced(Path(asked.slice))
    folder, tables = Path(asked.out), asked.only or list(blind_worlds.TABLES)
    cases = blind_worlds.cases(asked.worlds, tables, asked.series)
    if asked.peers and not blind_peers.pysindy_there():
        print("found no pysindy, wanted it for --peers; next: make blind PEERS=1, which installs it")
        return 2
    _note_engine(folder)
    missing = [case for case in cases if not (folder / "results" / f"{case.id}.json").exists()]
    _carried_out(partial(blind_trials.trial, folder=folder), missing, asked.processes, "diagnosed")
    if asked.peers:
        compared = [case for case in cases if case.table in ("clean", "one")]
        compared = [case for case in compared if not (folder / "peers" / f"{case.id}.json").exists()]
        _carried_out(partial(blind_peers.compared, folder=folder), compared, asked.processes, "shown to the peers")
    page = _page(folder)
    written = Path(asked.page) if asked.page else folder / "table.md"
    written.write_text(page, encoding="utf-8")
    print(page)
    print(f"next: read {written}; a world's answer and diagnosis are in {folder / 'results'}")
    return 0


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--worlds", type=int, default=30, metavar="N", help="worlds for each effect by name (30)")
    parser.add_argument("--out", default="runs/blind", metavar="FOLDER", help="where answers and results are kept")
    parser.add_argument("--only", action="append", choices=blind_worlds.TABLES, help="one table; may be repeated")
    parser.add_argument("--peers", action="store_true", help="also pysindy, lasso and forward selection")
    parser.add_argument("--page", metavar="FILE", help="where the tables are written (table.md in the folder)")
    parser.add_argument("--series", default="1", help="another name draws other worlds")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, metavar="P", help="all cores")
    parser.add_argument("--slice", metavar="FILE", help="only draw the thirty worlds of the test suite anew")
    return parser.parse_args()


def _sliced(path: Path) -> int:
    """Write the worlds of the test suite's slice, so that it need not size them every time."""
    blind_worlds.write(path, {"answers": [asdict(blind_worlds.drawn(case)) for case in blind_worlds.slice_of_all()]})
    print(f"next: look at {path} and run pytest tests/rig/test_blind_slice.py")
    return 0


def _carried_out(work: Callable[[Case], object], cases: Sequence[Case], processes: int, done: str) -> None:
    """Do the work for all cases on all cores, the slow bench first, and say from time to time how far it is."""
    if not cases:
        return
    order = sorted(cases, key=lambda case: SLOWEST_FIRST.index(case.bench))
    begun = said = time.monotonic()
    with ProcessPoolExecutor(processes) as pool:
        waiting = [pool.submit(work, case) for case in order]
        for number, one in enumerate(as_completed(waiting), 1):
            one.result()
            if time.monotonic() - said > 10.0 or number == len(order):
                said = time.monotonic()
                print(f"{number} of {len(order)} {done}, {said - begun:.0f} s", flush=True)


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


def _page(folder: Path) -> str:
    found = blind_scores.trials(folder)
    pairs = []
    for one in found:
        path = folder / "peers" / f"{one.answer.id}.json"
        if path.exists():
            pairs.append((one.answer, json.loads(path.read_text(encoding="utf-8")), one.result))
    return blind_scores.markdown(found, blind_peers.table(pairs) if pairs else ())


if __name__ == "__main__":
    raise SystemExit(main())
