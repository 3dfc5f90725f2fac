"""Whatever a killed command leaves, every file is as it was or as it is to be, and the same command goes through."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def test_a_command_that_is_killed_while_it_writes_tears_nothing() -> None:
    done = subprocess.run(
        [sys.executable, str(HERE / "crash_points.py"), "--few", "calibrate", "add", "import"],
        cwd=HERE, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("killed 4 times, 0 faults") == 3
