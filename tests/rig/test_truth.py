"""Found beside true: which entry of a model belongs to what is hidden, and how both are said."""

from __future__ import annotations

from typing import Any

import pytest

from rig.cli import truth
from rig.repair.model_file import Entry, Model, Value
from rig.shelf import shelf

HIDDEN: dict[str, Any] = {
    "name": "warm_up", "stage": "transducer", "quantity": "rate", "d_prime": 31.24,
    "parameters": {"shift": 0.0123456, "time_constant": 240.0},
}  # fmt: skip
FOUND = {"shift": Value(value=0.01241, unit="rad/s", u=2e-4), "time_constant": Value(value=251.0, unit="s", u=9.0)}


def model(**more: Any) -> Model:
    return Model(unit="SIM", effects=(Entry(**{"effect": "warm_up", "on": "rate", "parameters": FOUND, **more}),))


def lines(held: Model | None, hidden: dict[str, Any] = HIDDEN) -> list[str]:
    (one,) = truth.beside([hidden], held, shelf())
    return list(truth.in_words(one, modelled=held is not None))


def test_every_parameter_stands_beside_what_was_found_in_the_same_unit() -> None:
    assert lines(model()) == [
        "warm_up (transducer, rate), d′ 31.2",
        "  shift          true 0.012346 rad/s  found 0.01241 ± 0.0004 rad/s",
        "  time_constant  true 240 s  found 251 ± 18 s",
    ]


@pytest.mark.parametrize("held", [model(on="acceleration"), model(effect="temperature_bias"), Model(unit="SIM")])
def test_what_acts_on_other_channels_or_is_another_effect_was_not_found(held: Model) -> None:
    said = lines(held)
    assert said[1] == "  not in the model"
    assert not any("found" in line for line in said)


def test_without_a_model_only_the_truth_is_told() -> None:
    assert lines(None)[1:] == ["  shift          true 0.012346 rad/s", "  time_constant  true 240 s"]


def test_what_the_model_has_no_word_for_stands_alone() -> None:
    tilt = {"name": "gravity_tilt", "stage": "motion", "quantity": None, "d_prime": 12.0,
            "parameters": {"per_metre": 1.0, "angle": 0.005}}  # fmt: skip
    held = Model(unit="SIM", effects=(Entry(effect="gravity_tilt", parameters={"per_metre": Value(value=1.1)}),))
    assert lines(held, tilt)[1:] == ["  per_metre  true 1 rad/m  found 1.1", "  angle      true 0.005"]


def test_hundreds_are_written_out() -> None:
    one = {"value": 5111.53, "unit": "Hz", "u": 101.2}
    assert truth._estimate(one) == "5110 ± 200 Hz"
