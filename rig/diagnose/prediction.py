"""A model held as it is against records that it was not fitted to, and what one factor per channel would explain.

Only zero outputs are adjusted, which belong to every mounting. Where a factor brings the error down, the model's shape
holds and the two records differ by level: the sensitivity, the reference or the mounting, not the dynamics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.diagnose.misfit import Comparison, as_it_is
from rig.fit import fit as fitting
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit, State
from rig.model import Term

ROUNDS = 6
SETTLED = 1e-3  # of χ²
HOLDS = 2.0  # times the noise: what is left of a shape that holds


@dataclass(frozen=True)
class Level:
    """How much larger a channel reads than the model says, relative, with its standard uncertainty."""

    channel: str
    relative: float
    u: float

    def as_json(self) -> dict[str, Any]:
        """SI."""
        return {"channel": self.channel, "relative": self.relative, "u": self.u}


@dataclass(frozen=True)
class Prediction:
    """The model as it is, and with a level of its own for every channel."""

    as_is: Comparison
    levelled: Comparison
    levels: tuple[Level, ...]

    @property
    def holds(self) -> bool:
        """Whether the shape is predicted: with levels free nothing much is left but noise."""
        return math.sqrt(self.levelled.fit.chi2 / self.levelled.fit.count) < HOLDS

    def as_json(self) -> dict[str, Any]:
        """What `rig compare --as-is --json` adds."""
        return {
            "groups": [one.as_json() for one in self.as_is.groups],
            "with_levels": [one.as_json() for one in self.levelled.groups],
            "levels": [one.as_json() for one in self.levels],
            "shape_holds": self.holds,
        }


def predict(
    evidence: Evidence, terms: Sequence[Term], sensitivity: Mapping[str, float], pole: Mapping[str, float], *,
    poles: bool = True,
) -> Prediction:  # fmt: skip
    """Compare a model with values of its own: sensitivity (V/SI) and pole (Hz) by channel, terms at their coordinates.

    Channels that the model does not have keep the data sheet's values.
    """
    state = _held(evidence, terms, sensitivity, pole, poles)
    order = fitting.layout(evidence.parts, state)
    zeros = np.concatenate([a + np.arange(len(z)) for a, z in zip(order.zeros, state.zero, strict=True)])
    as_is = _adjusted(evidence, state, zeros)
    gains = np.array(sorted({order.gains[n] for n in order.channels}))
    levelled = _adjusted(evidence, as_is.state, np.concatenate([zeros, gains]))
    return Prediction(as_it_is(as_is), as_it_is(levelled), tuple(_levels(as_is, levelled)))


def _held(
    evidence: Evidence, terms: Sequence[Term], sensitivity: Mapping[str, float], pole: Mapping[str, float], poles: bool
) -> State:
    state = evidence.start(terms, poles=poles)
    gain, log_pole = dict(state.gain), dict(state.log_pole)
    for part in evidence.parts:
        for c, name in enumerate(part.channels.names):
            if name in sensitivity:
                gain[name] = abs(sensitivity[name] / float(part.channels.sensitivity[c])) - 1.0
            if name in pole and math.isfinite(part.channels.pole[c]):
                log_pole[name] = math.log(pole[name] / float(part.channels.pole[c]))
    return replace(state, gain=gain, log_pole=log_pole)


def _adjusted(evidence: Evidence, state: State, free: NDArray[np.intp]) -> Fit:
    """The fit at a state after these parameters alone were adjusted, without priors on them."""
    found = fitting.linearised(evidence.parts, state)
    for _ in range(ROUNDS):
        normal = np.zeros((found.layout.size, found.layout.size))
        downhill = np.zeros(found.layout.size)
        for block in found.blocks:
            normal[np.ix_(block.columns, block.columns)] += block.matrix.T @ block.matrix
            downhill[block.columns] += block.matrix.T @ found.left[block.rows]
        step = np.zeros(found.layout.size)
        step[free] = fitting.inverse(normal[np.ix_(free, free)]) @ downhill[free]
        after = fitting.linearised(evidence.parts, fitting.stepped(found.state, found.layout, step))
        gained = found.chi2 - after.chi2
        if gained < SETTLED:
            return after if gained > 0.0 else found
        found = after
    return found


def _levels(as_is: Fit, levelled: Fit) -> list[Level]:
    u = np.sqrt(np.maximum(np.diag(levelled.covariance), 0.0))
    return [
        Level(
            name,
            (1.0 + levelled.state.gain[name]) / (1.0 + as_is.state.gain[name]) - 1.0,
            float(u[levelled.layout.gains[name]]) / (1.0 + as_is.state.gain[name]),
        )
        for name in levelled.layout.channels
    ]
