"""What a sweep recorded in one mounting: lines of every channel at every point, their noise and the conditions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.model import Channels
from rig.motion import ORDERS, Array, Complexes
from rig.signals.noise import NoiseModel

MAINS_ORDERS = (1, 3)
LINES = ORDERS + len(MAINS_ORDERS)  # mean, harmonics, mains lines
WIDTH = 2 * LINES - 1  # rows of one record of a channel: the mean, then two for each line


@dataclass(frozen=True)
class Leftover:
    """What the fit of one record left over: amplitudes at multiples of `resolution` Hz, V, (f, c).

    `reference` is that of the reference; `taken` marks lines that the fit has emptied.
    """

    begin: float
    resolution: float
    amplitude: Complexes
    reference: Complexes
    taken: NDArray[np.bool_]


@dataclass(frozen=True)
class SweepRecords:
    """What was recorded in one mounting, p records of c channels, records at rest among them (`index` −1).

    `observed` (c, p, LINES) V, complex; `variance` of each part, same shape, NaN where there is no line. `shown`
    complex acceleration of the drive that the reference shows, m/s², (p, 6), with `reference_variance` (p, 6) of each
    part, (m/s²)²; `gated` the same without samples that stand out of its record, whose share and depth `outliers`
    tells, (p, 2). `frequency` Hz, `begin` and `end` s on the bench's clock, `level`, all (p,). `usable` (c, p).
    """

    name: str
    run: str
    axis: str
    channels: Channels
    observed: Complexes
    before: Complexes
    variance: Array
    noise: tuple[NoiseModel, ...]
    shown: Complexes
    gated: Complexes
    outliers: Array
    reference_variance: Array
    frequency: Array
    nominal: Array
    begin: Array
    end: Array
    level: tuple[str, ...]
    index: NDArray[np.intp]
    usable: NDArray[np.bool_]
    source: Array
    scale: Array
    temperature: Array
    supply: Array
    mains: float
    gravity: float
    directions: Array  # drive, up and side in the case frame, (3, 3), columns
    leftovers: tuple[Leftover, ...] = ()
    notes: tuple[str, ...] = ()
    drive_off: bool = False  # and not the recorder's clock; else `leftovers` tell
    held: NDArray[np.bool_] | None = None  # (p,): points that a model is judged by; every third without
    vibrometer: bool = True  # whether the reference is one
    since: float | None = None  # s, when the first record of its session began; None: that of its own

    @property
    def driven(self) -> NDArray[np.bool_]:
        """Whether a record was driven, (p,)."""
        return np.asarray(self.index >= 0)

    @property
    def along(self) -> NDArray[np.intp]:
        """Accelerometers that feel the drive."""
        felt = self.directions[self.channels.axis, 0] != 0.0
        return np.flatnonzero(felt & ~self.channels.rates)


def split(rows: Array, channels: int, points: int) -> tuple[Array, Complexes]:
    """Rows as means (c, p) and complex lines (c, p, LINES − 1), in standard deviations."""
    table = rows.reshape(channels, points, WIDTH)
    lines = table[..., 1:].reshape(channels, points, LINES - 1, 2)
    return table[..., 0], np.asarray(lines[..., 0] + 1j * lines[..., 1])


def directions(axis: str) -> Array:
    """Drive, up and side in the case frame for a sweep of this axis: the next axis is up, the one after it aside."""
    along = "xyz".index(axis)
    return np.eye(3)[:, [(along + step) % 3 for step in range(3)]]


def domains() -> tuple[str, ...]:
    """Domains of a record's rows, in their order: the mean, then two rows for each line."""
    return ("mean", *(f"{k}f" for k in range(1, ORDERS)), *("mains" if m == 1 else f"{m}×mains" for m in MAINS_ORDERS))
