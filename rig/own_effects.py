"""Effects of a user's own folder: loaded, checked against what an effect has to say, and watched while they work.

Whatever is wrong in such a file becomes one message with file and line: a mistake of Python's grammar, an exception
while it is loaded or in one of its methods, an attribute of the wrong kind, an array of the wrong shape.
"""

from __future__ import annotations

import ast
import difflib
import functools
import importlib.util
import inspect
import math
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import FunctionType, MappingProxyType, ModuleType
from typing import Any, get_args

import numpy as np

from rig.errors import BadInput
from rig.model import BOTH, EVERYWHERE, Coordinate, Effect, Motion, Parameter, Stage

TEXTS = ("title", "equation", "missing", "separate_by", "source")
MISSPELLED = 0.8  # likeness of a name to one that an effect has
Shape = tuple[int, ...]

# what a method returns: the shape of which argument, counted after self, and whether it may be complex
ARRAYS: Mapping[str, tuple[int, bool]] = MappingProxyType(
    {"shaken": (0, True), "felt": (0, False), "transduce": (0, False), "response": (0, True), "late": (0, False),
     "mixed": (0, True)}
)  # fmt: skip


def load(path: Path) -> Effect:
    """The one effect of a file. Raises BadInput with file and line for anything that is wrong with it."""
    module = _executed(path)
    kinds = [kind for kind in kinds_in(module) if kind.__module__ == module.__name__]
    if len(kinds) != 1:
        raise BadInput(f"{path}: found {len(kinds)} effects, wanted one in the file")
    kind = kinds[0]
    kind.name = path.stem
    _Check(path, kind).all()
    for name, method in list(vars(kind).items()):
        if isinstance(method, FunctionType):
            setattr(kind, name, _watched(path, name, method))
    try:
        return kind()
    except Exception as error:
        raise _failed(path, error, "while it is made") from error


def kinds_in(module: ModuleType) -> list[type[Effect]]:
    """Classes of a module that are effects."""
    found = (kind for _, kind in inspect.getmembers(module, inspect.isclass))
    return [kind for kind in found if issubclass(kind, Effect) and kind is not Effect]


def _executed(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"own_effects.{path.stem}", path)
    if spec is None or spec.loader is None:
        raise BadInput(f"{path}: found no Python file, wanted one with an effect")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        where = f"{path}:{error.lineno or 1}:{error.offset or 1}"
        raise BadInput(f"{where}: found '{(error.text or '').strip()}' ({error.msg}), wanted Python") from error
    except (Exception, SystemExit) as error:
        raise _failed(path, error, "while it is loaded") from error
    return module


def _failed(path: Path, error: BaseException, when: str, line: int = 0) -> BadInput:
    """An exception as a message, at the last line of the file that it passed through."""
    frames = traceback.extract_tb(error.__traceback__)
    at = next((one.lineno for one in reversed(frames) if Path(one.filename) == path), None) or line or 1
    said = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return BadInput(f"{path}:{at}: found {said} {when}, wanted an effect that works")


def _watched(path: Path, name: str, method: FunctionType) -> Callable[..., Any]:
    """A method whose exceptions, and results of the wrong shape, are told with file and line."""
    line = method.__code__.co_firstlineno

    @functools.wraps(method)
    def watched(*given: Any, **named: Any) -> Any:
        try:
            found = method(*given, **named)
        except BadInput:
            raise
        except Exception as error:
            raise _failed(path, error, f"in {name}", line) from error
        if wrong := _wrong_result(name, found, given):
            raise BadInput(f"{path}:{line}: {name}: {wrong}")
        return found

    return watched


def _wrong_result(name: str, found: Any, given: tuple[Any, ...]) -> str:
    """`found …, wanted …` for a result that is not what the method has to give; '' if it is."""
    if name in ARRAYS:
        argument, complex_too = ARRAYS[name]
        return _wrong_array(found, np.shape(given[1 + argument]), complex_too)
    match name:
        case "turned":
            return _wrong_parts(found, 3, [np.shape(given[1])] * 3, finite=False)  # before the index nothing is
        case "output":
            return _wrong_parts(found, 2, [np.shape(given[1]), np.shape(given[2])], complex_too=True)
        case "added":
            wanted = (len(given[2].names), *given[1].rate.shape[1:])
            return "" if found is None else _wrong_array(found, wanted, False, whole=True)
        case "motion":
            return "" if isinstance(found, Motion) else f"found {_shown(found)}, wanted a Motion"
        case "at_mains":
            return "" if found is None else _wrong_array(found, np.shape(given[2]), True)
        case "physical" | "from_physical":
            own = given[0].parameters if name == "physical" else given[0].coordinates
            return _wrong_names(found, {one.name for one in own})
        case "starts":
            names = {one.name for one in given[0].coordinates}
            if not isinstance(found, list):
                return f"found {_shown(found)}, wanted a list of starts"
            return next((wrong for one in found if (wrong := _wrong_names(one, names))), "")
    return ""


def _wrong_parts(found: Any, count: int, shapes: list[Shape], complex_too: bool = False, finite: bool = True) -> str:
    if not isinstance(found, tuple) or len(found) != count:
        return f"found {_shown(found)}, wanted {count} arrays"
    wrongs = (_wrong_array(one, shape, complex_too, finite=finite) for one, shape in zip(found, shapes, strict=True))
    return next((wrong for wrong in wrongs if wrong), "")


def _wrong_array(
    found: Any, wanted: Shape, complex_too: bool, *, finite: bool = True, whole: bool = False
) -> str:  # fmt: skip
    """A number or an array that cannot be spread over the shape wanted, or holds anything but finite numbers.

    `whole`: it has to have that shape itself.
    """
    try:
        array = np.asarray(found)
    except ValueError:
        return f"found {_shown(found)}, wanted an array of shape {wanted}"
    if array.dtype.kind not in ("biufc" if complex_too else "biuf"):
        kind = "numbers" if complex_too else "real numbers"
        return f"found {_shown(found)}, wanted {kind} in an array of shape {wanted}"
    try:
        fits = np.broadcast_shapes(array.shape, wanted) == wanted and (array.shape == wanted or not whole)
    except ValueError:
        fits = False
    if not fits:
        return f"found an array of shape {array.shape}, wanted {wanted}"
    return "" if not finite or np.isfinite(array).all() else "found numbers that are not finite, wanted finite ones"


def _wrong_names(found: Any, wanted: set[str]) -> str:
    names = ", ".join(sorted(wanted))
    if not isinstance(found, Mapping) or set(found) != wanted:
        return f"found {_shown(found)}, wanted numbers for {names}"
    return ""


def _shown(found: Any) -> str:
    if isinstance(found, np.ndarray):
        return f"an array of {found.dtype}, shape {found.shape}"
    text = repr(found)
    return text if len(text) <= 60 else f"{text[:60]}…"


class _Check:
    """What an effect's class says of itself, held against what it has to say."""

    def __init__(self, path: Path, kind: type[Effect]) -> None:
        self._path, self._kind = path, kind
        self._lines = _lines_of(path, kind.__name__)

    def all(self) -> None:
        """Raises BadInput for the first thing that is wrong."""
        for name, wrong in self._wrongs():
            line = self._lines.get(name, self._lines[""])
            raise BadInput(f"{self._path}:{line}: {name}: {wrong}")

    def _wrongs(self) -> Iterator[tuple[str, str]]:
        yield from self._misspelled()
        if getattr(self._kind, "stage", None) not in get_args(Stage):
            yield "stage", f"found {self._said('stage')}, wanted one of {', '.join(get_args(Stage))}"
        for name in TEXTS:
            text = getattr(self._kind, name, None)
            if not isinstance(text, str) or not text:
                yield name, f"found {self._said(name)}, wanted a text"
        for name, known in (("quantities", BOTH), ("places", EVERYWHERE)):
            given = getattr(self._kind, name)
            if not isinstance(given, tuple) or not set(given) <= set(known):
                yield name, f"found {self._said(name)}, wanted a tuple of {', '.join(known)}"
        for name, kind in (("coordinates", Coordinate), ("parameters", Parameter), ("confused_with", str)):
            given = getattr(self._kind, name)
            if not isinstance(given, tuple) or not all(isinstance(one, kind) for one in given):
                yield name, f"found {self._said(name)}, wanted a tuple of {kind.__name__}"
        yield from self._numbers()
        yield from self._translation()

    def _misspelled(self) -> Iterator[tuple[str, str]]:
        """Names so like one of an effect's that they are meant to be it."""
        known = [name for name in dir(Effect) if not name.startswith("_")] + [*TEXTS, "stage"]
        for name in vars(self._kind):
            near = [] if name in known else difflib.get_close_matches(name, known, 1, MISSPELLED)
            if near and not name.startswith("_"):
                yield name, f"found a name that no effect has, wanted {near[0]}"

    def _numbers(self) -> Iterator[tuple[str, str]]:
        for one in self._kind.coordinates:
            if not _finite(one.step) or one.step <= 0.0:
                yield "coordinates", f"found the step {one.step!r} of {one.name}, wanted a number above 0"
            if not isinstance(one.starts, tuple) or not one.starts or not all(map(_finite, one.starts)):
                yield "coordinates", f"found the starts {one.starts!r} of {one.name}, wanted a tuple of numbers"
        for each in self._kind.parameters:
            for what, pair in (("bounds", each.bounds), ("typical", each.typical)):
                if not isinstance(pair, tuple) or len(pair) != 2 or not all(map(_number, pair)) or pair[0] > pair[1]:
                    yield "parameters", f"found {what} {pair!r} of {each.name}, wanted two numbers, the lower first"
            if not isinstance(each.unit, str):
                yield "parameters", f"found the unit {each.unit!r} of {each.name}, wanted a text, '' for a pure number"

    def _translation(self) -> Iterator[tuple[str, str]]:
        """Coordinates and parameters of other names need methods that turn one into the other."""
        coordinates = {one.name for one in self._kind.coordinates}
        parameters = {one.name for one in self._kind.parameters}
        if coordinates == parameters:
            return
        for name in ("physical", "from_physical"):
            if getattr(self._kind, name) is getattr(Effect, name):
                said = ", ".join(sorted(coordinates ^ parameters))
                yield "parameters", f"found {said} in coordinates or parameters only, wanted the same names, or {name}"

    def _said(self, name: str) -> str:
        return _shown(getattr(self._kind, name)) if hasattr(self._kind, name) else "nothing"


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not math.isnan(value)


def _finite(value: Any) -> bool:
    return _number(value) and math.isfinite(value)


def _lines_of(path: Path, kind: str) -> dict[str, int]:
    """Line of every name that a class states, and under '' of the class itself."""
    tree = ast.parse(path.read_bytes())
    found = {"": 1}
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef) and node.name == kind:
            found[""] = node.lineno
            for part in node.body:
                targets = part.targets if isinstance(part, ast.Assign) else [getattr(part, "target", None)]
                names = [one.id for one in targets if isinstance(one, ast.Name)]
                found |= dict.fromkeys(
                    [*names, *([part.name] if isinstance(part, ast.FunctionDef) else [])], part.lineno
                )
    return found
