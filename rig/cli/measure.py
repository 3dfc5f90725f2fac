"""Commands that measure: sweep, turntable, noise, tumble, run, resume.

`sweep`, `turntable`, `noise` and `tumble` are procedures given by options; the options are [keys of their
YAML](procedures.md). With `--json` a measurement prints what `rig show` prints, and besides:

```json
{"elapsed": 0.816,
 "shares": {"wire": 0.060, "simulation": 0.111, "storage": 0.021, "analysis": 0.001, "other": 0.623},
 "figures": ["runs/reports/2026-11-24T130109-sweep-x/response.svg"],
 "rows": [{"channel": "unit_a_x", "key": "unit_a_x.sensitivity", "value": 0.06629, "unit": "V/(m/s²)", "u": 0.00033,
           "k": 1.96, "expanded": 0.00065, "status": "determined", "verdict": "pass", "check": null, "method": "…",
           "reference": "…", "remarks": []}]}
```

`elapsed` and `shares` are seconds of real time. `rows` are the results of this run alone, as `rig calibrate` gives
them. If `unmet` lists anything, the exit code is 3. With `--dry-run --json`:

```json
{"title": "Frequency sweep, x", "points": 1, "duration": 152.7,
 "steps": [{"kind": "Sine", "label": "20 Hz full", "duration": 2.1, "point": true,
            "acceleration": 1.2633, "stroke": 8e-05, "velocity": 0.010053}]}
```

Durations are seconds; peaks (m/s², m, m/s) are there for steps of the kind `Sine`.
"""

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


@click.command()
@click.option("--axis", type=click.Choice(["x", "y", "z"]), required=True, help="Cube axis along the drive.")
@click.option("--start", metavar="FREQUENCY", show_default="20 Hz", help="Lowest frequency, e.g. '30 Hz'.")
@click.option("--stop", metavar="FREQUENCY", show_default="500 Hz", help="Highest frequency, e.g. '1 kHz'.")
@click.option("--points", type=click.IntRange(1, 2000), show_default="24", help="Number of frequencies.")
@click.option("--levels", metavar="LIST", show_default="full,quarter", help="Some of full, half, quarter, eighth.")
@click.option(
    "--hold",
    type=click.Choice(["acceleration", "velocity", "drive"]),
    show_default="acceleration",
    help="What a level holds over frequency.",
)
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


@click.command()
@click.option(
    "--rpm", metavar="SPEED", default="45", show_default=True, help="33 1/3 (also spelled 33, 33.3, 33⅓) or 45."
)
@click.option(
    "--axis",
    type=click.Choice(["pitch", "roll", "yaw"]),
    default="yaw",
    show_default=True,
    help="Gyro axis on the platter's axis.",
)
@click.option("--invert", is_flag=True, help="The cube upside down: the other sense.")
@click.option("--all", "everything", is_flag=True, help="Both speeds in both senses.")
@click.option("--perturb", is_flag=True, help="Also rates changed by a light touch.")
@click.option("--revolutions", type=click.IntRange(2, 10_000), show_default="40", help="Whole revolutions held.")
@click.option("--rest", metavar="TIME", show_default="30 s", help="Record at rest before and after, e.g. '1 min'.")
@click.option("--radius", metavar="LENGTH", show_default="50 mm", help="Cube's centre from the axis, e.g. '40 mm'.")
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


@click.command()
@click.option("--length", metavar="TIME", show_default="300 s", help="Of the record, e.g. '10 min'.")
@click.option("--cables", type=click.Choice(["shaker", "turntable"]), show_default="shaker", help="Cable set.")
@measuring
def noise(**options: Any) -> None:
    """Record the sensors at rest, for densities and Allan deviations."""
    _measure_document({"procedure": "noise", **_given(options, "length", "cables")}, "noise", options)


@click.command()
@click.option(
    "--poses", type=click.Choice(["6", "12", "24"]), default="6", show_default=True,
    help="The six faces; 12 and 24 tilt every face too.",
)  # fmt: skip
@measuring
def tumble(poses: str, **options: Any) -> None:
    """Record the accelerometers in known poses, with gravity as the reference."""
    _measure_document({"procedure": "tumble", "poses": int(poses)}, f"tumble-{poses}", options)


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@measuring
def run(file: Path, **options: Any) -> None:
    """Run FILE: a procedure, or a sequence of procedures, prompts, waits and repetitions.

    A file that is shipped may be named alone: rig run sweep_x.yaml
    """
    from rig.yaml import document

    _measure(document.read(_procedure_path(file)), file.stem, options)


@click.command()
@click.argument("name", metavar="RUN")
@bench_option
@runs_option
@json_option
def resume(name: str, **options: Any) -> None:
    """Check the instruments, repeat what cables and mounting still permit, and go on with the rest of RUN.

    RUN is a run's name or `last`. What its procedure says, and whether overdue standards are allowed, stays as it
    began.
    """
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
    from rig.yaml import document

    return document.read_text(document.written(body), "(command line)")


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
