"""No draw breaks a measurement: the standard runs complete with every effect at the strongest that is allowed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import fast_bench
import numpy as np
import pytest

from fixtures import drawing
from fixtures.shelf import SHELF
from rig.diagnose.conclusion import concluded
from rig.diagnose.diagnose import diagnose
from rig.fit.evidence import evidence_of
from rig.shelf import shelf

SHORT: Mapping[str, Mapping[str, Any]] = {
    "shaker": {"procedure": "frequency_sweep", "axis": "x", "points": 4, "static": "2 s", "static_after": "1 s"},
    "turntable": {"procedure": "turntable", "axis": "yaw", "revolutions": 3, "rest": "3 s"},
}
ALWAYS_ABSORBED = ("sensitivity", "offset", "buffer_gain", "ldv_cosine")
STRONGEST = [(bench, name) for bench in SHORT for name in drawing.names(bench)]


def entry(bench: str, name: str) -> dict[str, Any]:
    """The effect at its largest size, with the other parameters drawn."""
    parameters = SHELF.kind(name).drawn(np.random.default_rng(5), bench)
    return {"name": name, "parameters": drawing.strongest(name, parameters)}


@pytest.mark.slow
@pytest.mark.parametrize(("bench", "name"), STRONGEST)
def test_the_standard_run_of_its_bench_completes_and_can_be_read(bench: str, name: str) -> None:
    records = fast_bench.measure(SHORT[bench], fast_bench.world(3, [entry(bench, name)]))
    assert records.status == "completed"
    assert len(records.points) == {"shaker": 8, "turntable": 5}[bench]
    assert evidence_of([records]).parts


def test_what_a_sensitivity_absorbs_stands_among_what_cannot_be_seen() -> None:
    world = fast_bench.world(3)
    evidence = evidence_of([fast_bench.measure(document, world) for document in SHORT.values()])
    said = concluded(evidence, diagnose(evidence, shelf=shelf()), shelf()).cannot_see
    assert {name for name in ALWAYS_ABSORBED if any(one.startswith(f"{name}: ") for one in said)} == set(
        ALWAYS_ABSORBED
    )


def test_nothing_that_may_be_drawn_is_left_out_here() -> None:
    sized = {name for name in SHELF.names if SHELF.kind(name).size}
    assert {name for _, name in STRONGEST} == sized
    assert set(SHELF.names) - sized == set(ALWAYS_ABSORBED)
