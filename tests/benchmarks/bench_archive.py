"""What the archive costs: a point of a run with the instruments left out, a long record, and a long list of runs."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np

from rig.archive.runs import Runs
from rig.errors import LimitExceeded, SettingRefused

POINTS = 2000
PER_POINT = 1e-4  # s
LIMITS = {"acceleration": 4.903325, "stroke": 1e-4, "velocity": 0.1, "source": 5.0}


class Echo:
    """Stands where the instrument would: takes settings and gives them back at once."""

    def __init__(self) -> None:
        self.taken: dict[str, float] = {}

    def set(self, settings: dict[str, float]) -> None:
        self.taken = dict(settings)


def within_limits(frequency: float, acceleration: float) -> dict[str, float]:
    """The drive for one point; raises LimitExceeded."""
    omega = 2 * math.pi * frequency
    motion = {"acceleration": acceleration, "velocity": acceleration / omega, "stroke": acceleration / omega**2}
    motion["source"] = motion["stroke"] / 20e-6
    for name, value in motion.items():
        if value > LIMITS[name]:
            raise LimitExceeded(f"{name}: found {value}, wanted at most {LIMITS[name]}")
    return motion


def test_a_point_with_limits_read_back_and_journal_costs_at_most_a_tenth_of_a_millisecond(tmp_path: Path) -> None:
    echo = Echo()
    with Runs(tmp_path).create("frequency_sweep", {"simulated": True, "points_total": POINTS}) as writer:
        begun = time.perf_counter()
        for index in range(POINTS):
            frequency = 40.0 + index * 0.2
            motion = within_limits(frequency, 1.0)
            echo.set({"frequency": frequency, "amplitude": motion["source"]})
            if echo.taken["frequency"] != frequency:
                raise SettingRefused("echo", "here", wanted=f"{frequency} Hz")
            writer.point_done(index, {"frequency": frequency, "level": "full", **motion, "settings": echo.taken})
        each = (time.perf_counter() - begun) / POINTS
        writer.seal("completed")
    print(f"\npoint with limits, read-back and journal: {each * 1e3:.4f} ms, {each / PER_POINT:.2f} of the bar")
    assert each <= PER_POINT


def test_a_long_record_is_closed_and_synced_far_faster_than_sixteen_channels_fill_it(tmp_path: Path) -> None:
    rows = np.random.default_rng(1).integers(0, 65535, (3125, 16), dtype=np.uint16)
    with Runs(tmp_path).create("noise", {"simulated": True}) as writer:
        begun = time.perf_counter()
        stream = writer.block_stream("record")
        for _ in range(300):
            stream.append(rows)
        stream.close()
        seconds = time.perf_counter() - begun
    speed = stream.rows * 16 / seconds
    print(f"\nlong record to closed blocks: {speed / 1e6:.1f} MS/s, {1e6 / speed:.3f} of the bar of 1 MS/s")
    assert speed >= 1e6


def test_a_thousand_runs_are_listed_within_a_second(tmp_path: Path) -> None:
    runs = Runs(tmp_path / "runs")
    with runs.create("frequency_sweep", {"simulated": True, "points_total": 48}) as writer:
        for index in range(48):
            writer.point_done(index, {"frequency": float(index)})
        writer.seal("completed")
    for copy in range(1000):
        folder = runs.root / f"copy-{copy}"
        folder.mkdir()
        for name in ("journal.jsonl", "seal.json", "lock"):
            (folder / name).write_bytes((writer.path / name).read_bytes())
    begun = time.perf_counter()
    summaries = [run.summary() for run in runs.list()]
    seconds = time.perf_counter() - begun
    print(f"\n{len(summaries)} runs listed: {seconds:.3f} s, {seconds:.2f} of the bar of 1 s")
    assert seconds <= 1.0
