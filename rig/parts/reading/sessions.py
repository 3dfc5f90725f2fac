"""Since when a unit may have been on: runs that follow one another closely are of one session.

What settles after power-on goes on from run to run. Nobody records when a unit was switched on; after a long break it
may have been off meanwhile. A session begins where the archive says, whichever of its runs are read: a model is then
the same for all and for one of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rig.archive.records import Recorded, is_imported

BREAK = 3600.0  # s without a record


def begun(runs: Sequence[Recorded]) -> dict[str, float]:
    """First record of the session of each of the rig's own runs, s on the bench's clock, by the run's name."""
    own = sorted((run for run in runs if not is_imported(run) and _starts(run)), key=lambda run: min(_starts(run)))
    found: dict[str, float] = {}
    for number, run in enumerate(own):
        first = _back(min(_starts(run)), reversed(own[:number]))
        known = [found[one.name] for one in own[:number] if min(_starts(one)) == first]
        found[run.name] = known[0] if known else _back(first, _of_its_unit(run))
    return found


def _back(first: float, earlier: Iterable[Recorded]) -> float:
    """Beginning of a session from a record in it, s, back through these runs, latest first, to the first long break."""
    for run in earlier:
        starts = _starts(run)
        if starts and first - max(starts) > BREAK:
            break
        first = min([first, *starts])
    return first


def _of_its_unit(run: Recorded) -> Iterable[Recorded]:
    sensor = run.header["sensor"]["serial"]
    return (one for one in run.earlier() if one.header["sensor"]["serial"] == sensor)


def _starts(run: Recorded) -> list[float]:
    """When its records began, s."""
    metas = [entry.body["meta"] for entry in run.lines if entry.kind == "block"]
    return [float(meta["start"]) for meta in metas if "convert_period" in meta]
