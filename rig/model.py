"""The sensor model: a chain of physical effects from the reference's reading to the volts of every channel.

    reference → motion → transducer → dynamics → output (sensitivity, zero) → electronics → sampling

An effect is one physical statement: what it does at its stage, its parameters, what data look like when it is missing.
Effects compose in the order of the chain. Every channel has a sensitivity S, a zero output V₀ and one pole of its
output filter besides; with nothing else that is the data-sheet model  V = S·u/(1 + jf/f_p) + V₀.

An effect's *coordinates* are what is fitted. They are chosen so that the effect vanishes where all of them are zero and
is as straight as possible there (a filter's reciprocal corner, a vector's two components); `physical` turns them into
the parameters that a person reads, with units.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from rig.correction.inverse import (
    NEXT,
    SI,
    Added,
    Bend,
    Drift,
    Expression,
    Filtered,
    Inverse,
    Late,
    Lost,
    Nothing,
    Quantity,
    Shares,
    arms,
)
from rig.motion import Array, Complexes, Grid, Motion, Periods, Stretches

Stage = Literal["reference", "motion", "transducer", "dynamics", "electronics", "sampling", "noise"]
Values = Mapping[str, float]
BOTH: tuple[Quantity, ...] = ("acceleration", "rate")
EXPERIMENTS: Mapping[str, str] = {
    "shaker": "shaker", "turntable": "turntable", "rotation": "imported rotations", "free": "imported free motion",
    "poses": "poses against gravity",
}  # fmt: skip
"""What a part is of, and where an effect can show, by its word: the rig's own two benches, and others."""
EVERYWHERE = tuple(EXPERIMENTS)
REMEMBERED = 4  # signals: with all channels of a long record they are large
if TYPE_CHECKING:
    Experiment = str
else:
    Experiment = Literal[EVERYWHERE]

__all__ = [
    "BOTH", "EVERYWHERE", "EXPERIMENTS", "NEXT", "SI", "Added", "Array", "Bend", "Channels", "Complexes", "Coordinate",
    "Drift", "Effect", "Experiment", "Expression", "Filtered", "Inverse", "Late", "Local", "Lost", "Motion", "Nothing",
    "Parameter", "Periods", "Quantity", "Shares", "Stage", "Stretches", "Term", "Values", "arms", "at_work", "volts",
]  # fmt: skip


@dataclass(frozen=True)
class Coordinate:
    """One fitted number: a step over which the effect is straight, and starts for those that cannot start at zero.

    `searched` ones are tried at their starts and stay there (a whole number, one of a few ranges). Those that `shape`
    do nothing while the others, which are sizes, are nought.
    """

    name: str
    step: float
    starts: tuple[float, ...] = (0.0,)
    searched: bool = False
    shape: bool = False


@dataclass(frozen=True)
class Parameter:
    """One parameter as a person reads it: SI unit, limits that physics allows, and sizes that are usual."""

    name: str
    unit: str
    bounds: tuple[float, float]
    typical: tuple[float, float]


@dataclass(frozen=True)
class Channels:
    """Channels of one recorder, c of them, as data sheets and cabling describe them.

    `axis` 0, 1, 2 in the case frame; `slot` in the scan; `side` m from the vibrometer's spot to the side (NaN: not
    stated); `sensitivity` V/SI, its relative `tolerance`, and `pole` Hz by the data sheet; `unit` groups channels.
    For words and figures: `titles` of each one's unit, its axis in `words`, and `colours`; where nothing states them
    a name up to its last underscore, the rest of it, and none.
    """

    names: tuple[str, ...]
    rates: NDArray[np.bool_]
    axis: NDArray[np.intp]
    slot: NDArray[np.intp]
    side: Array
    sensitivity: Array
    tolerance: Array
    pole: Array
    unit: tuple[str, ...]
    titles: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    colours: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (self.titles and self.words):
            labels = [labelled(name) for name in self.names]
            object.__setattr__(self, "titles", self.titles or tuple(title for title, _ in labels))
            object.__setattr__(self, "words", self.words or tuple(word for _, word in labels))
        object.__setattr__(self, "colours", self.colours or ("",) * len(self.names))

    def of(self, quantity: Quantity | None) -> NDArray[np.intp]:
        """Indices of the channels of one quantity, all without."""
        if quantity is None:
            return np.arange(len(self.names))
        return np.flatnonzero(self.rates == (quantity == "rate"))

    def only(self, index: NDArray[np.intp]) -> Channels:
        """Some of them."""
        if np.array_equal(index, np.arange(len(self.names))):
            return self
        arrays = {name: getattr(self, name)[index] for name in _ARRAYS}
        labels: dict[str, Any] = {name: tuple(getattr(self, name)[i] for i in index) for name in _LABELS}
        return replace(self, **arrays, **labels)


def labelled(name: str) -> tuple[str, str]:
    """`moving_gyro` and `z` of `moving_gyro_z`: how a name that nothing explains is said; it decides no number."""
    title = name.rsplit("_", 1)[0]
    return title, name.removeprefix(title).strip("_")


_LABELS = ("names", "unit", "titles", "words", "colours")
_ARRAYS = ("rates", "axis", "slot", "side", "sensitivity", "tolerance", "pole")


@dataclass(frozen=True)
class Local:
    """What belongs to each channel: sensitivity V/SI, pole Hz, zero output V; all (c,)."""

    sensitivity: Array
    pole: Array
    zero: Array

    def only(self, index: NDArray[np.intp]) -> Local:
        """Of some channels."""
        return Local(self.sensitivity[index], self.pole[index], self.zero[index])


class Effect:
    """One physical effect. Subclasses say what it is and override the hooks of their stage; the rest do nothing.

    `quantities`: the channels it can act on, each a statement of its own; () for what acts on the reference or on the
    motion as a whole. `places`: where it can show; only there it is asked.
    `absorbed`: why no fit can see it beside sensitivity and zero.
    """

    name: ClassVar[str] = ""
    stage: ClassVar[Stage]
    title: ClassVar[str]
    equation: ClassVar[str]
    quantities: ClassVar[tuple[Quantity, ...]] = ()
    places: ClassVar[tuple[str, ...]] = EVERYWHERE
    coordinates: ClassVar[tuple[Coordinate, ...]] = ()
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    missing: ClassVar[str]
    confused_with: ClassVar[tuple[str, ...]] = ()
    separate_by: ClassVar[str]
    source: ClassVar[str]
    absorbed: ClassVar[str] = ""
    kinked: ClassVar[bool] = False  # a characteristic that is not smooth
    contains: ClassVar[tuple[str, ...]] = ()  # effects that it is where some of its numbers are certain ones
    beside: ClassVar[tuple[tuple[str, ...], ...]] = ()  # a search tries it only where one of each group does some good
    entries: ClassVar[bool] = False  # each coordinate says something by itself, and a record may show some of them only
    rarity: ClassVar[float] = 0.0  # how much less usual than its neighbours, as a logarithm of odds
    instrument: ClassVar[str] = ""  # "": any; else it is of this kind of reference only, e.g. "vibrometer"
    needs: ClassVar[tuple[str, ...]] = ()  # signals that a record must hold for it: temperature, supply, source
    looks_in: ClassVar[str] = ""  # "": the observables; else a test of its own, e.g. "lines", "closure"
    parts: ClassVar[frozenset[str]] = frozenset()  # empty: all at its places; else of the reference of these alone
    elsewhere: ClassVar[str] = ""  # why there is nothing to undo in what a unit shows: "it belongs to the …"
    lost: ClassVar[str] = "its file does not say how"  # why it cannot be undone, where it says no inverse

    def shows(self, place: str) -> bool:
        """Whether it can show in this kind of experiment."""
        return place in self.places

    def units(self, on: Quantity | None) -> tuple[str, ...]:
        """Units of the parameters for channels of one quantity; `SI` in a unit stands for that quantity's."""
        return tuple(p.unit.replace("SI", SI[on] if on else "") for p in self.parameters)

    def physical(self, at: Values) -> dict[str, float]:
        """Parameters from coordinates; by default they are the same numbers."""
        return {name: float(at[name]) for name in (p.name for p in self.parameters)}

    def from_physical(self, values: Values) -> dict[str, float]:
        """Coordinates from parameters; by default the same numbers."""
        return {c.name: float(values[c.name]) for c in self.coordinates}

    def starts(self, motion: Motion, on: Quantity | None) -> list[dict[str, float]]:
        """Coordinates to start a fit from; by default every combination of the coordinates' starts."""
        names = [c.name for c in self.coordinates]
        return [dict(zip(names, one, strict=True)) for one in itertools.product(*(c.starts for c in self.coordinates))]

    def at_peak(self, frequency: float) -> list[dict[str, float]]:
        """Coordinates to start from if it is what makes a response peak at this frequency, Hz; by default none."""
        return []

    def inverse(self, at: Values) -> Inverse:
        """How it is undone in what a unit shows: see `rig.correction.inverse` for the kinds."""
        return Nothing(self.elsewhere) if self.elsewhere else Lost(self.lost)

    # hooks: reference
    def shaken(self, along: Complexes, frequency: Array, scale: Array, at: Values) -> Complexes:
        """True harmonics of the drive's acceleration from those shown; (p, 6), Hz (p, 6), (m/s)/V (p,)."""
        return along

    def turned(self, angle: Array, at: Values) -> tuple[Array, Array, Array]:
        """Angle that the encoder shows too much, rad, and its first two derivatives by the angle; all (n,)."""
        nothing = np.zeros_like(angle)
        return nothing, nothing, nothing

    # hooks: motion and transducer
    def motion(self, motion: Motion, at: Values) -> Motion:
        """The motion of the case with this effect."""
        return motion

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        """What arrives along each sensitive axis, SI, (c, *G)."""
        return felt

    def transduce(self, u: Array, motion: Motion, at: Values) -> Array:
        """The static characteristic, SI in, SI out, (c, *G)."""
        return u

    # hooks: dynamics and output
    def response(self, frequency: Array, at: Values) -> Complexes:
        """Complex factor beside the output filter, shape of `frequency` (Hz)."""
        return np.ones(frequency.shape, np.complex128)

    def leaks(self, at: Values) -> float:
        """Corner of a first-order high-pass by which slow signals leak away, Hz; its memory may outlast a record."""
        return 0.0

    def output(
        self, signal: NDArray[np.inexact], zero: Array, motion: Motion, channels: Channels, at: Values
    ) -> tuple[NDArray[np.inexact], Array]:
        """Signal about the zero (c, *observed) and zero (c, R), V."""
        return signal, zero

    # hooks: electronics and sampling
    def added(self, motion: Motion, channels: Channels, at: Values) -> Array | None:
        """Volts added to each channel, (c, *G); None for none."""
        return None

    def late(self, slots: NDArray[np.intp], at: Values) -> Array:
        """How much later than read back each slot of the scan is converted, s, (c,)."""
        return np.zeros(len(slots))

    def at_mains(self, order: int, elapsed: Array, at: Values) -> Complexes | None:
        """Volts at a multiple of the mains frequency, as phasors at each record's start (r,), s; None for none."""
        return None

    def mixed(self, volts: NDArray[np.inexact], before: NDArray[np.inexact], at: Values) -> NDArray[np.inexact]:
        """What the converter makes of volts after those of the slot before."""
        return volts

    # hooks: noise
    def density(self, frequency: Array, rate: float, channels: Channels, at: Values) -> Array:
        """One-sided density added to what is recorded of each channel `rate` times a second, V²/Hz, (c, *f), at
        `frequency` Hz (*f,).
        """
        return np.zeros((len(channels.names), *frequency.shape))

    def tone(self, rate: float, channels: Channels, at: Values) -> tuple[Array, float] | None:
        """Amplitude (V, (c,)) and frequency (Hz) of a line in what is recorded of each channel; None for none."""
        return None

    @property
    def spectral(self) -> bool:
        """Whether it shows in spectra of records at rest, and in nothing else that is fitted."""
        return _has(self, "density") or _has(self, "tone")


@dataclass(frozen=True)
class Term:
    """An effect at work: on which channels, and its coordinates. `prior` (standard deviations) makes it a nuisance.

    `only`: names of the channels of its quantity that alone have it; () for all of them.
    """

    effect: Effect
    on: Quantity | None
    at: Values
    prior: Values = field(default_factory=dict)
    only: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Name within a model."""
        if self.only:
            return f"{self.effect.name} ({', '.join(self.only)})"
        return f"{self.effect.name} ({self.on})" if len(self.effect.quantities) > 1 else self.effect.name

    @property
    def where(self) -> str:
        """The channels that have it in words, "" where the effect says it."""
        return ", ".join(self.only) or self.on or ""

    def among(self, channels: Channels) -> NDArray[np.intp]:
        """Indices of the channels that have it."""
        here = channels.of(self.on)
        return here if not self.only else np.array([c for c in here if channels.names[c] in self.only], np.intp)

    @property
    def nought(self) -> bool:
        """Whether it does nothing, as all its sizes are nought."""
        sizes = [self.at[c.name] for c in self.effect.coordinates if not (c.shape or c.searched)]
        return bool(sizes) and not any(sizes)

    def moved(self, **at: float) -> Term:
        """The same at other coordinates."""
        return replace(self, at={**self.at, **at})


def at_work(terms: Sequence[Term], place: str, part: str) -> list[Term]:
    """Terms that act in a part: at its place, and on its own reference."""
    return [t for t in terms if t.effect.shows(place) and (not t.effect.parts or part in t.effect.parts)]


class Memory:
    """What arrives at the outputs of a part's channels, by what decides it: models that are tried one after the other
    mostly differ in something else.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple[object, ...], tuple[Motion, Motion, NDArray[np.inexact]]] = {}

    def of(
        self, key: tuple[object, ...], shown: Motion, make: Callable[[], tuple[Motion, NDArray[np.inexact]]]
    ) -> tuple[Motion, NDArray[np.inexact]]:
        """The motion of the case that is `shown`, and a signal: as kept, or made and kept."""
        key = (*key, id(shown))  # which is kept too, so that no other gets its number
        if key not in self._kept:
            if len(self._kept) >= REMEMBERED:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = (shown, *make())
        return self._kept[key][1:]


def volts(
    motion: Motion, channels: Channels, local: Local, terms: Sequence[Term],
    before: NDArray[np.inexact] | None = None, memory: Memory | None = None,
) -> NDArray[np.inexact]:  # fmt: skip
    """Output of every channel: harmonics (c, p, 6), complex, or instants (c, n); V.

    `motion` is true already as far as the reference goes (see `shaken` and `turned`), and the terms act at its place.
    `before` holds the observed volts of the slot before each channel, for what the multiplexer leaves.
    """
    motion, signal = _arriving(motion, channels, local, terms, Memory() if memory is None else memory)
    signal = signal * _tall(local.sensitivity, signal.ndim)
    zero = np.repeat(local.zero[:, None], motion.temperature.shape[-1], axis=1)
    own = replace(channels, sensitivity=local.sensitivity)
    for term in terms:
        here = term.among(channels)
        signal[here], zero[here] = term.effect.output(signal[here], zero[here], motion, own.only(here), term.at)
    total = _with_zero(signal, zero)
    for term in terms:
        here = term.among(channels)
        more = term.effect.added(motion, own.only(here), term.at)
        if more is not None:
            total[here] = total[here] + motion.grid.plain(more)
    return _sampled(total, motion.grid, channels, terms, before)


def _arriving(
    shown: Motion, channels: Channels, local: Local, terms: Sequence[Term], memory: Memory
) -> tuple[Motion, NDArray[np.inexact]]:
    """The motion of the case, and what arrives behind every channel's filters, SI."""
    shaping, filtering = (
        tuple((t.effect, t.on, t.only, *t.at.values()) for t in terms if any(_has(t.effect, hook) for hook in hooks))
        for hooks in (("motion", "felt", "transduce"), ("response", "leaks"))
    )

    def taken() -> tuple[Motion, NDArray[np.inexact]]:
        moved = shown
        for term in terms:
            moved = term.effect.motion(moved, term.at)
        return moved, moved.grid.taken(_transduced(moved, channels, terms))

    def passed() -> tuple[Motion, NDArray[np.inexact]]:
        moved, signal = memory.of((channels.names, shaping), shown, taken)
        signal = moved.grid.passed(signal, _response(channels, local, terms, moved.grid))
        for term in terms:
            here, corner = term.among(channels), term.effect.leaks(term.at)
            if corner and len(here):
                signal[here] = moved.grid.leaked(signal[here], corner)
        return moved, signal

    return memory.of((channels.names, shaping, filtering, local.pole.tobytes()), shown, passed)


def _transduced(motion: Motion, channels: Channels, terms: Sequence[Term]) -> Array:
    felt = motion.force[channels.axis]
    felt[channels.rates] = motion.rate[channels.axis[channels.rates]]
    for hook in ("felt", "transduce"):
        for term in terms:
            here = term.among(channels)
            if hook == "felt" and _has(term.effect, "felt"):
                felt[here] = term.effect.felt(felt[here], motion, channels.only(here), term.at)
            elif hook == "transduce" and _has(term.effect, "transduce"):
                felt[here] = term.effect.transduce(felt[here], motion, term.at)
    return np.asarray(felt)


def _has(effect: Effect, hook: str) -> bool:
    return getattr(type(effect), hook) is not getattr(Effect, hook)


class _response:  # noqa: N801 - a function with something in its pocket
    """Responses of all channels, (c, *f)."""

    def __init__(self, channels: Channels, local: Local, terms: Sequence[Term], grid: Grid) -> None:
        self._channels, self._local = channels, local
        self._terms = [term for term in terms if _has(term.effect, "response")]

    def __call__(self, frequency: Array) -> Complexes:
        pole = _tall(self._local.pole, frequency.ndim + 1)
        found = np.asarray(1.0 / (1.0 + 1j * frequency / pole), np.complex128)
        for term in self._terms:
            found[term.among(self._channels)] *= term.effect.response(frequency, term.at)
        return found


def _tall(values: NDArray[Any], ndim: int) -> NDArray[Any]:
    """Values per channel in a shape that multiplies (c, …)."""
    return values.reshape(len(values), *(1,) * (ndim - 1))


def _with_zero(signal: NDArray[np.inexact], zero: Array) -> NDArray[np.inexact]:
    if signal.ndim == 2:
        return signal + zero
    signal[..., 0] += zero
    return signal


def _sampled(
    total: NDArray[np.inexact],
    grid: Grid,
    channels: Channels,
    terms: Sequence[Term],
    before: NDArray[np.inexact] | None,
) -> NDArray[np.inexact]:
    for term in terms:
        if _has(term.effect, "late") and isinstance(grid, Periods):
            late = term.effect.late(channels.slot, term.at)
            total = total * np.exp(2j * math.pi * grid.harmonics * late[:, None, None])
        if before is not None and _has(term.effect, "mixed"):
            total = term.effect.mixed(total, before, term.at)
    return total
