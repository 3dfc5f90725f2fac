"""Imported runs as parts of a fit: one reader for every kind of foreign data, found by the name of its file."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from typing import cast

import numpy as np

from rig.archive.records import Recorded, is_imported
from rig.errors import BadInput
from rig.foreign import faults, straying
from rig.foreign.finding import MISREAD
from rig.foreign.manifest import Manifest
from rig.foreign.tables import Foreign, foreign_of
from rig.model import Term
from rig.parts.part import Part
from rig.parts.reading import kinds
from rig.parts.reading.reading import Reading
from rig.parts.reference_gain import gains_of, shared

Reader = Callable[[Foreign], Reading]
DOUBTFUL = ("unit", "turns", *MISREAD)  # findings on import with which no model is adequate, whatever it leaves over


def read(runs: Sequence[Recorded]) -> Reading:
    """The imported ones among these runs."""
    found = Reading.joined(reading_of(foreign_of(run)) for run in runs if is_imported(run))
    return replace(found, known=tuple(shared(found.known)))


def reading_of(foreign: Foreign) -> Reading:
    """An imported run. Raises BadInput for data of a kind that no model can be compared with."""
    _refuse_standing_clocks(foreign)
    kind = foreign.manifest.kind
    reader = reader_of(kind)
    if reader is None:
        wanted = f"wanted one with motion (its noise: `rig show {foreign.run}`)"
        raise BadInput(f"{foreign.run}: found a {kind} record, {wanted}")
    found, doubtful = reader(foreign), (one for one in foreign.found if one.kind in DOUBTFUL)
    faulty = (*faults.left_out(foreign), *straying.findings(foreign), *doubtful)
    for part in found.parts:
        part.faults = faulty
    by_experiment: dict[str, list[str]] = {}
    for part in found.parts:
        by_experiment.setdefault(part.experiment, []).append(part.name)
    gains = (term for word, names in by_experiment.items() for term in gains_of(foreign, word, names))
    return replace(found, known=(*found.known, *gains))


def reader_of(kind: str) -> Reader | None:
    """The reader of a kind of foreign data; None for one that no model can be compared with."""
    name = f"{kinds.__name__}.{kind}"
    return cast(Reader, importlib.import_module(name).read) if find_spec(name) is not None else None


def comparable(manifest: Manifest) -> bool:
    """Whether a model can be compared with what a manifest describes."""
    return reader_of(manifest.kind) is not None


def parts_of(foreign: Foreign) -> tuple[list[Part], list[Term]]:
    """Its parts, and what is known of its reference only within an uncertainty. Raises BadInput as `reading_of`."""
    found = reading_of(foreign)
    return list(found.parts), list(found.known)


def twice(runs: Sequence[Foreign], parts: Sequence[Part]) -> Reading | None:
    """The same with every sampled reference compared up to twice the frequency; None where there is none, or where it
    does not reach so far.
    """
    bands = {part.run: part.bands for part in parts if part.bands}
    if not bands:
        return None
    try:
        found = Reading.joined(reading_of(_doubled(run, bands.get(run.run, ()))) for run in runs)
    except BadInput:
        return None
    return replace(found, known=tuple(shared(found.known)))


def _doubled(foreign: Foreign, bands: Sequence[float]) -> Foreign:
    if not bands:
        return foreign
    further = dict(zip(("rate_band", "force_band"), (2.0 * one for one in bands), strict=True))
    compared = foreign.manifest.compared.model_copy(update=further)
    return replace(foreign, manifest=foreign.manifest.model_copy(update={"compared": compared}))


def _refuse_standing_clocks(foreign: Foreign) -> None:
    """Time has to pass in a record. Raises BadInput."""
    for table in foreign.tables if foreign.manifest.time is not None else ():
        stamps = foreign.time(table)
        known = stamps[np.isfinite(stamps)]
        if len(known) < 2 or not known[-1] > known[0]:
            where = f"{foreign.run} {table.label}".strip()
            raise BadInput(f"{where}, time: found stamps that do not go forward, wanted each later than the one before")
