"""Probabilities of what fits equally well: a shape that the data do not tell is no further number to choose."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.diagnose import search
from rig.fit.parameters import estimates, independent
from rig.model import Term
from rig.shelf import effect_of

MOST = 5.0


def warmed() -> Term:
    return Term(effect_of("warm_up"), "rate", {"shift": 0.05, "time_constant": 300.0})


def test_a_time_constant_that_may_be_any_costs_nothing_and_one_that_is_known_all() -> None:
    assert search.untold(warmed(), {"shift": 1e-3, "time_constant": 3e4}, MOST) == pytest.approx(MOST, abs=0.01)
    assert search.untold(warmed(), {"shift": 1e-3, "time_constant": 1.0}, MOST) == 0.0


def test_it_pays_what_posterior_over_prior_width_says() -> None:
    """By numbers: of a normal prior of the logarithm the share that a normal likelihood of width u keeps."""
    relative, width = 0.4, math.log(600.0 / 60.0) / math.sqrt(12.0)
    x = np.linspace(-20.0 * width, 20.0 * width, 200_001)
    prior = np.exp(-0.5 * (x / width) ** 2) / (width * math.sqrt(2.0 * math.pi))
    kept = float(np.trapezoid(prior * np.exp(-0.5 * (x / relative) ** 2), x))
    paid = MOST - search.untold(warmed(), {"shift": 1e-3, "time_constant": relative * 300.0}, MOST)
    assert paid == pytest.approx(-2.0 * math.log(kept), rel=1e-6)


@given(st.floats(1e-3, 1e6), st.floats(1.01, 10.0))
def test_what_is_less_well_known_pays_less(u: float, factor: float) -> None:
    less, more = (search.untold(warmed(), {"time_constant": one}, MOST) for one in (u, factor * u))
    assert 0.0 <= less <= more <= MOST


def test_an_effect_without_a_shape_has_nothing_back() -> None:
    delay = Term(effect_of("delay"), "acceleration", {"delay": 1e-4})
    assert search.untold(delay, {"delay": 1e-5}, MOST) == 0.0


def test_what_a_test_of_its_own_tells_is_known_with_the_uncertainty_of_that_test() -> None:
    line = Term(effect_of("spur"), "rate", {"amplitude": 1e-3, "frequency": 6.85})
    found = estimates(line, independent(line, {"amplitude": 1e-5, "frequency": 2e-3}))
    assert (found["amplitude"].u, found["frequency"].u) == pytest.approx((1e-5, 2e-3))
