"""The budget against the printed examples of the GUM and its Supplement 1, and against the library GTC."""

from __future__ import annotations

import math
import tracemalloc

import GTC
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rig.calibrate.budget import (
    Budget,
    Contribution,
    Draw,
    coverage_factor,
    derivatives,
    from_expanded,
    half_width,
    monte_carlo,
    propagate,
    tolerance,
    validated,
)
from rig.errors import BadInput

Floats = NDArray[np.float64]

# GUM Table H.2: five sets of V (V), I (A), φ (rad)
SETS = np.array(
    [
        [5.007, 4.994, 5.005, 4.990, 4.999],
        [19.663e-3, 19.639e-3, 19.640e-3, 19.685e-3, 19.678e-3],
        [1.0456, 1.0438, 1.0468, 1.0428, 1.0433],
    ]
)


def impedance(x: Floats) -> Floats:
    """R, X and Z from V, I and φ."""
    return np.stack([x[0] / x[1] * np.cos(x[2]), x[0] / x[1] * np.sin(x[2]), x[0] / x[1]])


def correlations(covariance: Floats) -> Floats:
    u = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(u, u))


def printed(values: Floats, digits: int) -> list[str]:
    return [f"{value:.{digits}f}" for value in values]


def test_gum_h2_the_means_of_the_five_sets_are_those_of_table_h2() -> None:
    covariance = np.cov(SETS) / 5
    u = np.sqrt(np.diag(covariance))
    r = correlations(covariance)
    assert (f"{SETS[0].mean():.4f}", f"{SETS[1].mean() * 1e3:.4f}", f"{SETS[2].mean():.5f}") == (
        "4.9990",
        "19.6610",
        "1.04446",
    )
    assert (f"{u[0]:.4f}", f"{u[1] * 1e3:.4f}", f"{u[2]:.5f}") == ("0.0032", "0.0095", "0.00075")
    assert printed(np.array([r[0, 1], r[0, 2], r[1, 2]]), 2) == ["-0.36", "0.86", "-0.65"]


def test_gum_h2_approach_1_gives_table_h3() -> None:
    y, covariance = propagate(impedance, SETS.mean(axis=1), np.cov(SETS) / 5)
    r = correlations(covariance)
    assert printed(y, 3) == ["127.732", "219.847", "254.260"]
    u = np.sqrt(np.diag(covariance))
    assert [f"{u[0]:.3f}", f"{u[2]:.3f}"] == ["0.071", "0.236"]
    # Table H.3 prints 0.295 for u(X), but Table H.2 gives 0.29558 to first order, in GTC too; H.4 is 0.29549.
    assert f"{u[1]:.4f}" == "0.2956"
    assert printed(np.array([r[0, 1], r[0, 2], r[1, 2]]), 3) == ["-0.588", "-0.485", "0.993"]


def test_gum_h2_approach_2_gives_every_digit_of_table_h4() -> None:
    each = impedance(SETS)
    covariance = np.cov(each) / 5
    r = correlations(covariance)
    assert printed(each[0], 2) == ["127.67", "127.89", "127.51", "127.71", "127.88"]
    assert printed(each[1], 2) == ["220.32", "219.79", "220.64", "218.97", "219.51"]
    assert printed(each[2], 2) == ["254.64", "254.29", "254.84", "253.49", "254.04"]
    assert printed(each.mean(axis=1), 3) == ["127.732", "219.847", "254.260"]
    assert printed(np.sqrt(np.diag(covariance)), 3) == ["0.071", "0.295", "0.236"]
    assert printed(np.array([r[0, 1], r[0, 2], r[1, 2]]), 3) == ["-0.588", "-0.485", "0.993"]


def test_gum_h2_agrees_with_gtc_in_value_uncertainty_and_degrees_of_freedom() -> None:
    v, i, phi = GTC.type_a.multi_estimate_real(SETS.tolist(), labels=["V", "I", "phi"])
    values, covariance = SETS.mean(axis=1), np.cov(SETS) / 5
    y, found = propagate(impedance, values, covariance)
    slopes = derivatives(impedance, values, np.sqrt(np.diag(covariance)))
    r = correlations(covariance)
    for row, wanted in enumerate((v / i * GTC.cos(phi), v / i * GTC.sin(phi), v / i)):
        budget = Budget(
            tuple(
                Contribution(name, "A", "t", math.sqrt(covariance[k, k]), "", slopes[row, k], dof=4)
                for k, name in enumerate(("V", "I", "phi"))
            ),
            {("V", "I"): r[0, 1], ("V", "phi"): r[0, 2], ("I", "phi"): r[1, 2]},
        )
        assert y[row] == pytest.approx(wanted.x, rel=1e-12)
        assert math.sqrt(found[row, row]) == pytest.approx(wanted.u, rel=1e-9)
        assert budget.u == pytest.approx(wanted.u, rel=1e-9)
        assert budget.dof == pytest.approx(wanted.df, rel=1e-9)
        assert sum(budget.shares().values()) == pytest.approx(1)


def end_gauge() -> Budget:
    """GUM H.1, lengths in nm."""
    length, expansion, away = 50_000_623.0, 11.5e-6, -0.1
    return Budget(
        (
            Contribution("standard", "B", "t", from_expanded(75, 3), "nm", 1.0, dof=18),
            Contribution("repeated observations", "A", "t", 5.8, "nm", 1.0, dof=24),
            Contribution("comparator, random", "B", "t", 3.9, "nm", 1.0, dof=5),
            Contribution("comparator, systematic", "B", "t", 6.7, "nm", 1.0, dof=8),
            Contribution("expansion", "B", "rectangular", half_width(2e-6, "rectangular"), "1/°C", 0.0),
            Contribution("temperature", "B", "arcsine", 0.41, "°C", 0.0),
            Contribution(
                "difference of expansion",
                "B",
                "rectangular",
                half_width(1e-6, "rectangular"),
                "1/°C",
                -length * away,
                50,
            ),
            Contribution(
                "difference of temperature",
                "B",
                "rectangular",
                half_width(0.05, "rectangular"),
                "°C",
                -length * expansion,
                2,
            ),
        )
    )


def test_gum_h1_end_gauge_has_u_32_nm_16_degrees_of_freedom_and_u99_93_nm() -> None:
    budget = end_gauge()
    parts = {contribution.name: contribution.contribution for contribution in budget.contributions}
    assert f"{parts['difference of expansion']:.1f}" == "2.9"
    assert f"{parts['difference of temperature']:.1f}" == "16.6"
    assert round(budget.u) == 32
    assert math.floor(budget.dof) == 16
    assert f"{budget.coverage_factor(0.99):.2f}" == "2.92"
    assert budget.expanded(0.99) == pytest.approx(budget.coverage_factor(0.99) * budget.u)
    assert round(budget.coverage_factor(0.99) * round(budget.u)) == 93  # the GUM multiplies the rounded 32 nm


def test_gum_h1_agrees_with_gtc() -> None:
    budget = end_gauge()
    total = sum(GTC.ureal(0, c.u, c.dof) * c.sensitivity for c in budget.contributions if c.sensitivity != 0)
    assert budget.u == pytest.approx(total.u, rel=1e-12)
    assert budget.dof == pytest.approx(total.df, rel=1e-9)


def test_the_coverage_factors_are_those_of_gum_table_g2() -> None:
    table = {1: (12.71, 63.66), 2: (4.30, 9.92), 3: (3.18, 5.84), 4: (2.78, 4.60), 5: (2.57, 4.03), 10: (2.23, 3.17)}
    table |= {16: (2.12, 2.92), 20: (2.09, 2.85), 50: (2.01, 2.68), math.inf: (1.960, 2.576)}
    for dof, (p95, p99) in table.items():
        assert coverage_factor(dof, 0.95) == pytest.approx(p95, abs=0.0051)
        assert coverage_factor(dof, 0.99) == pytest.approx(p99, abs=0.0051)
    assert f"{coverage_factor(math.inf):.6f}" == "1.959964"
    assert coverage_factor(16.9) == coverage_factor(16)


def test_limits_become_standard_uncertainties() -> None:
    assert half_width(1, "rectangular") == pytest.approx(1 / math.sqrt(3))
    assert half_width(1, "triangular") == pytest.approx(1 / math.sqrt(6))
    assert half_width(1, "arcsine") == pytest.approx(1 / math.sqrt(2))
    assert from_expanded(0.01, 2) == pytest.approx(0.005)
    with pytest.raises(BadInput, match="normal"):
        half_width(1, "normal")


@given(st.lists(st.floats(0.01, 100), min_size=2, max_size=6), st.floats(-0.9, 0.9), st.integers(1, 50))
def test_shares_sum_to_one_and_the_variance_is_the_quadratic_form(us: list[float], r: float, dof: int) -> None:
    parts = tuple(Contribution(f"c{k}", "A", "t", u, "1", (-1.0) ** k, dof) for k, u in enumerate(us))
    budget = Budget(parts, {("c0", "c1"): r})
    assert budget.u**2 == pytest.approx(sum(u**2 for u in us) - 2 * r * us[0] * us[1], rel=1e-9)
    assert sum(budget.shares().values()) == pytest.approx(1)
    assert dof * (1 - 1e-9) <= budget.dof <= dof * len(us) * (1 + 1e-9)


def test_two_readings_through_one_gain_cancel_it_in_their_difference() -> None:
    parts = tuple(Contribution(name, "B", "normal", 0.01, "V", c) for name, c in (("first", 1.0), ("second", -1.0)))
    assert Budget(parts, {("second", "first"): 1.0}).u == pytest.approx(0, abs=1e-10)


def test_impossible_budgets_are_refused() -> None:
    parts = tuple(Contribution(name, "B", "normal", 1.0, "V", 1.0) for name in "abc")
    with pytest.raises(BadInput, match="more than once"):
        Budget((parts[0], parts[0]))
    with pytest.raises(BadInput, match="'d'"):
        Budget(parts, {("a", "d"): 0.1})
    with pytest.raises(BadInput, match="eigenvalue"):
        Budget(parts, {("a", "b"): -0.9, ("b", "c"): -0.9, ("a", "c"): -0.9})
    with pytest.raises(BadInput, match="negative"):
        Contribution("a", "B", "normal", -1.0, "V", 1.0)
    with pytest.raises(BadInput, match="at least one"):
        Budget(())


def test_numerical_derivatives_hold_for_large_small_and_zero_values() -> None:
    at, u = np.array([1e9, 1e-9, 0.0, 2.0]), np.array([1e-3, 1e-12, 1e-3, 0.0])

    def function(x: Floats) -> Floats:
        return np.array([x[0] * 3, np.sin(x[1]) * 1e9, np.cos(x[2]) + x[2], np.exp(x[3])])

    found = derivatives(function, at, u)
    assert found == pytest.approx(np.diag([3, 1e9, 1, math.exp(2)]), rel=1e-8, abs=1e-9)


def test_a_given_jacobian_replaces_the_differences_and_shapes_are_checked() -> None:
    y, covariance = propagate(lambda x: x[0] + x[1], [1.0, 2.0], np.diag([9.0, 16.0]), [[1.0, 1.0]])
    assert (y[0], covariance[0, 0]) == (3.0, 25.0)
    with pytest.raises(BadInput, match="jacobian"):
        propagate(lambda x: x[0] + x[1], [1.0, 2.0], np.eye(2), [[1.0]])
    with pytest.raises(BadInput, match="shapes"):
        propagate(lambda x: x[0], [1.0, 2.0], np.eye(3))
    with pytest.raises(BadInput, match="finite"):
        propagate(lambda x: x[0] * math.inf, [1.0], [[1.0]])


def four(distribution: str, last: float = 1.0) -> Budget:
    return Budget(tuple(Contribution(f"x{k}", "B", distribution, last if k == 3 else 1.0, "1", 1.0) for k in range(4)))  # type: ignore[arg-type]


def additive(distribution: str, last: float = 1.0, draws: int = 1_000_000):  # type: ignore[no-untyped-def]
    inputs = [Draw(0.0, last if k == 3 else 1.0, distribution) for k in range(4)]  # type: ignore[arg-type]
    return monte_carlo(lambda x: x.sum(axis=0), inputs, draws=draws)


def test_supplement_1_the_sum_of_four_normal_quantities() -> None:
    result = additive("normal")
    assert result.u == pytest.approx(2.0, abs=0.005)
    assert (result.low, result.high) == pytest.approx((-3.92, 3.92), abs=0.02)
    assert validated(four("normal"), 0.0, result)


def test_supplement_1_the_sum_of_four_rectangular_quantities_has_a_narrower_interval() -> None:
    result = additive("rectangular", draws=4_000_000)  # 3.92 - 3.88 is near the tolerance 0.05
    assert result.mean == pytest.approx(0, abs=0.01)
    assert result.u == pytest.approx(2.0, abs=0.005)
    assert (result.low, result.high) == pytest.approx((-3.88, 3.88), abs=0.015)
    assert result.shortest[1] - result.shortest[0] <= result.high - result.low
    assert validated(four("rectangular"), 0.0, result, digits=2)
    assert not validated(four("rectangular"), 0.0, result, digits=3)


def test_supplement_1_one_dominant_rectangular_quantity_refutes_the_budget() -> None:
    result = additive("rectangular", 10.0)
    assert result.u == pytest.approx(10.1, abs=0.05)
    assert (result.low, result.high) == pytest.approx((-17.0, 17.0), abs=0.05)
    assert four("rectangular", 10.0).expanded() == pytest.approx(19.9, abs=0.05)
    assert not validated(four("rectangular", 10.0), 0.0, result)


def test_draws_have_the_stated_standard_deviation() -> None:
    for distribution in ("normal", "rectangular", "triangular", "arcsine"):
        result = monte_carlo(lambda x: x[0], [Draw(5.0, 0.3, distribution)], draws=200_000)  # type: ignore[arg-type]
        assert (result.mean, result.u) == pytest.approx((5.0, 0.3), rel=5e-3)
    student = monte_carlo(lambda x: x[0], [Draw(0.0, 1.0, "t", dof=4)], draws=400_000)
    assert (student.low, student.high) == pytest.approx((-2.776, 2.776), abs=0.03)


def test_correlated_inputs_are_drawn_correlated_even_when_the_matrix_is_singular() -> None:
    inputs = [Draw(1.0, 0.1), Draw(2.0, 0.1), Draw(0.0, 0.3, "rectangular")]
    matrix = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1.0]])
    result = monte_carlo(lambda x: x[0] - x[1], inputs, draws=10_000, correlation=matrix)
    assert (result.mean, result.u) == pytest.approx((-1.0, 0.0), abs=1e-8)
    with pytest.raises(BadInput, match="rectangular"):
        monte_carlo(lambda x: x[0], inputs[1:], draws=10_000, correlation=[[1, 0.5], [0.5, 1]])


def test_the_same_seed_gives_the_same_numbers_and_a_million_draws_stay_under_100_megabytes() -> None:
    inputs = [Draw(0.0, 1.0, "rectangular")] * 20
    tracemalloc.start()
    first = monte_carlo(lambda x: x.sum(axis=0), inputs, draws=1_000_000, seed=3)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6
    assert first == monte_carlo(lambda x: x.sum(axis=0), inputs, draws=1_000_000, seed=3)


def test_the_numerical_tolerance_is_half_the_last_digit() -> None:
    assert tolerance(0.0754, 2) == pytest.approx(0.0005)  # 75e-3
    assert tolerance(0.0996, 2) == pytest.approx(0.005)  # rounds to 0.10
    assert tolerance(32.0, 1) == pytest.approx(5)


def test_too_few_draws_are_refused() -> None:
    with pytest.raises(BadInput, match="100 draws"):
        monte_carlo(lambda x: x[0], [Draw(0.0, 1.0)], draws=100)


def test_contributions_tied_together_count_as_one_with_the_smallest_degrees_of_freedom() -> None:
    parts = tuple(Contribution(name, "A", "t", 1.0, "V", 1.0, dof) for name, dof in (("a", 3), ("b", 30), ("c", 10)))
    # Variance 3 with 3 degrees of freedom, and 1 with 10, by hand.
    assert Budget(parts, {("a", "b"): 0.5}).dof == pytest.approx(16 / (9 / 3 + 1 / 10))
    assert Budget(parts).dof == pytest.approx(9 / (1 / 3 + 1 / 30 + 1 / 10))
