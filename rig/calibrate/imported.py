"""From imported runs to a calibration: somebody else's records, by the same fitted model as the bench's own.

A manifest states what its numbers mean, so a sensitivity comes out as its ratio to what is stated (1: exactly as
stated), and a zero output in m/s² or rad/s above the stated zero. What the owner states of the reference is in the
budget, a prior a line; what nobody states is in no line, and is said.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rig.archive.records import Recorded
from rig.calibrate import imported_noise
from rig.calibrate.allowances import in_runs
from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import Calibration, Result, Source, not_determined
from rig.calibrate.fitted import Assumed, Estimate, Experiment, experiments
from rig.calibrate.joined import NEGLIGIBLE, NOISE, inadequate, of_model, spoilt
from rig.calibrate.judging import judged
from rig.calibrate.merging import in_volts, merged
from rig.errors import BadInput
from rig.fit.evidence import evidence_of
from rig.fit.fit import POLE_TOLERANCE
from rig.foreign.manifest import SI_OF, Column, referred_to
from rig.foreign.tables import CONDITIONS, Foreign, foreign_of
from rig.parts.channels import UNSTATED
from rig.parts.part import Part
from rig.parts.reading.imported import comparable
from rig.parts.reading.runs import same_unit
from rig.sensor import Sensor

CHANNELS = ("acceleration", "rate", "voltage", "unstated", "magnitude", "real")  # what gives a channel its numbers
SENSITIVITY = "sensitivity, ratio to what is stated"
OFFSET = "zero output above what is stated"
BANDWIDTH = "corner of the output filter"
BEYOND = 0.5  # of what a data sheet's bandwidth is good for: a corner known no better is the data sheet's
MEANING = (
    "sensitivities are ratios to what the manifest states and offsets are above its zeros: a correction takes its "
    "numbers in SI, (number − zero) ÷ sensitivity"
)
NOISE_MEANING = (
    "noise is in SI by the sensitivity that the manifest states, or by the calibrated one where these runs have it"
)
MEANING_IN_VOLTS = (
    "imported values are in volts as their manifests state them: a zero output in V, a sensitivity in V per SI unit"
)
BUDGETS = "the budgets hold noise and what the manifest states: nothing of alignment, temperature and drift beyond it"
HELD_OUT = "values stand on all records, those too that are held out from a diagnosis"
DATES = "dates are those of the import; the manifest does not say when the records were made"


def calibration(
    runs: Sequence[Recorded], name: str, sources: Sequence[Source], assumed: Assumed, volts: bool = False
) -> Calibration:
    """One calibration from imported runs of a unit; `volts`: in V per SI unit, as a bench's own values are.

    Records with motion are compared with the model; those at rest give the noise. Raises BadInput for runs of
    different units and for such that determine nothing.
    """
    _of_one_unit(runs)
    foreign = {run.name: foreign_of(run) for run in runs}
    moved = [run for run in runs if comparable(foreign[run.name].manifest)]
    still = [data for run, data in foreign.items() if not comparable(data.manifest)]
    if volts:
        _refuse_other_than_volts(foreign[run.name] for run in moved)
    found = _Fitted.of(moved, foreign, assumed) if moved else _Fitted()
    header = runs[0].header
    unit = _unit(found.parts, still, header["sensor"])
    results = list(_judged(merged(found.results), _tolerances(foreign.values())))
    results += imported_noise.results(still, Sensor.stated(unit), results)
    if volts:
        columns = {one.channel: one for data in foreign.values() for one in data.manifest.of("device")}
        results = [in_volts(one, columns[one.channel]) if one.channel in columns else one for one in results]
    if not any(result.determined for result in results):
        wanted = "wanted records with motion, or at rest"
        raise BadInput(f"{', '.join(foreign)}: found nothing that determines a value, {wanted}")
    bare = all(one.unit.startswith("V") for one in found.results if one.measurand in ("sensitivity", "offset"))
    meaning = MEANING_IN_VOLTS if volts or bare else MEANING
    meanings = [*((meaning, BUDGETS, HELD_OUT) if moved else ()), *((NOISE_MEANING,) if still else ())]
    return Calibration(
        name=name, sensor=" ".join(str(header["sensor"]["model"]).split()) or "imported unit",
        serial=str(header["sensor"]["serial"]), made=max(entry.t for run in runs for entry in run.lines),
        simulated=any(bool(run.header["simulated"]) for run in runs), sources=tuple(sources),
        standards=tuple(_standards(runs)), conditions=dict(_conditions(foreign.values())), results=tuple(results),
        flags=tuple(dict.fromkeys([*_untraced(moved), *meanings, DATES, *_notes(found, still)])),
        program={key: str(value) for key, value in header["program"].items()}, model=found.model, unit=unit,
    )  # fmt: skip


@dataclass(frozen=True)
class _Fitted:
    """What the fitted model says of records with motion; nothing without any."""

    results: tuple[Result, ...] = ()
    model: str = ""
    parts: tuple[Part, ...] = ()
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, runs: Sequence[Recorded], foreign: Mapping[str, Foreign], assumed: Assumed) -> _Fitted:
        evidence = evidence_of(runs)
        known = {term.effect.name for term in assumed.terms}
        unstated = {t.key: t for part in evidence.parts for t in part.unstated() if t.effect.name not in known}
        model = "; besides, as no data sheet states it: ".join([assumed.said, *filter(None, [", ".join(unstated)])])
        assumed = replace(assumed, terms=(*assumed.terms, *unstated.values()))
        fits = experiments(evidence, assumed)
        results = [result for one in fits.values() for result in _of_experiment(one, foreign, assumed)]
        return cls((*results, *of_model(fits, assumed)), model, evidence.parts, evidence.notes)


def _refuse_other_than_volts(records: Iterable[Foreign]) -> None:
    """Ratios to what a manifest states and volts per SI unit are not one measurand, unless the numbers are volts."""
    for data in records:
        for one in data.manifest.of("device"):
            if one.quantity in CHANNELS and one.volts is None:
                raise BadInput(
                    f"{data.run}: found {one.channel} in {one.unit or one.sensitivity or 'no unit'} beside runs that a "
                    "bench recorded in volts, wanted either alone, or a voltage, or a sensitivity in volts such as "
                    "'0.066 V per m/s²': a ratio to what a manifest states and volts per SI unit are not one measurand"
                )


def _of_one_unit(runs: Sequence[Recorded]) -> None:
    for run in runs[1:]:
        if not same_unit(run, runs[0]):
            raise BadInput(f"{run.name}: found another unit than in {runs[0].name}, wanted runs of one unit")


def _notes(found: _Fitted, still: Sequence[Foreign]) -> Iterator[str]:
    yield from found.notes
    for data in still:
        yield from (one.text for one in data.found)


def _of_experiment(experiment: Experiment, foreign: Mapping[str, Foreign], assumed: Assumed) -> Iterator[Result]:
    """Sensitivity, zero output and corner of every channel."""
    parts = experiment.fit.parts
    owners = dict.fromkeys(part.run for part in parts)
    reference = "; ".join(dict.fromkeys(referred_to(foreign[run].manifest) for run in owners))
    method = f"model fitted to all records of the {experiment.name} ({assumed.words})"
    columns = {one.channel: one for run in owners for one in foreign[run].manifest.of("device")}
    for name in dict.fromkeys(name for part in parts for name in part.channels.names):
        part = next(part for part in parts if name in part.channels.names)
        owner = part.run
        quantity = "" if (column := columns.get(name)) is None else column.quantity
        for result in _of_channel(experiment, part, name, {**SI_OF, "voltage": "V"}.get(quantity, "")):
            result = replace(result, method=method, reference=reference) if result.determined else result
            yield in_volts(result, column) if column is not None and _bare(column, foreign[owner]) else result


def _bare(column: Column, data: Foreign) -> bool:
    """Whether nobody states a sensitivity of numbers that are volts, or volts per m/s²: the ratio is then none."""
    known = any(one.quantity in ("acceleration", "frequency") for one in data.manifest.of("reference"))
    return column.sensitivity is None and column.volts is not None and known


def _of_channel(experiment: Experiment, part: Part, name: str, unit: str) -> Iterator[Result]:
    """`unit` is that of the channel's numbers, "" where nobody states one: a zero output then has none."""
    stated = float(part.stated[part.channels.names.index(name)])
    found = experiment.sensitivity(name)
    if found is None:
        why = f"the records of the {experiment.name} do not determine it: nothing moves it, or noise leaves it open"
        yield not_determined(name, "sensitivity", SENSITIVITY, "1", why)
    else:
        yield _result(experiment, name, ("sensitivity", SENSITIVITY, "1"), found, stated)
    zero = experiment.offset(name, range(len(experiment.fit.parts)))
    if zero is not None and zero.u_noise > 0.0 and unit:
        yield _result(experiment, name, ("offset", OFFSET, unit), zero, stated)
    corner = experiment.bandwidth(name)
    if corner is not None and corner.u < BEYOND * POLE_TOLERANCE * corner.value:
        yield _result(experiment, name, ("bandwidth", BANDWIDTH, "Hz"), corner, 1.0)


def _result(experiment: Experiment, name: str, what: tuple[str, str, str], found: Estimate, scale: float) -> Result:
    """A result with its budget: noise, widened where the model leaves more than it, and a line for every prior."""
    measurand, title, unit = what
    channels = {one for part in experiment.fit.parts for one in part.channels.names}
    mine = [one.ratio for one in experiment.missed if one.channel == name or one.channel not in channels]
    factor = max([1.0, *mine])
    lines = [Contribution(NOISE[0], "A", "normal", factor * found.u_noise / abs(scale), unit, 1.0)]
    called: dict[str, int] = {}
    source = in_runs("stated", {part.run for part in experiment.fit.parts})
    for pull in found.pulls:
        if abs(pull.coefficient * pull.u) > NEGLIGIBLE * found.u:
            label = pull.name.replace("_", " ")
            called[label] = called.get(label, 0) + 1
            label = label if called[label] == 1 else f"{label} ({called[label]})"
            lines.append(Contribution(label, "B", "normal", pull.u, "1", pull.coefficient / scale, source=source))
    said = (() if experiment.worst is None else (inadequate(experiment, factor),)) + spoilt(experiment)
    return Result(
        name, measurand, title, found.value / scale, unit, Budget(tuple(lines)), remarks=said,
        status="flagged" if said else "determined",
    )  # fmt: skip


def _judged(results: Iterable[Result], tolerances: Mapping[str, float]) -> Iterator[Result]:
    """Sensitivities, ratios to what a manifest states, against the tolerance that it states."""
    for result in results:
        tolerance = tolerances.get(result.channel, UNSTATED)
        yield judged(result, 1.0, tolerance if tolerance < UNSTATED else None)


def _tolerances(foreign: Iterable[Foreign]) -> dict[str, float]:
    return {one.channel: one.tolerance for data in foreign for one in data.manifest.of("device")}


def _standards(runs: Sequence[Recorded]) -> Iterator[Mapping[str, Any]]:
    """Standards that the manifests name, each once."""
    seen: list[Mapping[str, Any]] = []
    for standard in (one for run in runs for one in run.header["standards"]):
        if standard not in seen:
            seen.append(standard)
            yield standard


def _untraced(runs: Sequence[Recorded]) -> Iterator[str]:
    for run in runs:
        if not run.header["standards"]:
            yield f"not traceable: the manifest of {run.name} names no standard for its reference"


def _conditions(foreign: Iterable[Foreign]) -> Iterator[tuple[str, tuple[float, float, float]]]:
    """Mean, lowest and highest temperature (°C) and supply (V), as far as they were logged."""
    records = list(foreign)
    for name in CONDITIONS:
        logged = np.concatenate([data.condition(table, name) for data in records for table in data.tables])
        values = logged[np.isfinite(logged)]
        if len(values):
            yield name, (float(values.mean()), float(values.min()), float(values.max()))


def _unit(parts: Sequence[Part], still: Sequence[Foreign], stated: Mapping[str, Any]) -> dict[str, Any]:
    """The unit as a sensor file would state it: every sensitivity is one, because ratios to it are what is told."""
    rows: dict[str, Mapping[str, Any]] = {}
    for part in parts:
        channels = part.channels
        for name, rate, axis, pole in zip(channels.names, channels.rates, channels.axis, channels.pole, strict=True):
            kind, si = ("rate", "rad/s") if rate else ("acceleration", "m/s²")
            rows[name] = {
                "part": str(stated["model"]), "unit": "gyros" if rate else "accelerometers", "quantity": kind,
                "axis": "xyz"[axis], "range": "", "sensitivity": f"1 V/({si})",
                "bandwidth": f"{float(pole)!r} Hz" if math.isfinite(pole) else "1 Hz",
            }  # fmt: skip
    rows = {**imported_noise.rows(still), **rows}
    return {"sensor": str(stated["model"]), "serial": str(stated["serial"]), "channels": rows}
