"""What channels feel of each other, and how it is taken apart.

    A·m = u − δ(m)   for all channels together: A what is felt of other axes, δ what is felt of turning and by formulas

What a channel feels of another axis is taken from its own triad where that has one along it, else from the channel of
the same quantity that has.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rig.correction import expression
from rig.correction.chain import Channel, Undone
from rig.correction.inverse import Added, Array, Condition, Expression, Quantity, Shares
from rig.errors import BadInput

PASSES = 6  # of what is felt of turning, which depends on the rates that it is taken off
ROUNDS = 40  # of what is felt by formulas: one that changes by half of a change of its input has then settled
SIGNALS: Mapping[str, tuple[Quantity, int]] = {
    "x": ("acceleration", 0), "y": ("acceleration", 1), "z": ("acceleration", 2),
    "wx": ("rate", 0), "wy": ("rate", 1), "wz": ("rate", 2),
}  # fmt: skip
UNSETTLED = 1e-3  # of a value and in SI: what still moves by more in the last round has no answer
CONDITIONS: Mapping[str, Condition] = {"T": "temperature", "Vs": "supply", "t": "time"}


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
class Coupling:
    """Channels together, c of them, and the effects of their model."""

    channels: tuple[Channel, ...]
    undone: tuple[Undone, ...]

    def apart(self, seen: Array, rate: float | None, conditions: Mapping[str, Array]) -> Array:
        """What each axis went through, of what each channel felt, (c, …); NaN where the rounds do not settle."""
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

    def _apart(self, felt: Array) -> Array:
        """A⁻¹·felt, without the zeros: what one channel cannot tell (NaN) is not spread over the others."""
        found = np.zeros_like(felt)
        for row, column in np.argwhere(self.inverse).tolist():
            found[row] += self.inverse[row, column] * felt[column]
        return found

    def _turning(self, found: Array, rate: float | None) -> Array:
        """What is felt of turning and of changes, (c, …)."""
        more = np.zeros_like(found)
        for one in self.felt:
            if one.second is not None:
                more[one.channel] += one.share * found[one.first] * found[one.second]
            elif rate is not None and found.shape[-1] > 1:
                more[one.channel] += one.share * np.gradient(found[one.first], 1.0 / rate, axis=-1)
        return more

    def _more(self, found: Array, conditions: Mapping[str, Array]) -> Array:
        """What is felt by formulas, (c, …)."""
        more = np.zeros_like(found)
        for one in self.written:
            if all(of in conditions for of in one.conditions):
                signals = {name: found[source] for name, source in one.sources.items()}
                signals |= {name: conditions[of] for name, of in CONDITIONS.items() if of in conditions}
                more[one.channel] += expression.value(one.expression, signals)
        return more

    def source(self, c: int, quantity: Quantity, axis: int) -> int | None:
        """The channel that tells force or rate along an axis to channel c: itself, one of its triad, or the first."""
        there = [k for k, one in enumerate(self.channels) if (one.quantity, one.axis) == (quantity, axis)]
        if c in there:
            return c
        own = [k for k in there if self.channels[k].triad == self.channels[c].triad]
        return next(iter([*own, *there]), None)

    def stands_for(self, c: int, name: str) -> int | None:
        """The channel that a signal of channel c's formula stands for."""
        return c if name == "u" else self.source(c, *SIGNALS[name])

    def shares(self) -> Iterator[tuple[int, int, Shares, str]]:
        """Channel, its axis, what it feels of others, and the effect's name; of channels whose axis is known."""
        for one in self.undone:
            for c, channel in enumerate(self.channels):
                if isinstance(one.inverse, Shares) and one.of(channel) and channel.axis is not None:
                    yield c, channel.axis, one.inverse, one.name

    def added(self) -> Iterator[tuple[int, Expression, str]]:
        """Channel, what it feels more by a formula, and the effect's name."""
        for one in self.undone:
            for c, channel in enumerate(self.channels):
                if isinstance(one.inverse, Added) and one.of(channel):
                    yield c, one.inverse.expression, one.name

    @cached_property
    def straight(self) -> Array:
        """A: what every channel feels of all, (c, c)."""
        found = np.eye(len(self.channels))
        for c, axis, shares, _ in self.shares():
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
        return tuple(one for c, axis, shares, _ in self.shares() for one in self._felt(c, axis, shares))

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
        for c, tree, _ in self.added():
            sources = {name: self.stands_for(c, name) for name in expression.names(tree) if name not in CONDITIONS}
            known = {name: source for name, source in sources.items() if source is not None}
            if len(known) == len(sources):
                found.append(Written(c, tree, known))
        return tuple(found)
