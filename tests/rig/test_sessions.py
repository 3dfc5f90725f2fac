"""What settles after power-on goes on from run to run of a session."""

from __future__ import annotations

import math

import fast_bench
import pytest

from fixtures.world import World
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
