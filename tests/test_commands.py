"""The commands as a technician runs them: in a process of their own, on a served bench, with faults planted in it."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pages
import pytest

from rig.archive.runs import Runs
from rig.bench.assembly import start_simulated, state_folder
from rig.bench.benchfile import describe
from rig.bench.control import Control, stop
from rig.cli import outcome
from rig.yaml.config import shipped

SHORT = ("--axis", "x", "--points", "2")


class Bench:
    """A runs folder, the simulated bench that belongs to it, and the commands."""

    def __init__(self, runs: Path) -> None:
        self.runs = runs
        self.description = describe(shipped("benches/simulated.yaml"))

    def rig(self, *arguments: str, wanted: int = 0) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [sys.executable, "-m", "rig", *arguments, "--runs", str(self.runs)],
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            check=False,
        )
        assert done.returncode == wanted, (done.returncode, done.stdout[-2000:], done.stderr[-2000:])
        assert "Traceback" not in done.stderr
        return done

    def json(self, *arguments: str) -> Any:
        return json.loads(self.rig(*arguments, "--json").stdout)

    def plant(self, fault: str, value: object) -> None:
        addresses = start_simulated(self.description, self.runs)
        with Control(int(str(addresses["control"]))) as control:
            control.ask("fault", name=fault, value=value)

    def source_is_off(self) -> bool:
        addresses = start_simulated(self.description, self.runs)
        with Control(int(str(addresses["control"]))) as control:
            events = [event for event in control.ask("log")["events"] if event["event"] == "source"]
        return not events or not events[-1]["on"]

    def end(self) -> None:
        stop(state_folder(self.description, self.runs))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path / "runs")
    yield made
    made.end()


def digests(run: Path) -> list[str]:
    return [hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted((run / "blocks").iterdir())]


def test_a_short_sweep_finds_the_sensitivities_and_keeps_a_sound_run(bench: Bench) -> None:
    found = bench.json("sweep", *SHORT)
    assert (found["status"], found["points_done"], found["points_total"], found["simulated"]) == (
        "completed",
        4,
        4,
        True,
    )
    values = {row["channel"]: row["value"] * 9.80665 for row in found["rows"]}
    # 0.5 % scatter of the sensors and 1 % (k = 2) of the vibrometer's gain
    assert values["unit_a_x"] == pytest.approx(0.650, rel=0.03)
    assert values["unit_c_x"] == pytest.approx(0.097, rel=0.05)
    sound, shown = bench.json("verify", "last"), bench.json("show", "last")
    assert sound["sound"]
    assert shown["run"] == found["run"]
    for said, example in ((sound, pages.examples("rig verify")[0]), (shown, pages.examples("rig show")[0])):
        pages.assert_shown(said, example)
    pages.assert_shown(found, shown | pages.examples("rig sweep")[0])
    assert [row["run"] for row in bench.json("runs")] == [found["run"]]
    assert all(Path(path).stat().st_size > 5000 for path in found["figures"])
    header = Runs(bench.runs).open("last").header
    assert header["identities"]["analyzer"]["model"] == "89410A"
    assert {s["certificate"] for s in header["standards"]} >= {"EX-LDV-2026-014"}
    assert len(header["program"]["lock_sha256"]) == 64
    confirmed = [e.body["action"] for e in Runs(bench.runs).open("last").lines() if e.kind == "confirmed"]
    assert confirmed == [
        "cables",
        "set_filter",
        "filter_test",
        "filter_test",
        "mount_on_shaker",
        "plug_analyzer",
        "align_beam",
    ]


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    found = []
    for name in ("one", "other"):
        bench = Bench(tmp_path / name)
        run = bench.json("sweep", *SHORT)
        found.append(digests(Path(run["path"])))
        bench.end()
    assert found[0] == found[1]
    assert len(set(found[0])) > 10


def test_a_turntable_run_finds_the_gyro_and_its_sense(bench: Bench) -> None:
    found = bench.json("turntable", "--rpm", "45", "--revolutions", "6", "--rest", "5 s", "--invert")
    values = {row["channel"]: row["value"] * 3.14159265 / 180 * 1e3 for row in found["rows"]}
    assert values["gyro_yaw"] == pytest.approx(3.71, rel=0.05)  # mV/(°/s), positive about the gyro's own axis
    assert values["backup_yaw"] == pytest.approx(5.19, rel=0.03)
    hold = next(body for body in Runs(bench.runs).open("last").points().values() if body.get("phase") == "hold")
    assert (hold["revolutions"], hold["flagged_counts"]) == (6, [])
    assert hold["rate"] == pytest.approx(-4.712, rel=0.05)  # rad/s: clockwise from above


def test_tumble_and_noise_and_a_sequence_end_completed(bench: Bench, tmp_path: Path) -> None:
    sequence = tmp_path / "mine.yaml"
    sequence.write_text(
        "title: small\nsteps:\n  - prompt: Warm?\n  - {procedure: noise, length: 3 s}\n  - wait: 1 s\n"
        "  - repeat: 2\n    steps:\n      - {procedure: frequency_sweep, axis: z, points: 1, static: 0 s}\n"
    )
    found = bench.json("run", str(sequence))
    assert (found["status"], found["points_total"]) == ("completed", 1 + 2 * 2)
    actions = [e.body["action"] for e in Runs(bench.runs).open("last").lines() if e.kind == "confirmed"]
    assert actions.count("remount") == 1
    assert actions[0] == "confirm"
    rows = {row["channel"]: row["value"] * 9.80665 for row in bench.json("tumble")["rows"]}
    assert rows["unit_b_y"] == pytest.approx(0.650, rel=0.02)


def test_mistakes_in_a_procedure_are_all_named_and_nothing_is_started(bench: Bench, tmp_path: Path) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text("procedure: frequency_sweep\naxis: w\nstart: 500\nstp: 3 Hz\n")
    said = bench.rig("run", str(bad), wanted=2).stderr
    for line in (
        "bad.yaml:2:7 axis: found 'w'",
        "bad.yaml:3:8 start: found '500', wanted a frequency",
        "bad.yaml:4:1 stp: found",
    ):
        assert line in said
    bad.write_text("procedure: frequency_sweep\naxis: x\nstart: 500 Hz\nstop: 20 Hz\nlimits: {acceleration: 2 g}\n")
    said = bench.rig("run", str(bad), wanted=2).stderr
    assert "bad.yaml:4:7 stop:" in said
    assert "bad.yaml:5:24 limits.acceleration: found 2 g" in said
    assert not bench.runs.exists()


def test_without_runs_last_is_bad_input_and_so_is_an_unknown_run(bench: Bench) -> None:
    assert "found no run" in bench.rig("show", "last", wanted=2).stderr
    assert "found no run" in bench.rig("resume", "nothing", wanted=2).stderr


def test_an_expectation_that_is_not_met_is_exit_code_3(bench: Bench, tmp_path: Path) -> None:
    wanting = tmp_path / "wanting.yaml"
    wanting.write_text(
        "procedure: frequency_sweep\naxis: x\npoints: 1\nexpect: {sensitivity: {within: [700 mV/g, 710 mV/g]}}\n"
    )
    assert "wanted 700.00 to 710.00 mV/g" in bench.rig("run", str(wanting), wanted=3).stderr
    shown = bench.json("show")
    assert shown["status"] == "completed"
    assert ["wanted 700.00 to 710.00 mV/g" in one for one in shown["unmet"]] == [True]
    assert "completed, 1 limit not met" in bench.rig("runs").stdout
    assert "not met: expect sensitivity" in bench.rig("show").stdout
    assert json.loads(bench.rig("verify", "--json").stdout)["sound"]


def test_a_run_says_what_was_not_met_and_what_was_measured_in_vain() -> None:
    unmet = ["expect sensitivity of a: found …", "a.sensitivity: not determined: stuck", "b.deviation: not determined"]
    said = [outcome.status_text({"status": "completed", "unmet": unmet[:count]}) for count in range(4)]
    assert said[:2] == ["completed", "completed, 1 limit not met"]
    assert said[2:] == [f"{said[1]}, 1 result not determined", f"{said[1]}, 2 results not determined"]


def test_nothing_of_the_working_folder_is_executed(tmp_path: Path) -> None:
    """Neither by the command nor by the guard and the simulated bench, which it starts here."""
    for name in ("serial", "numpy", "yaml", "drivers", "fixtures"):
        (tmp_path / f"{name}.py").write_text(f'raise SystemExit("{name}.py of the working folder was executed")')
    command = [sys.executable, "-m", "rig", "sweep", *SHORT, "--runs", "runs"]
    try:
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
        )
        assert "was executed" not in done.stdout + done.stderr
        assert done.returncode == 0, done.stderr[-2000:]
    finally:
        stop(state_folder(describe(shipped("benches/simulated.yaml")), tmp_path / "runs"))


def test_a_crystal_that_is_half_a_per_cent_fast_is_seen_and_nothing_passes_by_it(bench: Bench) -> None:
    bench.plant("das16jr.clock", 1.005)
    try:
        made = bench.json("turntable", "--revolutions", "3", "--rest", "8 s")
    finally:
        bench.plant("das16jr.clock", None)
    (row,) = [one for one in made["rows"] if one["key"] == "gyro_yaw.sensitivity"]
    assert (row["status"], row["verdict"]) == ("flagged", "inconclusive")
    said = re.search(r"clock is ([0-9.]+)% ± ([0-9.]+)% fast", row["remarks"][-1])
    assert said is not None
    assert abs(float(said[1]) - 0.5) < float(said[2]) < 0.3


def test_a_standard_past_its_date_is_refused_and_the_override_is_on_record(bench: Bench, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    bench_file = folder / "configs/benches/simulated.yaml"
    subprocess.run([sys.executable, "-m", "rig", "init", str(folder)], check=True, capture_output=True)
    standard = folder / "configs/standards/vibrometer.yaml"
    standard.write_text(standard.read_text().replace("due: 2027-03-02", "due: 2026-03-02"))
    said = bench.rig("sweep", *SHORT, "--bench", str(bench_file), wanted=2).stderr
    assert "vibrometer" in said
    assert "2026-03-02" in said
    bench.rig("sweep", *SHORT, "--bench", str(bench_file), "--allow-overdue")
    assert Runs(bench.runs).open("last").header["overdue_overridden"] == ["vibrometer"]


@pytest.mark.parametrize("recorders", ["[recorder]", "[scope]", "[recorder, cube]"])
def test_a_bench_with_other_recorders_works(bench: Bench, tmp_path: Path, recorders: str) -> None:
    folder = tmp_path / "mine"
    subprocess.run([sys.executable, "-m", "rig", "init", str(folder)], check=True, capture_output=True)
    bench_file = folder / "configs/benches/simulated.yaml"
    text = bench_file.read_text()
    bench_file.write_text(text.replace("recorders: [recorder, analyzer, scope]", f"recorders: {recorders}"))
    bench.rig("sweep", *SHORT, "--bench", str(bench_file))
    run = Runs(bench.runs).open("last")
    point = next(iter(run.points().values()))
    assert ("traces" in point, "cube" in point) == ("scope" in recorders, "cube" in recorders)
    if "cube" in recorders:
        assert run.block(point["cube"]).shape[1] == 15
        assert point["cube_gaps"] == 0


FAULTS = {
    "gpib.silence": (19, 1, "wanted"),
    "gpib.truncate": (100, 1, "analyzer at GPIB0::19::INSTR"),
    "gpib.drop": (True, 1, "wanted"),
    "hp89410a.identity": ("HEWLETT-PACKARD,35670A,1,A.00", 1, "wanted"),
    "das16jr.slip": (700, 1, "recorder at"),
    "das16jr.overflow": (1000, 1, "recorder at"),
    "das16jr.clock": (10, 1, "recorder at"),
    "das16jr.drop": (True, 1, "recorder at"),
    "das16jr.corrupt": (True, 1, "recorder at"),
    "ofv3001.low_level": (2, 1, "level"),
    "ofv3001.overrange": (True, 1, "vibrometer at"),
    "ofv3001.silence": (True, 1, "vibrometer at"),
    "operator.refuses": (True, 1, "operator"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_gives_one_clear_error_and_the_bench_at_rest(bench: Bench, fault: str) -> None:
    value, code, said = FAULTS[fault]
    bench.plant(fault, value)
    error = bench.rig("sweep", *SHORT, wanted=code).stderr
    assert said in error
    assert "error: " in error
    assert bench.source_is_off()
    if bench.json("runs"):
        assert bench.json("verify", "last")["sound"]
        assert bench.json("show", "last")["status"] in ("interrupted", "aborted")
        stopped = [entry.body["reason"] for entry in Runs(bench.runs).open("last").lines() if entry.kind == "stopped"]
        assert len(stopped) == 1
        assert stopped[0] in error


def test_damaged_frames_of_the_cube_are_counted_and_not_filled(bench: Bench, tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    subprocess.run([sys.executable, "-m", "rig", "init", str(folder)], check=True, capture_output=True)
    bench_file = folder / "configs/benches/simulated.yaml"
    text = bench_file.read_text()
    bench_file.write_text(text.replace("recorders: [recorder, analyzer, scope]", "recorders: [recorder, cube]"))
    bench.plant("sensor_cube.byte_errors", 2e-4)
    bench.rig("noise", "--length", "3 s", "--bench", str(bench_file))
    run = Runs(bench.runs).open("last")
    body = next(iter(run.points().values()))
    frames = run.block(f"{body['cube']}-frames")
    assert body["cube_bad_frames"] > 0
    assert body["cube_gaps"] > 0
    assert frames[-1, 0] + 1 == len(frames) + body["cube_gaps"] + frames[0, 0]


def test_the_bench_is_found_and_has_nothing_to_reveal(bench: Bench) -> None:
    found = bench.json("bench", "check")
    assert {row["role"] for row in found["instruments"]} >= {"analyzer", "scope", "recorder", "vibrometer", "cube"}
    assert not any(row["error"] for row in found["instruments"])
    pages.assert_shown(found, pages.examples("rig bench check")[0])
    assert bench.json("bench", "reveal") == {"effects": []}
