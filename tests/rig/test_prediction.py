"""A model held as it is: what it predicts of another record, and what one factor per channel explains."""

from __future__ import annotations

import imported_worlds as worlds
import pytest
from imported_worlds import Sensor, response, response_table

from rig.diagnose.prediction import Prediction, predict
from rig.fit.evidence import Evidence
from rig.model import Term
from rig.shelf import effect_of


def table(sensor: Sensor, seed: int) -> Evidence:
    return worlds.evidence(response([response_table(sensor.phasor, seed)]))


def predicted(other: Sensor) -> Prediction:
    """A model fitted to one table, held against a table of another sensor."""
    start = [
        Term(effect_of("delay"), "acceleration", {"time": 1.5e-3}),
        Term(effect_of("moving_average"), "acceleration", {"window": 2.5e-3}),
    ]
    found = table(Sensor(gain=1.02, delay=2e-3, window=3e-3), 1).fitted(start)
    terms = [term for term in found.state.terms if not term.prior]
    sensitivity = {"acc": 1.0 + found.state.gain["acc"]}
    return predict(table(other, 2), terms, sensitivity, {})


def test_the_same_sensor_is_predicted_without_any_change() -> None:
    found = predicted(Sensor(gain=1.02, delay=2e-3, window=3e-3))
    assert found.holds
    assert found.as_is.groups[0].ratio < 1.3
    assert abs(found.levels[0].relative) < 4.0 * found.levels[0].u


@pytest.mark.parametrize("gain", [1.01, -1.01])
def test_a_level_is_told_from_the_shape_whatever_the_sign(gain: float) -> None:
    found = predicted(Sensor(gain=gain, delay=2e-3, window=3e-3))
    assert found.holds
    assert found.levels[0].relative == pytest.approx(1.01 / 1.02 - 1.0, abs=4.0 * found.levels[0].u)
    assert found.as_is.groups[0].error > 3.0 * found.levelled.groups[0].error


def test_another_shape_is_not_explained_by_a_level() -> None:
    found = predicted(Sensor(gain=1.02, delay=2e-3, window=3.4e-3))
    assert not found.holds
    assert found.levelled.groups[0].ratio > 3.0
