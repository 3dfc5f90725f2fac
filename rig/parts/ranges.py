"""Channels that were driven beyond the range of their data sheet: what they show there is not what they feel."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rig import units
from rig.archive.records import Recorded
from rig.parts.platter import Platter
from rig.parts.sweep import Sweep


def beyond_range(run: Recorded, part: Sweep | Platter) -> Iterator[str]:
    """One sentence for every channel of a part of this run that felt more than its part is made for."""
    stated, motion = run.header["sensor"]["channels"], part.moved(())
    for row, name in enumerate(part.channels.names):
        kind = str(stated[name]["quantity"])  # of unit, too
        felt = (motion.rate if part.channels.rates[row] else motion.force)[part.channels.axis[row]]
        most, limit = float(np.nanmax(np.abs(felt))), units.parse(stated[name]["range"], kind)
        if most > limit:
            yield (
                f"{part.name}: {name} ({stated[name]['part']}) felt up to {units.format_quantity(most, kind)}, "
                f"beyond its range of {stated[name]['range']}"
            )
