"""A size that is unusual counts against an effect, as far as such sizes are less probable, and forbids nothing."""

from __future__ import annotations

import math

import imported_worlds as worlds
import numpy as np
import pytest
from imported_worlds import Unit

from rig.diagnose import search
from rig.diagnose.diagnose import diagnose
from rig.model import Term
from rig.shelf import shelf

HUNDRED = math.radians(100.0)  # °/s
BENT = 0.02  # of the rate at 100 °/s


def test_a_cubic_of_unusual_size_that_fits_best_is_preferred_to_a_usual_dead_zone() -> None:
    log = worlds.rotation(Unit(rate_zero=(0.0, 0.0, 0.0)), 3, seconds=30.0, channels="r")
    bent = worlds.changed(log, "gyro_z", lambda rate: rate * (1.0 + BENT * (rate / HUNDRED) ** 2))
    made = diagnose(worlds.evidence(bent))
    first = made.steps[0].taken
    assert first.name == "cubic"
    assert first.term.at["coefficient"] == pytest.approx(BENT / HUNDRED**2, rel=0.3)
    others = {one.name: one.probability for one in made.steps[0].others}
    assert others.get("dead_zone", 0.0) < 1e-3


def improbability(name: str, **at: float) -> float:
    effect = shelf()[name]
    on = effect.quantities[0] if effect.quantities else None
    return search.improbability(Term(effect, on, at), {})


def test_each_decade_beyond_the_usual_sizes_costs_more_and_none_forbids() -> None:
    beyond = [improbability("delay", time=2e-2 * 10.0**decades) for decades in (-1.0, 0.0, 1.0, 2.0, 4.0)]
    assert beyond[:2] == [0.0, 0.0]
    assert np.all(np.diff(beyond[1:]) > 0.0)
    assert math.isfinite(beyond[-1])
    assert improbability("resonance", square=50.0**-2, loss=0.01) < 10.0  # 50 Hz, where some others are


def test_what_physics_cannot_be_is_no_candidate_whatever_it_removes() -> None:
    assert improbability("delay", time=-1e-3) == math.inf
    assert improbability("butterworth_filter", period=-1e-3) == math.inf
    assert improbability("resonance", square=-1e-6, loss=1e-3) == math.inf
    assert improbability("resonance", square=1e-6, loss=-1e-3) == math.inf
    effect = shelf()["delay"]
    within = search.improbability(Term(effect, "rate", {"time": -1e-3}), {"time": 1e-3})
    assert within == 0.0  # it may as well be a millisecond


def test_between_two_that_remove_the_same_the_one_of_usual_size_is_likelier() -> None:
    usual, unusual = improbability("delay", time=1e-2), improbability("first_order_lag", time_constant=1e-2)
    assert usual == 0.0
    assert unusual > 2.0
