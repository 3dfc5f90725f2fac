"""By which law a misfit of a turntable run grows: with angle, rate, temperature, supply or time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rig.motion import Array
from rig.parts.laws import Shape, conditions
from rig.parts.platter_records import PlatterRecords
from rig.parts.remainder import Growth, Prediction, Reversal

SMOOTH = 2.0  # s, about one revolution
NEAR = 0.1  # relative difference of two rates that are compared
SEEN = 3.0  # standard deviations
MEANS = "mean, moving"


def shapes(data: PlatterRecords, component: str) -> Iterator[Shape]:
    """Laws of a component; for an order per revolution only those of that order, as wow itself has others."""
    size = data.channels.sensitivity[:, None] * 1e-3
    for words, signals in _signals(data):
        if "revolution" in component:
            if not words.startswith(component):
                continue
            words = words.removeprefix(f"{component}, ")
        yield Shape(words, tuple(size * np.broadcast_to(s, (len(size), len(s))) for s in signals))


def _signals(data: PlatterRecords) -> Iterator[tuple[str, Sequence[Array]]]:
    """Laws of a platter in words, with signals (n,) that belong to them."""
    axis = int(np.argmax(np.abs(data.up).mean(axis=1)))
    platter = data.counted.rate
    top = float(np.abs(platter).max()) or 1.0
    w = data.up[axis] * _smooth(data, platter) / top
    fast = np.abs(w)
    angle = np.where(np.isfinite(data.counted.angle), data.counted.angle, 0.0)
    for order, times in ((1, "once"), (2, "twice"), (3, "three times")):
        for q, said in ((0, "whatever the rate"), (1, "as the rate"), (2, "as the square of the rate")):
            speed = fast**q * (platter != 0.0)
            yield f"{times} per revolution, {said}", (speed * np.cos(order * angle), speed * np.sin(order * angle))
    yield "as the size of the rate, whatever its sense", (fast,)
    yield "as the rate", (w,)
    yield "as the square of the rate", (w**2,)
    yield "as the square of the rate, with its sign", (w * fast,)
    yield "as the cube of the rate", (w**3,)
    yield "as the angular acceleration", (data.up[axis] * _smooth(data, data.counted.acceleration) / top,)
    yield "while the motor runs", (data.motor.astype(np.float64),)
    for name, drift in conditions(data.temperature, data.supply, data.time):
        yield f"follows {name}", (drift,)
        yield f"follows {name} and the rate", (drift * w,)


def _smooth(data: PlatterRecords, values: Array) -> Array:
    """Without wow and what the encoder itself adds, which would bring orders of their own into every power; (n,)."""
    from scipy.ndimage import uniform_filter1d

    size = max(1, round(SMOOTH / data.interval))
    for _ in range(2):
        pieces = [uniform_filter1d(values[b:e], size, mode="nearest") for b, e in data.records]
        values = np.concatenate(pieces)
    return values


def _stretches(data: PlatterRecords, row: int, found: Prediction) -> tuple[Array, Array, Array]:
    """Mean rate in the case, mean of what is left of a channel, SI, and its standard deviation, for every stretch."""
    sensitivity = float(data.channels.sensitivity[row])
    left = np.asarray((data.observed[row] - found.predicted[row]) / sensitivity).real
    upward = data.up[int(np.argmax(np.abs(data.up[:, 0])))]  # the platter turns one way, the cube is turned over
    rate = np.array([(upward * data.counted.rate)[begin:end].mean() for begin, end in data.stretches])
    mean = np.array([left[begin:end].mean() for begin, end in data.stretches])
    spans = (np.array([[0.0], [(end - begin) * data.interval]]) for begin, end in data.stretches)
    variance = np.array([data.noise[row].covariance(*span)[0, 0] for span in spans])
    return rate, mean, np.sqrt(variance) / abs(sensitivity)


def growth(data: PlatterRecords, domain: str, row: int, found: Prediction) -> Growth | None:
    """Means of the stretches against the rate."""
    if domain != MEANS:
        return None
    rate, mean, sigma = _stretches(data, row, found)
    used = np.abs(rate) > 0.0
    return Growth(np.abs(mean[used]), sigma[used], {"rate": np.abs(rate[used])})


def reversal(data: PlatterRecords, domain: str, row: int, found: Prediction) -> Reversal | None:
    """Sum against difference of stretches that turn alike in both senses."""
    if domain != MEANS:
        return None
    rate, mean, sigma = _stretches(data, row, found)
    even = odd = noise = 0.0
    for k in np.flatnonzero(rate > 0.0):
        j = int(np.argmin(np.abs(rate + rate[k])))
        if abs(rate[j] + rate[k]) < NEAR * rate[k]:
            even, odd = even + (mean[k] + mean[j]) ** 2, odd + (mean[k] - mean[j]) ** 2
            noise += sigma[k] ** 2 + sigma[j] ** 2
    seen = even + odd > SEEN**2 * noise > 0.0
    return Reversal(even if seen else 0.0, odd if seen else 0.0, decides=True)
