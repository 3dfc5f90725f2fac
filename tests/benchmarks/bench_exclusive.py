"""A hundred pairings of two programs on one bench: one is refused at once, the other comes to the right number."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import threading
from pathlib import Path

from rig.archive.runs import Runs
from rig.bench.control import stop

PAIRINGS = int(os.environ.get("RIG_PAIRINGS", "100"))
LATEST = 0.8  # s from the start of the one to the start of the other
SWEEP = "procedure: frequency_sweep\naxis: x\npoints: 3\n"
FIRST = [
    ("run", "sweep.yaml", "--json"),
    ("turntable", "--rpm", "45", "--axis", "yaw", "--revolutions", "4", "--rest", "10 s", "--json"),
]
SECOND = [*FIRST, ("bench", "check"), ("bench", "safe")]
TRUE = {"unit_a_x.sensitivity": 0.06628, "gyro_yaw.sensitivity": 0.2141}  # V/(m/s²), V/(rad/s), of this world
WITHIN = 0.03  # relative; of four revolutions noise alone makes a third of that


def test_of_two_programs_one_has_the_bench_and_the_other_is_refused(tmp_path: Path) -> None:
    draws, refused = random.Random(13), 0
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    for _ in range(PAIRINGS):
        pair = [_started(tmp_path, draws.choice(FIRST))]
        threading.Event().wait(draws.uniform(0.0, LATEST))
        pair.append(_started(tmp_path, draws.choice(SECOND)))
        said = [(*one.communicate(), one.returncode) for one in pair]
        losers = [one for one in said if "found it held by process" in one[1]]
        refused += len(losers)
        assert len(losers) < 2
        for out, wrong, code in said:
            assert code == ((out, wrong, code) in losers), wrong
            _refuse_wrong(out)
    runs = Runs(tmp_path / "runs").list()
    stop(tmp_path / "runs" / ".bench" / "simulated")
    sound = sum(run.status == "completed" and run.verify() == [] for run in runs)
    print(
        f"\n{PAIRINGS} pairings, the second {LATEST} s at most after the first: {refused} refused; "
        f"{sound} of {len(runs)} runs completed and sound, every sensitivity within {WITHIN:.0%}"
    )
    assert refused == PAIRINGS
    assert sound == len(runs)


def _started(folder: Path, words: tuple[str, ...]) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "rig", *words, "--runs", str(folder / "runs")]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _refuse_wrong(out: str) -> None:
    """Every sensitivity of a run that was let through is that of the bench."""
    for row in json.loads(out)["rows"] if out.startswith("{") else ():
        if row["key"] in TRUE:
            assert abs(row["value"] / TRUE[row["key"]] - 1.0) < WITHIN, row
