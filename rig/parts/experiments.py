"""The experiments of the rig's own bench taken together: what runs lack of them, and what could be measured next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rig.parts.noise_spectrum import NoiseSpectrum
from rig.parts.part import Option, Part
from rig.parts.platter import Platter
from rig.parts.sweep import Sweep

OWN: tuple[type[Sweep] | type[Platter], ...] = (Sweep, Platter)


def _of(kind: type[Part], parts: Sequence[Part]) -> list[Any]:
    return [part for part in parts if isinstance(part, kind)]


def lacks(parts: Sequence[Part]) -> Iterator[str]:
    """What runs with these parts cannot show, an experiment that is there before one that is not."""
    groups = [(kind, _of(kind, parts)) for kind in OWN]
    for kind, mine in sorted(groups, key=lambda one: not one[1]):
        yield from kind.lacks(mine)


def absent(parts: Sequence[Part]) -> list[str]:
    """Experiments of the bench that none of these parts is of."""
    return [kind.experiment for kind in OWN if not any(part.within(kind.experiment) for part in parts)]


def unmeasured(parts: Sequence[Part], blind: Sequence[str]) -> list[tuple[str, str]]:
    """What these runs cannot show though this bench can: a sentence, and the command that measures it."""
    kinds: tuple[type[Part], ...] = (*reversed(OWN), NoiseSpectrum)
    return [one for kind in kinds for one in kind.unmeasured(_of(kind, parts), blind)]


def options(parts: Sequence[Part]) -> list[Option]:
    """The measurements that this bench can do, as far as a part of the same kind shows how they would look."""
    return [one for kind in OWN for part in _of(kind, parts)[:1] for one in part.options()]
