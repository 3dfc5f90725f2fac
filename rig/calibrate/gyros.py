"""Gyros on the turntable: sensitivity, linearity, asymmetry, lag and cross-coupling, against the encoder.

    V = V0 + S·(ω + k2·ω² + k3·ω³ + κ·|ω| − τ·α)

Block means of rest and whole revolutions give S and V0 by generalised least squares. The noise of a gyro is coloured:
its slow wandering between rest and rotation is what limits S. Its covariance between all blocks follows from the
spectrum found at rest, so that blocks which wander together are not counted as independent. The other terms need
spin-up, coast-down and touches (a continuum of rates), κ both senses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Reference
from rig.calibrate.allowances import Misfit, cosine, in_runs, misfit, of_sheet, temperature
from rig.calibrate.budget import Budget, Contribution, half_width
from rig.calibrate.calibration import Result, not_determined
from rig.calibrate.resting import Resting
from rig.errors import BadInput
from rig.parts.reading.revolutions import AXES, Blocks, Rotation
from rig.record import Wires
from rig.signals.line import Solution, gls

Array = NDArray[np.float64]
SENSITIVITY = "V/(rad/s)"
APART = 0.1  # of a speed: another one
PLACE, PLATEN = "place of the sensing element", "tilt of the platter"
WHOLE_BUDGET = frozenset({PLACE, PLATEN})  # lines that a sensitivity from ω²r needs before it may be relied on


@dataclass(frozen=True)
class Setup:
    """What the budgets need beside the blocks.

    `tilt` limit of the angle between sensitive and platter axis (rad), `radius` limit of the radius's error (m),
    `platen` limit of the platter's tilt (rad; None: not declared); `temperature` (mean, lowest, highest, °C);
    `ratiometric` nominal supply (V) of parts whose output follows it, by channel; `drift` declared temperature
    coefficients, 1/K, by channel; `supply` what the cables call it. By channel what the sensor file states: `straight`
    limits of asymmetry and nonlinearity, `off_centre` of the sensing element's place, m.
    """

    time_base: Reference
    tilt: float
    radius: float
    gravity: float
    temperature: tuple[float, float, float] | None
    ratiometric: Mapping[str, float]
    drift: Mapping[str, float]
    supply: str = Wires.supply
    platen: float | None = None
    straight: Mapping[str, tuple[float | None, float | None]] = field(default_factory=dict)
    off_centre: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Rows:
    """Blocks of one or several runs one below the other, for one channel: design pieces and covariances, V².

    `covariance` is that of the noise; `timing` what the uncertain instants of block ends do, for one V/(rad/s).
    """

    volts: Array
    rate: Array
    square: Array
    cube: Array
    acceleration: Array
    force: Array
    run: NDArray[np.int64]
    begin: Array
    end: Array
    covariance: Array
    timing: Array


def rows(
    rotations: Sequence[Rotation], channel: str, noise: Resting, setup: Setup, kinds: Sequence[str], cube_axis: int
) -> Rows:
    """Stack the blocks; rates are about the gyro's own axis (`sense` of the mounting applied)."""
    parts: list[Blocks] = []
    number: list[int] = []
    for place, rotation in enumerate(rotations):
        chosen = [b for b in rotation.blocks if b.kind in kinds and channel in b.volts and len(b.begin)]
        parts += chosen
        number += [place] * len(chosen)
    if not parts:
        raise BadInput(f"{channel}: found no block of {' or '.join(kinds)}, wanted some")
    run = np.concatenate([np.full(len(b.begin), n) for b, n in zip(parts, number, strict=True)])
    covariance = np.zeros((len(run), len(run)))
    begin, end = (np.concatenate([getattr(b, name) for b in parts]) for name in ("begin", "end"))
    for n in np.unique(run):
        mine = np.flatnonzero(run == n)
        covariance[np.ix_(mine, mine)] = noise.slow.covariance(begin[mine], end[mine])
    return Rows(
        volts=np.concatenate([_at_nominal_supply(b, channel, setup) for b in parts]),
        rate=np.concatenate([b.mount.sense * b.rate for b in parts]),
        square=np.concatenate([b.square for b in parts]),
        cube=np.concatenate([b.mount.sense * b.cube for b in parts]),
        acceleration=np.concatenate([b.mount.sense * b.acceleration for b in parts]),
        force=np.concatenate([_force(b, cube_axis, setup.gravity) for b in parts]),
        run=run,
        begin=begin,
        end=end,
        covariance=covariance,
        timing=_timing(parts),
    )


def _at_nominal_supply(blocks: Blocks, channel: str, setup: Setup) -> Array:
    """Volts as they would be at the nominal supply, for a part that is declared ratiometric (the paper's eq. 11)."""
    nominal = setup.ratiometric.get(channel)
    volts = blocks.volts[channel]
    return volts if nominal is None else np.asarray(volts * nominal / blocks.volts[setup.supply])


def _force(blocks: Blocks, cube_axis: int, gravity: float) -> Array:
    mount = blocks.mount
    return mount.force(cube_axis, -blocks.square * mount.radius, blocks.acceleration * mount.radius, gravity)


def _timing(parts: Sequence[Blocks]) -> Array:
    """Covariance of the mean rates of holds, (rad/s)²: neighbours share an uncertain end, with opposite sign."""
    total = np.zeros((sum(len(b.begin) for b in parts),) * 2)
    place = 0
    for b in parts:
        n = len(b.begin)
        size = b.rate / (b.end - b.begin) * b.u_bound
        jacobian = np.zeros((n, n + 1))
        jacobian[np.arange(n), np.arange(n)], jacobian[np.arange(n), np.arange(n) + 1] = size, -size
        total[place : place + n, place : place + n] = jacobian @ jacobian.T
        place += n
    return total


def _offsets(found: Rows) -> tuple[list[Array], list[str]]:
    """One zero output per run: power cycles and mountings shift it."""
    runs = np.unique(found.run)
    return [(found.run == n).astype(float) for n in runs], [f"zero {n}" for n in runs]


@dataclass(frozen=True)
class PlatterFit:
    """Sensitivity (V/SI) and zero outputs (V, one per run) of a gyro on the platter's axis, or of an accelerometer that
    feels ω²r.
    """

    channel: str
    runs: tuple[str, ...]
    solution: Solution
    noise: Resting
    blocks: Rows
    design: Array

    @property
    def sensitivity(self) -> float:
        return float(self.solution.parameters[-1])

    @property
    def misfit(self) -> Misfit:
        """Whether a straight line describes rest and whole revolutions."""
        return _misfit(self.solution, "block means miss a straight line")

    @property
    def noise_dof(self) -> float:
        """Degrees of freedom of the noise that limits: of the flicker if there is any, else of the white noise."""
        return dof_of(self.noise)


def _misfit(solution: Solution, what: str) -> Misfit:
    return misfit(solution.chi2, solution.dof, what)


def dof_of(noise: Resting) -> float:
    """2/r² with the relative standard uncertainty r of the density that means over seconds feel."""
    fit = noise.fit
    name = "flicker" if "flicker" in fit.terms else "white"
    size = float(getattr(fit.model, name))
    relative = fit.u.get(name, 0.0) / size if size else 0.0
    return max(2.0 / relative**2, 1.0) if relative else math.inf


def fit_gyro(rotations: Sequence[Rotation], channel: str, noise: Resting, setup: Setup) -> PlatterFit:
    """Generalised least squares over rest and whole revolutions. Raises BadInput without either."""
    found = rows(rotations, channel, noise, setup, ("rest", "hold"), 0)
    if not np.any(found.rate == 0.0) or not np.any(found.rate != 0.0):
        raise BadInput(f"{channel}: found only {'rest' if np.all(found.rate == 0) else 'rotation'}, wanted both")
    columns, names = _offsets(found)
    design = np.column_stack([*columns, found.rate])
    first = gls(design, found.volts, found.covariance, [*names, "sensitivity"])
    covariance = found.covariance + float(first.parameters[-1]) ** 2 * found.timing
    solution = gls(design, found.volts, covariance, [*names, "sensitivity"])
    found = replace(found, covariance=covariance)
    return PlatterFit(channel, tuple(r.run for r in rotations), solution, noise, found, design)


def sensitivity_result(fit: PlatterFit, setup: Setup) -> Result:
    """Sensitivity with its budget."""
    s = fit.sensitivity
    u_noise = float(fit.solution.u[-1]) * fit.misfit.factor
    drifting, remarks = temperature(s, setup.drift.get(fit.channel), setup.temperature, fit.runs)
    unseen, said = _unseen(fit, setup)
    lines = [
        Contribution("noise and wandering", "A", "normal", u_noise, SENSITIVITY, 1.0, fit.noise_dof,
                     f"covariance from the spectrum at rest ({fit.noise.run})"),
        Contribution("time base", "B", "normal", setup.time_base.u, "1", s, source=setup.time_base.source),
        Contribution("encoder graduation", "B", "normal", 0.0, "1", s, source="index to index: the same line twice"),
        cosine("axis to platter axis", setup.tilt, s, fit.runs),
        *unseen,
        *drifting,
    ]  # fmt: skip
    if fit.channel in setup.ratiometric:
        supply = f"at the nominal supply of {setup.ratiometric[fit.channel]:g} V (ratiometric part, eq. 11)"
        remarks = (supply, *remarks)
    return Result(
        channel=fit.channel,
        measurand="sensitivity",
        title="sensitivity",
        value=s,
        unit=SENSITIVITY,
        budget=Budget(tuple(lines)),
        method="whole revolutions against rest, generalised least squares",
        reference=f"encoder, index to index; time base, {setup.time_base.source}",
        status=fit.misfit.status,
        remarks=(*fit.misfit.remarks, *said, *remarks),
    )


def _unseen(fit: PlatterFit, setup: Setup) -> tuple[tuple[Contribution, ...], tuple[str, ...]]:
    """Budget lines and remarks for what these runs cannot tell from a sensitivity: an asymmetry needs both senses (and
    its sign goes with the sense), a curve more than one speed.
    """
    rate = fit.blocks.rate[fit.blocks.rate != 0.0]
    one_sense = bool(np.all(rate > 0.0) or np.all(rate < 0.0))
    fastest = float(np.abs(rate).max())
    one_speed = float(np.abs(rate).min()) > (1.0 - APART) * fastest
    along = math.copysign(fit.sensitivity, fit.sensitivity * float(rate.sum()))
    how = f"{math.degrees(math.copysign(fastest, float(rate.sum())) if one_sense else fastest):.0f} °/s"
    asymmetry, nonlinearity = setup.straight.get(fit.channel, (None, None))
    hidden = [
        ("asymmetry", asymmetry, along, of_sheet(fit.channel), one_sense),
        ("nonlinearity", nonlinearity, fit.sensitivity, f"{of_sheet(fit.channel)}, at {how}", one_speed),
    ]
    unseen = [one for one in hidden if one[4]]
    lines = tuple(
        Contribution(f"{name}, unseen here", "B", "rectangular", half_width(limit, "rectangular"), "1", s,
                     source=source)
        for name, limit, s, source, _ in unseen if limit is not None
    )  # fmt: skip
    if not unseen:
        return (), ()
    stated = " and ".join(name for name, limit, *_ in unseen if limit is not None)
    missing = " and ".join(name for name, limit, *_ in unseen if limit is None)
    told = [f"{stated} by the sensor file in the budget"] if stated else []
    told += [f"{missing} not in the budget, as the sensor file states no limit"] if missing else []
    turned = " and ".join(w for w, so in (("in one sense", one_sense), ("at one speed", one_speed)) if so)
    return lines, (f"turned {turned} only: {'; '.join(told)} (`rig turntable --all` measures both senses and speeds)",)


def offset_result(fit: PlatterFit) -> Result:
    """Zero output at rest, mean over the runs."""
    zeros = fit.solution.parameters[:-1]
    covariance = fit.solution.covariance[:-1, :-1]
    share = np.full(len(zeros), 1.0 / len(zeros))
    u = math.sqrt(float(share @ covariance @ share))
    line = Contribution("noise and wandering", "A", "normal", u, "V", 1.0, fit.noise_dof)
    return Result(
        fit.channel, "offset", "zero output", float(zeros.mean()), "V", Budget((line,)),
        method="records at rest, generalised least squares", reference="platter at rest",
    )  # fmt: skip


def linearity_results(rotations: Sequence[Rotation], fit: PlatterFit, setup: Setup) -> tuple[Result, ...]:
    """Quadratic, cubic, asymmetry and lag from the continuum of rates; what the runs cannot tell is said."""
    channel = fit.channel
    found = rows(rotations, channel, fit.noise, setup, ("rest", "hold", "moving"), 0)
    columns, names = _offsets(found)
    both = bool(np.any(found.rate > 0.1) and np.any(found.rate < -0.1))
    terms = {"sensitivity": found.rate, "lag": -found.acceleration, "cubic": found.cube}
    terms |= {"quadratic": found.square, "asymmetry": np.abs(found.rate)} if both else {"quadratic": found.square}
    top = float(np.abs(found.rate).max())
    if np.count_nonzero(np.abs(np.diff(np.sort(np.abs(found.rate)))) > 0.02 * top) < 2:
        return tuple(not_determined(channel, name, *_TITLES[name], why=_CONTINUUM) for name in _TITLES)
    design = np.column_stack([*columns, *terms.values()])
    try:
        solution = gls(design, found.volts, found.covariance, [*names, *terms])
    except BadInput as error:
        return tuple(not_determined(channel, n, *_TITLES[n], why=str(error)) for n in _TITLES)
    results = [_term(fit, solution, len(columns), list(terms), name, top) for name in ("quadratic", "cubic", "lag")]
    if both:
        results.append(_term(fit, solution, len(columns), list(terms), "asymmetry", top))
    else:
        results.append(not_determined(channel, "asymmetry", *_TITLES["asymmetry"], why=_ONE_SENSE))
    return tuple(results)


_TITLES = {
    "quadratic": ("quadratic share of the output at the highest rate", "1"),
    "cubic": ("cubic share of the output at the highest rate", "1"),
    "asymmetry": ("asymmetry of the sensitivity between senses, half the difference", "1"),
    "lag": ("lag behind the rate", "s"),
}
_CONTINUUM = "rates between rest and the hold are missing: a run with spin-up, coast-down or touches has them"
_ONE_SENSE = "one sense only: asymmetry and sensitivity are one; the cube upside down has the other (--all)"


def _term(fit: PlatterFit, solution: Solution, before: int, terms: list[str], name: str, top: float) -> Result:
    place = before + terms.index(name)
    power = {"quadratic": 1, "cubic": 2}.get(name, 0)
    scale = top**power / fit.sensitivity
    odd = _misfit(solution, "block means miss the polynomial in the rate")
    value, u = float(solution.parameters[place]) * scale, float(solution.u[place]) * abs(scale) * odd.factor
    title, unit = _TITLES[name]
    line = Contribution("noise and wandering", "A", "normal", u, unit, 1.0, fit.noise_dof)
    return Result(
        fit.channel, name, title, value, unit, Budget((line,)),
        method=f"all rates up to {math.degrees(top):.4g} °/s, generalised least squares", reference="encoder",
        status=odd.status, remarks=odd.remarks,
    )  # fmt: skip


def coupling_result(
    rotations: Sequence[Rotation], channel: str, axis: str, own: float, noise: Resting, setup: Setup
) -> Result:
    """What another gyro shows of the rotation about `axis`, relative to its own sensitivity `own` (V/(rad/s))."""
    kinds = ("rest", "hold")
    found = rows(rotations, channel, noise, setup, kinds, 0)
    columns, names = _offsets(found)
    solution = gls(np.column_stack([*columns, found.rate]), found.volts, found.covariance, [*names, "coupling"])
    odd = _misfit(solution, "block means miss a straight line")
    u = float(solution.u[-1]) / abs(own) * odd.factor
    line = Contribution("noise and wandering", "A", "normal", u, "1", 1.0, dof_of(noise))
    return Result(
        channel, f"cross_coupling_{axis}", f"cross-coupling from {axis}", float(solution.parameters[-1]) / own, "1",
        Budget((line,)), method="whole revolutions against rest", reference="encoder",
        status=odd.status, remarks=odd.remarks,
    )  # fmt: skip


def fit_centripetal(
    rotations: Sequence[Rotation], channel: str, cube_axis: int, noise: Resting, setup: Setup
) -> tuple[PlatterFit, float] | None:
    """An accelerometer against ω²r at a declared radius (m); None if the axis feels no radial acceleration."""
    radial = [r for r in rotations if _is_radial(r, cube_axis)]
    if not radial:
        return None
    found = rows(radial, channel, noise, setup, ("rest", "hold"), cube_axis)
    columns, names = _offsets(found)
    design = np.column_stack([*columns, found.force])
    solution = gls(design, found.volts, found.covariance, [*names, "sensitivity"])
    fit = PlatterFit(channel, tuple(r.run for r in radial), solution, noise, found, design)
    return fit, radial[0].blocks[0].mount.radius


def centripetal_result(fit: PlatterFit, radius: float, setup: Setup) -> Result:
    """Sensitivity of an accelerometer from ω²r at this radius, m, with its budget."""
    s, unit, odd = fit.sensitivity, "V/(m/s²)", fit.misfit
    u = float(fit.solution.u[-1]) * odd.factor
    lines = [
        Contribution("noise and wandering", "A", "normal", u, unit, 1.0, fit.noise_dof),
        cosine("axis to the radius", setup.tilt, s, fit.runs),
        Contribution("radius", "B", "rectangular", half_width(setup.radius, "rectangular"), "m", s / radius,
                     source=in_runs(f"declared limit {setup.radius * 1e3:.3g} mm", fit.runs)),
        Contribution("time base", "B", "normal", 2.0 * setup.time_base.u, "1", s, source=setup.time_base.source),
    ]  # fmt: skip
    said = list(odd.remarks)
    if (place := setup.off_centre.get(fit.channel)) is not None:
        lines.append(Contribution(PLACE, "B", "rectangular", half_width(place, "rectangular"), "m", s / radius,
                                  source=of_sheet(fit.channel)))  # fmt: skip
    else:
        said.append("the radius is that of the cube's centre: where the element sits (`off_centre`) is not stated")
    if setup.platen is not None:
        # at rest gravity has a part along the radius, over whole revolutions it has none
        share = setup.gravity * math.sin(setup.platen) / float(np.abs(fit.blocks.force).max())
        source = in_runs(f"declared limit {math.degrees(setup.platen):.3g}°", fit.runs)
        lines.append(Contribution(PLATEN, "B", "arcsine", half_width(share, "arcsine"), "1", s, source=source))
    else:
        said.append("the tilt of the platter (`alignment: platen`) is not stated")
    return Result(
        fit.channel, "sensitivity_centripetal", "sensitivity from ω²r on the turntable", s, unit, Budget(tuple(lines)),
        method=f"centripetal acceleration at {radius * 1e3:g} mm, generalised least squares", reference="encoder",
        status=odd.status,
        remarks=tuple(said),
    )  # fmt: skip


def _is_radial(rotation: Rotation, cube_axis: int) -> bool:
    mount = rotation.blocks[0].mount
    one = np.ones(1)
    return (
        mount.radius > 0
        and (cube_axis - AXES[mount.axis]) % 3 != 0
        and bool(abs(float(mount.force(cube_axis, one, 0.0 * one, 0.0)[0])) > 0.5)
    )
