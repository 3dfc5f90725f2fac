"""Dimensions of physical quantities, as far as formulas of effects need them: powers of m, s, rad, K and V.

Radians are kept for the reader's sake, but count as dimensionless where two dimensions are compared. A dimension may
hold unknowns, the dimensions of coefficients that nobody has stated: comparing two dimensions then solves for them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from types import MappingProxyType

BASE = ("m", "s", "rad", "K", "V")
LARGEST_POWER = 9  # of a unit in a text
_NAMED: Mapping[str, Mapping[str, int]] = MappingProxyType(
    {**{name: {name: 1} for name in BASE}, "Hz": {"s": -1}, "°C": {"K": 1}, "1": {}}
)
_RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_LOWERED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


@dataclass(frozen=True)
class Dimension:
    """Powers by name: of base units, and of unknowns, whose names begin with '?'. Powers are never zero."""

    powers: Mapping[str, Fraction] = field(default_factory=dict)

    def __mul__(self, other: Dimension) -> Dimension:
        found = dict(self.powers)
        for name, power in other.powers.items():
            found[name] = found.get(name, Fraction(0)) + power
        return Dimension({name: power for name, power in found.items() if power})

    def __pow__(self, power: Fraction) -> Dimension:
        return Dimension({name: one * power for name, one in self.powers.items() if power})

    def __truediv__(self, other: Dimension) -> Dimension:
        return self * other ** Fraction(-1)

    @property
    def unknowns(self) -> list[str]:
        """Names of unknowns in it."""
        return [name for name in self.powers if name.startswith("?")]

    @property
    def bare(self) -> bool:
        """Whether it is dimensionless; radians do not count."""
        return not set(self.powers) - {"rad"}

    def known(self, solved: Mapping[str, Dimension]) -> Dimension:
        """The same with what is known put in."""
        found = self
        while waiting := [name for name in found.unknowns if name in solved]:
            power = found.powers[waiting[0]]
            rest = Dimension({name: one for name, one in found.powers.items() if name != waiting[0]})
            found = rest * solved[waiting[0]] ** power
        return found

    def __str__(self) -> str:
        """As a technician writes it: 'm/s²', 's/rad', '1/K'; unknowns are left out."""
        above = [_power(name, self.powers[name]) for name in BASE if self.powers.get(name, 0) > 0]
        below = [_power(name, -self.powers[name]) for name in BASE if self.powers.get(name, 0) < 0]
        if not below:
            return "·".join(above) or "1"
        under = below[0] if len(below) == 1 else f"({'·'.join(below)})"
        return f"{'·'.join(above) or '1'}/{under}"


def unknown(name: str) -> Dimension:
    """The dimension of a coefficient that is still to be found."""
    return Dimension({f"?{name}": Fraction(1)})


def solve(one: Dimension, other: Dimension, solved: dict[str, Dimension]) -> bool:
    """Make two dimensions equal by adding to what is solved; False if they cannot be."""
    left = (one / other).known(solved)
    if not left.unknowns:
        return left.bare
    name = left.unknowns[0]
    rest = Dimension({key: power for key, power in left.powers.items() if key != name})
    solved[name] = rest ** (Fraction(-1) / left.powers[name])
    return True


def dimension_of(text: str) -> Dimension | None:
    """The dimension of a unit such as 'm/s²', 's/rad', '1/(m·s)' or 'V^2'; None if it is none."""
    above, slash, below = text.strip().partition("/")
    over, under = _product(above), _product(below.strip().removeprefix("(").removesuffix(")")) if slash else Dimension()
    return None if over is None or under is None else over / under


def _product(text: str) -> Dimension | None:
    found = Dimension()
    for part in re.split(r"[·*]", text):
        match = re.fullmatch(r"\s*(1|°C|[A-Za-z]+)\^?([-⁻]?[0-9⁰¹²³⁴⁵⁶⁷⁸⁹])?\s*", part)
        if match is None or match[1] not in _NAMED:
            return None
        power = Fraction(int((match[2] or "1").translate(_RAISED)))
        found = found * Dimension({n: Fraction(p) for n, p in _NAMED[match[1]].items()}) ** power
    return found


def _power(name: str, power: Fraction) -> str:
    if power == 1:
        return name
    return f"{name}{str(power).translate(_LOWERED)}" if power.denominator == 1 else f"{name}^({power})"
