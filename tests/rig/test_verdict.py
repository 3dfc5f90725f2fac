"""Pass, fail and inconclusive at the limits, and En numbers."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.calibrate.verdict import agrees, normalised_error, verdict
from rig.errors import BadInput


def test_the_whole_interval_inside_passes_outside_fails_and_across_a_limit_is_inconclusive() -> None:
    assert verdict(1.0, 0.1, 0.8, 1.2) == "pass"
    assert verdict(1.15, 0.1, 0.8, 1.2) == "inconclusive"
    assert verdict(1.25, 0.1, 0.8, 1.2) == "inconclusive"
    assert verdict(1.31, 0.1, 0.8, 1.2) == "fail"
    assert verdict(0.69, 0.1, 0.8, 1.2) == "fail"


def test_an_uncertainty_wider_than_the_limits_never_passes() -> None:
    assert verdict(1.0, 0.3, 0.8, 1.2) == "inconclusive"


def test_a_limit_may_stand_alone() -> None:
    assert verdict(-1e9, 1.0, high=0.0) == "pass"
    assert verdict(0.5, 1.0, high=0.0) == "inconclusive"
    assert verdict(2.0, 1.0, low=3.5) == "fail"


@given(st.floats(-5, 5), st.floats(0, 3), st.floats(0, 3))
def test_a_larger_uncertainty_never_turns_into_a_pass_or_a_fail(value: float, expanded: float, more: float) -> None:
    wide = verdict(value, expanded + more, -1.0, 1.0)
    assert wide in (verdict(value, expanded, -1.0, 1.0), "inconclusive")


def test_without_a_limit_or_with_numbers_that_cannot_be_compared_there_is_no_verdict() -> None:
    for arguments in ((1.0, 0.1, None, None), (1.0, 0.1, 2.0, 1.0), (math.nan, 0.1, 0.0, 1.0), (1.0, -0.1, 0.0, 1.0)):
        with pytest.raises(BadInput):
            verdict(*arguments)


def test_en_is_the_difference_in_units_of_its_expanded_uncertainty() -> None:
    assert normalised_error(10.0, 3.0, 5.0, 4.0) == pytest.approx(1.0)
    assert agrees(normalised_error(5.0, 4.0, 10.0, 3.0))
    assert not agrees(normalised_error(5.0, 4.0, 10.01, 3.0))


def test_a_shared_reference_makes_the_comparison_sharper() -> None:
    assert normalised_error(10.0, 3.0, 5.0, 4.0, 0.5) == pytest.approx(5 / math.sqrt(13))
    with pytest.raises(BadInput, match="without uncertainty"):
        normalised_error(1.0, 2.0, 1.1, 2.0, 1.0)
