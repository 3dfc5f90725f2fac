"""Since when a unit may have been on: runs that follow one another closely are of one session.

What settles after power-on goes on from run to run. Nobody records when a unit was switched on; after a long break it
may have been off meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rig.archive.records import Recorded, is_imported

BREAK = 3600.0  # s without a record


def begun(runs: Sequence[Recorded]) -> dict[str, float]:
    """First record of the session of each of the rig's own runs, s on the bench's clock, by the run's name."""
    found: dict[str, float] = {}
    first = last = -math.inf
    for name, starts in sorted(_started(runs), key=lambda one: min(one[1])):
        if min(starts) - last > BREAK:
            first = min(starts)
        found[name], last = first, max(last, *starts)
    return found


def _started(runs: Sequence[Recorded]) -> Iterator[tuple[str, list[float]]]:
    """When records of each run began; runs without any are left out."""
    for run in runs:
        metas = [entry.body["meta"] for entry in run.lines if entry.kind == "block"]
        starts = [float(meta["start"]) for meta in metas if "convert_period" in meta]
        if starts and not is_imported(run):
            yield run.name, starts
