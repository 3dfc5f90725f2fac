"""Probabilities of what fits equally well: a shape that the data do not tell is no further number to choose."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.diagnose import search
from rig.diagnose.diagnose import Choice, _weighed
from rig.fit.parameters import estimates, independent
from rig.model import Term
from rig.shelf import effect_of

MOST = 5.0


def warmed() -> Term:
    return Term(effect_of("warm_up"), "rate", {"shift": 0.05, "time_constant": 300.0})


def test_a_time_constant_that_may_be_any_costs_nothing_and_one_that_is_known_all() -> None:
    assert search.refund(warmed(), {"shift": 1e-3, "time_constant": 3e4}, MOST) == pytest.approx(MOST, abs=0.01)
    assert search.refund(warmed(), {"shift": 1e-3, "time_constant": 1.0}, MOST) == 0.0


def test_it_pays_what_posterior_over_prior_width_says() -> None:
    """By numbers: of a normal prior of the logarithm the share that a normal likelihood of width u keeps."""
    relative, width = 0.4, math.log(600.0 / 60.0) / math.sqrt(12.0)
    x = np.linspace(-20.0 * width, 20.0 * width, 200_001)
    prior = np.exp(-0.5 * (x / width) ** 2) / (width * math.sqrt(2.0 * math.pi))
    kept = float(np.trapezoid(prior * np.exp(-0.5 * (x / relative) ** 2), x))
    paid = MOST - search.refund(warmed(), {"shift": 1e-3, "time_constant": relative * 300.0}, MOST)
    assert paid == pytest.approx(-2.0 * math.log(kept), rel=1e-6)


@given(st.floats(1e-3, 1e6), st.floats(1.01, 10.0))
def test_what_is_less_well_known_pays_less(u: float, factor: float) -> None:
    less, more = (search.refund(warmed(), {"time_constant": one}, MOST) for one in (u, factor * u))
    assert 0.0 <= less <= more <= MOST


def test_an_effect_without_a_shape_has_nothing_back() -> None:
    delay = Term(effect_of("delay"), "acceleration", {"delay": 1e-4})
    assert search.refund(delay, {"delay": 1e-5}, MOST) == 0.0


def choice(effect: str, merit: float, refund: float) -> Choice:
    term = Term(effect_of(effect), "rate", {one.name: 1.0 for one in effect_of(effect).coordinates})
    return Choice(term, {}, merit, merit, 0.0, "", refund=refund)


def test_whether_any_is_there_is_not_made_likelier_by_a_refund() -> None:
    (alone,) = _weighed([choice("warm_up", 0.5, 5.0)])
    assert alone.probability == pytest.approx(1.0 / (1.0 + math.exp(-0.25)))


def test_of_two_the_more_probable_comes_first_and_they_share_what_merits_say() -> None:
    first, second = _weighed([choice("temperature_bias", 20.0, 0.0), choice("warm_up", 17.0, 5.0)])
    assert (first.name, second.name) == ("warm_up", "temperature_bias")
    assert first.probability / second.probability == pytest.approx(math.exp(1.0))
    assert first.probability + second.probability == pytest.approx(1.0, abs=1e-3)


def test_what_is_worth_nothing_does_not_come_first_however_little_is_told_of_it() -> None:
    assert [one.name for one in _weighed([choice("warm_up", -1.0, 5.0), choice("temperature_bias", 1.0, 0.0)])] == [
        "temperature_bias", "warm_up",
    ]  # fmt: skip


def test_what_contains_another_pays_for_its_shape() -> None:
    soft = Term(effect_of("soft_saturation"), "rate", {"loss": 0.01, "sharpness": 6.0})
    assert search.refund(soft, {"loss": 1e-3, "sharpness": 1e3}, MOST) == 0.0


def test_what_a_test_of_its_own_tells_is_known_with_the_uncertainty_of_that_test() -> None:
    line = Term(effect_of("spur"), "rate", {"amplitude": 1e-3, "frequency": 6.85})
    found = estimates(line, independent(line, {"amplitude": 1e-5, "frequency": 2e-3}))
    assert (found["amplitude"].u, found["frequency"].u) == pytest.approx((1e-5, 2e-3))
