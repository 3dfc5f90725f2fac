"""How `rig/` is built, in figures: `python tests/structure.py` prints them, and what breaks them.

A room is a file or folder directly under `rig/` (an `__init__` without definitions is none). An arrow is an ordered
pair of rooms with at least one import between them, be it inside a function or for types only. A share is of the
physical lines of Python under `rig/`. Drivers, procedures and fixtures are not looked at.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

RIG = Path(__file__).parents[1] / "rig"
LONG = 50  # lines
# From the top; each imports only what stands below it, and what stands side by side does not know each other.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("cli",), ("foreign.guessing", "notebook"), ("repair",), ("certificate", "export", "report"), ("calibrate",),
    ("diagnose",), ("figures",), ("fit",), ("parts",), ("bench", "foreign"), ("shelf", "formula"),
    ("own_effects", "effects"), ("model",), ("motion",), ("archive",), ("signals",),
    ("record", "room", "sensor", "printed", "correction"), ("yaml",), ("units", "dimensions"), ("errors",),
)  # fmt: skip
NO_LAYER = ("__init__", "__main__")  # the package itself, and the door to `cli`
PART_METHODS = {"whitened", "own_columns"}  # what only a part has: its rows in standard deviations, its own columns
INSIDE = ("parts", "foreign")  # where an experiment's kind may be asked: `foreign` reads it from the manifest


@dataclass(frozen=True)
class Module:
    """One file of Python: its dotted name under `rig`, its lines, its tree."""

    name: str
    lines: int
    tree: ast.Module

    @property
    def room(self) -> str:
        return self.name.split(".")[0]

    @property
    def functions(self) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
        return [one for one in ast.walk(self.tree) if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)]

    @property
    def empty(self) -> bool:
        """Whether nothing is defined here."""
        return not any(
            isinstance(one, ast.FunctionDef | ast.ClassDef | ast.Assign | ast.AnnAssign) for one in self.tree.body
        )


@dataclass(frozen=True)
class House:
    """All modules under a folder."""

    modules: Sequence[Module]

    @classmethod
    def of(cls, folder: Path) -> House:
        return cls([_read(path, folder) for path in sorted(folder.rglob("*.py"))])

    @cached_property
    def rooms(self) -> dict[str, int]:
        """Lines by room, the biggest first."""
        found: dict[str, int] = {}
        for one in self.modules:
            if one.name != "__init__" or not one.empty:
                found[one.room] = found.get(one.room, 0) + one.lines
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    @cached_property
    def imports(self) -> set[tuple[str, str]]:
        """Pairs of modules, the first importing the second."""
        names = {one.name for one in self.modules}
        return {(one.name, other) for one in self.modules for other in _imported(one, names) if other != one.name}

    @cached_property
    def arrows(self) -> set[tuple[str, str]]:
        pairs = {(one.split(".")[0], other.split(".")[0]) for one, other in self.imports}
        return {(one, other) for one, other in pairs if one != other and one in self.rooms and other in self.rooms}

    @property
    def biggest(self) -> float:
        """Share of the biggest room."""
        return max(self.rooms.values()) / sum(self.rooms.values())

    @property
    def circles(self) -> list[list[str]]:
        """Rooms that can be reached from one another."""
        return circles(self.arrows)

    @property
    def module_circles(self) -> list[list[str]]:
        return circles(self.imports)

    @property
    def unlisted(self) -> list[str]:
        """Rooms that the list of layers does not name: their arrows cannot be judged."""
        return [room for room in self.rooms if room not in NO_LAYER and _layer(room) is None]

    @property
    def upward(self) -> list[str]:
        """Arrows that do not lead down, between listed places."""
        found = set()
        for one, other in self.imports:
            a, b = _layer(one), _layer(other)
            if a is not None and b is not None and a != b and b[0] <= a[0]:
                found.add(f"{a[1]} → {b[1]}")
        return sorted(found)

    @cached_property
    def part_classes(self) -> set[str]:
        """Classes of parts: they have what only a part has, or descend from one that does."""
        classes = {
            one.name: one for module in self.modules for one in ast.walk(module.tree) if isinstance(one, ast.ClassDef)
        }
        found = {
            name
            for name, one in classes.items()
            if PART_METHODS & {m.name for m in one.body if isinstance(m, ast.FunctionDef)}
        }
        while more := {n for n, one in classes.items() if {_last(base) for base in one.bases} & found} - found:
            found |= more
        return found

    @property
    def branches(self) -> list[str]:
        """Where something outside `INSIDE` asks for a part's type, kind or place."""
        outside = [one for one in self.modules if not one.name.startswith(INSIDE)]
        return [f"{one.name}:{line} {text}" for one in outside for line, text in _branches(one.tree, self.part_classes)]

    @property
    def lengths(self) -> list[int]:
        """Lines of every function, the shortest first."""
        return sorted(_length(f) for one in self.modules for f in one.functions)

    @property
    def p90(self) -> int:
        """Nine in ten functions have no more lines."""
        return self.lengths[max(0, -(-9 * len(self.lengths) // 10) - 1)]

    @property
    def long(self) -> list[str]:
        """Functions over `LONG` lines, the longest first."""
        found = [(_length(f), f"{one.name}:{f.lineno} {f.name}") for one in self.modules for f in one.functions]
        return [f"{name}, {lines} lines" for lines, name in sorted(found, reverse=True) if lines > LONG]

    @property
    def untyped(self) -> list[str]:
        """Functions with an argument or a result without a type."""
        return [f"{one.name}:{f.lineno} {f.name}" for one in self.modules for f in one.functions if not _typed(f)]

    @property
    def typed(self) -> float:
        return 1.0 - len(self.untyped) / len(self.lengths)


def _read(path: Path, folder: Path) -> Module:
    text = path.read_text(encoding="utf-8")
    parts = path.relative_to(folder).with_suffix("").parts
    name = ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)
    return Module(name, len(text.splitlines()), ast.parse(text))


def _imported(module: Module, names: set[str]) -> Iterator[str]:
    """Modules under `rig` that a module imports, wherever the line stands."""
    for one in ast.walk(module.tree):
        if isinstance(one, ast.Import):
            for alias in one.names:
                yield from _known(alias.name, names)
        elif isinstance(one, ast.ImportFrom) and one.module and one.level == 0:
            for alias in one.names:
                yield from _known(f"{one.module}.{alias.name}", names)


def _known(dotted: str, names: set[str]) -> Iterator[str]:
    """The deepest module that a dotted name leads to."""
    first, *rest = dotted.split(".")
    if first != "rig":
        return
    while rest and ".".join(rest) not in names:
        rest.pop()
    yield ".".join(rest) or "__init__"


def circles(arrows: set[tuple[str, str]]) -> list[list[str]]:
    """Groups that can be reached from one another, by following every arrow to its end."""
    ahead: dict[str, set[str]] = {}
    for one, other in arrows:
        ahead.setdefault(one, set()).add(other)
    reached = {one: _reached(one, ahead) for one in ahead}
    groups = {frozenset(x for x in reached[one] if one in reached.get(x, ())) for one in ahead if one in reached[one]}
    return sorted(sorted(group) for group in groups)


def _reached(start: str, ahead: Mapping[str, set[str]]) -> set[str]:
    found: set[str] = set()
    waiting = [start]
    while waiting:
        new = ahead.get(waiting.pop(), set()) - found
        found |= new
        waiting += new
    return found


def _layer(name: str) -> tuple[int, str] | None:
    """The layer of a module and its name there: that of its longest listed beginning."""
    listed = {place: n for n, layer in enumerate(LAYERS) for place in layer}
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        if (place := ".".join(parts[:end])) in listed:
            return listed[place], place
    return None


def _branches(tree: ast.Module, parts: set[str]) -> Iterator[tuple[int, str]]:
    for one in ast.walk(tree):
        if isinstance(one, ast.Call) and _last(one.func) in ("isinstance", "issubclass") and len(one.args) == 2:
            if _names(one.args[1]) & parts:
                yield one.lineno, ast.unparse(one)
        elif isinstance(one, ast.MatchClass) and _last(one.cls) in parts:
            yield one.lineno, f"case {ast.unparse(one)}"
        elif isinstance(one, ast.Match) and _asks(one.subject):
            yield one.subject.lineno, f"match {ast.unparse(one.subject)}"
        elif isinstance(one, ast.Compare):
            sides = (one.left, *one.comparators)
            if any(_asks(side) for side in sides) or any(_names(side) & parts for side in one.comparators):
                yield one.lineno, ast.unparse(one)


def _asks(side: ast.expr) -> bool:
    """Whether this is the place of something, or the kind of a part or of an imported experiment."""
    if not isinstance(side, ast.Attribute):
        return False
    return side.attr == "place" or (side.attr == "kind" and _last(side.value) in ("part", "manifest"))


def _names(value: ast.expr) -> set[str]:
    """Names in a class, a tuple or a union of classes."""
    return {_last(one) for one in ast.walk(value) if isinstance(one, ast.Name | ast.Attribute)}


def _last(value: ast.expr) -> str:
    return value.id if isinstance(value, ast.Name) else value.attr if isinstance(value, ast.Attribute) else ""


def _length(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    return (function.end_lineno or function.lineno) - function.lineno + 1


def _typed(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    a = function.args
    every = [*a.posonlyargs, *a.args, *a.kwonlyargs, *(one for one in (a.vararg, a.kwarg) if one)]
    owner = every[:1] if every and every[0].arg in ("self", "cls") else []
    return function.returns is not None and all(one.annotation is not None for one in every if one not in owner)


def said(house: House) -> str:
    """All figures, and by name what is still to be mended."""
    room, lines = next(iter(house.rooms.items()))
    figures = [
        f"rooms {len(house.rooms)}, arrows {len(house.arrows)}, biggest {room} {lines} lines = {house.biggest:.1%}",
        f"circles of rooms {len(house.circles)}, of modules {len(house.module_circles)}",
        f"rooms without a layer {len(house.unlisted)}, arrows that lead up {len(house.upward)}",
        f"branches on a part {len(house.branches)}",
        f"functions {len(house.lengths)}, over {LONG} lines {len(house.long)}, p90 {house.p90} lines",
        f"functions with all types {house.typed:.1%}",
    ]
    groups = {
        "lines by room": [f"{name} {lines}" for name, lines in house.rooms.items()],
        "circles": [" ".join(one) for one in (*house.circles, *house.module_circles)],
        "rooms without a layer": [" ".join(house.unlisted)] if house.unlisted else [],
        "arrows that lead up": house.upward,
        "branches on a part": house.branches,
        f"functions over {LONG} lines": house.long,
        "functions without types": house.untyped,
    }
    return "\n".join([*figures, *(line for name, rows in groups.items() if rows for line in (f"\n{name}:", *rows))])


if __name__ == "__main__":
    sys.stdout.write(said(House.of(RIG)) + "\n")
