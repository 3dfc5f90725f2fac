"""What to measure next: for every measurement that the bench can do, how well it would decide between what is open.

A measurement that has not been made is a part whose motion is known and whose rows are those that one of two rival
models predicts. The other model is readjusted to the old rows and the new ones together (linearised about its fit);
the χ² that it cannot get rid of is the expected power to decide (T-optimal design: Atkinson and Fedorov 1975). The most
powerful comes first, among equals the quickest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rig.diagnose.diagnose import Choice, Diagnosis
from rig.fit import fit as fitting
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.fit.quality import on_all_rows
from rig.motion import Array
from rig.parts import experiments
from rig.parts.part import Option, Part
from rig.parts.remainder import Indices
from rig.parts.ripple import Floor

DECIDES = 16.0  # expected χ² between two models that settles it
HELPS = 4.0  # and that a few repetitions bring there
LIKELY = 0.02  # probability of a rival that is still open
MOST_RIVALS = 4


@dataclass(frozen=True)
class Ranked:
    """A measurement with its expected power (χ² between the two rivals it tells least apart), and which they are."""

    option: Option
    power: float
    pair: tuple[str, str]

    @property
    def decides(self) -> bool:
        """Whether it is expected to settle the question."""
        return self.power >= DECIDES

    @property
    def helps(self) -> bool:
        """Whether it is worth its time although one of it may not settle the question."""
        return self.power >= HELPS


def rivals(diagnosis: Diagnosis) -> list[Choice]:
    """Choices of the last step that the data leave open, best first; fewer than two: nothing is open."""
    if not diagnosis.steps:
        return []
    step = diagnosis.steps[-1]
    open_ones = {one.term.key: one for one in (*step.members, *step.others)}
    likely = [o for o in open_ones.values() if o.probability > LIKELY or o in step.members]
    best = sorted((one for one in likely if one.fit is not None), key=lambda one: -one.merit)[:MOST_RIVALS]
    return [replace(one, fit=on_all_rows(one.fit)) for one in best if one.fit is not None]


def ranked(diagnosis: Diagnosis, floor: Floor | None = None) -> list[Ranked]:
    """All measurements of this bench, the most powerful first, of those that decide well the quickest.

    A new mounting brings ripple of its own: the floor's. [] if nothing is open.
    """
    open_ones = rivals(diagnosis)
    if len(open_ones) < 2:
        return []
    found = []
    for option in experiments.options(diagnosis.base.parts):
        part = option.part().with_ripple(floor)
        powers = [(power(one, other, part), (one.name, other.name)) for one, other in _pairs(open_ones)]
        least, pair = min(powers)
        found.append(Ranked(option, least, pair))
    return sorted(found, key=lambda one: (-min(one.power, 4.0 * DECIDES), one.option.minutes, -one.power))


def _pairs(open_ones: Sequence[Choice]) -> Iterator[tuple[Choice, Choice]]:
    """The best against each of the others, both ways round: the truth may be either."""
    for other in open_ones[1:]:
        yield open_ones[0], other
        yield other, open_ones[0]


def power(truth: Choice, rival: Choice, part: Part) -> float:
    """χ² that the rival would be left with if the first were true and this part were measured."""
    assert truth.fit is not None
    assert rival.fit is not None
    expected = part.whitened(part.raw(_local(truth.fit, part), truth.fit.state.terms))
    normal, columns, predicted = _extended(rival.fit, part)
    left = expected - predicted
    gradient = columns.T @ left
    whole = normal + columns.T @ columns
    return max(float(left @ left) - float(gradient @ fitting.inverse(whole) @ gradient), 0.0)


def _local(found: Fit, part: Part) -> Any:
    """A model's channels in a part that has not been measured; zeros of a part of the same place."""
    for number, other in enumerate(found.parts):
        if other.alike(part) and other.channels.names == part.channels.names:
            return found.state.local(part, number)
    raise ValueError(f"found no part like {part.name}")


def _extended(found: Fit, part: Part) -> tuple[Array, Array, Array]:
    """The rival's normal matrix, columns and prediction with the new part's own zeros free."""
    number = next(n for n, p in enumerate(found.parts) if p.alike(part))
    state = replace(
        found.state,
        zero=(*found.state.zero, found.state.zero[number]),
        nuisance=(*found.state.nuisance, np.zeros(part.extra.shape[1])),
    )
    parts = (*found.parts, part)
    order = fitting.layout(parts, state)
    raw = part.raw(state.local(part, len(parts) - 1), state.terms)
    columns = np.zeros((part.rows, order.size))
    for block in fitting.blocks_of(part, len(parts) - 1, state, order, raw):
        columns[np.ix_(block.rows, block.columns)] += block.matrix
    old = fitting.layout(found.parts, found.state)
    normal = np.zeros((order.size, order.size))
    places = _places(old, order)
    normal[np.ix_(places, places)] = found.normal
    own = order.nuisances[-1] + np.arange(part.extra.shape[1])
    normal[own, own] += 1.0  # their prior
    return normal, columns, part.whitened(raw)


def _places(old: fitting.Layout, new: fitting.Layout) -> Indices:
    """Where the parameters of a smaller layout stand in a larger one."""
    starts = [0, *old.zeros, *old.nuisances, *old.terms, old.size]
    targets = [0, *new.zeros[:-1], *new.nuisances[:-1], *new.terms, new.size]
    place = np.zeros(old.size, np.intp)
    for start, end, target in zip(starts, starts[1:], targets, strict=False):
        place[start:end] = target + np.arange(end - start)
    return place


def unmeasured(evidence: Evidence) -> list[tuple[str, str]]:
    """What these runs cannot show though this bench can: a sentence, and the command that measures it."""
    return experiments.unmeasured(evidence.parts, evidence.blind)
