"""How far a direct estimate may lie from the fitted one, though both are made from the same rows.

Two estimators that weigh the same noise differently differ by less than their uncertainties: u²(Δ) = u₁² + u₂² − 2·cov.
Noise like that of each channel is drawn, and both estimators, straight in it, are asked what they make of each draw;
the scatter of the difference is u(Δ).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np

from rig.calibrate.accelerometers import ChannelFit
from rig.calibrate.calibration import Check
from rig.calibrate.fitted import Estimate, Experiment
from rig.calibrate.gyros import PlatterFit
from rig.model import Channels
from rig.motion import Array, Complexes

DRAWS = 200  # u(Δ) is then known to five per cent
SEED = 1
SLACK = 0.1  # of the noise's share: the two reductions do not treat every sample alike
Draw = Any  # an array, or what its part makes one of anew


class Replayed(Protocol):
    """A part that can say what noise is like, and what direct estimators would see of it."""

    @property
    def channels(self) -> Channels: ...
    def noise_like(self, row: int, random: np.random.Generator, count: int) -> Draw: ...
    def felt(self, row: int, drawn: Draw, influence: Array) -> Array: ...
    def spans(self) -> tuple[Array, Array]: ...
    def summed(self, row: int, drawn: Draw, weights: Array) -> Array: ...
    def driven_of(self, row: int, drawn: Draw) -> Mapping[tuple[str, int], Complexes]: ...


@dataclass(frozen=True)
class Drawn:
    """Noise of one channel in one part."""

    number: int
    part: Replayed
    row: int
    noise: Draw


Direct = Callable[[Sequence[Drawn]], Array]
"""Change of a direct estimate by draws of noise, (draws,)."""


@dataclass(frozen=True)
class DirectEstimate:
    """What a direct estimator says of one result, `u` from noise alone, and what it makes of noise; `u_alone` is from
    what moves it and no fitted value.
    """

    key: str
    experiment: str
    value: float
    u: float
    change: Direct
    u_alone: float = 0.0


def check(experiment: Experiment, channel: str, estimate: Estimate, direct: DirectEstimate, method: str) -> Check:
    """The direct value beside the fitted one."""
    random = np.random.default_rng(SEED)
    drawn = []
    for number, one in enumerate(experiment.fit.parts):
        if channel in one.channels.names:
            part, row = cast(Replayed, one), one.channels.names.index(channel)
            drawn.append(Drawn(number, part, row, part.noise_like(row, random, DRAWS)))
    apart = _fitted(experiment, estimate, drawn) - direct.change(drawn)
    scatter = float(np.sqrt(np.mean(apart**2)))
    u_delta = math.hypot(scatter, SLACK * max(direct.u, estimate.u_noise), direct.u_alone)
    return Check(method, direct.value, direct.u, estimate.value - direct.value, u_delta)


def _fitted(experiment: Experiment, estimate: Estimate, drawn: Sequence[Drawn]) -> Array:
    total = np.zeros(DRAWS)
    for one in drawn:
        influence = estimate.influence[experiment.rows_of(one.number)]
        total += one.part.felt(one.row, one.noise, influence)
    return total


def of_response(fit: ChannelFit, parameter: str) -> Direct:
    """What the direct fit of a response makes of noise in the driven lines, in the unit of the parameter."""
    weights = fit.adjustment.weights[fit.adjustment.names.index(parameter)]
    scale = fit.sensitivity if parameter == "log_sensitivity" else fit.pole
    points = list(zip(fit.seen.run, fit.seen.index, strict=True))

    def changed(drawn: Sequence[Drawn]) -> Array:
        lines: dict[tuple[str, int], Complexes] = {}
        for one in drawn:
            lines |= one.part.driven_of(one.row, one.noise)
        relative = np.stack([lines[point] for point in points], axis=1) / fit.seen.u_relative
        parts = [relative.real] if fit.seen.u_time else [relative.real, relative.imag]  # else magnitudes alone
        return np.asarray(scale * (np.concatenate(parts, axis=1) @ weights))

    return changed


def of_means(begin: Array, end: Array, weights: Array) -> Direct:
    """What a weighted sum of means between instants (bench clock, s) makes of noise in the windows of a record."""

    def changed(drawn: Sequence[Drawn]) -> Array:
        total = np.zeros(DRAWS)
        for one in drawn:
            first, last = one.part.spans()
            at, length = 0.5 * (first + last), last - first
            of_window = np.zeros(len(at))
            for b, e, weight in zip(begin, end, weights, strict=True):
                inside = (at >= b) & (at < e)
                if inside.any():
                    of_window[inside] += weight * length[inside] / float(length[inside].sum())
            total += one.part.summed(one.row, one.noise, of_window)
        return total

    return changed


def of_poses(begin: Array, end: Array, weights: Array) -> Direct:
    """What a weighted sum of means of x, y and z in poses between instants (bench clock, s), weights (n, 3), makes of
    noise in the means of a tumble's part, some of which are pieces of a pose.
    """

    def changed(drawn: Sequence[Drawn]) -> Array:
        total = np.zeros(DRAWS)
        for one in drawn:
            first, last = one.part.spans()
            at, length = 0.5 * (first + last), last - first
            for b, e, weight in zip(begin, end, weights, strict=True):
                inside = (at >= b) & (at < e)
                if inside.any():
                    mean = one.noise[:, :, inside] @ length[inside] / float(length[inside].sum())
                    total += mean @ weight
        return total

    return changed


def gls_weights(fit: PlatterFit) -> Array:
    """∂(parameters)/∂(block means) of a direct fit, (parameters, blocks)."""
    scaled = np.linalg.solve(fit.blocks.covariance, fit.design)
    return np.asarray(np.linalg.solve(fit.design.T @ scaled, scaled.T))
