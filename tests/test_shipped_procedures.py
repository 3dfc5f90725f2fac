"""Every procedure that the program brings with it, carried out to its end on the simulated bench, shown, calibrated."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import in_process
import pytest

from rig.archive.runs import Runs
from rig.bench.control import stop

FOLDER = Path(next(iter(importlib.import_module("procedures").__path__)))
ACCELEROMETERS = {axis: {f"unit_{unit}_{axis}.sensitivity" for unit in "abc"} for axis in "xyz"}
GRAVITY = {f"unit_{unit}_{axis}.sensitivity_gravity" for unit in "abc" for axis in "xyz"}
GYROS = {axis: {f"gyro_{axis}.sensitivity", f"backup_{axis}.sensitivity"} for axis in ("pitch", "roll", "yaw")}
# What a run of each must determine, and the figures that are drawn of it.
KNOWN = {
    "full_calibration.yaml": (
        set().union(*ACCELEROMETERS.values(), GRAVITY, *GYROS.values()),
        ["response", "rotation", "rotation-2", "rotation-3", "noise", "poses"],
    ),
    "gyros_yaw.yaml": (GYROS["yaw"], ["rotation"]),
    "remounts.yaml": (ACCELEROMETERS["x"], ["response"]),
    "sweep_x.yaml": (ACCELEROMETERS["x"], ["response"]),
    "three_axes.yaml": (set().union(*ACCELEROMETERS.values()), ["response"]),
}


def rig(runs: Path, *arguments: str) -> str:
    done = in_process.rig(*arguments, "--runs", str(runs))
    assert done.returncode == 0, (done.returncode, done.stdout[-2000:], done.stderr[-2000:])
    return done.stdout


def test_every_shipped_procedure_is_carried_out_below() -> None:
    assert {path.name for path in FOLDER.glob("*.yaml")} == set(KNOWN)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", list(KNOWN))
def test_a_shipped_procedure_runs_to_its_end_is_shown_and_calibrates(name: str, tmp_path: Path) -> None:
    runs, (determined, figures) = tmp_path / "runs", KNOWN[name]
    try:
        made = json.loads(rig(runs, "run", name, "--json"))
    finally:
        stop(runs / ".bench" / "simulated")
    assert (made["status"], made["points_done"], made["unmet"]) == ("completed", made["points_total"], [])
    assert [Path(path).stem for path in made["figures"]] == figures
    assert Runs(runs).open("last").verify() == []
    shown = rig(runs, "show", "last")
    assert all(key.partition(".")[0] in shown for key in determined)
    results = json.loads(rig(runs, "calibrate", "last", "--json"))["results"]
    assert determined <= {row["key"] for row in results if row["value"] is not None}
