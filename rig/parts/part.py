"""What a model is compared with: the protocol of a part, and parts whose rows are a table.

A table says itself what its rows stand for. The rig's own sweeps and turntable runs have their own ways into comparison
and diagnosis; every other kind of record is one of these. Rows are ordered name after name (mostly channels), `width`
of each.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from rig.model import Channels, Local, Quantity, Term
from rig.motion import Array, Motion

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
STEP = 1e-4  # relative, of sensitivities and poles; V, of zeros


class Part(Protocol):
    """One experiment as rows of standard deviations."""

    name: str
    place: str
    channels: Channels
    instruments: frozenset[str]
    logged: frozenset[str]  # signals beside the motion that the records hold: temperature, supply, source
    target: Array  # (rows,)
    extra: Array  # (rows, k): nuisances with a prior of one standard deviation each

    @property
    def rows(self) -> int: ...
    @property
    def held_out(self) -> NDArray[np.bool_]: ...
    @property
    def counted(self) -> NDArray[np.bool_]: ...
    @property
    def reference(self) -> Motion: ...
    def raw(self, local: Local, terms: Sequence[Term], only: Indices | None = None) -> NDArray[np.inexact]: ...
    def whitened(self, raw: NDArray[np.inexact]) -> Array: ...
    def each_channel(self, raw: NDArray[np.inexact]) -> Array: ...
    def blocks(self) -> list[tuple[slice, Indices]]: ...


@runtime_checkable
class Joint(Protocol):
    """A part whose rows belong to several channels at once: it works out the columns of their own parameters itself."""

    def own_columns(self, local: Local, terms: Sequence[Term], raw: NDArray[np.inexact]) -> list[Array]:
        """Derivatives of the rows by relative gain, log pole and zero output of every channel, three of (rows, c)."""
        ...


@dataclass(frozen=True)
class Cut:
    """Rows of one channel's table under one condition: `kind` as level or time, `words` as a person says it."""

    kind: str
    words: str
    mask: Mask


class Tabled(ABC):
    """See `Part` for the members that every part has."""

    place: str
    name: str
    run: str
    channels: Channels
    target: Array  # (rows,)
    extra: Array  # (rows, k)
    instruments: frozenset[str] = frozenset()  # kinds of reference with effects of their own
    logged: frozenset[str] = frozenset()  # signals beside the motion that its records hold
    row_names: tuple[str, ...]  # names of the table's rows; its channels unless rows belong to several
    row_rates: NDArray[np.bool_]  # (names,): whether a row is of a rate
    width: int
    notes: tuple[str, ...] = ()  # what is to be said of the records
    blind: tuple[str, ...] = ()  # what this part cannot see, a sentence each

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

    @abstractmethod
    def raw(self, local: Local, terms: Sequence[Term], only: NDArray[np.intp] | None = None) -> NDArray[np.inexact]:
        """Predicted outputs of every channel (or of some)."""

    @abstractmethod
    def whitened(self, raw: NDArray[np.inexact]) -> Array:
        """Outputs in standard deviations, (rows,)."""

    def each_channel(self, raw: NDArray[np.inexact]) -> Array:
        """Whitened changes that are every channel's own: (rows,) if each moves its own rows only, else (rows, c)."""
        return self.whitened(raw)

    def blocks(self) -> list[tuple[slice, NDArray[np.intp]]]:
        """Rows and the channels whose own parameters move them."""
        width = self.width
        return [(slice(c * width, (c + 1) * width), np.array([c])) for c in range(len(self.row_names))]

    @abstractmethod
    def domains(self) -> Mapping[str, Mask]:
        """Kinds of row by name, each (width,); together they are all rows of a name."""

    @abstractmethod
    def cuts(self) -> Sequence[Cut]:
        """Conditions by which what is left over is looked at."""

    @abstractmethod
    def noise(self) -> Array:
        """Variance of the noise of every number compared, referred to the input, SI², (names, width)."""

    def numbers(self) -> Array:
        """How many numbers the squares of a name's rows add up over, for its rms error, (names,)."""
        return np.asarray(self.counted.reshape(len(self.row_names), -1).sum(axis=1), np.float64)

    @property
    def allowance(self) -> float:
        """Relative uncertainty of the variances that the rows are weighed with."""
        return 0.06

    def allowance_of(self, name: str, mask: Mask) -> float:
        """The same for some rows of a name, mask (width,)."""
        return self.allowance

    def unevenness(self, change: Array, left: Array) -> float:
        """How many times more the χ² that one effect removes scatters by chance, because noise is not the same
        throughout. `change` (rows,) is what the effect moves, `left` (rows,) what is left over without it.
        """
        return 1.0

    def errors(self, left: Array) -> Array:
        """Sum of squares of what is left over in every name's rows, referred to the input, SI², (names,)."""
        squares = np.where(self.counted, left, 0.0).reshape(len(self.row_names), -1) ** 2
        return np.asarray(np.sum(squares * self.noise(), axis=1))

    def shapes(self, component: str) -> Mapping[str, Array]:
        """Laws that an error of this kind of row may follow, in words, SI: (width,) or (names, width)."""
        return {}

    def title(self, name: str) -> str:
        """What a row is called in a comparison; rows of equal titles make one group."""
        quantity: Quantity = "rate" if self.row_rates[self.row_names.index(name)] else "acceleration"
        return "gyros" if quantity == "rate" else "accelerometers"

    def remarks(self, left: Array, local: Local, terms: Sequence[Term]) -> tuple[str, ...]:
        """What only this kind of record can tell of a fitted model, a sentence each; `left` its rows (rows,)."""
        return ()
