"""What the type checker found wrong with a file, in the program's words: `file:line:column key: found …, wanted …`."""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, RootModel, ValidationError
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import ErrorDetails, core_schema

from rig.errors import Problem
from rig.units import KINDS, Quantity, format_quantity
from rig.yaml.document import Document, KeyPath, dotted, shown

# What was wanted, by pydantic's error type; `{…}` are the error's own details.
WANTED: Mapping[str, str] = {
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": "a smaller whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "text (in quotes, if it looks like something else)",
    "list_type": "a list",
    "tuple_type": "a list",
    "set_type": "a list",
    "frozen_set_type": "a list",
    "dict_type": "a mapping of keys",
    "model_type": "a mapping of keys",
    "model_attributes_type": "a mapping of keys",
    "dataclass_type": "a mapping of keys",
    "none_required": "nothing",
    "date_type": "a date such as 2026-01-31",
    "date_parsing": "a date such as 2026-01-31",
    "date_from_datetime_parsing": "a date such as 2026-01-31",
    "datetime_type": "a time such as 2026-01-31T08:00:00Z",
    "datetime_parsing": "a time such as 2026-01-31T08:00:00Z",
    "datetime_from_date_parsing": "a time such as 2026-01-31T08:00:00Z",
    "path_type": "a path",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
    "multiple_of": "a multiple of {multiple_of}",
    "literal_error": "{expected}",
    "enum": "{expected}",
    "string_pattern_mismatch": "text of the form {pattern}",
    "string_too_short": "at least {min_length} characters",
    "string_too_long": "at most {max_length} characters",
    "too_short": "at least {min_length} items",
    "too_long": "at most {max_length} items",
}


def problems(document: Document, model: type[BaseModel], at: KeyPath, error: ValidationError) -> list[Problem]:
    """Every mistake of a validation, in the order of the file, those of one place joined by "or"."""
    rows: dict[tuple[int, int, str, str], list[str]] = {}
    for details in error.errors(include_url=False):
        line, column, key, found, wanted = _row(document, model, at, details)
        alternatives = rows.setdefault((line, column, key, found), [])
        if wanted not in alternatives:
            alternatives.append(wanted)
    return [
        Problem(document.file, line, column, key, f"{found}, wanted {' or '.join(alternatives)}")
        for (line, column, key, found), alternatives in sorted(rows.items())
    ]


def _row(
    document: Document, model: type[BaseModel], at: KeyPath, error: ErrorDetails
) -> tuple[int, int, str, str, str]:
    """Line, column, key, `found …` and what was wanted."""
    path = at + _path(document.node(at), error["loc"])
    node = document.node(path) or document.root
    place = document.locate(path)
    match error["type"]:
        case "missing":
            name = error["loc"][-1]
            return *place, dotted((*path, name)), "found nothing", _missing(model, error["loc"])
        case "extra_forbidden":
            return *_key_place(document, path), dotted(path), "found an unknown key", _known(model, error["loc"])
        case "union_tag_invalid" | "union_tag_not_found":
            tag = str(error["ctx"]["discriminator"]).strip("'")
            inner = document.node((*path, tag))
            found = shown(inner) if inner is not None else "nothing"
            return (
                *document.locate((*path, tag)),
                dotted((*path, tag)),
                f"found {found}",
                _tags(model, error["loc"], tag),
            )
        case "value_error" | "assertion_error":
            found, wanted = _said(str(error["ctx"]["error"]), node)
            return *place, dotted(path), found, wanted
        case _:
            return *place, dotted(path), f"found {shown(node)}", _wanted(model, error)


def _path(node: yaml.Node | None, loc: tuple[int | str, ...]) -> KeyPath:
    """The keys and indices of pydantic's location that are in the file; tags of unions and the like are not."""
    path: list[int | str] = []
    for part in loc:
        if isinstance(node, yaml.MappingNode):
            child = next((value for key, value in node.value if key.value == str(part)), None)
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            child = node.value[part]
        else:
            child = None
        if child is not None:
            path.append(part)
            node = child
    return tuple(path)


def _key_place(document: Document, path: KeyPath) -> tuple[int, int]:
    """Where the key itself stands, not its value."""
    parent = document.node(path[:-1])
    if path and isinstance(parent, yaml.MappingNode):
        for key, _ in parent.value:
            if key.value == str(path[-1]):
                return key.start_mark.line + 1, key.start_mark.column + 1
    return document.locate(path)


def _said(message: str, node: yaml.Node) -> tuple[str, str]:
    """A validator's own words; most say `found …, wanted …` themselves."""
    found, separator, wanted = message.partition(", wanted ")
    if separator and found.startswith("found "):
        return found, wanted
    return f"found {shown(node)}", f"another value ({message})"


def _wanted(model: type[BaseModel], error: ErrorDetails) -> str:
    details = dict(error.get("ctx", {}))
    kind = next((k for t in _types_at(model, error["loc"]) for k in _kinds(t)), None)
    if kind is not None:
        details = {k: format_quantity(v, kind) if isinstance(v, float) else v for k, v in details.items()}
    if (template := WANTED.get(error["type"])) is not None:
        return template.format_map(details)
    message = error["msg"].removeprefix("Input should be ").removeprefix("a valid ")
    return message[:1].lower() + message[1:]


def _missing(model: type[BaseModel], loc: tuple[int | str, ...]) -> str:
    kind = next((k for t in _types_at(model, loc) for k in _kinds(t)), None)
    if kind is not None:
        return KINDS[kind].wanted
    return "this key" if isinstance(loc[-1], str) else "one more item"


def _known(model: type[BaseModel], loc: tuple[int | str, ...]) -> str:
    """The keys that there are, and the one that was probably meant."""
    names = sorted({name for t in _types_at(model, loc[:-1]) for m in _models(t) for name in m.model_fields})
    near = difflib.get_close_matches(str(loc[-1]), names, n=1)
    listed = f"one of {', '.join(names)}" if names else "no key here"
    return f"{listed} (did you mean '{near[0]}'?)" if near else listed


def _tags(model: type[BaseModel], loc: tuple[int | str, ...], discriminator: str) -> str:
    tags = [t for kind in _types_at(model, loc) for m in _models(kind) for t in _literals(m, discriminator)]
    return " or ".join(f"'{tag}'" for tag in tags) if tags else "one of the kinds there are"


def _types_at(model: Any, loc: tuple[int | str, ...]) -> list[Any]:
    """The types that the model allows at a location, as far as they can be followed."""
    here: list[Any] = [model]
    for part in loc:
        inside = [t for outer in here for t in _inside(outer, part)]
        # A part that leads nowhere is the tag of a union, or the name of one of its members.
        here = inside or [m for outer in here for m in _models(outer) if _tagged(m, part)] or here
    return here


def _tagged(model: type[BaseModel], tag: int | str) -> bool:
    return any(tag in _literals(model, name) for name in model.model_fields)


def _literals(model: type[BaseModel], field: str) -> tuple[Any, ...]:
    annotation = model.model_fields[field].annotation if field in model.model_fields else None
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def _inside(outer: Any, part: int | str) -> Iterator[Any]:
    for kind in _alternatives(outer):
        origin, arguments = get_origin(kind), get_args(kind)
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            field = kind.model_fields.get(str(part))
            if field is not None:
                yield Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
        elif origin is dict or origin is Mapping:
            yield arguments[1]
        elif origin in (list, tuple, set, frozenset) and isinstance(part, int):
            fixed = origin is tuple and arguments[-1] is not Ellipsis
            yield arguments[min(part, len(arguments) - 1) if fixed else 0]


def _alternatives(kind: Any) -> Iterator[Any]:
    """The members of a union, without their annotations; a root model stands for what it holds."""
    origin = get_origin(kind)
    if origin is Annotated:
        yield from _alternatives(get_args(kind)[0])
    elif origin in (Union, types.UnionType):
        for member in get_args(kind):
            yield from _alternatives(member)
    elif isinstance(kind, type) and issubclass(kind, RootModel):
        yield from _alternatives(kind.model_fields["root"].annotation)
    elif origin is not Literal:
        yield kind


def _models(kind: Any) -> Iterator[type[BaseModel]]:
    return (k for k in _alternatives(kind) if isinstance(k, type) and issubclass(k, BaseModel))


def _kinds(kind: Any) -> Iterator[str]:
    """Names of the kinds of quantity that a type is marked with, inside a union too."""
    if get_origin(kind) is Annotated:
        yield from (mark.kind for mark in get_args(kind)[1:] if isinstance(mark, Quantity))
        yield from _kinds(get_args(kind)[0])
    elif get_origin(kind) in (Union, types.UnionType):
        for member in get_args(kind):
            yield from _kinds(member)


class _Schema(GenerateJsonSchema):
    """Writes the default of a quantity as text with its unit, as a file would have it."""

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        found = super().default_schema(schema)
        kind, default = found.get("x-quantity"), found.get("default")
        if kind is not None and isinstance(default, int | float):
            found["default"] = format_quantity(default, kind, digits=12)
        return found


def schema(model: type[BaseModel]) -> dict[str, Any]:
    """The model's JSON schema; quantities are text with a unit, in their defaults too."""
    return {"$schema": _Schema.schema_dialect, **model.model_json_schema(schema_generator=_Schema)}
