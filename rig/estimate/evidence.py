"""Everything that a model of a unit is compared with: the parts of a fit, and what is known of the bench."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from rig.errors import BadInput
from rig.estimate import nuisances
from rig.estimate.fit import Fit, Part, State, begin, fit
from rig.estimate.shaking import shaken
from rig.estimate.sines import Sines
from rig.estimate.spinning import spun
from rig.estimate.turning import Turning
from rig.model import Term
from rig.records import Recorded


@dataclass(frozen=True)
class Evidence:
    """Parts of all runs of one unit, nuisances with their priors, and remarks that qualify every conclusion."""

    parts: tuple[Part, ...]
    nuisances: tuple[Term, ...]
    runs: tuple[str, ...]
    serial: str
    simulated: bool
    notes: tuple[str, ...]
    blind: tuple[str, ...] = field(default=())

    @property
    def sines(self) -> list[Sines]:
        """Mountings on the shaker."""
        return [part for part in self.parts if isinstance(part, Sines)]

    @property
    def turnings(self) -> list[Turning]:
        """Turntable runs."""
        return [part for part in self.parts if isinstance(part, Turning)]

    @property
    def training(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Rows that are not held out, (rows,)."""
        return np.concatenate([~part.held_out for part in self.parts])

    def start(self, terms: Sequence[Term] = (), *, poles: bool = True) -> State:
        """Where a fit of a model begins."""
        return begin(self.parts, [*self.nuisances, *terms], poles=poles)

    def fitted(self, terms: Sequence[Term] = (), *, poles: bool = True) -> Fit:
        """The data-sheet model with these effects, fitted to everything."""
        return fit(self.parts, self.start(terms, poles=poles))


def evidence_of(runs: Sequence[Recorded]) -> Evidence:
    """Read the runs of one unit. Raises BadInput for runs of several units, or that no model can be compared with."""
    _of_one_unit(runs)
    sines = [Sines(data) for run in runs for data in shaken(run)]
    turnings = [Turning(data) for run in runs for data in spun(run)]
    parts: tuple[Part, ...] = (*sines, *turnings)
    if not parts:
        names = ", ".join(run.name for run in runs)
        raise BadInput(f"{names}: found no sines and no turning platter, wanted a sweep or a turntable run")
    known: list[Term] = []
    if sines:
        known += nuisances.of_shaker([run for run in runs if any("frequency" in b for b in run.points.values())])
    if turnings:
        known += nuisances.of_turntable([run for run in runs if any("phase" in b for b in run.points.values())])
    header = runs[0].header
    return Evidence(
        parts, tuple(known), tuple(run.name for run in runs), str(header["sensor"]["serial"]),
        any(bool(run.header["simulated"]) for run in runs), tuple(_notes(runs, sines, turnings)),
    )  # fmt: skip


def _of_one_unit(runs: Sequence[Recorded]) -> None:
    if not runs:
        raise BadInput("found no run, wanted at least one")
    for run in runs[1:]:
        if run.header["sensor"] != runs[0].header["sensor"]:
            raise BadInput(f"{run.name}: found another unit than in {runs[0].name}, wanted runs of one unit")


def _notes(runs: Sequence[Recorded], sines: Sequence[Sines], turnings: Sequence[Turning]) -> Iterator[str]:
    for run in runs:
        if run.status != "completed":
            yield f"{run.name} is {run.status}: not every point of it was measured"
    for noted in ([one.data.notes for one in sines], [one.data.notes for one in turnings]):
        for notes in noted:
            yield from notes
    for part in sines:
        bad = [n for n, usable in zip(part.channels.names, part.data.usable, strict=True) if not usable.all()]
        if bad:
            yield f"{part.name}: {', '.join(bad)} clipped or without a reference in some records, left out there"
    for turning in turnings:
        bad = [n for n, usable in zip(turning.channels.names, turning.data.usable, strict=True) if not usable]
        if bad:
            yield f"{turning.name}: {', '.join(bad)} clipped, left out"
