"""Qualify: a calibrated unit carries its calibration to others that were on the bench with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli.onward import Carried, command, completed, say_next
from rig.cli.options import effects_option, json_option, print_json, runs_option

if TYPE_CHECKING:
    from rig.calibrate.calibration import Calibration
    from rig.calibrate.qualifying import Against


@click.command()
@click.argument("names", metavar="RUN...", nargs=-1, required=True)
@click.option("--by", "known", metavar="CALIBRATION", required=True, help="Calibration of the reference unit.")
@click.option("--reference", metavar="UNIT", required=True, help="That unit's name in the sensor file.")
@click.option("--unit", "units", metavar="UNIT", multiple=True, help="What is calibrated (all others of its kind).")
@click.option("--last", metavar="CALIBRATION", help="Their last calibration, to compare with; else the data sheet.")
@click.option("--name", cls=Carried, help="Name of the calibration.", show_default="the unit's serial and the day")
@effects_option
@runs_option
@json_option
def qualify(
    names: tuple[str, ...], known: str, reference: str, units: tuple[str, ...], last: str | None, name: str | None,
    effects: Path | None, runs: Path, as_json: bool,
) -> None:  # fmt: skip
    """Calibrate units by another one that rode with them and is calibrated; the bench's own reference cancels.

    RUN as for `rig calibrate`: runs in which all of them were recorded. Sensitivities, zero outputs and lags come with
    a budget that holds the reference unit's own calibration, and with En against the last calibration or the data
    sheet. The result is a calibration like any other, for `rig export` and
    `rig compare-calibrations`. Exit code 3 if a value lies outside its limits by more than its expanded uncertainty.

    \f
    `--json` gives `calibration`, `path`, `reference`, `by`, `results` as `rig calibrate` has them, and `against`: a
    list of `key`, `stated`, `unit`, `source`, `en`, `agrees`.
    """
    from dataclasses import replace

    from rig.calibrate.calibration import load, path_of, save
    from rig.calibrate.qualifying import against, qualified
    from rig.cli.calibration import calibrated, refuse_failed

    before = None if last is None else load(path_of(runs, last))
    master = load(path_of(runs, known))
    ride, _ = calibrated(names, runs, name, None, effects)
    made = replace(qualified(ride, master, reference, units), name=ride.name)
    path = path_of(runs, made.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    save(made, path)
    rows = list(against(made, before))
    if as_json:
        print_json(_as_json(made, path, reference, known, rows))
    else:
        click.echo("\n".join(_text(made, reference, known, rows)))
        click.echo(f"calibration: {path}")
        say_next(command("compare-calibrations", known, made.name), command("export", made.name, "--to", "csv"))
    refuse_failed(made)


def _text(made: Calibration, reference: str, known: str, rows: list[Against]) -> list[str]:
    from rig.calibrate.calibration import text

    en = {row.key: f"En {row.en:+.2f} against the {row.source}" for row in rows}
    shown = [row for row in made.results if row.measurand in ("sensitivity", "offset", "lag")]
    width = max(len(row.key) for row in shown)
    mark = "  SIMULATED" if made.simulated else ""
    lines = [f"calibration {made.name} of {made.sensor} {made.serial}, by {reference} as in {known}{mark}", ""]
    lines += [f"  {row.key:<{width}}  {text(row):<26} {en.get(row.key, '')}".rstrip() for row in shown]
    apart = [row.key for row in rows if not row.agrees]
    lines += ["", f"  {len(rows) - len(apart)} of {len(rows)} agree with what was stated of them"]
    lines += [f"  apart: {', '.join(apart)}"] if apart else []
    lines += [f"  note: {flag}" for flag in made.flags]
    return [completed(line) for line in lines]


def _as_json(made: Calibration, path: Path, reference: str, known: str, rows: list[Against]) -> dict[str, Any]:
    from rig.cli.calibration import row_of

    return {
        "calibration": made.name, "path": str(path), "reference": reference, "by": known,
        "results": [row_of(one) for one in made.results], "against": [row.as_json() for row in rows],
    }  # fmt: skip
