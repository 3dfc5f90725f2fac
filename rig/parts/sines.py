"""Sine records as a model sees them: harmonics of every channel at every point, whitened by the noise they have.

Observed are, for every channel and record, the mean, the complex amplitudes of the harmonics 1 … 5, and those at one
and three times the mains frequency. What makes them uncertain:

- the sensor's noise, whose density comes from what the fits of all records leave over, at the frequency that matters;
- the reference's noise, which all channels that follow the drive share: the channels of one harmonic are whitened
  together (Cholesky of diag σ² + g·gᴴ·σ_ref²);
- slow noise of the means, which are not independent from record to record: they are whitened together over the whole
  run with the covariance that the fitted white and flicker densities give their block means.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.model import Channels, Local, Term, at_work, volts
from rig.motion import FINE, ORDERS, PHASES, Array, Complexes, Motion, Periods
from rig.parts.reading.conditions import filled, logged
from rig.signals.noise import NoiseModel

MAINS_ORDERS = (1, 3)
LINES = ORDERS + len(MAINS_ORDERS)  # mean, harmonics, mains lines
REMEMBERED = 8  # readings of the reference
HELD_OUT = 3  # every third point of a run is not fitted when a model is judged


@dataclass(frozen=True)
class Leftover:
    """What the fit of one record left over: amplitudes at multiples of `resolution` Hz, V, (f, c).

    `reference` is that of the reference; `taken` marks lines that the fit has emptied.
    """

    begin: float
    resolution: float
    amplitude: Complexes
    reference: Complexes
    taken: NDArray[np.bool_]


@dataclass(frozen=True)
class SineRecords:
    """What was recorded in one mounting, p records of c channels, records at rest among them (`index` −1).

    `observed` (c, p, LINES) V, complex; `variance` of each part, same shape, NaN where there is no line. `shown`
    complex acceleration of the drive that the reference shows, m/s², (p, 6), with `reference_variance` (p, 6) of each
    part, (m/s²)²; `gated` the same without samples that stand out of its record, whose share and depth `outliers`
    tells, (p, 2). `frequency` Hz, `begin` and `end` s on the bench's clock, `level`, all (p,). `usable` (c, p).
    """

    name: str
    run: str
    axis: str
    channels: Channels
    observed: Complexes
    before: Complexes
    variance: Array
    noise: tuple[NoiseModel, ...]
    shown: Complexes
    gated: Complexes
    outliers: Array
    reference_variance: Array
    frequency: Array
    nominal: Array
    begin: Array
    end: Array
    level: tuple[str, ...]
    index: NDArray[np.intp]
    usable: NDArray[np.bool_]
    source: Array
    scale: Array
    temperature: Array
    supply: Array
    mains: float
    gravity: float
    directions: Array  # drive, up and side in the case frame, (3, 3), columns
    leftovers: tuple[Leftover, ...] = ()
    notes: tuple[str, ...] = ()
    held: NDArray[np.bool_] | None = None  # (p,): points that a model is judged by; every third without
    vibrometer: bool = True  # whether the reference is one


class Sines:
    """One mounting on the shaker as a part of a fit."""

    place = "shaker"

    def __init__(self, data: SineRecords) -> None:
        self.instruments = frozenset({"vibrometer"} if data.vibrometer else ())
        self.data, self.name, self.channels = data, data.name, data.channels
        source = np.where(data.source != 0.0, data.source, np.nan)
        self.logged = logged(temperature=data.temperature, supply=data.supply, source=source)
        frequency = np.where(data.frequency > 0.0, data.frequency, 1.0)
        self.grid, self._fine = Periods(frequency), Periods(frequency, FINE)
        self._moved: dict[tuple[object, ...], Motion] = {}
        self.extra = np.zeros((self.rows, 0))
        self.target = self.whitened(data.observed)

    @property
    def rows(self) -> int:
        """Numbers compared: one for each mean, two for each line."""
        c, p = self.data.usable.shape
        return int(c * p * (2 * LINES - 1))

    @cached_property
    def reference(self) -> Motion:
        """The motion as the reference shows it, before any effect."""
        data = self.data
        count = len(data.frequency)
        still = np.zeros((3, count, PHASES))
        drive, up, side = (np.repeat(data.directions[:, k : k + 1], count, axis=1) for k in range(3))
        return Motion(
            grid=self.grid, place="shaker", force=still, rate=still, turning=still, up=up, gravity=data.gravity,
            temperature=filled("temperature", data.temperature), supply=filled("supply", data.supply),
            elapsed=0.5 * (data.begin + data.end) - float(data.begin.min()), along=data.shown, drive=drive, side=side,
            source=2.0 * data.source, scale=data.scale,
        )  # fmt: skip

    def moved(self, terms: Sequence[Term]) -> Motion:
        """The true motion, once the effects of the reference are taken off what it shows."""
        key = reference_key(terms)
        if key not in self._moved:
            if len(self._moved) > REMEMBERED:
                self._moved.clear()
            self._moved[key] = self._true(terms)
        return self._moved[key]

    def _true(self, terms: Sequence[Term]) -> Motion:
        gated = any(term.effect.looks_in == "dropouts" for term in terms)
        along, shown = self.data.gated if gated else self.data.shown, self.reference
        for term in terms:
            along = term.effect.shaken(along, self.grid.harmonics, self.data.scale, term.at)
        grid = self._fine if any(term.effect.kinked for term in terms) else self.grid
        force = shown.drive[:, :, None] * grid.waveform(along) + shown.gravity * shown.up[:, :, None]
        still = np.zeros_like(force)
        return replace(shown, grid=grid, along=along, force=force, rate=still, turning=still)

    def raw(self, local: Local, terms: Sequence[Term], only: NDArray[np.intp] | None = None) -> Complexes:
        """Predicted lines of every channel (or of some), V, (c, p, LINES)."""
        terms = at_work(terms, self.place, self.name)
        channels, before = self.channels, self.data.before[..., :ORDERS]
        if only is not None:
            channels, local, before = channels.only(only), local.only(only), before[only]
        found = np.zeros((len(channels.names), len(self.data.frequency), LINES), np.complex128)
        found[..., :ORDERS] = volts(self.moved(terms), channels, local, terms, before)
        for term in terms:
            for place, order in enumerate(MAINS_ORDERS, ORDERS):
                more = term.effect.at_mains(order, self.reference.elapsed, term.at)
                if more is not None:
                    found[channels.of(term.on), :, place] += more
        return found

    @cached_property
    def _means(self) -> Array:
        """Inverse Cholesky factor of the covariance of the means, (c, p, p)."""
        data = self.data
        count = len(data.begin)
        found = np.zeros((len(data.noise), count, count))
        for c, model in enumerate(data.noise):
            used = np.flatnonzero(data.usable[c])
            if len(used):
                since = float(data.begin.min())  # numbers near the clock's own size would lose their last digits
                covariance = model.covariance(data.begin[used] - since, data.end[used] - since)
                found[c][np.ix_(used, used)] = np.linalg.inv(np.linalg.cholesky(covariance))
        return found

    @cached_property
    def _lines(self) -> Complexes:
        """Inverse Cholesky factors over the channels for every record and line, (p, LINES − 1, c, c)."""
        data = self.data
        variance = data.variance[..., 1:].transpose(1, 2, 0)  # (p, lines, c)
        good = data.usable.T[:, None, :] & np.isfinite(variance) & (variance > 0.0)
        sigma2 = np.where(good, variance, 1.0)
        follows = self._follows().transpose(1, 2, 0) * good
        whole = follows[..., :, None] * np.conj(follows[..., None, :])
        index = np.arange(whole.shape[-1])
        whole[..., index, index] += sigma2
        inverse = np.linalg.inv(np.linalg.cholesky(whole))
        return np.asarray(inverse * good[..., None, :] * good[..., :, None])

    def _follows(self) -> Complexes:
        """Standard deviation of the reference's noise in every channel's lines, V, (c, p, LINES − 1)."""
        data = self.data
        own = data.directions[:, 0][data.channels.axis] * ~data.channels.rates * data.channels.sensitivity
        f = self.grid.harmonics[:, 1:]
        response = own[:, None, None] / (1.0 + 1j * f / data.channels.pole[:, None, None])
        found = np.zeros((len(own), len(f), LINES - 1), np.complex128)
        found[..., : ORDERS - 1] = response * np.sqrt(np.nan_to_num(data.reference_variance[:, 1:]))
        return found

    def whitened(self, raw: NDArray[np.inexact]) -> Array:
        """Lines in standard deviations, (rows,) for (c, p, LINES), (rows, k) for (k, c, p, LINES)."""
        single = raw.ndim == 3
        stack = np.nan_to_num(raw[None] if single else raw)
        k, c, p, _ = stack.shape
        means = np.einsum("cpq,kcq->kcp", self._means, stack[..., 0].real)
        lines = np.matmul(self._lines, stack[..., 1:].transpose(2, 3, 1, 0))  # (p, lines, c, k)
        both = np.stack([lines.real, lines.imag]).transpose(4, 3, 1, 2, 0)  # (k, c, p, lines, 2)
        found = np.concatenate([means[..., None], both.reshape(k, c, p, -1)], axis=-1).reshape(k, -1)
        return np.asarray(found[0] if single else found.T)

    def each_channel(self, raw: NDArray[np.inexact]) -> Array:
        """Whitened columns of a change that is every channel's own, (rows, c)."""
        c = len(raw)
        apart = np.zeros((c, *raw.shape), np.complex128)
        apart[np.arange(c), np.arange(c)] = raw
        return self.whitened(apart)

    def blocks(self) -> list[tuple[slice, NDArray[np.intp]]]:
        """Rows and the channels whose own parameters move them."""
        return [(slice(0, self.rows), np.arange(len(self.channels.names)))]

    @cached_property
    def held_out(self) -> NDArray[np.bool_]:
        """Rows of the points held out, else of every third (in the order in which they were measured), (rows,)."""
        c, p = self.data.usable.shape
        driven = np.cumsum(self.data.index >= 0) - 1
        out = (self.data.index >= 0) & (driven % HELD_OUT == HELD_OUT - 1)
        if self.data.held is not None:
            out = self.data.held
        return np.broadcast_to(out[None, :, None], (c, p, 2 * LINES - 1)).reshape(-1)

    @cached_property
    def counted(self) -> NDArray[np.bool_]:
        """Rows that carry an observation, (rows,)."""
        c, p = self.data.usable.shape
        mean = np.diagonal(self._means, axis1=1, axis2=2) > 0.0
        line = np.diagonal(self._lines, axis1=2, axis2=3).real.transpose(2, 0, 1) > 0.0
        both = np.repeat(line[..., None], 2, axis=-1).reshape(c, p, -1)
        return np.concatenate([mean[..., None], both], axis=-1).reshape(-1)


def reference_key(terms: Sequence[Term]) -> tuple[object, ...]:
    """What decides how the reference is read: effects of its stage with their coordinates, and how fine it must be."""
    stage = tuple((t.effect.name, *t.at.values()) for t in terms if t.effect.stage == "reference")
    return (*stage, any(t.effect.kinked for t in terms))


def split(rows: Array, channels: int, points: int) -> tuple[Array, Complexes]:
    """Rows as means (c, p) and complex lines (c, p, LINES − 1), in standard deviations."""
    table = rows.reshape(channels, points, 2 * LINES - 1)
    lines = table[..., 1:].reshape(channels, points, LINES - 1, 2)
    return table[..., 0], np.asarray(lines[..., 0] + 1j * lines[..., 1])


def directions(axis: str) -> Array:
    """Drive, up and side in the case frame for a sweep of this axis: the next axis is up, the one after it aside."""
    along = "xyz".index(axis)
    return np.eye(3)[:, [(along + step) % 3 for step in range(3)]]
