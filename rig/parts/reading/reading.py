"""What a reader makes of runs: parts of a fit, and what is known of their references within an uncertainty."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from rig.model import Term
from rig.parts.part import Part


@dataclass(frozen=True)
class Reading:
    """Parts, and nuisances with their priors."""

    parts: tuple[Part, ...] = ()
    known: tuple[Term, ...] = ()

    @classmethod
    def joined(cls, some: Iterable[Reading]) -> Reading:
        """Several as one."""
        whole = list(some)
        return cls(tuple(p for one in whole for p in one.parts), tuple(t for one in whole for t in one.known))
