"""How noisy a device on a shaft is where its motion does not stand: white noise in the band above it.

A device that neither stood still nor has a data sheet still shows its noise above the motion: there the spectrum of
every channel is flat, the same all over the record, and nothing that channels share. Where it is not (lines, flicker,
a filter, codes, vibration), or reaches not far enough, or disagrees with what no filter of the reference explains
within the compared band, nothing is known of the noise. What is slower than the band above shows none of its flicker:
therefore that agreement.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rig.motion import Array
from rig.parts.track import DeviceNoise, TrackedMotion, TrackRecords
from rig.signals.noise import with_levels

ABOVE = (2.5, 4.0, 6.0)  # times where the motion meets its noise: from the first of them on that shows nothing else
HIGHEST = 0.25  # of the sampling rate: a spline keeps what is below
SEGMENT = 4.0  # s
FEWEST = 300  # lines, of which the level is known to 6 %
OCTAVE = 1.0  # at least
UNUSUAL = 4.0  # standard deviations of a sixth of the band, of a sixth of the record, of a shared part
WHITE = 2.0  # times the noise of codes in power that white noise must have
LESS, MORE = 0.67, 1.3  # times in power that may be left in either half of the compared band
BY_CHANCE = 1e-3  # that a line of noise is as loud as the loudest may be
PARTS = 6


def above_motion(
    data: TrackRecords, rows: Sequence[Array], codes: Sequence[float], step: float, ends: float
) -> TrackRecords:
    """The records with the noise of every channel known; as they are where it is not told of all.

    `rows`: every channel's values, (channels, n), of every piece of the records, on an even grid of `step` s. `codes`:
    the smallest step between numbers of a channel. `ends` Hz: where the motion does not stand out any more.
    """
    tried = (_lines(rows, step, times * ends, HIGHEST / step) for times in ABOVE)
    plain = (one for one in tried if one is not None and all(map(_plain, one)) and not _shared(one))
    if (lines := next(plain, None)) is None:
        return data
    levels = np.mean(np.abs(lines) ** 2, axis=(1, 2))
    if any(level * 0.5 / step < WHITE * code**2 / 12.0 for level, code in zip(levels, codes, strict=True)):
        return data
    models = (with_levels(1.0 / step, {"white": float(level)}) for level in levels)
    u = ((1.0 / lines[0].size,),)
    noise = tuple(
        DeviceNoise(replace(one, names=("white",), covariance_of_logs=u), "above the motion") for one in models
    )
    made = replace(data, noise=noise, jitter=0.0)  # of a moving device's stamps: it is in the band above too
    return made if _agrees(data, made) else data


def _lines(rows: Sequence[Array], step: float, low: float, high: float) -> Array | None:
    """Lines of half-overlapping segments under Hann's window, in roots of a density, (channels, segments, lines);
    None if there are too few.
    """
    count = round(SEGMENT / step)
    if count < 2 * PARTS:
        return None
    window = np.hanning(count)
    scale = math.sqrt(2.0 * step / float(window @ window))
    f = np.fft.rfftfreq(count, step)
    use = np.flatnonzero((f > low) & (f < high))[::2]  # nearly independent under this window
    if high < 2.0**OCTAVE * low or not len(use):
        return None
    cut = [piece[:, at : at + count] for piece in rows for at in range(0, piece.shape[1] - count + 1, count // 2)]
    found = [np.fft.rfft(window * (one - one.mean(axis=1, keepdims=True)))[:, use] * scale for one in cut]
    if len(found) * len(use) < FEWEST:
        return None
    return np.stack(found, axis=1)


def _plain(lines: Array) -> bool:
    """Whether lines (segments, lines) are those of white noise: level all over, in frequency and time, and normal."""
    power = np.abs(lines) ** 2
    level = float(power.mean())
    for axis in (0, 1):
        for part in np.array_split(power, PARTS, axis=axis):
            if part.size and abs(float(part.mean()) / level - 1.0) * math.sqrt(part.size / 1.5) > UNUSUAL:
                return False
    return bool(power.max() < level * math.log(power.size / BY_CHANCE))


def _shared(lines: Array) -> bool:
    """Whether any two channels have a part in common: vibration is no noise of a channel."""
    for one, other in itertools.combinations(lines, 2):
        size = math.sqrt(float(np.mean(np.abs(one) ** 2) * np.mean(np.abs(other) ** 2)))
        if abs(complex(np.mean(one * other.conj()))) * math.sqrt(one.size / 1.5) > UNUSUAL * size:
            return True
    return False


def _agrees(plain: TrackRecords, made: TrackRecords) -> bool:
    """Whether the noise within the compared band is what no filter of the reference explains there."""
    found, known = TrackedMotion(plain), TrackedMotion(made)
    f = found.frequency_of
    for row, (one, other) in enumerate(zip(found.variance, known.variance, strict=True)):
        band = plain.bands[0 if plain.channels.rates[row] else 1]
        for half in ((f > 0.0) & (f <= 0.5 * band), (f > 0.5 * band) & (f <= band)):
            if half.any() and not LESS < float(np.mean(one[half] / other[half])) < MORE:
                return False
    return True
