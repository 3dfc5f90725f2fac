"""Every key of every file that a person writes is read by some code outside the class that describes it.

The search is by name, in the syntax trees: an attribute that is loaded in the schema's module (outside its classes) or
in a module that imports it; or, for what stands as JSON in a run's header, a look-up by its name. What a change of
a key does is another test's business (tests/rig/test_manifest_keys.py).
"""

from __future__ import annotations

import ast
import importlib
import pkgutil
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from types import ModuleType

import pytest
from pydantic import BaseModel

import drivers
import procedures
import rig

ROOT = Path(__file__).parents[1]
PACKAGES: tuple[ModuleType, ...] = (rig, drivers, procedures)
# who reads values of a schema without importing its module: they come by way of these
BY_WAY_OF = {
    "rig.foreign.manifest": {"rig.foreign.tables", "rig.foreign.importing"},
    "rig.bench.benchfile": {"rig.bench.steps", "rig.bench.station"},
}
AS_JSON = {"rig.bench.benchfile", "rig.bench.operators"}  # in a run's header or journal: read there by name


@lru_cache(maxsize=1)
def modules() -> dict[str, ast.Module]:
    """Every module with its syntax tree; importing them makes every schema known."""
    found = {}
    for package in PACKAGES:
        for one in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            path = Path(str(importlib.import_module(one.name).__file__))
            found[one.name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def schemas(kind: type[BaseModel] = BaseModel) -> Iterator[type[BaseModel]]:
    modules()
    for one in kind.__subclasses__():
        if one.__module__ in modules():
            yield one
        yield from schemas(one)


def imported(tree: ast.Module) -> set[str]:
    """Names of the modules that one imports, or from which it imports."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {one.name for one in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{one.name}" for one in node.names)}
    return found


def loads(tree: ast.AST, described: frozenset[str] = frozenset()) -> tuple[set[str], set[str]]:
    """Attributes that are loaded, and texts that something is looked up by, outside the classes that are named."""
    attributes: set[str] = set()
    texts: set[str] = set()
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ClassDef) and node.name in described:
            node = ast.Module([one for one in node.body if isinstance(one, ast.FunctionDef)], [])  # what it works out
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
            attributes.add(node.attr)
        texts |= {one.value for one in _looked_up(node) if isinstance(one, ast.Constant) and isinstance(one.value, str)}
        inner = loads(node, described)
        attributes |= inner[0]
        texts |= inner[1]
    return attributes, texts


def _looked_up(node: ast.AST) -> Iterator[ast.expr]:
    """What may name a key here: an index, an argument of a look-up, a name in a tuple that is gone through."""
    if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Load):
        yield node.slice
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "get":
        yield from node.args[:1]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id.startswith("_optional"):
        yield from node.args[1:2]
    if isinstance(node, ast.For | ast.comprehension) and isinstance(node.iter, ast.Tuple):
        for one in node.iter.elts:  # names, or names with something beside them
            yield from one.elts if isinstance(one, ast.Tuple) else (one,)


@lru_cache(maxsize=64)
def readers(schema: str) -> tuple[frozenset[str], frozenset[str]]:
    """Attributes and texts that may be reads of what one module describes."""
    ways = {schema, *BY_WAY_OF.get(schema, ())}
    described = frozenset(one.__name__ for one in schemas() if one.__module__ == schema)
    attributes, texts = loads(modules()[schema], described)
    for name, tree in modules().items():
        if name != schema and ways & {name, *imported(tree)}:
            attributes |= loads(tree)[0]
        if schema in AS_JSON and not name.startswith(("rig.bench.", "rig.effects.")):  # these look up other things
            texts |= loads(tree)[1]
    return frozenset(attributes), frozenset(texts if schema in AS_JSON else ())


FIXED = {"format", "procedure", "driver", "root"}  # of one value, or read before there is a schema: it chooses it
KEYS = sorted(
    {(one.__module__, one.__name__, key) for one in schemas() for key in one.__annotations__.keys() & one.model_fields}
)  # those of a class that it stands on are asked for there
KEYS = [(module, name, key) for module, name, key in KEYS if key not in FIXED]


def test_there_are_schemas() -> None:
    assert len({(module, name) for module, name, _ in KEYS}) > 40


@pytest.mark.parametrize(("module", "schema", "key"), KEYS, ids=str)
def test_a_key_is_read(module: str, schema: str, key: str) -> None:
    attributes, texts = readers(module)
    assert key in attributes or key in texts, f"{module}.{schema}.{key}: found no code that reads it"


def test_a_key_that_nobody_reads_is_found() -> None:
    attributes, texts = readers("rig.foreign.manifest")
    assert "gain_uncertainty" in attributes
    assert "gain_certainty" not in attributes | texts
