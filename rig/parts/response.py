"""A table of frequency responses as a model sees it: magnitude and phase at every frequency, no time series needed.

Compared is the logarithm of the complex ratio of the sensor's output to the reference's acceleration: its real part is
magnitude and its imaginary part phase, unwrapped from the lowest frequency up, and either has its own uncertainty.
Repeats at one frequency are turned into their mean and contrasts (an orthonormal transform): contrasts have the scatter
of the repeats, pooled over neighbouring frequencies; the mean has besides what was stated as uncertainty, because a
reference that is wrong is wrong in every repeat alike.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.model import Channels, Local, Quantity, Term, volts
from rig.motion import FINE, ORDERS, PHASES, Array, Complexes, Motion, Periods
from rig.parts.conditions import NOMINAL
from rig.parts.formulas import OF_SHAKER
from rig.parts.part import Origin, Part
from rig.parts.remainder import Cut, Mask

CLOSE = 1e-6  # relative: one frequency
NEIGHBOURS = 2  # frequencies on either side that repeats' scatter is pooled over
STEPS = 12  # places in the table at which a step is tried
CONFOUNDED = 0.8  # correlation of the logarithms of level and frequency


@dataclass(frozen=True)
class ResponseRecords:
    """p measured points of one channel: `frequency` Hz, `excitation` m/s², complex `ratio`, standard uncertainties of
    `magnitude` (of the ratio's unit) and `phase` (rad) as stated, zero where nothing is; `repeat` counts them at each
    frequency, `row` is the number of each in the order in which they were measured; all (p,). `held` (p,): a model is
    judged by them.
    """

    name: str
    run: str
    channels: Channels
    frequency: Array
    excitation: Array
    ratio: Complexes
    u_magnitude: Array
    u_phase: Array
    repeat: NDArray[np.intp]
    row: NDArray[np.intp]
    held: Mask
    gravity: float
    notes: tuple[str, ...] = ()


def places_of(frequency: Array) -> NDArray[np.intp]:
    """Number of each distinct frequency, for sorted ones, (p,)."""
    new = np.diff(frequency, prepend=-math.inf) > CLOSE * frequency
    return np.cumsum(new) - 1


class ResponseTable(Part):
    """A table of frequency responses as a part of a fit. Raises BadInput without repeats and uncertainties."""

    experiment = "shaker"
    drawing = "response"
    formulas = OF_SHAKER

    def __init__(self, data: ResponseRecords) -> None:
        self.data = data
        super().__init__(data.name, data.run, data.channels, 2 * len(data.frequency), notes=data.notes,
                         blind=_blind(data))  # fmt: skip
        self.grid, self._fine = Periods(data.frequency), Periods(data.frequency, FINE)
        self._turns = self._points()

    @property
    def observed(self) -> Complexes:
        return self._logarithm(self.data.ratio[None])

    def excites(self, on: Quantity | None) -> bool:
        return on != "rate"

    @cached_property
    def reference(self) -> Motion:
        data = self.data
        count, axis = len(data.frequency), int(self.channels.axis[0])
        drive, up, side = (np.repeat(np.eye(3)[:, [(axis + k) % 3]], count, axis=1) for k in range(3))
        along = np.zeros((count, ORDERS), np.complex128)
        along[:, 1] = data.excitation
        still = np.zeros((3, count, PHASES))
        return Motion(
            grid=self.grid, place=self.experiment, force=still, rate=still, turning=still, up=up, gravity=data.gravity,
            temperature=np.full(count, NOMINAL["temperature"]), supply=np.full(count, NOMINAL["supply"]),
            elapsed=np.zeros(count), along=along, drive=drive, side=side, source=np.zeros(count), scale=np.ones(count),
        )  # fmt: skip

    def raw(self, local: Local, terms: Sequence[Term], only: NDArray[np.intp] | None = None) -> Complexes:
        """Logarithm of the predicted ratio, (1, p)."""
        terms = self.here(terms)
        shown = self.reference
        along = shown.along
        for term in terms:
            along = term.effect.shaken(along, self.grid.harmonics, shown.scale, term.at)
        grid = self._fine if any(term.effect.kinked for term in terms) else self.grid
        force = shown.drive[:, :, None] * grid.waveform(along) + shown.gravity * shown.up[:, :, None]
        still = np.zeros_like(force)
        moved = Motion(**{**vars(shown), "grid": grid, "along": along, "force": force, "rate": still, "turning": still})
        channels = self.channels
        if only is not None:
            channels, local = channels.only(only), local.only(only)
        return self._logarithm(volts(moved, channels, local, terms)[..., 1] / self.data.excitation)

    def amplified(self, raw: NDArray[np.inexact]) -> Iterator[tuple[Array, Array]]:
        yield self.data.frequency, np.exp((self.observed - raw).real[0])

    def _logarithm(self, ratio: NDArray[np.inexact]) -> Complexes:
        """Complex logarithm, its imaginary part unwrapped along frequency, (1, p)."""
        phase = np.angle(ratio * np.conj(self._means))  # small steps between repeats and neighbours
        return np.asarray(np.log(np.abs(ratio)) + 1j * np.unwrap(phase))

    def _points(self) -> list[tuple[slice, Array, Array]]:
        """For every frequency its points, the transform to mean and contrasts, and variances of both parts, (n, 2)."""
        data = self.data
        place = places_of(data.frequency)
        counts = np.bincount(place)
        bounds = np.concatenate([[0], np.cumsum(counts)])
        scatter = self._scatter(bounds)
        found = []
        for k, (begin, end) in enumerate(itertools.pairwise(bounds.tolist())):
            n, here = end - begin, slice(begin, end)
            size = np.abs(data.ratio[here])
            stated = np.array([np.mean((data.u_magnitude[here] / size) ** 2), np.mean(data.u_phase[here] ** 2)])
            variance = np.repeat(scatter[k][None], n, axis=0)
            variance[0] += n * stated
            if scatter[k].max() == 0.0:
                variance[:] = stated
            found.append((here, _contrasts(n), variance))
        if any(variance.min() <= 0.0 for _, _, variance in found):
            raise BadInput(f"{data.name}: found neither repeats nor uncertainties, wanted one of them")
        return found

    def _scatter(self, bounds: NDArray[np.intp]) -> Array:
        """Variance of one repeat in ln magnitude and in phase, pooled over neighbours, (frequencies, 2)."""
        ratio = self.data.ratio
        squares, freedom = np.zeros((len(bounds) - 1, 2)), np.zeros(len(bounds) - 1)
        for k, (begin, end) in enumerate(itertools.pairwise(bounds.tolist())):
            mean = ratio[begin:end].mean()
            apart = ratio[begin:end] / mean - 1.0
            squares[k] = np.sum(apart.real**2), np.sum(apart.imag**2)
            freedom[k] = end - begin - 1
        wide = np.ones(2 * NEIGHBOURS + 1)
        total = np.convolve(freedom, wide, mode="same")
        pooled = np.stack([np.convolve(squares[:, j], wide, mode="same") for j in range(2)], axis=1)
        return np.asarray(np.where(total[:, None] > 0.0, pooled / np.maximum(total, 1.0)[:, None], 0.0))

    def _rotated(self, logarithm: Complexes) -> Array:
        """Mean and contrasts of every frequency, magnitude and phase parts, (p, 2)."""
        parts = np.stack([logarithm.real, logarithm.imag], axis=1)
        return np.concatenate([turn @ parts[here] for here, turn, _ in self._turns])

    @cached_property
    def _means(self) -> Complexes:
        """Mean response at each point's frequency, (p,)."""
        place = places_of(self.data.frequency)
        total = np.bincount(place, self.data.ratio.real) + 1j * np.bincount(place, self.data.ratio.imag)
        return np.asarray((total / np.bincount(place))[place])

    @cached_property
    def _variance(self) -> Array:
        return np.concatenate([variance for _, _, variance in self._turns])

    def whitened(self, raw: NDArray[np.inexact]) -> Array:
        return np.asarray((self._rotated(np.asarray(raw[0], np.complex128)) / np.sqrt(self._variance)).reshape(-1))

    @property
    def held_out(self) -> Mask:
        return np.repeat(self.data.held, 2)

    @property
    def counted(self) -> Mask:
        return np.ones(self.rows, np.bool_)

    def domains(self) -> Mapping[str, Mask]:
        first = np.concatenate([np.arange(len(variance)) == 0 for _, _, variance in self._turns])
        is_mean, phase = np.repeat(first, 2), np.tile([False, True], len(first))
        return {"magnitude": is_mean & ~phase, "phase": is_mean & phase, "repeats": ~is_mean}

    def cuts(self) -> Sequence[Cut]:
        data = self.data
        found = []
        for kind, unit, values in (("frequency", "Hz", data.frequency), ("level", "m/s²", data.excitation)):
            for some in np.array_split(np.unique(values), 3):
                if len(some):
                    inside = (values >= some[0]) & (values <= some[-1])
                    found.append(Cut(kind, f"{some[0]:.3g}–{some[-1]:.3g} {unit}", np.repeat(inside, 2)))
        return found

    def changes(self) -> Iterator[tuple[str, str, Array]]:
        """What repeats show of a step or a trend of size and of phase in the order in which rows were measured.

        Means of frequencies say nothing of it: a frequency may well have another response than the one before.
        """
        row = self.data.row
        at = np.quantile(row, np.linspace(0.0, 1.0, STEPS + 2)[1:-1])
        laws = [*((row > one).astype(np.float64) for one in at), row / max(int(row.max()), 1)]
        is_mean = np.concatenate([np.arange(len(variance)) == 0 for _, _, variance in self._turns])
        for k, words in enumerate(("size", "phase")):
            columns = np.stack([self.whitened(law[None] * (1.0, 1j)[k]) for law in laws], axis=1)
            columns[np.repeat(is_mean, 2)] = 0.0
            yield self.row_names[0], f"its {words} in the course of the table", columns

    @property
    def to_judge(self) -> str:
        return "more frequencies"

    def origin(self, name: str) -> Origin:
        return "repeats" if len(self.data.frequency) > len(self._turns) else "stated"

    def noise(self) -> Array:
        return np.asarray(self._variance * np.abs(self._means[:, None]) ** 2).reshape(1, -1)

    @property
    def allowance(self) -> float:
        """A scatter is known as well as there are repeats; what is stated counts as known."""
        count = len(self._turns)
        freedom = len(self.data.frequency) - count
        if not freedom:
            return super().allowance
        own = [variance[-1] / variance[0] for _, _, variance in self._turns if len(variance) > 1]
        return math.hypot(super().allowance, math.sqrt(2.0 / freedom) * float(np.mean(own)))

    def errors(self, left: Array) -> Array:
        """Sum of squares of |H observed − H predicted|."""
        apart = left.reshape(-1, 2) * np.sqrt(self._variance)
        back = np.concatenate([turn.T @ apart[here] for here, turn, _ in self._turns])
        predicted = self.data.ratio * np.exp(-back[:, 0] - 1j * back[:, 1])
        return np.array([float(np.sum(np.abs(self.data.ratio - predicted) ** 2))])

    def numbers(self) -> Array:
        return np.array([float(len(self.data.frequency))])

    def shapes(self, component: str) -> Mapping[str, Array]:
        """Powers of frequency, and the level."""
        means = np.zeros(len(self.data.frequency))
        f, level = self.data.frequency, self.data.excitation
        found = {}
        for words, law in (
            ("the same at every frequency", np.ones(len(f))), ("grows as f", f), ("grows as f²", f**2),
            ("grows with the level", level),
        ):  # fmt: skip
            whole = means.copy()
            for here, _, _ in self._turns:  # a law moves means only, √n of it
                whole[here.start] = math.sqrt(here.stop - here.start) * float(np.mean(law[here]))
            found[words] = np.repeat(whole * np.abs(self._means) / np.abs(whole).max(), 2)
        return found

    def title(self, name: str) -> str:
        return "response"

    def unit(self, name: str) -> str:
        return "1"


def _blind(data: ResponseRecords) -> tuple[str, ...]:
    """What such a table cannot show."""
    level, f = data.excitation, data.frequency
    said = ["one response per frequency: zero output, harmonics and noise are not in the table"]
    if len(np.unique(level)) > 2 and abs(float(np.corrcoef(np.log(level), np.log(f))[0, 1])) > CONFOUNDED:
        said.append(
            f"the excitation rises with frequency ({level.min():.3g} to {level.max():.3g} m/s²): what depends on "
            "level cannot be told from what depends on frequency; repeat at another level"
        )
    said.append("a delay of the sensor and one of the reference are one and the same here; time both by another clock")
    return tuple(said)


def _contrasts(n: int) -> Array:
    """Orthonormal transform of n repeats: their mean (times √n) first, then contrasts (Helmert), (n, n)."""
    found = np.zeros((n, n))
    found[0] = 1.0 / math.sqrt(n)
    for k in range(1, n):
        found[k, :k], found[k, k] = 1.0, -k
        found[k] /= math.sqrt(k * (k + 1.0))
    return found
