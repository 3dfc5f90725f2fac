"""How noisy a device on a shaft is, known without any model: from where the case stood, and from its data sheet.

Above `LOWEST` the spectrum of what the device shows at rest is that of its noise: white and flicker are found by
Whittle's likelihood, with what the data sheet says as a prior of log-normal width. Slower parts of a rest are left out:
a zero that warms up is no noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from rig.foreign.manifest import SheetNoise
from rig.motion import Array
from rig.parts.track import DeviceNoise, TrackRecords
from rig.signals.noise import Beforehand, NoiseModel, by_sheet, fit_density, with_levels
from rig.signals.spectrum import Density, log_bins

STILL = 0.02  # of the rms rate of the record: slower than that a case stands
SHORTEST = 3.0  # s of a rest
MARGIN = 0.5  # s at either end of it, where low-passed motion may reach in
LOWEST = 0.3  # Hz
PER_DECADE = 12.0


def device_noise(data: TrackRecords, sheets: Sequence[SheetNoise | None]) -> tuple[DeviceNoise | None, ...]:
    """Of every channel, None where neither a rest nor a data sheet tells."""
    return tuple(_of_channel(data, row, list(_rests(data, row)), sheet) for row, sheet in enumerate(sheets))


def _rests(data: TrackRecords, row: int) -> Iterator[slice]:
    """Instants at which the case stands and a channel counts, without their margins, within the records."""
    speed = np.sqrt(np.sum(data.rate**2, axis=0))
    still = speed < STILL * math.sqrt(float(np.mean(speed**2)))
    if data.kept is not None:
        still &= data.kept[row]
    margin = math.ceil(MARGIN / data.interval)
    for first, last in data.records:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still[first:last], [False]]).astype(np.int8)))
        for begin, end in zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True):
            if (end - begin - 2 * margin) * data.interval >= SHORTEST:
                yield slice(first + begin + margin, first + end - margin)


def _of_channel(data: TrackRecords, row: int, rests: Sequence[slice], sheet: SheetNoise | None) -> DeviceNoise | None:
    known = {} if sheet is None else _beforehand(data, row, sheet)
    lines = _lines(data, row, rests)
    if lines is not None:
        rate = 1.0 / data.interval
        # flicker that the rest does not show would excuse any zero that creeps, uncertain as it is
        shown = "flicker" not in known
        return DeviceNoise(fit_density(lines, rate, step=0.0, pole=None, shown=shown, beforehand=known), "at rest")
    return None if not known else DeviceNoise(_by_sheet(known, 1.0 / data.interval), "data sheet")


def _lines(data: TrackRecords, row: int, rests: Sequence[slice]) -> Density | None:
    """Density of the lines at rest within the channel's band; None without a rest, or if it shows one number there."""
    from scipy.fft import dct

    of_rate, axis = bool(data.channels.rates[row]), int(data.channels.axis[row])
    band = data.bands[0 if of_rate else 1]
    shown = data.channels.sensitivity[row] * (data.rate if of_rate else data.force)[axis]  # a case may swing a little
    found: list[tuple[Array, Array]] = []
    for rest in rests:
        values = data.observed[row, rest] - shown[rest]
        f = np.arange(len(values)) / (2.0 * len(values) * data.interval)
        inside = (f > LOWEST) & (f <= band)
        power = dct(values - values.mean(), type=2, norm="ortho") ** 2 * (2.0 * data.interval)
        found.append((f[inside], power[inside]))
    f, power = (np.concatenate([one[k] for one in found] or [np.empty(0)]) for k in (0, 1))
    if len(f) < 2 * PER_DECADE or not power.max() > 0.0:
        return None
    order = np.argsort(f, kind="stable")
    return log_bins(f[order] * (1.0 + 1e-12 * np.arange(len(f))), power[order], PER_DECADE, 1.0)


def _beforehand(data: TrackRecords, row: int, sheet: SheetNoise) -> Beforehand:
    """Logarithms of white noise and flicker by the data sheet."""
    density = sheet.density_si(bool(data.channels.rates[row])) * float(data.channels.sensitivity[row])
    return by_sheet(density, sheet.tolerance, sheet.corner)


def _by_sheet(known: Beforehand, rate: float) -> NoiseModel:
    """The data sheet's noise as it stands."""
    names = tuple(known)
    covariance = tuple(tuple(known[a][1] ** 2 if a == b else 0.0 for b in names) for a in names)
    levels = {name: math.exp(at) for name, (at, _) in known.items()}
    return replace(with_levels(rate, levels), names=names, covariance_of_logs=covariance)
