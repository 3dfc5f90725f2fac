"""A fitted model turned round: volts in, acceleration and rate out, and what was not undone in words.

    every channel for itself (`rig.correction.chain`), then all of them together (`rig.correction.coupling`)

What comes out is specific force (m/s²) or rate (rad/s) along each channel's axis of the case.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from rig.correction import remarks
from rig.correction.chain import Chain, Channel, Undone, chains_of
from rig.correction.coupling import Coupling
from rig.correction.inverse import Array
from rig.errors import BadInput

CONVERTER = (-10.0, 10.0)  # V, range of the rig's own converter
CODES = 65535.0


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

    @cached_property
    def chains(self) -> tuple[Chain, ...]:
        """Every channel for itself."""
        return tuple(chains_of(self.channels, self.undone))

    @cached_property
    def coupling(self) -> Coupling:
        """All of them together."""
        return Coupling(self.channels, self.undone)

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
        u = {chain.channel.name: chain.uncertainty(value) for chain, value in zip(here.chains, found, strict=True)}
        return Corrected(values, (*here.said(), *here.said_of(rate, tuple(conditions))), u)

    def _by_name(self, volts: Array) -> dict[str, Array]:
        if volts.ndim < 1 or len(volts) != len(self.channels):
            raise BadInput(f"raw: found the shape {volts.shape}, wanted {len(self.channels)} channels first")
        return dict(zip(self.names, volts, strict=True))

    def _corrected(self, volts: Array, rate: float | None, conditions: Mapping[str, Array]) -> Array:
        felt = [chain.felt(one, rate, conditions) for chain, one in zip(self.chains, volts, strict=True)]
        return self.coupling.apart(np.stack(felt), rate, conditions)

    def chain(self, name: str) -> Chain:
        """One channel for itself, by its name."""
        return self.chains[self.names.index(name)]

    def said(self) -> tuple[str, ...]:
        """What is not undone whatever is given, and where what is undone ends; a sentence each."""
        return tuple(dict.fromkeys(remarks.always(self.coupling)))

    def said_of(self, rate: float | None, conditions: Sequence[str]) -> tuple[str, ...]:
        """What is not undone because it was not given, and how far filters are."""
        chains, coupling = self.chains, self.coupling
        return (*remarks.of_rate(chains, coupling, rate), *remarks.of_conditions(chains, coupling, conditions))


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
