"""A power cut at any moment costs no point whose line was on the disk: with and without holes."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import fast_bench
import pytest
from power_cuts import Cut, Disk, faults

from rig.archive import durable
from rig.archive.runs import Runs

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 4, "static": "2 s", "static_after": "1 s"}
STATES = int(os.environ.get("RIG_CUTS", "120"))  # of each kind; `make kills` takes 500


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Disk:
    """What a sweep makes the disk do, and a run that is interrupted and taken up again."""
    root = tmp_path_factory.mktemp("disk")
    seen = Disk(root)
    with pytest.MonkeyPatch.context() as patch, seen.watched():
        patch.setattr(durable, "SYNC_EVERY", 0.002)  # the run takes a second where a real one takes minutes
        fast_bench.keep(SWEEP, fast_bench.world(2), root / "runs")
        with Runs(root / "runs").create("by hand", {"simulated": True, "points_total": 40}) as writer:
            write(writer, range(20))
        with Runs(root / "runs").reopen(writer.name) as writer:
            write(writer, range(20, 40))
            writer.seal("completed")
    return seen


def write(writer: object, points: range) -> None:
    for index in points:
        writer.block(f"{index:04d}", range(index + 3))  # type: ignore[attr-defined]
        writer.point_done(index, {"label": f"point {index}"})  # type: ignore[attr-defined]
        time.sleep(0.004 * (index % 3 == 0))


@pytest.mark.parametrize("holes", [False, True])
def test_what_was_on_the_disk_is_there_after_a_power_cut(disk: Disk, tmp_path: Path, holes: bool) -> None:
    """Without holes behind what was synced the run goes on, too."""
    seen = set()
    for number, cut in enumerate(disk.cuts(STATES, seed=1, holes=holes)):
        folder = tmp_path / str(number)
        assert list(faults(disk, cut, folder)) == [], (number, cut.moment)
        seen |= {len(disk.promised(cut.moment, f"runs/{name}/journal.jsonl")) for name in disk.runs(cut.moment)}
        shutil.rmtree(folder)
    assert len(seen) > 20  # promises grow


def test_without_a_power_cut_the_disk_holds_the_run_itself(disk: Disk, tmp_path: Path) -> None:
    disk.laid_out(Cut(disk.calls), tmp_path / "whole")
    for run in Runs(tmp_path / "whole" / "runs").list():
        assert run.status == "completed"
        assert run.verify() == []
        assert (
            run.path.joinpath("journal.jsonl").read_bytes()
            == (disk.root / "runs" / run.name / "journal.jsonl").read_bytes()
        )
