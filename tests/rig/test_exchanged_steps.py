"""The best effect alone may be a bad half of two: earlier steps are looked at again beside later ones."""

from __future__ import annotations

import math
from functools import lru_cache

import imported_worlds as worlds
import pytest
from imported_worlds import Sensor, response, response_table

from rig.diagnose import search
from rig.diagnose.diagnose import Diagnosis, diagnose
from rig.fit.evidence import Evidence
from rig.shelf import shelf

EXCHANGED = Sensor(0.99, 5e-4, 1.5e-3)  # a Bessel filter alone is best, and a Butterworth filter beside it
PAIRED = Sensor(0.99, 1e-3, 3e-3)  # a Butterworth filter alone is best, and nothing helps beside it


@lru_cache(maxsize=4)
def table(sensor: Sensor) -> Evidence:
    return worlds.evidence(response([response_table(sensor.phasor, 3)]))


@lru_cache(maxsize=4)
def found(sensor: Sensor) -> Diagnosis:
    return diagnose(table(sensor))


def best_alone(sensor: Sensor) -> str:
    """The admissible effect that removes most by itself."""
    base = table(sensor).fitted()
    refits = search.best(base, search.scores(base, search.possible(shelf(), base))[:8])
    return next(one.name for one in refits if search.admissible(one.term, one.u))


@pytest.mark.parametrize(("sensor", "alone"), [(EXCHANGED, "bessel_filter"), (PAIRED, "butterworth_filter")])
def test_what_was_best_alone_is_given_up_for_two_that_do_better_together(sensor: Sensor, alone: str) -> None:
    assert best_alone(sensor) == alone
    assert alone not in found(sensor).named
    assert "moving_average" in found(sensor).named
    assert found(sensor).verdict == "missing"


def test_the_pair_is_the_one_that_was_put_in() -> None:
    assert sorted(found(PAIRED).named) == ["delay", "moving_average"]
    at = {term.effect.name: next(iter(term.at.values())) for term in found(PAIRED).final.state.terms}
    assert at == pytest.approx({"delay": 1e-3, "moving_average": 3e-3}, abs=2e-5)


@pytest.mark.parametrize("sensor", [EXCHANGED, PAIRED])
def test_the_ladder_after_an_exchange_is_whole(sensor: Sensor) -> None:
    made = found(sensor)
    first, second = made.steps
    assert first.before.chi2 == pytest.approx(made.base.chi2, rel=1e-6)
    assert second.before.chi2 == pytest.approx(first.after.chi2, rel=1e-3)
    assert second.after.chi2 == pytest.approx(made.final.chi2, rel=1e-2)
    assert math.sqrt(made.final.chi2 / made.final.count) < 1.2
    assert sorted(made.named) == sorted(term.effect.name for term in made.final.state.terms)


def test_no_step_is_taken_twice() -> None:
    assert len(set(found(EXCHANGED).named)) == len(found(EXCHANGED).named)
