"""What to measure next: for every measurement that the bench can do, how well it would decide between what is open.

A measurement that has not been made is a part whose motion is known and whose rows are those that one of two rival
models predicts. The other model is readjusted to the old rows and the new ones together (linearised about its fit);
the χ² that it cannot get rid of is the expected power to decide (T-optimal design: Atkinson and Fedorov 1975). The most
powerful comes first, among equals the quickest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rig.diagnose.diagnose import Choice, Diagnosis
from rig.fit import fit as fitting
from rig.fit.evidence import Evidence
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
        made = [_foreseen(one, part) for one in open_ones]
        least, pair = min(
            (_left_with(made[rival], made[truth]), (open_ones[truth].name, open_ones[rival].name))
            for truth, rival in _pairs(len(open_ones))
        )
        found.append(Ranked(option, least, pair))
    return sorted(found, key=lambda one: (-min(one.power, 4.0 * DECIDES), one.option.minutes, -one.power))


def _pairs(count: int) -> Iterator[tuple[int, int]]:
    """The first against each of the others, both ways round: the truth may be either."""
    for other in range(1, count):
        yield 0, other
        yield other, 0


def power(truth: Choice, rival: Choice, part: Part) -> float:
    """χ² that the rival would be left with if the first were true and this part were measured."""
    return _left_with(_foreseen(rival, part), _foreseen(truth, part))


@dataclass(frozen=True)
class _Foreseen:
    """What a model makes of a part that has not been measured: whitened rows, their columns, and the inverse of its
    normal matrix with this part, whose own zeros are free.
    """

    rows: Array
    blocks: Sequence[fitting.Block]
    inverse: Array


def _left_with(rival: _Foreseen, truth: _Foreseen) -> float:
    left = truth.rows - rival.rows
    gradient = np.zeros(len(rival.inverse))
    for block in rival.blocks:
        gradient[block.columns] += block.matrix.T @ left[block.rows]
    return max(float(left @ left) - float(gradient @ rival.inverse @ gradient), 0.0)


def _foreseen(choice: Choice, part: Part) -> _Foreseen:
    """Raises ValueError if the choice's fit has no part like this one, from which its zeros could be taken."""
    found = choice.fit
    assert found is not None
    number = next((n for n, one in enumerate(found.parts) if one.alike(part)), None)
    if number is None:
        raise ValueError(f"found no part like {part.name}")
    state = replace(
        found.state,
        zero=(*found.state.zero, found.state.zero[number]),
        nuisance=(*found.state.nuisance, np.zeros(part.extra.shape[1])),
    )
    parts = (*found.parts, part)
    order = fitting.layout(parts, state)
    raw = part.raw(state.local(part, len(parts) - 1), state.terms)
    blocks = fitting.blocks_of(part, len(parts) - 1, state, order, raw)
    whole = np.zeros((order.size, order.size))
    places = _places(fitting.layout(found.parts, found.state), order)
    whole[np.ix_(places, places)] = found.normal
    own = order.nuisances[-1] + np.arange(part.extra.shape[1])
    whole[own, own] += 1.0  # their prior
    for block in blocks:
        whole[np.ix_(block.columns, block.columns)] += block.matrix.T @ block.matrix
    return _Foreseen(part.whitened(raw), blocks, fitting.inverse(whole))


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
