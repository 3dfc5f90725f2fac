"""Commands that conclude: calibrate, certify, report, export, compare-calibrations.

A calibration merges runs of one unit and is kept in `calibrations/` of the runs folder; an older one is never
overwritten: a name that is taken gets a number. Imported runs are calibrated by the same commands: a sensitivity is
then the ratio to what the manifest states (unit `1`), an offset is in SI above the stated zero, and a note says "not
traceable" unless the manifest names a `standard`. They are merged with runs of a bench of the same serial number where
their numbers are volts; values are then in V per SI unit. How measurands are called: [measurands](measurands.md).

`calibrate` and `certify` end with exit code 3 if a value lies outside its limits by more than its expanded uncertainty,
has another sign than declared (`sign reversed`), or was measured and cannot be believed: a channel that is stuck, poses
that were others than asked for. Such a row has no value, says why in `remarks`, and its verdict is `inconclusive`. What
was made is written all the same. An inconclusive verdict on a value is not a failure.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from rig.cli.onward import Carried, command, completed, say_next
from rig.cli.options import effects_option, json_option, print_json, runs_option

if TYPE_CHECKING:
    from rig.archive.records import Records
    from rig.calibrate.calibration import Calibration, Result
    from rig.calibrate.cube_route import Recorder
    from rig.calibrate.fitted import Assumed

RUN_NAMES = click.argument("names", metavar="RUN...", nargs=-1, required=True)
MODEL = click.option(
    "--model", cls=Carried, metavar="FILE", type=click.Path(dir_okay=False, path_type=Path),
    show_default="models/<serial>.yaml of the runs folder if there is one",
    help="Model that the values stand on; `none` is the data sheet alone.",
)  # fmt: skip
NO_MODEL = Path("none")
NAME = click.option(
    "--name", cls=Carried, help="Name of the calibration.", show_default="the unit's serial and the day"
)
RECORDER = click.option(
    "--recorder",
    cls=Carried,
    type=click.Choice(["converter", "cube", "scope"]),
    show_default="converter, else scope, else cube",
    help="Which recorder the sensor is read from.",
)
FORMATS = ("kalibr", "ros2", "csv", "mat", "hdf5", "python", "c")


@click.command()
@RUN_NAMES
@NAME
@RECORDER
@click.option("--monte-carlo", is_flag=True, help="Check the budgets of sensitivities by GUM Supplement 1.")
@MODEL
@effects_option
@runs_option
@json_option
def calibrate(
    names: tuple[str, ...], name: str | None, recorder: str | None, monte_carlo: bool, model: Path | None,
    effects: Path | None, runs: Path, as_json: bool,
) -> None:  # fmt: skip
    """Merge runs of one unit (axes, remounts, both senses, tumbles, records at rest) into one calibration.

    RUN is a run's name, `last`, or `all` for every completed run in the folder. The calibration is written to
    calibrations/<name>.yaml under the runs folder; an older one is never overwritten.

    \f
    ```json
    {"calibration": "first", "path": "runs/calibrations/first.yaml", "serial": "SIM-CUBE-1", "simulated": true,
     "model": "data sheet", "runs": ["2026-11-24T160303-sweep-x"],
     "results": [{"key": "unit_a_x.sensitivity", "value": 0.06629, "unit": "V/(m/s²)", "u": 0.00033, "k": 1.96,
                  "expanded": 0.00065, "status": "determined", "verdict": "pass", "check": null, "method": "…",
                  "reference": "…", "remarks": []}],
     "flags": [], "overdue": []}
    ```

    `value` is `null` for what was not determined; `remarks` then say why. `check` is what a direct estimate makes of
    the same records (`value`, `u`, `delta`, `u_delta`, `agrees`), `null` without one. With `--monte-carlo` there is
    `monte_carlo`, a list of `key`, `low`, `high`, `budget_low`, `budget_high`, `agrees`.
    """
    from rig.calibrate.calibration import MISSING, path_of, save

    made, _ = calibrated(names, runs, name, model, effects, recorder)
    path = path_of(runs, made.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    save(made, path)
    intervals = _intervals(made) if monte_carlo else []
    if as_json:
        print_json(_as_json(made, path) | ({"monte_carlo": intervals} if monte_carlo else {}))
    else:
        click.echo("\n".join([*text_of(made), *(_interval_text(one) for one in intervals)]))
        click.echo(f"calibration: {path}")
        lacking = any(MISSING in remark for result in made.results for remark in result.remarks)
        asked = [command("diagnose", *names)] if lacking and model != NO_MODEL else []
        say_next(*asked, command("certify", *names), command("report", *names), _exporting(made))
    refuse_failed(made)


def _intervals(made: Calibration) -> list[dict[str, Any]]:
    """Monte Carlo intervals beside the budgets' ones, SI."""
    from rig.calibrate.checking import checked

    return [
        {
            "key": one.key,
            "low": one.distribution.low,
            "high": one.distribution.high,
            "budget_low": (one.result.value or 0.0) - one.result.expanded,
            "budget_high": (one.result.value or 0.0) + one.result.expanded,
            "agrees": one.agrees,
        }
        for one in checked(made)
    ]


def _interval_text(one: dict[str, Any]) -> str:
    return (
        f"  GUM-S1 {one['key']}: {one['low']:.6g} to {one['high']:.6g}, budget {one['budget_low']:.6g} to "
        f"{one['budget_high']:.6g} (SI): {'agrees' if one['agrees'] else 'does not agree'}"
    )


@click.command()
@RUN_NAMES
@NAME
@RECORDER
@click.option("--out", type=click.Path(file_okay=False, path_type=Path), help="Folder.", show_default="reports/<name>")
@click.option(
    "--laboratory",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Who issues it, for whom, who signs: a file such as configs/laboratories/example.yaml.",
)
@MODEL
@effects_option
@runs_option
@json_option
def certify(
    names: tuple[str, ...], name: str | None, recorder: str | None, out: Path | None, laboratory: Path | None,
    model: Path | None, effects: Path | None, runs: Path, as_json: bool,
) -> None:  # fmt: skip
    """Calibrate from runs and write the certificate as PDF and as digital calibration certificate (DCC 3.2.1).

    RUN as for `rig calibrate`. Exit code 3 if a value does not keep its limits; both documents are written all the
    same.

    \f
    `--json` gives `calibration`, `pdf`, `dcc`, `simulated`.
    """
    from rig.calibrate.calibration import path_of, save
    from rig.certificate.dcc import write_dcc
    from rig.certificate.issuer import Issuer
    from rig.certificate.pdf import write_pdf
    from rig.report.run_figures import svg_of_response
    from rig.yaml import config

    issuer = None if laboratory is None else config.load(laboratory, Issuer)
    made, _ = calibrated(names, runs, name, model, effects, recorder)
    path = path_of(runs, made.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = out or runs / "reports" / made.name
    folder.mkdir(parents=True, exist_ok=True)
    pdf, dcc = folder / f"{made.name}.pdf", folder / f"{made.name}.xml"
    write_dcc(made, dcc, issuer)
    write_pdf(made, pdf, svg_of_response(made), issuer)
    save(made, path)
    if as_json:
        print_json({"calibration": made.name, "pdf": str(pdf), "dcc": str(dcc), "simulated": made.simulated})
    else:
        for label, written in (("certificate", pdf), ("digital certificate", dcc), ("calibration", path)):
            click.echo(f"{label}: {written}")
        say_next(_exporting(made), *_with_another(path))
    refuse_failed(made)


@click.command()
@click.argument("name", metavar="[CALIBRATION]", required=False)
@click.option("--to", "format", type=click.Choice(FORMATS), required=True, help="Format.")
@click.option(
    "--out",
    cls=Carried,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder.",
    show_default="reports/<name>",
)
@click.option(
    "--unit",
    cls=Carried,
    metavar="UNIT",
    help="Accelerometers, as the sensor file calls them.",
    show_default="the primary",
)
@click.option(
    "--gyro", cls=Carried, metavar="UNIT", help="Gyros, as the sensor file calls them.", show_default="the first"
)
@click.option(
    "--rate", cls=Carried, type=float, help="Samples per second of the robot: messages (Kalibr), records (a model)."
)
@click.option("--topic", cls=Carried, default="/imu0", show_default=True, help="ROS topic (Kalibr).")
@click.option(
    "--assume",
    cls=Carried,
    multiple=True,
    metavar="KEY=VALUE",
    help="A Kalibr value that no record determined; marked.",
)
@click.option(
    "--model", "written_model", type=click.Path(dir_okay=False, path_type=Path), help="Model file to write (python, c)."
)
@click.option(
    "--channel", "channels", cls=Carried, multiple=True, metavar="NAME", help="Only these channels of the model."
)
@click.option("--single", is_flag=True, help="Floats instead of doubles (c).")
@effects_option
@runs_option
@json_option
def export(
    name: str | None,
    format: str,
    out: Path | None,
    unit: str | None,
    gyro: str | None,
    rate: float | None,
    topic: str,
    assume: tuple[str, ...],
    written_model: Path | None,
    channels: tuple[str, ...],
    single: bool,
    effects: Path | None,
    runs: Path,
    as_json: bool,
) -> None:
    """Write CALIBRATION as Kalibr or ROS 2 YAML, CSV, MAT (v5), HDF5 or a Python module without dependencies.

    With --model, a repaired model is written instead, as a Python module or a header in C99 that turn volts into m/s²
    and rad/s: zero, sensitivity, temperature, supply, nonlinearity, cross-axis, lever arm, with --rate filters and
    delays too. What cannot be undone is said, here and in the file. `--to c` without --model takes models/<serial>.yaml
    of the calibration's unit.

    \f
    `--json` gives `calibration`, `format` and `files`; with a model `model`, `format`, `files` and `not_undone`.
    """
    from rig.calibrate.calibration import load, path_of
    from rig.errors import BadInput
    from rig.export import write

    if written_model is not None or format == "c":
        path = written_model or _model_of(name, runs)
        _export_model(path, format, out or runs / "reports" / path.stem, rate, channels, single, effects, as_json)
        return
    if name is None:
        raise BadInput("export: found neither a calibration nor --model, wanted one of them")
    if channels or single:
        raise BadInput("export: found --channel or --single without --model, wanted a model's file")
    made = load(path_of(runs, name))
    folder = out or runs / "reports" / name
    written = write(made, format, folder, unit=unit, gyros=gyro, rate=rate, topic=topic, assumed=_assumed(assume))
    if as_json:
        print_json({"calibration": name, "format": format, "files": [str(path) for path in written]})
        return
    for path in written:
        click.echo(f"{format}: {path}")
    say_next(command("export", name, "--to", "csv" if format != "csv" else "mat"))


def _model_of(name: str | None, runs: Path) -> Path:
    """The model of the unit that a calibration is of."""
    from rig.calibrate.calibration import load, path_of
    from rig.errors import BadInput
    from rig.repair.model_file import path_of as model_path_of

    if name is None:
        raise BadInput("export --to c: found no model, wanted --model FILE (made by `rig fit` or `rig add`)")
    return model_path_of(runs, load(path_of(runs, name)).serial)


def _export_model(
    path: Path, format: str, folder: Path, rate: float | None, channels: Sequence[str], single: bool,
    effects: Path | None, as_json: bool,
) -> None:  # fmt: skip
    from rig.export import write_model
    from rig.export.correction_numbers import stays
    from rig.repair.correction import correction_at
    from rig.shelf import shelf

    found = correction_at(path, shelf(effects))
    correction = found.only(channels) if channels else found
    written = write_model(correction, format, folder, rate=rate, single=single)
    kept = stays(correction, rate)
    if as_json:
        files = [str(one) for one in written]
        print_json({"model": str(path), "format": format, "files": files, "not_undone": kept})
        return
    for one in written:
        click.echo(f"{format}: {one}{'  SIMULATED' if correction.simulated else ''}")
    click.echo("\n".join(f"  note: {sentence}" for sentence in kept))
    say_next(command("export", "--model", path, "--to", "c" if format != "c" else "python"))


def _assumed(given: Sequence[str]) -> dict[str, float]:
    from rig.errors import BadInput

    found = {}
    for item in given:
        key, _, number = item.partition("=")
        try:
            found[key] = float(number)
        except ValueError:
            raise BadInput(f"--assume: found '{item}', wanted KEY=NUMBER in SI units") from None
    return found


@click.command()
@RUN_NAMES
@NAME
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path), help="File.", show_default="reports/<name>.html"
)
@MODEL
@effects_option
@runs_option
@json_option
def report(
    names: tuple[str, ...], name: str | None, out: Path | None, model: Path | None, effects: Path | None, runs: Path,
    as_json: bool,
) -> None:  # fmt: skip
    """Draw Tables I and II and figures 4, 5, 7, 8 and 9 of the paper, budgets and responses: one HTML file.

    RUN as for `rig calibrate`; no calibration is kept.

    \f
    `--json` gives `calibration` and `report`.
    """
    from rig.report import write_report

    made, records = calibrated(names, runs, name, model, effects)
    path = out or runs / "reports" / f"{made.name}.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_report(made, records, path)
    if as_json:
        print_json({"calibration": made.name, "report": str(path)})
        return
    click.echo(f"report: {path} (open it in a browser)")
    say_next(command("certify", *names))


@click.command("compare-calibrations")
@click.argument("first", metavar="A")
@click.argument("second", metavar="B")
@runs_option
@json_option
def compare_calibrations(first: str, second: str, runs: Path, as_json: bool) -> None:
    """En of every measurand that the calibrations A and B have: |En| ≤ 1 agrees within the expanded uncertainties.

    Errors of a standard that both share (same certificate) cancel in the difference and are left out of it.

    \f
    `--json` gives a list of `key`, `difference`, `expanded`, `unit`, `en`, `agrees`.
    """
    from rig.calibrate.calibration import load, path_of
    from rig.calibrate.comparison import compare
    from rig.errors import BadInput

    made = [load(path_of(runs, name)) for name in (first, second)]
    rows = compare(*made)
    if not rows:
        raise BadInput(f"{first}, {second}: found no measurand that both determine, wanted at least one")
    if as_json:
        print_json([row.as_json() for row in rows])
        return
    width = max(len(row.key) for row in rows)
    for row in rows:
        click.echo(f"{row.key:<{width}}  {row.first:>22}  {row.second:>22}  En {row.en:+6.2f}  {row.words}")
    apart = [row.key for row in rows if not row.agrees]
    click.echo(f"{len(rows) - len(apart)} of {len(rows)} agree" + (f"; apart: {', '.join(apart)}" if apart else ""))
    newer = max(made, key=lambda one: one.made)
    say_next(command("report", *(source.run for source in newer.sources)), _exporting(newer))


def _exporting(made: Calibration) -> str:
    """How to export a calibration: for a robot where it has all that a robot's file needs, else as a table."""
    from rig.errors import BadInput
    from rig.export import FORMATS as FILES
    from rig.export.selection import Choice, chosen

    try:
        FILES["ros2"].files(made, Choice(chosen(made, "acceleration", None), chosen(made, "rate", None)))
    except BadInput:
        return command("export", made.name, "--to", "csv")
    return command("export", made.name, "--to", "ros2")


def _with_another(path: Path) -> list[str]:
    """How to compare a calibration with the newest one before it, if there is one."""
    others = sorted((one for one in path.parent.glob("*.yaml") if one != path), key=lambda one: one.stat().st_mtime)
    return [command("compare-calibrations", others[-1].stem, path.stem)] if others else []


def calibrated(
    names: Sequence[str], runs: Path, name: str | None, model: Path | None, effects: Path | None,
    recorder: str | None = None,
) -> tuple[Calibration, list[Records]]:  # fmt: skip
    """Calibrate from the named runs by a model; a name that is taken gets a number."""
    import datetime as dt
    from dataclasses import replace

    from rig.archive.records import Records
    from rig.archive.runs import Runs
    from rig.archive.writer import SEAL
    from rig.calibrate.calibrate import calibrate as merged
    from rig.calibrate.calibrate import digest_of
    from rig.calibrate.calibration import path_of

    archive = Runs(runs)
    if tuple(names) == ("all",):
        names = [run.name for run in archive.list() if run.status == "completed"] or ["last"]
    opened = [Records(archive.open(one)) for one in dict.fromkeys(names)]
    seals = {r.name: r.run.path / SEAL for r in opened}
    digests = {n: digest_of(s.read_bytes()) for n, s in seals.items() if s.exists()}
    assumed = _standing_on(str(opened[0].header["sensor"]["serial"]), runs, model, effects)
    made = merged(opened, "unnamed", digests, assumed, cast("Recorder | None", recorder))
    day = dt.datetime.fromtimestamp(made.made, dt.UTC).date()
    serial = "".join(c if c.isalnum() or c in "-_." else "-" for c in made.serial).lstrip(".") or "unit"
    wanted = name or f"{serial}-{day}"
    free, number = wanted, 1
    while path_of(runs, free).exists():
        number += 1
        free = f"{wanted}-{number}"
    return replace(made, name=free), opened


def _standing_on(serial: str, runs: Path, model: Path | None, effects: Path | None) -> Assumed:
    """The model of the file that is meant; the data sheet's without one. Raises BadInput for another unit's."""
    from rig.calibrate.calibrate import digest_of
    from rig.calibrate.fitted import Assumed
    from rig.errors import BadInput
    from rig.repair.model_file import load, path_of, terms_of
    from rig.shelf import shelf

    path = model or path_of(runs, serial)
    if model == NO_MODEL or (model is None and not path.exists()):
        return Assumed()
    on_shelf = shelf(effects)
    found = load(path, on_shelf)
    if found.unit != serial:
        raise BadInput(f"{path}: found a model of {found.unit}, wanted one of {serial}")
    terms = tuple(terms_of(found, on_shelf))
    return Assumed(terms, found.poles, found.shared, path.name, digest_of(path.read_bytes()))


SHOWN_FIRST = (
    "sensitivity_combined",
    "sensitivity",
    "sensitivity_analyzer",
    "sensitivity_gravity",
    "sensitivity_centripetal",
    "offset",
    "deviation",
)


def text_of(made: Calibration) -> list[str]:
    """The table that a calibration prints: the main measurands of every channel, then what there is to say."""
    from rig.calibrate.calibration import text

    mark = "  SIMULATED" if made.simulated else ""
    lines = [f"calibration {made.name} of {made.sensor} {made.serial}{mark}"]
    lines += [*([f"model: {made.model}"] if made.model else []), ""]
    known = [r for r in made.results if r.determined]
    shown = [r for r in known if r.measurand in SHOWN_FIRST]
    if {r.measurand for r in shown} <= {"deviation"}:
        shown = known  # of noise alone
    width = max((len(r.key) for r in shown), default=0)
    lines += [f"  {r.key:<{width}}  {text(r):<26} {_beside(r)}".rstrip() for r in shown]
    lines += [f"  {r.key:<{width}}  {text(r)}" for r in made.results if r.rejected]
    others = sum(r.determined for r in made.results) - len(shown)
    missing = [r for r in made.results if not r.determined]
    lines += ["", f"  U with k for 95 %; {others} more values and {len(missing)} not determined are in the file"]
    lines += [f"  {made.agreement}"] if made.agreement else []
    lines += flagged_lines(made)
    lines += [f"  note: {flag}" for flag in made.flags]
    return [completed(line) for line in lines]


def flagged_lines(made: Calibration) -> list[str]:
    """What there is to say against flagged results, each with all those that it is said of."""
    said: dict[str, list[str]] = {}
    for result in made.results:
        for remark in result.remarks if result.status == "flagged" else ():
            said.setdefault(remark, []).append(result.key)
    return [f"  flagged: {', '.join(keys)}: {remark}" for remark, keys in said.items()]


def _beside(result: Result) -> str:
    said = result.ruling
    verdict = f"{said} against the data sheet's tolerance" if said and said == result.verdict else said
    check = (
        "" if result.check is None else f"{'agrees' if result.check.agrees else 'does not agree'} with the other route"
    )
    return "; ".join(part for part in (f"k = {result.coverage_factor:.2f}", verdict, check) if part)


def _as_json(made: Calibration, path: Path) -> dict[str, Any]:
    return {
        "calibration": made.name,
        "path": str(path),
        "serial": made.serial,
        "simulated": made.simulated,
        "model": made.model,
        "runs": [source.run for source in made.sources],
        "results": [row_of(result) for result in made.results],
        "flags": list(made.flags),
        "overdue": list(made.overdue),
    }


def row_of(result: Result) -> dict[str, Any]:
    """One result as JSON, SI; value null with the reason in `remarks` if it was not determined."""
    return {
        "key": result.key,
        "value": result.value,
        "unit": result.unit,
        "u": result.u if result.determined else None,
        "k": result.coverage_factor if result.determined else None,
        "expanded": result.expanded if result.determined else None,
        "status": result.status,
        "verdict": result.verdict,
        "check": None if result.check is None else {**asdict(result.check), "agrees": result.check.agrees},
        "method": result.method,
        "reference": result.reference,
        "remarks": list(result.remarks),
    }


def refuse_failed(made: Calibration) -> None:
    """Exit code 3 if a value is outside its limits by more than its uncertainty, or cannot be believed."""
    from rig.errors import VerdictNotMet

    if failed := list(failures(made)):
        raise VerdictNotMet("; ".join(failed))


def failures(made: Calibration) -> Iterator[str]:
    """Every value outside its limits or with another sign than declared, and everything that was measured in vain."""
    from rig.calibrate.calibration import text

    for result in made.results:
        if result.verdict == "fail":
            wanted = "outside its limits" if result.ruling == result.verdict else "wanted the declared sign"
            yield f"{result.key}: found {text(result)}, {wanted}"
        elif result.rejected:
            yield f"{result.key}: {text(result)}"
