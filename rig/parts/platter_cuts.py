"""What the rows of a turntable run stand for: bands and orders per revolution, speeds and senses, noise, orders."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.motion import Array
from rig.parts.platter_records import PlatterRecords
from rig.parts.remainder import Cut, Mask, Remainder, Series
from rig.parts.sweep_cuts import terciles

BANDS = ((0.0, 0.3), (0.3, 1.2), (1.2, 3.0), (3.0, 20.0))  # Hz
STEADY = 0.02  # of the rate
HIGHEST_ORDER = 3
NOMINAL: Mapping[str, float] = {"16⅔": 50.0 / 3.0, "33⅓": 100.0 / 3.0, "45": 45.0, "78": 78.0}
NEAR = 0.04  # of a nominal speed
BESIDE = 2.5  # lines on either side of an order
_TIMES = {1: "once", 2: "twice", 3: "three times"}


@dataclass(frozen=True)
class Rows:
    """Rows of one channel of a turntable run: the means of the stretches, then the cosine lines of each."""

    data: PlatterRecords

    @cached_property
    def stretch_of(self) -> NDArray[np.intp]:
        """Which stretch a row belongs to, (width,)."""
        lengths = [end - begin for begin, end in self.data.stretches]
        return np.concatenate([np.arange(len(lengths)), np.repeat(np.arange(len(lengths)), np.array(lengths) - 1)])

    @cached_property
    def frequency_of(self) -> Array:
        """Frequency of a row, Hz, zero for means, (width,)."""
        lines = [
            np.arange(1, end - begin) / (2.0 * (end - begin) * self.data.interval) for begin, end in self.data.stretches
        ]
        return np.concatenate([np.zeros(len(lines)), *lines])

    @cached_property
    def mean_rates(self) -> Array:
        """Mean rate of the platter in every stretch, rad/s."""
        return np.array([float(np.mean(self.data.counted.rate[b:e])) for b, e in self.data.stretches])

    @cached_property
    def steady(self) -> Mask:
        """Stretches at a steady speed."""
        rates = [self.data.counted.rate[b:e] for b, e in self.data.stretches]
        return np.array([abs(r.mean()) > 0.0 and float(np.std(r)) < STEADY * abs(r.mean()) for r in rates])

    @cached_property
    def states(self) -> list[tuple[str, bool]]:
        """Speed of every stretch, or that it rests or speeds up or down, and whether it is inverted."""
        found = []
        for (begin, _), rate, steady in zip(self.data.stretches, self.mean_rates, self.steady, strict=True):
            what = "rest" if rate == 0.0 else _speed(float(rate)) if steady else "ramp"
            found.append((what, _inverted(self.data, begin)))
        return found

    def domains(self) -> dict[str, Mask]:
        """Means, and bands of frequency, of a moving platter and at rest."""
        data, of, f = self.data, self.stretch_of, self.frequency_of
        moving = np.array([bool(np.any(data.counted.rate[b:e] != 0.0)) for b, e in data.stretches])
        mean = np.arange(len(of)) < len(data.stretches)
        found = {"mean, moving": mean & moving[of], "mean, at rest": mean & ~moving[of]}
        for low, high in BANDS:
            inside = ~mean & (f >= low) & (f < high)
            found[f"{low:g}–{high:g} Hz, moving"] = inside & moving[of]
            found[f"{low:g}–{high:g} Hz, at rest"] = inside & ~moving[of]
        return found

    def components(self) -> dict[str, Mask]:
        """Bands and orders per revolution."""
        found = self.domains()
        mean = np.abs(self.mean_rates) / (2.0 * math.pi)
        step = np.array([1.0 / (2.0 * (e - b) * self.data.interval) for b, e in self.data.stretches])
        of, f = self.stretch_of, self.frequency_of
        steady = self.steady[of] & (f > 0.0)
        for order in range(1, HIGHEST_ORDER + 1):
            near = np.abs(f - order * mean[of]) <= BESIDE * step[of]
            found[f"{_TIMES[order]} per revolution"] = steady & near
        return found

    def cuts(self) -> Iterator[Cut]:
        """By speed, sense and time."""
        of, data, rates, steady = self.stretch_of, self.data, self.mean_rates, self.steady
        moving = rates != 0.0
        speeds = np.array([_speed(float(rate)) for rate in rates])
        for speed in sorted(set(speeds[steady].tolist())):
            yield Cut("rate", f"at {speed} rpm", (steady & (speeds == speed))[of])
        yield Cut("rate", "while it speeds up or coasts down", (moving & ~steady)[of])
        yield Cut("rate", "at rest", ~moving[of])
        inverted = np.array([_inverted(data, begin) for begin, _ in data.stretches])
        if inverted.any() and not inverted.all():
            yield Cut("direction", "upright", (moving & ~inverted)[of])
            yield Cut("direction", "inverted", (moving & inverted)[of])
        begins = np.array([data.time[b] for b, _ in data.stretches])
        for said, (_, mask) in zip(("early", "half-way", "late"), terciles(begins, np.isfinite(begins)), strict=False):
            yield Cut("time", said, mask[of])

    def noise(self) -> Array:
        """Variance of every row, referred to the input by the data sheet, SI², (c, width): of a mean times windows."""
        data, found = self.data, []
        lengths = np.array([end - begin for begin, end in data.stretches])
        since = float(data.time[0])
        begin = np.array([data.time[b] for b, _ in data.stretches]) - since - 0.5 * data.interval
        lines = self.frequency_of[len(lengths) :]
        for model in data.noise:
            means = np.diag(model.covariance(begin, begin + lengths * data.interval))
            found.append(np.concatenate([means * lengths, model.density(lines) / (2.0 * data.interval)]))
        return np.asarray(np.array(found) / data.channels.sensitivity[:, None] ** 2)

    def series(self, rest: Remainder) -> Iterator[Series]:
        """Of the gyros: means along time, and the lines of the longest stretch."""
        data, names = self.data, self.data.channels.names
        whole, used = rest.left.reshape(len(names), -1), rest.used.reshape(len(names), -1)
        for row in np.flatnonzero(data.channels.rates & data.usable):
            where = f"{data.name} {names[row]}"
            yield Series(f"{where}, means along time", whole[row, : len(data.stretches)])
            longest = int(np.argmax(np.bincount(self.stretch_of[used[row]])))
            mine = whole[row][(self.stretch_of == longest) & (self.frequency_of > 0.0) & used[row]]
            pairs = mine[: len(mine) // 2 * 2].reshape(-1, 2)  # two cosine lines have two degrees of freedom
            yield Series(f"{where}, lines of the longest stretch", np.sum(pairs**2, axis=1), powers=True)


def _speed(rate: float) -> str:
    """Nominal speed of a platter near this rate (rad/s) in rpm, or the rounded one if it is near none."""
    rpm = abs(rate) * 30.0 / math.pi
    near = [words for words, nominal in NOMINAL.items() if abs(rpm / nominal - 1.0) < NEAR]
    return near[0] if near else f"{rpm:.0f}"


def _inverted(data: PlatterRecords, window: int) -> bool:
    label = next(n for n, (b, e) in zip(data.labels, data.records, strict=True) if b <= window < e)
    up = data.up[:, window]
    return "inverted" in label or float(up[np.argmax(np.abs(up))]) < 0.0
