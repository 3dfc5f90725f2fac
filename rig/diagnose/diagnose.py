"""What a model is missing: instruments first, then the shelf, one effect after another, until only noise is left.

Every step takes the effect with the largest merit: the χ² that it removes after a full refit, less what chance gives to
the best of so many candidates, less how unusual it is. A step is taken only if chance would hardly do as well. Effects
that the data cannot tell from the one taken form its class. All of this is decided on the rows that are not held out;
those then judge what was decided, and only the parameters that are reported, and the order within a class, come from
fits to everything. When no effect brings both to their noise, the verdict is *unlisted*, and the best candidate is only
the nearest. Where nothing is found missing but noise is known only from what the model leaves over, the verdict is
*undecided*: that nothing stands out of such noise means nothing. So it is while records hold samples that are no
measurement, since what made them may have changed others too, and where too few rows are held out to judge. Where the
axes of a triad are not those that its manifest states, nothing is looked for at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from rig.diagnose import describe, instruments, search
from rig.diagnose.instruments import Finding
from rig.diagnose.search import Candidate, Score
from rig.fit import adequacy
from rig.fit import fit as fitting
from rig.fit.adequacy import Group
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.model import Effect, Term
from rig.parts.remainder import Mask
from rig.shelf import shelf as shelf_of

Verdict = Literal["adequate", "missing", "unlisted", "undecided"]
CHANCE = 16.0  # χ² that one coordinate hardly gains by chance among the candidates of a shelf
PER_COORDINATE = 5.0  # more of it for each further coordinate
PER_START = 1.5  # and for every factor e of starts tried
PER_WAY = 2.0  # and of channels or units that alone could have it, which do not go together as starts do (Bonferroni)
FINDING = 30.0  # evidence that a test of its own must have
ALONE = "a test of its own tells it from chance, and from no other effect"
CLASS = 9.0  # χ² within which another effect is not excluded by the data
LARGEST_CLASS = 3
MOST_CERTAIN = 1e3  # χ²
RANKED_BELOW = 4  # effects of a step that are said to be excluded
MOST_STEPS = 4
REFITS = 8
SHARE = 2e-3  # of the first effect's gain: a later effect must be worth more than the first one's own imprecision
LIKELY = 0.6  # of what chance may give: where a score is as small as that it is straight, and no refit does much better
EVENS = 0.5  # the highest probability of a name whose shape the data do not tell
PROMISE = 0.1  # of what is needed: a score was never seen to promise less of what a refit removed
PAIRS = 8  # first effects that pairs are begun with
PAIR_REFITS = 3
QUARTER = 0.25  # of the misfit in excess of the noise


@dataclass(frozen=True)
class Choice:
    """One effect as it competes in a step: what it removes, how probable it is, and whether the data exclude it.

    Where it was not refitted in `full` it removes `gain` at least, and that is out of reach of what was taken.
    """

    term: Term
    u: Mapping[str, float]
    gain: float
    merit: float
    probability: float
    because: str
    fit: Fit | None = field(default=None, repr=False)
    full: bool = True
    doubt: float = 1.0  # how many times more than by even noise a difference from the best may be chance
    refund: float = 0.0  # of what it was charged for shapes, χ²: these the data do not tell
    whole: Fit | None = field(default=None, repr=False)  # beside all other steps' effects, where that is another fit

    @property
    def name(self) -> str:
        return self.term.effect.name

    @property
    def possible(self) -> bool:
        """Whether physics allows it at all."""
        return self.merit > -math.inf

    @property
    def standing(self) -> float:
        """Merit among effects of which one is there: a shape that any value fits is no further number to choose."""
        return self.merit + self.refund


@dataclass(frozen=True)
class Step:
    """One missing effect: the choice taken, its class (itself first), all choices, the fits before and after."""

    taken: Choice
    members: tuple[Choice, ...]
    others: tuple[Choice, ...]
    before: Fit = field(repr=False)
    after: Fit = field(repr=False)

    @property
    def ranked_below(self) -> list[Choice]:
        """The next best that are not of its class, most of χ² removed first."""
        apart = [one for one in self.others if one not in self.members and one.fit is not None]
        return sorted(apart, key=lambda one: -one.gain)[:RANKED_BELOW]

    @property
    def excluded(self) -> list[Choice]:
        """Those of them that were refitted in full: of the others nothing is known but that they are out of reach."""
        return [one for one in self.ranked_below if one.full]


@dataclass(frozen=True)
class Diagnosis:
    """What is missing. `base` is the model as given, `final` with all steps taken, both fitted to all rows.

    `trained` is the final model fitted to those that are not held out, `held` says how the others judge it (none: too
    few could). `scores` of the whole shelf.
    """

    verdict: Verdict
    steps: tuple[Step, ...]
    base: Fit = field(repr=False)
    final: Fit = field(repr=False)
    scores: tuple[Score, ...] = field(repr=False)
    explained: float = 0.0  # share of the excess that the steps explain
    misplaced: tuple[str, ...] = ()  # implausible metadata
    trained: Fit | None = field(default=None, repr=False)
    held: tuple[Group, ...] = field(default=(), repr=False)

    @property
    def named(self) -> tuple[str, ...]:
        """Names of the effects taken, in order."""
        return tuple(step.taken.name for step in self.steps)


Told = Callable[[str], None]


def unheard(doing: str) -> None:
    """Nobody waits for it."""


def diagnose(
    evidence: Evidence, terms: Sequence[Term] = (), *, shelf: Mapping[str, Effect] | None = None, poles: bool = True,
    shared: bool = False, told: Told = unheard,
) -> Diagnosis:  # fmt: skip
    """Find what is missing in a model with these effects, without reading anything but the evidence.

    `told` hears what is being done, as that may take long.
    """
    told("fitting the model as it is")
    shelf = shelf_of() if shelf is None else shelf
    whole = evidence.fitted(terms, poles=poles, shared=shared)
    base = fitting.fit(whole.parts, whole.state, use=_training(evidence, whole))
    if misread(whole):
        return _concluded(whole, base, [], (), evidence.imported)
    steps: list[Step] = []
    current = base
    first_scores: tuple[Score, ...] = ()
    memory: search.Memory = {}
    for number in range(1, MOST_STEPS + 1):
        told(f"looking for effect {number}{_after(steps)}")
        step, scored = _step(evidence, current, shelf, steps, memory)
        first_scores = first_scores or scored
        if step is None:
            break
        steps.append(step)
        current = step.after
        told(f"looking at {len(steps)} found so far again{_after(steps)}")
        steps, current = _exchanged(steps, base, current, shelf, memory)
    if steps and (not adequacy.adequate(current) or _doubled(steps)):
        told(f"trying pairs{_after(steps)}")
        steps, current = _paired(steps, base, current, shelf, memory)
    told(f"refitting what ranks below{_after(steps)}")
    steps, current = _pruned(steps, base, current)
    steps = _together(_on_all_rows(steps, whole), whole)
    trained = fitting.fit(whole.parts, steps[-1].after.state if steps else whole.state, use=base.use)
    return _concluded(whole, trained, steps, first_scores, evidence.imported)


def misread(found: Fit) -> bool:
    """Whether a manifest has axes otherwise than its numbers, for which an effect would be blamed."""
    return any(one.misread for part in found.parts for one in part.faults)


def _after(steps: Sequence[Step]) -> str:
    return f" (found: {', '.join(step.taken.name for step in steps)})" if steps else ""


def _training(evidence: Evidence, whole: Fit) -> Mask | None:
    """Rows that effects are chosen by: those not held out; all of them (None) where those could not tell a thing."""
    training = evidence.training
    kept = int(np.count_nonzero(training & np.concatenate([part.counted for part in whole.parts])))
    return training if whole.layout.size + adequacy.FEWEST_HELD <= kept < whole.count else None


def _step(
    evidence: Evidence, current: Fit, shelf: Mapping[str, Effect], before: Sequence[Step], memory: search.Memory
) -> tuple[Step | None, tuple[Score, ...]]:
    there = {term.key for term in current.state.terms if not term.prior}
    for finding in instruments.findings(evidence, shelf, there):
        if finding.evidence > FINDING:
            return _by_test(evidence, current, finding), ()
    terms = search.possible(shelf, current)
    scored = search.scores(current, terms, memory)
    elsewhere = search.from_data_sheet(current, terms, REFITS) if instruments.implausible(current) else []
    least = max([QUARTER * adequacy.excess(current), *(SHARE * step.taken.gain for step in before)])
    choices = _choices(current, scored, least=least if adequacy.adequate(current) else 0.0, elsewhere=elsewhere)
    choices = _with_narrower(current, shelf, choices, scored[0].gain if scored else 0.0, memory)
    if not choices or choices[0].merit <= 0.0:
        return None, tuple(scored)
    first = choices[0]
    if first.gain < least and not (first.gain > QUARTER * adequacy.excess(current) and _leaves_noise(first)):
        return None, tuple(scored)
    return _taken(current, choices), tuple(scored)


def _with_narrower(
    current: Fit, shelf: Mapping[str, Effect], choices: list[Choice], most: float, memory: search.Memory
) -> list[Choice]:
    """Choices, and with them those that act on one channel or one unit, where the data do not exclude such a one beside
    those that act on every channel, of which a score promises no more than `most`.

    What all have promises less in a few: an effect is only taken to be in a few if that does clearly better.
    """
    terms = search.alone(shelf, current)
    scored = search.scores(current, terms, memory) if terms else []
    if not scored or scored[0].gain <= most - CLASS:
        return choices
    everywhere = {(one.name, one.term.on): one.merit for one in choices}
    narrow = [
        one for one in _choices(current, scored)
        if one.merit > max(everywhere.get((one.name, one.term.on), 0.0), 0.0) + CLASS
    ]  # fmt: skip
    best = max((one.merit for one in choices), default=0.0)
    if not narrow or max(one.merit for one in narrow) <= best - CLASS:
        return choices
    return _weighed([*narrow, *choices])


def _weighed(choices: Sequence[Choice], certain: float | None = None) -> list[Choice]:
    """Choices with their probabilities, the most probable of those that are worth anything first.

    Whether any of them is there is a matter of merits against chance (`certain`: the merit that counts for it, that of
    the best), which of them it is of how they stand.
    """
    by_merit, best = _weights(choices, [one.merit for one in choices])
    certain = best if certain is None else certain
    chance_ = math.exp(-0.5 * max(min(certain, MOST_CERTAIN), -MOST_CERTAIN))
    there = sum(by_merit) / (sum(by_merit) + chance_)
    shares, _ = _weights(choices, [one.standing for one in choices])
    total = sum(shares) or 1.0
    made = [replace(one, probability=there * share / total) for one, share in zip(choices, shares, strict=True)]
    return sorted(made, key=lambda one: (one.merit > 0.0, one.standing), reverse=True)


def _weights(choices: Sequence[Choice], values: Sequence[float]) -> tuple[list[float], float]:
    """Likelihoods relative to that of the largest value, χ², and that value."""
    most = max(max(values), -MOST_CERTAIN)
    return [math.exp(0.5 * (at - most) / one.doubt) for one, at in zip(choices, values, strict=True)], most


def _leaves_noise(choice: Choice) -> bool:
    """Whether nothing is left beside it: then what it removes is no imprecision of an earlier effect."""
    return choice.full and choice.fit is not None and adequacy.adequate(choice.fit)


def _taken(current: Fit, choices: Sequence[Choice]) -> Step:
    """The step that the best of the choices makes, with those that the data do not tell from it."""
    best = _polished(choices[0])
    assert best.fit is not None
    after = best.fit
    # where more than noise is left, a difference counts for less (Birge)
    apart = CLASS * max(1.0, after.chi2 / max(after.count, 1))
    near = [
        k for k, one in enumerate(choices)
        if k and one.possible and _behind(one, best) < apart * one.doubt
    ]  # fmt: skip
    near = near[: LARGEST_CLASS - 1]
    members = (best, *(_polished(choices[k]) for k in near))
    rest = (one for k, one in enumerate(choices) if k and k not in near)
    return Step(best, members, (*members, *rest), current, after)


def _behind(one: Choice, best: Choice) -> float:
    """By how much of χ² or merit, whichever is less, a choice is worse than the best.

    One that contains the best always removes as much: it must be worth its further numbers.
    """
    more = best.name in one.term.effect.contains and (one.term.on, one.term.only) == (best.term.on, best.term.only)
    return best.merit - one.merit if more else min(best.gain - one.gain, best.merit - one.merit)


def _exchanged(
    steps: list[Step], base: Fit, current: Fit, shelf: Mapping[str, Effect], memory: search.Memory
) -> tuple[list[Step], Fit]:
    """Every earlier step looked at again beside the later ones: another effect may now do better in its place.

    What was taken first was the best alone; two effects together need not contain it.
    """
    for place in range(len(steps) - 1):
        old = steps[place].taken
        if old.term.effect.looks_in:
            continue
        others = [one.taken.term for k, one in enumerate(steps) if k != place]
        without = _with_terms(base, [_at(current, term) for term in others])
        scored = search.scores(without, search.possible(shelf, without), memory)
        choices = _choices(without, scored)
        was = without.objective - current.objective - chance_of(old.term, base) - 2.0 * old.term.effect.rarity
        if choices and choices[0].name != old.name and choices[0].merit > was + CLASS:
            step = _taken(without, choices)
            steps, current = _rebuilt(base, [*steps[:place], step, *steps[place + 1 :]]), step.after
    return steps, current


def _doubled(steps: Sequence[Step]) -> bool:
    """Whether two of the dynamics were taken: one may only mend what another is wrong in."""
    return sum(step.taken.term.effect.stage == "dynamics" for step in steps) > 1


def _paired(
    steps: list[Step], base: Fit, current: Fit, shelf: Mapping[str, Effect], memory: search.Memory
) -> tuple[list[Step], Fit]:
    """The best pair that begins with one of the first step's other choices, if it does better than all steps so far.

    The best effect alone may be a bad half of two, and no exchange of one at a time leads away from it.
    """
    best: tuple[Choice, Fit, list[Choice]] | None = None
    lowest = current.objective + sum(_price(step.taken) for step in steps) - CLASS
    for choice in [one for one in steps[0].others if one.fit is not None and one.possible][1:PAIRS]:
        if not _has_numbers(base, choice.term):
            continue  # without what it was fitted beside it is beyond all that can be reckoned with
        first = _with_terms(base, [choice.term])
        seconds = _choices(first, search.scores(first, search.possible(shelf, first), memory), PAIR_REFITS)
        if not seconds or seconds[0].merit <= 0.0:
            continue
        whole = first.objective - seconds[0].gain + _price(choice) + _price(seconds[0])
        if whole < lowest:
            best, lowest = (choice, first, seconds), whole
    if best is None:
        return steps, current
    chosen, other = best[0].term, best[2][0].term
    made = [_alone(_with_terms(base, [other]), chosen, shelf, memory), _alone(best[1], other, shelf, memory)]
    return _rebuilt(base, made), made[1].after


def _has_numbers(base: Fit, term: Term) -> bool:
    """Whether a model with this term, as it is, predicts numbers."""
    state = replace(base.state, terms=(*base.state.terms, term))
    return bool(np.isfinite(fitting.residual(base.parts, state, base.use)).all())


def _alone(without: Fit, term: Term, shelf: Mapping[str, Effect], memory: search.Memory) -> Step:
    """The step that leads from a model without a term to one with it, and what else could be in its place."""
    choices = _choices(without, search.scores(without, search.possible(shelf, without), memory))
    mine = [one for one in choices if (one.name, one.term.on, one.term.only) == (term.effect.name, term.on, term.only)]
    mine = mine or [_chosen(without, term)]  # by itself it may be none of those that are worth a refit
    return _taken(without, [*mine, *(one for one in choices if one not in mine)])


def _chosen(without: Fit, term: Term) -> Choice:
    """A term that was decided on, with what it removes."""
    made = _with_terms(without, [term])
    gain = without.objective - made.objective
    merit = gain - chance_of(term, without) - 2.0 * term.effect.rarity
    return Choice(made.state.terms[-1], made.u(len(made.state.terms) - 1), gain, merit, 1.0, term.effect.missing, made)


def _with_terms(base: Fit, terms: Sequence[Term]) -> Fit:
    return fitting.fit(base.parts, replace(base.state, terms=(*base.state.terms, *terms)), use=base.use)


def _at(current: Fit, term: Term) -> Term:
    """A term where a fit has it now."""
    return next((t for t in current.state.terms if not t.prior and t.key == term.key), term)


def _rebuilt(base: Fit, steps: Sequence[Step]) -> list[Step]:
    """The ladder of these steps, each with the fits before and after it."""
    made: list[Step] = []
    before = base
    for step in steps:
        after = _with_terms(before, [step.taken.term])
        made.append(replace(step, before=before, after=after))
        before = after
    return made


def _polished(choice: Choice) -> Choice:
    """With all columns worked out afresh: a quick refit does not see what the effect itself uncovers of the model's
    own parameters, and states too small an uncertainty.
    """
    assert choice.fit is not None
    if choice.full:
        return choice
    made = fitting.fit(choice.fit.parts, choice.fit.state, use=choice.fit.use)
    gain, place = choice.gain + choice.fit.objective - made.objective, len(made.state.terms) - 1
    return replace(choice, term=made.state.terms[place], gain=gain, fit=made, u=made.u(place), full=True)


def _by_test(evidence: Evidence, current: Fit, finding: Finding) -> Step:
    state = replace(current.state, terms=(*current.state.terms, finding.term))
    after = fitting.fit(current.parts, state, use=current.use)
    gain = current.objective - after.objective
    merit = min(finding.evidence - FINDING, MOST_CERTAIN)
    choice = Choice(finding.term, finding.u, max(gain, finding.evidence), finding.evidence,
                    1.0 / (1.0 + math.exp(-0.5 * merit)), f"{finding.because}; {ALONE}", after)  # fmt: skip
    return Step(choice, (choice,), (choice,), current, after)


def chance(score: Score | Candidate) -> float:
    """χ² that a candidate of this size and with so many starts may gain by chance.

    What only shapes it is fitted too once it has a size: starts that stand for that are not paid twice.
    """
    shapes = sum(one.shape for one in score.term.effect.coordinates)
    unseen = min(shapes, max(len(fitting.fitted(score.term)) - score.size, 0))
    choice = max(PER_START * math.log(score.steps), PER_COORDINATE * unseen)
    return CHANCE + PER_COORDINATE * (score.size - 1) + choice + _of_ways(score.ways)


def _of_ways(ways: int) -> float:
    """χ² that the best of so many places may gain more than one."""
    return PER_WAY * math.log(ways)


def _merits(current: Fit, refits: Sequence[Candidate], least: Fit) -> Iterator[tuple[float, float]]:
    """χ² that each removes, less what chance gives and how unusual it and its size are; what cannot be has none.

    The second number is that with the doubt of noise which is louder just where it acts. One that this does not leave
    above nought counts no more than so; among the others the doubt says nothing of which it is.
    """
    for one in refits:
        unusual = search.improbability(one.term, one.u) + 2.0 * one.term.effect.rarity
        doubtful = one.gain - chance(one) * _unevenness(current, one.fit, least) - unusual
        yield (one.gain - chance(one) - unusual if doubtful > 0.0 else doubtful), doubtful


def _unevenness(before: Fit, after: Fit, least: Fit) -> float:
    """How many times more than χ² of even noise chance may give, by the parts in which one fit moves from another.

    Noise is what the best of all candidates leaves: before one is taken, what the truth explains stands just where it
    acts, and the truth would be the most doubtful of all.
    """
    offsets, change = after.offsets(), before.left - after.left
    size, found = 0.0, 0.0
    for part, first, end in zip(after.parts, offsets, offsets[1:], strict=False):
        weight = float(change[first:end] @ change[first:end])
        factor = part.unevenness(change[first:end], least.left[first:end])
        size, found = size + weight, found + weight * factor
    return found / size if size > 0.0 else 1.0


def _price(one: Choice) -> float:
    """χ² that an effect must be worth: what chance gives, and how unusual it and its size are."""
    assert one.fit is not None
    return chance_of(one.term, one.fit) + 2.0 * one.term.effect.rarity + search.improbability(one.term, one.u)


def chance_of(term: Term, found: Fit) -> float:
    """The same for a term that was refitted from one start, among the channels of a fit."""
    ways = _of_ways(search.ways_of(found.parts, term))
    return CHANCE + PER_COORDINATE * (len(fitting.fitted(term)) - 1) + ways


def _choices(
    current: Fit, scored: Sequence[Score], most: int = REFITS, least: float = 0.0, elsewhere: Sequence[Candidate] = ()
) -> list[Choice]:
    """Refits of the best, most probable first, with probabilities among them and against chance.

    Where a step must be worth `least` of χ², none is refitted if no score comes near it. Those made `elsewhere` count
    where they leave less.
    """
    top = max((score.gain for score in scored), default=0.0)
    if top < PROMISE * least and not elsewhere:
        return []
    chosen = [score for score in scored if score.gain > max(LIKELY * chance(score), 0.02 * top)]
    refits = _better(search.best(current, chosen[:most]), elsewhere)
    if not refits:
        return []
    least_left = min((current, *(one.fit for one in refits)), key=lambda fit: fit.objective)
    merits = list(_merits(current, refits, least_left))
    (_, certain), best = max(zip(merits, refits, strict=True), key=lambda pair: pair[0])
    made = [
        Choice(one.term, one.u, one.gain, merit, 0.0, one.term.effect.missing, one.fit, one.full,
               _unevenness(best.fit, one.fit, least_left), search.refund(one.term, one.u, PER_COORDINATE))
        for one, (merit, _) in zip(refits, merits, strict=True)
    ]  # fmt: skip
    return _weighed(made, certain)


def _better(refits: Sequence[Candidate], elsewhere: Sequence[Candidate]) -> list[Candidate]:
    """Of two refits of one candidate the one that leaves less, best first."""
    made: dict[str, Candidate] = {}
    for one in (*refits, *elsewhere):
        if one.term.key not in made or one.gain > made[one.term.key].gain:
            made[one.term.key] = one
    return sorted(made.values(), key=lambda one: -one.gain)


def _pruned(steps: list[Step], base: Fit, current: Fit) -> tuple[list[Step], Fit]:
    """Without steps that the later ones have made needless."""
    before = len(steps)
    for place in range(len(steps) - 2, -1, -1):
        step = steps[place]
        if step.taken.term.effect.looks_in:
            continue
        terms = tuple(t for t in current.state.terms if t.prior or t.key != step.taken.term.key)
        without = fitting.fit(current.parts, replace(current.state, terms=terms), use=current.use)
        if without.objective - current.objective < CHANCE:
            steps = [one for one in steps if one is not step]
            current = without
    return steps if len(steps) == before else _rebuilt(base, steps), current


def _on_all_rows(steps: Sequence[Step], base: Fit) -> list[Step]:
    """The ladder of these steps fitted to everything."""
    made: list[Step] = []
    for step in steps:
        before = made[-1].after if made else base
        members = [_refitted(before, one) for one in step.members]
        if len(steps) == 1:
            members = _reordered(members)
        assert members[0].fit is not None
        left = (one for one in step.others if one not in step.members)
        made.append(Step(members[0], tuple(members), (*members, *left), before, members[0].fit))
    return made


def _reordered(members: Sequence[Choice]) -> list[Choice]:
    """A class by merit on all rows, with the probability that it had as a whole.

    Which effects form it was decided without the rows held out; which of them comes first may lean on all.
    """
    if len(members) < 2 or members[0].term.effect.looks_in:
        return list(members)
    total = sum(one.probability for one in members)
    weights, _ = _weights(members, [one.standing for one in members])
    shared = [
        replace(one, probability=total * weight / sum(weights)) for one, weight in zip(members, weights, strict=True)
    ]
    return sorted(shared, key=lambda one: -one.standing)


def _refitted(before: Fit, choice: Choice) -> Choice:
    """A choice fitted to everything beside what was there before, with what it removes there."""
    made = _with_terms(before, [choice.term])
    if choice.term.effect.looks_in:  # its merit is the evidence of that test
        return replace(choice, fit=made, gain=max(before.objective - made.objective, choice.merit))
    if choice.term.effect.kinked:  # columns are chords, and a descent from elsewhere may end beside the lowest
        nothing = choice.term.moved(**dict.fromkeys(choice.term.at, 0.0))
        anew = search.refitted(before, search.scores(before, [nothing])[0]).fit
        made = min(made, fitting.fit(before.parts, anew.state), key=lambda one: one.objective)
    made = _less_astray(before, choice, made)
    gain = before.objective - made.objective
    merit = choice.merit + gain - choice.gain
    term, u = made.state.terms[-1], made.u(len(made.state.terms) - 1)
    refund = search.refund(term, u, PER_COORDINATE)
    return replace(choice, fit=made, gain=gain, merit=merit, term=term, u=u, refund=refund)


def _less_astray(before: Fit, choice: Choice, made: Fit) -> Fit:
    """The fit that was made, or where it removes little of what the choice did, one from where the choice had come to:
    what a zero and a drift share between them lies anywhere, and one of both alone is far from any model.
    """
    there = choice.fit
    if there is None or before.objective - made.objective > search.SHORT * choice.gain:
        return made
    keys = [term.key for term in there.state.terms]
    if keys != [term.key for term in (*before.state.terms, choice.term)]:
        return made
    anew = fitting.fit(before.parts, there.state, use=before.use)
    return anew if anew.objective < made.objective else made


def _together(steps: Sequence[Step], base: Fit) -> list[Step]:
    """Every step's effect as the final fit has it, and its rivals as a fit beside all other steps' effects has them.

    What a step found alone has taken on some of what later steps explain.
    """
    if len(steps) < 2:
        return list(steps)
    final = steps[-1].after
    return [
        _beside(step, [_at(final, other.taken.term) for other in steps if other is not step], base, final)
        for step in steps
    ]


def _beside(step: Step, others: Sequence[Term], base: Fit, final: Fit) -> Step:
    made = {}
    for one in [*step.members, *step.excluded]:
        taken = one is step.taken
        made[id(one)] = _as_in(final if taken else _with_terms(base, [*others, one.term]), one)
    again = tuple(made.get(id(one), one) for one in step.others)
    return replace(step, taken=made[id(step.taken)], members=tuple(made[id(one)] for one in step.members), others=again)


def _as_in(whole: Fit, choice: Choice) -> Choice:
    """A choice with the coordinates and uncertainties that a fit has found; those of a test of its own stay."""
    places = [n for n, term in enumerate(whole.state.terms) if not term.prior and term.key == choice.term.key]
    if choice.term.effect.looks_in or not places:
        return choice
    return replace(choice, term=whole.state.terms[places[0]], u=whole.u(places[0]), whole=whole)


def _changing(base: Fit, final: Fit, steps: Sequence[Step]) -> bool:
    """Whether something changes in the course of a record that no effect explains: with all steps taken, or by itself
    and without them so well that the data exclude them beside it. An effect of time itself explains nearly all of it.
    """
    standing = adequacy.unsteady(final)
    if not steps:
        return bool(standing)
    gained = base.objective - final.objective
    worth = gained - sum(_price(step.taken) for step in steps)
    rival = max((one.chi2 for one in adequacy.unsteady(base)), default=-math.inf) - CHANCE
    return rival > worth + CLASS or max((one.chi2 for one in standing), default=-math.inf) > SHARE * gained


def _ahead(base: Fit, final: Fit, steps: Sequence[Step], *, plain: bool = False) -> float:
    """How much more of χ² one formula of the library alone (a `plain` one has a single coefficient) takes away than all
    effects that were taken, in units in which more than one is clearly more, and less than minus one clearly less.

    No group of rows may stand out though it is more: where noise is known from the misfit alone, it holds what a wrong
    law leaves.
    """
    found = describe.alone(base, steps[0].taken.term.only, coefficients=1 if plain else 2)
    if found is None:
        return -math.inf
    more = found.gain - (base.objective - final.objective)
    return more / (CLASS * max(1.0, _unevenness(final, found.fit, found.fit)))


def _shaped(base: Fit, final: Fit, steps: Sequence[Step]) -> list[Step]:
    """The steps; an effect of several coefficients that was taken alone is no likelier than evens where a formula of
    one does as well: a zero that drifts straight on is no exponential whose time constant is far longer.
    """
    (step,) = steps
    if len(fitting.fitted(step.taken.term)) < 2 or _ahead(base, final, steps, plain=True) < -1.0:
        return [step]
    members = [replace(one, probability=min(one.probability, EVENS)) for one in step.members]
    return [replace(step, taken=members[0], members=tuple(members), others=(*members, *step.others[len(members) :]))]


def _concluded(base: Fit, trained: Fit, steps: Sequence[Step], scored: tuple[Score, ...], imported: bool) -> Diagnosis:
    final = steps[-1].after if steps else base
    before, after = adequacy.excess(base), adequacy.excess(final)
    held = adequacy.unseen(trained)
    fine = not adequacy.standing([*adequacy.groups(trained), *held])
    if imported and steps:  # references of others are less perfect: no more is left than the steps' own error
        fine = fine or after < SHARE * (base.objective - final.objective)
    explained = 1.0 - after / before if before > 0.0 else 1.0
    steps = _shaped(base, final, steps) if imported and len(steps) == 1 else steps
    beaten = imported and len(steps) > 0 and _ahead(base, final, steps) > 1.0
    verdict: Verdict
    if misread(final):
        verdict = "undecided"
    elif not fine or _changing(base, final, steps) or beaten:
        verdict = "unlisted"
    elif not held:
        verdict = "undecided"
    elif not steps:
        doubtful = adequacy.untold(final) or any(not one.accepted for part in final.parts for one in part.faults)
        verdict = "undecided" if doubtful else "adequate"
    else:
        verdict = "missing"
    # a gain that no data sheet allows may only make up for what was missing: it counts beside that
    misplaced = tuple(instruments.implausible(final))
    return Diagnosis(verdict, tuple(steps), base, final, scored, explained, misplaced, trained, tuple(held))
