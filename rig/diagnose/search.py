"""Which effect of the shelf takes away most of what a model leaves over: score test first, full refits of the best.

The score of a candidate is the decrease of χ² that its columns promise once the model's own parameters have been
readjusted (one linear projection; Rao 1948). A candidate whose columns lie within the span of the model's cannot be
seen in this data at all. The best candidates are then refitted with all parameters free.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.fit import adequacy
from rig.fit import fit as fitting
from rig.fit.fit import HIDDEN, TOLD, Fit, fitted, unseen_of
from rig.model import BOTH, Effect, Quantity, Term
from rig.motion import Array
from rig.parts.part import Part

ROUNDING = 1e-6  # of a column's norm: less is no more than rounding
NARROW = 0.2  # of a column's norm outside the span: below it a refit needs all columns afresh
REACH = 0.7  # of the best's gain: a quick refit that removes less was never seen to become the best
WIDTH = 1.0  # decades: by how much sizes scatter beyond those that are usual
ROUNDS = 8
FIRST_ROUNDS = 4  # with all columns afresh; those within reach go on
SHORT = 0.5  # of what a score promised: a quick refit that removes less went astray
AWAY = (10.0, 100.0)  # steps of a coordinate: not straight any more
MANY = 8  # starts in a row: of more, every second is tried first
LIKE = 0.1  # of the best's gain: what one effect promises where another that is much like it acts
HARDLY = 8.0  # χ² of a score that is worth nothing
SETTLED = 0.02  # of χ²
MOSTLY = 0.5  # of what is left in a quantity: less in one channel or unit is no reason to think that it is there alone
MUCH = 0.25  # the same where something that all channels share may take up a part
ALONE = 0.9  # of what is left in a unit: then it is that channel's, as far as anybody can tell
TELLS = 0.5  # of a sensitivity's tolerance


Memory = dict[tuple[object, ...], tuple[NDArray[np.float32], NDArray[np.float32]]]
"""Columns by effect and start, in half the space: a score needs no more digits."""


@dataclass(frozen=True)
class Score:
    """A candidate before it is refitted: linear estimate and the decrease of χ² it promises."""

    start: Term
    term: Term
    gain: float
    visible: float  # largest share of a column outside the span of the model
    steps: int  # starts that were tried
    size: int = 1  # coordinates that the data see
    ways: int = 1  # to choose the channels that have it
    unseen: tuple[str, ...] = ()  # entries that the data do not show, while others show


@dataclass(frozen=True)
class Candidate:
    """A candidate after the refit. `gain` is the decrease of χ² and priors; `u` of the coordinates.

    Where it is not `full` the model's own columns stayed as they were: it removes at least that.
    """

    term: Term
    gain: float
    fit: Fit
    u: Mapping[str, float]
    steps: int
    size: int
    full: bool = False
    ways: int = 1

    @property
    def name(self) -> str:
        return self.term.effect.name


def possible(shelf: Mapping[str, Effect], found: Fit, looks_in: str = "", only: tuple[str, ...] = ()) -> list[Term]:
    """Effects that are not in the model and could act in one of its parts, once for each quantity there; on `only` some
    of its channels, where they are named.
    """
    held: dict[str, set[str]] = {}
    for part in found.parts:
        held.setdefault(part.experiment, set()).update(part.logged)
    rates = {bool(r) for part in found.parts for r in part.channels.rates}
    there = {(t.effect.name, t.on, t.only) for t in found.state.terms if not t.prior}
    result = []
    for effect in shelf.values():
        if effect.instrument and not any(effect.instrument in part.instruments for part in found.parts):
            continue
        here = {part.experiment for part in found.parts if part.acts(effect)}
        if effect.looks_in != looks_in or effect.absorbed or not here:
            continue
        if not any(held[one].issuperset(effect.needs) for one in here):
            continue  # what nobody logged cannot be found to be the cause
        quantities: Iterable[Quantity | None] = effect.quantities or (None,)
        for on in quantities:
            if (on is None or (on == "rate") in rates) and (effect.name, on, only) not in there:
                zero = dict.fromkeys((c.name for c in effect.coordinates), 0.0)
                result.append(Term(effect, on, zero, only=only))
    return result


def alone(shelf: Mapping[str, Effect], found: Fit) -> list[Term]:
    """Effects that one channel or one unit alone may have: those where most of what is left stands, and of the dynamics
    also those where much of it does, since a delay that all channels share takes up part of what one of them has.
    """
    return [
        term
        for on, only, share in narrower(found)
        for term in possible(shelf, found, only=only)
        if term.on == on and (share > MOSTLY or term.effect.stage == "dynamics")
    ]


def narrower(found: Fit) -> list[tuple[Quantity, tuple[str, ...], float]]:
    """Where an effect may be in some channels only: one channel or one unit of a quantity in which much of what is left
    stands, and its share of that, though others are driven as well.
    """
    places: list[tuple[Quantity, tuple[str, ...], float]] = []
    above: dict[str, float] = {}
    for one in adequacy.groups(found):
        if one.z > adequacy.EXCEEDS:
            above[one.channel] = above.get(one.channel, 0.0) + one.chi2 - one.count
    for on in BOTH:
        channels, driven = _units(found.parts, on), _driven(found, on)
        total = sum(above.get(name, 0.0) for name in channels)
        for some in _some(channels):
            here = sum(above.get(name, 0.0) for name in some)
            most = max(above.get(name, 0.0) for name in some)
            told = len(some) == 1 or most < ALONE * here
            if total > 0.0 and here > MUCH * total and told and driven - set(some):
                places.append((on, some, here / total))
    return places


def _units(parts: Sequence[Part], on: Quantity) -> dict[str, str]:
    """Unit of every channel of a quantity, by its name."""
    return {p.channels.names[c]: p.channels.unit[c] for p in parts for c in p.channels.of(on)}


def _some(channels: Mapping[str, str]) -> list[tuple[str, ...]]:
    """Single channels, and units of several."""
    units = [tuple(name for name, own in channels.items() if own == one) for one in dict.fromkeys(channels.values())]
    whole = [unit for unit in units if 1 < len(unit) < len(channels)]
    return [*((name,) for name in channels), *whole] if len(channels) > 1 else []


def _driven(found: Fit, on: Quantity) -> set[str]:
    """Channels of a quantity whose sensitivities the records tell: what acts on the input would show there."""
    names = set()
    for number, part in enumerate(found.parts):
        u = np.sqrt(np.maximum(np.diag(found.covariance)[found.layout.own(part, number)[:, 0]], 0.0))
        names |= {
            part.channels.names[c] for c in part.channels.of(on) if 0.0 < u[c] < TELLS * part.channels.tolerance[c]
        }
    return names


def ways_of(parts: Sequence[Part], term: Term) -> int:
    """How many channels and units could have been chosen in place of those of a term."""
    return max(len(_some(_units(parts, term.on))), 1) if term.only and term.on is not None else 1


@dataclass(frozen=True)
class _Sight:
    """What every score needs of the present model, worked out once; of rows only those that count."""

    found: Fit
    inverse: Array
    raws: tuple[NDArray[np.inexact], ...]
    counting: NDArray[np.intp]
    left: Array
    places: tuple[slice, ...]  # of the rows of the model's blocks among those that count
    memory: Memory

    @classmethod
    def of(cls, found: Fit, memory: Memory | None = None) -> _Sight:
        raws = tuple(fitting.predicted(found.parts, found.state))
        counted = np.concatenate([part.counted for part in found.parts])
        counted = counted if found.use is None else counted & found.use
        inverse, counting = fitting.inverse(found.normal), np.flatnonzero(counted)
        first = (int(np.searchsorted(counting, block.rows[:1].sum())) for block in found.blocks)
        places = tuple(slice(a, a + len(block.rows)) for a, block in zip(first, found.blocks, strict=True))
        return cls(found, inverse, raws, counting, found.left[counting], places, {} if memory is None else memory)

    def cross(self, columns: Array) -> Array:
        """Products with the model's columns, (parameters, k) or (parameters,)."""
        found = np.zeros((len(self.inverse), *columns.shape[1:]))
        for block, places in zip(self.found.blocks, self.places, strict=True):
            here = columns[places]
            if here.any():
                found[block.columns] += block.matrix.T @ here
        return found

    def columns(self, term: Term) -> tuple[Array, Array]:
        """Columns of a candidate at its coordinates, (rows, k), and what it changes there already, (rows,).

        Those of an earlier step will do: a model that has one effect more has hardly other derivatives.
        """
        key = (term.effect, term.on, term.only, *term.at.values())
        if key in self.memory:
            kept, before = self.memory[key]
            return kept.astype(np.float64), before.astype(np.float64)
        columns, shift = self._columns(term)
        self.memory[key] = columns.astype(np.float32), shift.astype(np.float32)
        return columns, shift

    def _columns(self, term: Term) -> tuple[Array, Array]:
        columns, moved = [], []
        for number, (part, raw) in enumerate(zip(self.found.parts, self.raws, strict=True)):
            local, terms = self.found.state.local(part, number), self.found.state.terms
            here = raw
            if not term.nought and any(term.at.values()) and part.here([term]):
                here = raw.copy()
                only = part.apart(term)
                here[slice(None) if only is None else only] = part.raw(local, [*terms, term], only)
            columns.append(fitting.term_columns(part, local, terms, term, here))
            moved.append(np.zeros(part.rows) if here is raw else part.whitened(here - raw))
        return np.concatenate(columns)[self.counting], np.concatenate(moved)[self.counting]


def scores(found: Fit, terms: Iterable[Term], memory: Memory | None = None) -> list[Score]:
    """The best start of every candidate, most promising first; `memory` keeps columns from one step to the next.

    Those that are much like others are left out where none of these promises enough.
    """
    sight, terms = _Sight.of(found, memory), list(terms)
    names = {term.effect.name for term in terms}
    later = [term for term in terms if any(names.intersection(group) for group in term.effect.beside)]
    result = [_scored(sight, term) for term in terms if term not in later]
    most = max((one.gain for one in result), default=0.0)
    promising = {
        (one.start.effect.name, one.start.on, one.start.only)
        for one in result if one.gain > max(LIKE * most, HARDLY)
    }  # fmt: skip
    result += [
        _scored(sight, term) for term in later
        if all(any((name, term.on, term.only) in promising for name in group) for group in term.effect.beside)
    ]  # fmt: skip
    return sorted(result, key=lambda one: -one.gain)


def _scored(sight: _Sight, term: Term) -> Score:
    """The best of its starts; of many in a row every second is tried, and those beside the best of these."""
    parts = [n for n, p in enumerate(sight.found.parts) if p.here([term]) and len(term.among(p.channels))]
    starts = _starts(sight, term, parts)
    row = len(starts) > MANY and not any(one.searched for one in term.effect.coordinates)
    made = {place: _from(sight, term.moved(**starts[place])) for place in range(row, len(starts), 1 + row)}
    if row:
        tops = sorted(made, key=lambda place: -made[place].gain)[:2]
        near = {place + way for place in tops for way in (-1, 1)} & set(range(len(starts)))
        made |= {place: _from(sight, term.moved(**starts[place])) for place in near}
    more = [_from(sight, term.moved(**start)) for start in _more_starts(sight, term, parts)]
    tried, steps = [*made.values(), *more], max(len(starts) + len(more), 1)
    best = max(tried, key=lambda one: one.gain, default=None)
    if best is None or best.gain <= 0.0:
        best = Score(term, term, 0.0, 0.0, steps)
    visible, size = (one.visible for one in tried), (one.size for one in tried)
    ways = ways_of(sight.found.parts, term)
    unseen = tuple(name for name in fitted(term) if tried and all(name in one.unseen for one in tried))
    return replace(best, visible=max([best.visible, *visible]), steps=steps, size=max([best.size, *size]), ways=ways,
                   unseen=unseen)  # fmt: skip


def _starts(sight: _Sight, term: Term, parts: Sequence[int]) -> list[dict[str, float]]:
    """Starts in the part that has most of the channels concerned."""
    if not parts:
        return []
    there = [sight.found.parts[number] for number in parts]
    return term.effect.starts(min(there, key=lambda part: not part.excites(term.on)).reference, term.on)


def _more_starts(sight: _Sight, term: Term, parts: Sequence[int]) -> list[dict[str, float]]:
    """At the peaks of every response, and beside another of the dynamics at sizes of its own: at nought a lag looks
    the same as a delay.
    """
    starts: list[dict[str, float]] = []
    if term.effect.at_peak(1.0):
        tops = sorted({f for number in parts for f in sight.found.parts[number].peaks(sight.raws[number])})
        starts += [start for f in tops for start in term.effect.at_peak(f)]
    theirs = [one for one in sight.found.state.terms if one.effect.stage == "dynamics" and not one.prior]
    if term.effect.stage == "dynamics" and any(one.on == term.on for one in theirs):
        steps = {one.name: one.step for one in term.effect.coordinates}
        starts += [{name: share * step for name, step in steps.items()} for share in AWAY]
    return starts


def _from(sight: _Sight, term: Term) -> Score:
    """Linear estimate from one start."""
    columns, moved = sight.columns(term)
    if not (np.isfinite(columns).all() and np.isfinite(moved).all()):
        return Score(term, term, 0.0, 0.0, 1)  # it has no value for this motion
    left, pull = sight.left - moved, sight.found.downhill - sight.cross(moved)
    inside, own = sight.cross(columns), columns.T @ columns
    outside = own - inside.T @ sight.inverse @ inside
    size = np.sqrt(np.maximum(np.diag(own), 1e-300))
    seen = np.sqrt(np.maximum(np.diag(outside), 0.0)) / size
    # what only a prior tells from a nuisance is a small share of a strong column, and can be seen all the same
    steps = np.array([c.step for c in term.effect.coordinates if not c.searched])
    told = np.sqrt(np.maximum(np.diag(outside), 0.0)) * steps > TOLD
    good = (seen > HIDDEN) | ((seen > ROUNDING) & told)
    if term.effect.entries:
        good &= ~unseen_of(term, outside, np.diag(own))
    seen = np.where(good, np.maximum(seen, 1.01 * HIDDEN), seen)
    target = columns.T @ left - inside.T @ sight.inverse @ pull
    if good.any():
        # unseen directions stay where they are
        reduced = outside[np.ix_(good, good)]
        step = np.zeros(len(size))
        step[good] = fitting.inverse(reduced) @ target[good]
        gained = float(target @ step)
    else:
        step, gained = np.zeros(len(size)), 0.0
    if np.any(moved):
        before = float(left @ left) - float(pull @ sight.inverse @ pull)
        gained += float(sight.left @ sight.left) - before
        seen = np.append(seen, 1.0)
    at = dict(zip(fitted(term), step.tolist(), strict=True))
    where = term.moved(**{name: term.at[name] + change for name, change in at.items()})
    unseen = tuple(name for name, one in zip(at, good, strict=True) if term.effect.entries and not one)
    return Score(term, where, gained, float(seen.max(initial=0.0)), 1, max(int(np.count_nonzero(good)), 1),
                 unseen=unseen)  # fmt: skip


def _pull(sight: _Sight, left: Array) -> Array:
    """Gradient of the model's parameters for these rows (priors included)."""
    return sight.found.downhill + sight.cross((left - sight.found.left)[sight.counting])


def refitted(found: Fit, score: Score) -> Candidate:
    """All parameters and the candidate's adjusted together.

    The model's own columns stay as they were where the candidate stands out from them; where it nearly lies within
    their span, all move far and are worked out afresh at every step.
    """
    return _refitted(_Sight.of(found), score)


def _refitted(sight: _Sight, score: Score) -> Candidate:
    if score.visible < NARROW:
        return _afresh(sight.found, score)
    quick = _quickly(sight, score)
    if quick.gain > SHORT * score.gain or not any(score.start.at.values()):
        return quick
    afresh = _afresh(sight.found, score)  # far from its start the model's own columns are others
    return afresh if afresh.gain > quick.gain else quick


def _afresh(found: Fit, score: Score, start: fitting.State | None = None, iterations: int = FIRST_ROUNDS) -> Candidate:
    """Refitted with all columns worked out at every step, from where the model is or from elsewhere."""
    start = start or found.state
    state = replace(start, terms=(*start.terms, score.start))
    made = fitting.fit(found.parts, state, use=found.use, iterations=iterations)
    return Candidate(made.state.terms[-1], found.objective - made.objective, made,
                     made.u(len(made.state.terms) - 1), score.steps, score.size, ways=score.ways)  # fmt: skip


def from_data_sheet(found: Fit, terms: Sequence[Term], most: int) -> list[Candidate]:
    """The most promising of some candidates, scored and fitted from where the data sheet's sensitivities are held.

    Without what is missing a fit may reverse a sensitivity rather than leave a misfit; no effect leads back from there.
    """
    state = found.state
    start = fitting.begin(found.parts, (), poles=state.poles, shared=state.shared, free=state.free)
    before = tuple(one.moved(**dict.fromkeys(one.at, 0.0)) if one.prior else one for one in state.terms)
    firm = fitting.fit(found.parts, replace(start, terms=before, firm=True), use=found.use)
    begun = replace(firm.state, firm=False)
    plain = fitting.fit(found.parts, begun, use=found.use)
    against = min((found, plain), key=lambda one: one.objective)  # a better valley is no effect's merit
    made = (_afresh(against, one, begun, fitting.ITERATIONS) for one in scores(firm, terms)[:most])
    return [replace(one, full=True) for one in made]


def completed(found: Fit, one: Candidate) -> Candidate:
    """The candidate with all columns worked out afresh until nothing changes: only then is it known what it leaves."""
    if one.full:
        return one
    made = fitting.fit(found.parts, one.fit.state, use=found.use)
    place = len(made.state.terms) - 1
    gain = found.objective - made.objective
    return replace(one, term=made.state.terms[place], gain=gain, fit=made, u=made.u(place), full=True)


def _quickly(sight: _Sight, score: Score) -> Candidate:
    found, size = sight.found, len(sight.inverse)
    order = fitting.layout(found.parts, replace(found.state, terms=(*found.state.terms, score.term)))
    begun = _begun(sight, score, order)
    if begun is None:  # the linear estimate is beyond where the effect has values
        return _afresh(found, score)
    state, left, objective = begun
    normal, held = found.normal, [fitted(score.term).index(name) for name in score.unseen]
    for _ in range(ROUNDS):
        columns = _candidate_columns(sight, state)
        columns[:, held] = 0.0
        cross = sight.cross(columns)
        normal = np.block([[found.normal, cross], [cross.T, columns.T @ columns]])
        gradient = np.concatenate([_gradient(sight, state, left), columns.T @ left[sight.counting]])
        step = fitting.inverse(normal) @ gradient
        moved = _improved(found, state, order, step, objective)
        if moved is None:
            break
        gained = objective - moved[2]
        state, left, objective = moved
        if gained < SETTLED:
            break
    covariance = fitting.inverse(normal)
    u = np.sqrt(np.maximum(np.diag(covariance)[size:], 0.0))
    made = Fit(found.parts, state, order, left, found.blocks, normal, np.zeros(len(normal)), float(left @ left),
               objective - float(left @ left), found.use)  # fmt: skip
    return Candidate(state.terms[-1], found.objective - objective, made,
                     dict(zip(fitted(score.term), u.tolist(), strict=True)), score.steps, score.size,
                     ways=score.ways)  # fmt: skip


_Begun = tuple[fitting.State, Array, float]


def _begun(sight: _Sight, score: Score, order: fitting.Layout) -> _Begun | None:
    """Where a refit begins: at the linear estimate, or where that goes past a kink and does no good, at its own start.

    None where the estimate has no value.
    """
    first = _standing(sight, score.term, order)
    if first is None or score.start.nought or first[2] < sight.found.objective:
        return first
    other = _standing(sight, score.start, order)
    return first if other is None or first[2] < other[2] else other


def _standing(sight: _Sight, term: Term, order: fitting.Layout) -> _Begun | None:
    """The model with this term, its own parameters readjusted: state, rows left, and their χ² with that of priors."""
    found = sight.found
    state = replace(found.state, terms=(*found.state.terms, term))
    state, left = _readjusted(sight, state, order, len(sight.inverse))
    if not np.isfinite(left).all():
        return None
    return state, left, fitting.squares(left) + fitting.penalty(found.parts, state)


def _readjusted(sight: _Sight, state: fitting.State, order: fitting.Layout, size: int) -> tuple[fitting.State, Array]:
    """The model's own parameters moved to where the candidate's start wants them."""
    found = sight.found
    left = fitting.residual(found.parts, state, found.use)
    step = np.concatenate([sight.inverse @ _pull(sight, left), np.zeros(order.size - size)])
    moved = fitting.stepped(state, order, step)
    after = fitting.residual(found.parts, moved, found.use)
    whole = [float(x @ x) + fitting.penalty(found.parts, s) for x, s in ((after, moved), (left, state))]
    return (moved, after) if whole[0] < whole[1] else (state, left)


def _gradient(sight: _Sight, state: fitting.State, left: Array) -> Array:
    """Of the model's own parameters at a state, with the columns as they were."""
    found = sight.found
    rows = sight.cross(left[sight.counting])
    values, weights = fitting.prior_of(found.parts, replace(state, terms=state.terms[:-1]))
    return np.asarray(rows - weights * values)


def _candidate_columns(sight: _Sight, state: fitting.State) -> Array:
    *others, term = state.terms
    parts = enumerate(sight.found.parts)
    columns = [fitting.term_columns(part, state.local(part, n), others, term) for n, part in parts]
    return np.concatenate(columns)[sight.counting]


def _improved(
    found: Fit, state: fitting.State, order: fitting.Layout, step: Array, objective: float
) -> tuple[fitting.State, Array, float] | None:
    for _ in range(fitting.HALVINGS):
        moved = fitting.stepped(state, order, step)
        left = fitting.residual(found.parts, moved, found.use)
        finite = bool(np.isfinite(left).all())
        after = fitting.squares(left) + fitting.penalty(found.parts, moved) if finite else math.inf
        if after < objective:
            return moved, left, after
        step = 0.5 * step
    return None


def admissible(term: Term, u: Mapping[str, float]) -> bool:
    """Whether the parameters are within what physics allows, or no more than two standard uncertainties outside."""
    return math.isfinite(improbability(term, u))


def improbability(term: Term, u: Mapping[str, float]) -> float:
    """How much less probable its size is than a usual one, as χ² (−2 ln of the odds); infinite for what cannot be.

    Sizes scatter about the usual ones as a log-normal of `WIDTH` decades. The most probable within two standard
    uncertainties counts.
    """
    names = [name for name in term.at if u.get(name, 0.0) > 0.0]
    least = math.inf
    for signs in itertools.product((0.0, 1.0, -1.0), repeat=len(names)):
        moved = {name: term.at[name] + 2.0 * sign * u[name] for name, sign in zip(names, signs, strict=True)}
        physical = term.effect.physical({**term.at, **moved})
        if all(_within(physical[p.name], p.bounds) for p in term.effect.parameters):
            decades = (_decades(physical[p.name], p.typical) for p in term.effect.parameters)
            least = min(least, sum((one / WIDTH) ** 2 for one in decades))
    return least


def refund(term: Term, u: Mapping[str, float], most: float) -> float:
    """What of the `most` χ² that it is charged for each shape a term has back, because the data tell little of it.

    The factor of Occam (MacKay 1992, Neural Computation 4, 415): −2 ln of posterior over prior width, ln(1 + (σ/u)²) of
    a size whose logarithm scatters by σ over the usual ones and is known to u.
    """
    if term.effect.contains:  # beside what it contains it is a further number, told or not
        return 0.0
    usual = {one.name: one.typical for one in term.effect.parameters}
    kept = 0.0
    for one in term.effect.coordinates:
        low, high = usual.get(one.name, (0.0, 0.0))
        if one.shape and 0.0 < low < high and u.get(one.name, 0.0) > 0.0:
            width = math.log(high / low) / math.sqrt(12.0)
            kept += max(most - math.log1p((width * term.at[one.name] / u[one.name]) ** 2), 0.0)
    return kept


def _within(value: float, bounds: tuple[float, float]) -> bool:
    return math.isfinite(value) and bounds[0] <= value <= bounds[1]


def _decades(value: float, typical: tuple[float, float]) -> float:
    """How far a size is outside the usual ones; nought is no size, and not unusual."""
    low, high = min(map(abs, typical)), max(map(abs, typical))
    if min(typical) < 0.0:  # a range about nought has no smallest size
        low = 0.0
    size = abs(value)
    if size > high > 0.0:
        return math.log10(size / high)
    return math.log10(low / size) if 0.0 < size < low else 0.0


def best(found: Fit, chosen: Sequence[Score]) -> list[Candidate]:
    """Refits, best first. Those within reach of the best that can be are refitted in full."""
    if not chosen:
        return []
    sight = _Sight.of(found)
    refits = [_refitted(sight, score) for score in chosen]
    can_be = [one for one in refits if one.gain > 0.0 and admissible(one.term, one.u)]
    least = REACH * max((one.gain for one in can_be), default=0.0)
    made = [completed(found, one) if one in can_be and one.gain > least else one for one in refits]
    return sorted(made, key=lambda one: -one.gain)
