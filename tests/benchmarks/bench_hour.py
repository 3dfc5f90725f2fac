"""An hour on the turntable, sixteen channels (180 million samples), from the archive to a calibration.

The records are made by the simulated bench (half a minute); what is timed is `rig calibrate` as a whole process:
seconds, peak memory, and how both grow from a quarter of an hour to the hour.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from rig.bench import control

FASTEST, MOST = 100.0, 500.0  # times real time; MB
PROCEDURE = "procedure: turntable\nspeed: 45 rpm\naxis: yaw\nrevolutions: {revolutions}\n"


def made(folder: Path, revolutions: int) -> Path:
    """Runs folder with one turntable run of so many revolutions."""
    (folder / "procedure.yaml").write_text(PROCEDURE.format(revolutions=revolutions))
    command = [sys.executable, "-m", "rig", "run", str(folder / "procedure.yaml"), "--runs", str(folder / "runs")]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return folder / "runs"


def calibrated(runs: Path) -> tuple[float, float]:
    """Wall seconds and peak memory (MB) of one `rig calibrate` process."""
    begun = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-m", "rig", "calibrate", "last", "--runs", str(runs)], stdout=subprocess.DEVNULL
    )
    _, status, usage = os.wait4(child.pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    return time.perf_counter() - begun, usage.ru_maxrss / 1024.0


def test_an_hour_is_calibrated_far_faster_than_it_was_recorded(tmp_path: Path) -> None:
    found = {}
    for minutes in (15, 60):
        folder = tmp_path / f"{minutes}"
        folder.mkdir()
        runs = made(folder, 45 * minutes)
        found[minutes] = calibrated(runs)
        control.stop(runs / ".bench" / "simulated")
        seconds, memory = found[minutes]
        speed = minutes * 60.0 / seconds
        print(f"\n{minutes} min of 16 channels: {seconds:.1f} s, {speed:.0f} x real time, {memory:.0f} MB")
    assert 3600.0 / found[60][0] >= FASTEST
    assert found[60][1] <= MOST
    assert found[60][0] <= 4.0 * found[15][0] * 1.2  # start-up makes the quarter look slow, never the hour
