"""Zeros that stray in the course of a sweep's file: a drift, or a reference that jumps and stays there.

A sweep is compared at its sines, which such a thing hardly reaches; what made it may have changed them too. What a
device shows and its reference does not is freed of the sines and turned by a cosine transform. The slowest lines of it
stand above the noise that all the others show, flicker among it as far as they show that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.foreign.faults import bridged
from rig.foreign.finding import Finding
from rig.foreign.lines import even, strongest
from rig.foreign.manifest import Column
from rig.foreign.tables import Foreign, Table
from rig.signals import tone
from rig.signals.noise import NoiseModel, fit_density
from rig.signals.spectrum import log_bins

Array = NDArray[np.float64]
SLOWEST = 3  # half cycles in a file: what drifts or steps once has nearly all of its power there
BELOW = 0.4  # of the driven frequency: lines that tell the noise
FEWEST = 16  # of them
HARMONICS = 6
PER_DECADE = 12.0
BY_CHANCE = 1e-4  # that noise alone strays so in any file of a run
SIGNALS = ("acceleration", "rate", "voltage", "unstated")


@dataclass(frozen=True)
class _Slow:
    """Slow lines of one file: frequencies, Hz, density of each, unit²/Hz, and rows per second."""

    table: Table
    frequency: Array
    density: Array
    rate: float


def findings(data: Foreign) -> Iterator[Finding]:
    """Every device of a sweep whose zero strays from its reference's in a file by more than noise."""
    reference = [one for one in data.manifest.of("reference") if one.quantity in SIGNALS]
    if data.manifest.kind != "sweep" or len(reference) != 1:
        return
    for device in (one for one in data.manifest.of("device") if one.quantity in SIGNALS):
        files = [one for table in data.tables if (one := _slow(data, table, device, reference[0])) is not None]
        for one in files:
            # a step has lines above the slowest too, and its own file's noise would seem to flicker
            others = [other for other in files if other is not one] or [one]
            if _chance(one, _noise(others)) < BY_CHANCE / len(files):
                yield _said(data, device, reference[0], one)


def _said(data: Foreign, device: Column, reference: Column, one: _Slow) -> Finding:
    strayed = math.sqrt(float(np.sum(one.density[:SLOWEST])) * float(one.frequency[0]))
    text = f"{device.channel}: its zero strays from that of {reference.channel} by {strayed:.3g} (rms) within the file"
    accepted = "accepted" in (device.findings, reference.findings)
    return Finding("strays", one.table.label, text, device.channel, accepted=accepted)


def _slow(data: Foreign, table: Table, device: Column, reference: Column) -> _Slow | None:
    """Slow lines of what the device shows and the reference does not; None of a file without a line, or too short."""
    rows, time = even(data, table)
    frequency = strongest(time, data.si(table, reference)[rows]) if len(time) else None
    if frequency is None:
        return None
    shown, true = (bridged(data, table, one)[rows] for one in (device, reference))
    if not np.isfinite(shown).all() or not np.isfinite(true).all():
        return None
    rate = (len(time) - 1) / float(time[-1] - time[0])
    orders = max(1, min(HARMONICS, math.floor(0.49 * rate / frequency)))
    try:
        driven = tone.fit_four(time, true, frequency, orders)
        there = tone.fit_three(time, shown, driven.frequency, orders)
    except BadInput:
        return None
    factor = float((there.amplitudes[0] / driven.amplitudes[0]).real)
    left = tone.residual(there, time, shown) - factor * tone.residual(driven, time, true)
    return _lines(table, left, rate, driven.frequency)


def _lines(table: Table, left: Array, rate: float, driven: float) -> _Slow | None:
    from scipy.fft import dct

    power = dct(left - left.mean(), type=2, norm="ortho")[1:] ** 2 * (2.0 / rate)
    f = np.asarray(np.arange(1, len(left)) * rate / (2.0 * len(left)), np.float64)
    slow = f < BELOW * driven
    return _Slow(table, f[slow], power[slow], rate) if np.count_nonzero(slow) >= FEWEST + SLOWEST else None


def _noise(files: Sequence[_Slow]) -> NoiseModel:
    """White noise and flicker of files by all their lines but the slowest."""
    f, power = (np.concatenate([getattr(one, name)[SLOWEST:] for one in files]) for name in ("frequency", "density"))
    order = np.argsort(f, kind="stable")
    rising = f[order] * (1.0 + 1e-12 * np.arange(len(f)))
    rate = files[0].rate
    return fit_density(log_bins(rising, power[order], PER_DECADE, 1.0), rate, step=0.0, pole=None, shown=True)


def _chance(one: _Slow, model: NoiseModel) -> float:
    """That noise makes the slowest lines as strong as they are: their χ² against F, as its density was estimated."""
    from scipy.special import fdtrc

    f = one.frequency[:SLOWEST]
    ratio = float(np.mean(one.density[:SLOWEST] / model.density(f)))
    u = max(float(np.sqrt(np.mean(model.u_log(f) ** 2))), 1e-3)
    return float(fdtrc(SLOWEST, 2.0 / u**2, ratio))
