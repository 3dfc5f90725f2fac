"""What the simulated world hides beside what was found of it: the same parameters, in the same units."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rig.bench.benchfile import BenchDescription
    from rig.model import Effect
    from rig.repair.model_file import Entry, Model

PLAIN = (99.5, 1e6)


def model_of(description: BenchDescription, runs: Path, given: Path | None) -> Model | None:
    """The model that is held against the truth: the one named, else that of the bench's unit, if there is one."""
    from rig.repair.model_file import load, path_of

    path = given or path_of(runs, description.sensor.serial)
    return load(path) if given is not None or path.exists() else None


def begun(model: Model | None, runs: Path) -> float | None:
    """Bench clock at the beginning of the first session among the runs of a model, as far as they are still there."""
    from rig.notebook import records_of
    from rig.parts.reading import sessions

    names = [name for name in (model.runs if model is not None else ()) if (runs / name).is_dir()]
    return min(sessions.begun(records_of(names, runs)).values(), default=None) if names else None


def beside(effects: Sequence[Mapping[str, Any]], model: Model | None, shelf: Mapping[str, Effect]) -> list[Any]:
    """Hidden effects with `units`, and with `found`: value, unit and u by parameter, None if a model lacks it."""
    return [{**one, "units": _units(one, shelf), "found": _found(one, model)} for one in effects]


def _units(one: Mapping[str, Any], shelf: Mapping[str, Effect]) -> dict[str, str]:
    effect = shelf.get(str(one["name"]))
    if effect is None:
        return {}
    quantity = one["quantity"] or (effect.quantities[0] if effect.quantities else None)
    return dict(zip((p.name for p in effect.parameters), effect.units(quantity), strict=True))


def _found(one: Mapping[str, Any], model: Model | None) -> dict[str, Any] | None:
    entries = model.effects if model is not None else ()
    entry = next((entry for entry in entries if _same(entry, one)), None)
    return None if entry is None else {name: value.model_dump() for name, value in entry.parameters.items()}


def _same(entry: Entry, one: Mapping[str, Any]) -> bool:
    return entry.effect == one["name"] and (entry.on is None or one["quantity"] in (None, entry.on))


def in_words(one: Mapping[str, Any], *, modelled: bool) -> Iterator[str]:
    """Lines for one hidden effect: its name and strength, then a row for each parameter."""
    on = f", {one['quantity']}" if one["quantity"] else ""
    yield f"{one['name']} ({one['stage']}{on}), d′ {one['d_prime']:.1f}"
    found, width = one["found"], max(map(len, one["parameters"]), default=0)
    if modelled and found is None:
        yield "  not in the model"
    for name, value in one["parameters"].items():
        unit = one["units"].get(name, "")
        shown = f"  {name:<{width}}  true {_number(value, unit)}"
        yield shown + (f"  found {_estimate(found[name])}" if found and name in found else "")


def _number(value: float, unit: str, digits: int = 5) -> str:
    return f"{value:.{digits}g}{'' if unit in ('', '1') else f' {unit}'}"


def _estimate(one: Mapping[str, Any]) -> str:
    """With its expanded uncertainty (k = 2)."""
    if one["u"] is None:
        return _number(one["value"], one["unit"])
    expanded = 2.0 * one["u"]
    if not PLAIN[0] <= expanded < PLAIN[1]:  # two digits of these would have a power of ten
        return f"{one['value']:.5g} ± {_number(expanded, one['unit'], digits=2)}"
    step = 10.0 ** (math.floor(math.log10(expanded)) - 1)
    number, shown = (step * round(value / step) for value in (one["value"], expanded))
    return f"{number:.0f} ± {shown:.0f}{'' if one['unit'] in ('', '1') else ' ' + one['unit']}"
