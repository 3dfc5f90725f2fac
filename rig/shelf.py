"""The shelf of effects: every file in `rig/effects`, and in a user's own folder, that holds one effect.

A file's name is the effect's name. A user's folder is named on the command line or in RIG_EFFECTS, never in a model
file: what a YAML file says cannot make code run that the user has not put there.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType, ModuleType

from rig import effects, own_effects
from rig.errors import BadInput
from rig.model import Effect, Quantity, Term

FOLDER = "RIG_EFFECTS"


def shelf(folder: Path | None = None) -> Mapping[str, Effect]:
    """Every effect by name; those of a user's folder (or of RIG_EFFECTS) beside and before the shipped ones.

    Raises BadInput, with file and line, for what is wrong in a user's file.
    """
    own = _folder(folder)
    return MappingProxyType({**_shipped(), **(_own(own) if own is not None else {})})


def own_names(folder: Path | None = None) -> frozenset[str]:
    """Names of the effects of a user's folder (or of RIG_EFFECTS)."""
    own = _folder(folder)
    return frozenset(path.stem for path in _files(own)) if own is not None else frozenset()


def _folder(given: Path | None) -> Path | None:
    if given is not None:
        return given
    return Path(os.environ[FOLDER]) if os.environ.get(FOLDER) else None


def _files(folder: Path) -> list[Path]:
    return sorted(folder.glob("[a-z]*.py"))


def effect_of(name: str, folder: Path | None = None) -> Effect:
    """One effect; raises BadInput with the nearest names if there is none."""
    import difflib

    found = shelf(folder)
    if name not in found:
        near = difflib.get_close_matches(name, found, 3) or sorted(found)[:3]
        raise BadInput(f"effect: found '{name}', wanted one of the shelf such as {', '.join(near)} (`rig effects`)")
    return found[name]


def nothing_of(effect: Effect, on: Quantity | None) -> Term:
    """The effect with all coordinates zero: not there."""
    return Term(effect, on, dict.fromkeys((c.name for c in effect.coordinates), 0.0))


@lru_cache(maxsize=1)
def _shipped() -> Mapping[str, Effect]:
    names = sorted(one.name for one in pkgutil.iter_modules(effects.__path__))
    return {name: _only(importlib.import_module(f"rig.effects.{name}"), name) for name in names}


def _own(folder: Path) -> dict[str, Effect]:
    if not folder.is_dir():
        raise BadInput(f"{folder}: found no folder, wanted one with effects, one file each")
    return {path.stem: own_effects.load(path) for path in _files(folder)}


def _only(module: ModuleType, name: str) -> Effect:
    kind = next(kind for kind in own_effects.kinds_in(module) if kind.__module__ == module.__name__)
    kind.name = name
    return kind()
