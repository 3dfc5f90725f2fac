"""Pages that the code makes are what it makes today, and leave out no command, option, default or exit code."""

from __future__ import annotations

import json
from typing import Any

import click
import pages
import pytest
from click.testing import CliRunner

from rig.bench.procedure_file import procedures
from rig.cli import COMMANDS, EXIT_CODES, cli, measure
from rig.errors import RigError

EVERY = list(pages.contexts(COMMANDS))
MEASURING = {"sweep": ("--axis", "x"), "turntable": (), "noise": (), "tumble": ()}  # and what each cannot do without


@pytest.fixture(autouse=True)
def _nothing_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RIG_EFFECTS", "RIG_RUNS", "RIG_BENCH"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize("path", pages.files())
def test_a_committed_page_is_what_the_code_makes(path: str) -> None:
    assert (pages.ROOT / path).read_text(encoding="utf-8") == pages.files()[path], "make pages"


def test_an_option_that_is_added_to_a_command_changes_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    before = pages.commands_page()
    command = next(ctx.command for ctx in EVERY if ctx.command_path == "rig bench serve")
    monkeypatch.setattr(command, "params", [*command.params, click.Option(["--loud"], help="Say more.")])
    after = pages.commands_page()
    assert set(after.splitlines()) - set(before.splitlines()) == {"| `--loud TEXT` | Say more. |"}


@pytest.mark.parametrize("ctx", EVERY, ids=lambda ctx: ctx.command_path)
def test_the_page_has_every_command_with_what_its_help_says(ctx: click.Context) -> None:
    _, found, rest = pages.commands_page().partition(f"### {ctx.command_path}\n")
    assert found
    entry = rest.partition("\n### ")[0]
    for option in pages.options(ctx):
        assert f"`{option.opts[-1]}" in entry or f"`{option.opts[0]}" in entry
    words = [word for word in pages.text_of(ctx)[0].split() if word.isalpha()]
    assert words
    assert not [word for word in words if word not in entry]


@pytest.mark.parametrize("ctx", EVERY, ids=lambda ctx: ctx.command_path)
def test_a_command_says_what_it_does_with_all_that_it_is_given(ctx: click.Context) -> None:
    for one in ctx.command.params:
        if isinstance(one, click.Argument):
            assert one.make_metavar(ctx).strip("[].") in pages.text_of(ctx)[0], f"nothing of {one.name}"
        elif isinstance(one, click.Option):
            assert one.help, f"nothing of {one.opts[0]}"


def settings(monkeypatch: pytest.MonkeyPatch, command: str, *words: str) -> Any:
    """Settings of the procedure that a command line means."""
    bodies: list[dict[str, Any]] = []
    monkeypatch.setattr(measure, "_measure_document", lambda body, *_: bodies.append(body))
    CliRunner().invoke(cli, [command, *words], catch_exceptions=False, standalone_mode=False)
    (body,) = bodies
    return procedures()[body["procedure"]].Settings.model_validate_json(json.dumps(body), strict=True)


@pytest.mark.parametrize("command", MEASURING)
def test_the_defaults_that_help_states_are_those_of_the_procedure(
    monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    (ctx,) = pages.contexts([command])
    needed = MEASURING[command]
    stated = [one for one in pages.options(ctx) if one.show_default and not one.envvar]
    assert stated
    for option in stated:
        text = str(option.show_default if isinstance(option.show_default, str) else option.default)
        assert text in pages.record(ctx, option)[1].partition("default: ")[2]
        given = settings(monkeypatch, command, *needed, option.opts[0], text)
        assert given == settings(monkeypatch, command, *needed), option.opts[0]


def test_every_exit_code_is_listed_and_no_other() -> None:
    def below(kind: type[RigError]) -> set[int]:
        return {kind.exit_code}.union(*(below(one) for one in kind.__subclasses__()))

    done, interrupted, unread = 0, 130, 141
    assert set(EXIT_CODES) == below(RigError) | {done, interrupted, unread}
    said = CliRunner().invoke(cli, ["--help"]).stdout
    assert all(f"  {code} " in said for code in EXIT_CODES)


def test_help_lists_every_command_once() -> None:
    said = CliRunner().invoke(cli, ["--help"]).stdout.splitlines()
    assert [line.split()[0] for line in said if line.startswith("  ") and line.split()[0] in COMMANDS] == list(COMMANDS)
