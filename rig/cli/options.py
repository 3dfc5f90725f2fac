"""Options that several commands share."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from rig.cli.onward import Carried

F = TypeVar("F", bound=Callable[..., Any])
MODEL = click.option(
    "--model",
    cls=Carried,
    type=click.Path(dir_okay=False, path_type=Path),
    show_default="models/<serial>.yaml of the runs folder",
    help="Model file.",
)


def bench_option(command: F) -> F:
    """Which bench: `--bench`, RIG_BENCH, ./bench.yaml if there is one, else the simulated bench."""
    return click.option(
        "--bench",
        "bench",
        cls=Carried,
        type=click.Path(dir_okay=False, path_type=Path),
        envvar="RIG_BENCH",
        show_envvar=True,
        show_default="./bench.yaml if it exists, else the simulated bench",
        help="Bench file.",
    )(command)


def runs_option(command: F) -> F:
    """Where runs are kept."""
    return click.option(
        "--runs",
        "runs",
        cls=Carried,
        type=click.Path(file_okay=False, path_type=Path),
        envvar="RIG_RUNS",
        show_envvar=True,
        default=Path("runs"),
        show_default=True,
        help="Folder of the runs.",
        callback=_noted,
    )(command)


def _noted(ctx: click.Context, parameter: click.Parameter, runs: Path) -> Path:
    """The folder of runs that the whole invocation is about."""
    from rig.cli import RUNS

    ctx.meta[RUNS] = runs
    return runs


def effects_option(command: F) -> F:
    """Effects of the user's own."""
    return click.option(
        "--effects",
        cls=Carried,
        type=click.Path(file_okay=False, path_type=Path),
        envvar="RIG_EFFECTS",
        show_envvar=True,
        help="Folder with effects of your own, one file each.",
    )(command)


def json_option(command: F) -> F:
    """One JSON object on stdout instead of text."""
    return click.option(
        "--json", "as_json", is_flag=True, help="One JSON value on stdout instead of text; numbers in SI."
    )(command)


def bench_path(given: Path | None) -> Path:
    """The bench file that the options mean."""
    from rig.yaml.config import shipped

    if given is not None:
        return given
    here = Path("bench.yaml")
    return here if here.exists() else shipped("benches/simulated.yaml")


def print_json(value: object) -> None:
    """One JSON object on stdout."""
    click.echo(json.dumps(value, ensure_ascii=False, indent=2 if os.isatty(1) else None))
