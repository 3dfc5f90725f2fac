"""Commands that a command prints for its reader: what to do next, and what a message advises.

Each runs as it stands, in the same shell and folder: options of the invocation that say which bench, runs, model and
effects are meant go along (those from the environment are there anyway), and everything is quoted for a shell. In a
message a command stands between backticks; it is completed where the message is shown.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from typing import Any

import click
from click.core import ParameterSource

NOTED = "rig.cli.onward"  # in the invocation's meta: texts of options by name
IN_BACKTICKS = re.compile(r"`(rig [^`]+)`")
BOTH = " && "  # between commands of which the second needs the first


class Carried(click.Option):
    """An option that goes along into the commands that are printed, as far as they have it too."""

    def process_value(self, ctx: click.Context, value: Any) -> Any:
        """The value as click makes it; noted if it was given in this invocation."""
        found = super().process_value(ctx, value)
        if ctx.get_parameter_source(str(self.name)) is ParameterSource.COMMANDLINE:
            _noted(ctx)[str(self.name)] = self.texts(found)
        return found

    def texts(self, value: Any) -> tuple[str, ...]:
        """What to print of it, once for each time that the option is given."""
        return tuple(map(str, value)) if self.multiple else (str(value),)


def carry(**values: object) -> None:
    """Have options go along as if they had been given in this invocation."""
    _noted(click.get_current_context()).update({name: (str(value),) for name, value in values.items()})


def command(*words: object) -> str:
    """`rig` with these words, which are quoted, and what has to go along."""
    return carrying(shlex.join(["rig", *map(str, words)]))


def carrying(line: str) -> str:
    """A line of one or more `rig …` commands, joined by `&&`, with what has to go along in each."""
    return BOTH.join(" ".join([one, *_options(one)]) for one in line.split(BOTH))


def completed(text: str) -> str:
    """A message in which every command between backticks carries what has to go along."""
    return IN_BACKTICKS.sub(lambda found: f"`{carrying(found[1])}`", text)


def again(*, without: str) -> str:
    """The command of this invocation as it was given, less one flag."""
    ctx = click.get_current_context()
    words = _names_of(ctx)
    named: list[str] = []
    for parameter in ctx.command.params:
        if ctx.get_parameter_source(str(parameter.name)) is not ParameterSource.COMMANDLINE:
            continue
        value = ctx.params.get(str(parameter.name))
        values = value if isinstance(value, tuple) else (value,)
        if isinstance(parameter, click.Argument):
            words += map(str, values)
        elif value is True and parameter.name != without:
            named.append(parameter.opts[0])
        elif value is not True:
            named += (word for one in values for word in (parameter.opts[0], str(one)))
    return shlex.join(["rig", *words, *named])


def _names_of(ctx: click.Context) -> list[str]:
    """Names of a command and the groups that it is in, without the program's."""
    return [] if ctx.parent is None else [*_names_of(ctx.parent), str(ctx.info_name)]


def say_next(*lines: str) -> None:
    """Print what to do next, one line for each command, the likeliest first."""
    click.echo("\n".join(f"next: {line}" for line in lines))


def _noted(ctx: click.Context) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = ctx.meta.setdefault(NOTED, {})
    return found


def _options(line: str) -> Iterator[str]:
    """Options that one command has to be given besides its own words, quoted."""
    ctx = click.get_current_context(silent=True)
    noted = {} if ctx is None else _noted(ctx)
    if ctx is None or not noted:
        return
    try:
        words = shlex.split(line)[1:]
    except ValueError:  # a message may quote anything
        return
    for option in _taken_by(ctx.find_root(), words):
        if option.name in noted and not set(option.opts).intersection(words):
            yield from (f"{option.opts[0]} {shlex.quote(text)}" for text in noted[option.name])


def _taken_by(root: click.Context, words: list[str]) -> list[Carried]:
    """Options of a command, given by its words, that can go along."""
    found: click.Command | None = root.command
    for word in words:
        if not isinstance(found, click.Group):
            break
        found = found.get_command(root, word)
    return [one for one in found.params if isinstance(one, Carried)] if found is not None else []
