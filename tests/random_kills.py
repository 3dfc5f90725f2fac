"""Measurements ended at random moments: nothing that was done is lost or torn, the status is true, and all go on.

`make kills` ends a hundred, by SIGKILL, SIGTERM or SIGINT, some of them again while they are resumed.
"""

from __future__ import annotations

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from rig.archive.reader import Run
from rig.archive.runs import Runs
from rig.bench.control import stop

SEQUENCE = """\
title: a bit of everything
steps:
- {procedure: frequency_sweep, axis: x, points: 2, static: 2 s, static_after: 0 s}
- {procedure: noise, length: 2 s, cables: turntable}
- {procedure: turntable, axis: yaw, revolutions: 2, rest: 2 s}
"""
COMMANDS: tuple[tuple[str, ...], ...] = (
    ("sweep", "--axis", "x", "--points", "3"), ("turntable", "--axis", "yaw", "--revolutions", "2"),
    ("noise", "--length", "5 s"), ("tumble",), ("run", "sequence.yaml"),
)  # fmt: skip
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
LONGEST = 600.0  # s


def _begun(words: Sequence[str], folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "rig", *words], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


def _killed(words: Sequence[str], folder: Path, rng: random.Random, lasts: float) -> tuple[str, list[str]]:
    """How a command was ended at a moment of the time that it takes, and what was wrong afterwards."""
    number, before = rng.choice(SIGNALS), _points(folder)
    program = _begun(words, folder)
    over = time.monotonic() + rng.uniform(0.0, lasts)
    while program.poll() is None and time.monotonic() < over:
        before = _points(folder)
        time.sleep(0.01)
    ended = program.poll() is not None
    program.send_signal(number)
    _, said = program.communicate(timeout=LONGEST)
    wrong = list(_wrong(folder, before))
    if "Traceback" in said or (ended and program.returncode):
        wrong.append(f"ended with {program.returncode}: {said}")
    return "over before" if ended else number.name, wrong


def _wrong(folder: Path, before: set[int]) -> Iterator[str]:
    """What is not as it must be of the runs of a folder, in the last of which these points were done."""
    for run in Runs(folder / "runs").list():
        if run.status not in ("interrupted", "completed"):
            yield f"{run.name} is {run.status}"
        if wrong := run.verify():
            yield f"{run.name}: {wrong}"
        if run.status == "completed" and len(run.points()) != run.header["points_total"]:
            yield f"{run.name} is completed with {len(run.points())} of {run.header['points_total']} points"
        if lost := before - set(run.points()):
            yield f"{run.name}: lost {sorted(lost)}"


def _points(folder: Path) -> set[int]:
    runs = Runs(folder / "runs").list()
    return set(runs[-1].points()) if runs else set()


def trial(number: int, seed: int, lasts: dict[tuple[str, ...], float]) -> tuple[list[str], list[str]]:
    """One command, killed, perhaps killed again as it goes on, and brought to its end: what was wrong."""
    rng = random.Random(f"{seed} {number}")
    words = COMMANDS[number % len(COMMANDS)]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "sequence.yaml").write_text(SEQUENCE, encoding="utf-8")
        how, wrong = _killed(words, folder, rng, lasts[words])
        kinds = [f"{words[0]}: {how}, {len(_points(folder))} points done"]
        while (run := _interrupted(folder)) is not None and rng.random() < 0.3:
            how, more = _killed(("resume", run.name), folder, rng, lasts[words])
            kinds, wrong = [*kinds, f"resume: {how}"], wrong + more
        if (run := _interrupted(folder)) is not None:
            resumed = _begun(("resume", run.name), folder)
            _, said = resumed.communicate(timeout=LONGEST)
            if resumed.returncode or run.status != "completed" or run.verify() or run.not_safe:
                wrong.append(f"resume ended with {resumed.returncode}, {run.status}, {run.not_safe}: {said}")
        stop(folder / "runs" / ".bench" / "simulated")
    return kinds, wrong


def _interrupted(folder: Path) -> Run | None:
    return next((run for run in Runs(folder / "runs").list() if run.status == "interrupted"), None)


def _duration(words: tuple[str, ...]) -> float:
    with tempfile.TemporaryDirectory() as made:
        (Path(made) / "sequence.yaml").write_text(SEQUENCE, encoding="utf-8")
        begun = time.monotonic()
        program = _begun(words, Path(made))
        _, said = program.communicate(timeout=LONGEST)
        stop(Path(made) / "runs" / ".bench" / "simulated")
        if program.returncode:
            raise RuntimeError(said)
        return time.monotonic() - begun


def main() -> int:
    """Exit 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description="End measurements at random moments.")
    parser.add_argument("count", type=int, nargs="?", default=100)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    lasts = {words: _duration(words) for words in COMMANDS}
    faults, killed = 0, Counter[str]()
    with ThreadPoolExecutor(2) as pool:
        made = pool.map(partial(trial, seed=options.seed, lasts=lasts), range(options.count))
        for number, (kinds, wrong) in enumerate(made):
            faults += len(wrong)
            killed.update(kind.partition(": ")[0] for kind in kinds if "over before" not in kind)
            print("\n  ".join([f"{number + 1:>4} of {options.count}  {'; '.join(kinds)}", *wrong]), flush=True)
    print(f"killed at work: {dict(killed)}, {killed.total()} in all; {faults} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
