"""Whose distortion is it: the shaker's, which reference and device both show, or the device's own?

A harmonic that the shaker makes is in the motion: the device shows it with the gain it has for the drive,  B_k = g·A_k.
What the device adds by itself is  D_k = B_k − g·A_k.  Its share  √(Σ|D_k|²/Σ|B_k|²)  over the harmonics 2 … 5 decides:
hardly any is the shaker's distortion, nearly all is the device's.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.foreign.tables import Foreign
from rig.motion import ORDERS
from rig.parts.sweep_records import SweepRecords
from rig.signals import tone

Array = NDArray[np.float64]
Whose = Literal["none", "shaker", "device", "both"]
SMALL = 0.1  # share of the device's harmonics that may be its own while the shaker is named
LARGE = 0.5  # share from which the device is named
SIGNIFICANT = 25.0  # χ² per harmonic
SEEN = 1e-3  # of the fundamental: smaller harmonics are not worth a sentence
COMPRESSED = 0.02  # relative spread of the gain from drive to reference
FEWEST = 3  # levels of one dial
RANGE = 1.5  # largest over smallest drive of one dial


@dataclass(frozen=True)
class Gain:
    """Device over reference at one level: magnitude with the standard uncertainty of each part, and phase, rad."""

    channel: str
    level: str
    magnitude: float
    u: float
    phase: float


@dataclass(frozen=True)
class Distortion:
    """Harmonics 2 … 5 of one device over all levels: `share` of them that the reference does not show, and `chi2` of
    that share per harmonic; `largest` and `reference` are those of device and reference over the fundamental."""

    channel: str
    whose: Whose
    share: float
    chi2: float
    largest: float
    reference: float


def gains(data: SweepRecords) -> list[Gain]:
    """Gain of every accelerometer at every driven record."""
    found = []
    for c, name in enumerate(data.channels.names):
        for p in np.flatnonzero(data.index >= 0):
            below = complex(data.shown[p, 1])
            ratio = complex(data.observed[c, p, 1]) / below
            variance = data.variance[c, p, 1] + abs(ratio) ** 2 * data.reference_variance[p, 1]
            u = math.sqrt(float(variance)) / abs(below)
            found.append(Gain(name, data.level[p], abs(ratio), u, math.atan2(ratio.imag, ratio.real)))
    return found


def distortions(data: SweepRecords) -> list[Distortion]:
    """Whose the harmonics are, for every channel."""
    return [_distortion(data, c) for c in range(len(data.channels.names))]


def _distortion(data: SweepRecords, c: int) -> Distortion:
    driven = np.flatnonzero(data.index >= 0)
    device, shown = data.observed[c, driven][:, 1:ORDERS], data.shown[driven][:, 1:ORDERS]
    gain = device[:, :1] / shown[:, :1]
    own = (device - gain * shown)[:, 1:]
    variance = (data.variance[c, driven] [:, 2:ORDERS]
                + np.abs(gain) ** 2 * data.reference_variance[driven][:, 2:])  # fmt: skip
    good = np.isfinite(own) & (variance > 0.0)
    power = float(np.sum(np.abs(device[:, 1:][good]) ** 2))
    share = math.sqrt(float(np.sum(np.abs(own[good]) ** 2)) / power) if power > 0.0 else 0.0
    chi2 = float(np.mean(np.abs(own[good]) ** 2 / (2.0 * variance[good]))) if good.any() else 0.0
    largest, reference = (float(np.nanmax(np.abs(one[:, 1:] / one[:, :1]))) for one in (device, shown))
    return Distortion(data.channels.names[c], _whose(share, chi2, largest), share, chi2, largest, reference)


def _whose(share: float, chi2: float, largest: float) -> Whose:
    if largest < SEEN:
        return "none"
    if share < SMALL or chi2 < SIGNIFICANT:
        return "shaker"
    return "device" if share > LARGE else "both"


def shaker_remarks(foreign: Foreign, data: SweepRecords) -> tuple[str, ...]:
    """What is to be said of distortion, of compression and of the gain at every level, with the figures."""
    return (
        *(_verdict(one) for one in distortions(data)),
        *_compression(foreign, data),
        *_harmonics(data),
        *_gain_said(data),
    )


def _verdict(one: Distortion) -> str:
    seen = (
        f"harmonics up to {one.largest:.1%} of the fundamental in {one.channel}, {one.reference:.1%} in the reference"
    )
    own = f"{one.share:.1%} of them is not in the reference"
    if one.whose == "none":
        return f"no distortion: {seen}"
    if one.whose == "shaker":
        rest = "within noise" if one.chi2 < SIGNIFICANT else f"{math.sqrt(one.chi2):.0f} times its noise"
        return f"the distortion is the shaker's, not the sensor's: {seen}; {own} ({rest})"
    if one.whose == "device":
        return f"the distortion is the sensor's own, not the shaker's: {seen}; {own}"
    return f"the distortion is partly the shaker's and partly the sensor's own: {seen}; {own}"


def _driven(data: SweepRecords) -> list[int]:
    """Driven records, from the smallest motion to the largest."""
    return sorted(np.flatnonzero(data.index >= 0).tolist(), key=lambda p: abs(complex(data.shown[p, 1])))


def _compression(foreign: Foreign, data: SweepRecords) -> Iterator[str]:
    """Gain from the drive signal to the reference by level, if the drive was recorded, one dial at a time."""
    if not foreign.manifest.of("drive"):
        return
    drives = {p: _drive(foreign, data, p) for p in _driven(data)}
    for group in _one_dial(foreign, drives):
        found = {p: abs(complex(data.shown[p, 1])) / drives[p] for p in group}
        if max(found.values()) / min(found.values()) - 1.0 < COMPRESSED:
            continue
        extremes = (min(found, key=lambda p: found[p]), max(found, key=lambda p: found[p]))
        told = sorted({group[0], *extremes, group[-1]}, key=group.index)
        listed = ", ".join(f"{found[p]:.3f} at {data.level[p]}" for p in told)
        yield f"the shaker does not follow its drive in proportion: reference over drive, by rising drive, is {listed}"


def _drive(foreign: Foreign, data: SweepRecords, p: int) -> float:
    """Amplitude of the drive signal at the driven frequency, in its SI unit."""
    table = foreign.tables[p]
    stamps, signal = foreign.time(table), foreign.si(table, foreign.manifest.of("drive")[0])
    return tone.fit_three(stamps - stamps[0], signal, float(data.frequency[p])).magnitude


def _one_dial(foreign: Foreign, drives: Mapping[int, float]) -> Iterator[list[int]]:
    """Records whose settings differ in nothing but one, which sets the drive signal; by rising drive."""
    seen: set[frozenset[int]] = set()
    names = {name for p in drives for name in foreign.tables[p].settings if name != "frequency"}
    for name in sorted(names):
        groups: dict[tuple[tuple[str, str], ...], list[int]] = {}
        for p in drives:
            rest = {k: str(v) for k, v in foreign.tables[p].settings.items() if k not in (name, "level")}
            groups.setdefault(tuple(sorted(rest.items())), []).append(p)
        for group in groups.values():
            size = [drives[p] for p in group]
            if len(group) >= FEWEST and max(size) > RANGE * min(size) and frozenset(group) not in seen:
                seen.add(frozenset(group))
                yield sorted(group, key=lambda p: drives[p])


def _harmonics(data: SweepRecords) -> Iterator[str]:
    """Harmonics of the reference, in per cent of the fundamental, at the smallest, middle and largest motion."""
    order = _driven(data)
    if not order or not any(one.whose in ("shaker", "both") for one in distortions(data)):
        return
    chosen = dict.fromkeys((order[0], order[len(order) // 2], order[-1]))
    for p in chosen:
        share = np.abs(data.shown[p, 2:ORDERS] / data.shown[p, 1])
        listed = ", ".join(f"{k}f {one:.1%}" for k, one in enumerate(share, 2))
        yield f"the shaker's own harmonics at {data.level[p]}: {listed}"


def _gain_said(data: SweepRecords) -> Iterator[str]:
    every = gains(data)
    for name in data.channels.names:
        yield _spread(name, [one for one in every if one.channel == name])


def _spread(name: str, found: Sequence[Gain]) -> str:
    size = np.array([one.magnitude for one in found])
    least, most = min(found, key=lambda one: one.magnitude), max(found, key=lambda one: one.magnitude)
    noise = max(one.u for one in found)
    if len(found) == 1:
        return f"{name} over reference: {size[0]:.4f} ± {noise:.1g} by noise"
    away = float(np.abs(size - size.mean()).max())
    return (
        f"{name} over reference is {size.mean():.4f} ± {away:.4f} at every level: from {least.magnitude:.4f} "
        f"({least.level}) to {most.magnitude:.4f} ({most.level}), uncertain by noise up to {noise:.1g}"
    )
