"""Whether what accelerometers show in poses is gravity in the stated directions; zero outputs and gains are free.

Every channel follows `gain·expected + zero` over its poses, or it does not, and then its poses say where.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
ASKEW = 0.25  # of gravity: 14° of a pose, or as much of a wrong gain
FAINT = 0.2  # of the declared sensitivity: less is no accelerometer on this wire
CLEARLY = 0.5  # times as far off, and less, decides for the other sign
FEWEST = 4  # poses that say something of a channel with gain and zero of its own


def following(felt: Array, expected: Array) -> tuple[Array, Mask]:
    """Gain (c,) of channels in poses, and where they do not follow, (n, c); both inputs (n, c), in units of gravity.

    A channel that follows with any gain does so everywhere. Else it is held against its declared gain, with the sign
    that suits it better.
    """
    columns = [_followed(one, other) for one, other in zip(felt.T, expected.T, strict=True)]
    gains, off = zip(*columns, strict=True)
    return np.array(gains), np.column_stack(off)


def _followed(felt: Array, expected: Array) -> tuple[float, Mask]:
    design = np.column_stack([expected, np.ones(len(expected))])
    gain = float(np.linalg.lstsq(design, felt, rcond=None)[0][0])
    left = felt - gain * expected
    if np.ptp(expected) > ASKEW and abs(gain) >= FAINT and _away(left).max() <= ASKEW * max(abs(gain), 1.0):
        return gain, np.zeros(len(felt), np.bool_)
    plain, turned = (float(_away(felt - one * expected).mean()) for one in (1.0, -1.0))
    sign = -1.0 if turned < CLEARLY * plain else 1.0
    return sign, _away(felt - sign * expected) > ASKEW


def _away(values: Array) -> Array:
    return np.asarray(np.abs(values - np.median(values)))
