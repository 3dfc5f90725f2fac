"""Gravity tumble: a triad of accelerometers held still in many poses, calibrated by gravity.

    volts = offsets + matrix · f,     matrix = diag(sensitivities) · axes,     f = gravity · up  (at rest)

Each row of `axes` is the unit vector of one sensitive axis. `fit_magnitude` needs no knowledge of the poses, only that
the specific force is gravity in each of them; it finds the nine intrinsic quantities: three sensitivities, three
offsets, and the angles between the axes. `fit_directions` needs the direction of up in each pose and finds all twelve,
so also how the triad sits in its case. Skog, Händel, Proc. IMEKO (2006); IEEE Std 1293-2018 annex on multi-point tests.

The frame of the nine-parameter triad is its own: x along the sensitive axis x, y in the plane of the sensitive axes x
and y, so `matrix` is lower triangular with a positive diagonal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.calibrate.budget import propagate
from rig.errors import BadInput
from rig.signals.line import gls

Floats = NDArray[np.float64]

PAIRS = ((0, 1), (0, 2), (1, 2))
NAMES = (
    *("sensitivity x", "sensitivity y", "sensitivity z"),
    *("offset x", "offset y", "offset z"),
    *("angle xy", "angle xz", "angle yz"),
)
# Poses spread evenly over the sphere give 0.26; below this a parameter is five times worse determined than it could be.
WEAKEST = 0.05
ITERATIONS = 100


@dataclass(frozen=True)
class Triad:
    """Intrinsic quantities: sensitivities (3,) V/(m/s²), offsets (3,) V, angles xy, xz, yz between the axes (3,) rad.

    `covariance` (9, 9) is in the order of `NAMES` and contains the common share of gravity.
    """

    sensitivities: Floats
    offsets: Floats
    angles: Floats
    covariance: Floats
    chi2: float
    dof: int

    @property
    def parameters(self) -> Floats:
        """All nine in the order of `NAMES`, shape (9,)."""
        return np.concatenate([self.sensitivities, self.offsets, self.angles])

    @property
    def u(self) -> Floats:
        """Standard uncertainties in the order of `NAMES`, shape (9,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def matrix(self) -> Floats:
        """Volts per m/s² in the triad's own frame, lower triangular, shape (3, 3)."""
        return np.asarray(self.sensitivities[:, None] * np.linalg.cholesky(_gram(self.angles)), float)

    def specific_force(self, volts: ArrayLike) -> Floats:
        """Specific force in m/s² in the triad's own frame, from volts (n, 3); shape (n, 3)."""
        return np.asarray(np.linalg.solve(self.matrix, (np.asarray(volts, float) - self.offsets).T).T, float)


@dataclass(frozen=True)
class Directions:
    """Matrix (c, 3) V/(m/s²) from the frame of the poses, offsets (c,) V, of c channels: three are a triad.

    `covariance` (4c, 4c) has each channel's row of the matrix followed by its offset, and gravity's common share.
    `by_readings` (c, 4, n, c) are the derivatives of these parameters by the readings.
    """

    matrix: Floats
    offsets: Floats
    covariance: Floats
    chi2: float
    dof: int
    by_readings: Floats

    @property
    def own_axes(self) -> Floats:
        """Derivatives of the sensitivities along the channels' own axes by the readings, (c, n, c)."""
        units = self.matrix / np.linalg.norm(self.matrix, axis=1)[:, None]
        return np.asarray(np.einsum("kj,kjnc->knc", units, self.by_readings[:, :3]))

    @property
    def sizes(self) -> tuple[Floats, Floats]:
        """Sensitivity of every channel along its own axis, V/(m/s²), and its standard uncertainty, (c,) each."""
        parameters = np.column_stack([self.matrix, self.offsets]).ravel()
        sizes, covariance = propagate(_sizes, parameters, self.covariance)
        return sizes, np.sqrt(np.diag(covariance))

    @property
    def u_offsets(self) -> Floats:
        """Standard uncertainty of the offsets, V, (c,)."""
        return np.sqrt(np.diag(self.covariance))[3::4]

    @property
    def intrinsic(self) -> Triad:
        """Of a triad the nine quantities that do not depend on the frame, with their covariance (GUM 5.2)."""
        parameters = np.column_stack([self.matrix, self.offsets]).ravel()
        nine, covariance = propagate(_intrinsic, parameters, self.covariance)
        return Triad(nine[:3], nine[3:6], nine[6:], covariance, self.chi2, self.dof)

    def specific_force(self, volts: ArrayLike) -> Floats:
        """Of a triad: specific force in m/s² in the frame of the poses, from volts (n, 3); shape (n, 3)."""
        return np.asarray(np.linalg.solve(self.matrix, (np.asarray(volts, float) - self.offsets).T).T, float)


def fit_magnitude(volts: ArrayLike, gravity: float, u_gravity: float, u_volts: ArrayLike) -> Triad:
    """Nine intrinsic parameters from the magnitude of gravity alone.

    `volts` (n, 3), one pose a row, each the mean of a record at rest; `gravity` the local value in m/s² with its
    standard uncertainty `u_gravity`; `u_volts` in V, a number, (3,) or (n, 3), independent between poses and channels.
    Starts from the ellipsoid that linear least squares fits, then Gauss–Newton with the readings adjusted along with
    the parameters. A bias of about 2.5·(noise/gravity)² of the sensitivities remains, 3e-6 for 1 mg.
    Raises BadInput for fewer than nine poses, for poses that leave parameters undetermined (it names them and says
    which poses are missing), and for readings that are not those of a triad at rest.
    """
    volts, sigma = _readings(volts, u_volts)
    _check_gravity(gravity, u_gravity)
    if len(volts) < 9:
        raise BadInput(f"tumble: found {len(volts)} poses, wanted at least 9 for nine parameters; add tilted ones")
    parameters, read = _ellipsoid(volts, gravity), volts
    for _ in range(ITERATIONS):
        magnitude, by_parameter, by_volt = _magnitude(read, parameters)
        left = gravity - magnitude - np.sum(by_volt * (volts - read), axis=1)
        variance = np.sum((by_volt * sigma) ** 2, axis=1)
        step = gls(by_parameter, left, variance, NAMES)
        parameters = parameters + step.parameters
        _check_triad(parameters)
        if np.max(np.abs(step.parameters) / step.u) < 1e-7:
            check_spread(_directions(volts, parameters))
            covariance = step.covariance + _common(np.r_[parameters[:3], np.zeros(6)], u_gravity / gravity)
            return Triad(parameters[:3], parameters[3:6], parameters[6:], covariance, step.chi2, step.dof)
        multiplier = (left - by_parameter @ step.parameters) / variance
        read = volts + sigma**2 * by_volt * multiplier[:, None]
    raise BadInput("tumble: found no triad that fits, wanted readings at rest in each pose")


def fit_directions(
    volts: ArrayLike, up: ArrayLike, gravity: float, u_gravity: float, u_volts: ArrayLike, u_up: float = 0.0
) -> Directions:
    """Four parameters of each channel, twelve of a triad, from poses with known direction of up.

    `volts` (n, c); `up` (n, 3) unit vectors in the frame of the case; `u_up` in rad is the standard uncertainty of each
    pose about any axis, independent between poses: it moves the channels together. The rest as for
    `fit_magnitude`. A constant rotation of the frame itself is not seen here; it adds to the alignment of the axes and
    leaves the intrinsic quantities alone. Raises BadInput for fewer than four poses, directions that are no unit
    vectors, or poses that leave a column undetermined.
    """
    volts, sigma = _readings(volts, u_volts, None)
    count = volts.shape[1]
    up = _unit_vectors(up, len(volts))
    _check_gravity(gravity, u_gravity)
    columns = np.column_stack([gravity * up, np.ones(len(up))])
    _check_columns(np.column_stack([up, np.ones(len(up))]))
    design = np.einsum("nc,ij->nijc", columns, np.eye(count)).reshape(-1, 4 * count)
    matrix, previous = np.zeros((count, 3)), np.full(4 * count, math.inf)
    for _ in range(ITERATIONS):
        factor = np.linalg.cholesky(_pose_covariance(matrix, up, sigma, gravity * u_up))
        shaped = design.reshape(-1, count, 4 * count)
        white = np.linalg.solve(factor, np.concatenate([shaped, volts[:, :, None]], axis=2))
        flat = white.reshape(-1, 4 * count + 1)
        solution = gls(flat[:, :-1], flat[:, -1], np.ones(len(flat)))
        block = solution.parameters.reshape(count, 4)
        matrix, moved = block[:, :3], np.abs(solution.parameters - previous) / solution.u
        previous = solution.parameters
        if u_up == 0 or np.max(moved) < 1e-7:
            scaled = np.column_stack([matrix, np.zeros(count)]).ravel()
            covariance = solution.covariance + _common(scaled, u_gravity / gravity)
            weights = (solution.covariance @ flat[:, :-1].T).reshape(count, 4, len(up), count)
            weights = np.einsum("kpni,nij->kpnj", weights, np.linalg.inv(factor))
            return Directions(matrix, block[:, 3], covariance, solution.chi2, solution.dof, weights)
    raise BadInput("tumble: found no triad that fits, wanted readings at rest in the stated poses")


def _magnitude(volts: Floats, parameters: Floats) -> tuple[Floats, Floats, Floats]:
    """|f| (n,) and its derivatives by the nine parameters (n, 9) and by the three readings (n, 3).

    With a = (V - b)/s and the matrix C of the cosines between the axes, |f|² = aᵀ C⁻¹ a.
    """
    sensitivities, offsets, angles = parameters[:3], parameters[3:6], parameters[6:]
    a = (volts - offsets) / sensitivities
    w = np.linalg.solve(_gram(angles), a.T).T
    magnitude = np.sqrt(np.sum(a * w, axis=1))
    unit = w / magnitude[:, None]
    by_volt = unit / sensitivities
    by_angle = np.column_stack(
        [unit[:, i] * w[:, j] * math.sin(angle) for (i, j), angle in zip(PAIRS, angles, strict=True)]
    )
    return magnitude, np.column_stack([-by_volt * a, -by_volt, by_angle]), by_volt


def _gram(angles: Floats) -> Floats:
    """Cosines between the axes, shape (3, 3)."""
    matrix = np.eye(3)
    for (i, j), angle in zip(PAIRS, angles, strict=True):
        matrix[i, j] = matrix[j, i] = math.cos(angle)
    return matrix


def _ellipsoid(volts: Floats, gravity: float) -> Floats:
    """Start: the quadric through the readings by linear least squares, turned into the nine parameters."""
    middle, half = (volts.max(axis=0) + volts.min(axis=0)) / 2, np.ptp(volts, axis=0) / 2
    if not np.all(half > 0):
        raise BadInput(f"tumble: found no change of {_axes_of(half <= 0)}, wanted poses with each axis up and down")
    a = (volts - middle) / half
    check_spread(a / np.linalg.norm(a, axis=1)[:, None])
    products = np.column_stack([2 * a[:, i] * a[:, j] for i, j in PAIRS])
    quadric = gls(np.column_stack([a**2, products, 2 * a]), np.ones(len(a)), np.ones(len(a)), NAMES).parameters
    shape = np.diag(quadric[:3])
    for (i, j), value in zip(PAIRS, quadric[3:6], strict=True):
        shape[i, j] = shape[j, i] = value
    centre = -np.linalg.solve(shape, quadric[6:])
    inverse = np.linalg.inv(shape) * (1 + float(centre @ shape @ centre))
    if np.min(np.linalg.eigvalsh(inverse)) <= 0:
        raise BadInput("tumble: found readings that lie on no ellipsoid, wanted a triad at rest in each pose")
    size = np.sqrt(np.diag(inverse))
    angles = [math.acos(inverse[i, j] / (size[i] * size[j])) for i, j in PAIRS]
    return np.concatenate([size * half / gravity, middle + half * centre, angles])


def _directions(volts: Floats, parameters: Floats) -> Floats:
    """Unit vectors of up in the triad's own frame, shape (n, 3)."""
    a = (volts - parameters[3:6]) / parameters[:3]
    force = np.linalg.solve(np.linalg.cholesky(_gram(parameters[6:])), a.T).T
    return np.asarray(force / np.linalg.norm(force, axis=1)[:, None], float)


def check_spread(up: Floats) -> None:
    """Refuse poses that leave one of the nine parameters, each in units of gravity, undetermined."""
    design = np.column_stack([up**2, up, *(up[:, i] * up[:, j] for i, j in PAIRS)]) / math.sqrt(len(up))
    weak = _weak(design)
    if not np.any(weak):
        return
    names = [name for name, is_weak in zip(NAMES, weak, strict=True) if is_weak]
    tilted = [name[-2:] for name in names if name.startswith("angle")]
    axes = sorted({name[-1] for name in names if not name.startswith("angle")})
    wanted = [f"poses tilted half way between {pair[0]} and {pair[1]}" for pair in tilted]
    wanted += [f"poses with {axis} up, {axis} down and {axis} level" for axis in axes]
    raise BadInput(f"tumble: found poses that leave {', '.join(names)} undetermined, wanted {', '.join(wanted)}")


def _check_columns(columns: Floats) -> None:
    weak = _weak(columns / math.sqrt(len(columns)))
    if len(columns) < 4 or np.any(weak):
        names = [name for name, is_weak in zip(("x", "y", "z", "offset"), weak, strict=True) if is_weak]
        what = ", ".join(names) or "the offset"
        raise BadInput(
            f"tumble: found {len(columns)} poses that leave {what} undetermined, wanted each axis up and down"
        )


def _weak(design: Floats) -> NDArray[np.bool_]:
    """Which columns take part in a combination that the rows hardly determine."""
    _, size, right = np.linalg.svd(design, full_matrices=True)
    full = np.zeros(design.shape[1])
    full[: len(size)] = size
    part = np.abs(right[full < WEAKEST])
    return np.asarray(np.any(part > 0.3, axis=0), bool)


def _pose_covariance(matrix: Floats, up: Floats, sigma: Floats, turned: float) -> Floats:
    """Covariance of the readings of each pose, shape (n, c, c): noise, and each pose turned about any axis.

    A small turn δ moves up by δ × up, so the readings by matrix·(δ × up): covariance matrix·(1 - up upᵀ)·matrixᵀ.
    """
    across = np.eye(3) - up[:, :, None] * up[:, None, :]
    noise = sigma[:, :, None] ** 2 * np.eye(len(matrix))
    return np.asarray(noise + turned**2 * (matrix @ across @ matrix.T), float)


def _sizes(parameters: Floats) -> Floats:
    return np.asarray(np.linalg.norm(parameters.reshape(-1, 4)[:, :3], axis=1))


def _intrinsic(parameters: Floats) -> Floats:
    block = parameters.reshape(3, 4)
    size = np.linalg.norm(block[:, :3], axis=1)
    axes = block[:, :3] / size[:, None]
    angles = [math.acos(float(axes[i] @ axes[j])) for i, j in PAIRS]
    return np.concatenate([size, block[:, 3], angles])


def _common(scaled: Floats, relative: float) -> Floats:
    """What gravity's error does to all sensitivities at once: each is too small by the same fraction."""
    return np.asarray(relative**2 * np.outer(scaled, scaled), float)


def _readings(volts: ArrayLike, u_volts: ArrayLike, channels: int | None = 3) -> tuple[Floats, Floats]:
    values, sigma = np.asarray(volts, float), np.asarray(u_volts, float)
    if values.ndim != 2 or channels not in (None, values.shape[1]) or not np.all(np.isfinite(values)):
        wanted = f"(n, {channels or 'channels'}) finite numbers, one pose a row"
        raise BadInput(f"tumble: found readings of shape {values.shape}, wanted {wanted}")
    shapes = ((), values.shape[1:], values.shape)
    if sigma.shape not in shapes or not np.all(sigma > 0) or not np.all(np.isfinite(sigma)):
        wanted = f"a number, {shapes[1]} or {shapes[2]}, above 0"
        raise BadInput(f"tumble: found u_volts of shape {sigma.shape}, wanted {wanted}")
    return values, np.broadcast_to(sigma, values.shape)


def _unit_vectors(up: ArrayLike, count: int) -> Floats:
    vectors = np.asarray(up, float)
    if vectors.shape != (count, 3):
        raise BadInput(f"tumble: found directions of shape {vectors.shape}, wanted {(count, 3)}")
    if not np.allclose(np.linalg.norm(vectors, axis=1), 1, rtol=0, atol=1e-6):
        raise BadInput("tumble: found directions that are no unit vectors, wanted length 1")
    return vectors


def _check_gravity(gravity: float, u_gravity: float) -> None:
    if not (9.7 < gravity < 9.9 and 0 <= u_gravity < 0.1):
        raise BadInput(f"gravity: found {gravity} with u = {u_gravity}, wanted the local value in m/s²")


def _check_triad(parameters: Floats) -> None:
    if not np.all(parameters[:3] > 0) or np.min(np.linalg.eigvalsh(_gram(parameters[6:]))) <= 1e-6:
        raise BadInput("tumble: found readings that no triad gives, wanted a triad at rest in each pose")


def _axes_of(chosen: NDArray[np.bool_]) -> str:
    return ", ".join(axis for axis, is_chosen in zip("xyz", chosen, strict=True) if is_chosen)
