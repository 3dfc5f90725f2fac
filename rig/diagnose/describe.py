"""What an effect that is on no shelf looks like: where it shows, how it grows, and a formula to try as a term.

A small library of formulas is scored against what the model leaves over, alone, in pairs and with more waves, and the
best is refitted with all parameters of the model. All of that is done on the rows that are not held out; the others
judge it, and what explains nothing of them is not offered. What is offered is then fitted to everything, in the way in
which `rig add` does it, and said with the errors that `rig add` will find. Exponents are read from what is left once
the formula's term is taken out again: the model's own parameters stay where the formula has put them, so that they
hide nothing of it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from rig.diagnose import search
from rig.diagnose.search import Candidate, Score
from rig.fit import adequacy
from rig.fit import fit as fitting
from rig.fit.adequacy import Group
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit, State
from rig.fit.quality import Errors, errors_of, heldout_rows
from rig.formula import MOST, formula_effect, meets, parse, term_of
from rig.model import Quantity, Term
from rig.motion import Array
from rig.parts.formulas import ANYWHERE
from rig.parts.part import Part
from rig.parts.remainder import Growth, Prediction

Parity = Literal["even", "odd", "both", "unseen"]
CHANCE = 25.0  # χ² that the best of the library gains by chance
WORTH = 0.01  # of the first term's gain: a second must bring more
PAIRED = 6  # best single terms that are tried in pairs
REFITS = 3
HELD_CHANCE = 9.0  # χ² that held-out rows hardly lose by chance
PROPORTION = 0.25  # of what as many fitted rows lose
REPAIRED = 1.1  # χ²/n of held-out rows: little more than noise
SHARE = 0.1  # of the strongest order's gain
WHOLE = 0.95  # share of the excess: a formula that explains as much is taken as the truth
COMPETES = 0.5  # of the best gain: a family of terms that does worse does not describe it
SEEN = 3.0  # standard deviations
SLACK = 0.05  # relative: no power law is exact
FLAT = 0.1  # exponent of what does not depend on something
PURE = 0.85  # share of the squares that makes a parity
TIMES = (20.0, 60.0, 200.0, 600.0)  # s


@dataclass(frozen=True)
class Description:
    """An unlisted effect in so far as the data show it.

    `domains` (lines, bands) and `channels` that stand out of the noise, most so first. `exponents`: powers of
    'frequency' and 'level' (shaker) or 'rate' (turntable) by which it grows. `orders` per revolution. `parity`: even if
    it stays the same when input or sense are reversed, odd if it changes its sign. `growth`: share of the formula's
    gain that a term in time alone would have. `formula`, `on`, `starts` and `only` (its channels, () for all) go to
    `rig.formula.formula_effect`; '' without a formula.
    `term` is the formula refitted, `u` standard uncertainties of its coefficients, `explained` the share of the excess
    over the noise that it takes away. `held`: χ²/n of the rows held out without and with it, fitted to the others.
    `before` and `after` are the errors that it changes when it is added.
    """

    domains: tuple[str, ...]
    channels: tuple[str, ...]
    exponents: Mapping[str, float]
    orders: tuple[int, ...]
    parity: Parity
    growth: float
    formula: str
    on: Quantity | None
    starts: Mapping[str, tuple[float, ...]]
    only: tuple[str, ...]
    term: Term | None
    u: Mapping[str, float]
    gain: float
    explained: float
    words: tuple[str, ...]
    fit: Fit | None = field(default=None, repr=False)
    held: tuple[float, float] | None = None
    before: Errors | None = field(default=None, repr=False)
    after: Errors | None = field(default=None, repr=False)

    @property
    def repairs(self) -> bool:
        """Whether rows that it was not fitted to are noise with it."""
        return self.held is not None and self.held[1] <= REPAIRED


@dataclass(frozen=True)
class _Tried:
    """One formula of the library for channels of one quantity, and its score."""

    shapes: tuple[str, ...]
    on: Quantity
    only: tuple[str, ...]
    score: Score

    @property
    def gain(self) -> float:
        return self.score.gain


def describe(evidence: Evidence, whole: Fit) -> Description:
    """Describe what a model of this evidence leaves over; `whole` is its fit to all rows."""
    fit = fitting.fit(whole.parts, whole.state, use=evidence.training)
    standing = [one for one in adequacy.standing(adequacy.groups(fit)) if one.count > 1]
    singles = sorted(_singles(fit), key=lambda one: -one.gain)
    chosen, found = _chosen(fit, singles)
    some = _channels_alone(evidence, standing)
    if some and _explained(fit, found) < WHOLE:
        theirs = sorted(_singles(fit, some), key=lambda one: -one.gain)
        alone = _chosen(fit, theirs)
        if alone[1] is not None and (found is None or alone[1].gain > found.gain + CHANCE):
            (chosen, found), singles = alone, theirs
    if found is None or found.gain < CHANCE:
        chosen, found = None, None
    held = _held(fit, found) if found is not None else None
    made = Description(
        domains=tuple(dict.fromkeys(g.domain for g in standing)),
        channels=tuple(dict.fromkeys(g.channel for g in standing)),
        exponents=_exponents(fit, found, standing),
        orders=_orders(singles),
        parity=_parity(fit, found, standing),
        growth=_growth(singles, chosen),
        formula="", on=None, starts={}, only=(), term=None, u={}, gain=0.0, explained=_explained(fit, found), words=(),
        held=None if held is None else (held.before, held.after),
    )  # fmt: skip
    if chosen is not None and found is not None and held is not None and held.explains(found.gain):
        made = _offered(evidence, whole, chosen, made)
    return replace(made, words=tuple(_words(made, standing)))


def alone(fit: Fit, only: tuple[str, ...] = (), *, coefficients: int = 2) -> Candidate | None:
    """The formula of one term and up to so many coefficients, on all channels or on `only` some, that by itself takes
    most away of what a model leaves, refitted; None if none does.
    """
    singles = [*_singles(fit), *(_singles(fit, only) if only else ())]
    singles = [one for one in singles if one.gain > CHANCE and 1 + len(_starts(one.shapes)) <= coefficients]
    scored = sorted(singles, key=lambda one: -one.gain)[:REFITS]
    return max((search.refitted(fit, one.score) for one in scored), key=lambda one: one.gain, default=None)


@dataclass(frozen=True)
class _Held:
    """χ² per row of the rows held out without and with a formula that was fitted to the others; `fitted` is theirs."""

    before: float
    after: float
    rows: int
    fitted: int

    def explains(self, gain: float) -> bool:
        """Whether they lose so much of χ² as by chance they do not, and not much less in proportion than the others."""
        fallen = self.rows * (self.before - self.after)
        return fallen > max(HELD_CHANCE, PROPORTION * gain * self.rows / self.fitted)


def _held(fit: Fit, found: Candidate) -> _Held | None:
    """None where too few rows are held out to judge."""
    out = heldout_rows(fit)
    rows = int(np.count_nonzero(out))
    if rows < adequacy.FEWEST_HELD:
        return None
    polished = fitting.fit(fit.parts, found.fit.state, use=fit.use)
    before, after = (fitting.squares(fitting.residual(fit.parts, one.state, out)) for one in (fit, polished))
    return _Held(before / rows, after / rows, rows, fit.count)


def _offered(evidence: Evidence, whole: Fit, chosen: _Tried, made: Description) -> Description:
    """With the formula as `rig add` will fit it to everything."""
    nothing = _term(chosen.shapes, chosen.on, chosen.only)
    again = search.refitted(whole, search.scores(whole, [nothing])[0])
    fit = fitting.fit(whole.parts, again.fit.state)
    return replace(
        made, formula=_text(chosen.shapes), on=chosen.on, starts=_starts(chosen.shapes), only=chosen.only,
        term=fit.state.terms[-1], u=fit.u(len(fit.state.terms) - 1), gain=whole.objective - fit.objective, fit=fit,
        before=errors_of(evidence, whole), after=errors_of(evidence, fit),
    )  # fmt: skip


def _explained(fit: Fit, found: Candidate | None) -> float:
    before = adequacy.excess(fit)
    return 1.0 - adequacy.excess(found.fit) / before if found and before > 0.0 else 0.0


def library(parts: Sequence[Part]) -> list[str]:
    """Shapes that are tried with these parts, without their coefficient."""
    return list(dict.fromkeys([*ANYWHERE, *(shape for part in parts for shape in part.formulas)]))


def _text(shapes: Sequence[str]) -> str:
    """The shapes with a coefficient each, as one formula."""
    alone = len(shapes) == 1
    return " + ".join(f"k{'' if alone else n}*{shape.format(tau='tau')}" for n, shape in enumerate(shapes, 1))


def _starts(shapes: Sequence[str]) -> dict[str, tuple[float, ...]]:
    return {"tau": TIMES} if any("{tau}" in shape for shape in shapes) else {}


def _term(shapes: Sequence[str], on: Quantity, only: tuple[str, ...]) -> Term:
    return term_of(formula_effect("unlisted", _text(shapes), on=on, starts=_starts(shapes), channels=only))


def _channels_alone(evidence: Evidence, standing: Sequence[Group]) -> tuple[str, ...]:
    """Channels that stand out if others do not."""
    every = {name for part in evidence.parts for name in part.channels.names}
    found = {one.channel for one in standing}
    return tuple(sorted(found)) if found and found != every else ()


def _singles(fit: Fit, only: tuple[str, ...] = ()) -> Iterator[_Tried]:
    rates = {bool(r) for part in fit.parts for r in part.channels.rates}
    for on in _quantities(rates):
        shapes = [(shape,) for shape in library(fit.parts)]
        yield from _scored(fit, shapes, on, only)


def _quantities(rates: set[bool]) -> list[Quantity]:
    both: tuple[tuple[bool, Quantity], ...] = ((False, "acceleration"), (True, "rate"))
    return [on for rate, on in both if rate in rates]


def _scored(fit: Fit, shapes: Sequence[tuple[str, ...]], on: Quantity, only: tuple[str, ...]) -> list[_Tried]:
    made = {one: _term(one, on, only) for one in shapes if meets(_text(one))}
    scores = search.scores(fit, made.values())
    by_effect = {term.effect: one for one, term in made.items()}
    return [_Tried(by_effect[score.term.effect], on, only, score) for score in scores]


def _chosen(fit: Fit, singles: Sequence[_Tried]) -> tuple[_Tried | None, Candidate | None]:
    """The best formula of one term, or of two if the second is worth it, and more waves beside waves, refitted."""
    if not singles:
        return None, None
    one = _best(fit, singles[:REFITS])
    two = _best(fit, sorted(_pairs(fit, singles), key=lambda tried: -tried.gain)[:REFITS])
    if two is not None and one is not None and two[1].gain - one[1].gain > max(CHANCE, WORTH * one[1].gain):
        return _with_more_waves(fit, two, singles)
    return one or (None, None)


def _with_more_waves(fit: Fit, found: tuple[_Tried, Candidate], singles: Sequence[_Tried]) -> tuple[_Tried, Candidate]:
    """A wave of the angle with waves of other orders, each by sine and cosine, as long as they are worth it."""
    while len(found[0].shapes) + 2 <= MOST and all("theta" in one for one in found[0].shapes):
        there = found[0].shapes
        waves = [one.shapes[0].replace("sin(", "cos(") for one in singles if one.on == found[0].on]
        orders = [one for one in dict.fromkeys(waves) if "cos(" in one]
        pairs = [(one, one.replace("cos(", "sin(")) for one in orders]
        more = [pair for pair in pairs if not set(pair) <= set(there)][:PAIRED]
        sets = [tuple(dict.fromkeys((*there, *pair))) for pair in more]
        tried = sorted(_scored(fit, sets, found[0].on, found[0].only), key=lambda one: -one.gain)
        best = _best(fit, tried[:1])
        if best is None or best[1].gain - found[1].gain < max(CHANCE, WORTH * found[1].gain):
            break
        found = best
    return found


def _best(fit: Fit, tried: Sequence[_Tried]) -> tuple[_Tried, Candidate] | None:
    refits = [(one, search.refitted(fit, one.score)) for one in tried if one.gain > 0.0]
    return max(refits, key=lambda pair: pair[1].gain, default=None)


def _pairs(fit: Fit, singles: Sequence[_Tried]) -> list[_Tried]:
    """Pairs of the best terms of one quantity, and of sines with their cosines."""
    on = singles[0].on
    best = [one.shapes[0] for one in singles if one.on == on][:PAIRED]
    pairs = list(itertools.combinations(best, 2))
    pairs += [(shape, shape.replace("sin(", "cos(")) for shape in best if "sin(" in shape]
    pairs += [(shape.replace("cos(", "sin("), shape) for shape in best if "cos(" in shape]
    one_time = [
        pair for pair in dict.fromkeys(tuple(sorted(pair)) for pair in pairs) if not all("{tau}" in s for s in pair)
    ]
    return _scored(fit, [(a, b) for a, b in one_time], on, singles[0].only)


def _orders(singles: Sequence[_Tried]) -> tuple[int, ...]:
    """Orders per revolution that stand out, strongest first, if waves of the angle describe what is left."""
    gains: dict[int, float] = {}
    for one in singles:
        if "theta" in one.shapes[0]:
            order = int(one.shapes[0].partition("(")[2].partition("*")[0])
            gains[order] = max(gains.get(order, 0.0), one.gain)
    most = max(gains.values(), default=0.0)
    if most < max(CHANCE, COMPETES * singles[0].gain):
        return ()
    strong = [order for order, gain in gains.items() if gain > max(CHANCE, SHARE * most)]
    return tuple(sorted(strong, key=lambda order: -gains[order]))


def _growth(singles: Sequence[_Tried], chosen: _Tried | None) -> float:
    timed = [one.gain for one in singles if "t" in parse(_text(one.shapes)).signals]
    return min(1.0, max(timed, default=0.0) / chosen.gain) if chosen and chosen.gain > 0.0 else 0.0


# exponents and parity


def _bared(fit: Fit, found: Candidate | None) -> State:
    """Parameters of the model as they are beside a formula that explains everything, without the formula."""
    if found is None or _explained(fit, found) < WHOLE:
        return fit.state
    state = found.fit.state
    return replace(state, terms=tuple(term for term in state.terms if term.effect is not found.term.effect))


def _seen(
    fit: Fit, found: Candidate | None, standing: Sequence[Group]
) -> Iterator[tuple[Part, Group, int, Prediction]]:
    """Groups of rows that stand out, each with its part, its row there, and what the model says beside the formula."""
    state, numbers = _bared(fit, found), {part.name: n for n, part in enumerate(fit.parts)}
    said = {name: fit.said_of(number, state) for name, number in numbers.items()}
    for group in standing:
        part = fit.parts[numbers[group.part]]
        yield part, group, part.row_names.index(group.channel), said[group.part]


def _exponents(fit: Fit, found: Candidate | None, standing: Sequence[Group]) -> dict[str, float]:
    """Powers in the clearest rows of each experiment that are a power of something."""
    grown: dict[str, Growth] = {}
    for part, group, row, said in _seen(fit, found, standing):
        if part.experiment not in grown and (one := part.growth(group.domain, row, said)) is not None:
            grown[part.experiment] = one
    order = [one for one in dict.fromkeys(part.experiment for part in fit.parts) if one in grown]
    powers = [_powers(grown[one]) for one in order]
    return {name: value for one in powers for name, value in one.items()}


def _powers(grown: Growth) -> dict[str, float]:
    """Exponents of what varies by a factor of 1.3 at least: size² = (c·Π xᵖ)² + noise², give or take some per cent."""
    from scipy.optimize import least_squares

    size, noise = grown.size, grown.noise
    varying = {
        name: np.log(one) for name, one in grown.against.items() if len(one) > 2 and one.max() > 1.3 * one.min() > 0.0
    }
    seen = size > SEEN * noise
    if np.count_nonzero(seen) < len(varying) + 3 or not varying:
        return {}
    columns = np.column_stack([np.ones(len(size)), *(one - one.mean() for one in varying.values())])
    start = np.linalg.lstsq(columns[seen], np.log(size[seen]), rcond=None)[0]
    spread = np.hypot(noise, SLACK * size)

    def missed(powers: Array) -> Array:
        made = np.exp(np.clip(columns @ powers, -60.0, 60.0))
        return np.asarray((size - np.hypot(made, noise)) / spread)

    solution = least_squares(missed, start, loss="soft_l1").x
    return dict(zip(varying, solution[1:].tolist(), strict=True))


def _parity(fit: Fit, found: Candidate | None, standing: Sequence[Group]) -> Parity:
    """By the rows of the experiment that tells first."""
    even = odd = 0.0
    telling = ""
    for part, group, row, said in _seen(fit, found, standing):
        one = part.reversal(group.domain, row, group.chi2 - group.count, said)
        if one is None or not part.within(telling or part.experiment):
            continue
        telling = part.experiment
        even, odd = even + one.even, odd + one.odd
        if one.decides:
            break
    return _named(even, odd)


def _named(even: float, odd: float) -> Parity:
    total = even + odd
    if total <= 0.0:
        return "unseen"
    return "even" if even > PURE * total else "odd" if odd > PURE * total else "both"


# words

_PARITY: Mapping[Parity, str] = {
    "even": "It is the same when the input or the sense is reversed.",
    "odd": "It changes its sign when the input or the sense is reversed.",
    "both": "One part of it changes its sign when the input or the sense is reversed, another does not.",
}
_OF = {"frequency": "frequency", "level": "acceleration", "rate": "rate of rotation"}


def _words(one: Description, standing: Sequence[Group]) -> Iterator[str]:
    if not standing:
        yield "Nothing stands out of the noise."
    else:
        group = standing[0]
        yield f"It stands out of the noise in {_some(one.domains)} of {_some(one.channels)}."
        yield f"It is clearest in {group.domain} of {group.channel}, {group.ratio:.3g} times the noise."
    growing = [f"{_OF[n]} to the power {value:.1f}" for n, value in one.exponents.items() if abs(value) >= FLAT]
    flat = [_OF[name] for name, value in one.exponents.items() if abs(value) < FLAT]
    if growing:
        yield f"It grows as {' and '.join(growing)}."
    if flat:
        yield f"It does not depend on {' or '.join(flat)}."
    if one.orders:
        yield f"It repeats {_some([f'{order}' for order in one.orders])} times per revolution."
    if one.parity in _PARITY:
        yield _PARITY[one.parity]
    if one.growth > 1.0 - SHARE:
        yield "It changes with time, and time alone describes it."
    if one.term is not None:
        units = dict(zip((p.name for p in one.term.effect.parameters), one.term.effect.units(one.on), strict=True))
        values = ", ".join(
            f"{name} = ({value:.4g} ± {one.u.get(name, math.nan):.2g}) {units[name]}"
            for name, value in one.term.at.items()
        )
        those = f"{_some(one.only)} only" if one.only else f"all channels of {one.on}"
        yield f"A term to try, on {those}: {one.formula} with {values}."
        yield f"It takes {one.gain:.4g} off χ²" + (f" and explains {one.explained:.0%}." if standing else ".")
        yield from _judged(one)
    elif standing:
        yield "No formula of the library explains what is held out of the fit: none is offered."


def _judged(one: Description) -> Iterator[str]:
    """What held-out rows say of the formula, and what adding it will change."""
    if one.held is not None:
        before, after = one.held
        part = "" if one.repairs else ", so it is not the whole of it"
        yield f"On rows held out, which it was not fitted to, χ²/n falls from {before:.3g} to {after:.3g}{part}."
    if one.before is not None and one.after is not None:
        now = one.after.worst.ratio if one.fit is None else one.after.at(one.fit, one.before.worst.where).ratio
        yield (
            f"Added, it brings the error from {one.before.error:.4g} to {one.after.error:.4g} times the noise, and in "
            f"{one.before.worst.where} from {one.before.worst.ratio:.3g} to {now:.3g}."
        )


def _some(names: Sequence[str], most: int = 4) -> str:
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")
