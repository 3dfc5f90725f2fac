"""The bench's own ripple: found from three mountings, none where there is none, carried by a fit as a nuisance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import fast_bench
import pytest
from blind_strangers import Ripple
from blind_worlds import with_more

from fixtures.world import World
from rig.errors import BadInput, ConfigError
from rig.fit import adequacy
from rig.fit.evidence import Evidence, evidence_of
from rig.fit.floor import floor_of, load, save, with_floor
from rig.parts.ripple import Floor, said

RIPPLE = 1e-3


def _mountings(count: int, **more: Any) -> dict[str, Any]:
    sweep = {"procedure": "frequency_sweep", "axis": "x", "levels": ["full"], **more}
    return {"title": "remounts", "steps": [{"repeat": count, "steps": [sweep]}]}


def _rippled(seed: int) -> World:
    return with_more(fast_bench.world(seed), [Ripple(relative=RIPPLE)])


@pytest.fixture(scope="module")
def world() -> World:
    return _rippled(3)


@pytest.fixture(scope="module")
def remounts(world: World) -> Evidence:
    return evidence_of([fast_bench.measure(_mountings(3), world)])


@pytest.fixture(scope="module")
def floor(remounts: Evidence) -> Floor:
    return floor_of(remounts)


def test_a_ripple_of_a_tenth_of_a_per_cent_is_found_from_three_mountings(floor: Floor, remounts: Evidence) -> None:
    found = floor.size * math.sqrt(2.0)  # of both parts together, as the world's
    assert RIPPLE / 1.6 < found < RIPPLE * 1.6
    assert floor.mountings == 3
    assert floor.runs == remounts.runs
    assert "0.1" in said(floor)


def test_a_clean_bench_has_no_floor() -> None:
    found = floor_of(evidence_of([fast_bench.measure(_mountings(3), fast_bench.world(3))]))
    assert found.size == 0.0
    assert "no ripple beyond noise between 3 mountings" in said(found)


def test_two_mountings_are_too_few(world: World) -> None:
    evidence = evidence_of([fast_bench.measure(_mountings(2, points=4), world)])
    with pytest.raises(BadInput, match=r"found 2 mountings of one axis, wanted at least 3"):
        floor_of(evidence)


def test_mountings_that_share_no_frequency_are_refused_and_not_called_free_of_ripple(world: World) -> None:
    sweeps = [
        {"procedure": "frequency_sweep", "axis": "x", "levels": ["full"], "points": 4, "start": f"{20 + 7 * k} Hz",
         "stop": f"{300 + 50 * k} Hz"}
        for k in range(3)
    ]  # fmt: skip
    evidence = evidence_of([fast_bench.measure({"title": "three sweeps", "steps": sweeps}, world)])
    with pytest.raises(BadInput, match="found no frequency and level that all mountings share"):
        floor_of(evidence)


def test_a_model_is_adequate_with_the_floor_that_is_not_without_it(world: World, floor: Floor) -> None:
    evidence = evidence_of([fast_bench.measure({"procedure": "frequency_sweep", "axis": "x"}, world)])
    assert not adequacy.adequate(evidence.fitted())
    assert adequacy.adequate(with_floor(evidence, floor).fitted())


def test_what_is_not_known_of_the_floor_is_said(remounts: Evidence, floor: Floor) -> None:
    assert "not known" in with_floor(remounts, None).blind[-1]
    assert with_floor(remounts, floor).blind[-1] == said(floor)
    assert with_floor(remounts, None).parts == remounts.parts


def test_a_floor_is_read_as_it_was_written(tmp_path: Path, floor: Floor) -> None:
    assert load(tmp_path / "floor.yaml") is None
    save(tmp_path / "runs" / "floor.yaml", floor)
    assert load(tmp_path / "runs" / "floor.yaml") == floor


@pytest.mark.parametrize(
    "text",
    [
        "size: 0.001\nlength: 0.3\n", "- 1\n", "size: much\nlength: 1\nmountings: 3\nruns: []\n",
        "size: -1\nlength: 1\nmountings: 3\nruns: []\n", "size: .nan\nlength: 1\nmountings: 3\nruns: []\n",
        "size: 0.001\nlength: 0\nmountings: 3\nruns: []\n", "size: [\n", "",
    ],
)  # fmt: skip
def test_a_broken_floor_is_refused_by_the_name_of_its_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "floor.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises((BadInput, ConfigError), match=r"floor\.yaml.*found"):
        load(path)
