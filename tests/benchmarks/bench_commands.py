"""How long whole commands take on two standard runs, as a ratio to loading the libraries that any answer needs."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rig.bench.control import stop

LIBRARIES = "import numpy, scipy.optimize, matplotlib.figure"
BARS = {"compare": 3.0, "diagnose": 4.0}
TURNS = 7


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A standard sweep and a standard turntable run."""
    folder = tmp_path_factory.mktemp("commands") / "runs"
    for words in (("sweep", "--axis", "x"), ("turntable",)):
        taken("-m", "rig", *words, "--runs", str(folder))
    stop(folder / ".bench" / "simulated")
    return folder


def taken(*command: str) -> float:
    """Real time (s) of one program."""
    # Compiled modules are kept, or every process compiles them all again, which is most of what it would do.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    begun = time.perf_counter()
    subprocess.run([sys.executable, *command], check=True, capture_output=True, env=kept)
    return time.perf_counter() - begun


@pytest.mark.parametrize("command", sorted(BARS))
def test_a_command_takes_few_times_what_its_libraries_take(runs: Path, command: str) -> None:
    whole = ("-m", "rig", command, "all", "--runs", str(runs))
    taken(*whole), taken("-c", LIBRARIES)  # compiled, and the files in memory, from here on
    pairs = [(taken(*whole), taken("-c", LIBRARIES)) for _ in range(TURNS)]
    ours, libraries = (statistics.median(times) for times in zip(*pairs, strict=True))
    ratio = statistics.median(one / other for one, other in pairs)
    print(
        f"\nrig {command}, a sweep and a turntable run: {ours:.2f} s, libraries {libraries:.2f} s, "
        f"ratio {ratio:.1f} (bar {BARS[command]:.0f})"
    )
    assert ratio <= BARS[command]
