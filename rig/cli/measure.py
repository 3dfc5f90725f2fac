"""Commands that measure: sweep, turntable, noise, tumble, run, resume."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli.options import bench_option, bench_path, json_option, print_json, runs_option

if TYPE_CHECKING:
    from rig.bench.runner import Order, Outcome
    from rig.bench.steps import Plan
    from rig.yaml.document import Document


def measuring(command: Any) -> Any:
    """Options of every command that measures."""
    for option in (
        json_option,
        click.option(
            "--allow-overdue", is_flag=True, help="Measure with a standard past its due date; goes on record."
        ),
        click.option("--dry-run", is_flag=True, help="Print every step, the duration and the limits; move nothing."),
        runs_option,
        bench_option,
    ):
        command = option(command)
    return command


@click.command(short_help="Drive one axis on the shaker over frequency and level.")
@click.option("--axis", type=click.Choice(["x", "y", "z"]), required=True, help="Cube axis along the drive.")
@click.option("--start", metavar="FREQUENCY", help="e.g. '20 Hz'")
@click.option("--stop", metavar="FREQUENCY", help="e.g. '500 Hz'")
@click.option("--points", type=click.IntRange(1, 2000), help="Frequencies [default: 24].")
@click.option("--levels", metavar="LIST", help="e.g. 'full,quarter' (the default)")
@click.option("--hold", type=click.Choice(["acceleration", "velocity", "drive"]), help="What a level holds.")
@measuring
def sweep(axis: str, levels: str | None, hold: str | None, **options: Any) -> None:
    """Sweep one axis of the accelerometers against the vibrometer."""
    document: dict[str, Any] = {"procedure": "frequency_sweep", "axis": axis}
    document |= _given(options, "start", "stop", "points")
    if levels is not None:
        document["levels"] = [level.strip() for level in levels.split(",")]
    if hold is not None:
        document["level"] = hold
    _measure_document(document, f"sweep-{axis}", options)


@click.command(short_help="Turn the cube on the platter at 33 1/3 or 45 rpm.")
@click.option("--rpm", metavar="SPEED", default="45", show_default=True, help="33 1/3 (also as 33 or 33.3) or 45.")
@click.option("--axis", type=click.Choice(["pitch", "roll", "yaw"]), default="yaw", show_default=True)
@click.option("--invert", is_flag=True, help="The cube upside down: the other sense.")
@click.option("--all", "everything", is_flag=True, help="Both speeds in both senses.")
@click.option("--perturb", is_flag=True, help="Also rates changed by a light touch.")
@click.option("--revolutions", type=click.IntRange(2, 10_000), help="Whole revolutions held [default: 40].")
@click.option("--rest", metavar="TIME", help="Record at rest before and after, e.g. '30 s' (the default).")
@click.option("--radius", metavar="LENGTH", help="Cube's centre from the axis, e.g. '50 mm' (the default).")
@measuring
def turntable(rpm: str, axis: str, invert: bool, everything: bool, perturb: bool, **options: Any) -> None:
    """Turn the gyros on the platter against the encoder."""
    speed = _speed(rpm)
    document: dict[str, Any] = {"procedure": "turntable", "speed": speed, "axis": axis}
    document |= {key: True for key, on in (("inverted", invert), ("all", everything), ("perturb", perturb)) if on}
    document |= _given(options, "revolutions", "rest", "radius")
    _measure_document(document, f"turntable-{axis}-{speed.split()[0]}", options)


def _speed(text: str) -> str:
    """The turntable's speed that was spelled. Raises BadInput with the speeds that it has."""
    import importlib

    from rig.errors import BadInput

    try:
        return str(importlib.import_module("procedures.turntable").speed_of(text))
    except BadInput as error:
        raise BadInput(f"--rpm: {error}") from None


@click.command(short_help="Record everything at rest.")
@click.option("--length", metavar="TIME", help="e.g. '10 min' [default: 300 s]")
@click.option("--cables", type=click.Choice(["shaker", "turntable"]), help="Cable set [default: shaker].")
@measuring
def noise(**options: Any) -> None:
    """Record the sensors at rest, for densities and Allan deviations."""
    _measure_document({"procedure": "noise", **_given(options, "length", "cables")}, "noise", options)


@click.command(short_help="Record static poses against gravity.")
@click.option("--poses", type=click.Choice(["6", "12", "24"]), default="6", show_default=True)
@measuring
def tumble(poses: str, **options: Any) -> None:
    """Record the accelerometers in known poses, with gravity as the reference."""
    _measure_document({"procedure": "tumble", "poses": int(poses)}, f"tumble-{poses}", options)


@click.command(short_help="Run a procedure from a YAML file.")
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@measuring
def run(file: Path, **options: Any) -> None:
    """Run a technician's procedure or sequence of procedures."""
    from rig.yaml import document

    _measure(document.read(_procedure_path(file)), file.stem, options)


@click.command(short_help="Go on with an interrupted run.")
@click.argument("name", metavar="RUN")
@bench_option
@runs_option
@json_option
def resume(name: str, **options: Any) -> None:
    """Check the instruments, repeat what cables and mounting still permit, and go on with the rest."""
    from rig.archive.runs import Runs
    from rig.bench import runner

    found = Runs(options["runs"]).open(name)
    order = _order(
        _document(found.header["document"]), "", {**options, "allow_overdue": bool(found.header["overdue_overridden"])}
    )
    _carried_out(order, lambda watched: runner.resume(watched, found.name), options)


def _given(options: dict[str, Any], *names: str) -> dict[str, Any]:
    """The named options that were given; all of them are taken out."""
    return {name: value for name in names if (value := options.pop(name)) is not None}


def _procedure_path(file: Path) -> Path:
    """A procedure file by path, or by name among the shipped ones."""
    import importlib

    if file.exists() or len(file.parts) > 1:
        return file
    shipped = Path(next(iter(importlib.import_module("procedures").__path__))) / file.name
    return shipped if shipped.exists() else file


def _document(body: dict[str, Any]) -> Document:
    """A procedure given on the command line, as the YAML file that would say the same."""
    import yaml

    from rig.yaml import document

    return document.read_text(yaml.safe_dump(dict(body), allow_unicode=True, sort_keys=False), "(command line)")


def _measure_document(body: dict[str, Any], label: str, options: dict[str, Any]) -> None:
    _measure(_document(body), label, options)


def _measure(document: Document, label: str, options: dict[str, Any]) -> None:
    from rig.bench import runner

    order = _order(document, label, options)
    if options["dry_run"]:
        _print_plan(order.plan, options["as_json"])
        return
    _carried_out(order, runner.run, options)


def _order(document: Document, label: str, options: dict[str, Any]) -> Order:
    from rig.bench import procedure_file
    from rig.bench.assembly import fittings
    from rig.bench.benchfile import describe
    from rig.bench.runner import Order

    description = describe(bench_path(options["bench"]))
    fittings(description)  # every mistake of the bench file, before anything else happens
    return Order(
        plan=procedure_file.plan(document, description.facts()),
        document=document.data,
        description=description,
        runs=options["runs"],
        label=label,
        allow_overdue=options.get("allow_overdue", False),
    )


def _carried_out(order: Order, carry_out: Any, options: dict[str, Any]) -> None:
    """Run with a progress line, then the table, the figure, the verdict and what to do next."""
    from dataclasses import replace

    from rig.cli import outcome
    from rig.cli.progress import Bar

    with Bar(order.plan.title, quiet=options["as_json"]) as bar:
        done: Outcome = carry_out(replace(order, on_progress=bar.show))
    outcome.present(done, order, as_json=options["as_json"])


def _print_plan(plan: Plan, as_json: bool) -> None:
    from rig.cli import outcome

    if as_json:
        print_json(outcome.plan_as_json(plan))
    else:
        click.echo(outcome.plan_as_text(plan))
