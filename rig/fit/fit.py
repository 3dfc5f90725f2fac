"""Fit a model to everything that was observed of a unit: weighted nonlinear least squares with prior knowledge.

Every part (a mounting on the shaker, a turntable run) predicts whitened rows; the sum of squares of what is left, plus
that of the priors in their standard deviations, is minimised by Gauss–Newton (GUM with type A and type B information
combined; JCGM 100 5.2, generalised least squares). Sensitivity and pole of a channel are common to all parts, its
zero output belongs to each. Columns of the channels' own parameters are kept block by block, so that a long run costs
no more than its rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.model import Local, Term
from rig.motion import Array
from rig.parts.part import Part
from rig.parts.remainder import Indices, Prediction, Remainder

POLE_TOLERANCE = 0.1  # of the logarithm: what a data sheet's bandwidth is good for
STRAIGHT = 0.02  # of a coordinate's step: what is left of the bend does not tell a delay from another delay
ENOUGH = 1e-3  # of χ²: a step that changes it by less is the last
ITERATIONS = 12
FIRM = 1e8  # times the weight of a data sheet's tolerance
HALVINGS = 5
CORRECTIONS = 5  # steps with the same columns
ROUNDING = 1e-13  # of the largest output
HIDDEN = 1e-3  # of a column's norm, outside the span of the model: below it an effect cannot be seen
TOLD = 1.0  # standard deviations that a step of the coordinate makes outside the span: then it is seen all the same
NEGLIGIBLE = 1e-11  # of a scaled normal matrix: directions that the data do not see


@dataclass(frozen=True)
class State:
    """All parameters: relative changes of sensitivities and logarithms of poles against the data sheet, by channel;
    zeros (V) by part and channel; coefficients of every part's nuisances; the terms with their coordinates.

    `leader` names the channel whose relative gain each channel has: its own, or in a model with one sensitivity for all
    channels of a quantity the first one's.
    """

    gain: Mapping[str, float]
    log_pole: Mapping[str, float]
    zero: tuple[Array, ...]
    nuisance: tuple[Array, ...]
    terms: tuple[Term, ...]
    poles: bool = True  # False: the model has no output filter (the paper's)
    leader: Mapping[str, str] = field(default_factory=dict)
    free: bool = False  # nothing is believed of sensitivities beforehand: what a data sheet says moves no calibration
    firm: bool = False  # everything is: they stay the data sheet's, and what they could take up is left over

    @property
    def shared(self) -> bool:
        """Whether channels share a sensitivity."""
        return any(name != leader for name, leader in self.leader.items())

    def local(self, part: Part, number: int) -> Local:
        """Sensitivity, pole and zero of a part's channels."""
        names = part.channels.names
        gain = np.array([self.gain[self.leader.get(n, n)] for n in names])
        if not self.poles:
            pole = np.full(len(names), np.inf)
        else:
            pole = part.channels.pole * np.exp([self.log_pole[n] for n in names])
        return Local(part.channels.sensitivity * (1.0 + gain), pole, self.zero[number])


def begin(
    parts: Sequence[Part], terms: Sequence[Term], *, poles: bool = True, shared: bool = False, free: bool = False
) -> State:
    """Where a fit starts: data-sheet values, zero outputs as the parts have them.

    `shared`: one sensitivity for all channels of a quantity; `free`: the data sheet says where a fit begins and not
    what sensitivities are likely.
    """
    names = dict.fromkeys(name for part in parts for name in part.channels.names)
    first: dict[bool, str] = {}
    leader = {
        n: first.setdefault(bool(rate), n) if shared else n
        for part in parts for n, rate in zip(part.channels.names, part.channels.rates, strict=True)
    }  # fmt: skip
    return State(
        dict.fromkeys(names, 0.0),
        dict.fromkeys(names, 0.0),
        tuple(part.zeros for part in parts),
        tuple(np.zeros(part.extra.shape[1]) for part in parts),
        tuple(terms),
        poles,
        leader,
        free,
    )


@dataclass(frozen=True)
class Block:
    """Columns of those rows of the whole problem that count: `columns` says which parameters they belong to."""

    rows: Indices
    columns: Indices
    matrix: Array


@dataclass(frozen=True)
class Layout:
    """Where each parameter stands in the vector."""

    channels: tuple[str, ...]
    gains: Mapping[str, int]  # place of every channel's gain: that of its leader
    zeros: tuple[int, ...]  # first zero of every part
    nuisances: tuple[int, ...]
    terms: tuple[int, ...]  # first coordinate of every term
    size: int

    def own(self, part: Part, number: int) -> Indices:
        """Gain, pole and zero of every channel of a part, (c, 3)."""
        at = np.array([self.channels.index(n) for n in part.channels.names])
        gain = np.array([self.gains[n] for n in part.channels.names])
        return np.stack([gain, 2 * at + 1, self.zeros[number] + np.arange(len(at))], axis=1)


def layout(parts: Sequence[Part], state: State) -> Layout:
    """Order: gain and pole by channel, zeros by part, nuisances by part, coordinates by term."""
    channels = tuple(state.gain)
    at = 2 * len(channels)
    zeros, nuisances, terms = [], [], []
    for zero in state.zero:
        zeros.append(at)
        at += len(zero)
    for one in state.nuisance:
        nuisances.append(at)
        at += len(one)
    for term in state.terms:
        terms.append(at)
        at += len(fitted(term))
    gains = {name: 2 * channels.index(state.leader.get(name, name)) for name in channels}
    return Layout(channels, gains, tuple(zeros), tuple(nuisances), tuple(terms), at)


def fitted(term: Term) -> list[str]:
    """Coordinates that a fit moves."""
    return [c.name for c in term.effect.coordinates if not c.searched]


@dataclass(frozen=True)
class Fit:
    """A fitted model: `left` rows of all parts in standard deviations; `normal` matrix with priors, `blocks` columns.

    `chi2` is that of the rows alone, `penalty` that of the priors.
    """

    parts: tuple[Part, ...]
    state: State
    layout: Layout
    left: Array
    blocks: tuple[Block, ...]
    normal: Array
    downhill: Array
    chi2: float
    penalty: float
    use: NDArray[np.bool_] | None = field(default=None, repr=False)

    @property
    def objective(self) -> float:
        """χ² of rows and priors."""
        return self.chi2 + self.penalty

    @property
    def covariance(self) -> Array:
        """Of all parameters, in the order of the layout."""
        return inverse(self.normal)

    @property
    def count(self) -> int:
        """Rows that carry an observation."""
        counted = np.concatenate([part.counted for part in self.parts])
        return int(np.count_nonzero(counted if self.use is None else counted & self.use))

    def offsets(self) -> list[int]:
        """First row of every part."""
        return [0, *np.cumsum([part.rows for part in self.parts]).tolist()]

    def said_of(self, number: int, state: State | None = None) -> Prediction:
        """What the model says of a part; `state` for other parameters than those fitted."""
        part, state = self.parts[number], state or self.state
        return Prediction(state.local(part, number), state.terms, part.raw)

    def rest(self, number: int) -> Remainder:
        """What is left over of a part."""
        part, first = self.parts[number], self.offsets()[number]
        here = slice(first, first + part.rows)
        used = part.counted if self.use is None else part.counted & self.use[here]
        return Remainder(self.state.local(part, number), self.state.terms, part.raw, self.left[here], used)

    def u(self, number: int) -> dict[str, float]:
        """Standard uncertainties of a term's coordinates."""
        first = self.layout.terms[number]
        names = fitted(self.state.terms[number])
        variance = np.diag(self.covariance)[first : first + len(names)]
        return dict(zip(names, np.sqrt(np.maximum(variance, 0.0)).tolist(), strict=True))


def inverse(normal: Array) -> Array:
    """Inverse of a normal matrix, with columns scaled; directions that nothing determines, or that have no derivative,
    get none of it.
    """
    size = np.sqrt(np.diag(normal))
    seen = np.isfinite(size) & (size > 0.0)
    both = np.outer(seen, seen)
    size = np.where(seen, size, 1.0)
    values, vectors = np.linalg.eigh(np.where(both, normal, 0.0) / np.outer(size, size))
    kept = values > NEGLIGIBLE * values[-1]
    scaled = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    return np.asarray(np.where(both, scaled / np.outer(size, size), 0.0))  # not even by rounding


def predicted(parts: Sequence[Part], state: State) -> list[NDArray[np.inexact]]:
    """Volts of every part."""
    return [part.raw(state.local(part, n), state.terms) for n, part in enumerate(parts)]


def residual(parts: Sequence[Part], state: State, use: NDArray[np.bool_] | None = None) -> Array:
    """Rows of all parts, observed less predicted, in standard deviations."""
    with np.errstate(all="ignore"):  # a step too far gives no numbers, and is not taken
        raws = predicted(parts, state)
        return _left(parts, state, [p.whitened(raw) for p, raw in zip(parts, raws, strict=True)], use)


def _left(parts: Sequence[Part], state: State, white: Sequence[Array], use: NDArray[np.bool_] | None) -> Array:
    rows = [p.target - w - p.extra @ x for p, w, x in zip(parts, white, state.nuisance, strict=True)]
    whole = np.concatenate(rows)
    return whole if use is None else whole * use


def squares(left: Array) -> float:
    """χ² of rows; infinite, and no warning, for a step that went too far."""
    with np.errstate(over="ignore"):
        return float(left @ left)


def penalty(parts: Sequence[Part], state: State) -> float:
    """Sum of squares of priors in their standard deviations."""
    values, weights = prior_of(parts, state)
    return float(values**2 @ weights)


def prior_of(parts: Sequence[Part], state: State) -> tuple[Array, Array]:
    """Distance of every parameter from its prior value and the reciprocal variance of that; zero without a prior."""
    order = layout(parts, state)
    values, weights = np.zeros(order.size), np.zeros(order.size)
    tolerance = {n: float(t) for p in parts for n, t in zip(p.channels.names, p.channels.tolerance, strict=True)}
    for place, name in enumerate(order.channels):
        values[2 * place : 2 * place + 2] = state.gain[name], state.log_pole[name]
        believed = FIRM if state.firm else 0.0 if state.free else 1.0
        weights[2 * place : 2 * place + 2] = believed * tolerance[name] ** -2.0, POLE_TOLERANCE**-2.0
    for first, one in zip(order.nuisances, state.nuisance, strict=True):
        values[first : first + len(one)], weights[first : first + len(one)] = one, 1.0
    for first, term in zip(order.terms, state.terms, strict=True):
        for k, name in enumerate(fitted(term)):
            if name in term.prior:
                values[first + k], weights[first + k] = term.at[name], term.prior[name] ** -2.0
    return values, weights


def fit(
    parts: Sequence[Part], state: State, *, use: NDArray[np.bool_] | None = None, iterations: int = ITERATIONS
) -> Fit:
    """Minimise from this state. `use` (rows,) leaves rows out. Raises BadInput if there is nothing to fit."""
    if not parts:
        raise BadInput(
            "fit: found no record that a model can be compared with, wanted a sweep, a turntable run or a tumble"
        )
    found = linearised(parts, state, use)
    for _ in range(iterations):
        step = inverse(found.normal) @ found.downhill
        better = _shortened(found, step)
        if better is None:
            return found
        gain = found.objective - better.objective
        found = better
        if gain < ENOUGH:
            break
    return found


def _shortened(found: Fit, step: Array) -> Fit | None:
    """The fit after a step, shortened until it is better; None if none is.

    Directions that the data hold tight bend long before those that they hardly see, so a long step leaves the valley;
    a few more steps with the same columns bring it back.
    """
    if float(step @ found.downhill) < 0.1 * ENOUGH:
        return None
    covariance = inverse(found.normal)
    for _ in range(HALVINGS):
        state, objective = found.state, found.objective
        best = None
        move = step
        for _ in range(CORRECTIONS):
            state = stepped(state, found.layout, move)
            left = residual(found.parts, state, found.use)
            if not np.isfinite(left).all():
                break
            after = squares(left) + penalty(found.parts, state)
            if after < objective - (ENOUGH if best is not None else 0.0):
                best, objective = state, after
            elif best is not None:
                break
            move = covariance @ gradient(found, state, left)
        if best is not None:
            return linearised(found.parts, best, found.use)
        step = 0.25 * step
    return None


def gradient(found: Fit, state: State, left: Array) -> Array:
    """Downhill direction at a state with the columns of a fit."""
    total = np.zeros(found.layout.size)
    for block in found.blocks:
        total[block.columns] += block.matrix.T @ left[block.rows]
    values, weights = prior_of(found.parts, state)
    return np.asarray(total - weights * values)


def stepped(state: State, order: Layout, step: Array) -> State:
    """The state after a step."""
    gain = {n: g + float(step[2 * k]) for k, (n, g) in enumerate(state.gain.items())}
    pole = {n: p + float(step[2 * k + 1]) for k, (n, p) in enumerate(state.log_pole.items())}
    zero = tuple(z + step[a : a + len(z)] for a, z in zip(order.zeros, state.zero, strict=True))
    nuisance = tuple(x + step[a : a + len(x)] for a, x in zip(order.nuisances, state.nuisance, strict=True))
    terms = tuple(
        term.moved(**{n: term.at[n] + float(step[a + k]) for k, n in enumerate(fitted(term))})
        for a, term in zip(order.terms, state.terms, strict=True)
    )
    return replace(state, gain=gain, log_pole=pole, zero=zero, nuisance=nuisance, terms=terms)


def linearised(parts: Sequence[Part], state: State, use: NDArray[np.bool_] | None = None) -> Fit:
    """Residual and columns at a state."""
    order = layout(parts, state)
    raws = predicted(parts, state)
    white = [p.whitened(raw) for p, raw in zip(parts, raws, strict=True)]
    left = _left(parts, state, white, use)
    _refuse_no_numbers(parts, left)
    blocks: list[Block] = []
    first = 0
    for number, part in enumerate(parts):
        mask = None if use is None else use[first : first + part.rows]
        blocks += blocks_of(part, number, state, order, raws[number], first, mask)
        first += part.rows
    normal, downhill = np.zeros((order.size, order.size)), np.zeros(order.size)
    for block in blocks:
        normal[np.ix_(block.columns, block.columns)] += block.matrix.T @ block.matrix
        downhill[block.columns] += block.matrix.T @ left[block.rows]
    values, weights = prior_of(parts, state)
    normal[np.diag_indices(order.size)] += weights
    downhill -= weights * values
    for first, term in zip(order.terms, state.terms, strict=True):
        _hold(normal, downhill, first, term)
    return Fit(
        tuple(parts), state, order, left, tuple(blocks), normal, downhill, float(left @ left),
        float(values**2 @ weights), use,
    )  # fmt: skip


def _hold(normal: Array, downhill: Array, first: int, term: Term) -> None:
    """Leave the entries of a term that nothing shows where they are: no step, no uncertainty, and none of what other
    parameters say."""
    if not term.effect.entries or term.prior:
        return
    own = first + np.arange(len(fitted(term)))
    others = np.setdiff1d(np.arange(len(normal)), own)
    across = normal[np.ix_(others, own)]
    outside = normal[np.ix_(own, own)] - across.T @ inverse(normal[np.ix_(others, others)]) @ across
    unseen = own[unseen_of(term, outside, np.diag(normal)[own])]
    normal[unseen, :], normal[:, unseen], downhill[unseen] = 0.0, 0.0, 0.0


def unseen_of(term: Term, outside: Array, own: Array) -> NDArray[np.bool_]:
    """Which coordinates show nothing that the model, or those before them, do not show as well, (k,).

    `outside` (k, k): products of their columns outside the span of the model; `own` (k,): squares of the whole columns.
    """
    steps = {c.name: c.step for c in term.effect.coordinates}
    left, unseen = outside.copy(), np.zeros(len(own), bool)
    for k, name in enumerate(fitted(term)):
        seen = max(float(left[k, k]), 0.0)
        unseen[k] = seen <= HIDDEN**2 * own[k] and seen * steps[name] ** 2 <= TOLD**2
        if not unseen[k]:
            left = left - np.outer(left[:, k], left[k]) / seen
    return unseen


def _refuse_no_numbers(parts: Sequence[Part], left: Array) -> None:
    """No method finds parameters of rows that are infinite or no numbers. Raises BadInput with the part's name."""
    first = 0
    for part in parts:
        wrong = int(np.count_nonzero(~np.isfinite(left[first : first + part.rows])))
        if wrong:
            raise BadInput(
                f"{part.name}: found {wrong} of {part.rows} rows that a model cannot be compared with (infinite, or no "
                "numbers), wanted finite values and an uncertainty above nought in every row"
            )
        first += part.rows


def blocks_of(
    part: Part, number: int, state: State, order: Layout, raw: NDArray[np.inexact], first: int = 0,
    mask: NDArray[np.bool_] | None = None,
) -> list[Block]:  # fmt: skip
    """Columns of all parameters for the rows of one part that count, `raw` being its prediction at the state."""
    counted = part.counted if mask is None else part.counted & mask
    local = state.local(part, number)
    own = part.own_columns(local, state.terms, raw)
    shared, where = [part.extra], [order.nuisances[number] + np.arange(part.extra.shape[1])]
    for at, term in zip(order.terms, state.terms, strict=True):
        others = [one for one in state.terms if one is not term]
        shared.append(term_columns(part, local, others, term, raw))
        where.append(at + np.arange(len(fitted(term))))
    common, columns = np.concatenate(shared, axis=1), np.concatenate(where)
    mine = order.own(part, number)
    blocks = []
    for rows, channels in part.blocks():
        here = rows.start + np.flatnonzero(counted[rows])
        local_columns = [one[here] if one.ndim == 2 else one[here, None] for one in own]
        matrix = np.concatenate([*local_columns, common[here]], axis=1)
        index = np.concatenate([*(mine[channels, k] for k in range(3)), columns])
        if state.shared:
            index, matrix = _merged(index, matrix)
        blocks.append(Block(first + here, index, matrix))
    return blocks


def _merged(index: Indices, matrix: Array) -> tuple[Indices, Array]:
    """Columns of one parameter added up."""
    different, place = np.unique(index, return_inverse=True)
    found = np.zeros((len(matrix), len(different)))
    for column, at in enumerate(place.tolist()):
        found[:, at] += matrix[:, column]
    return different, found


def term_columns(
    part: Part, local: Local, others: Sequence[Term], term: Term, base: NDArray[np.inexact] | None = None
) -> Array:
    """Derivatives of a part's whitened prediction by a term's coordinates, (rows, k).

    `base` is the prediction at the term's own coordinates, if it is known. Only the channels concerned are worked out.
    """
    names = fitted(term)
    if not part.here([term]) or not len(term.among(part.channels)):
        return np.zeros((part.rows, len(names)))
    if base is None:
        base = part.raw(local, [*others, term])
    only = part.apart(term)
    columns = []
    for coordinate in term.effect.coordinates:
        if coordinate.shape and term.nought:
            columns.append(np.zeros(part.rows))
        elif not coordinate.searched:
            step = coordinate.step * (1.0 if term.effect.kinked else STRAIGHT)
            nearby = term.moved(**{coordinate.name: term.at[coordinate.name] + step})
            change = np.zeros_like(base)
            where = slice(None) if only is None else only
            change[where] = _beyond_rounding(part.raw(local, [*others, nearby], only), base[where]) / step
            columns.append(part.whitened(change))
    return np.stack(columns, axis=1) if columns else np.zeros((part.rows, 0))


def _beyond_rounding(moved: NDArray[np.inexact], base: NDArray[np.inexact]) -> NDArray[np.inexact]:
    """The difference, or nothing where it is only rounding: a coordinate without any effect must have no column."""
    change, largest = moved - base, np.abs(base).max(initial=0.0)
    return np.zeros_like(change) if np.abs(change).max(initial=0.0) < ROUNDING * largest else change
