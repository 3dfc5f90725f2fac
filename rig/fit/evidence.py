"""Everything that a model of a unit is compared with: the parts of a fit, and what is known of the bench."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from rig.archive.records import Recorded
from rig.errors import BadInput
from rig.fit.fit import Fit, State, begin, fit
from rig.model import Term
from rig.parts.part import Part
from rig.parts.reading import runs as reading
from rig.parts.reading.reading import Reading
from rig.parts.reading.runs import Reader


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
    twice: Callable[[], Reading | None] | None = field(default=None, repr=False)  # compared up to twice the frequency

    @property
    def training(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Rows that are not held out, (rows,)."""
        return np.concatenate([~part.held_out for part in self.parts])

    def further(self) -> Evidence | None:
        """The same records with every sampled reference compared up to twice the frequency; None if none can be."""
        found = None if self.twice is None else self.twice()
        return None if found is None else replace(self, parts=found.parts, nuisances=found.known, twice=None)

    def start(self, terms: Sequence[Term] = (), *, poles: bool = True, shared: bool = False) -> State:
        """Where a fit of a model begins."""
        return begin(self.parts, [*self.nuisances, *terms], poles=poles, shared=shared)

    def fitted(self, terms: Sequence[Term] = (), *, poles: bool = True, shared: bool = False) -> Fit:
        """The data-sheet model with these effects, fitted to everything."""
        return fit(self.parts, self.start(terms, poles=poles, shared=shared))


def evidence_of(runs: Sequence[Recorded], read: Reader = reading.read) -> Evidence:
    """Read the runs of one unit, by the converter unless `read` has another recorder. Raises BadInput for runs of
    several units, or that no model can be compared with.
    """
    _of_one_unit(runs)
    found = read(runs)
    if not found.parts:
        names = ", ".join(run.name for run in runs)
        wanted = "wanted a sweep, a turntable run, a tumble or a record at rest"
        raise BadInput(f"{names}: found nothing that a model can be compared with, {wanted}")
    header = runs[0].header
    return Evidence(
        found.parts, found.known, tuple(run.name for run in runs), str(header["sensor"]["serial"]),
        any(bool(run.header["simulated"]) for run in runs), tuple(_notes(runs, found.parts)),
        tuple(dict.fromkeys(said for part in found.parts for said in part.blind)), reading.all_imported(runs),
        partial(reading.twice, tuple(runs), found.parts),
    )  # fmt: skip


def _of_one_unit(runs: Sequence[Recorded]) -> None:
    if not runs:
        raise BadInput("found no run, wanted at least one")
    for run in runs[1:]:
        if not reading.same_unit(run, runs[0]):
            raise BadInput(f"{run.name}: found another unit than in {runs[0].name}, wanted runs of one unit")


def _notes(runs: Sequence[Recorded], parts: Sequence[Part]) -> Iterator[str]:
    for run in runs:
        yield from reading.remarks(run)
    for part in parts:
        yield from part.notes
    for part in parts:
        yield from part.left_out()
