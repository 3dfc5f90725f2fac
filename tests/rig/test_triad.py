"""A known triad is turned about in gravity, and comes back within its stated uncertainty."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.calibrate.triad import fit_directions, fit_magnitude
from rig.errors import BadInput

Floats = NDArray[np.float64]

GRAVITY = 9.8123
OFFSETS = np.array([1.65, 1.60, 1.72])
MATRIX = np.array([[0.0308, 4e-4, -2e-4], [-5e-4, 0.0305, 3e-4], [2e-4, 6e-4, 0.0297]])
NOISE = 3e-5  # V, about 0.1 mg


def truth() -> Floats:
    size = np.linalg.norm(MATRIX, axis=1)
    axes = MATRIX / size[:, None]
    return np.r_[size, OFFSETS, np.arccos([axes[0] @ axes[1], axes[0] @ axes[2], axes[1] @ axes[2]])]


def cardinal() -> Floats:
    return np.vstack([np.eye(3), -np.eye(3)])


def poses() -> Floats:
    """Six faces up, and the twelve edges up."""
    edges = [np.roll([a, b, 0.0], shift) / np.sqrt(2) for shift in range(3) for a in (1.0, -1.0) for b in (1.0, -1.0)]
    return np.vstack([cardinal(), edges])


def read(up: Floats, rng: np.random.Generator, gravity: float = GRAVITY, noise: float = NOISE) -> Floats:
    return gravity * up @ MATRIX.T + OFFSETS + noise * rng.standard_normal(up.shape)


def test_nine_parameters_come_back_within_their_uncertainty_over_many_seeds() -> None:
    errors, chi2 = [], []
    for seed in range(200):
        fit = fit_magnitude(read(poses(), np.random.default_rng(seed)), GRAVITY, 0.0, NOISE)
        errors.append((fit.parameters - truth()) / fit.u)
        chi2.append(fit.chi2 / fit.dof)
    assert np.std(errors, axis=0) == pytest.approx(np.ones(9), abs=0.16)  # 3.2 sigma of a standard deviation of 200
    assert np.abs(np.mean(errors, axis=0)).max() < 4 / np.sqrt(200)
    assert np.mean(chi2) == pytest.approx(1, abs=0.11)


def test_an_exact_triad_comes_back_exactly() -> None:
    fit = fit_magnitude(read(poses(), np.random.default_rng(0), noise=0.0), GRAVITY, 0.0, NOISE)
    assert fit.parameters == pytest.approx(truth(), rel=1e-10)
    force = fit.specific_force(read(poses(), np.random.default_rng(0), noise=0.0))
    assert np.linalg.norm(force, axis=1) == pytest.approx(np.full(18, GRAVITY), rel=1e-10)


def test_the_matrix_of_the_nine_parameters_is_lower_triangular_and_has_the_rows_lengths_and_angles() -> None:
    matrix = fit_magnitude(read(poses(), np.random.default_rng(0), noise=0.0), GRAVITY, 0.0, NOISE).matrix
    assert np.triu(matrix, 1) == pytest.approx(np.zeros((3, 3)))
    assert matrix @ matrix.T == pytest.approx(MATRIX @ MATRIX.T, rel=1e-9)


def test_twelve_parameters_come_back_within_their_uncertainty_with_poses_set_imperfectly() -> None:
    errors, turned = [], 2e-3
    wanted = np.column_stack([MATRIX, OFFSETS]).ravel()
    for seed in range(200):
        rng = np.random.default_rng(seed)
        up = poses()
        real = up + np.cross(turned * rng.standard_normal(up.shape), up)
        real /= np.linalg.norm(real, axis=1)[:, None]
        fit = fit_directions(read(real, rng), up, GRAVITY, 0.0, NOISE, u_up=turned)
        found = np.column_stack([fit.matrix, fit.offsets]).ravel()
        errors.append((found - wanted) / np.sqrt(np.diag(fit.covariance)))
    assert np.std(errors, axis=0) == pytest.approx(np.ones(12), abs=0.18)
    assert np.abs(np.mean(errors, axis=0)).max() < 4 / np.sqrt(200)


def test_both_ways_agree_on_the_intrinsic_quantities() -> None:
    volts = read(poses(), np.random.default_rng(5))
    nine = fit_magnitude(volts, GRAVITY, 0.0, NOISE)
    twelve = fit_directions(volts, poses(), GRAVITY, 0.0, NOISE).intrinsic
    # The same readings, so the twelve-parameter result, which knows more, differs by var(nine) - var(twelve).
    spread = np.sqrt(np.maximum(nine.u**2 - twelve.u**2, 0) + 1e-3 * nine.u**2)
    assert np.abs((nine.parameters - twelve.parameters) / spread).max() < 4
    assert np.all(twelve.u <= nine.u * 1.001)


def test_an_error_of_gravity_moves_all_sensitivities_together_as_stated() -> None:
    volts = read(poses(), np.random.default_rng(1), gravity=GRAVITY * (1 + 1e-4), noise=0.0)
    for fit in (
        fit_magnitude(volts, GRAVITY, 1e-4 * GRAVITY, 1e-9),
        fit_directions(volts, poses(), GRAVITY, 1e-4 * GRAVITY, 1e-9).intrinsic,
    ):
        assert fit.sensitivities / truth()[:3] - 1 == pytest.approx(np.full(3, 1e-4), rel=1e-3)
        assert fit.u[:3] / fit.sensitivities == pytest.approx(np.full(3, 1e-4), rel=1e-3)
        correlation = fit.covariance[:3, :3] / np.outer(fit.u[:3], fit.u[:3])
        assert correlation == pytest.approx(np.ones((3, 3)), abs=1e-6)
        assert fit.offsets == pytest.approx(OFFSETS, rel=1e-9)


def test_six_poses_are_too_few_for_nine_parameters() -> None:
    with pytest.raises(BadInput, match=r"found 6 poses, wanted at least 9"):
        fit_magnitude(read(cardinal(), np.random.default_rng(0)), GRAVITY, 0.0, NOISE)


def test_six_faces_read_twice_say_nothing_about_the_angles_and_the_refusal_says_so() -> None:
    up = np.vstack([cardinal(), cardinal()])
    with pytest.raises(BadInput, match=r"angle xy, angle xz, angle yz undetermined.*half way between x and y"):
        fit_magnitude(read(up, np.random.default_rng(0)), GRAVITY, 0.0, NOISE)


def test_poses_without_a_tilt_between_y_and_z_leave_that_angle() -> None:
    up = poses()
    up = up[~((np.abs(up[:, 1]) > 0.5) & (np.abs(up[:, 2]) > 0.5))]
    with pytest.raises(BadInput, match=r"leave angle yz undetermined, wanted poses tilted half way between y and z$"):
        fit_magnitude(read(up, np.random.default_rng(0)), GRAVITY, 0.0, NOISE)


def test_twelve_parameters_need_each_axis_up_and_down() -> None:
    up = np.vstack([np.eye(3), np.eye(3)])
    with pytest.raises(BadInput, match="undetermined"):
        fit_directions(read(up, np.random.default_rng(0)), up, GRAVITY, 0.0, NOISE)
    with pytest.raises(BadInput, match="unit vectors"):
        fit_directions(read(up, np.random.default_rng(0)), 2 * up, GRAVITY, 0.0, NOISE)


def test_gravity_in_units_of_g_is_refused() -> None:
    with pytest.raises(BadInput, match="gravity: found 1"):
        fit_magnitude(read(poses(), np.random.default_rng(0)), 1.0, 0.0, NOISE)


def test_noise_of_a_tenth_of_gravity_still_settles_with_a_bias_of_the_order_of_its_square() -> None:
    noise = 0.1 * GRAVITY * 0.03
    found = [
        fit_magnitude(read(poses(), np.random.default_rng(seed), noise=noise), GRAVITY, 0.0, noise).sensitivities
        for seed in range(100)
    ]
    assert np.abs(np.mean(found, axis=0) / truth()[:3] - 1).max() < 4 * 0.1**2
