"""Whole runs through the command line: what was measured is near the world's truth, and faults leave a sound run."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from fixtures.world import World
from rig import tone
from rig.archive import Runs
from rig.bench.assembly import start_simulated, state_folder
from rig.bench.benchfile import describe
from rig.bench.control import Control, stop
from rig.config import shipped
from rig.first_look import Records
from rig.run_reader import Run

GRAVITY = 9.80665
SHORT = ("--axis", "x", "--points", "3")
CUBE_VOLTS = 5.0 / 65536.0  # V per count of the Sensor Cube's own converter


class Program:
    """The commands, each in a process of its own, with one runs folder and the simulated bench that belongs to it."""

    def __init__(self, runs: Path, bench_file: Path | None = None) -> None:
        self.runs = runs
        self._bench = bench_file or shipped("benches/simulated.yaml")

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "rig", *arguments, "--runs", str(self.runs)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "RIG_BENCH": str(self._bench)},
            text=True,
        )

    def rig(self, *arguments: str, wanted: int = 0) -> tuple[str, str]:
        """Standard output and standard error of a command that must end with this exit code."""
        program = self.start(*arguments)
        out, err = program.communicate(timeout=100)
        assert program.returncode == wanted, (program.returncode, out[-2000:], err[-2000:])
        assert "Traceback" not in err
        return out, err

    def json(self, *arguments: str) -> Any:
        out, _ = self.rig(*arguments, "--json")
        return json.loads(out)

    def control(self) -> Control:
        addresses = start_simulated(describe(self._bench), self.runs)
        return Control(int(str(addresses["control"])))

    def last(self) -> Run:
        return Runs(self.runs).open("last")

    def end(self) -> None:
        stop(state_folder(describe(self._bench), self.runs))


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Program]:
    made = Program(tmp_path / "runs")
    yield made
    made.end()


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Program, Any]]:
    """A short sweep that many tests look at, and what it printed as JSON."""
    made = Program(tmp_path_factory.mktemp("swept") / "runs")
    yield made, made.json("sweep", *SHORT)
    made.end()


@pytest.fixture(scope="module")
def truth() -> dict[str, Any]:
    """What the world of the shipped simulated bench hides from the program."""
    settings = yaml.load(shipped("worlds/clean.yaml").read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
    return World(settings, 1).truth


@pytest.fixture
def own_bench_file(tmp_path: Path) -> Callable[[str], Path]:
    """A bench file of the test's own whose recorders are these, with the other configs beside it."""

    def write(recorders: str) -> Path:
        root = tmp_path / "configs"
        shutil.copytree(shipped("benches/simulated.yaml").parents[1], root)
        path = root / "benches" / "simulated.yaml"
        text, count = re.subn(r"^recorders: \[.*\]", f"recorders: {recorders}", path.read_text("utf-8"), flags=re.M)
        assert count == 1
        path.write_text(text, "utf-8")
        return path

    return write


def until(ready: Callable[[], Any], deadline: float = 60.0) -> Any:
    over = time.monotonic() + deadline
    while not (found := ready()):
        assert time.monotonic() < over, "waited in vain"
        threading.Event().wait(0.005)
    return found


def values(found: Any) -> dict[str, float]:
    return {row["channel"]: row["value"] for row in found["rows"]}


def test_a_short_sweep_says_what_it_made(swept: tuple[Program, Any]) -> None:
    program, found = swept
    assert (found["status"], found["points_done"], found["points_total"]) == ("completed", 6, 6)
    assert found["simulated"] is True
    assert found["unmet"] == []
    assert all(Path(path).is_file() for path in found["figures"])
    assert sum(found["shares"].values()) == pytest.approx(found["elapsed"], rel=0.25)
    assert Path(found["path"]) == program.last().path


def test_sensitivities_of_the_driven_axis_are_within_two_percent_of_the_truth(
    swept: tuple[Program, Any], truth: dict[str, Any]
) -> None:
    found = values(swept[1])
    assert set(found) == {"unit_a_x", "unit_b_x", "unit_c_x"}
    for channel, value in found.items():
        assert value == pytest.approx(truth["sensitivity"][channel], rel=0.02), channel


def test_show_runs_and_verify_agree_about_the_run_in_words_and_in_json(swept: tuple[Program, Any]) -> None:
    program, found = swept
    name = found["run"]
    assert program.json("show", "last") == program.json("show", name) == program.json("runs")[0]
    verified = program.json("verify", name)
    assert (verified["sound"], verified["problems"], verified["status"]) == (True, [], "completed")
    words, _ = program.rig("show", "last")
    assert f"run {name}  SIMULATED" in words
    assert "completed, 6 of 6 points" in words
    assert "mV/g" in words
    assert "SIMULATED" in program.rig("runs")[0]
    assert f"{name}: sound (completed;" in program.rig("verify")[0]


def test_raw_blocks_are_plain_little_endian_numbers_that_the_journal_acknowledges(swept: tuple[Program, Any]) -> None:
    run = swept[0].last()
    lines = [json.loads(line) for line in (run.path / "journal.jsonl").read_text("utf-8").splitlines()]
    blocks = [line["body"] for line in lines if line["kind"] == "block"]
    assert len(blocks) >= 3 * 6 + 2  # converter, analyzer and oscilloscope at every point, and two records at rest
    for block in blocks:
        raw = (run.path / block["file"]).read_bytes()
        assert hashlib.sha256(raw).hexdigest() == block["sha256"]
        numbers = np.frombuffer(raw, block["dtype"]).reshape(block["shape"])
        assert np.array_equal(numbers, run.read(run.blocks()[block["name"]][block["piece"]]), equal_nan=True)
    points = run.points().values()
    assert all(run.block(point["samples"]).shape == (3125, 16) for point in points)
    assert all(run.block(point["samples"]).dtype == np.dtype("<u2") for point in points)


def test_levels_are_reached_within_five_percent_and_clear_of_the_limits(swept: tuple[Program, Any]) -> None:
    for point in swept[0].last().points().values():
        assert point["acceleration"] == pytest.approx(point["target"], rel=0.05)
        assert point["acceleration"] <= 0.5 * GRAVITY * 1.1
        assert point["acceleration"] / (2 * math.pi * point["frequency"]) ** 2 <= 100e-6
        assert point["clipped"] == {}
        assert min(point["optical_level"]) >= 5


def test_everything_about_a_simulated_run_says_that_it_is_simulated(swept: tuple[Program, Any]) -> None:
    program, found = swept
    run = program.last()
    assert run.header["simulated"] is True
    for path in found["figures"]:
        assert "simulated" in Path(path).read_text("utf-8").lower()


def test_one_changed_byte_is_found_by_verify(swept: tuple[Program, Any], tmp_path: Path) -> None:
    program, found = swept
    copy = Program(tmp_path / "runs")
    shutil.copytree(found["path"], copy.runs / found["run"])
    block = sorted((copy.runs / found["run"] / "blocks").iterdir())[3]
    damaged = bytearray(block.read_bytes())
    damaged[100] ^= 1
    block.chmod(0o644)
    block.write_bytes(damaged)
    _, said = copy.rig("verify", "last", wanted=1)
    assert f"blocks/{block.name}: found contents that do not match" in said
    assert program.json("verify")["sound"]


@pytest.mark.parametrize("command", ["show", "verify", "resume"])
def test_an_unknown_run_is_bad_input_and_the_nearest_name_is_offered(swept: tuple[Program, Any], command: str) -> None:
    program, found = swept
    _, said = program.rig(command, found["run"].replace("sweep", "swep"), wanted=2)
    assert said.count("\n") == 1
    assert f"such as {found['run']}" in said


def test_a_completed_run_is_not_resumed(swept: tuple[Program, Any]) -> None:
    program, found = swept
    _, said = program.rig("resume", "last", wanted=2)
    assert "found it completed, wanted an interrupted run" in said
    assert program.json("verify")["sound"]
    assert found["run"] in said


@pytest.mark.parametrize("command", ["show", "verify", "resume"])
def test_last_without_any_run_is_bad_input_and_says_how_to_make_one(tmp_path: Path, command: str) -> None:
    program = Program(tmp_path / "runs")
    _, said = program.rig(command, "last", wanted=2)
    assert "found no run, wanted one (rig sweep --axis x makes one)" in said
    assert not program.runs.exists()


def test_noise_and_turntable_give_the_same_bytes_for_the_same_seed(tmp_path: Path) -> None:
    found = []
    for name in ("one", "other"):
        program = Program(tmp_path / name)
        program.rig("noise", "--length", "2 s")
        program.rig("turntable", "--rpm", "33", "--revolutions", "2", "--rest", "1 s")
        runs = Runs(program.runs).list()
        found.append(
            [hashlib.sha256(p.read_bytes()).hexdigest() for r in runs for p in sorted(r.path.glob("blocks/*"))]
        )
        program.end()
    assert len(found[0]) >= 6
    assert found[0] == found[1]


def test_a_short_turntable_run_finds_the_gyros_within_two_percent_of_the_truth(
    program: Program, truth: dict[str, Any]
) -> None:
    found = program.json("turntable", "--rpm", "45", "--revolutions", "6", "--rest", "2 s")
    assert (found["status"], found["points_done"], found["simulated"]) == ("completed", 5, True)
    for channel in ("gyro_yaw", "backup_yaw"):
        assert values(found)[channel] == pytest.approx(truth["sensitivity"][channel], rel=0.02), channel
    run = program.last()
    hold = next(point for point in run.points().values() if point["phase"] == "hold")
    true_rate = 45.0 * (1.0 + truth["speed_offset"]["45.0"]) * 2.0 * math.pi / 60.0
    assert abs(hold["rate"]) == pytest.approx(true_rate, rel=2e-3)
    assert hold["rate"] < 0  # clockwise seen from above
    assert run.verify() == []


def test_a_noise_record_keeps_every_scan_it_was_asked_for(program: Program) -> None:
    found = program.json("noise", "--length", "4 s", "--cables", "turntable")
    assert (found["status"], found["points_done"]) == ("completed", 1)
    (point,) = program.last().points().values()
    assert program.last().block(point["samples"]).shape == (4 * 3125, 16)
    assert program.last().verify() == []


def test_a_tumble_finds_the_accelerometers_within_one_percent_of_the_truth(
    program: Program, truth: dict[str, Any]
) -> None:
    found = program.json("tumble")
    assert (found["status"], found["points_done"]) == ("completed", 6)
    got = values(found)
    for unit in "abc":
        for axis in "xyz":
            channel = f"unit_{unit}_{axis}"
            assert got[channel] == pytest.approx(truth["sensitivity"][channel], rel=0.01), channel


def test_a_sequence_from_a_file_is_one_run_with_all_its_points(program: Program, tmp_path: Path) -> None:
    file = tmp_path / "day.yaml"
    file.write_text(
        "title: A small day\nsteps:\n  - prompt: Is the cube warm?\n  - wait: 5 s\n"
        "  - repeat: 2\n    steps:\n      - {procedure: noise, length: 1 s}\n"
        "  - {procedure: turntable, axis: roll, revolutions: 2, rest: 1 s}\n"
    )
    found = program.json("run", str(file))
    assert (found["status"], found["points_done"], found["procedure"]) == ("completed", 2 + 5, "sequence")
    run = program.last()
    assert run.header["title"] == "A small day"
    confirmed = [entry.body["action"] for entry in run.lines() if entry.kind == "confirmed"]
    assert confirmed == [
        "confirm",
        "cables",
        "remount",
        "cables",
        "cables",
        "mount_on_turntable",
        "turntable_speed",
        "turntable_speed",
    ]
    assert run.verify() == []


def test_an_expectation_not_met_is_exit_code_3_and_the_run_is_kept(program: Program, tmp_path: Path) -> None:
    file = tmp_path / "wanting.yaml"
    file.write_text(
        "procedure: frequency_sweep\npoints: 1\nlevels: [half]\nstatic: 0 s\n"
        "expect: {sensitivity: {within: [100 mV/g, 110 mV/g]}}\n"
    )
    out, said = program.rig("run", str(file), "--json", wanted=3)
    assert len(json.loads(out)["unmet"]) == 1
    assert re.search(
        r"error: expect sensitivity of unit_a_x: found 6\d\d\.\d\d mV/g, wanted 100\.00 to 110\.00 mV/g", said
    )
    assert program.last().status == "completed"
    assert program.last().verify() == []


@pytest.mark.parametrize("recorders", ["[recorder]", "[scope]"])
def test_one_recorder_is_enough_for_the_sensitivity(
    tmp_path: Path, own_bench_file: Callable[[str], Path], truth: dict[str, Any], recorders: str
) -> None:
    program = Program(tmp_path / "runs", own_bench_file(recorders))
    found = program.json("sweep", *SHORT)
    assert values(found)["unit_a_x"] == pytest.approx(truth["sensitivity"]["unit_a_x"], rel=0.02)
    kept = {
        key for point in program.last().points().values() for key in point if key in ("samples", "response", "traces")
    }
    assert kept == {"samples" if recorders == "[recorder]" else "traces"}
    program.end()


def test_the_cube_s_own_frames_give_the_same_sensitivity_as_the_converter(
    tmp_path: Path, own_bench_file: Callable[[str], Path], truth: dict[str, Any]
) -> None:
    program = Program(tmp_path / "runs", own_bench_file("[recorder, cube]"))
    program.rig("sweep", *SHORT, "--levels", "full")
    records = Records(program.last())
    for point in records.points.values():
        cube = records.cube(point["cube"])
        assert (cube.gaps, cube.bad_frames) == (0, 0)
        if point["frequency"] > 50:
            continue
        volts = cube.counts[:, cube.names.index("unit_a_x")] * CUBE_VOLTS
        fitted = tone.fit_three(np.arange(len(volts)) / cube.rate, volts, point["frequency"])
        found = abs(fitted.amplitude) / point["acceleration"]
        assert found == pytest.approx(truth["sensitivity"]["unit_a_x"], rel=0.02)
    program.end()


BEFORE = {  # faults that a run meets when it begins
    "hp89410a.identity": ("HEWLETT-PACKARD,35670A,1,A.00", "analyzer at GPIB0::19::INSTR: "),
    "operator.refuses": (True, "operator, asked to cables: "),
}
DURING = {  # faults planted when two points are done, and who must be named
    "gpib.silence": (19, "analyzer at GPIB0::19::INSTR: "),
    "gpib.truncate": (100, "analyzer at GPIB0::19::INSTR: "),
    "gpib.drop": (True, " at GPIB0::"),
    "hp89410a.overload": (1, "analyzer at "),
    "das16jr.slip": (700, "recorder at "),
    "das16jr.overflow": (1000, "recorder at "),
    "das16jr.clock": (10, "recorder at "),
    "das16jr.drop": (True, "recorder at "),
    "das16jr.corrupt": (True, "recorder at "),
    "ofv3001.low_level": (2, "vibrometer at "),
    "ofv3001.overrange": (True, "vibrometer at "),
    "ofv3001.silence": (True, "vibrometer at "),
}


@pytest.fixture(scope="module")
def faulty(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Program]:
    """One bench that meets one fault after another."""
    made = Program(tmp_path_factory.mktemp("faulty") / "runs")
    yield made
    made.end()


def ends_clearly(program: Program, running: subprocess.Popen[str], said: str) -> None:
    """The command ends with one line that names who failed, exit code 1 or 3, and the source off."""
    out, err = running.communicate(timeout=100)
    assert running.returncode in (1, 3), (running.returncode, out[-500:], err[-2000:])
    errors = [line for line in err.splitlines() if not line.startswith("Frequency sweep")]
    assert len(errors) == 1, err
    assert errors[0].startswith("error: ")
    assert said in errors[0]
    assert out == ""
    with program.control() as control:
        events = [event for event in control.ask("log")["events"] if event["event"] == "source"]
    assert not events or not events[-1]["on"]


@pytest.mark.parametrize("fault", BEFORE)
def test_a_fault_at_the_beginning_ends_the_run_before_any_point(faulty: Program, fault: str) -> None:
    value, said = BEFORE[fault]
    with faulty.control() as control:
        control.ask("fault", name=fault, value=value)
        ends_clearly(faulty, faulty.start("sweep", *SHORT), said)
        control.ask("fault", name=fault, value=None)
    for run in Runs(faulty.runs).list()[-1:]:
        assert run.verify() == []


@pytest.mark.parametrize("fault", DURING)
def test_a_fault_during_a_run_ends_it_with_one_line_the_source_off_and_all_points_kept(
    faulty: Program, fault: str
) -> None:
    value, said = DURING[fault]
    before = {run.name for run in Runs(faulty.runs).list()}
    with faulty.control() as control:
        running = faulty.start("sweep", "--axis", "x", "--points", "8")
        run = until(lambda: next((r for r in Runs(faulty.runs).list() if r.name not in before), None))
        until(lambda: len(run.points()) >= 2 or running.poll() is not None)
        control.ask("fault", name=fault, value=value)
        kept = run.points()
        ends_clearly(faulty, running, said)
        control.ask("fault", name=fault, value=None)
    after = run.points()
    assert kept.items() <= after.items()
    assert len(after) < 16
    assert run.verify() == []
    assert run.status in ("interrupted", "aborted")
    assert any(entry.kind == "stopped" for entry in run.lines())


def test_a_run_that_a_fault_interrupted_is_finished_by_resume_once_the_fault_is_gone(program: Program) -> None:
    with program.control() as control:
        running = program.start("sweep", *SHORT)
        until(lambda: Runs(program.runs).list() and len(program.last().points()) >= 2)
        control.ask("fault", name="das16jr.drop", value=True)
        ends_clearly(program, running, "recorder at ")
        control.ask("fault", name="das16jr.drop", value=None)
    kept = program.last().points()
    found = program.json("resume", "last")
    assert (found["status"], found["points_done"]) == ("completed", 6)
    assert kept.items() <= program.last().points().items()
    assert program.json("verify")["sound"]


def test_damaged_frames_of_the_cube_do_not_end_a_sweep_but_are_counted(
    tmp_path: Path, own_bench_file: Callable[[str], Path]
) -> None:
    program = Program(tmp_path / "runs", own_bench_file("[recorder, cube]"))
    with program.control() as control:
        control.ask("fault", name="sensor_cube.byte_errors", value=3e-4)
    program.rig("sweep", *SHORT, "--levels", "full")
    run = program.last()
    assert run.status == "completed"
    assert sum(point["cube_bad_frames"] for point in run.points().values()) > 0
    assert sum(point["cube_gaps"] for point in run.points().values()) > 0
    assert run.verify() == []
    program.end()
