"""Sweeps that the bench could do next, as they would be recorded: motion, noise and conditions, nothing observed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rig.motion import ORDERS, Array
from rig.parts.conditions import continued
from rig.parts.part import Option, Part
from rig.parts.sweep_records import LINES, SweepRecords, directions

HIGHEST = 1000.0  # Hz; the converter allows 1220, but records of 1 s lose whole cycles near that
RECORD, PAUSE = 1.0, 1.6  # s of one point, and between two; longer ones lose whole cycles
ASIDE = 0.002  # of the acceleration: harmonics that a shaker has
MINUTES_MOUNT = 4.0  # of an operator: mount, cables, beam
SHARES = {"full": 1.0, "half": 0.5, "quarter": 0.25, "eighth": 0.125}
Plan = tuple[str, Sequence[str], tuple[float, float], int]
"""Axis, levels, limits of frequency (Hz) and points of a sweep."""


def options(data: SweepRecords, make: Callable[[SweepRecords], Part]) -> Iterator[Option]:
    """Sweeps that the bench can do: again, wider, with more points or levels, along another axis, later."""
    axis = data.axis
    band, wide = (20.0, 500.0), (60.0, HIGHEST)
    others, both = [one for one in "xyz" if one != axis], ("full", "quarter")
    for name, why, of, levels, limits, points in (
        ("repeat", "more of the same", axis, both, band, 24),
        ("wider band", "dynamics that look alike below 500 Hz part above it", axis, both, wide, 24),
        ("wider band, more points", "the same with less noise", axis, both, wide, 64),
        ("three levels", "laws of level part", axis, ("full", "half", "eighth"), band, 24),
        ("more points", "less noise in every parameter", axis, both, band, 64),
        (f"axis {others[0]}", "what goes with the cube turns with it", others[0], both, band, 24),
        (f"axis {others[1]}", "what goes with the cube turns with it", others[1], both, band, 24),
    ):
        minutes = MINUTES_MOUNT + points * len(levels) * (RECORD + PAUSE) / 60.0
        document = {
            "procedure": "frequency_sweep", "axis": of, "start": f"{limits[0]:g} Hz", "stop": f"{limits[1]:g} Hz",
            "points": points, "levels": list(levels),
        }  # fmt: skip
        yield Option(name, why, minutes, document, _sweep(data, make, (of, levels, limits, points)))
    later = {"title": "The same sweep ten minutes later",
             "steps": [{"wait": "600 s"}, {"procedure": "frequency_sweep", "axis": axis}]}  # fmt: skip
    yield Option("later", "temperature, supply and time since power-up part", 16.0, later,
                 _sweep(data, make, (axis, both, band, 24), later=600.0))  # fmt: skip


def _sweep(
    data: SweepRecords, make: Callable[[SweepRecords], Part], plan: Plan, later: float = 0.0
) -> Callable[[], Part]:
    return lambda: make(swept(data, *plan, later=later))


def swept(
    data: SweepRecords, axis: str, levels: Sequence[str], limits: tuple[float, float], points: int,
    seconds: float = RECORD, later: float = 0.0,
) -> SweepRecords:  # fmt: skip
    """A sweep as it would be recorded after the one of `data`: motion, noise and conditions, nothing observed."""
    peaks = np.abs(data.shown[:, 1])
    highest = float(peaks.max())
    stroke = float(np.max(peaks / np.maximum((2.0 * math.pi * data.frequency) ** 2, 1.0)))
    f = np.tile(np.geomspace(*limits, points), len(levels))
    share = np.repeat([SHARES[level] for level in levels], points)
    target = share * np.minimum(highest, stroke * (2.0 * math.pi * f) ** 2)
    order = np.argsort(np.modf(np.arange(len(f)) * 0.6180339887)[0])  # a fixed disorder
    f, target = f[order], target[order]
    along = np.zeros((len(f), ORDERS), np.complex128)
    along[:, 1] = target
    along[:, 2:] = ASIDE * target[:, None]
    begin = np.asarray(float(data.end.max()) + 60.0 + later + np.arange(len(f)) * (seconds + PAUSE), np.float64)
    channels = data.channels
    lines = np.zeros((len(channels.names), len(f), LINES))
    at = np.concatenate([f[:, None] * np.arange(ORDERS), np.full((len(f), LINES - ORDERS), data.mains)], axis=1)
    for c, model in enumerate(data.noise):
        lines[c] = model.density(np.minimum(np.maximum(at, 1.0), 0.49 * model.rate)) / seconds
    lines[:, at > 0.49 * data.noise[0].rate] = np.nan
    middle, before = begin + 0.5 * seconds, 0.5 * (data.begin + data.end)
    return replace(
        data, name=f"next {axis}", axis=axis, observed=np.zeros(lines.shape, np.complex128),
        before=np.zeros(lines.shape, np.complex128), variance=lines, shown=along, gated=along,
        outliers=np.zeros((len(f), 2)), reference_variance=_reference_noise(data, f, seconds),
        frequency=f, nominal=f, begin=begin, end=np.asarray(begin + seconds, np.float64), index=np.arange(len(f)),
        level=tuple(levels[int(k)] for k in (order // points)), usable=np.ones((len(channels.names), len(f)), np.bool_),
        source=np.interp(f, np.sort(data.frequency), data.source[np.argsort(data.frequency)]),
        scale=np.full(len(f), float(np.median(data.scale[data.scale > 0.0]))),
        temperature=continued(before, data.temperature, middle),
        supply=continued(before, data.supply, middle), directions=directions(axis), leftovers=(),
        drive_off=False, notes=(),
    )  # fmt: skip


def _reference_noise(data: SweepRecords, f: Array, seconds: float) -> Array:
    """Variance of the reference's lines: that of its velocity is the same at all frequencies."""
    driven = data.frequency > 0.0
    length = float(np.median((data.end - data.begin)[driven]))
    velocity = np.median(data.reference_variance[driven, 1] / (2.0 * math.pi * data.frequency[driven]) ** 2)
    omega = 2.0 * math.pi * np.multiply.outer(f, np.arange(ORDERS))
    return np.asarray(velocity * length / seconds * omega**2)
