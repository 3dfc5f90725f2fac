"""Faults that are planted in the program, each where a promise of safety or durability is kept: tests must notice.

`make mutants` copies the sources, plants one fault at a time, and runs the tests that are named for it. A fault that
survives is a promise that nobody watches. The copies are what is imported, also by the processes that tests start.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = (
    "rig",
    "drivers",
    "fixtures",
    "procedures",
    "tests",
    "configs",
    "docs",
    "pyproject.toml",
    "requirements-run.lock",
)
PATIENCE = 120.0  # s; a mutant may hang, and hanging is noticed too
ARCHIVE, GUARD, LEFT = "tests/rig/test_archive.py", "tests/rig/test_guard.py", "tests/test_bench_left.py"
POSSESSION, BOARD = "tests/rig/test_possession.py", "tests/drivers/test_das16jr.py"
SERVICE, COMMANDS = "tests/drivers/test_daq_service.py", "tests/test_commands.py"


@dataclass(frozen=True)
class Mutant:
    """`old`, which stands once in the file, becomes `new`; tests of `module` that match `names` notice."""

    promise: str
    file: str
    old: str
    new: str
    module: str
    names: str


MUTANTS = (
    Mutant("a block is on the disk before its name is", "rig/archive/durable.py",
           "os.fsync(self._descriptor)\n                os.rename", "os.rename", ARCHIVE, "on_the_disk"),
    Mutant("the name of a block is on the disk", "rig/archive/durable.py",
           "sync_folder(self.path.parent)", "pass", ARCHIVE, "on_the_disk"),
    Mutant("a file is there as a whole or not at all", "rig/archive/durable.py",
           'path.with_name(f".{path.name}.part")', "path", "tests/test_crash_points.py", "tears_nothing"),
    Mutant("a line is on the disk within a second", "rig/archive/durable.py",
           "os.fdatasync(self._descriptor)", "pass", ARCHIVE, "without_being_asked"),
    Mutant("the journal is on the disk before the seal", "rig/archive/writer.py",
           "self._file.sync()\n            body", "body", ARCHIVE, "before_the_seal"),
    Mutant("only a run with all its points is completed", "rig/archive/writer.py",
           "            self._refuse_missing_points(status)\n", "", ARCHIVE, "all_its_points"),
    Mutant("no changed byte of the journal goes unnoticed", "rig/archive/journal.py",
           "if _digest(previous, content) != chain:", "if not content:", ARCHIVE, "byte or changed or damage"),
    Mutant("a run with a damaged journal is damaged", "rig/archive/reader.py",
           "            self._refuse_damage(seal)\n", "", ARCHIVE, "damaged or journal"),
    Mutant("runs follow their numbers, whatever the clock did", "rig/archive/runs.py",
           "sorted(keyed, key=lambda one: one[:3])", "sorted(keyed, key=lambda one: one[1:3])",
           ARCHIVE, "last or clock"),
    Mutant("a limit that is not met is exit code 3", "rig/cli/outcome.py",
           'raise VerdictNotMet("; ".join(missed))', "pass", COMMANDS, "expectation"),
    Mutant("a limit that was not met stays with the run", "rig/cli/outcome.py",
           "        run.keep_unmet(missed)\n", "        pass\n", COMMANDS, "expectation"),
    Mutant("another timing than the configured one ends the record", "drivers/das16jr.py",
           "if frame.convert_ns != round(record.timing.convert_period * 1e9) or", "if not frame.channels and",
           BOARD, "changes_under_way"),
    Mutant("a gap of conversions ends the record", "drivers/das16jr.py",
           "if frame.index != record.received and record.failure is None:", "if frame.index < 0:",
           BOARD, "missing_on_the_way"),
    Mutant("an overflow has its name", "drivers/das16jr.py",
           "if flags & OVERFLOW:", "if not flags + 1:", BOARD, "overflow"),
    Mutant("what is silent is off within five seconds", "rig/bench/guard.py",
           "SILENCE = 4.5", "SILENCE = 60.0", GUARD, "five_seconds"),
    Mutant("work that hangs is found though others go on", "rig/bench/guard.py",
           "if threading.get_ident() != self._worker or not self._attended:", "if not self._attended:",
           GUARD, "others_go_on"),
    Mutant("a step may not outlast its time", "rig/bench/guard.py",
           "min(self._due, self._step_due)", "self._due", GUARD, "outlast"),
    Mutant("nothing is sent once the guard has gone", "rig/bench/guard.py",
           "if self._process.poll() is not None:", "if self._process.pid < 0:", GUARD, "guard_that_is_killed"),
    Mutant("no signal ends the guard", "rig/bench/guard.py",
           "for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):", "for number in ():",
           GUARD, "no_signal"),
    Mutant("the guard runs nothing of the working folder", "rig/bench/guard.py",
           '[sys.executable, "-P", "-m", "rig.bench.guard"', '[sys.executable, "-m", "rig.bench.guard"',
           GUARD, "working_folder"),
    Mutant("the guard is told as the program dies", "rig/bench/guard.py",
           "self._lifeline.hold()  #", "pass  #", GUARD, "ends_with"),
    Mutant("only what is read back when all threads have gone is off", "rig/bench/guard.py",
           "        not_yet = list(orders.duties)\n", "", GUARD, "killed"),
    Mutant("the simulated bench runs nothing of the working folder", "rig/bench/control.py",
           '[sys.executable, "-P", "-m", "fixtures"', '[sys.executable, "-m", "fixtures"', COMMANDS, "working_folder"),
    Mutant("a driver is a plain name", "rig/bench/guard.py",
           "if not name.isidentifier():", "if not name:", GUARD, "dotted"),
    Mutant("what is armed outlives the program", "rig/bench/guard.py",
           "            armed.write()\n        return cls", "        return cls", LEFT, "both_are_killed"),
    Mutant("off is said only if it was read back", "rig/bench/guard.py",
           "if self._process.returncode != _MADE_SAFE:", "if self._process.returncode is None:", LEFT, "not_answer"),
    Mutant("a failed attempt is tried again", "rig/bench/guard.py",
           "_TRY_FOR = 10.0", "_TRY_FOR = 0.0", GUARD, "repeated"),
    Mutant("a bench has one driver", "rig/bench/possession.py",
           "fcntl.LOCK_EX | fcntl.LOCK_NB", "fcntl.LOCK_SH | fcntl.LOCK_NB",
           POSSESSION, "refused"),
    Mutant("only the stopped are passed over", "rig/bench/possession.py",
           'if holder is None or holder.state == "alive":', "if holder is None:", POSSESSION, "passed_over"),
    Mutant("a later process of the same number is another one", "rig/bench/possession.py",
           " or started != self.started", "", POSSESSION, "same_number"),
    Mutant("what was left armed and is not here is not off", "rig/bench/safe_action.py",
           "(*found, *_not_here(left, found))", "found", LEFT, "not_in_the_bench_file"),
    Mutant("what is noted before it is sent is not sent without a guard", "rig/bench/watched.py",
           "        self._guard.expect(self._patience)\n        self._transcript", "        self._transcript",
           "tests/rig/test_watched.py", "noted"),
    Mutant("the board has one owner", "drivers/daq_service.py",
           "                self._own(asker)\n", "                self._owner = asker\n", SERVICE, "one_owner"),
    Mutant("memory stays bounded for a client that does not read", "drivers/daq_service.py",
           "if self._data.waiting + len(payload) > self._queue:", "if self._data.waiting < 0:", SERVICE, "bounded"),
    Mutant("one who watches and does not read is hung up on", "drivers/daq_service.py",
           "one is self._data or one.waiting <= WATCHED", "one.waiting >= 0", SERVICE, "watches"),
)  # fmt: skip


def survivors(mutants: Iterable[Mutant]) -> Iterator[Mutant]:
    """Those that their tests do not notice, told as they come. Raises ValueError if a place is not there once."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = _copied(Path(folder))
        for one in mutants:
            began = time.monotonic()
            ended = _noticed(one, copy)
            print(f"{ended:<11} {time.monotonic() - began:5.1f} s  {one.promise}", flush=True)
            if ended != "noticed":
                yield one


def planted(one: Mutant, text: str) -> str:
    """The file's text with the fault. Raises ValueError unless its place is there exactly once."""
    if text.count(one.old) != 1:
        raise ValueError(
            f"{one.file}: found {one.old[:60]!r} {text.count(one.old)} times, wanted it once ({one.promise})"
        )
    return text.replace(one.old, one.new)


def _copied(folder: Path) -> Path:
    for name in SOURCES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__", "golden"))
        else:
            shutil.copy(source, folder / name)
    return folder


def _noticed(one: Mutant, copy: Path) -> str:
    """`noticed`, `survives`, or `no test` where the names match none, or the tests fail without the fault too."""
    path, sound = copy / one.file, (ROOT / one.file).read_text(encoding="utf-8")
    before = _tested(one, copy)
    if before != 0:
        return "no test"
    path.write_text(planted(one, sound), encoding="utf-8")
    try:
        return "survives" if _tested(one, copy) == 0 else "noticed"
    finally:
        path.write_text(sound, encoding="utf-8")


def _tested(one: Mutant, copy: Path) -> int | None:
    """Exit code of the named tests; None if they hang."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", one.module, "-k", one.names]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        return None
    return done.returncode


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", help="only promises with one of these words")
    words = parser.parse_args().words
    chosen = [one for one in MUTANTS if not words or any(word in one.promise for word in words)]
    left = list(survivors(chosen))
    print(f"{len(left)} of {len(chosen)} planted faults survive")
    return 1 if left or not chosen else 0


if __name__ == "__main__":
    sys.exit(main())
