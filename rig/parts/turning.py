"""A turntable run as a model sees it: window means of every channel against what the encoder shows of the same windows.

Sensor and reference are averaged over the same windows (the reference's mean rate is the difference of its angles at
the ends), so that wow cannot leak in as a lag. Noise is coloured: every stretch of a few seconds is turned by a cosine
transform, whose lines are nearly independent with the density as variance (Whittle), and the means of the stretches,
which flicker ties together, are whitened with their covariance over the whole run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.model import Channels, Effect, Local, Term, at_work, volts
from rig.motion import Array, Motion, Stretches
from rig.parts.reading.conditions import filled, logged
from rig.parts.sines import REMEMBERED, reference_key
from rig.signals.noise import NoiseModel

SETTLING = 14  # windows at either end of a record of a moving platter, where its acceleration is not well known
# Hz; on a moving platter accelerometers are compared below the first and gyros below the second: above them sampled
# edges leave patterns that the encoder's second and first derivative cannot tell from motion
HIGHEST_FORCE, HIGHEST_RATE = 1.2, 10.0
INVERSIONS = 3  # of shown into true angle; each gains a factor of the error's size
CLOSE = 1e-8  # rad: an inversion that changes no angle by more is the last
HELD_OUT = 3  # every third stretch is not fitted when a model is judged


@dataclass(frozen=True)
class Shown:
    """What the encoder shows at every window: angle (NaN where no index ties it down), rate and acceleration; (n,)."""

    angle: Array
    rate: Array
    acceleration: Array


@dataclass(frozen=True)
class TurnRecords:
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
    notes: tuple[str, ...] = ()


class Turning:
    """A turntable run as a part of a fit."""

    place = "turntable"
    instruments = frozenset({"encoder"})

    def __init__(self, data: TurnRecords) -> None:
        self.data, self.name, self.channels = data, data.name, data.channels
        self.logged = logged(temperature=data.temperature, supply=data.supply)
        self.grid = Stretches(data.interval, data.records)
        self.extra = np.zeros((self.rows, 0))
        self._moved: dict[tuple[object, ...], Motion] = {}
        self.target = self.whitened(data.observed)

    @property
    def width(self) -> int:
        """Rows of one channel."""
        return sum(end - begin for begin, end in self.data.stretches)

    @property
    def rows(self) -> int:
        """Numbers compared."""
        return self.width * len(self.channels.names)

    @cached_property
    def reference(self) -> Motion:
        """The motion as the encoder shows it, before any effect."""
        return self.moved(())

    def moved(self, terms: Sequence[Term]) -> Motion:
        """The true motion, once the effects of the reference are taken off what it shows."""
        key = reference_key(terms)
        if key not in self._moved:
            if len(self._moved) > REMEMBERED:
                self._moved.clear()
            self._moved[key] = self._read(terms)
        return self._moved[key]

    def _read(self, terms: Sequence[Term]) -> Motion:
        data = self.data
        shown = data.closed if any(term.effect.looks_in == "closure" for term in terms) else data.counted
        angle, rate, acceleration = true_motion(shown, [term for term in terms if _turns(type(term.effect))])
        force = (
            -data.outward * data.radius * rate**2 + data.tangent * data.radius * acceleration + data.up * data.gravity
        )
        return Motion(
            grid=self.grid, place="turntable", force=force, rate=data.up * rate, turning=data.up * acceleration,
            up=data.up, gravity=data.gravity, temperature=filled("temperature", data.temperature),
            supply=filled("supply", data.supply), elapsed=data.time - float(data.time[0]), angle=angle,
            motor=data.motor.astype(np.float64), outward=data.outward, tangent=data.tangent,
        )  # fmt: skip

    def raw(self, local: Local, terms: Sequence[Term], only: NDArray[np.intp] | None = None) -> Array:
        """Predicted window means of every channel (or of some), V, (c, n)."""
        terms = at_work(terms, self.place, self.name)
        channels = self.channels
        if only is not None:
            channels, local = channels.only(only), local.only(only)
        return np.asarray(volts(self.moved(terms), channels, local, terms), np.float64)

    @cached_property
    def _means(self) -> Array:
        """Inverse Cholesky factor of the covariance of the stretches' means, (c, s, s)."""
        data = self.data
        since = float(data.time[0])
        begin = np.array([data.time[b] for b, _ in data.stretches]) - since - 0.5 * data.interval
        end = np.array([data.time[e - 1] for _, e in data.stretches]) - since + 0.5 * data.interval
        found = [np.linalg.inv(np.linalg.cholesky(model.covariance(begin, end))) for model in data.noise]
        return np.asarray(np.array(found) * data.usable[:, None, None])

    @cached_property
    def _scales(self) -> list[Array]:
        """Reciprocal standard deviations of the cosine lines of every stretch, (c, m − 1)."""
        data, found = self.data, []
        for begin, end in data.stretches:
            count = end - begin
            f = np.arange(1, count) / (2.0 * count * data.interval)
            variance = np.array([model.density(f) for model in data.noise]) / (2.0 * data.interval)
            used = data.usable[:, None] & np.ones(count - 1, np.bool_)
            if np.any(data.counted.rate[begin:end] != 0.0):
                used &= f < np.where(data.channels.rates, HIGHEST_RATE, HIGHEST_FORCE)[:, None]
            found.append(used / np.sqrt(variance))
        return found

    def whitened(self, raw: NDArray[np.inexact]) -> Array:
        """Windows in standard deviations, (rows,), channel after channel: means of the stretches, then their lines.

        A channel that is zero throughout stays so: a change that moves few of them costs no more than those.
        """
        from scipy.fft import dct

        found = np.zeros((len(raw), self.width))
        moved = np.flatnonzero(raw.any(axis=1))
        means, at = [], len(self.data.stretches)
        for begin, count, pieces, scale in self._together:
            table = raw[moved, begin : begin + count * pieces].reshape(len(moved), pieces, count)
            turned: Array = dct(np.asarray(table, np.float64), type=2, norm="ortho", axis=2, overwrite_x=True)
            means.append(turned[..., 0] / np.sqrt(count))
            lines = turned[..., 1:] * scale[moved]
            found[moved, at : at + pieces * (count - 1)] = lines.reshape(len(moved), pieces * (count - 1))
            at += pieces * (count - 1)
        found[moved, : len(self.data.stretches)] = np.einsum(
            "cst,ct->cs", self._means[moved], np.concatenate(means, axis=1)
        )
        return found.reshape(-1)

    @cached_property
    def _together(self) -> list[tuple[int, int, int, Array]]:
        """Stretches that follow each other and are equally long: first window, length, how many, scales."""
        found: list[tuple[int, int, int, list[Array]]] = []
        for (begin, end), scale in zip(self.data.stretches, self._scales, strict=True):
            if found and found[-1][1] == end - begin and found[-1][0] + found[-1][1] * found[-1][2] == begin:
                first, count, pieces, scales = found[-1]
                found[-1] = (first, count, pieces + 1, [*scales, scale])
            else:
                found.append((begin, end - begin, 1, [scale]))
        return [(first, count, pieces, np.stack(scales, axis=1)) for first, count, pieces, scales in found]

    def each_channel(self, raw: NDArray[np.inexact]) -> Array:
        """Whitened changes that are every channel's own; each moves its own rows only, (rows,)."""
        return self.whitened(raw)

    def blocks(self) -> list[tuple[slice, NDArray[np.intp]]]:
        """Rows of each channel."""
        width = self.width
        return [(slice(c * width, (c + 1) * width), np.array([c])) for c in range(len(self.channels.names))]

    @cached_property
    def stretch_of(self) -> NDArray[np.intp]:
        """Which stretch a row of one channel belongs to, (width,)."""
        lengths = [end - begin for begin, end in self.data.stretches]
        return np.concatenate([np.arange(len(lengths)), np.repeat(np.arange(len(lengths)), np.array(lengths) - 1)])

    @cached_property
    def frequency_of(self) -> Array:
        """Frequency of a row of one channel, Hz, zero for means, (width,)."""
        lines = [
            np.arange(1, end - begin) / (2.0 * (end - begin) * self.data.interval) for begin, end in self.data.stretches
        ]
        return np.concatenate([np.zeros(len(lines)), *lines])

    @cached_property
    def held_out(self) -> NDArray[np.bool_]:
        """Rows of every third stretch, (rows,)."""
        out = self.stretch_of % HELD_OUT == HELD_OUT - 1
        return np.tile(out, len(self.channels.names))

    @cached_property
    def counted(self) -> NDArray[np.bool_]:
        """Rows that carry an observation, (rows,)."""
        means = np.repeat(self.data.usable[:, None], len(self.data.stretches), axis=1)
        return np.concatenate([means, *(scale > 0.0 for scale in self._scales)], axis=1).reshape(-1)


def true_motion(shown: Shown, terms: Sequence[Term]) -> tuple[Array, Array, Array]:
    """True angle, rate and acceleration: what the encoder shows is θ + Σδ(θ) of the true angle θ."""
    angle = shown.angle
    if not terms or not any(any(term.at.values()) for term in terms):
        return angle, shown.rate, shown.acceleration
    for _ in range(INVERSIONS):
        known, angle = angle, shown.angle - sum(term.effect.turned(np.nan_to_num(angle), term.at)[0] for term in terms)
        if not np.any(np.abs(angle - known) > CLOSE):
            break
    errors = [term.effect.turned(np.nan_to_num(angle), term.at) for term in terms]
    first, second = (sum((one[k] for one in errors), np.zeros_like(angle)) for k in (1, 2))
    rate = shown.rate / (1.0 + first)
    return angle, rate, (shown.acceleration - rate**2 * second) / (1.0 + first)


def _turns(kind: type[Effect]) -> bool:
    return kind.turned is not Effect.turned


def only_stretches(data: TurnRecords, seconds: float) -> TurnRecords:
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
