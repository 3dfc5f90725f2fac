"""Spectra of records at rest as a part of a fit: how strong the sensors' noise is, in bands of frequency.

Rows are how far the mean density of each band is above what a model says, in standard deviations, which are known from
the number of lines averaged: no fit is needed to know them. Predicted is what the data sheet states, rounded by the
converter (see `rig.signals.sheet_noise`), and what effects add. What a sheet leaves open is found anew for every model
from the rows that are not held out (variable projection; Golub and Pereyra 1973), and how far it is from the sheet
makes four more rows of each channel, so that noise cannot be louder than a sheet allows without a misfit. The sheet's
noise goes with the sheet's sensitivities and poles, whose errors are within its tolerances: nothing is learned of
either. What an effect adds goes with the fitted sensitivities.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from rig.model import Channels, Effect, Local, Term, at_work
from rig.motion import Array, Motion
from rig.parts.conditions import NOMINAL
from rig.parts.noise_records import NoiseRecords
from rig.parts.noise_signs import signs
from rig.parts.part import STEP, Origin, Part
from rig.parts.poses import Still
from rig.parts.remainder import Cut, Indices, Mask, Remainder, Score, Series, Sign
from rig.signals.rest_spectrum import Bands, of_line
from rig.signals.sheet_noise import GRID, OPEN, Levels, Scatter, mean_density, with_added

SEEN = 25.0  # χ² that tells noise of another kind
NEAR, STEPS = 0.01, 12  # how near to it in its logarithm, and in how many steps at most
POWER_LAW = 2.0  # χ² of weak noise goes with the square of its power
TINY, FARTHEST = 1e-300, 20.0  # χ² of what changes nothing, and how far one step may go in the logarithm of a power
LONG = 600.0  # s at rest, beyond which no more is asked for
REMEMBERED = 64  # predictions of other models
SIDES = (1.0, 50.0)  # Hz, between the kinds of row
KINDS = ("noise below 1 Hz", "noise 1-50 Hz", "noise above 50 Hz")
OF_SHEET = "noise against the data sheet"
SHAPES: Mapping[str, int] = {"white": 0, "as 1/f": 1, "as 1/f²": 2}


class NoiseSpectrum(Part):
    """Records at rest as a part of a fit."""

    calibrates: ClassVar[bool] = False
    against: ClassVar[str] = "what it scatters"

    def __init__(self, data: NoiseRecords) -> None:
        self.data = data
        self._all = [data.trained, *([] if data.held is None else [data.held])]
        self._seen = [Scatter.of(one) for one in self._all]
        self._levels = Levels(data.sheet, data.rate, data.trained)
        self._made: dict[tuple[object, bytes], Array] = {}
        width = sum(len(one.dof) for one in self._all) + OPEN
        super().__init__(data.name, data.run, data.channels, width, notes=data.notes)

    @property
    def experiment(self) -> str:
        return self.data.place

    @property
    def drawing(self) -> str:
        return "noise"

    def alike(self, other: Part) -> bool:
        return isinstance(other, NoiseSpectrum) and super().alike(other)

    def here(self, terms: Sequence[Term]) -> list[Term]:
        return [one for one in at_work(terms, self.experiment, self.name) if one.effect.spectral]

    def acts(self, effect: Effect) -> bool:
        return effect.spectral and effect.shows(self.experiment)

    @cached_property
    def reference(self) -> Motion:
        """Nothing moves."""
        still, once = np.zeros((3, 1)), np.zeros(1)
        return Motion(
            grid=Still(), place=self.experiment, force=still, rate=still, turning=still, up=still, gravity=0.0,
            temperature=once + NOMINAL["temperature"], supply=once + NOMINAL["supply"], elapsed=once,
        )  # fmt: skip

    # rows: bands, those held out, and what the sheet leaves open

    @cached_property
    def frequency(self) -> Array:
        """Middle of every row's band, Hz, NaN of what is no band, (width,)."""
        return np.concatenate([*(np.sqrt(one.low * one.high) for one in self._all), np.full(OPEN, np.nan)])

    @cached_property
    def held_out(self) -> Mask:
        later = np.isfinite(self.frequency) & (np.arange(self.width) >= len(self.data.trained.dof))
        return np.asarray(np.tile(later, len(self.row_names)))

    @cached_property
    def counted(self) -> Mask:
        return np.ones(self.rows, np.bool_)

    @cached_property
    def observed(self) -> Array:
        """Nothing is above itself."""
        return np.zeros((len(self.row_names), self.width))

    @cached_property
    def _u(self) -> Array:
        """Relative standard deviation of every row's power; 1 of what is no band, (width,)."""
        return np.concatenate([*(one.u for one in self._seen), np.ones(OPEN)])

    def raw(self, local: Local, terms: Sequence[Term], only: Indices | None = None) -> Array:
        """How far a model is above what was recorded in every band, and what is open, in standard deviations (c, w)."""
        found = self._density(local, terms)
        parts = np.split(found, np.cumsum([len(one.dof) for one in self._all]), axis=1)
        bands = [-seen.deviates(density) for seen, density in zip(self._seen, parts, strict=False)]
        table = np.concatenate([*bands, parts[-1] / self.data.sheet.known], axis=1)
        return table if only is None else table[only]

    def _density(self, local: Local, terms: Sequence[Term]) -> Array:
        """Density in every band, V²/Hz, then what is open, (c, width)."""
        terms = self.here(terms)
        key = (
            tuple((one.effect, one.on, one.only, *one.at.values()) for one in terms),
            local.sensitivity.tobytes() * bool(terms),
        )
        if key not in self._made:
            if len(self._made) > REMEMBERED:
                self._made.clear()
            added = [self._added(one, local, terms) for one in self._all]
            nothing = np.zeros_like(self._start)  # a line that is not in the model drags the levels far away
            at = self._levels.with_added(nothing, added[0]) if terms else self._start
            clean = [mean_density(self.data.sheet, self.data.rate, one, at) for one in self._all]
            self._made[key] = np.concatenate(
                [*(with_added(one, more) for one, more in zip(clean, added, strict=True)), at], axis=1
            )
        return self._made[key]

    @property
    def bands_at(self) -> Array:
        """Middle of every band, Hz, (b,), those held out behind the others."""
        return self.frequency[:-OPEN]

    @property
    def bands_held(self) -> Mask:
        """Which of them are held out, (b,)."""
        return np.asarray(np.arange(self.width - OPEN) >= len(self.data.trained.dof))

    def densities(self, local: Local, terms: Sequence[Term]) -> tuple[Array, Array, Array]:
        """Of every band as recorded, as a model says, and as the data sheets do, SI/√Hz, three of (c, b)."""
        size = np.abs(self.channels.sensitivity)[:, None]
        seen = np.concatenate([one.power for one in self._all], axis=1)
        usual = np.zeros((len(size), OPEN))
        sheet = np.concatenate([mean_density(self.data.sheet, self.data.rate, b, usual) for b in self._all], axis=1)
        said = self._density(local, terms)[:, :-OPEN]
        return np.sqrt(seen) / size, np.sqrt(said) / size, np.sqrt(sheet) / size

    def unit_of_density(self, name: str) -> str:
        """As `densities` has it."""
        return f"({super().unit(name)})/√Hz"

    @cached_property
    def _start(self) -> Array:
        return self._levels.start()

    def _added(self, bands: Bands, local: Local, terms: Sequence[Term]) -> Array:
        """What terms add to the mean density of every band, V²/Hz, (c, b)."""
        found = np.zeros((len(self.channels.names), len(bands.dof)))
        for term in terms:
            here = term.among(self.channels)
            some = _scaled(self.channels, local, here)
            found[here] += term.effect.density(bands.nodes, self.data.rate, some, term.at).mean(axis=-1)
            if (line := term.effect.tone(self.data.rate, some, term.at)) is not None:
                found[here] += np.outer(0.5 * line[0] ** 2, of_line(bands, line[1]))
        return found

    def whitened(self, raw: NDArray[np.inexact]) -> Array:
        return np.asarray(raw, np.float64).reshape(-1)

    def own_columns(self, local: Local, terms: Sequence[Term], raw: NDArray[np.inexact]) -> list[Array]:
        """Only what terms add goes with the sensitivities."""
        gain = none = np.zeros(self.rows)
        if self.here(terms):
            near = replace(local, sensitivity=local.sensitivity + STEP * self.channels.sensitivity)
            gain = self.whitened((self.raw(near, terms) - raw) / STEP)
        return [gain, none, none]

    def walks(self) -> Mapping[str, float]:
        """Random walks that the records show, V²·Hz by channel."""
        return {name: float(q) for name, q in zip(self.channels.names, self.data.walk, strict=True) if q > 0.0}

    # how noisy the rows are

    def unsure(self, local: Local, terms: Sequence[Term]) -> Array:
        """Bands held out, by what the others do not tell of level, pole, corner and reach."""
        found = np.zeros((len(self.row_names), self.width, OPEN))
        if self.data.held is not None:
            terms = self.here(terms)
            at, first = self._density(local, terms)[:, -OPEN:], len(self.data.trained.dof)
            added, there = (self._added(one, local, terms) for one in self._all)
            found[:, first:-OPEN] = self._levels.unsure(at, added, self.data.held, there)
        return found.reshape(self.rows, OPEN)

    def origin(self, name: str) -> Origin:
        return "averages"

    @property
    def to_know(self) -> str:
        return "record longer at rest"

    def noise(self) -> Array:
        """Relative, of powers; what is open adds no error of its own."""
        return np.tile(np.where(np.isfinite(self.frequency), self._u**2, 0.0), (len(self.row_names), 1))

    def errors(self, left: Array) -> Array:
        return np.full(len(self.row_names), np.nan)

    def numbers(self) -> Array:
        return np.full(len(self.row_names), np.count_nonzero(np.isfinite(self.frequency)), np.float64)

    # what the rows stand for

    def domains(self) -> Mapping[str, Mask]:
        place = np.digitize(self.frequency, SIDES)
        known = np.isfinite(self.frequency)
        found = {kind: known & (place == number) for number, kind in enumerate(KINDS)}
        return {kind: mask for kind, mask in {**found, OF_SHEET: ~known}.items() if mask.any()}

    def cuts(self) -> Sequence[Cut]:
        return ()

    def series(self, rest: Remainder) -> Iterator[Series]:
        """None: a band's neighbour errs as it does where a sheet's shape is not quite the sensor's."""
        yield from ()

    def laws(
        self, component: str, rows: Sequence[int], rest: Remainder, score: Score
    ) -> Iterator[tuple[str, dict[int, float]]]:
        """How many times the data sheet's density there is at most, and as which power of frequency the rest goes."""
        if component == OF_SHEET:
            return
        mask = self.domains()[component][: len(self.data.trained.dof)]
        usual = mean_density(self.data.sheet, self.data.rate, self.data.trained, np.zeros((len(self.row_names), OPEN)))
        ratio = np.sqrt((self.data.trained.power / usual)[list(rows)][:, mask])
        left = rest.left.reshape(len(self.row_names), -1)[list(rows)][:, : len(mask)][:, mask]
        most = float(ratio[np.unravel_index(np.abs(left).argmax(), left.shape)])
        there = self._added(self.data.trained, rest.local, self.here(rest.terms))
        for words, power in SHAPES.items():
            removed = self._levels.removed(power, GRID[::4], there).max(axis=0)
            yield f"up to {most:.3g} times the data sheet's, {words}", {row: float(removed[row]) for row in rows}

    def faintest(self, effect: Effect) -> Iterator[str]:
        for on in effect.quantities if self.acts(effect) and not effect.looks_in else ():
            if len(self.channels.of(on)):
                term = self._seen_from(Term(effect, on, effect.starts(self.reference, on)[0]))
                if term is None:
                    continue
                first = effect.parameters[0]
                value = effect.physical(term.at)[first.name]
                unit = effect.units(on)[0]
                yield f"{term.key}: less than {value:.2g} {unit} would not be seen in {self.data.seconds:.0f} s at rest"

    def _seen_from(self, term: Term) -> Term | None:
        """The term as strong as just removes what chance hardly does; None if no strength does just that."""
        c, name = self.channels, term.effect.coordinates[0].name
        local = Local(c.sensitivity, c.pole, self.zeros)
        nothing, size, slope = self.raw(local, []), math.log(term.at[name]), POWER_LAW
        seen: list[tuple[float, float]] = []
        for _ in range(STEPS):
            there = term.moved(**{name: math.exp(size)})
            seen.append((size, math.log(max(np.sum((self.raw(local, [there]) - nothing) ** 2), TINY) / SEEN)))
            if abs(seen[-1][1]) < NEAR:
                return there
            if len(seen) > 1:
                (before, under), (now, over) = seen[-2:]
                slope = min(max((over - under) / (now - before), 0.5 * POWER_LAW), 10.0 * POWER_LAW)
            size -= min(max(seen[-1][1] / slope, -FARTHEST), FARTHEST)
        return None

    @classmethod
    def signs(cls, parts: Sequence[Self]) -> Iterator[Sign]:
        yield from signs([one.data for one in parts])

    @classmethod
    def unmeasured(cls, parts: Sequence[Self], blind: Sequence[str]) -> Iterator[tuple[str, str]]:
        seconds: dict[str, float] = {}
        for part in parts:
            seconds[part.experiment] = seconds.get(part.experiment, 0.0) + part.data.seconds
        for place, known in seconds.items():
            if known < LONG:
                said = f"only {known:.0f} s at rest with the cables of the {place}: weak noise is not seen"
                yield said, f"rig noise --length {LONG / 60.0:.0f}min --cables {place}"

    def title(self, name: str) -> str:
        return f"noise of {super().title(name)}"

    def unit(self, name: str) -> str:
        return "1"


def _scaled(channels: Channels, local: Local, here: Indices) -> Channels:
    """Some channels with the sensitivities that are fitted."""
    return replace(channels.only(here), sensitivity=local.sensitivity[here])
