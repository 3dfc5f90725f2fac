"""A technician's YAML into a plan: one procedure, or a sequence of procedures, prompts, waits and repetitions."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from types import ModuleType
from typing import Annotated, Any, Union, cast

from pydantic import BaseModel, ConfigDict, Discriminator, Field, RootModel, Tag, create_model

from rig.bench.steps import Ask, BenchFacts, Experiment, Mistake, Plan, Step, Wait
from rig.errors import ConfigError, Problem
from rig.room import Request
from rig.units import Time
from rig.yaml import config
from rig.yaml.document import Document, KeyPath

# How the reader tells kinds apart; none of them is a key, so that a mistake's path is never taken for one.
PROMPT, WAIT, REPEAT, SEQUENCE = "a prompt", "a wait", "a repetition", "a sequence"
SINGLE = "a step"  # a plan that is no procedure


class Prompt(BaseModel):
    """A question or instruction that the operator confirms."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    prompt: str = Field(min_length=1)


class WaitItem(BaseModel):
    """Nothing moves for so long."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    wait: Time = Field(ge=0)


def procedures() -> dict[str, ModuleType]:
    """Every procedure there is, by the name of its file."""
    package = importlib.import_module("procedures")
    names = sorted(module.name for module in pkgutil.iter_modules(package.__path__))
    return {name: importlib.import_module(f"procedures.{name}") for name in names}


def _kind(value: Any) -> str | None:
    """Which member of the union a mapping means; None is reported as a mistake with the choices."""
    if isinstance(value, BaseModel):
        value = dict(value)
    if not isinstance(value, Mapping):
        return None
    for key, tag in (("repeat", REPEAT), ("steps", SEQUENCE), ("prompt", PROMPT), ("wait", WAIT)):
        if key in value:
            return tag
    name = value.get("procedure")
    return name if isinstance(name, str) else None


@cache
def file_model() -> type[RootModel[Any]]:
    """What a procedure file may hold; also the source of its JSON schema."""
    kinds = {name: module.Settings for name, module in procedures().items()}
    leaves: dict[str, Any] = {**kinds, PROMPT: Prompt, WAIT: WaitItem}
    strict = ConfigDict(extra="forbid", frozen=True)
    times: Any = Annotated[int, Field(ge=1, le=1000)]
    repeat = create_model(
        "Repeat",
        __doc__="The same steps several times.",
        __config__=strict,
        repeat=(times, ...),
        steps=(_list(leaves), ...),
    )
    sequence = create_model(
        "Sequence",
        __doc__="Procedures, prompts, waits and repetitions, one after another in one run.",
        __config__=strict,
        title=(str, ""),
        steps=(_list({**leaves, REPEAT: repeat}), ...),
    )
    whole: Any = RootModel[_any_of({**kinds, SEQUENCE: sequence})]  # type: ignore[misc]
    return cast(type[RootModel[Any]], create_model("ProcedureFile", __base__=whole))


def _any_of(members: Mapping[str, Any]) -> Any:
    """The union of models, told apart by `_kind`."""
    tagged = tuple(Annotated[model, Tag(tag)] for tag, model in members.items())
    return Annotated[Union[tagged], Discriminator(_kind)]  # noqa: UP007 - made at run time


def _list(members: Mapping[str, Any]) -> Any:
    return Annotated[list[_any_of(members)], Field(min_length=1)]  # type: ignore[misc]


def plan(document: Document, facts: BenchFacts) -> Plan:
    """The plan that a document means on this bench; raises ConfigError with every mistake at its line and column."""
    unknown = list(_unknown(document, document.data, ()))
    if unknown:
        raise ConfigError(unknown)
    loaded, problems = config.check(document, file_model())
    if loaded is None:
        raise ConfigError(problems)
    made = _plan(loaded.root, facts)
    if made.mistakes:
        once = dict.fromkeys(made.mistakes)  # a repetition makes the same mistake every time
        raise ConfigError([document.problem(mistake.path, mistake.text) for mistake in once])
    return made


def _unknown(document: Document, value: Any, path: KeyPath) -> Iterator[Problem]:
    """Items whose kind cannot be told, wherever they are nested."""
    kind = _kind(value)
    known = sorted(procedures())
    if kind is None:
        text = "found no procedure" if isinstance(value, Mapping) and "procedure" not in value else f"found {value!r}"
        others = "steps" if not path else "prompt, wait or repeat with steps"
        yield document.problem(
            (*path, "procedure"), f"{text}, wanted procedure: one of {', '.join(known)}; or {others}"
        )
    elif kind in (SEQUENCE, REPEAT) and isinstance(value.get("steps"), list):
        for number, item in enumerate(value["steps"]):
            yield from _unknown(document, item, (*path, "steps", number))
    elif kind not in (*known, PROMPT, WAIT, REPEAT, SEQUENCE):
        yield document.problem((*path, "procedure"), f"found '{kind}', wanted one of {', '.join(known)}")


def _plan(item: Any, facts: BenchFacts) -> Plan:
    if hasattr(item, "procedure"):
        made: Plan = procedures()[item.procedure].expand(item, facts)
        return made
    parts = list(_parts(item.steps, ("steps",), facts))
    return Plan(
        procedure="sequence",
        title=item.title or "Sequence",
        settings=item.model_dump(mode="json"),
        steps=tuple(step for _, part in parts for step in part.steps),
        mistakes=tuple(Mistake((*path, *one.path), one.text) for path, part in parts for one in part.mistakes),
        expect=_expected([part for _, part in parts]),
        parts=tuple(_experiments([part for _, part in parts])),
    )


def _expected(plans: Iterable[Plan]) -> dict[str, tuple[float, float]]:
    """What all procedures together expect: of a result that several name, what every one of them allows."""
    found: dict[str, tuple[float, float]] = {}
    for one in plans:
        for key, (low, high) in one.expect.items():
            lowest, highest = found.get(key, (low, high))
            found[key] = (max(low, lowest), min(high, highest))
    return found


def _experiments(plans: Iterable[Plan]) -> Iterator[Experiment]:
    """Where each procedure's steps stand in the sequence; single steps between them are no procedure."""
    first = 0
    for one in plans:
        end = first + len(one.steps)
        if one.procedure != SINGLE:
            yield Experiment(one.procedure, one.title, first, end)
        first = end


def _parts(items: list[Any], path: KeyPath, facts: BenchFacts) -> Iterator[tuple[KeyPath, Plan]]:
    for number, item in enumerate(items):
        here = (*path, number)
        if hasattr(item, "repeat"):
            for turn in range(item.repeat):
                if turn:
                    request = Request("remount", "Take the cube off and put it back as it was.")
                    yield here, _single(Ask("remount", request=request, duration=60))
                yield from _parts(item.steps, (*here, "steps"), facts)
        elif hasattr(item, "prompt"):
            yield here, _single(Ask("prompt", request=Request("confirm", item.prompt), duration=10))
        elif hasattr(item, "wait"):
            yield here, _single(Wait("wait", duration=item.wait))
        else:
            yield here, _plan(item, facts)


def _single(step: Step) -> Plan:
    return Plan(procedure=SINGLE, title=step.label, settings={}, steps=(step,))
