"""How long a diagnosis takes once its records are loaded, as a multiple of one fit of the starting model."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial

import blind_worlds
import golden_blind
import imported_worlds as worlds
import pytest

from rig.diagnose.diagnose import diagnose
from rig.fit.evidence import Evidence, evidence_of

BAR = 12.0
TURNS = 3
LONG = 25.0 * 60.0  # s


def times_a_fit(made: Callable[[], Evidence]) -> float:
    """Median of a diagnosis ÷ one fit of the starting model, each from evidence of its own: what one has worked out is
    not there for the other.
    """
    taken: dict[str, list[float]] = {"fit": [], "diagnosis": []}
    for _ in range(TURNS):
        for name, work in (("fit", lambda evidence: evidence.fitted(())), ("diagnosis", diagnose)):
            evidence = made()
            begun = time.process_time()
            work(evidence)
            taken[name].append(time.process_time() - begun)
    ours, one = (statistics.median(taken[name]) for name in ("diagnosis", "fit"))
    print(f"  diagnosis {ours:.2f} s, fit {one:.3f} s, ratio {ours / one:.1f}")
    return ours / one


@pytest.mark.parametrize("bench", ["shaker", "turntable"])
def test_a_diagnosis_takes_few_times_what_a_fit_takes(bench: str) -> None:
    print()
    ratios = []
    for answer in (one for one in golden_blind.answers() if one.bench == bench):
        print(f"  {bench}, {' and '.join(answer.names) or 'nothing hidden'}:", end="")
        records = blind_worlds.measured(blind_worlds.world_of(answer), answer.bench)
        ratios.append(times_a_fit(partial(evidence_of, [records])))
    print(f"{bench}: median of {len(ratios)} worlds {statistics.median(ratios):.1f} (bar {BAR:.0f})")
    assert statistics.median(ratios) <= BAR


def test_nor_does_that_of_a_long_imported_record() -> None:
    print("\n  imported rotation of 25 minutes:", end="")
    foreign = worlds.rotation(worlds.clean(1), seconds=LONG)
    assert times_a_fit(partial(worlds.evidence, foreign)) <= BAR
