"""What a model is compared with: a part, one experiment as rows of standard deviations.

Rows are ordered name after name (mostly channels), `width` of each, and a part says itself what they stand for: which
kinds of row there are, under which conditions they were taken, how noisy they are, by which laws they may err. Who fits
or diagnoses loops over parts and asks; nobody outside this folder asks which experiment it is.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from rig.foreign.finding import Finding as Finding
from rig.model import Channels, Effect, Local, Quantity, Term, at_work, labelled
from rig.motion import Array, Motion
from rig.parts.remainder import (
    Cut,
    Growth,
    Indices,
    Mask,
    Prediction,
    Remainder,
    Reversal,
    Score,
    Series,
    Sign,
)
from rig.parts.ripple import Floor
from rig.signals.peaks import peaks

STEP = 1e-4  # relative, of sensitivities and poles; V, of zeros
ALLOWANCE = 0.06  # relative uncertainty of an estimated variance
Origin = Literal[
    "at rest", "averages", "beside the lines", "repeats", "stated", "data sheet", "above the motion", "misfit"
]
"""Where the noise of some rows is known from. What a model leaves over is no independent source: "misfit"."""


class Part(ABC):
    """One experiment as rows of standard deviations.

    `instruments`: kinds of reference with effects of their own. `logged`: signals beside the motion that its records
    hold: temperature, supply, source. `formulas`: shapes of a formula that this motion may
    show, beside those that any may. `extra` (rows, k): nuisances with a prior of one standard deviation each,
    called `extra_title`. `faults`: samples that are no measurement and were left out, and what else looks wrong with
    the records.
    """

    instruments: frozenset[str] = frozenset()
    logged: frozenset[str] = frozenset()
    formulas: ClassVar[tuple[str, ...]] = ()
    extra_title: ClassVar[str] = "ripple"
    against: ClassVar[str] = "the noise"  # what ratios of its rows are to
    calibrates: ClassVar[bool] = True  # whether sensitivities and zero outputs show in it
    faults: tuple[Finding, ...] = ()
    bands: tuple[float, ...] = ()  # Hz, up to which rates and forces of a sampled reference are compared

    def __init__(
        self, name: str, run: str, channels: Channels, width: int, *, row_names: tuple[str, ...] | None = None,
        row_rates: Mask | None = None, notes: Sequence[str] = (), blind: Sequence[str] = (),
    ) -> None:  # fmt: skip
        self.name, self.run, self.channels, self.width = name, run, channels, width
        self.row_names = channels.names if row_names is None else row_names
        self.row_rates = channels.rates if row_rates is None else row_rates
        self.notes, self.blind = tuple(notes), tuple(blind)
        self.extra = np.zeros((self.rows, 0))

    # what it is

    @property
    @abstractmethod
    def experiment(self) -> str:
        """The word for it in results, and in the places where an effect can show."""

    @property
    @abstractmethod
    def drawing(self) -> str:
        """The drawing that shows what is left over."""

    @property
    def rows(self) -> int:
        """Numbers compared."""
        return len(self.row_names) * self.width

    @property
    @abstractmethod
    def held_out(self) -> Mask:
        """Rows that a model is judged by, (rows,)."""

    @property
    @abstractmethod
    def counted(self) -> Mask:
        """Rows that carry an observation, (rows,)."""

    @property
    @abstractmethod
    def reference(self) -> Motion:
        """The motion as the reference shows it, before any effect."""

    @property
    @abstractmethod
    def observed(self) -> NDArray[np.inexact]:
        """What was recorded, as `raw` predicts it."""

    @property
    def zeros(self) -> Array:
        """Zero outputs of its channels where a fit begins, V, (c,)."""
        return np.zeros(len(self.channels.names))

    @property
    def stated(self) -> Array:
        """Sensitivities, V/SI, that the data's owner would call one, (c,): ratios are taken to them."""
        return np.abs(self.channels.sensitivity)

    def unstated(self) -> Iterator[Term]:
        """What is fitted with any calibration from here because no data sheet states it."""
        return iter(())

    def alike(self, other: Part) -> bool:
        """Whether another part is of the same experiment: zero outputs carry over."""
        return self.within(other.experiment)

    def within(self, experiment: str) -> bool:
        """Whether a word in results means this experiment."""
        return self.experiment == experiment

    def here(self, terms: Sequence[Term]) -> list[Term]:
        """Those of the terms that can show here."""
        return [one for one in at_work(terms, self.experiment, self.name) if not one.effect.spectral]

    def acts(self, effect: Effect) -> bool:
        """Whether an effect can show here."""
        return self.experiment in effect.places and not effect.spectral

    def excites(self, on: Quantity | None) -> bool:
        """Whether this is an experiment that drives the channels of a quantity."""
        return False

    def apart(self, term: Term) -> Indices | None:
        """Channels that alone feel a term; None if all do."""
        return term.among(self.channels) if term.on is not None and term.effect.stage != "reference" else None

    # rows

    @abstractmethod
    def raw(self, local: Local, terms: Sequence[Term], only: Indices | None = None) -> NDArray[np.inexact]:
        """Predicted outputs of every channel (or of some)."""

    @abstractmethod
    def whitened(self, raw: NDArray[np.inexact]) -> Array:
        """Outputs in standard deviations, (rows,)."""

    @cached_property
    def target(self) -> Array:
        """What was recorded in standard deviations, (rows,)."""
        return self.whitened(self.observed)

    def each_channel(self, raw: NDArray[np.inexact]) -> Array:
        """Whitened changes that are every channel's own: (rows,) if each moves its own rows only, else (rows, c)."""
        return self.whitened(raw)

    def blocks(self) -> list[tuple[slice, Indices]]:
        """Rows and the channels whose own parameters move them."""
        width = self.width
        return [(slice(c * width, (c + 1) * width), np.array([c])) for c in range(len(self.row_names))]

    def own_columns(self, local: Local, terms: Sequence[Term], raw: NDArray[np.inexact]) -> list[Array]:
        """Derivatives of the rows by relative gain, log pole and zero output of every channel, three of (rows,) or
        (rows, c); `raw` is the prediction there.
        """
        nearby = (
            replace(local, sensitivity=local.sensitivity + STEP * self.channels.sensitivity),
            replace(local, pole=local.pole * np.exp(STEP)),
            replace(local, zero=local.zero + STEP),
        )
        return [self.each_channel((self.raw(one, terms) - raw) / STEP) for one in nearby]

    def with_ripple(self, floor: Floor | None) -> Self:
        """The same with the bench's own ripple as nuisances, where a mounting has any."""
        return self

    def with_walk(self, walk: Mapping[str, float]) -> Self:
        """The same where zeros walk at random besides, V²·Hz by channel: how uncertain means are depends on it."""
        made = self._walking([walk.get(name, 0.0) for name in self.channels.names])
        made.notes = self.notes
        return made

    def _walking(self, levels: Sequence[float]) -> Self:
        """The same with these random walks, V²·Hz (c,); itself where it has no means that feel them."""
        return self

    def said_of_ripple(self, floor: Floor | None) -> tuple[str, ...]:
        """What is to be said of the bench's own ripple here."""
        return ()

    @property
    def mounting(self) -> str:
        """What a mounting must share with others so that their differences show the bench's ripple; "" for none."""
        return ""

    def responses(self) -> Mapping[tuple[str, float, str], tuple[complex, float]]:
        """Response and relative variance of each part of it by channel, nominal frequency and level."""
        return {}

    # how noisy the rows are

    @abstractmethod
    def origin(self, name: str) -> Origin:
        """Where the noise of a name's rows is known from."""

    @property
    def to_know(self) -> str:
        """What would make their noise known independently of a misfit."""
        return "record 30 s at rest"

    @property
    def to_judge(self) -> str:
        """What would leave rows to hold out."""
        return "a longer record"

    @abstractmethod
    def noise(self) -> Array:
        """Variance of the noise of every number compared, referred to the input, SI², (names, width)."""

    def unsure(self, local: Local, terms: Sequence[Term]) -> Array:
        """How far rows that were held out move by one standard deviation of what a part finds of every name from the
        others, whatever is fitted, (rows, k).
        """
        return np.zeros((self.rows, 0))

    def changes(self) -> Iterator[tuple[str, str, Array]]:
        """What may change in the course of a record while χ² of all rows hides it: a name, words, and what each of k
        such changes does to the rows, (rows, k), of any size.
        """
        return iter(())

    def numbers(self) -> Array:
        """How many numbers the squares of a name's rows add up over, for its rms error, (names,)."""
        return np.asarray(self.counted.reshape(len(self.row_names), -1).sum(axis=1), np.float64)

    def numbers_in(self, mask: Mask) -> float:
        """How many the variances of some rows of a name add up over, mask (width,)."""
        return float(np.count_nonzero(mask))

    def errors(self, left: Array) -> Array:
        """Sum of squares of what is left over in every name's rows, referred to the input, SI², (names,).

        NaN where it is told by the noise and the ratio to it.
        """
        squares = np.where(self.counted, left, 0.0).reshape(len(self.row_names), -1) ** 2
        return np.asarray(np.sum(squares * self.noise(), axis=1))

    @property
    def allowance(self) -> float:
        """Relative uncertainty of the variances that the rows are weighed with."""
        return ALLOWANCE

    def allowance_of(self, name: str, mask: Mask) -> float:
        """The same for some rows of a name, mask (width,)."""
        return self.allowance

    def unevenness(self, change: Array, left: Array) -> float:
        """How many times more the χ² that one effect removes scatters by chance, because noise is not the same
        throughout. `change` (rows,) is what the effect moves, `left` (rows,) what may be taken for noise.
        """
        return 1.0

    def amplified(self, raw: NDArray[np.inexact]) -> Iterator[tuple[Array, Array]]:
        """Of every channel that follows the drive frequencies, Hz, and how many times larger its output is there than
        predicted, both (p,); `raw` is the prediction.
        """
        return iter(())

    def peaks(self, raw: NDArray[np.inexact]) -> set[float]:
        """Where a channel's response stands out of what is predicted, Hz."""
        return {float(f) for frequency, size in self.amplified(raw) for f in peaks(frequency, size)}

    # what the rows stand for

    @abstractmethod
    def domains(self) -> Mapping[str, Mask]:
        """Kinds of row by name, each (width,); together they are all rows of a name."""

    def components(self) -> Mapping[str, Mask]:
        """Kinds of row as a comparison looks at them, finer than domains or across them; each (width,)."""
        return self.domains()

    @abstractmethod
    def cuts(self) -> Sequence[Cut]:
        """Conditions by which what is left over is looked at."""

    def joined(self, cuts: Sequence[Cut]) -> str:
        """Several conditions of one kind in words."""
        return " and ".join(cut.words for cut in cuts)

    def entangled(self, component: str, other: str) -> bool:
        """Whether an error in one component shows in the other by the way rows are made."""
        return component == other

    def recurs(self, component: str) -> bool:
        """Whether laws of other components name this one, so that it needs no saying again."""
        return False

    def squares(self, rest: Remainder) -> Array:
        """Squares of what is left over, as the components divide it, (names, width)."""
        return np.asarray(rest.left.reshape(len(self.row_names), -1) ** 2)

    def series(self, rest: Remainder) -> Iterator[Series]:
        """What is left over in orders in which noise has none: each kind of row of each name."""
        whole = rest.left.reshape(len(self.row_names), -1)
        used = rest.used.reshape(whole.shape)
        for row, name in enumerate(self.row_names):
            for what, mask in self.components().items():
                yield Series(f"{self.name} {name}, {what}", whole[row][mask & used[row]])

    def shapes(self, component: str) -> Mapping[str, Array]:
        """Laws that an error of this kind of row may follow, in words, SI: (width,) or (names, width)."""
        return {}

    def laws(
        self, component: str, rows: Sequence[int], rest: Remainder, score: Score
    ) -> Iterator[tuple[str, dict[int, float]]]:
        """Laws in words with the χ² that each would take from a component's rows; one coefficient a name."""
        left, used = (one.reshape(len(self.row_names), -1) for one in (rest.left, rest.used))
        mask = self.components()[component]
        for words, shape in self.shapes(component).items():
            gains = {}
            for row in rows:
                here = mask & used[row]
                own = shape if shape.ndim == 1 else shape[row]
                column = self.in_deviations(row, own)[here]
                size = float(column @ column)
                gains[row] = float(column @ left[row][here]) ** 2 / size if size > 0.0 else 0.0
            yield words, gains

    def in_deviations(self, row: int, shape: Array) -> Array:
        """A law of one name, SI, in standard deviations, (width,)."""
        return np.asarray(shape / np.sqrt(self.noise()[row]))

    def growth(self, domain: str, row: int, found: Prediction) -> Growth | None:
        """What the rows of a domain may be a power of; None where nothing varies."""
        return None

    def reversal(self, domain: str, row: int, excess: float, found: Prediction) -> Reversal | None:
        """How much of the χ² in excess in a domain stays the same when the input is reversed; None if it tells not."""
        return None

    # words

    @cached_property
    def labels(self) -> list[tuple[str, str]]:
        """What each row's unit is called, and which axis of it the row is."""
        said = dict(zip(self.channels.names, zip(self.channels.titles, self.channels.words, strict=True), strict=True))
        return [said.get(name) or labelled(name) for name in self.row_names]

    def title(self, name: str) -> str:
        """What a row is called in a comparison; rows of equal titles make one group."""
        return "gyros" if self.row_rates[self.row_names.index(name)] else "accelerometers"

    def unit(self, name: str) -> str:
        """SI unit of a row's error, referred to the input."""
        return "rad/s" if self.row_rates[self.row_names.index(name)] else "m/s²"

    def remarks(self, left: Array, local: Local, terms: Sequence[Term]) -> tuple[str, ...]:
        """What only this kind of record can tell of a fitted model, a sentence each; `left` its rows (rows,)."""
        return ()

    def faintest(self, effect: Effect) -> Iterator[str]:
        """How strong an effect would have to be to be seen here, where that goes with the length of a record."""
        yield from ()

    def left_out(self) -> Iterator[str]:
        """Channels that are not compared, in words."""
        yield from ()

    # what all parts of one kind tell together

    @classmethod
    def signs(cls, parts: Sequence[Self]) -> Iterator[Sign]:
        """What the instruments' own tests show in parts of this kind."""
        yield from ()

    @classmethod
    def lacks(cls, parts: Sequence[Self]) -> Iterator[str]:
        """What runs of this kind cannot show for want of a level, a rest, an axis; without any, what only they show."""
        yield from ()

    @classmethod
    def unmeasured(cls, parts: Sequence[Self], blind: Sequence[str]) -> Iterator[tuple[str, str]]:
        """What the bench could still measure of this kind: a sentence, and the command."""
        yield from ()

    def options(self) -> Iterator[Option]:
        """Measurements that the bench can do as this one was done."""
        yield from ()


@dataclass(frozen=True)
class Option:
    """One measurement: what it is, why it would help, how long it takes, the procedure, and how its part looks."""

    name: str
    why: str
    minutes: float
    document: Mapping[str, Any]
    part: Callable[[], Part]


def by_kind(parts: Iterable[Part]) -> list[tuple[type[Part], list[Part]]]:
    """Parts of each kind together, in the order in which the kinds first appear."""
    found: dict[type[Part], list[Part]] = {}
    for part in parts:
        found.setdefault(type(part), []).append(part)
    return list(found.items())
