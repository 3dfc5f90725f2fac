"""Pages and schemas of the reference that the code makes: `make pages` writes them, tests/rig/test_pages.py compares.

A command's text is its docstring. What stands behind a form feed there is for the page alone, and is Markdown; so is
what a module of commands says of all of them, behind its first paragraph. A paragraph that begins with a backspace
alone on its line (click's mark for text that is not to be wrapped) is something to type.
"""

from __future__ import annotations

import importlib
import inspect
import json
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click
from pydantic import BaseModel

from fixtures import world_file
from rig.bench import assembly, procedure_file
from rig.bench.benchfile import SensorFile, Standard
from rig.bench.operators import Answers
from rig.certificate.issuer import Issuer
from rig.cli import EXIT_CODES, SECTIONS, cli
from rig.cli.effects import reference_page
from rig.cli.onward import Carried
from rig.foreign.manifest import KINDS, Manifest
from rig.repair.model_file import Model
from rig.shelf import shelf
from rig.yaml.config import json_schema

ROOT = Path(__file__).parents[1]
SCHEMAS = "docs/reference/schemas"
MODELS: Mapping[str, Callable[[], type[BaseModel]]] = {
    "laboratory": lambda: Issuer,
    "answers": lambda: Answers,
    "bench": assembly.file_model,
    "manifest": lambda: Manifest,
    "model": lambda: Model,
    "procedure": procedure_file.file_model,
    "sensor": lambda: SensorFile,
    "standard": lambda: Standard,
}
MANIFEST = "docs/reference/manifest.md"
BEGIN, END = "<!-- kinds, made by `make pages` -->", "<!-- end of kinds -->"
SHARED = 5  # so many commands have an option in the same words: it is described once
HEAD = """\
# Commands

<!-- Made by `make pages` from the commands in rig/cli; changes here are lost. -->

`rig --help` lists the commands, `rig COMMAND --help` says what stands here, `rig --version` which program it is.
Results go to standard output; messages of errors, and the progress line, go to standard error.

`RUN` is a run's name, or `last` for the newest. What a command prints after `next:`, and a command between backticks in
a message, runs as it stands in the same shell and folder:
{carried}
go along where they were given.

## Exit codes"""


def files() -> dict[str, str]:
    """Every page that the code makes, by its path in the repository."""
    made = {f"{SCHEMAS}/{name}.json": as_text(schema) for name, schema in schemas().items()}
    return {
        "docs/reference/commands.md": commands_page(), "docs/reference/effects.md": reference_page(shelf()),
        MANIFEST: manifest_page((ROOT / MANIFEST).read_text(encoding="utf-8")), **made,
    }  # fmt: skip


def manifest_page(page: str) -> str:
    """The page of manifests with its table of kinds anew; the rest is written by hand."""
    rows = [(f"`{name}`", kind.done, kind.needs) for name, kind in KINDS.items()]
    before, _, rest = page.partition(BEGIN)
    table = _table(("kind", "what was done", "needs"), rows)
    return f"{before}{BEGIN}\n\n{table}\n\n{END}{rest.partition(END)[2]}"


def schemas() -> dict[str, dict[str, Any]]:
    """The JSON schema of every kind of YAML file that people write, by the kind's name."""
    return {**{name: json_schema(model()) for name, model in MODELS.items()}, "world": world_file.schema()}


def as_text(schema: dict[str, Any]) -> str:
    """A schema as its file has it."""
    return json.dumps(schema, ensure_ascii=False, indent=1) + "\n"


def commands_page() -> str:
    """`docs/reference/commands.md`: every command with its text, arguments and options, as the parser has them."""
    every = [ctx for names in SECTIONS.values() for ctx in contexts(names)]
    carried = dict.fromkeys(one.opts[-1] for ctx in every for one in options(ctx) if isinstance(one, Carried))
    shared = _shared(every)
    parts = [HEAD.format(carried=_listed(f"`{one}`" for one in carried))]
    parts += [_table(("code", "meaning"), ((str(code), _plain(text)) for code, text in EXIT_CODES.items()))]
    parts += ["## Options that several commands have", _options_table(shared)]
    for title, names in SECTIONS.items():
        parts += [f"## {title}", *_said_of_all(module for module, _ in names.values())]
        parts += [part for ctx in contexts(names) for part in _entry(ctx, shared)]
    return "\n\n".join(parts) + "\n"


def contexts(names: Iterable[str]) -> Iterator[click.Context]:
    """Every command of these names, each of a group's by itself, as if it were called."""
    root = click.Context(cli, info_name="rig")
    for name in names:
        command = cli.get_command(root, name)
        assert command is not None, name
        yield from _inside(click.Context(command, root, name))


def _inside(ctx: click.Context) -> Iterator[click.Context]:
    if not isinstance(ctx.command, click.Group):
        yield ctx
        return
    for name, command in ctx.command.commands.items():
        yield from _inside(click.Context(command, ctx, name))


def options(ctx: click.Context) -> list[click.Option]:
    """The options of a command, `--help` excepted."""
    return [one for one in ctx.command.params if isinstance(one, click.Option)]


def record(ctx: click.Context, option: click.Option) -> tuple[str, str]:
    """An option with its value, and what it does, its default and its limits: as `--help` has them."""
    found = option.get_help_record(ctx)
    assert found is not None, (ctx.command_path, option.name)
    return found


def text_of(ctx: click.Context) -> tuple[str, str]:
    """What a command says of itself: in `--help`, and besides on the page."""
    shown, _, more = inspect.cleandoc(ctx.command.help or "").partition("\f")
    return shown.strip(), more.strip()


def examples(path: str) -> list[Any]:
    """The JSON that the page shows of one command, e.g. `rig bench check`, and of all commands of its module."""
    ctx = next(one for one in contexts([path.split()[1]]) if one.command_path == path)
    texts = (text_of(ctx)[1], str(sys.modules[str(ctx.command.callback.__module__)].__doc__))
    blocks = (one for text in texts for one in re.findall(r"^```json\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    return [json.loads(one) for one in blocks]


def assert_shown(found: Any, example: Any, where: str = "") -> None:
    """That what a command printed has the keys of its example; where one of them holds nothing there are none."""
    if isinstance(found, dict) and isinstance(example, dict) and found and example:
        assert set(found) == set(example), where
        for key, value in found.items():
            assert_shown(value, example[key], f"{where}.{key}")
    elif isinstance(found, list) and isinstance(example, list) and found and example:
        assert_shown(found[0], example[0], f"{where}[]")


def _shared(every: Iterable[click.Context]) -> dict[str, str]:
    """Options that several commands have in the same words, by their records."""
    count = Counter(record(ctx, option) for ctx in every for option in options(ctx))
    return {names: said for (names, said), number in count.items() if number >= SHARED}


def _said_of_all(modules: Iterable[str]) -> Iterator[str]:
    """What the modules of a section say of all their commands."""
    for name in dict.fromkeys(modules):
        _, _, more = inspect.cleandoc(importlib.import_module(f"rig.cli.{name}").__doc__ or "").partition("\n\n")
        if more:
            yield more.strip()


def _entry(ctx: click.Context, shared: dict[str, str]) -> Iterator[str]:
    """One command: usage, text, options."""
    yield f"### {ctx.command_path}"
    yield f"```text\n{' '.join([ctx.command_path, *ctx.command.collect_usage_pieces(ctx)])}\n```"
    shown, more = text_of(ctx)
    yield from (_paragraph(one) for one in shown.split("\n\n"))
    records = dict(record(ctx, option) for option in options(ctx))
    own = {names: said for names, said in records.items() if shared.get(names) != said}
    if own:
        yield _options_table(own)
    others = [f"`{names.split()[0]}`" for names in records if names not in own]
    if others:
        yield f"{'And' if own else 'Options:'} {_listed(others)}, as above."
    if more:
        yield more


def _paragraph(text: str) -> str:
    if text.startswith("\b\n"):
        return f"```text\n{inspect.cleandoc(text[2:])}\n```"
    return _plain(" ".join(text.split()))


def _plain(text: str) -> str:
    """Text of a terminal as Markdown that shows the same."""
    pieces = text.split("`")  # between backticks it stays as it is
    pieces[::2] = [re.sub(r"[<>*_\[\]]", r"\\\g<0>", one) for one in pieces[::2]]
    return "`".join(pieces)


def _options_table(records: dict[str, str]) -> str:
    return _table(("option", "meaning"), ((f"`{names}`", _plain(said)) for names, said in records.items()))


def _table(heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [heads, ("---",) * len(heads), *(tuple(cell.replace("|", r"\|") for cell in row) for row in rows)]
    return "\n".join(f"| {' | '.join(row)} |" for row in lines)


def _listed(names: Iterable[str]) -> str:
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last


def main() -> None:
    for path, text in files().items():
        if not (ROOT / path).exists() or (ROOT / path).read_text(encoding="utf-8") != text:
            (ROOT / path).parent.mkdir(parents=True, exist_ok=True)
            (ROOT / path).write_text(text, encoding="utf-8")
            sys.stdout.write(f"{path}\n")


if __name__ == "__main__":
    main()
