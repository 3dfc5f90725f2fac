"""Lines above the compared band that a gyro and its reference share: the case really moves there.

A motor that steps, or a bearing, shakes what it turns. Such a line is no noise of the sensor if the reference has it
too, in step with it; it is said with a record, so that nobody takes it for noise. Jitter of time stamps takes the
coherence away where the frequency is high: such a line is not found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SECONDS = 10.0  # of a segment
COHERENT = 0.7
STANDS_OUT = 10.0  # times the median power around it
AROUND = 4.0  # Hz on either side: a motor whose speed wavers has broad lines
APART = 1.0  # Hz between two lines
WIDE = 5  # lines of the spectrum on either side that belong to one
MOST = 3


@dataclass(frozen=True)
class SharedLine:
    """One line: frequency (Hz), rms in the gyro (rad/s), gyro ÷ reference, and their coherence."""

    frequency: float
    rms: float
    ratio: float
    coherence: float

    @property
    def in_words(self) -> str:
        """How it is said of a record."""
        return (
            f"{self.frequency:.3g} Hz ({np.degrees(self.rms):.2g} °/s, gyro ÷ reference {self.ratio:.2f}, "
            f"coherence {self.coherence:.2f})"
        )


def shared_lines(angle: Array, gyro: Array, interval: float, above: float) -> list[SharedLine]:
    """The strongest lines above a frequency (Hz) of an angle (rad) and a rate (rad/s), both (n,) every `interval` s."""
    from scipy.ndimage import median_filter
    from scipy.signal import csd, welch

    rate, gyro = np.diff(angle) / interval, 0.5 * (gyro[1:] + gyro[:-1])
    count = round(SECONDS / interval)
    if count < 2 * WIDE or len(rate) < 4 * count:  # no spectrum, or one that is a single line
        return []
    f, reference = welch(rate, 1.0 / interval, nperseg=count)
    own = welch(gyro, 1.0 / interval, nperseg=count)[1]
    both = csd(rate, gyro, 1.0 / interval, nperseg=count)[1]
    width = 2 * round(AROUND * SECONDS) + 1
    coherence = np.abs(both) ** 2 / np.maximum(reference * own, 1e-300)
    out = (f > above) & (f < 0.48 / interval) & (coherence > COHERENT)
    for power in (reference, own):
        out &= power > STANDS_OUT * median_filter(power, width)
    whole = np.convolve(own, np.ones(2 * WIDE + 1), mode="same") * f[1]
    found: list[SharedLine] = []
    for k in sorted(np.flatnonzero(out).tolist(), key=lambda one: -own[one]):
        if len(found) < MOST and all(abs(f[k] - one.frequency) > APART for one in found):
            # the mean of two readings is cos, the difference of two angles sinc of the same half interval
            averaged, stepped = np.cos(np.pi * f[k] * interval), np.sinc(f[k] * interval)
            rms = float(np.sqrt(whole[k])) / averaged
            ratio = float(np.sqrt(own[k] / reference[k])) * stepped / averaged
            found.append(SharedLine(float(f[k]), rms, ratio, float(coherence[k])))
    return found
