"""A turntable run as a model sees it: window means of every channel against what the encoder shows of the same windows.

Sensor and reference are averaged over the same windows (the reference's mean rate is the difference of its angles at
the ends), so that wow cannot leak in as a lag. Noise is coloured: every stretch of a few seconds is turned by a cosine
transform, whose lines are nearly independent with the density as variance (Whittle), and the means of the stretches,
which flicker ties together, are whitened with their covariance over the whole run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rig.model import Local, Memory, Quantity, Term, volts
from rig.motion import Array, Complexes, Motion, Stretches
from rig.parts import platter_laws, platter_options, platter_signs
from rig.parts.conditions import filled, logged
from rig.parts.formulas import OF_PLATTER
from rig.parts.laws import scored
from rig.parts.part import ALLOWANCE, Option, Origin, Part
from rig.parts.platter_cuts import Rows
from rig.parts.platter_records import PlatterRecords, lines_of
from rig.parts.reference_motion import REMEMBERED, reference_key, true_motion, turns
from rig.parts.remainder import Cut, Growth, Mask, Prediction, Remainder, Reversal, Score, Series, Sign
from rig.signals.blocks import spread, unmixed
from rig.signals.noise import walking

# Hz; on a moving platter accelerometers are compared below the first and gyros below the second: above them sampled
# edges leave patterns that the encoder's second and first derivative cannot tell from motion
HIGHEST_FORCE, HIGHEST_RATE = 1.2, 10.0
KNOWN = 120.0  # s at rest that make a density as well known as the allowance says


@dataclass(frozen=True)
class WindowNoise:
    """Noise of the windows of a channel, drawn `count` times by the usual generator in this state."""

    row: int
    count: int
    state: Mapping[str, Any]


class Platter(Part):
    """A turntable run as a part of a fit."""

    experiment = "turntable"
    drawing = "platter"
    instruments = frozenset({"encoder"})
    formulas = OF_PLATTER

    def __init__(self, data: PlatterRecords) -> None:
        width = sum(end - begin for begin, end in data.stretches)
        super().__init__(data.name, data.run, data.channels, width, notes=data.notes)
        self.data, self.of = data, Rows(data)
        self.logged = logged(temperature=data.temperature, supply=data.supply)
        self.grid = Stretches(data.interval, data.records, lines_of(data))
        self._moved: dict[tuple[object, ...], Motion] = {}
        self._memory = Memory()

    @property
    def observed(self) -> Array:
        return self.data.observed

    def excites(self, on: Quantity | None) -> bool:
        return on == "rate"

    def _walking(self, levels: Sequence[float]) -> Self:
        return type(self)(replace(self.data, noise=walking(self.data.noise, levels)))

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
        since = float(data.time[0]) if data.since is None else data.since
        shown = data.closed if any(term.effect.looks_in == "closure" for term in terms) else data.counted
        angle, rate, acceleration = true_motion(shown, [term for term in terms if turns(term)])
        force = (
            -data.outward * data.radius * rate**2 + data.tangent * data.radius * acceleration + data.up * data.gravity
        )
        return Motion(
            grid=self.grid, place=self.experiment, force=force, rate=data.up * rate, turning=data.up * acceleration,
            up=data.up, gravity=data.gravity, temperature=filled("temperature", data.temperature),
            supply=filled("supply", data.supply), elapsed=data.time - since, angle=angle,
            motor=data.motor.astype(np.float64), outward=data.outward, tangent=data.tangent,
        )  # fmt: skip

    def raw(self, local: Local, terms: Sequence[Term], only: NDArray[np.intp] | None = None) -> Array:
        """Predicted window means of every channel (or of some), V, (c, n)."""
        terms = self.here(terms)
        channels = self.channels
        if only is not None:
            channels, local = channels.only(only), local.only(only)
        return np.asarray(volts(self.moved(terms), channels, local, terms, memory=self._memory), np.float64)

    @cached_property
    def _means(self) -> Array:
        """Inverse Cholesky factor of the covariance of the stretches' means, those held out last, (c, s, s)."""
        data = self.data
        since = float(data.time[0])
        begin = np.array([data.time[b] for b, _ in data.stretches]) - since - 0.5 * data.interval
        end = np.array([data.time[e - 1] for _, e in data.stretches]) - since + 0.5 * data.interval
        found = [unmixed(model.covariance(begin, end), self._held) for model in data.noise]
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
        found = np.zeros((len(raw), self.width))
        moved = np.flatnonzero(raw.any(axis=1))
        found[moved] = self._whitened(raw[moved], moved)
        return found.reshape(-1)

    def _whitened(self, raw: NDArray[np.inexact], rows: NDArray[np.intp]) -> Array:
        """Windows (k, n) of these channels (k,), which may repeat, in standard deviations, (k, width)."""
        from scipy.fft import dct

        found = np.empty((len(raw), self.width))
        means, at = [], len(self.data.stretches)
        for begin, count, pieces, scale in self._together:
            table = raw[:, begin : begin + count * pieces].reshape(len(raw), pieces, count)
            turned: Array = dct(np.array(table, np.float64), type=2, norm="ortho", axis=2, overwrite_x=True)
            means.append(turned[..., 0] / np.sqrt(count))
            lines = turned[..., 1:] * scale[rows]
            found[:, at : at + pieces * (count - 1)] = lines.reshape(len(raw), pieces * (count - 1))
            at += pieces * (count - 1)
        found[:, : len(self.data.stretches)] = np.einsum("cst,ct->cs", self._means[rows], np.concatenate(means, axis=1))
        return found

    def noise_like(self, row: int, random: np.random.Generator, count: int) -> WindowNoise:
        """Noise as that of one channel, V, drawn so often; of a long run it is never all there at once.

        Means of the stretches have the covariance of the run, lines of each the density of the noise.
        """
        drawn = WindowNoise(row, count, random.bit_generator.state)
        for _ in self._drawn(drawn, random):
            pass  # what is drawn after it is drawn behind it
        return drawn

    def _drawn(self, noise: WindowNoise, random: np.random.Generator) -> Iterator[Array]:
        """Lines of the cosine transform of every stretch, V, (count, m)."""
        data, model = self.data, self.data.noise[noise.row]
        since = float(data.time[0])
        begin = np.array([data.time[b] for b, _ in data.stretches]) - since - 0.5 * data.interval
        end = np.array([data.time[e - 1] for _, e in data.stretches]) - since + 0.5 * data.interval
        root = np.linalg.cholesky(model.covariance(begin, end))
        means = random.standard_normal((noise.count, len(begin))) @ root.T
        for k, (b, e) in enumerate(data.stretches):
            f = np.arange(1, e - b) / (2.0 * (e - b) * data.interval)
            lines = random.standard_normal((noise.count, e - b)) * np.sqrt(
                np.concatenate([[0.0], model.density(f) / (2.0 * data.interval)])
            )
            lines[:, 0] = means[:, k] * np.sqrt(e - b)
            yield lines

    def _summed(self, drawn: WindowNoise, weights: Sequence[Array]) -> Array:
        """Sums of the lines of every stretch with these weights, (m,) each: V, (count,)."""
        random = np.random.default_rng()
        random.bit_generator.state = drawn.state
        total = np.zeros(drawn.count)
        for lines, of_lines in zip(self._drawn(drawn, random), weights, strict=True):
            total += lines @ of_lines
        return total

    def summed(self, row: int, drawn: WindowNoise, weights: Array) -> Array:
        """Sums of windows with these weights, (n,), of what `noise_like` drew, (count,); nothing outside stretches."""
        from scipy.fft import dct

        return self._summed(drawn, [dct(weights[b:e], type=2, norm="ortho") for b, e in self.data.stretches])

    def spans(self) -> tuple[Array, Array]:
        """Begin and end (bench clock, s) of every window, (n,)."""
        half = 0.5 * self.data.interval
        return self.data.time - half, self.data.time + half

    def felt(self, row: int, drawn: WindowNoise, influence: Array) -> Array:
        """What an estimate with this influence of the rows, (rows,), makes of what `noise_like` drew, (count,)."""
        of_rows, at = influence.reshape(-1, self.width)[row], len(self.data.stretches)
        of_means, weights = of_rows[:at] @ self._means[row], []
        for mean, scale in zip(of_means, self._scales, strict=True):
            count = scale.shape[1] + 1
            weights.append(np.concatenate([[mean / math.sqrt(count)], of_rows[at : at + count - 1] * scale[row]]))
            at += count - 1
        return self._summed(drawn, weights)

    def driven_of(self, row: int, drawn: Array) -> dict[tuple[str, int], Complexes]:
        """Nothing is driven here."""
        return {}

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

    @cached_property
    def held_out(self) -> NDArray[np.bool_]:
        """Rows of every third stretch at rest, at each speed and between them, (rows,)."""
        return np.tile(self._held[self.of.stretch_of], len(self.channels.names))

    @cached_property
    def _held(self) -> Mask:
        return spread(self.of.states)

    @cached_property
    def counted(self) -> NDArray[np.bool_]:
        """Rows that carry an observation, (rows,)."""
        means = np.repeat(self.data.usable[:, None], len(self.data.stretches), axis=1)
        return np.concatenate([means, *(scale > 0.0 for scale in self._scales)], axis=1).reshape(-1)

    # noise, and what the rows stand for

    def origin(self, name: str) -> Origin:
        return "at rest" if self.data.resting > 0.0 else "misfit"

    def noise(self) -> Array:
        return self.of.noise()

    def numbers(self) -> Array:
        """Windows."""
        return np.asarray(self.width * self.data.usable, np.float64)

    def numbers_in(self, mask: Mask) -> float:
        """A mean stands for all windows of its stretch."""
        lengths = np.array([end - begin for begin, end in self.data.stretches])
        return float(np.sum(np.where(self.of.frequency_of > 0.0, 1, lengths[self.of.stretch_of])[mask]))

    def errors(self, left: Array) -> Array:
        return np.full(len(self.row_names), np.nan)

    @property
    def allowance(self) -> float:
        """A density is known as well as the rest was long."""
        return ALLOWANCE * math.sqrt(max(KNOWN / max(self.data.resting, 1.0), 1.0))

    def domains(self) -> Mapping[str, Mask]:
        return self.of.domains()

    def components(self) -> Mapping[str, Mask]:
        """Bands and orders per revolution."""
        return self.of.components()

    def cuts(self) -> Sequence[Cut]:
        return tuple(self.of.cuts())

    def entangled(self, component: str, other: str) -> bool:
        """Means over stretches are whitened together at rest and moving."""
        return component == other or (component.startswith("mean, ") and other.startswith("mean, "))

    def recurs(self, component: str) -> bool:
        return "revolution" in component

    def series(self, rest: Remainder) -> Iterator[Series]:
        """Of the gyros: means along time, and the lines of the longest stretch."""
        return self.of.series(rest)

    def laws(
        self, component: str, rows: Sequence[int], rest: Remainder, score: Score
    ) -> Iterator[tuple[str, dict[int, float]]]:
        mask = self.components()[component]
        return scored(self, platter_laws.shapes(self.data, component), [], rows, score, mask)

    def growth(self, domain: str, row: int, found: Prediction) -> Growth | None:
        return platter_laws.growth(self.data, domain, row, found)

    def reversal(self, domain: str, row: int, excess: float, found: Prediction) -> Reversal | None:
        return platter_laws.reversal(self.data, domain, row, found)

    def title(self, name: str) -> str:
        return self.labels[self.row_names.index(name)][0]

    def left_out(self) -> Iterator[str]:
        bad = [n for n, usable in zip(self.channels.names, self.data.usable, strict=True) if not usable]
        if bad:
            yield f"{self.name}: {', '.join(bad)} clipped, left out"

    # all turntable runs together

    @classmethod
    def signs(cls, parts: Sequence[Self]) -> Iterator[Sign]:
        return platter_signs.signs([part.data for part in parts])

    @classmethod
    def lacks(cls, parts: Sequence[Self]) -> Iterator[str]:
        return platter_signs.lacks([part.data for part in parts])

    @classmethod
    def unmeasured(cls, parts: Sequence[Self], blind: Sequence[str]) -> Iterator[tuple[str, str]]:
        return platter_signs.unmeasured([part.data for part in parts])

    def options(self) -> Iterator[Option]:
        return platter_options.options(self.data, Platter)
