"""One channel: the steps from its volts back to what it felt, each as the model has it.

    felt = characteristics⁻¹(filters⁻¹((V − zero)/(S·gain)))

Characteristics are taken off from the last to the first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rig.correction import dynamics
from rig.correction.dynamics import Taps
from rig.correction.inverse import Array, Bend, Complexes, Drift, Filtered, Inverse, Late, Quantity


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
    """An effect of the model: its name, the quantity it acts on (None: all), its inverse, and which channels of that
    alone have it, by name; () for all.
    """

    name: str
    on: Quantity | None
    inverse: Inverse
    only: tuple[str, ...] = ()

    def of(self, channel: Channel) -> bool:
        """Whether it acts on a channel."""
        return self.on in (None, channel.quantity) and (not self.only or channel.name in self.only)


@dataclass(frozen=True)
class Chain:
    """A channel, and the inverses of what acts on it in the order of the model."""

    channel: Channel
    inverses: tuple[Inverse, ...]

    @cached_property
    def drifts(self) -> tuple[Drift, ...]:
        """How its output follows conditions."""
        return tuple(one for one in self.inverses if isinstance(one, Drift))

    @cached_property
    def bends(self) -> tuple[Bend, ...]:
        """Its characteristics."""
        return tuple(one for one in self.inverses if isinstance(one, Bend))

    @property
    def filtered(self) -> bool:
        """Whether anything linear stands between what it feels and the record."""
        return self.channel.pole is not None or any(isinstance(one, Filtered | Late) for one in self.inverses)

    @property
    def response(self) -> Callable[[Array], Complexes]:
        """Everything linear between what it feels and the record."""
        channel, systems = self.channel, [one for one in self.inverses if isinstance(one, Filtered)]
        late = sum(one.per_slot * (channel.slot or 0) for one in self.inverses if isinstance(one, Late))

        def whole(f: Array) -> Complexes:
            found = np.exp(2j * math.pi * f * late)
            if channel.pole is not None:
                found = found / (1.0 + 1j * f / channel.pole)
            for system in systems:
                found = found * system.response(f)
            return np.asarray(found, np.complex128)

        return whole

    @property
    def lag(self) -> float:
        """How late its slow signals are, s."""
        return dynamics.lag(self.response)

    def taps(self, rate: float) -> Taps:
        """The sum that undoes what is linear in it."""
        if rate not in self._taps:
            self._taps[rate] = dynamics.taps(self.response, rate)
        return self._taps[rate]

    @cached_property
    def _taps(self) -> dict[float, Taps]:
        return {}

    def felt(self, volts: Array, rate: float | None, conditions: Mapping[str, Array]) -> Array:
        """What it felt, SI; without a `rate` filters and delays stay in it."""
        found = self._input(volts, conditions)
        if rate is not None and self.filtered:
            found = self.taps(rate)(found)
        for bend in reversed(self.bends):
            found = bend.straight(found)
        return found

    def _input(self, volts: Array, conditions: Mapping[str, Array]) -> Array:
        """What drives the output, SI: less zero, by sensitivity, both as they are under these conditions."""
        channel = self.channel
        zero, gain = np.asarray(channel.zero), np.asarray(1.0)
        for drift in self.drifts:
            phi = drift.phi(conditions.get(drift.of, np.asarray(drift.usual)))
            zero = zero * (1.0 + drift.zero * phi) + channel.sensitivity * drift.shift * phi
            gain = gain * (1.0 + drift.gain * phi)
        return np.asarray((volts - zero) / (channel.sensitivity * gain))

    def uncertainty(self, value: Array) -> Array:
        """Standard uncertainty of a corrected value from those of sensitivity and zero, SI; NaN if neither is known."""
        channel = self.channel
        parts = [
            u * size / abs(channel.sensitivity)
            for u, size in ((channel.u_sensitivity, np.abs(value)), (channel.u_zero, np.ones_like(value)))
            if u is not None
        ]
        whole = np.sqrt(np.sum([part**2 for part in parts], axis=0)) if parts else np.full_like(value, math.nan)
        return np.asarray(whole, np.float64)


def chains_of(channels: Sequence[Channel], undone: Sequence[Undone]) -> Iterator[Chain]:
    """Every channel with what acts on it."""
    return (Chain(channel, tuple(one.inverse for one in undone if one.of(channel))) for channel in channels)
