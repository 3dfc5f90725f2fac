"""One bench has one driver, and how it was left is told as it is: by the twin's own log of its source."""

from __future__ import annotations

import json
import os
import random
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

from driven import driving, on, plant, sources
from in_process import Done, rig

from rig.archive.runs import Runs
from rig.bench.armed import Armed
from rig.bench.assembly import occupied, state_folder
from rig.bench.benchfile import describe
from rig.bench.control import stop
from rig.yaml.config import shipped

SHORT = "procedure: frequency_sweep\naxis: x\npoints: 24\nstatic: 20 s\n"


def asked(folder: Path, *words: str) -> Done:
    """Another program, which asks for the bench of this folder of runs."""
    return rig(*words, "--runs", str(folder / "runs"), XDG_RUNTIME_DIR=os.environ["XDG_RUNTIME_DIR"])


def test_a_second_program_is_refused_at_once_and_the_first_is_unharmed(tmp_path: Path) -> None:
    delays, refused = random.Random(4), 0
    others = [("turntable", "--rpm", "45"), ("bench", "check"), ("bench", "safe"), ("sweep", "--axis", "y")]
    with driving(tmp_path, procedure=SHORT) as first:
        first.until_on()
        for words in others:
            threading.Event().wait(delays.uniform(0.0, 0.2))
            second = asked(tmp_path, *words)
            if Runs(tmp_path / "runs").list()[0].status == "running":
                refused += 1
                assert second.returncode == 1
                assert f"found it held by process {first.program.pid} (rig run long.yaml" in second.stderr
        assert refused
        assert first.ended()[0] == 0
        assert asked(tmp_path, "bench", "check").returncode == 0
    (run,) = Runs(tmp_path / "runs").list()
    assert run.status == "completed"
    assert run.verify() == []


def test_what_program_and_guard_leave_on_when_both_are_killed_keeps_others_from_the_bench(tmp_path: Path) -> None:
    with driving(tmp_path) as first:
        first.until_on()
        os.kill(first.guard, signal.SIGSTOP)
        first.program.kill()
        os.kill(first.guard, signal.SIGKILL)
        first.ended()
        assert on(sources(first.runs))
        refused = asked(tmp_path, "sweep", "--axis", "x", "--points", "1")
        assert refused.returncode == 1
        assert refused.stderr.startswith("NOT SAFE: analyzer of bench simulated")
        listed = asked(tmp_path, "runs")
        assert listed.returncode == 0
        assert "NOT SAFE" in listed.stdout
        assert listed.stderr.startswith("NOT SAFE: analyzer of bench simulated")
        assert "armed" in json.loads(asked(tmp_path, "show", "--json").stdout)["not_safe"]
        made = asked(tmp_path, "bench", "safe", "--json")
        assert (made.returncode, json.loads(made.stdout)["safe"]) == (0, True)
        assert not on(sources(first.runs))
        assert "NOT SAFE" not in asked(tmp_path, "runs").stdout + asked(tmp_path, "runs").stderr
        assert asked(tmp_path, "bench", "check").returncode == 0


def test_a_source_that_does_not_answer_any_more_is_not_safe_until_it_was_read_back(tmp_path: Path) -> None:
    bench = shipped("benches/simulated.yaml")
    hasty = bench.read_text().replace('${gpib}::INTFC"}', '${gpib}::INTFC", timeout: 200 ms}')
    (tmp_path / "bench.yaml").write_text(hasty.replace("../", f"{bench.parents[1]}/"))
    options = ("--bench", str(tmp_path / "bench.yaml"))
    with driving(tmp_path, *options) as first:
        first.until_on()
        plant(first.runs, "gpib.silence", True)
        os.kill(first.guard, signal.SIGKILL)  # it would try for ten seconds
        code, said = first.ended()
        assert code == 1
        assert "NOT SAFE: analyzer: not read back as off; the guard has ended" in said
        assert "off, read back" not in said
        assert on(sources(first.runs))
        assert asked(tmp_path, "bench", "safe", *options).returncode == 1
        assert asked(tmp_path, "bench", "check", *options).stderr.startswith("NOT SAFE")
        plant(first.runs, "gpib.silence", None)
        assert asked(tmp_path, "bench", "safe", *options).returncode == 0
        assert not on(sources(first.runs))
        assert asked(tmp_path, "bench", "check", *options).returncode == 0


def test_what_was_left_armed_and_is_not_in_the_bench_file_is_not_said_to_be_off(tmp_path: Path) -> None:
    description, runs = describe(shipped("benches/simulated.yaml")), tmp_path / "runs"
    with occupied(description, runs) as possession:
        armed = Armed.of(possession, ("analyzer", "amplifier"), tmp_path / "guard.jsonl", str(runs.resolve()))
        armed.write()
    try:
        refused = asked(tmp_path, "bench", "safe")
        assert refused.returncode == 1
        assert "NOT SAFE: amplifier: it was left armed" in refused.stderr
        assert asked(tmp_path, "bench", "check").stderr.startswith("NOT SAFE")
        replace(armed, instruments=("analyzer",)).write()
        assert asked(tmp_path, "bench", "safe").returncode == 0
        assert asked(tmp_path, "bench", "check").returncode == 0
    finally:
        stop(state_folder(description, runs))


def test_a_stopped_program_is_switched_off_soon_and_sends_nothing_when_it_goes_on(tmp_path: Path) -> None:
    with driving(tmp_path) as first:
        first.until_on()
        stopped = time.monotonic()
        first.program.send_signal(signal.SIGSTOP)
        assert first.off_after(stopped) - stopped < 30.0  # how soon on a quiet machine: bench_guard
        refused = asked(tmp_path, "bench", "check")
        assert refused.returncode == 1
        assert "which is stopped" in refused.stderr
        passed = asked(tmp_path, "bench", "safe")
        assert passed.returncode == 0
        assert f"passed over process {first.program.pid}" in passed.stdout
        went_on = time.monotonic()
        first.program.send_signal(signal.SIGCONT)
        code, said = first.ended()
        assert code == 1
        assert "guard: it is gone or has acted" in said
        assert not any(one["on"] for one in sources(first.runs) if one["wall"] > went_on)
