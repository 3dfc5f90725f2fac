"""One blind trial: measure a world, diagnose it from its records alone, and only then look at what was hidden.

A result holds the diagnosis as it was given, the digest of the sealed answer, and the figures that need the truth: how
much χ² held-out rows keep, what the repaired model makes of a fresh run, whether its interval holds the true size.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import blind_imports
import blind_worlds as worlds
import numpy as np
from blind_worlds import Answer, Case
from fast_bench import MemoryRecords

from fixtures.imperfections import Beginning
from fixtures.shelf import SHELF
from fixtures.world import World
from rig.diagnose import search
from rig.diagnose.conclusion import conclude, stated
from rig.diagnose.describe import describe
from rig.diagnose.diagnose import Diagnosis, diagnose
from rig.errors import BadInput
from rig.fit import fit as fitting
from rig.fit.evidence import Evidence, evidence_of
from rig.fit.fit import Fit
from rig.fit.floor import floor_of, with_floor
from rig.model import Effect, Term
from rig.shelf import shelf as shelf_of

Z95 = 1.959964
FRESH_EVERY = 3  # every third world with one effect is measured once more
OWN_TO_A_RUN = ("mains_hum", "warm_up")  # their phase or size counts from a run's first record
ADJUSTMENTS = 3
FAILURES = (BadInput, ValueError, ArithmeticError, np.linalg.LinAlgError, KeyError, IndexError, AssertionError)


def trial(case: Case, folder: Path) -> dict[str, Any]:
    """Draw, seal, measure, diagnose and write the result of one world; an error of the program is a result too."""
    begun = time.perf_counter()
    answer = worlds.drawn(case)
    sealed = worlds.seal(answer, folder)
    result: dict[str, Any] = {"id": case.id, "table": case.table, "bench": case.bench, "sealed": sealed}
    try:
        imported = case.table in worlds.IMPORTED
        result |= import_tried(answer) if imported else _tried(answer, worlds.world_of(answer), case)
    except FAILURES as error:
        result |= {"verdict": "failed", "named": [], "steps": [], "why": f"{type(error).__name__}: {error}"}
    result["took"] = time.perf_counter() - begun
    worlds.write(folder / "results" / f"{case.id}.json", result)
    return result


def _tried(answer: Answer, world: World, case: Case) -> dict[str, Any]:
    loading = time.perf_counter()
    evidence, begun = _evidence(answer, world)
    shelf = shelf_of()
    if case.table == "unshelved":
        shelf = {name: effect for name, effect in shelf.items() if name not in case.names}
    started = time.perf_counter()
    found = diagnose(evidence, shelf=shelf)
    ended = time.perf_counter()
    result = {**said(found), "load": started - loading, "seconds": ended - started}
    if case.table == "unshelved":
        result["held_out"] = held_out(evidence, found, shelf_of()[case.names[0]])
    if case.table == "strangers" and found.verdict == "unlisted":
        result["repaired"] = repaired(evidence, found)
    if case.table == "one" and found.verdict == "missing":
        if found.named == case.names:
            result["interval"] = interval(found, answer, begun)
        if case.number % FRESH_EVERY == 0:
            result["fresh"] = on_fresh_run(found.final, worlds.measured(world, case.bench))
    return result


def said_of(answer: Answer) -> dict[str, Any]:
    """What is said of a world from its records alone."""
    if answer.table in worlds.IMPORTED:
        return import_tried(answer)
    return said(diagnose(evidence_of([worlds.measured(worlds.world_of(answer), answer.bench)])))


def import_tried(answer: Answer) -> dict[str, Any]:
    """An imported record, diagnosed as `rig diagnose` does it, and what is found wrong with its samples."""
    loading = time.perf_counter()
    evidence = blind_imports.evidence(worlds.imported(answer))
    started = time.perf_counter()
    found = conclude(evidence, [], shelf_of())
    ended = time.perf_counter()
    result = {**said(found.diagnosis), "load": started - loading, "seconds": ended - started}
    for number, step in enumerate(result["steps"], 1):
        here = [one for one in found.candidates if one.step == number]
        step["stated"] = [[one.effect, one.probability] for one in here]
        step["only"] = [list(one.channels) for one in here if one.taken]
        step["depends_on_band"] = any(one.depends_on_band for one in here)
    result["faults"] = sorted({one.kind for one in found.faults})
    result["rows"] = sum(len(one.rows) for one in found.faults)
    result["origins"] = sorted({part.origin(name) for part in evidence.parts for name in part.row_names})
    if found.verdict == "unlisted" and answer.table == "imported_strangers":
        result["repaired"] = repaired(evidence, found.diagnosis)
    return result


def repaired(evidence: Evidence, found: Diagnosis) -> dict[str, Any]:
    """The formula that is offered for an unlisted effect, and χ²/n of held-out rows with it; "" if none is offered."""
    one = describe(evidence, found.base)
    return {"formula": one.formula, "held": None if one.held is None else one.held[1]}


def _evidence(answer: Answer, world: World) -> tuple[Evidence, float]:
    """Evidence of the standard run (after one of remounts where the floor is wanted), and when its record began."""
    if answer.table == "ripple":
        floor = floor_of(evidence_of([worlds.remounted(world)]))
        records = worlds.measured(world, answer.bench)
        return with_floor(evidence_of([records]), floor), worlds.first_record(records, world)
    records = worlds.measured(world, answer.bench)
    return evidence_of([records]), worlds.first_record(records, world)


def said(found: Diagnosis) -> dict[str, Any]:
    """What was concluded, in plain values."""
    return {
        "verdict": found.verdict,
        "named": list(found.named),
        "steps": [
            {
                "name": step.taken.name,
                "members": [one.name for one in step.members],
                "gain": step.taken.gain,
                "merit": step.taken.merit,
                "probability": step.taken.probability,
                "stated": [[one.name, stated(found, one)] for one in step.members],
            }
            for step in found.steps
        ],
        "explained": found.explained,
        "chi2": found.final.chi2,
        "count": found.final.count,
        "nearest": [{"name": one.term.effect.name, "gain": one.gain} for one in found.scores[:3]],
    }


def held_out(evidence: Evidence, found: Diagnosis, truth: Effect) -> dict[str, float]:
    """χ² of the held-out rows with the effects named and with the true one, each fitted to the other rows.

    The true effect is what tells the noise of these very rows: one standard deviation is then √(2·rows).
    """
    named = [term for term in found.final.state.terms if not term.prior]
    base = found.base
    starts = [one for one in search.possible({truth.name: truth}, base) if one.effect is truth]
    refits = [search.refitted(base, score) for score in search.scores(base, starts)]
    best = max(refits, key=lambda one: one.gain, default=None)
    chi2, rows = _held_out(evidence, named)
    true, _ = _held_out(evidence, [best.term] if best is not None else [])
    return {"chi2": chi2, "true": true, "rows": rows, "sigma": math.sqrt(2.0 * rows)}


def _held_out(evidence: Evidence, terms: Sequence[Term]) -> tuple[float, int]:
    training = evidence.training
    made = fitting.fit(evidence.parts, evidence.start(terms), use=training)
    left = fitting.residual(evidence.parts, made.state)
    counted = np.concatenate([part.counted for part in evidence.parts]) & ~training
    return float(left[counted] @ left[counted]), int(np.count_nonzero(counted))


def on_fresh_run(final: Fit, records: MemoryRecords) -> dict[str, float]:
    """χ² of another run of the same unit with the model as it was repaired.

    Only each channel's zero is adjusted, and what counts from a run's own beginning (the phase of the mains, what is
    left of a warm-up): those are not the unit's. Degrees of freedom are rows less what was adjusted.
    """
    evidence = evidence_of([records])
    begin = evidence.start()
    known = replace(final.state, zero=begin.zero, nuisance=begin.nuisance)
    made = fitting.linearised(evidence.parts, known)
    free = _of_the_run(made)
    for _ in range(ADJUSTMENTS):
        step = np.zeros(made.layout.size)
        step[free] = fitting.inverse(made.normal[np.ix_(free, free)]) @ made.downhill[free]
        made = fitting.linearised(evidence.parts, fitting.stepped(made.state, made.layout, step))
    counted = np.concatenate([part.counted for part in made.parts])
    rows = int(np.count_nonzero(counted))
    return {"chi2": float(made.left[counted] @ made.left[counted]), "freedom": rows - len(free)}


def _of_the_run(made: Fit) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Places of the parameters that belong to a run and not to the unit."""
    order = made.layout
    places: list[int] = []
    for first, one in zip((*order.zeros, *order.nuisances), (*made.state.zero, *made.state.nuisance), strict=True):
        places += range(first, first + len(one))
    for first, term in zip(order.terms, made.state.terms, strict=True):
        if term.effect.name in OWN_TO_A_RUN:
            places += range(first, first + len(fitting.fitted(term)))
    return np.array(places, np.intp)


def interval(found: Diagnosis, answer: Answer, begun: float) -> dict[str, Any]:
    """The true size of the effect named, its value in the repaired model and the standard uncertainty of that."""
    (entry,) = answer.hidden
    kind = SHELF.kind(str(entry["name"]))
    truth = kind(**entry["parameters"]).stated(Beginning(begun, 0.0, worlds.MAINS))[kind.size]
    step = found.steps[-1].taken
    term = next(one for one in found.final.state.terms if one.effect.name == kind.name and not one.prior)
    value = term.effect.physical(term.at)[kind.size]
    if term.effect.looks_in:  # found by a test of its own, outside the rows
        return {"parameter": kind.size, "truth": truth, "value": value, "u": float(step.u[kind.size])}
    return {"parameter": kind.size, "truth": truth, "value": value, "u": propagated(found.final, term, kind.size)}


def propagated(made: Fit, term: Term, parameter: str) -> float:
    """Standard uncertainty of a parameter from the covariance of the coordinates, by central differences."""
    place = next(k for k, one in enumerate(made.state.terms) if one is term)
    names, first = fitting.fitted(term), made.layout.terms[place]
    covariance = made.covariance[first : first + len(names), first : first + len(names)]
    slope = []
    for name, variance in zip(names, np.diag(covariance).tolist(), strict=True):
        h = 0.1 * math.sqrt(max(variance, 1e-300))
        ends = [term.effect.physical(term.moved(**{name: term.at[name] + way * h}).at)[parameter] for way in (1, -1)]
        slope.append((ends[0] - ends[1]) / (2.0 * h))
    return math.sqrt(max(float(np.array(slope) @ covariance @ np.array(slope)), 0.0))


def holds(one: Mapping[str, Any]) -> bool:
    """Whether a 95 % interval holds the truth."""
    return abs(float(one["value"]) - float(one["truth"])) <= Z95 * float(one["u"])
