"""What settles after power-on goes on from run to run of a session."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import fast_bench
import pytest
from click.testing import CliRunner

from fixtures.world import World
from rig.archive.records import Records
from rig.archive.runs import Runs
from rig.cli import cli
from rig.diagnose.diagnose import diagnose
from rig.fit.evidence import evidence_of
from rig.parts.reading import sessions

SHIFT, SETTLING = 0.045, 160.0  # m/s², s


@pytest.fixture(scope="module")
def world() -> World:
    hidden = {"shift": SHIFT, "time_constant": SETTLING, "quantity": "acceleration"}
    return fast_bench.world(1, [{"name": "warm_up", "parameters": hidden}])


@pytest.fixture(scope="module")
def runs(world: World) -> list[fast_bench.MemoryRecords]:
    swept = fast_bench.measure({"procedure": "frequency_sweep", "axis": "x"}, world)
    return [swept, fast_bench.measure({"procedure": "turntable"}, world)]


def test_a_second_run_counts_from_the_first_records_of_the_session(runs: list[fast_bench.MemoryRecords]) -> None:
    first, second = runs
    since = sessions.begun(runs)
    assert since[first.name] == since[second.name]
    assert sessions.begun([second])[second.name] > since[first.name] + 60.0
    evidence = evidence_of(runs)
    starts = {part.run: float(part.reference.elapsed.min()) for part in evidence.parts if part.drawing != "noise"}
    assert starts[first.name] < 10.0 < 60.0 < starts[second.name]


def test_the_warm_up_of_two_runs_has_one_shift_and_nothing_is_blamed_beside_it(
    runs: list[fast_bench.MemoryRecords], world: World
) -> None:
    found = diagnose(evidence_of(runs))
    assert (found.verdict, found.named) == ("missing", ("warm_up",))
    (step,) = found.steps
    begun = sessions.begun(runs)[runs[0].name] - world.epoch
    for name, true in (("shift", SHIFT * math.exp(-begun / SETTLING)), ("time_constant", SETTLING)):
        assert abs(step.taken.term.at[name] - true) < 3.0 * step.taken.u[name]


def asked(runs: Path, *words: str) -> Any:
    """What a command says of runs in a folder; it raises what the command raises."""
    words = (*words, "--runs", str(runs), "--json")
    return json.loads(CliRunner().invoke(cli, words, catch_exceptions=False, standalone_mode=False).stdout)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """A folder with a short sweep and the turntable run after it, of gyros that warm up; names of both."""
    runs = tmp_path_factory.mktemp("session")
    hidden = {"shift": 1.0, "time_constant": 60.0, "quantity": "rate"}
    world = fast_bench.world(3, [{"name": "warm_up", "parameters": hidden}])
    swept = fast_bench.keep({"procedure": "frequency_sweep", "axis": "x", "points": 4}, world, runs)
    return runs, swept, fast_bench.keep({"procedure": "turntable", "revolutions": 8}, world, runs)


def test_a_model_of_both_runs_says_the_same_of_one_of_them_alone(archive: tuple[Path, str, str]) -> None:
    """Held as it is, it leaves of the turntable run what a model of that run alone leaves."""
    runs, *both = archive
    ratios = []
    for number, names in enumerate((both, both[1:])):
        model = str(runs / f"{number}.yaml")
        asked(runs, "add", "warm_up", *names, "--on", "rate", "--model", model)
        groups = asked(runs, "compare", both[1], "--as-is", "--model", model)["groups"]
        ratios.append({one["name"]: one["ratio"] for one in groups}["turntable, gyros"])
    assert ratios[0] == pytest.approx(ratios[1], rel=0.01)
    assert ratios[1] < 1.1


def test_a_session_begins_with_runs_that_are_not_read_and_ends_at_a_long_break(archive: tuple[Path, str, str]) -> None:
    runs, swept, turned = archive
    first, second = (Records(Runs(runs).open(name)) for name in (swept, turned))
    assert [one.name for one in second.earlier()] == [swept]
    assert list(first.earlier()) == []
    since = sessions.begun([second])
    assert since == {turned: sessions.begun([first])[swept]}
    assert sessions.begun([second, first]) == {swept: since[turned], turned: since[turned]}
