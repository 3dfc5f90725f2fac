"""Procedure files: the shipped ones run dry, and a bad one names all its mistakes and moves nothing."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pages
import pytest

from rig.bench import procedure_file
from rig.bench.steps import BenchFacts
from rig.yaml.document import read

FOLDER = Path(procedure_file.procedures()["noise"].__file__ or "").parent
SHIPPED = sorted(FOLDER.glob("*.yaml"))


def rig(runs: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "rig", *arguments, "--runs", str(runs)],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        check=False,
    )


def refused(tmp_path: Path, text: str) -> list[str]:
    """What `rig run` says of a file with this text; checks that nothing was started and nothing was written."""
    file, runs = tmp_path / "bad.yaml", tmp_path / "runs"
    file.write_text(text)
    done = rig(runs, "run", str(file))
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert not runs.exists(), "a bench was started or a run was made"
    return done.stderr.removeprefix("error: ").splitlines()


def starts(lines: list[str], tmp_path: Path) -> list[str]:
    """`line:column key` of every mistake; every one says what was found and what was wanted."""
    found = []
    for line in lines:
        match = re.fullmatch(rf"{re.escape(str(tmp_path / 'bad.yaml'))}:(\d+:\d+) (\S+): found .+, wanted .+", line)
        assert match, line
        found.append(f"{match[1]} {match[2]}")
    return found


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_file_has_a_plan_without_mistakes(path: Path, facts: BenchFacts) -> None:
    plan = procedure_file.plan(read(path), facts)
    assert plan.duration > 0
    assert plan.points > 0
    assert plan.mistakes == ()
    assert plan.title


def test_a_dry_run_lists_every_step_and_starts_nothing(tmp_path: Path) -> None:
    done = rig(tmp_path / "runs", "run", "full_calibration.yaml", "--dry-run", "--json")
    assert done.returncode == 0, done.stderr
    plan = json.loads(done.stdout)
    assert plan["points"] == sum(step["point"] for step in plan["steps"])
    sines = [step for step in plan["steps"] if step["kind"] == "Sine"]
    pages.assert_shown(plan | {"steps": sines}, pages.examples("rig run")[1])
    assert plan["duration"] == pytest.approx(sum(step["duration"] for step in plan["steps"]))
    assert {step["kind"] for step in plan["steps"]} == {
        "Ask",
        "SetFilter",
        "AlignBeam",
        "Static",
        "Sine",
        "Spin",
        "Wait",
    }
    assert max(step["acceleration"] for step in sines) == pytest.approx(0.5 * 9.80665)
    assert max(step["stroke"] for step in sines) == pytest.approx(80e-6)
    assert not (tmp_path / "runs").exists()


def test_the_dry_run_in_words_has_a_line_for_every_step(tmp_path: Path) -> None:
    done = rig(tmp_path / "runs", "run", "sweep_x.yaml", "--dry-run")
    assert done.returncode == 0, done.stderr
    head, *steps, nothing, tail = done.stdout.splitlines()
    assert head.startswith("Accelerometer sweep, x: 55 steps, 48 points, about ")
    assert len(steps) == 55
    assert nothing.startswith("nothing was moved")
    assert tail.startswith("next: rig run ")
    assert any("20 Hz full" in line and "0.129 g" in line and "80.00 µm" in line for line in steps)


def test_mistakes_of_type_are_named_all_at_once_where_they_stand(tmp_path: Path) -> None:
    lines = refused(
        tmp_path,
        "procedure: frequency_sweep\naxis: w\nstart: 500\nstop: 3 V\npoints: many\nlevels: [full, loud]\nstp: 1 Hz\n",
    )
    assert starts(lines, tmp_path) == ["2:7 axis", "3:8 start", "4:7 stop", "5:9 points", "6:16 levels[1]", "7:1 stp"]
    assert "wanted a frequency such as '500 Hz'" in lines[1]
    assert "did you mean 'stop'?" in lines[5]


def test_mistakes_of_sense_are_named_all_at_once_where_they_stand(tmp_path: Path) -> None:
    lines = refused(
        tmp_path,
        "procedure: frequency_sweep\nstart: 400 Hz\nstop: 300 Hz\nrecord: 0 s\n"
        "limits: {acceleration: 2 g, stroke: 1 mm}\nsettle: 1 ms\n",
    )
    places = ["3:7 stop", "4:9 record", "5:24 limits.acceleration", "5:37 limits.stroke", "6:9 settle"]
    assert starts(lines, tmp_path) == places


def test_mistakes_inside_a_sequence_are_named_at_their_own_lines(tmp_path: Path) -> None:
    lines = refused(
        tmp_path,
        "title: mine\nsteps:\n  - prompt: Ready?\n  - {procedure: noise, length: 0 s}\n"
        "  - repeat: 2\n    steps:\n      - {procedure: turntable, speed: 78 rpm}\n"
        "      - {procedure: tumble, record: 2 h}\n",
    )
    assert sorted(set(starts(lines, tmp_path))) == [
        "4:32 steps[1].length",
        "7:39 steps[2].steps[0].speed",
        "8:37 steps[2].steps[1].record",
    ]
    assert len(lines) == len(set(lines)), "a repeated mistake is told once"


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("procedure: dance\n", "1:12 procedure"),
        ("axis: x\n", "1:1 procedure"),
        ("steps: []\n", "1:8 steps"),
        ("steps:\n  - wait: -1 s\n", "2:11 steps[0].wait"),
        ("steps:\n  - repeat: 0\n    steps: [{wait: 1 s}]\n", "2:13 steps[0].repeat"),
        ("steps:\n  - prompt: ''\n", "2:13 steps[0].prompt"),
        ("procedure: turntable\nradius: 1 m\n", "2:9 radius"),
        ("procedure: tumble\nposes: 7\n", "2:8 poses"),
        ("procedure: turntable\nspeed: 0 rpm\n", "2:8 speed"),
    ],
)
def test_one_mistake_is_told_in_one_line_at_its_place(tmp_path: Path, text: str, place: str) -> None:
    assert starts(refused(tmp_path, text), tmp_path) == [place]


@pytest.mark.parametrize("text", ["", "- 1\n", "procedure: noise\nprocedure: noise\n", "a: [\n", "a: &b 1\n", "\t\n"])
def test_what_is_no_procedure_at_all_is_bad_input_with_its_place(tmp_path: Path, text: str) -> None:
    lines = refused(tmp_path, text)
    assert all(re.search(r"bad\.yaml:\d+:\d+ (\S+: )?found .+, wanted .+", line) for line in lines)


def test_a_file_that_does_not_exist_is_bad_input(tmp_path: Path) -> None:
    done = rig(tmp_path / "runs", "run", str(tmp_path / "none.yaml"))
    assert done.returncode == 2
    assert "none.yaml" in done.stderr
    assert "wanted a YAML file" in done.stderr
    assert not (tmp_path / "runs").exists()
