"""A fitted model turned round: volts in, acceleration and rate out, and what was not undone in words.

    u_c = filter_c⁻¹((V_c − zero_c)/(S_c·gain_c)), then characteristics from the last to the first,
    then  A·m = u − δ(m)  for all channels together: A what is felt of other axes, δ what is felt of turning.

`m` is specific force (m/s²) or rate (rad/s) along each channel's axis of the case. What a channel feels of another axis
is taken from its own triad where that has one along it, else from the channel of the same quantity that has.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from rig.correction import expression
from rig.correction.dynamics import Taps, lag, taps
from rig.correction.inverse import (
    UNITS,
    Added,
    Array,
    Bend,
    Complexes,
    Condition,
    Drift,
    Expression,
    Filtered,
    Inverse,
    Late,
    Lost,
    Nothing,
    Quantity,
    Shares,
)
from rig.errors import BadInput

SI: Mapping[str, str] = {"acceleration": "m/s²", "rate": "rad/s"}
AXES = "xyz"
PASSES = 6  # of what is felt of turning, which depends on the rates that it is taken off
ROUNDS = 40  # of what is felt by formulas: one that changes by half of a change of its input has then settled
SIGNALS: Mapping[str, tuple[Quantity, int]] = {
    "x": ("acceleration", 0), "y": ("acceleration", 1), "z": ("acceleration", 2),
    "wx": ("rate", 0), "wy": ("rate", 1), "wz": ("rate", 2),
}  # fmt: skip
UNSETTLED = 1e-3  # of a value and in SI: what still moves by more in the last round has no answer
CONDITIONS: Mapping[str, Condition] = {"T": "temperature", "Vs": "supply", "t": "time"}
CONVERTER = (-10.0, 10.0)  # V, range of the rig's own converter
CODES = 65535.0


@dataclass(frozen=True)
class Channel:
    """One channel as fitted: `axis` 0, 1, 2 (None: not known), `slot` of its scan, `sensitivity` V/SI, `zero` V, `pole`
    of its output filter, Hz; `u_` are standard uncertainties, None where they are not known.
    """

    name: str
    quantity: Quantity
    axis: int | None
    triad: str
    sensitivity: float
    zero: float
    pole: float | None = None
    slot: int | None = None
    u_sensitivity: float | None = None
    u_zero: float | None = None


@dataclass(frozen=True)
class Undone:
    """An effect of the model: its name, the channels it acts on (None: all), and its inverse."""

    name: str
    on: Quantity | None
    inverse: Inverse


@dataclass(frozen=True)
class Felt:
    """What `channel` feels of the rise of `first`, per second, or of the product of `first` and `second`."""

    channel: int
    first: int
    second: int | None
    share: float


@dataclass(frozen=True)
class Written:
    """What `channel` feels more as arithmetic; `sources` are the channels that its signals stand for."""

    channel: int
    expression: Expression
    sources: Mapping[str, int]

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """What must be given besides."""
        signals = dict.fromkeys(expression.names(self.expression))
        return tuple(CONDITIONS[name] for name in signals if name in CONDITIONS)


@dataclass(frozen=True)
class Corrected:
    """SI by channel, what was not undone in a sentence each, and standard uncertainties of sensitivity and zero."""

    values: Mapping[str, Array]
    said: tuple[str, ...]
    u: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.values[name]

    @property
    def array(self) -> Array:
        """All channels in their order, (c, …)."""
        return np.stack(list(self.values.values()))


def counts_to_volts(counts: ArrayLike, low: float = CONVERTER[0], high: float = CONVERTER[1]) -> Array:
    """Volts of raw 16-bit offset-binary counts: 0 is `low`, 65535 is `high`."""
    return np.asarray(np.asarray(counts, np.float64) / CODES * (high - low) + low)


@dataclass(frozen=True)
class Correction:
    """A model turned round: its channels, and its effects in their order, each with its inverse."""

    unit: str
    channels: tuple[Channel, ...]
    undone: tuple[Undone, ...] = ()
    simulated: bool = False
    provenance: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the channels."""
        return tuple(channel.name for channel in self.channels)

    def only(self, names: Sequence[str]) -> Correction:
        """Of some channels, in this order. Raises BadInput for one that the model does not have."""
        known = {channel.name: channel for channel in self.channels}
        strange = [name for name in names if name not in known]
        if strange:
            raise BadInput(f"channels: found '{strange[0]}', wanted some of {', '.join(known) or 'none'}")
        return replace(self, channels=tuple(known[name] for name in names))

    def apply(
        self,
        raw: Mapping[str, ArrayLike] | ArrayLike,
        *,
        rate: float | None = None,
        temperature: ArrayLike | None = None,
        supply: ArrayLike | None = None,
        time: ArrayLike | None = None,
    ) -> Corrected:
        """Acceleration and rate from volts: by channel's name, or an array (c, …) in the order of `names`.

        `rate`, samples per second of a record, takes filters, delays and angular acceleration out too. `temperature`
        °C, `supply` V, `time` s since the first record began: one number or one for each sample. Raises BadInput.
        """
        if not isinstance(raw, Mapping):
            return self.apply(self._by_name(np.asarray(raw, np.float64)), rate=rate, temperature=temperature,
                              supply=supply, time=time)  # fmt: skip
        here = self if tuple(raw) == self.names else self.only(tuple(raw))
        given = {"temperature": temperature, "supply": supply, "time": time}
        conditions = {name: np.asarray(value, np.float64) for name, value in given.items() if value is not None}
        volts = _together(raw, conditions)
        if rate is not None and not (math.isfinite(rate) and rate > 0.0 and volts.ndim > 1):
            raise BadInput(f"rate: found {rate} for samples of shape {volts.shape[1:]}, wanted a record and its rate")
        found = here._corrected(volts, rate, conditions)
        values = dict(zip(here.names, found, strict=True))
        u = {name: here.uncertainty(name, value) for name, value in values.items()}
        return Corrected(values, (*here.said(), *here.said_of(rate, tuple(conditions))), u)

    def _by_name(self, volts: Array) -> dict[str, Array]:
        if volts.ndim < 1 or len(volts) != len(self.channels):
            raise BadInput(f"raw: found the shape {volts.shape}, wanted {len(self.channels)} channels first")
        return dict(zip(self.names, volts, strict=True))

    def _corrected(self, volts: Array, rate: float | None, conditions: Mapping[str, Array]) -> Array:
        seen = np.stack([self._input(c, one, conditions) for c, one in enumerate(volts)])
        if rate is not None:
            seen = np.stack([self.taps(c, rate)(one) if self.filtered(c) else one for c, one in enumerate(seen)])
        for c in range(len(seen)):
            for bend in reversed(self.bends(c)):
                seen[c] = bend.straight(seen[c])
        found = self._apart(seen)
        before = found
        for _ in range(self.passes):
            before, found = found, self._apart(seen - self._turning(found, rate) - self._more(found, conditions))
        if not self.written:
            return found
        return np.where(np.abs(found - before) <= UNSETTLED * (1.0 + np.abs(found)), found, math.nan)

    @property
    def passes(self) -> int:
        """How often what depends on the result is taken off."""
        return ROUNDS if self.written else PASSES if self.felt else 0

    def _more(self, found: Array, conditions: Mapping[str, Array]) -> Array:
        """What is felt by formulas, (c, …)."""
        more = np.zeros_like(found)
        for one in self.written:
            if all(of in conditions for of in one.conditions):
                signals = {name: found[source] for name, source in one.sources.items()}
                signals |= {name: conditions[of] for name, of in CONDITIONS.items() if of in conditions}
                more[one.channel] += expression.value(one.expression, signals)
        return more

    def _apart(self, felt: Array) -> Array:
        """A⁻¹·felt, without the zeros: what one channel cannot tell (NaN) is not spread over the others."""
        found = np.zeros_like(felt)
        for row, column in np.argwhere(self.inverse).tolist():
            found[row] += self.inverse[row, column] * felt[column]
        return found

    def _input(self, c: int, volts: Array, conditions: Mapping[str, Array]) -> Array:
        """What drives the output, SI: less zero, by sensitivity, both as they are under these conditions."""
        channel = self.channels[c]
        zero, gain = np.asarray(channel.zero), np.asarray(1.0)
        for drift in self.drifts(c):
            phi = drift.phi(conditions.get(drift.of, np.asarray(drift.usual)))
            zero = zero * (1.0 + drift.zero * phi) + channel.sensitivity * drift.shift * phi
            gain = gain * (1.0 + drift.gain * phi)
        return np.asarray((volts - zero) / (channel.sensitivity * gain))

    def _turning(self, found: Array, rate: float | None) -> Array:
        """What is felt of turning and of changes, (c, …)."""
        more = np.zeros_like(found)
        for one in self.felt:
            if one.second is not None:
                more[one.channel] += one.share * found[one.first] * found[one.second]
            elif rate is not None and found.shape[-1] > 1:
                more[one.channel] += one.share * np.gradient(found[one.first], 1.0 / rate, axis=-1)
        return more

    # what acts on a channel
    def _of(self, c: int) -> Iterator[Inverse]:
        quantity = self.channels[c].quantity
        return (one.inverse for one in self.undone if one.on in (None, quantity))

    def drifts(self, c: int) -> list[Drift]:
        """How its output follows conditions, in the order of the model."""
        return [one for one in self._of(c) if isinstance(one, Drift)]

    def bends(self, c: int) -> list[Bend]:
        """Its characteristics, in the order of the model."""
        return [one for one in self._of(c) if isinstance(one, Bend)]

    def filtered(self, c: int) -> bool:
        """Whether anything linear stands between what it feels and the record."""
        return self.channels[c].pole is not None or any(isinstance(one, Filtered | Late) for one in self._of(c))

    def response(self, c: int) -> Callable[[Array], Complexes]:
        """Everything linear between what it feels and the record."""
        channel, systems = self.channels[c], [one for one in self._of(c) if isinstance(one, Filtered)]
        late = sum(one.per_slot * (channel.slot or 0) for one in self._of(c) if isinstance(one, Late))

        def whole(f: Array) -> Complexes:
            found = np.exp(2j * math.pi * f * late)
            if channel.pole is not None:
                found = found / (1.0 + 1j * f / channel.pole)
            for system in systems:
                found = found * system.response(f)
            return np.asarray(found, np.complex128)

        return whole

    def lag(self, name: str) -> float:
        """How late slow signals of a channel are, s: what to take off the time stamps where no rate is given."""
        return lag(self.response(self.names.index(name)))

    def taps(self, c: int, rate: float) -> Taps:
        """The sum that undoes what is linear in one channel."""
        known = self._taps
        if (c, rate) not in known:
            known[c, rate] = taps(self.response(c), rate)
        return known[c, rate]

    @cached_property
    def _taps(self) -> dict[tuple[int, float], Taps]:
        return {}

    # what channels feel of each other
    def source(self, c: int, quantity: Quantity, axis: int) -> int | None:
        """The channel that tells force or rate along an axis to channel c: itself, one of its triad, or the first."""
        there = [k for k, one in enumerate(self.channels) if (one.quantity, one.axis) == (quantity, axis)]
        if c in there:
            return c
        own = [k for k in there if self.channels[k].triad == self.channels[c].triad]
        return next(iter([*own, *there]), None)

    @cached_property
    def straight(self) -> Array:
        """A: what every channel feels of all, (c, c)."""
        found = np.eye(len(self.channels))
        for c, axis, shares, _ in self._shares():
            for quantity, matrix in shares.straight(self.channels[c].quantity):
                for j in np.flatnonzero(matrix[axis]).tolist():
                    source = self.source(c, quantity, j)
                    if source is not None:
                        found[c, source] += matrix[axis, j]
        return found

    @cached_property
    def inverse(self) -> Array:
        """A⁻¹, (c, c). Raises BadInput if there is none."""
        try:
            return np.asarray(np.linalg.inv(self.straight), np.float64)
        except np.linalg.LinAlgError:
            raise BadInput("model: found axes that cannot be told apart, wanted shares well below 1") from None

    @cached_property
    def felt(self) -> tuple[Felt, ...]:
        """δ: what is felt of changes and of turning."""
        return tuple(one for c, axis, shares, _ in self._shares() for one in self._felt(c, axis, shares))

    def _felt(self, c: int, axis: int, shares: Shares) -> Iterator[Felt]:
        for quantity, matrix in shares.rises(self.channels[c].quantity):
            for j in np.flatnonzero(matrix[axis]).tolist():
                source = self.source(c, quantity, j)
                if source is not None:
                    yield Felt(c, source, None, float(matrix[axis, j]))
        for j, k in np.argwhere(shares.spin[axis]).tolist():
            first, second = self.source(c, "rate", j), self.source(c, "rate", k)
            if first is not None and second is not None:
                yield Felt(c, first, second, float(shares.spin[axis, j, k]))

    @cached_property
    def written(self) -> tuple[Written, ...]:
        """What is felt by formulas, of channels that have all signals."""
        found = []
        for _, c, tree in self._added():
            sources = {name: self._stands_for(c, name) for name in expression.names(tree) if name not in CONDITIONS}
            known = {name: source for name, source in sources.items() if source is not None}
            if len(known) == len(sources):
                found.append(Written(c, tree, known))
        return tuple(found)

    def _added(self) -> Iterator[tuple[str, int, Expression]]:
        for one in self.undone:
            for c, channel in enumerate(self.channels):
                if isinstance(one.inverse, Added) and one.on in (None, channel.quantity):
                    yield one.name, c, one.inverse.expression

    def _stands_for(self, c: int, name: str) -> int | None:
        return c if name == "u" else self.source(c, *SIGNALS[name])

    def _shares(self) -> Iterator[tuple[int, int, Shares, str]]:
        for one in self.undone:
            for c, channel in enumerate(self.channels):
                here = one.on in (None, channel.quantity) and channel.axis is not None
                if here and isinstance(one.inverse, Shares) and channel.axis is not None:
                    yield c, channel.axis, one.inverse, one.name

    # what is to be said
    def uncertainty(self, name: str, value: Array) -> Array:
        """Standard uncertainty of a corrected value from those of sensitivity and zero, SI; NaN if neither is known."""
        channel = self.channels[self.names.index(name)]
        parts = [
            u * size / abs(channel.sensitivity)
            for u, size in ((channel.u_sensitivity, np.abs(value)), (channel.u_zero, np.ones_like(value)))
            if u is not None
        ]
        whole = np.sqrt(np.sum([part**2 for part in parts], axis=0)) if parts else np.full_like(value, math.nan)
        return np.asarray(whole, np.float64)

    def said(self) -> tuple[str, ...]:
        """What is not undone whatever is given, and where what is undone ends; a sentence each."""
        return tuple(dict.fromkeys(self._said()))

    def _said(self) -> Iterator[str]:
        for one in self.undone:
            here = [channel for channel in self.channels if one.on in (None, channel.quantity)]
            match one.inverse:
                case Nothing(why=why):
                    yield f"{one.name}: nothing to undo, {why}"
                case Lost(why=why) if here:
                    yield f"{one.name}: not undone, {why}"
                case Bend() as bend if here:
                    yield from _range(one.name, bend, SI[here[0].quantity])
                case Late() if here:
                    unknown = [channel.name for channel in here if channel.slot is None]
                    if unknown:
                        yield f"{one.name}: not undone for {', '.join(unknown)}, found no slot of the scan in the model"
                case Shares() if here:
                    unknown = [channel.name for channel in here if channel.axis is None]
                    if unknown:
                        yield f"{one.name}: not undone for {', '.join(unknown)}, found no axis in the model"
        for c, axis, shares, name in self._shares():
            missing = list(self._missing(c, axis, shares))
            if missing:
                yield f"{name}: not undone for {self.channels[c].name}, found no channel of {' and '.join(missing)}"
        for name, c, tree in self._added():
            lacking = [one for one in expression.names(tree) if one in SIGNALS and self._stands_for(c, one) is None]
            if lacking:
                yield f"{name}: not undone for {self.channels[c].name}, found no channel that tells {lacking[0]}"
        for channel in self.channels:
            if channel.u_zero is None:
                yield f"{channel.name}: {channel.zero:g} V is taken off as zero output, whose uncertainty is not known"

    def _missing(self, c: int, axis: int, shares: Shares) -> Iterator[str]:
        own = self.channels[c].quantity
        felt = [*shares.straight(own), *shares.rises(own)]
        wanted = {(quantity, j) for quantity, matrix in felt for j in np.flatnonzero(matrix[axis]).tolist()}
        wanted |= {("rate", j) for j in np.flatnonzero(shares.spin[axis].any(axis=0)).tolist()}
        for quantity, j in sorted(wanted):
            if self.source(c, quantity, j) is None:
                yield f"{quantity} along {AXES[j]}"

    def said_of(self, rate: float | None, conditions: Sequence[str]) -> tuple[str, ...]:
        """What is not undone because it was not given, and how far filters are."""
        return (*self._of_rate(rate), *self._of_conditions(conditions))

    def _of_rate(self, rate: float | None) -> Iterator[str]:
        late = {name: self.lag(name) for c, name in enumerate(self.names) if self.filtered(c)}
        if rate is None and late:
            worst = max(late, key=lambda name: abs(late[name]))
            yield f"filters and delays: not undone without a rate; {worst} is {late[worst] * 1e3:.4g} ms late"
        if rate is None and any(one.second is None for one in self.felt):
            yield "angular acceleration and changes of force: what they add is not undone without a rate"
        if rate is not None:
            for words, names in _grouped({c.name: _filter_words(self.taps(k, rate)) for k, c in enumerate(self.channels)
                                          if c.name in late}):  # fmt: skip
                yield f"filters and delays of {', '.join(names)}: {words}"

    def _of_conditions(self, conditions: Sequence[str]) -> Iterator[str]:
        lacking = dict.fromkeys(of for one in self.written for of in one.conditions if of not in conditions)
        yield from (f"{of}: not given, what follows it by a formula is not undone" for of in lacking)
        for of in ("temperature", "supply", "time"):
            usual = {d.usual for c in range(len(self.channels)) for d in self.drifts(c) if d.of == of}
            if usual and of not in conditions:
                at = " or ".join(f"{one:g} {UNITS[of]}" for one in sorted(usual))
                yield f"{of}: not given, {'long after the start' if math.inf in usual else at} assumed"


def _together(raw: Mapping[str, ArrayLike], conditions: Mapping[str, Array]) -> Array:
    """Channels of one shape, (c, …). Raises BadInput if they are not, or conditions do not go with them."""
    arrays = [np.asarray(value, np.float64) for value in raw.values()]
    if not arrays:
        raise BadInput("raw: found no channel, wanted at least one")
    try:
        together = np.broadcast_arrays(*arrays, *conditions.values())[: len(arrays)]
    except ValueError:
        shapes = ", ".join(f"{name} {np.shape(value)}" for name, value in {**raw, **conditions}.items())
        raise BadInput(f"raw: found the shapes {shapes}, wanted one for all") from None
    return np.stack(together)


def _range(name: str, bend: Bend, unit: str) -> Iterator[str]:
    low, high = bend.range
    if math.isfinite(low) or math.isfinite(high):
        yield f"{name}: undone between {low:.4g} and {high:.4g} {unit}, beyond which the output does not tell the input"


def _filter_words(found: Taps) -> str:
    return (
        f"undone up to {found.band:.3g} Hz within {found.error:.1e}, fading out above; white noise × {found.noise:.2f}"
    )


def _grouped(words: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    found: dict[str, list[str]] = {}
    for name, text in words.items():
        found.setdefault(text, []).append(name)
    return list(found.items())
