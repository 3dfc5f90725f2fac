"""Repair a model step by step: start it, refit it, add an effect, take one out; every step with its errors.

A step changes the model as a value; who calls writes it to its file. Errors before a step are those of the model on the
same runs, so a ladder climbs on one set of data: where the runs have changed since the last step, a refit comes first.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rig.archive.records import Recorded
from rig.diagnose import instruments, search
from rig.diagnose.diagnose import chance
from rig.errors import BadInput
from rig.fit import fit as fitting
from rig.fit.evidence import Evidence, evidence_of
from rig.fit.fit import Fit
from rig.fit.floor import with_floor
from rig.fit.parameters import covariance_of, tied
from rig.fit.quality import Errors, Place, error_at, error_of, errors_of
from rig.formula import OwnTerm
from rig.model import BOTH, Effect, Quantity, Term
from rig.parts.ripple import Floor
from rig.repair.model_file import OF_CHANNELS, Action, Entry, Model, Start, Step, load, terms_of, with_fit

SAME = 1e-3  # relative: errors of one model on the same records


@dataclass(frozen=True)
class Bench:
    """What a step works on: the evidence of the runs, the shelf, and the newest bench time of the runs, s."""

    evidence: Evidence
    shelf: Mapping[str, Effect]
    when: float


@dataclass(frozen=True)
class Repaired:
    """A model after a step, the fit, and what is to be said of the step. `before` and `after` are lines of history;
    `errors` those of the fit.
    """

    model: Model
    fit: Fit
    before: Step
    after: Step
    remarks: tuple[str, ...] = ()
    errors: Errors | None = None

    def at(self, where: str) -> Place:
        """What is left now at a place, over all rows and on those held out."""
        return Place(where, error_at(self.fit, where)) if self.errors is None else self.errors.at(self.fit, where)


def bench_of(records: Sequence[Recorded], shelf: Mapping[str, Effect], floor: Floor | None = None) -> Bench:
    """Read the runs of one unit, with the bench's own floor if it is known. Raises BadInput as `evidence_of` does."""
    newest = max(entry.t for run in records for entry in run.lines)
    return Bench(with_floor(evidence_of(records), floor), shelf, newest)


def model_at(path: Path, bench: Bench, start: Start | None) -> Model:
    """The model of a file, or a new one if there is none yet (`start` then says which, by default the data sheet's).

    Raises BadInput for a model of another unit, and for a start that is not the file's.
    """
    if not path.exists():
        return new(bench, start or "datasheet")
    model = load(path, bench.shelf)
    if model.unit != bench.evidence.serial:
        raise BadInput(f"{path}: found a model of {model.unit}, wanted one of {bench.evidence.serial}")
    if start is not None and start != model.start:
        raise BadInput(f"--start: found {start}, wanted {model.start} as {path} begins, or another file with --model")
    return model


def new(bench: Bench, start: Start) -> Model:
    """A model without effects and without history."""
    evidence = bench.evidence
    return Model(unit=evidence.serial, start=start, simulated=evidence.simulated, runs=evidence.runs)


def fit_of(bench: Bench, model: Model) -> Fit:
    """The model fitted to the runs."""
    return bench.evidence.fitted(terms_of(model, bench.shelf), poles=model.poles, shared=model.shared)


def fitted(bench: Bench, model: Model) -> Repaired:
    """The model refitted to the runs: its first step, or one more."""
    action: Action = "fit" if model.history else "start"
    made = _after(bench, model, fit_of(bench, model), action)
    return replace(made, before=model.history[-1]) if model.history else made


def _after(
    bench: Bench, model: Model, found: Fit, action: Action, effect: str | None = None, on: Quantity | None = None,
    channels: Sequence[str] = (), known: Mapping[str, Mapping[str, float]] | None = None,
) -> Repaired:  # fmt: skip
    """A model after a step that this fit made, by itself: its line of history is before and after."""
    errors = errors_of(bench.evidence, found)
    made = with_fit(model, bench.evidence, found, action=action, effect=effect, on=on, channels=channels,
                    when=bench.when, known=_known(bench, model) if known is None else known, errors=errors)  # fmt: skip
    return Repaired(made, found, made.history[-1], made.history[-1], tuple(_not_apart(found)), errors)


def _not_apart(found: Fit) -> Iterator[str]:
    """Of every effect that a fit moves the parameters that are not known apart."""
    for number, term in enumerate(found.state.terms):
        joint = None if term.prior or term.effect.looks_in else tied(term, covariance_of(found, number))
        if joint is not None:
            yield f"{term.key}: {joint.text}"


def added(
    bench: Bench, model: Model, name: str, on: Quantity | None = None, formula: str | OwnTerm | None = None,
    channels: Sequence[str] = (),
) -> Repaired:  # fmt: skip
    """The model with one more effect, from the best of its starts, everything refitted.

    `on` chooses the channels of an effect that can act on either kind; by default those where it removes most;
    `channels` those of them that alone have it. With `formula` the effect is a term of one's own of this name. Raises
    BadInput for an effect that cannot be added.
    """
    own = OwnTerm(formula) if isinstance(formula, str) else formula
    entry = _entry_of(name, on, own, channels)
    if own is None and name in OF_CHANNELS:
        return _with_part(bench, _on_these_runs(bench, model), name)
    effect = _addable(bench, model, entry, own)
    base = _on_these_runs(bench, model)
    if effect.looks_in:
        term, known, remarks, after = _by_test(bench, base, effect, on)
    else:
        term, known, remarks, after = _by_score(base, effect, on, () if own else tuple(channels))
    if own is not None:
        written = entry.model_copy(update={"on": term.on})
        model_with = base.model.model_copy(update={"effects": (*base.model.effects, written)})
    else:
        model_with = base.model
    everything = {**_known(bench, base.model), **({name: known} if known else {})}
    made = _after(bench, model_with, after, "add", name, term.on, entry.channels, everything)
    return replace(made, before=base.after, remarks=(*remarks, *made.remarks))


def _with_part(bench: Bench, base: Repaired, name: str) -> Repaired:
    """The paper's model with the channels' output filters, or the shared one with their own sensitivities, refitted."""
    lacks = not base.model.poles if name == OF_CHANNELS[0] else base.model.shared
    if not lacks:
        raise BadInput(f"add: found {name} in the model already, wanted another effect")
    more = base.model.model_copy(update={"effects": (Entry(effect=name), *base.model.effects)})
    return replace(_after(bench, more, fit_of(bench, more), "add", name), before=base.after)


def removed(
    bench: Bench, model: Model, name: str, on: Quantity | None = None, channels: Sequence[str] = ()
) -> Repaired:
    """The model without an effect, everything refitted; of several of this name all, or that `on` some channels.

    Raises BadInput if it is not in the model.
    """
    left = [entry for entry in model.effects if not entry.is_of(name, on, channels)]
    if len(left) == len(model.effects):
        there = ", ".join(entry.effect for entry in model.effects) or "none"
        raise BadInput(f"remove: found no {name} in the model, wanted one of its effects: {there}")
    base = _on_these_runs(bench, model)
    kept = [entry for entry in base.model.effects if not entry.is_of(name, on, channels)]
    smaller = base.model.model_copy(update={"effects": tuple(kept)})
    return replace(_after(bench, smaller, fit_of(bench, smaller), "remove", name, on, channels), before=base.after)


def _on_these_runs(bench: Bench, model: Model) -> Repaired:
    """The model as its last step left it if that was on the same records, else refitted with a step of its own."""
    if model.history:
        last = model.history[-1]
        if last.runs == bench.evidence.runs and last.when == round(bench.when, 3):
            found = fit_of(bench, model)
            if abs(error_of(found) / last.error - 1.0) < SAME:  # else somebody changed the file by hand
                return Repaired(model, found, last, last)
    return fitted(bench, model)


def _entry_of(name: str, on: Quantity | None, own: OwnTerm | None, channels: Sequence[str]) -> Entry:
    if own is None:
        return Entry(effect=name, on=on, channels=tuple(channels))
    values = {coefficient: starts[0] for coefficient, starts in own.starts.items()}
    return Entry(effect=name, formula=own.text, on=on, channels=own.channels, units=dict(own.units), values=values)


def channels_named(bench: Bench, words: Sequence[str]) -> tuple[Quantity | None, tuple[str, ...]]:
    """What `acceleration`, `rate`, or names of channels or units mean: their quantity, and which channels of it if they
    are not all.

    Raises BadInput for a name that no channel and no unit has, and for channels of both quantities.
    """
    if not words:
        return None, ()
    if len(words) == 1 and words[0] in BOTH:
        return BOTH[BOTH.index(words[0])], ()
    of: dict[str, Quantity] = {}
    units: dict[str, list[str]] = {}
    for part in bench.evidence.parts:
        of |= {name: BOTH[bool(rates)] for name, rates in zip(part.channels.names, part.channels.rates, strict=True)}
        for unit, name in zip(part.channels.unit, part.channels.names, strict=True):
            units.setdefault(unit, []).append(name)
    words = [name for word in words for name in ([word] if word in of else units.get(word, [word]))]
    stray = next((word for word in words if word not in of), None)
    if stray is not None:
        near = difflib.get_close_matches(stray, of, 3) or list(of)
        raise BadInput(f"--on: found '{stray}', wanted acceleration, rate or channels such as {', '.join(near)}")
    quantities = {of[word] for word in words}
    if len(quantities) > 1:
        raise BadInput(f"--on: found {' and '.join(words)}, wanted channels of one kind")
    (quantity,) = quantities
    everything = {name for name, one in of.items() if one == quantity}
    return quantity, () if set(words) == everything else tuple(dict.fromkeys(words))


def _addable(bench: Bench, model: Model, entry: Entry, own: OwnTerm | None) -> Effect:
    from rig.repair.model_file import effect_of

    if entry.formula is not None and entry.on is None:
        driven = any(part.excites("acceleration") for part in bench.evidence.parts)
        entry = entry.model_copy(update={"on": "acceleration" if driven else "rate"})
    try:
        effect = effect_of(entry, bench.shelf, own.starts if own is not None else {})
    except BadInput as error:
        raise BadInput(f"add: {error}") from error
    if effect.absorbed:
        raise BadInput(f"add: found {effect.name}, wanted an effect that a fit can see ({effect.absorbed})")
    if entry.channels and entry.formula is None and (effect.looks_in or not effect.quantities):
        wanted = "a quantity: its own test finds it" if effect.quantities else "no channels: it belongs to all alike"
        raise BadInput(f"add: found {effect.name} on {', '.join(entry.channels)}, wanted {wanted}")
    alike = [one for one in model.effects if one.effect == entry.effect]
    there = [one.on for one in alike if entry.formula is not None or set(one.channels) == set(entry.channels)]
    if there and (len(effect.quantities) < 2 or entry.on in there or entry.formula is not None):
        raise BadInput(f"add: found {effect.name} in the model already, wanted another effect")
    return effect


_Added = tuple[Term, Mapping[str, float] | None, tuple[str, ...], Fit]


def _by_test(bench: Bench, base: Repaired, effect: Effect, on: Quantity | None) -> _Added:
    """An effect that a test of its own determines."""
    there = {term.key for term in base.fit.state.terms if not term.prior}
    found = [f for f in instruments.findings(bench.evidence, bench.shelf, there) if f.term.effect.name == effect.name]
    found = [f for f in found if on in (None, f.term.on)]
    if not found:
        raise BadInput(f"add: found no sign of {effect.name} in these runs, wanted one; {effect.separate_by}")
    state = replace(base.fit.state, terms=(*base.fit.state.terms, found[0].term))
    after = fitting.fit(base.fit.parts, state)
    return found[0].term, found[0].u, (found[0].because,), after


def _by_score(base: Repaired, effect: Effect, on: Quantity | None, channels: tuple[str, ...]) -> _Added:
    """An effect that the observables show: the start that promises most, refitted."""
    candidates = [t for t in search.possible({effect.name: effect}, base.fit, only=channels) if on in (None, t.on)]
    if not candidates:
        places, kinds = " or the ".join(effect.places), " or ".join(effect.quantities) or "any quantity"
        wanted = f"an effect that is not in the model and can act here (this one: {kinds}, on the {places})"
        raise BadInput(f"add: found {effect.name}{f' on {on}' if on else ''}, wanted {wanted}")
    best = search.scores(base.fit, candidates)[0]
    if best.visible < fitting.HIDDEN:
        raise BadInput(
            f"add: found {effect.name}, which these runs cannot tell from what is fitted anyway, "
            f"wanted another measurement: {effect.separate_by}"
        )
    made = search.refitted(base.fit, best)
    after = fitting.fit(base.fit.parts, made.fit.state)
    said = [] if search.admissible(made.term, made.u) else [f"{effect.name}: physics does not allow it"]
    if base.fit.objective - after.objective < chance(best):
        said.append(f"{effect.name} removes no more than chance would: this data does not ask for it")
    return after.state.terms[-1], None, tuple(said), after


def _known(bench: Bench, model: Model) -> dict[str, Mapping[str, float]]:
    """Standard uncertainties that a test of its own gave, by effect; no fit finds them again."""
    return {
        entry.effect: {name: one.u for name, one in entry.coordinates.items() if one.u is not None}
        for entry in model.effects
        if entry.formula is None and entry.effect in bench.shelf and bench.shelf[entry.effect].looks_in
    }
