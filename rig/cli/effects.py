"""The shelf of effects to read: `rig effects`, an effect's page, and the reference page in the documentation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli.options import effects_option, json_option, print_json

if TYPE_CHECKING:
    from rig.model import Effect, Parameter

STAGES = ("reference", "motion", "transducer", "dynamics", "electronics", "sampling", "noise")
HEAD = """\
# The shelf of effects

<!-- Made by `make pages` from the files in rig/effects; changes here are lost. -->

Every physical effect that a model can be composed of, {count} in all, by its stage of the chain. `rig diagnose` looks
for all of them that a run can show; those with a test of their own, those that are not looked for yet, and those that
no fit can see, say so. How to add one: [an effect of your own](../how-to/add-an-effect.md). In a unit, SI stands for
that of the channel, m/s² or rad/s. `rig effects` lists the shelf in a terminal, `rig effects NAME` shows one."""


@click.command()
@click.argument("name", metavar="[EFFECT]", required=False)
@effects_option
@click.option("--markdown", is_flag=True, help="Print the reference page of the documentation instead.")
@json_option
def effects(name: str | None, effects: Path | None, markdown: bool, as_json: bool) -> None:
    """List every effect that a model can have, by its stage of the chain, or show the page of EFFECT.

    Effects of your own (--effects or RIG_EFFECTS) are among them, marked.

    \f
    `--markdown` prints [the page of the reference](effects.md). `--json` gives a list, with EFFECT one object:
    `effect`, `stage`, `title`, `own`, `equation`, `quantities`, `places`, `parameters` (a list of `name`, `unit`,
    `bounds`, `typical`; an open end is `null`, `SI` in a unit is m/s² or rad/s), `missing`, `confused_with`,
    `separate_by`, `source`, `absorbed`, `looks_in`.
    """
    from rig.shelf import effect_of, own_names, shelf

    if markdown and (name is not None or as_json):
        raise click.UsageError("--markdown: found EFFECT or --json with it, wanted it alone")
    if name is not None:
        one = effect_of(name, effects)
        own = name in own_names(effects)
        print_json(as_object(one, own)) if as_json else click.echo("\n".join(page_text(one, own)))
        return
    found, mine = shelf(effects), own_names(effects)
    if markdown:
        click.echo(reference_page(found), nl=False)
    elif as_json:
        print_json([as_object(one, one.name in mine) for one in by_stage(found)])
    else:
        click.echo("\n".join(list_text(found, mine)))


def by_stage(shelf: Mapping[str, Effect]) -> list[Effect]:
    """The effects in the order of the chain, and by name within a stage."""
    return sorted(shelf.values(), key=lambda one: (STAGES.index(one.stage), one.name))


def list_text(shelf: Mapping[str, Effect], own: frozenset[str]) -> Iterator[str]:
    """The shelf, one line for each effect."""
    width = max(len(name) for name in shelf)
    yield f"the shelf: {len(shelf)} effects" + (f", {len(own)} of your own" if own else "")
    stage = ""
    for one in by_stage(shelf):
        if one.stage != stage:
            stage = one.stage
            yield from ("", stage)
        yield f"  {one.name:<{width}}  {'(own) ' if one.name in own else ''}{one.title}: {one.equation}"


def page_text(one: Effect, own: bool) -> Iterator[str]:
    """The page of one effect, for a terminal."""
    yield f"{one.name}: {one.title} ({one.stage}{', of your own' if own else ''})"
    yield from ("", f"  {one.equation}", "")
    for parameter in one.parameters:
        usual = f"usually {_range(parameter.typical)}"
        yield f"  {parameter.name}: {usual}, possible {_range(parameter.bounds)}{_unit(one, parameter)}"
    for head, text in _said(one):
        yield f"  {head}: {text}"
    yield f"  source: {one.source}"


def reference_page(shelf: Mapping[str, Effect]) -> str:
    """`docs/reference/effects.md`: every effect with equation, parameters, and what it is confused with."""
    parts, stage = [HEAD.format(count=len(shelf))], ""
    for one in by_stage(shelf):
        if one.stage != stage:
            stage = one.stage
            parts.append(f"## {stage.capitalize()}")
        parts += _entry(one)
    return "\n\n".join(parts) + "\n"


def _entry(one: Effect) -> Iterator[str]:
    yield f"### {one.name}"
    yield f"{_capital(one.title)}: `{one.equation}`"
    rows = [
        f"| {p.name} | {_unit(one, p).strip()} | {_range(p.typical)} | {_range(p.bounds)} |" for p in one.parameters
    ]
    if rows:
        yield "\n".join(["| parameter | unit | usual | possible |", "|---|---|---|---|", *rows])
    first, *others = _said(one)
    yield _sentence(*first)
    yield " ".join([*(_sentence(*other) for other in others), f"Source: {one.source}."])


def _said(one: Effect) -> Iterator[tuple[str, str]]:
    """What there is to say of an effect, as pairs of head and text."""
    from rig.diagnose.unseen import TESTED
    from rig.model import EXPERIMENTS

    yield "missing", one.missing
    yield "channels", " or ".join(one.quantities) or "all alike"
    places = [EXPERIMENTS[place] for place in one.places]
    yield "shows on", "every kind of experiment" if len(places) == len(EXPERIMENTS) else _listed(places)
    if one.confused_with:
        yield "confused with", ", ".join(one.confused_with)
    yield "separated by", one.separate_by
    if one.absorbed:
        yield "no fit sees it", one.absorbed
    if one.looks_in:
        yield "found by", "a test of its own" if one.looks_in in TESTED else "no test yet: it is not looked for"


def as_object(one: Effect, own: bool) -> dict[str, Any]:
    """What `rig effects --json` says of one effect, SI; an end of a range that is open is null."""
    return {
        "effect": one.name,
        "stage": one.stage,
        "title": one.title,
        "own": own,
        "equation": one.equation,
        "quantities": list(one.quantities),
        "places": list(one.places),
        "parameters": [
            {"name": p.name, "unit": _unit(one, p).strip(), "bounds": _ends(p.bounds), "typical": _ends(p.typical)}
            for p in one.parameters
        ],
        "missing": one.missing,
        "confused_with": list(one.confused_with),
        "separate_by": one.separate_by,
        "source": one.source,
        "absorbed": one.absorbed,
        "looks_in": one.looks_in,
    }


def _ends(given: tuple[float, float]) -> list[float | None]:
    return [end if math.isfinite(end) else None for end in given]


def _range(given: tuple[float, float]) -> str:
    low, high = (f"{end:.6g}".replace("inf", "∞") for end in given)
    return f"{low} … {high}"


def _unit(one: Effect, parameter: Parameter) -> str:
    """The unit with a space before it, in full where the effect acts on one quantity only."""
    units = one.units(one.quantities[0]) if len(one.quantities) == 1 else [p.unit for p in one.parameters]
    unit = dict(zip((p.name for p in one.parameters), units, strict=True))[parameter.name]
    return f" {unit}" if unit else ""


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _sentence(head: str, text: str) -> str:
    return f"{_capital(head)}: {text}."
