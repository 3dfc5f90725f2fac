"""Saturation on one side, and soft saturation: each is named where it is the truth (the hard one: the blind slice)."""

from __future__ import annotations

import math

import fast_bench
import numpy as np
import pytest

from rig.diagnose import search
from rig.diagnose.diagnose import diagnose
from rig.fit.evidence import Evidence, evidence_of
from rig.shelf import effect_of, shelf

OFFERED = ("one_sided_saturation", "soft_saturation")


def swept(name: str, **parameters: float) -> Evidence:
    entry = {"name": name, "parameters": {"quantity": "acceleration", **parameters}}
    document = {"procedure": "frequency_sweep", "axis": "x", "points": 5}
    return evidence_of([fast_bench.measure(document, fast_bench.world(21, [entry]))])


@pytest.mark.parametrize(
    ("name", "parameters", "true"),
    [
        ("one_sided_saturation", {"limit": 4.5, "side": -1.0}, -4.5),
        ("soft_saturation", {"limit": 6.0, "sharpness": 5.0}, 6.0),
    ],
)
def test_the_kind_of_saturation_that_is_there_is_named(name: str, parameters: dict[str, float], true: float) -> None:
    found = diagnose(swept(name, **parameters))
    assert found.named == (name,)
    term = found.final.state.terms[-1]
    assert term.effect.physical(term.at)["limit"] == pytest.approx(true, rel=0.02)


def test_what_is_much_like_others_is_scored_only_where_these_do_some_good() -> None:
    found = swept("first_order_lag", time_constant=2e-5).fitted()
    known = {name: one for name, one in shelf().items() if one.stage in ("transducer", "dynamics")}
    there = {one.start.effect.name for one in search.scores(found, search.possible(known, found))}
    assert "saturation" in there
    assert not there.intersection(OFFERED)
    for name in OFFERED:  # asked for by itself, as `rig add` does
        asked = search.scores(found, search.possible({name: effect_of(name)}, found))
        assert [one.start.effect.name for one in asked if one.start.on == "acceleration"] == [name]


@pytest.mark.parametrize(("u", "out"), [(6.0, 6.0 / 2.0**0.25), (-6.0, -6.0 / 2.0**0.25), (0.0, 0.0), (1e4, 6.0)])
def test_soft_saturation_nears_its_limit(u: float, out: float) -> None:
    effect = effect_of("soft_saturation")
    at = effect.from_physical({"limit": 6.0, "sharpness": 4.0})
    assert effect.transduce(np.array([u]), None, at)[0] == pytest.approx(out)  # type: ignore[arg-type]
    assert effect.physical(at) == pytest.approx({"limit": 6.0, "sharpness": 4.0})
    assert effect.physical({**at, "loss": 0.0})["limit"] == math.inf


def test_one_side_is_scored_where_nothing_even_does_any_good() -> None:
    """On a turntable few stretches come near a limit: of what is even hardly anything is seen."""
    entry = {"name": "one_sided_saturation", "parameters": {"quantity": "rate", "limit": 4.68, "side": 0.45}}
    turns = {"procedure": "turntable", "all": True, "revolutions": 3, "rest": "10 s"}
    found = evidence_of([fast_bench.measure(turns, fast_bench.world(21, [entry]))]).fitted()
    known = {name: one for name, one in shelf().items() if one.stage == "transducer"}
    gains = {one.start.key: one.gain for one in search.scores(found, search.possible(known, found))}
    assert max(gains["quadratic (rate)"], gains["asymmetry (rate)"]) < search.HARDLY
    assert gains["one_sided_saturation (rate)"] > 0.7 * gains["saturation (rate)"] > search.HARDLY
