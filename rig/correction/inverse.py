"""How one effect is undone: a few kinds of inverse, each plain numbers, so that a notebook, a module without
dependencies and a header in C can carry out the same.

    raw V → zero and sensitivity (`Drift`) → filters and delays (`Filtered`, `Late`)
          → characteristics (`Bend`) → what is felt besides (`Shares`, `Added`) → SI

An effect says of which kind it is (`Effect.inverse`), or that there is `Nothing` to undo in the unit because it belongs
to the bench, or that what it does is `Lost`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Quantity = Literal["acceleration", "rate"]
Condition = Literal["", "temperature", "supply", "time"]
Expression = float | str | tuple[Any, ...]  # see `rig.correction.expression`
AXES = "xyz"
SI: Mapping[str, str] = {"acceleration": "m/s²", "rate": "rad/s"}
UNITS = {"temperature": "°C", "supply": "V", "time": "s"}

MOST = 80  # steps of an iteration: halving alone would do in these


def _nothing() -> Array:
    return np.zeros((3, 3))


@dataclass(frozen=True)
class Drift:
    """Output that follows a condition: signal·(1 + gain·φ), zero·(1 + zero·φ) + S·shift·φ.

    φ is the condition's value less `reference`, or with a `decay` (s) exp(−value/decay); 1 without a condition.
    `shift` in SI per unit of φ.
    """

    of: Condition
    reference: float = 0.0
    gain: float = 0.0
    zero: float = 0.0
    shift: float = 0.0
    decay: float = 0.0

    @property
    def usual(self) -> float:
        """The value that stands for one that nobody gave: there the output is the nominal one."""
        return math.inf if self.decay else self.reference

    def phi(self, value: Array | float) -> Array | float:
        """φ at a value of the condition."""
        if not self.of:
            return 1.0
        return np.exp(-np.asarray(value) / self.decay) if self.decay else value - self.reference


@dataclass(frozen=True)
class Filtered:
    """A linear system: its complex response at frequencies in Hz."""

    response: Callable[[Array], Complexes]


@dataclass(frozen=True)
class Late:
    """Conversion that is later than stated by so many seconds for each slot of the scan."""

    per_slot: float


@dataclass(frozen=True)
class Bend:
    """A characteristic: v = shift + (1 + relative)·u + quadratic·u² + cubic·u³ + ratio·|u| + odd_quadratic·u·|u|."""

    shift: float = 0.0
    relative: float = 0.0
    quadratic: float = 0.0
    cubic: float = 0.0
    ratio: float = 0.0
    odd_quadratic: float = 0.0

    @property
    def halves(self) -> tuple[Half, Half]:
        """Of inputs above zero, and, with both signs turned, of those below."""
        return (
            Half(1.0 + self.relative + self.ratio, self.quadratic + self.odd_quadratic, self.cubic),
            Half(1.0 + self.relative - self.ratio, self.odd_quadratic - self.quadratic, self.cubic),
        )

    @property
    def range(self) -> tuple[float, float]:
        """Inputs between which the output only rises, SI: only there it tells the input."""
        above, below = self.halves
        return -below.top, above.top

    def bent(self, u: Array) -> Array:
        """The output of inputs."""
        size = np.abs(u)
        odd = self.cubic * u**3 + self.odd_quadratic * u * size
        return np.asarray(self.shift + (1.0 + self.relative) * u + self.quadratic * u**2 + self.ratio * size + odd)

    def straight(self, v: Array) -> Array:
        """The inputs of outputs; NaN for one that no input of the range makes."""
        w = v - self.shift
        above, below = self.halves
        return np.where(w >= 0.0, above.root(np.maximum(w, 0.0)), -below.root(np.maximum(-w, 0.0)))


@dataclass(frozen=True)
class Half:
    """w = first·x + second·x² + third·x³ for x ≥ 0."""

    first: float
    second: float
    third: float

    @property
    def top(self) -> float:
        """Where it stops rising; infinite if it never does, zero if it does not begin to."""
        if self.first <= 0.0:
            return 0.0
        a, b, c = 3.0 * self.third, 2.0 * self.second, self.first
        if a >= 0.0 and b >= 0.0:
            return math.inf
        size = max(abs(b), math.sqrt(abs(a)) * math.sqrt(c))  # squares of small numbers would vanish
        under = (b / size) ** 2 - 4.0 * (a / size) * (c / size)
        if under < 0.0:
            return math.inf
        return 2.0 * c / (size * math.sqrt(under) - b)  # of like numbers no difference

    @property
    def least(self) -> float:
        """Its least slope where it rises without end."""
        bend = -self.second / (3.0 * self.third) if self.third > 0.0 else 0.0
        return self.first - self.second**2 / (3.0 * self.third) if bend > 0.0 else self.first

    def at(self, x: Array) -> Array:
        """Its value."""
        return np.asarray(x * (self.first + x * (self.second + x * self.third)))

    def root(self, w: Array) -> Array:
        """x of every w ≥ 0 by Newton's rule kept between bounds that close in; NaN beyond `top`."""
        top = self.top
        if top == 0.0:
            return np.full(w.shape, math.nan)
        low = np.zeros_like(w)
        high = np.full_like(w, top) if math.isfinite(top) else w / self.least
        x = np.minimum(w / self.first, high)
        for _ in range(MOST):
            off = self.at(x) - w
            low, high = np.where(off <= 0.0, x, low), np.where(off >= 0.0, x, high)
            slope = self.first + x * (2.0 * self.second + 3.0 * x * self.third)
            with np.errstate(all="ignore"):
                following = x - off / slope
            inside = (following >= low) & (following <= high)
            following = np.where(inside, following, 0.5 * (low + high))
            still = np.abs(following - x) <= np.finfo(float).eps * np.abs(following)
            x = following
            if still.all():
                break
        beyond = w > self.at(np.asarray(top)) if math.isfinite(top) else ~np.isfinite(w)
        return np.where(beyond | np.isnan(w), math.nan, x)


NEXT = np.roll(np.eye(3), 1, axis=1)  # row i: the axis after i


@dataclass(frozen=True)
class Shares:
    """What a channel along axis i feels besides its own input, row i, summed:

    own_ij·m_j + own_rise_ij·dm_j/dt + force_ij·f_j + rate_ij·ω_j + turning_ij·dω_j/dt + ωᵀ·spin_i·ω,
    m the channel's own quantity, f specific force m/s², ω rad/s.
    """

    own: Array = field(default_factory=_nothing)
    own_rise: Array = field(default_factory=_nothing)
    force: Array = field(default_factory=_nothing)
    rate: Array = field(default_factory=_nothing)
    turning: Array = field(default_factory=_nothing)
    spin: Array = field(default_factory=lambda: np.zeros((3, 3, 3)))

    def straight(self, own: Quantity) -> Iterator[tuple[Quantity, Array]]:
        """What is felt of a quantity itself, by channels of a quantity of their own."""
        yield from ((own, self.own), ("acceleration", self.force), ("rate", self.rate))

    def rises(self, own: Quantity) -> Iterator[tuple[Quantity, Array]]:
        """What is felt of its change."""
        yield from ((own, self.own_rise), ("rate", self.turning))


def arms(own: Array) -> Shares:
    """α×r + ω×(ω×r) where the channel along axis i sits at r = own[i], m, (3, 3)."""
    turning, spin = np.zeros((3, 3)), np.zeros((3, 3, 3))
    for i, r in enumerate(own):
        turning[i] = np.cross(r, np.eye(3)[i])  # (α×r)·e = α·(r×e)
        both = np.outer(np.eye(3)[i], r)
        spin[i] = 0.5 * (both + both.T) - r[i] * np.eye(3)
    return Shares(turning=turning, spin=spin)


@dataclass(frozen=True)
class Added:
    """What every channel feels more, SI, as arithmetic of what it and its neighbours went through, taken off in rounds.

    Signals: `u` its own input; `x` `y` `z` specific force along and `wx` `wy` `wz` rate about the axes, m/s² and
    rad/s; `T` °C, `Vs` V, `t` s. It must be small beside the input: a change of u changes it by less.
    """

    expression: Expression


@dataclass(frozen=True)
class Nothing:
    """Nothing to undo in the unit, and why: it belongs to the bench, or to chance."""

    why: str


@dataclass(frozen=True)
class Lost:
    """It cannot be undone, and why."""

    why: str


Inverse = Drift | Filtered | Late | Bend | Shares | Added | Nothing | Lost
