"""Everything that a model of a unit is compared with: the parts of a fit, and what is known of the bench."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from rig.archive.records import Recorded, experiments
from rig.errors import BadInput
from rig.fit.fit import Fit, State, begin, fit
from rig.foreign.tables import foreign_of, is_foreign
from rig.model import Term
from rig.parts import nuisances
from rig.parts.part import Part, Tabled
from rig.parts.ranges import beyond_range
from rig.parts.reading.imported import parts_of
from rig.parts.reading.sweep import shaken
from rig.parts.reading.turntable import spun
from rig.parts.reference_gain import shared
from rig.parts.sines import Sines
from rig.parts.turning import Turning


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
    imported: bool = False  # whether all runs are

    @property
    def sines(self) -> list[Sines]:
        """Mountings on the shaker."""
        return [part for part in self.parts if isinstance(part, Sines)]

    @property
    def turnings(self) -> list[Turning]:
        """Turntable runs."""
        return [part for part in self.parts if isinstance(part, Turning)]

    @property
    def tabled(self) -> list[Tabled]:
        """Imported records that say themselves what their rows are."""
        return [part for part in self.parts if isinstance(part, Tabled)]

    @property
    def training(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Rows that are not held out, (rows,)."""
        return np.concatenate([~part.held_out for part in self.parts])

    def start(self, terms: Sequence[Term] = (), *, poles: bool = True, shared: bool = False) -> State:
        """Where a fit of a model begins."""
        return begin(self.parts, [*self.nuisances, *terms], poles=poles, shared=shared)

    def fitted(self, terms: Sequence[Term] = (), *, poles: bool = True, shared: bool = False) -> Fit:
        """The data-sheet model with these effects, fitted to everything."""
        return fit(self.parts, self.start(terms, poles=poles, shared=shared))


def evidence_of(runs: Sequence[Recorded]) -> Evidence:
    """Read the runs of one unit. Raises BadInput for runs of several units, or that no model can be compared with."""
    _of_one_unit(runs)
    own = [run for run in runs if not is_foreign(run)]
    imported = [parts_of(foreign_of(run)) for run in runs if is_foreign(run)]
    sines = [Sines(data) for run in own for data in shaken(run)]
    turnings = [Turning(data) for run in own for data in spun(run)]
    parts: tuple[Part, ...] = (*sines, *turnings, *(part for made, _ in imported for part in made))
    if not parts:
        names = ", ".join(run.name for run in runs)
        raise BadInput(f"{names}: found no sines and no turning platter, wanted a sweep or a turntable run")
    done = [one for run in own for one in experiments(run)]
    known = shared([term for _, terms in imported for term in terms])
    if sines:
        known += nuisances.of_shaker([one for one in done if any("frequency" in b for b in one.points.values())])
    if turnings:
        known += nuisances.of_turntable([one for one in done if any("phase" in b for b in one.points.values())])
    header = runs[0].header
    return Evidence(
        parts, tuple(known), tuple(run.name for run in runs), str(header["sensor"]["serial"]),
        any(bool(run.header["simulated"]) for run in runs), tuple(_notes(runs, parts)),
        tuple(dict.fromkeys(said for part in parts if isinstance(part, Tabled) for said in part.blind)),
        not own,
    )  # fmt: skip


def _of_one_unit(runs: Sequence[Recorded]) -> None:
    if not runs:
        raise BadInput("found no run, wanted at least one")
    for run in runs[1:]:
        if not _same_unit(run, runs[0]):
            raise BadInput(f"{run.name}: found another unit than in {runs[0].name}, wanted runs of one unit")


def _same_unit(run: Recorded, other: Recorded) -> bool:
    """Whether two runs are of one unit; imported ones only name its serial number."""
    mine, its = run.header["sensor"], other.header["sensor"]
    if is_foreign(run) or is_foreign(other):
        return bool(mine["serial"] == its["serial"])
    return bool(mine == its)


def _notes(runs: Sequence[Recorded], parts: Sequence[Part]) -> Iterator[str]:
    for run in runs:
        if run.status != "completed":
            yield f"{run.name} is {run.status}: not every point of it was measured"
        if is_foreign(run):
            yield from foreign_of(run).found
    sines = [part for part in parts if isinstance(part, Sines)]
    turnings = [part for part in parts if isinstance(part, Turning)]
    for one in parts:
        if isinstance(one, Tabled):
            yield from one.notes
        elif isinstance(one, Sines | Turning):
            yield from one.data.notes
            if (
                own := next((run for run in runs if run.name == one.data.run and not is_foreign(run)), None)
            ) is not None:
                yield from beyond_range(own, one)
    for part in sines:
        bad = [n for n, usable in zip(part.channels.names, part.data.usable, strict=True) if not usable.all()]
        if bad:
            yield f"{part.name}: {', '.join(bad)} clipped or without a reference in some records, left out there"
    for turning in turnings:
        bad = [n for n, usable in zip(turning.channels.names, turning.data.usable, strict=True) if not usable]
        if bad:
            yield f"{turning.name}: {', '.join(bad)} clipped, left out"
