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

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rig.model import Local, Memory, Quantity, Term, volts
from rig.motion import FINE, ORDERS, PHASES, Array, Complexes, Motion, Periods
from rig.parts import sweep_cuts, sweep_laws, sweep_options, sweep_signs
from rig.parts.conditions import filled, logged
from rig.parts.formulas import OF_SHAKER
from rig.parts.part import Option, Origin, Part
from rig.parts.reference_motion import REMEMBERED, reference_key
from rig.parts.remainder import Cut, Growth, Mask, Prediction, Remainder, Reversal, Score, Series, Sign
from rig.parts.ripple import ELSEWHERE, Floor, said
from rig.parts.sweep_records import LINES, MAINS_ORDERS, WIDTH, SweepRecords
from rig.signals.blocks import inward, spread, unmixed
from rig.signals.noise import walking

SEVERAL = 3  # records of one level, from which it is a state of its own


class Sweep(Part):
    """One mounting on the shaker as a part of a fit."""

    experiment = "shaker"
    formulas = OF_SHAKER

    def __init__(self, data: SweepRecords) -> None:
        super().__init__(data.name, data.run, data.channels, len(data.frequency) * WIDTH, notes=data.notes)
        self.data = data
        self.instruments = frozenset({"vibrometer"} if data.vibrometer else ())
        source = np.where(data.source != 0.0, data.source, np.nan)
        self.logged = logged(temperature=data.temperature, supply=data.supply, source=source)
        frequency = np.where(data.frequency > 0.0, data.frequency, 1.0)
        self.grid, self._fine = Periods(frequency), Periods(frequency, FINE)
        self._moved: dict[tuple[object, ...], Motion] = {}
        self._memory = Memory()
        # noise, its rows, and the generator's state behind it, by its state before
        self._drawn: dict[str, tuple[Complexes, Array, Mapping[str, Any]]] = {}

    def _walking(self, levels: Sequence[float]) -> Self:
        return type(self)(replace(self.data, noise=walking(self.data.noise, levels)))

    @property
    def drawing(self) -> str:
        return "sweep" if self.data.driven.any() else ""

    @property
    def observed(self) -> Complexes:
        return self.data.observed

    def excites(self, on: Quantity | None) -> bool:
        return on != "rate"

    @cached_property
    def reference(self) -> Motion:
        """The motion as the reference shows it, before any effect."""
        data = self.data
        count = len(data.frequency)
        still = np.zeros((3, count, PHASES))
        drive, up, side = (np.repeat(data.directions[:, k : k + 1], count, axis=1) for k in range(3))
        return Motion(
            grid=self.grid, place=self.experiment, force=still, rate=still, turning=still, up=up, gravity=data.gravity,
            temperature=filled("temperature", data.temperature), supply=filled("supply", data.supply),
            elapsed=self._elapsed(data.since), along=data.shown, drive=drive, side=side,
            source=2.0 * data.source, scale=data.scale,
        )  # fmt: skip

    def _elapsed(self, since: float | None) -> Array:
        """Middle of every record, s after this instant or else after the first began, (p,)."""
        middle = 0.5 * (self.data.begin + self.data.end)
        return np.asarray(middle - (float(self.data.begin.min()) if since is None else since))

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
        terms = self.here(terms)
        channels, before = self.channels, self.data.before[..., :ORDERS]
        if only is not None:
            channels, local, before = channels.only(only), local.only(only), before[only]
        found = np.zeros((len(channels.names), len(self.data.frequency), LINES), np.complex128)
        found[..., :ORDERS] = volts(self.moved(terms), channels, local, terms, before, self._memory)
        for term in terms:
            for place, order in enumerate(MAINS_ORDERS, ORDERS):
                more = term.effect.at_mains(order, self._elapsed(None), term.at)
                if more is not None:
                    found[term.among(channels), :, place] += more
        return found

    @cached_property
    def _means(self) -> Array:
        """Inverse Cholesky factor of the covariance of the means, those held out last, (c, p, p)."""
        data = self.data
        count = len(data.begin)
        found = np.zeros((len(data.noise), count, count))
        for c, model in enumerate(data.noise):
            used = np.flatnonzero(data.usable[c])
            if len(used):
                since = float(data.begin.min())  # numbers near the clock's own size would lose their last digits
                covariance = model.covariance(data.begin[used] - since, data.end[used] - since)
                found[c][np.ix_(used, used)] = unmixed(covariance, self._held[used])
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

    def noise_like(self, row: int, random: np.random.Generator, count: int) -> Complexes:
        """Noise of all channels that a channel is compared with, V, drawn so often: (count, c, p, LINES).

        That of the reference, which all channels along the drive share, is in the lines of each; there is none where
        there is no observation. All channels are asked with the same generator: what it draws is drawn once.
        """
        before = repr((random.bit_generator.state, count))
        if before not in self._drawn:
            self._drawn.clear()
            found = self._draw(random, count)
            self._drawn[before] = found, self.whitened(found), random.bit_generator.state
        drawn, _, random.bit_generator.state = self._drawn[before]
        return drawn

    def _draw(self, random: np.random.Generator, count: int) -> Complexes:
        data = self.data
        good = data.usable[..., None] & np.isfinite(data.variance)
        sigma = np.where(good, np.sqrt(np.nan_to_num(data.variance)), 0.0)
        shared = random.standard_normal((count, 1, *good.shape[1:])) + 1j * random.standard_normal(
            (count, 1, *good.shape[1:])
        )
        own = random.standard_normal((count, *good.shape)) + 1j * random.standard_normal((count, *good.shape))
        found = np.asarray(own * sigma, np.complex128)
        found[..., 1:] += shared[..., 1:] * self._follows() * good[..., 1:]
        for c in range(len(good)):
            used, root = self._roots[c]
            found[:, c, :, 0] = 0.0
            found[:, c, used, 0] = random.standard_normal((count, len(used))) @ root.T
        return found

    @cached_property
    def _roots(self) -> list[tuple[NDArray[np.intp], Array]]:
        """Of every channel the records that count, and the Cholesky factor of the covariance of their means."""
        data, found = self.data, []
        since = float(data.begin.min())
        for usable, model in zip(data.usable, data.noise, strict=True):
            used = np.flatnonzero(usable)
            at = np.concatenate([data.begin[used], data.end[used]]).reshape(2, -1) - since
            covariance = model.covariance(*at) if len(used) else np.zeros((0, 0))
            found.append((used, np.asarray(np.linalg.cholesky(covariance), np.float64)))
        return found

    def felt(self, row: int, drawn: Complexes, influence: Array) -> Array:
        """What an estimate with this influence of the rows, (rows,), makes of what `noise_like` drew, (count,)."""
        known = (rows for mine, rows, _ in self._drawn.values() if mine is drawn)
        rows = next(known, None)
        return np.asarray(influence @ (self.whitened(drawn) if rows is None else rows))

    def spans(self) -> tuple[Array, Array]:
        """Begin and end (bench clock, s) of every mean, (p,)."""
        return self.data.begin, self.data.end

    def summed(self, row: int, drawn: Complexes, weights: Array) -> Array:
        """Sums of a channel's means with these weights, (p,), of what `noise_like` drew, (count,)."""
        return np.asarray(drawn[:, row, :, 0].real @ weights)

    def driven_of(self, row: int, drawn: Complexes) -> dict[tuple[str, int], Complexes]:
        """Relative change of a channel's driven line by what `noise_like` drew, by run and point, (count,) each."""
        seen = self.data.observed[row, :, 1]
        return {
            (self.data.run, int(index)): np.asarray(drawn[:, row, p, 1] / seen[p])
            for p, index in enumerate(self.data.index)
            if index >= 0
        }

    def each_channel(self, raw: NDArray[np.inexact]) -> Array:
        """Whitened columns of a change that is every channel's own, (rows, c)."""
        c, p, _ = raw.shape
        known = np.nan_to_num(raw)
        found = np.zeros((c, p, WIDTH, c))
        found[np.arange(c), :, 0, np.arange(c)] = np.matmul(self._means, known[..., 0].real[..., None])[..., 0]
        lines = (self._lines * known[..., 1:].transpose(1, 2, 0)[:, :, None, :]).transpose(2, 0, 1, 3)
        found[:, :, 1::2], found[:, :, 2::2] = lines.real, lines.imag
        return found.reshape(self.rows, c)

    def blocks(self) -> list[tuple[slice, NDArray[np.intp]]]:
        """Rows and the channels whose own parameters move them."""
        return [(slice(0, self.rows), np.arange(len(self.channels.names)))]

    @cached_property
    def held_out(self) -> NDArray[np.bool_]:
        """Rows of the records held out, else of a third in time at each level and at rest, (rows,)."""
        c, p = self.data.usable.shape
        return np.broadcast_to(self._held[None, :, None], (c, p, WIDTH)).reshape(-1)

    @cached_property
    def _held(self) -> Mask:
        data = self.data
        if data.held is not None:
            return data.held
        levels = [level if driven else "rest" for level, driven in zip(data.level, data.driven, strict=True)]
        often = Counter(levels)
        states = [level if often[level] >= SEVERAL or level == "rest" else "driven" for level in levels]
        return inward(spread(states), np.abs(data.shown[:, 1]), np.array([one == "driven" for one in states]))

    @cached_property
    def counted(self) -> NDArray[np.bool_]:
        """Rows that carry an observation, (rows,)."""
        c, p = self.data.usable.shape
        mean = np.diagonal(self._means, axis1=1, axis2=2) > 0.0
        line = np.diagonal(self._lines, axis1=2, axis2=3).real.transpose(2, 0, 1) > 0.0
        both = np.repeat(line[..., None], 2, axis=-1).reshape(c, p, -1)
        return np.concatenate([mean[..., None], both], axis=-1).reshape(-1)

    # the bench's own ripple

    @property
    def mounting(self) -> str:
        return self.data.axis

    def said_of_ripple(self, floor: Floor | None) -> tuple[str, ...]:
        return (said(floor) if floor is not None or self.data.vibrometer else ELSEWHERE,)

    def with_ripple(self, floor: Floor | None) -> Self:
        """With the floor's shapes as nuisances: each part of the response of each driven accelerometer."""
        if floor is None or floor.size == 0.0:
            return self
        data, made = self.data, copy(self)
        f = np.where(data.frequency > 0.0, data.frequency, 1.0)
        shapes = floor.shapes(np.log(f), data.frequency > 0.0)
        columns = []
        for c in data.along:
            response = data.channels.sensitivity[c] / (1.0 + 1j * f / data.channels.pole[c])
            for shape in shapes.T:
                for turn in (1.0, 1j):
                    raw = np.zeros(data.observed.shape, np.complex128)
                    along = data.shown[:, 1] * data.directions[data.channels.axis[c], 0]
                    raw[c, :, 1] = turn * shape * response * along
                    columns.append(raw)
        made.extra = self.whitened(np.array(columns)) if columns else made.extra
        return made

    def responses(self) -> Mapping[tuple[str, float, str], tuple[complex, float]]:
        return sweep_signs.responses(self.data)

    # noise, and what the rows stand for

    @property
    def to_judge(self) -> str:
        return "more levels or frequencies, or each again"

    def origin(self, name: str) -> Origin:
        """Lines are as noisy as what lies beside them, means as the rest and all records' slow noise make them."""
        return "beside the lines" if self.data.driven.all() else "at rest"

    def noise(self) -> Array:
        """The sensor's noise, and the reference's in channels along the drive; of a line half in each row."""
        return sweep_cuts.noise(self.data).reshape(len(self.row_names), -1)

    def numbers(self) -> Array:
        """Means and complex lines."""
        table = self.counted.reshape(len(self.row_names), -1, WIDTH)
        both = np.concatenate([table[..., :1], table[..., 1::2]], axis=-1)
        return np.asarray(both.sum(axis=(1, 2)), np.float64)

    def errors(self, left: Array) -> Array:
        return np.full(len(self.row_names), np.nan)

    def allowance_of(self, name: str, mask: Mask) -> float:
        """Means wander with flicker below all lines of the records, which is known worse than a line's neighbours."""
        of_means = self.domains()["mean"]
        if not of_means[mask].all():
            return self.allowance
        span = float(self.data.end.max() - self.data.begin.min())
        return math.hypot(self.allowance, self.data.noise[self.row_names.index(name)].u_of_means(span))

    def domains(self) -> Mapping[str, Mask]:
        return sweep_cuts.domains_of(self.data)

    def components(self) -> Mapping[str, Mask]:
        """The driven line as magnitude and phase."""
        return sweep_cuts.components(self.data)

    def cuts(self) -> Sequence[Cut]:
        return tuple(sweep_cuts.cuts(self.data))

    def joined(self, cuts: Sequence[Cut]) -> str:
        """Neighbouring frequencies as one span."""
        return sweep_cuts.joined(self.data, cuts) if cuts[0].kind == "frequency" else super().joined(cuts)

    def squares(self, rest: Remainder) -> Array:
        return sweep_cuts.squares(self.data, rest)

    def series(self, rest: Remainder) -> Iterator[Series]:
        """The driven line along frequency and along time."""
        return sweep_cuts.series(self.data, rest)

    def laws(
        self, component: str, rows: Sequence[int], rest: Remainder, score: Score
    ) -> Iterator[tuple[str, dict[int, float]]]:
        return sweep_laws.laws(self, self.data, sweep_laws.Asked(component, tuple(rows), rest), score)

    def amplified(self, raw: NDArray[np.inexact]) -> Iterator[tuple[Array, Array]]:
        """Of accelerometers along the drive, in records that it drives."""
        driven, shown = self.data.driven, np.abs(raw[..., 1])
        follows = ~self.channels.rates & (self.data.directions[self.channels.axis, 0] != 0.0)
        for c in np.flatnonzero(follows & (shown[:, driven].min(axis=1, initial=1.0) > 0.0)):
            yield self.data.frequency[driven], np.abs(self.data.observed[c, driven, 1]) / shown[c, driven]

    def growth(self, domain: str, row: int, found: Prediction) -> Growth | None:
        return sweep_laws.growth(self.data, domain, row, found)

    def reversal(self, domain: str, row: int, excess: float, found: Prediction) -> Reversal | None:
        """Even harmonics and the mean stay, odd ones change their sign."""
        if domain != "mean" and not domain.endswith("f"):
            return None
        even = domain in ("mean", "2f", "4f")
        return Reversal(excess if even else 0.0, 0.0 if even else excess)

    def title(self, name: str) -> str:
        return self.labels[self.row_names.index(name)][0]

    def left_out(self) -> Iterator[str]:
        bad = [n for n, usable in zip(self.channels.names, self.data.usable, strict=True) if not usable.all()]
        if bad:
            yield f"{self.name}: {', '.join(bad)} clipped or without a reference in some records, left out there"

    # all sweeps together

    @classmethod
    def signs(cls, parts: Sequence[Self]) -> Iterator[Sign]:
        return sweep_signs.signs([part.data for part in parts])

    @classmethod
    def lacks(cls, parts: Sequence[Self]) -> Iterator[str]:
        return sweep_signs.lacks([part.data for part in parts])

    @classmethod
    def unmeasured(cls, parts: Sequence[Self], blind: Sequence[str]) -> Iterator[tuple[str, str]]:
        return sweep_signs.unmeasured([part.data for part in parts], blind)

    def options(self) -> Iterator[Option]:
        return sweep_options.options(self.data, Sweep)
