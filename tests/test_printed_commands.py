"""Every command that is printed runs as it stands, in the shell and folder where it was printed, and means the same.

Runs, model, effects and bench are kept in places whose names have spaces; what is printed is given to a shell.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import in_process
import pytest
import yaml

from rig.bench import control
from rig.bench.assembly import state_folder
from rig.bench.benchfile import describe
from rig.yaml.config import shipped

CUBIC = {"name": "cubic", "parameters": {"quantity": "acceleration", "coefficient": 3e-4}}
OWN = '''"""Drag of the cable."""

import numpy as np

from rig.model import Array, Coordinate, Effect, Motion, Parameter, Values


class Drag(Effect):
    stage = "transducer"
    title = "drag of the cable"
    equation = "u + drag·u⁷"
    quantities = ("acceleration",)
    coordinates = (Coordinate("drag", 1e-9),)
    parameters = (Parameter("drag", "1/(SI)⁶", (-1.0, 1.0), (1e-9, 1e-8)),)
    missing = "it pulls"
    separate_by = "a shorter cable"
    source = "our own bench"

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        return np.asarray(u + at["drag"] * u**7)
'''
PRINTED = re.compile(r"^next: (rig .*)$", re.MULTILINE)
ADVISED = re.compile(r"`(rig [^`]+)`")
pytestmark = pytest.mark.timeout(900)
END = "end of the command"
MODEL, EFFECTS, RUNS, BENCH = "my models/model 1.yaml", "my effects", "my runs", "my bench.yaml"


@dataclass
class Shell:
    """A folder in which commands are typed."""

    folder: Path

    def run(self, line: str, wanted: int = 0) -> str:
        """What a line prints, both streams; a shell says what its words are, and a command that fails is the last."""
        said, code = "", 0
        for words in self.words(line):
            done = in_process.rig(*words, folder=self.folder)
            said, code = said + done.stdout + done.stderr, done.returncode
            if code:
                break
        assert code == wanted, f"{line}\n{said[-3000:]}"
        assert "Traceback" not in said
        return said

    def words(self, line: str) -> list[list[str]]:
        """Words of every command of a line, as a shell takes it apart."""
        program = f"rig() {{ printf '%s\\0' \"$@\" '{END}'; }}\n"
        done = subprocess.run(
            ["bash", "-c", program + line], cwd=self.folder, capture_output=True, text=True, check=True
        )
        assert not done.stderr, f"{line}\n{done.stderr}"
        return [part.split("\0")[:-1] for part in done.stdout.split(f"{END}\0")[:-1]]

    def runs(self) -> set[str]:
        """Names of the runs where they are meant to be."""
        return {path.parent.name for path in (self.folder / RUNS).glob("*/journal.jsonl")}

    def measuring(self, before: set[str]) -> bool:
        """Whether a run that was not there before has measured its first point."""
        journals = [self.folder / RUNS / name / "journal.jsonl" for name in self.runs() - before]
        return any('"kind":"point"' in one.read_text(encoding="utf-8") for one in journals)


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    """A sweep on a bench that hides a cubic nonlinearity, everything in places of its own."""
    folder = tmp_path_factory.mktemp("printed commands")
    ours = shipped("benches/simulated.yaml")
    world = yaml.safe_load((ours.parent / "../worlds/clean.yaml").read_text(encoding="utf-8"))
    (folder / "world.yaml").write_text(yaml.safe_dump({**world, "hidden": [CUBIC]}, allow_unicode=True))
    text = ours.read_text(encoding="utf-8").replace("../worlds/clean.yaml", str(folder / "world.yaml"))
    bench = folder / BENCH
    bench.write_text(text.replace("seed: 1}", "seed: 2}").replace("../", f"{ours.parent.parent}/"), encoding="utf-8")
    (folder / EFFECTS).mkdir()
    (folder / EFFECTS / "cable_drag.py").write_text(OWN, encoding="utf-8")
    made = Shell(folder)
    made.run(f"rig sweep --axis x --points 8 --bench '{BENCH}' --runs '{RUNS}'")
    yield made
    control.stop(state_folder(describe(bench), folder / RUNS))


@pytest.fixture(autouse=True)
def _nothing_goes_where_it_is_not_meant_to(shell: Shell) -> Iterator[None]:
    yield
    assert not (shell.folder / "runs").exists()


def printed(text: str) -> list[str]:
    """Commands that a text tells its reader to run; what is said of one run or file is not among them."""
    return list(dict.fromkeys([*PRINTED.findall(text), *ADVISED.findall(text)]))


def carries(line: str, *options: str) -> bool:
    """Whether every command of a line has these options."""
    return all(option in one for one in line.split(" && ") for option in options)


RUN, UNIT, OURS = f"--runs '{RUNS}'", f"--model '{MODEL}'", f"--effects '{EFFECTS}'"
WORDS = f"last {UNIT} {OURS} {RUN}"
FLOWS = {
    "compare": f"rig compare {WORDS}",
    "diagnose": f"rig diagnose {WORDS}",
    "paper": f"rig diagnose {WORDS} --start paper".replace("model 1", "paper 1"),
    "add": f"rig add cable_drag {WORDS}".replace("model 1", "model 2"),
    "formula": f"rig add wave {WORDS} --formula 'k*sin(u/w)' --start 'w=2 g' --start 'w=1 g' --on acceleration".replace(
        "model 1", "model 3"
    ),
    "next": f"rig next {WORDS} --bench '{BENCH}'",
    "calibrate": f"rig calibrate all --name 'my unit' {RUN}",
    "runs": f"rig runs {RUN}",
    "verify": f"rig verify {RUN}",
    "check": f"rig bench check --bench '{BENCH}' {RUN}",
    "dry run": f"rig sweep --axis x --points 1 --levels full --dry-run --bench '{BENCH}' {RUN}",
}  # fmt: skip


@pytest.mark.parametrize("flow", FLOWS)
def test_every_printed_command_runs_as_it_stands_and_says_where_runs_model_and_effects_are(
    shell: Shell, flow: str
) -> None:
    found = PRINTED.findall(shell.run(FLOWS[flow]))
    assert found, FLOWS[flow]
    for line in found:
        assert carries(line, RUN), line
        if " last " in FLOWS[flow] and "rig history" not in line and "rig turntable" not in line:
            name = re.search(r"my models/\w+ \d", FLOWS[flow])
            assert carries(line, f"--model '{name[0] if name else ''}.yaml'", OURS), line
        if flow in ("next", "check", "dry run") and ("rig sweep" in line or "rig turntable" in line):
            assert carries(line, f"--bench '{BENCH}'"), line
        before = shell.runs()
        quick = line.replace("rig sweep --axis x --bench", "rig sweep --axis x --points 1 --bench")
        quick = quick.replace("rig turntable --all", "rig turntable --all --revolutions 2 --rest '5 s'")
        shell.run(quick)  # of a measurement a short one, on the same bench
        assert shell.runs() >= before


def test_a_diagnosis_goes_on_in_the_model_it_was_asked_of(shell: Shell) -> None:
    """From the first comparison to the history by nothing but what is printed."""
    words = WORDS.replace("model 1", "model 5").replace("last", sorted(shell.runs())[0])
    line, seen = f"rig compare {words}", []
    while line is not None and len(seen) < 5:
        seen.append(line.split()[1])
        line = next(iter(PRINTED.findall(shell.run(line))), None)
    assert seen == ["compare", "diagnose", "add", "diagnose", "fit"]
    model = yaml.safe_load((shell.folder / "my models" / "model 5.yaml").read_text(encoding="utf-8"))
    assert [entry["effect"] for entry in model["effects"]] == ["cubic"]


def test_advice_among_what_data_cannot_see_and_in_json_carries_the_same(shell: Shell) -> None:
    text = shell.run(f"rig diagnose {WORDS}")
    assert any("rig run remounts.yaml" in line for line in ADVISED.findall(text))
    assert all(carries(line, RUN) for line in ADVISED.findall(text))
    limits = json.loads(shell.run(f"rig diagnose {WORDS} --json"))["cannot_see"]
    assert all(carries(line, RUN) for one in limits for line in ADVISED.findall(one))
    found = json.loads(shell.run(f"rig next {WORDS} --bench '{BENCH}' --json"))
    assert all(carries(one["command"], RUN) for one in found["unmeasured"])


@pytest.mark.parametrize(
    ("line", "advice"),
    [
        ("rig show --runs 'no runs'", "rig sweep --axis x --runs 'no runs'"),
        (f"rig history --model 'no model.yaml' {RUN}", f"rig fit last --model 'no model.yaml' {RUN}"),
        (f"rig export nothing --to csv {RUN}", f"rig calibrate all {RUN}"),
        (
            f"rig compare last --as-is --model 'none yet.yaml' {OURS} {RUN}",
            f"rig fit last --model 'none yet.yaml' {OURS} {RUN}",
        ),
        (f"rig effects cubik {OURS}", f"rig effects {OURS}"),
    ],
)
def test_an_error_advises_a_command_that_runs_as_it_stands(shell: Shell, line: str, advice: str) -> None:
    said = shell.run(line, wanted=2)
    if "calibrate" in advice and "one of" in said:  # another test has made one
        return
    assert ADVISED.findall(said) == [advice]
    if "sweep" not in advice:
        shell.run(advice)


def test_an_imported_run_goes_on_where_it_was_kept(tmp_path: Path, shell: Shell) -> None:
    import foreign_data as made

    folder = tmp_path / "their data"
    folder.mkdir()
    (folder / "swing.csv").write_bytes(made.csv_bytes(made.turning(seconds=20.0)))
    (tmp_path / "swing.yaml").write_text(made.turning_manifest("swing.csv"), encoding="utf-8")
    mine = Shell(tmp_path)
    (dry,) = PRINTED.findall(mine.run("rig import swing.yaml --data 'their data' --runs 'my runs' --dry-run"))
    assert dry == "rig import swing.yaml --data 'their data' --runs 'my runs'"
    (line,) = PRINTED.findall(mine.run(dry))
    assert line.startswith("rig compare ")
    mine.run(line)
    (drafting,) = PRINTED.findall(mine.run("rig import --guess 'their data/swing.csv' --runs 'my runs'"))
    mine.run(drafting)
    assert (tmp_path / "swing-2.yaml").exists()  # the other was there already


def test_an_interrupted_measurement_says_how_to_go_on_with_it(shell: Shell) -> None:
    import signal
    import time

    words = [sys.executable, "-m", "rig", "sweep", "--axis", "x", "--points", "12", "--bench", BENCH, "--runs", RUNS]
    before = shell.runs()
    going = subprocess.Popen(words, cwd=shell.folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not shell.measuring(before):  # pytest's own limit ends it
        time.sleep(0.05)
    going.send_signal(signal.SIGINT)
    _, said = going.communicate()
    assert going.returncode == 130, said
    resume, runs = PRINTED.findall(said)
    assert carries(resume, "rig resume last", f"--bench '{BENCH}'", RUN)
    assert carries(runs, "rig runs", RUN)
    shell.run(resume)
    shell.run(runs)
