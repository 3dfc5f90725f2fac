"""What a turntable run recorded: window means of every channel, the encoder over the same windows, noise at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.model import Channels
from rig.motion import Array
from rig.parts.reference_motion import Shown
from rig.signals.noise import NoiseModel

SETTLING = 14  # windows at either end of a record of a moving platter, where its acceleration is not well known


@dataclass(frozen=True)
class PlatterRecords:
    """One turntable run in one mounting after another: n windows of c channels.

    `observed` (c, n) V. `counted` is the encoder as its lines were counted, `closed` with the lines that index pulses
    prove lost put back. `records` bounds of the records among the windows, `stretches` bounds of the pieces that are
    whitened together, with `moving` for each. `outward`, `tangent`, `up` unit vectors in the case frame, (3, n).
    """

    name: str
    run: str
    channels: Channels
    observed: Array
    counted: Shown
    closed: Shown
    lost: int
    lines: int
    noise: tuple[NoiseModel, ...]
    interval: float
    time: Array
    records: tuple[tuple[int, int], ...]
    labels: tuple[str, ...]
    stretches: tuple[tuple[int, int], ...]
    motor: NDArray[np.bool_]
    outward: Array
    tangent: Array
    up: Array
    radius: Array
    temperature: Array
    supply: Array
    gravity: float
    usable: NDArray[np.bool_]  # (c,)
    resting: float  # s at rest, from which the noise is known
    graduation: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the disk's pattern: rms rad, u, evidence
    notes: tuple[str, ...] = ()
    since: float | None = None  # s, when the first record of its session began; None: that of its own


def lines_of(data: PlatterRecords) -> tuple[tuple[int, int], ...]:
    """Of every record the mounting, and when it began, in intervals from its first record's beginning; records do not
    overlap.
    """
    found: list[tuple[int, int]] = []
    line, origin, end, before = -1, 0.0, 0, np.zeros(0)
    for first, last in data.records:
        mounted = np.concatenate([data.up[:, first], data.outward[:, first], [float(data.radius[first])]])
        if not np.array_equal(mounted, before):
            line, origin, end, before = line + 1, float(data.time[first]), 0, mounted
        begin = max(round((float(data.time[first]) - origin) / data.interval), end)
        found.append((line, begin))
        end = begin + last - first
    return tuple(found)


def only_stretches(data: PlatterRecords, seconds: float) -> PlatterRecords:
    """The same with stretches of about this length."""
    return replace(data, stretches=stretches_of(data.records, data.interval, seconds, data.counted.rate))


def stretches_of(
    records: Sequence[tuple[int, int]], interval: float, seconds: float, rate: Array
) -> tuple[tuple[int, int], ...]:
    """Records cut into pieces of about equal length; the first windows of a moving record are left out."""
    found = []
    for begin, end in records:
        margin = SETTLING if np.any(rate[begin:end] != 0.0) else 0
        length = end - begin - 2 * margin
        pieces = max(1, round(length * interval / seconds))
        if length // pieces > 4:  # of equal length, so that one transform does them all
            first = begin + margin + np.arange(pieces) * (length // pieces)
            found += [(int(b), int(b) + length // pieces) for b in first]
    return tuple(found)
