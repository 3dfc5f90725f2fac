"""How close the estimators come to the Cramér–Rao bound: the error of many simulated calibrations ÷ the bound."""

from __future__ import annotations

import numpy as np
import pytest

from rig.line import fit_line

DRAWS = 2000
WORST = 1.05


@pytest.mark.parametrize(("u_x", "u_y"), [(0.0, 0.05), (0.3, 0.05), (0.3, 0.0)])
def test_the_straight_line_is_at_its_cramer_rao_bound(u_x: float, u_y: float) -> None:
    x, slope, intercept = np.linspace(-10.0, 10.0, 50), 0.36, 1.65
    rng = np.random.default_rng(11)
    errors = np.empty((DRAWS, 2))
    for row in errors:
        line = fit_line(
            x + u_x * rng.standard_normal(x.size), intercept + slope * x + u_y * rng.standard_normal(x.size), u_x, u_y
        )
        row[:] = line.slope - slope, line.intercept - intercept
    design = np.column_stack([x, np.ones(x.size)])
    # With the true x unknown as well, eliminating them leaves the variance u_y² + slope²·u_x² per point.
    bound = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * (u_y**2 + slope**2 * u_x**2))
    ratio = np.sqrt(np.mean(errors**2, axis=0)) / bound
    print(f"\nstraight line, u_x = {u_x}, u_y = {u_y}: RMSE/CRB slope {ratio[0]:.3f}, intercept {ratio[1]:.3f}")
    assert np.all(ratio <= WORST)
