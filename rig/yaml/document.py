"""A YAML file with its positions: plain data, and the line and column where each key stands.

The YAML is a strict subset of YAML 1.2: no anchors, aliases or tags, no key twice; `yes`, `no`, `on`, `12:30`, `0123`
and dates are text. A file that is anything else is refused with line, column, what was found and what was wanted.
"""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import yaml

from rig.errors import ConfigError, Problem

KeyPath = tuple[str | int, ...]
DEEPEST = 50  # levels of nesting; a rig file has five
LONGEST_NUMBER = 30  # characters
LARGEST = 500_000  # bytes; reading takes seconds for each million, and a rig file has a few thousand

_INT = re.compile(r"[-+]?(?:0|[1-9][0-9]*|0x[0-9a-fA-F]+)")
_FLOAT = re.compile(r"[-+]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_SURROGATE = re.compile("[\ud800-\udfff]")


@dataclass(frozen=True)
class Document:
    """A YAML file that was read: its plain `data`, and where each key stands.

    `data` is made of dict, list, str, int, float, bool and None.
    """

    file: str
    root: yaml.Node
    data: Any

    def node(self, path: KeyPath) -> yaml.Node | None:
        """The node at a path of keys and indices, None if the file has none."""
        node: yaml.Node | None = self.root
        for part in path:
            node = _child(node, part)
        return node

    def locate(self, path: KeyPath) -> tuple[int, int]:
        """Line and column (from one) of the value at `path`, or of the nearest thing around it that is in the file."""
        while path and self.node(path) is None:
            path = path[:-1]
        return _position((self.node(path) or self.root).start_mark)

    def problem(self, path: KeyPath, text: str) -> Problem:
        """A mistake at `path`; `text` is `found …, wanted …`."""
        return Problem(self.file, *self.locate(path), dotted(path), text)


def dotted(path: KeyPath) -> str:
    """A path as a reader wants it: ("steps", 2, "stop") is `steps[2].stop`."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")


def read(path: Path) -> Document:
    """Read a YAML file; raises ConfigError if it cannot be read or is not YAML."""
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        _fail(str(path), 1, 1, "found no such file, wanted a YAML file")
    except IsADirectoryError:
        _fail(str(path), 1, 1, "found a folder, wanted a YAML file")
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL in it
        reason = getattr(error, "strerror", None) or error
        _fail(str(path), 1, 1, f"found that it cannot be read ({reason}), wanted a readable YAML file")
    if len(raw) > LARGEST:
        _fail(str(path), 1, 1, f"found {len(raw) / 1e6:.1f} MB, wanted a file of at most {LARGEST / 1e6:g} MB")
    try:
        text = raw.removeprefix(codecs.BOM_UTF8).decode()
    except UnicodeDecodeError as error:
        line, column = _offset(error.object[: error.start].decode())
        _fail(str(path), line, column, f"found byte 0x{error.object[error.start]:02x}, wanted text in UTF-8")
    return read_text(text, str(path))


def read_text(text: str, name: str) -> Document:
    """Read YAML from a text; `name` stands for the file in messages. Raises ConfigError."""
    loader = _loader(text, name)
    try:
        root = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark or loader.get_mark()
        _fail(name, *_position(mark), _yaml_mistake(error.problem or error.context or "nothing"))
    except (yaml.YAMLError, ValueError, OverflowError, LookupError, TypeError, AttributeError) as error:
        # PyYAML lets these out on input that it does not foresee, such as the escape "\UFFFFFFFF".
        _fail(name, *_position(loader.get_mark()), f"found invalid YAML ({error}), wanted valid YAML")
    if root is None:
        _fail(name, 1, 1, "found an empty document, wanted keys and values")
    if problems := [Problem(name, *_position(m), dotted(p), text) for m, p, text in _refused(root, ())]:
        raise ConfigError(problems)
    return Document(name, root, _value(root))


def written(body: Mapping[str, Any]) -> str:
    """Plain data as YAML text, in their order; also what a journal's lines hold, which is a dict of another sort."""
    return str(yaml.dump(body, Dumper=_Writer, allow_unicode=True, sort_keys=False))


class _Writer(yaml.SafeDumper):
    """Writes every sort of dict like a dict."""


_Writer.add_multi_representer(dict, yaml.SafeDumper.represent_dict)


class _StrictLoader(yaml.SafeLoader):
    """Composes nodes only; refuses anchors, aliases, tags and bottomless nesting where they stand."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - PyYAML's own name; scalars are read by `_value`
    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if getattr(event, "anchor", None) is not None:  # an alias has one too
            _refuse(event, "found an anchor or alias, wanted the value written out")
        if getattr(event, "tag", None) is not None:
            _refuse(event, f"found the tag '{event.tag}', wanted a plain value")
        self.depth += 1
        if self.depth > DEEPEST:
            _refuse(event, f"found more than {DEEPEST} levels, wanted a flatter file")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


def _refuse(event: Any, problem: str) -> NoReturn:
    raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)


def _loader(text: str, name: str) -> _StrictLoader:
    try:
        return _StrictLoader(text)
    except yaml.reader.ReaderError as error:
        line, column = _offset(text[: error.position])
        _fail(name, line, column, f"found the character U+{ord(text[error.position]):04X}, wanted printable text")


def _fail(file: str, line: int, column: int, text: str) -> NoReturn:
    raise ConfigError([Problem(file, line, column, "", text)]) from None


def _position(mark: yaml.Mark) -> tuple[int, int]:
    return mark.line + 1, mark.column + 1


def _offset(before: str) -> tuple[int, int]:
    return before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1


def _yaml_mistake(problem: str) -> str:
    """PyYAML's sentence in the order found, wanted."""
    if problem.startswith("found ") and ", wanted " in problem:
        return problem
    if r"'\t'" in problem:
        return "found a tab, wanted spaces"
    if "<block" in problem:
        return "found an indentation that fits nothing above it, wanted keys of one mapping in one column"
    if expected := re.fullmatch(r"(?:while .*?, )?expected (.+?), but (?:got|found) (.+)", problem):
        return f"found {expected[2]}, wanted {expected[1]}"
    if problem.startswith("mapping values are not allowed"):
        return "found a second ':' on one line, wanted quotes around the text, or a new line"
    if problem == "but found another document":
        return "found a second document, wanted one"
    found = problem.removeprefix("found ")
    return f"found {found}, wanted valid YAML"


def _child(node: yaml.Node | None, part: str | int) -> yaml.Node | None:
    if isinstance(node, yaml.MappingNode):
        return next((value for key, value in node.value if key.value == str(part)), None)
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and 0 <= part < len(node.value):
        child: yaml.Node = node.value[part]
        return child
    return None


def _refused(node: yaml.Node, path: KeyPath) -> Iterator[tuple[yaml.Mark, KeyPath, str]]:
    """Everything that YAML allows and a rig file does not: keys twice, odd keys, numbers that are none."""
    if isinstance(node, yaml.MappingNode):
        yield from _refused_keys(node, path)
        for key, value in node.value:
            yield from _refused(value, (*path, str(key.value)))
    elif isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            yield from _refused(item, (*path, index))
    elif isinstance(node, yaml.ScalarNode) and (text := _refused_scalar(node)):
        yield node.start_mark, path, text


def _refused_keys(node: yaml.MappingNode, path: KeyPath) -> Iterator[tuple[yaml.Mark, KeyPath, str]]:
    first: dict[str, yaml.Mark] = {}
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            yield key.start_mark, path, f"found {shown(key)} as a key, wanted plain text"
        elif key.value in first:
            line = first[key.value].line + 1
            yield key.start_mark, (*path, key.value), f"found the key twice (first in line {line}), wanted it once"
        elif _SURROGATE.search(key.value):
            yield key.start_mark, path, "found half a character in a key, wanted text"
        else:
            first[key.value] = key.start_mark


def _refused_scalar(node: yaml.ScalarNode) -> str | None:
    if _SURROGATE.search(node.value):
        return "found half a character, wanted text"
    if node.style is not None or not (_INT.fullmatch(node.value) or _FLOAT.fullmatch(node.value)):
        return None
    if len(node.value) > LONGEST_NUMBER:
        return f"found a number of {len(node.value)} characters, wanted at most {LONGEST_NUMBER}"
    if isinstance(number := _plain(node.value), float) and not math.isfinite(number):
        return f"found '{node.value}', wanted a number that a computer can hold"
    return None


def _value(node: yaml.Node) -> Any:
    """Plain data of a node that `_refused` found nothing in."""
    if isinstance(node, yaml.MappingNode):
        return {key.value: _value(value) for key, value in node.value}
    if isinstance(node, yaml.SequenceNode):
        return [_value(item) for item in node.value]
    return _plain(node.value) if _unquoted(node) else node.value


def _unquoted(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and node.style is None


_WORDS: Mapping[str, bool | None] = {"": None, "~": None, "null": None, "true": True, "false": False}


def _plain(text: str) -> str | int | float | bool | None:
    """An unquoted scalar."""
    if text in _WORDS:
        return _WORDS[text]
    if _INT.fullmatch(text):
        return int(text, 0)
    return float(text) if _FLOAT.fullmatch(text) else text


def shown(node: yaml.Node) -> str:
    """What stands in the file, for the `found` half of a message."""
    if isinstance(node, yaml.MappingNode):
        return "a mapping of keys"
    if isinstance(node, yaml.SequenceNode):
        return "a list"
    if _unquoted(node) and node.value in ("", "~", "null"):
        return "nothing"
    return f"'{node.value}'" if len(node.value) <= 60 else f"'{node.value[:60]}…'"
