"""Commands about runs that exist: runs, show, verify."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rig.cli.onward import command, say_next
from rig.cli.options import json_option, print_json, runs_option


@click.command()
@runs_option
@json_option
def runs(runs: Path, as_json: bool) -> None:
    """List the runs, oldest first.

    \f
    `--json` gives a list of what `rig show --json` prints.
    """
    from rig.archive.runs import Runs
    from rig.cli import outcome

    rows = [run.summary() for run in Runs(runs).list()]
    if as_json:
        print_json(rows)
        return
    if not rows:
        click.echo(f"no runs in {runs} yet")
        say_next(command("sweep", "--axis", "x"))
        return
    said = [outcome.status_text(row) for row in rows]
    width, wide = max(len(row["run"]) for row in rows), max(11, *map(len, said))
    for row, status in zip(rows, said, strict=True):
        mark = ("  SIMULATED" if row["simulated"] else "") + ("  NOT SAFE" if row["not_safe"] else "")
        done, total = ("?" if row[key] is None else row[key] for key in ("points_done", "points_total"))
        click.echo(f"{row['run']:<{width}}  {status:<{wide}}  {done:>4} of {total:<4}{mark}")
    say_next(command("show", rows[-1]["run"]))


@click.command()
@click.argument("name", metavar="[RUN]", default="last")
@runs_option
@json_option
def show(name: str, runs: Path, as_json: bool) -> None:
    """Show one run: what it is, how far it came, and what was measured. Without RUN it is the newest.

    \f
    ```json
    {"run": "2026-11-24T130059-sweep-x", "procedure": "frequency_sweep", "status": "completed", "points_done": 48,
     "points_total": 48, "simulated": true, "path": "runs/2026-11-24T130059-sweep-x", "not_safe": null, "unmet": []}
    ```

    `status` is one of the [states](../explanation/records-and-durability.md#seal-and-states). In a damaged run what is
    unknown is `null`. `not_safe` says what the run left energised, as far as is known by the log of its guard. `unmet`
    lists what an `expect` missed when the run was concluded, and what was measured and cannot be believed. An imported
    run has `findings` besides, as `rig import` gives them.
    """
    from rig.archive.runs import Runs
    from rig.cli import outcome

    run = Runs(runs).open(name)
    if as_json:
        print_json({**run.summary(), **outcome.findings_as_json(run)})
    else:
        click.echo(outcome.run_as_text(run))
    if found := run.summary()["not_safe"]:
        click.secho(f"NOT SAFE: {found}", fg="red", bold=True, err=True)


@click.command()
@click.argument("name", metavar="[RUN]", default="last")
@runs_option
@json_option
def verify(name: str, runs: Path, as_json: bool) -> None:
    """Check every digest of RUN, or of the newest run; exit code 1 if anything does not agree.

    \f
    ```json
    {"run": "2026-11-24T130059-sweep-x", "status": "completed", "sound": true, "problems": []}
    ```
    """
    from rig.archive.runs import Runs
    from rig.errors import ArchiveError

    run = Runs(runs).open(name)
    problems = run.verify()
    if as_json:
        print_json({"run": run.name, "status": run.status, "sound": not problems, "problems": problems})
    elif not problems:
        click.echo(f"{run.name}: sound ({run.status}; {_counted(run)})")
        say_next(command("resume" if run.status == "interrupted" else "show", run.name))
    if problems:
        raise ArchiveError(f"{run.name}: " + "; ".join(problems))


def _counted(run: Any) -> str:
    blocks = run.blocks()
    return f"{sum(1 for _ in run.lines())} journal lines, {sum(len(parts) for parts in blocks.values())} blocks"
