"""What is said of an imported sweep beside its numbers: units, clocks, hum, and zeros that wander."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from rig.foreign.manifest import SI_OF, Column
from rig.parts.sweep_lines import drive_clock, mains_seen
from rig.parts.sweep_records import Leftover, SweepRecords
from rig.signals.record_means import wandering


def notes(columns: Sequence[Column], data: SweepRecords) -> Iterator[str]:
    """Sentences on units, the drive's clock, mains lines and zeros; `columns` of the reference and the devices."""
    yield from _unit_notes(columns)
    yield from _clock_notes(data)
    yield from _hum_notes(data)
    yield from _zero_notes(columns[1:], data)


def _unit_notes(columns: Sequence[Column]) -> list[str]:
    bare = [one.channel for one in columns if one.quantity == "unstated"]
    if not bare:
        return []
    text = "is" if len(bare) == 1 else "are"
    return [
        f"the unit of {', '.join(bare)} {text} not stated: numbers are taken as m/s² as they stand, "
        "so gains are ratios to the reference and amplitudes have no unit"
    ]


def _zero_notes(device: Sequence[Column], data: SweepRecords) -> list[str]:
    seconds = float(np.median(data.end - data.begin))
    units = [SI_OF.get(one.quantity, "") for one in device]
    return [
        text
        for name, unit, model in zip(data.channels.names, units, data.noise, strict=True)
        for text in wandering(name, unit, model, seconds)
    ]


def _clock_notes(data: SweepRecords) -> list[str]:
    found = drive_clock(data.frequency, data.nominal, data.leftovers, data.mains)
    return [] if found is None else [found.said]


def _hum_notes(data: SweepRecords) -> list[str]:
    """Mains lines of each channel at their largest, from records at rest if there are any."""
    if not math.isfinite(data.mains):
        return []
    resting = [left for left, index in zip(data.leftovers, data.index, strict=True) if index < 0]
    looked = resting or list(data.leftovers)
    seen = mains_seen(looked, data.mains)
    if seen is None:
        return []
    where = "at rest" if resting else "under way"
    lines = ", ".join(f"{one:.1f}" for one in seen.strongest)
    strongest = [f"{n} {_strongest(looked, c, data.mains)}" for c, n in enumerate(data.channels.names)]
    reference = f"reference {_strongest(looked, None, data.mains)}"
    return [
        f"mains lines {where} at {lines} Hz, kept apart from the drive's harmonics; strongest: "
        f"{', '.join([reference, *strongest])}; files have no common phase of the mains, so hum is not compared"
    ]


def _strongest(leftovers: Sequence[Leftover], channel: int | None, mains: float) -> str:
    """The strongest mains line of a channel (None: of the reference) in words."""
    best = (0.0, 0)
    for left in leftovers:
        size = np.abs(left.reference if channel is None else left.amplitude[:, channel])
        for order in range(1, math.floor((len(size) - 3) * left.resolution / mains) + 1):
            k = round(order * mains / left.resolution)
            near = slice(k - 2, k + 3)
            if not left.taken[near].any():
                best = max(best, (float(size[near].max()), order))
    return f"{best[0]:.2g} at {best[1] * mains:g} Hz"
