"""What a diagnosis concludes, as values to print or to write: the candidates with all that speaks for and against each.

A candidate is an effect that was taken, or one that the data do not tell from it. Together they are a class, and each
says what would tell it from the others. Where the verdict is *unlisted* a candidate is only the nearest on the shelf:
its probability counts no more than the share that it explains, and never more than evens.
"""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rig.diagnose.bands import Known, dependent
from rig.diagnose.describe import Description, describe
from rig.diagnose.diagnose import CHANCE, CLASS, Choice, Diagnosis, Step, Told, diagnose, misread, unheard
from rig.diagnose.misfit import Group, Pull, finite, place_as_json, pulls, untold
from rig.diagnose.unseen import cannot_see
from rig.fit import adequacy
from rig.fit.evidence import Evidence
from rig.fit.fit import POLE_TOLERANCE, Fit
from rig.fit.parameters import Estimate, Tied, covariance_of, estimates, independent, plausible, tied
from rig.fit.quality import Place, errors_from, errors_of, heldout_rows, on_all_rows
from rig.model import Effect, Quantity, Term
from rig.motion import Array
from rig.parts.part import Finding

OUTPUT_FILTER = "output_filter"  # what the paper's model lacks: no effect of the shelf but a part of every channel
OWN_SENSITIVITY = "own_sensitivity"  # what the shared model lacks
OWN = "own_law"  # name of a described formula in a model
DETERMINED = 0.5  # of the prior uncertainty of a corner: below it the data have their say
EVENS = 0.5  # the highest probability of a candidate that leaves more than noise


@dataclass(frozen=True)
class Candidate:
    """One effect that the data allow. `taken` in step `step` (from 1), or a member of that step's class.

    `error_after`, `heldout_error_after`: √(χ²/n) with it in the model, noise = 1; `there` what it leaves where the
    model as given is worst. `members` of its class, itself included.
    """

    effect: str
    title: str
    on: Quantity | None
    members: tuple[str, ...]
    probability: float
    error_after: float
    heldout_error_after: float
    parameters: Mapping[str, Estimate]
    plausible: bool
    because: str
    separate_by: str
    step: int
    taken: bool
    there: Place
    tied: Tied | None = None  # parameters that are not known apart
    depends_on_band: bool = False  # whether its size changes when twice the band of a sampled reference is compared
    channels: tuple[str, ...] = ()  # of the quantity that alone have it

    def as_json(self) -> dict[str, Any]:
        """As `rig diagnose --json` gives it, SI; null for what has no finite value."""
        return {
            "effect": self.effect,
            "on": self.on,
            "channels": list(self.channels),
            "class": list(self.members),
            "probability": self.probability,
            "error_after": self.error_after,
            "heldout_error_after": finite(self.heldout_error_after),
            "worst_after": place_as_json(self.there),
            "parameters": {name: one.as_json() for name, one in self.parameters.items()},
            "not_known_apart": None if self.tied is None else self.tied.as_json(),
            "depends_on_band": self.depends_on_band,
            "plausible": self.plausible,
            "because": self.because,
            "separate_by": self.separate_by,
            "step": self.step,
            "taken": self.taken,
        }


@dataclass(frozen=True)
class Excluded:
    """An effect that the data exclude in a step: the error that it would leave (noise = 1), and where most.

    Without an error where it was not refitted, as it removes far less.
    """

    step: int
    effect: str
    error_after: float | None
    why: str

    def as_json(self) -> dict[str, Any]:
        """As `rig diagnose --json` gives it."""
        return {"step": self.step, "effect": self.effect, "error_after": self.error_after, "why": self.why}


@dataclass(frozen=True)
class Conclusion:
    """The verdict, the candidates best first, what an unlisted effect looks like, and what cannot be seen.

    `error` and `heldout_error` are those of the model as given, `after` and `heldout_after` with all steps taken.
    `worst` says where the model as given fails most, `worst_after` what is left of that; `references` what of the
    references would have to leave its stated uncertainty with all steps taken. `untold` are groups
    of rows, with all steps taken, whose noise is known only from what the model leaves over; `faults` samples that
    were left out, and what else looks wrong with the records; `unjudged` why no rows judge it, "" if some do.
    """

    verdict: str
    candidates: tuple[Candidate, ...]
    description: str
    cannot_see: tuple[str, ...]
    error: float
    heldout_error: float
    after: float
    heldout_after: float
    worst: Place
    worst_after: Place
    diagnosis: Diagnosis = field(repr=False)
    excluded: tuple[Excluded, ...] = ()
    untold: tuple[Group, ...] = ()
    faults: tuple[Finding, ...] = ()
    unjudged: str = ""
    references: tuple[Pull, ...] = ()

    @property
    def taken(self) -> tuple[Candidate, ...]:
        """The effects that were taken, in order."""
        return tuple(one for one in self.candidates if one.taken)


def conclude(
    evidence: Evidence, terms: Sequence[Term], shelf: Mapping[str, Effect], *, poles: bool = True, shared: bool = False,
    told: Told = unheard,
) -> Conclusion:  # fmt: skip
    """Diagnose a model with these effects; `poles` says whether it has the channels' output filters, `shared` whether
    all channels of a quantity have one sensitivity.

    Without filters (the paper's model) the filter is tried first: it belongs to every channel, and what else is missing
    shows only beside it. So are sensitivities of their own where they are shared. `told` hears what is being done.
    """
    found = concluded(evidence, diagnose(evidence, terms, shelf=shelf, poles=True, told=told), shelf)
    if (poles and not shared) or misread(found.diagnosis.final):
        return found
    base = evidence.fitted(terms, poles=poles, shared=shared)
    if base.objective - found.diagnosis.base.objective < CHANCE:  # nothing that a part of every channel would explain
        plain = diagnose(evidence, terms, shelf=shelf, poles=poles, shared=shared, told=told)
        return concluded(evidence, plain, shelf)
    first = (_own_sensitivity if shared else _output_filter)(evidence, found.diagnosis.base, found.diagnosis.final)
    rest = [replace(one, step=one.step + 1) for one in found.candidates]
    candidates = sorted([first, *rest], key=lambda one: (not one.taken, one.step))
    errors, final = errors_of(evidence, base), found.diagnosis.final
    return replace(
        found, verdict="unlisted" if found.verdict == "unlisted" else "missing", candidates=tuple(candidates),
        error=errors.error, heldout_error=errors.heldout, worst=errors.worst,
        worst_after=errors_of(evidence, final).at(final, errors.worst.where),
    )  # fmt: skip


def _output_filter(evidence: Evidence, base: Fit, final: Fit) -> Candidate:
    """The output filter of every channel, with the corners of the final fit that this data determines."""
    errors, u = errors_of(evidence, base), np.sqrt(np.maximum(np.diag(final.covariance), 0.0))
    poles = {}
    for number, part in enumerate(final.parts):
        own, local = final.layout.own(part, number)[:, 1], final.state.local(part, number)
        for name, at, pole in zip(part.channels.names, own, local.pole, strict=True):
            if u[at] < DETERMINED * POLE_TOLERANCE:
                poles[f"corner {name}"] = Estimate(float(pole), "Hz", float(pole * u[at]))
    return Candidate(
        effect=OUTPUT_FILTER, title="output filter of every channel", on=None, members=(OUTPUT_FILTER,),
        probability=1.0, error_after=errors.error, heldout_error_after=errors.heldout, there=errors.worst,
        parameters=poles, plausible=True,
        because="gain falls and phase lags with frequency as one pole per channel, at the corner of its data sheet",
        separate_by="a sweep past the corner: one pole falls by 20 dB per decade", step=1, taken=True,
    )  # fmt: skip


def _own_sensitivity(evidence: Evidence, base: Fit, final: Fit) -> Candidate:
    """A sensitivity of its own for every channel, relative to that of its data sheet."""
    errors, u = errors_of(evidence, base), np.sqrt(np.maximum(np.diag(final.covariance), 0.0))
    gains = {}
    for number, part in enumerate(final.parts):
        own = final.layout.own(part, number)[:, 0]
        for name, at in zip(part.channels.names, own, strict=True):
            gains[f"sensitivity {name}"] = Estimate(1.0 + final.state.gain[name], "1", float(u[at]))
    return Candidate(
        effect=OWN_SENSITIVITY, title="a sensitivity of its own for every channel", on=None, members=(OWN_SENSITIVITY,),
        probability=1.0, error_after=errors.error, heldout_error_after=errors.heldout, there=errors.worst,
        parameters=gains, plausible=True,
        because="the error is in proportion to the input, with another factor in every channel",
        separate_by="the same input along each axis in turn", step=1, taken=True,
    )  # fmt: skip


def concluded(evidence: Evidence, diagnosis: Diagnosis, shelf: Mapping[str, Effect]) -> Conclusion:
    """Everything there is to say about a diagnosis."""
    before, after = errors_of(evidence, diagnosis.base), errors_of(evidence, diagnosis.final)
    candidates = list(_candidates(evidence, diagnosis, before.worst.where))
    found = _by_band(candidates, dependent(evidence, diagnosis.final))
    # what was taken comes first, then what it could be instead
    found.sort(key=lambda one: (not one.taken, one.step, -one.probability))
    return Conclusion(
        worst=before.worst,
        worst_after=after.at(diagnosis.final, before.worst.where),
        verdict=diagnosis.verdict,
        candidates=tuple(found),
        description=description(evidence, diagnosis) if diagnosis.verdict == "unlisted" else "",
        cannot_see=cannot_see(evidence, diagnosis.scores, shelf, diagnosis.misplaced),
        error=before.error,
        heldout_error=before.heldout,
        after=after.error,
        heldout_after=after.heldout,
        diagnosis=diagnosis,
        excluded=tuple(_excluded(diagnosis)),
        untold=tuple(untold(diagnosis.final)),
        faults=tuple(dict.fromkeys(one for part in evidence.parts for one in part.faults)),
        unjudged="" if diagnosis.held else _unjudged(diagnosis.final),
        references=tuple(pulls(diagnosis.final)),
    )


def _unjudged(found: Fit) -> str:
    """Why no rows judge a model, and what would: states that were met once are not held out, and rows that are must
    leave more than the parameters need.
    """
    out, size = int(np.count_nonzero(heldout_rows(found))), found.layout.size
    why = "" if out else ", what was met once is kept"
    if out >= adequacy.FEWEST_HELD:
        why = f", and the other {found.count - out} are too few for {size} parameters"
    more = "; ".join(dict.fromkeys(part.to_judge for part in found.parts))
    return f"too few rows are held out to judge by ({out} of {found.count}{why}): take {more}"


def _excluded(diagnosis: Diagnosis) -> Iterator[Excluded]:
    """The next best of every step, beside all other steps' effects."""
    for number, step in enumerate(diagnosis.steps, 1):
        for choice in step.ranked_below:
            fit = choice.whole or choice.fit
            if choice.full and fit is not None:
                yield _left(diagnosis, number, choice, on_all_rows(fit))
            else:
                yield Excluded(number, choice.term.key, None, f"it removes far less than {step.taken.name}")


def _left(diagnosis: Diagnosis, number: int, choice: Choice, fit: Fit) -> Excluded:
    """Where an effect in the place of the one taken leaves most, and whether that excludes it."""
    errors = errors_from(fit, None)
    worst, size = errors.worst, f" ({errors.worst.size})" if errors.worst.size else ""
    where = f"{worst.ratio:.3g} times the noise in {worst.where}{size}" if worst.where else ""
    if not choice.possible:
        where = f"{where}; physics does not allow it"
    elif fit.objective < diagnosis.final.objective + CLASS:
        where = f"{where}; this data does not exclude it"
    return Excluded(number, choice.term.key, errors.error, where)


def _by_band(found: Sequence[Candidate], dependent: Set[Known]) -> list[Candidate]:
    """What was taken in a step and changes with the band is marked, and none of that step is likelier than evens."""
    marked = {one.step for one in found if one.taken and (one.effect, one.on, one.channels) in dependent}
    return [
        replace(one, probability=min(one.probability, EVENS), depends_on_band=one.taken)
        if one.step in marked else one
        for one in found
    ]  # fmt: skip


def _candidates(evidence: Evidence, diagnosis: Diagnosis, where: str) -> Iterator[Candidate]:
    for number, step in enumerate(diagnosis.steps, 1):
        members = tuple(dict.fromkeys([step.taken.name, *(one.name for one in step.members)]))
        for choice in step.members:
            yield _candidate(evidence, diagnosis, step, number, choice, members, where)


def _candidate(
    evidence: Evidence, diagnosis: Diagnosis, step: Step, number: int, choice: Choice, members: tuple[str, ...],
    where: str,
) -> Candidate:  # fmt: skip
    is_taken = choice is step.taken
    fit = step.after if is_taken or choice.fit is None else choice.fit
    term, covariance = _where_it_stands(choice, choice.whole or fit)
    errors = errors_of(evidence, fit)
    return Candidate(
        effect=choice.name,
        title=term.effect.title,
        on=term.on,
        members=members,
        probability=stated(diagnosis, choice),
        error_after=errors.error,
        heldout_error_after=errors.heldout,
        there=errors.at(fit, where),
        parameters=estimates(term, covariance),
        plausible=plausible(term),
        because=choice.because,
        separate_by=term.effect.separate_by,
        step=number,
        taken=is_taken,
        tied=None if choice.term.effect.looks_in else tied(term, covariance),
        channels=term.only,
    )


def _where_it_stands(choice: Choice, fit: Fit) -> tuple[Term, Array]:
    """The effect with the coordinates that a fit has found, and their covariance; those of a test of its own stay."""
    places = [n for n, term in enumerate(fit.state.terms) if not term.prior and term.key == choice.term.key]
    if choice.term.effect.looks_in or not places:
        return choice.term, independent(choice.term, choice.u)
    return fit.state.terms[places[0]], covariance_of(fit, places[0])


def stated(diagnosis: Diagnosis, choice: Choice) -> float:
    """The probability that is said of a choice: of the nearest to an unlisted effect no more than what it explains, and
    never more than evens. Nor is one likelier than evens whose parameters are not known apart: what is known is a limit
    of its law, as the slope of an exponential, and other causes that nobody lists have that too.
    """
    fit = choice.whole or choice.fit
    if diagnosis.verdict != "unlisted":
        loose = fit is not None and not choice.term.effect.looks_in and tied(*_where_it_stands(choice, fit))
        return min(choice.probability, EVENS) if loose else choice.probability
    return min(EVENS, choice.probability * min(max(diagnosis.explained, 0.0), 1.0))


def description(evidence: Evidence, diagnosis: Diagnosis) -> str:
    """What an unlisted effect looks like: the nearest on the shelf, its laws, and a formula to try as a term."""
    said = [nearest(diagnosis), *_laws(evidence, describe(evidence, diagnosis.base))]
    groups = [*adequacy.standing(adequacy.groups(diagnosis.final)), *adequacy.unsteady(diagnosis.final)]
    if groups:
        domains = dict.fromkeys(group.domain for group in groups)
        channels = dict.fromkeys(group.channel for group in groups)
        said.append(
            f"what is left shows in {', '.join(list(domains)[:4])} of {_some(list(channels))}, "
            f"most in {groups[0].channel} at {groups[0].domain}: {groups[0].ratio:.3g} times the noise"
        )
    return "; ".join(said)


def _laws(evidence: Evidence, found: Description) -> Iterator[str]:
    """Domain, exponents, orders and parity in words, and how to try the formula."""
    yield from found.words
    if found.formula and found.fit is not None:
        yield f"to try: `{trying(evidence.runs, found, {term.effect.name for term in found.fit.state.terms})}`"


def trying(runs: Sequence[str], found: Description, there: Set[str]) -> str:
    """The command that adds the formula to the model of these runs, under a name that is not there yet."""
    free = itertools.chain([OWN], map(f"{OWN}_{{}}".format, itertools.count(2)))
    name = next(one for one in free if one not in there)
    where = (word for one in found.only or (found.on,) for word in ("--on", str(one)))
    starts = (f"{one}={value:g} s" for one, values in found.starts.items() for value in values)  # all are times
    options = (word for start in starts for word in ("--start", start))
    return shlex.join(["rig", "add", name, *runs, "--formula", found.formula, *where, *options])


def nearest(diagnosis: Diagnosis) -> str:
    """`nearest: X, explains N %`: not a cause."""
    if diagnosis.steps:
        names = " and ".join(step.taken.name for step in diagnosis.steps)
        return f"nearest: {names}, explains {100.0 * diagnosis.explained:.0f} %"
    best = max(diagnosis.scores, key=lambda one: one.gain, default=None)
    excess = adequacy.excess(diagnosis.base)
    if best is None or excess <= 0.0 or best.gain <= 0.0:
        return "nothing on the shelf comes near"
    return f"nearest: {best.term.effect.name}, explains {100.0 * min(best.gain / excess, 1.0):.0f} %"


def _some(names: list[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more channels" if len(names) > most else "")
