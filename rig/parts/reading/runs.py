"""Runs as parts of a fit: one reader for every kind of experiment, the rig's own and imported ones alike."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from rig.archive.records import Recorded, is_imported
from rig.parts.noise_spectrum import NoiseSpectrum
from rig.parts.part import Part
from rig.parts.reading import noise_spectrum, still, sweep, tumble, turntable
from rig.parts.reading.reading import Reading

Reader = Callable[[Sequence[Recorded]], Reading]


def imported(runs: Sequence[Recorded]) -> Reading:
    """Imported ones; what reads other people's files is only loaded where there are any."""
    if not any(is_imported(run) for run in runs):
        return Reading()
    from rig.parts.reading import imported as other_peoples

    return other_peoples.read(runs)


READERS: tuple[Reader, ...] = (sweep.read, turntable.read, tumble.read, still.read, noise_spectrum.read, imported)
"""Each takes of the runs what it can read. A new kind of experiment of the rig's own adds one here."""


def read(runs: Sequence[Recorded]) -> Reading:
    """Everything in these runs that a model can be compared with. Raises BadInput as the readers do."""
    return _wandering(Reading.joined(reader(runs) for reader in READERS))


def _wandering(found: Reading) -> Reading:
    """Parts whose zeros walk at random as the records at rest of the same run show."""
    walks: dict[str, dict[str, float]] = {}
    for rest in (one for one in found.parts if isinstance(one, NoiseSpectrum)):
        walks.setdefault(rest.run, {}).update(rest.walks())
    parts = tuple(one.with_walk(walk) if (walk := walks.get(one.run)) else one for one in found.parts)
    return Reading(parts, found.known)


def all_imported(runs: Sequence[Recorded]) -> bool:
    """Whether somebody else measured all of them."""
    return all(is_imported(run) for run in runs)


def same_unit(run: Recorded, other: Recorded) -> bool:
    """Whether two runs are of one unit; imported ones only name its serial number."""
    mine, its = run.header["sensor"], other.header["sensor"]
    if is_imported(run) or is_imported(other):
        return bool(mine["serial"] == its["serial"])
    return bool(mine == its)


def remarks(run: Recorded) -> Iterator[str]:
    """What is to be said of a run's records as a whole."""
    if run.status != "completed":
        yield f"{run.name} is {run.status}: not every point of it was measured"
    if is_imported(run):
        from rig.foreign.tables import foreign_of

        yield from (one.text for one in foreign_of(run).found)


def twice(runs: Sequence[Recorded], parts: Sequence[Part]) -> Reading | None:
    """Imported runs with sampled references compared up to twice the frequency, None where there is no such thing."""
    if not all_imported(runs):
        return None
    from rig.foreign.tables import foreign_of
    from rig.parts.reading.imported import twice as doubled

    return doubled([foreign_of(run) for run in runs], parts)
