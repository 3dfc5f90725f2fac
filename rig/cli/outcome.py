"""What a command prints when it is done: the table, the figure, the verdict, and what to do next."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli.options import print_json
from rig.cli.progress import duration_text

if TYPE_CHECKING:
    from rig.bench.runner import Order, Outcome
    from rig.bench.steps import Plan, Sine, Step
    from rig.first_look import Row
    from rig.run_reader import Run

CAVEAT = "no uncertainty yet: plain estimates for a first look, not a calibration"


def present(done: Outcome, order: Order, *, as_json: bool) -> None:
    """Print what a finished run came to; raises VerdictNotMet if an `expect` of the procedure is not met."""
    from rig import first_look
    from rig.archive import Runs
    from rig.figures import draw

    run = Runs(order.runs).open(done.name)
    records = first_look.Records(run)
    rows = first_look.rows_of(records)
    figure = draw(records, order.runs / "reports" / run.name)
    missed = _unmet(order.plan, rows)
    if as_json:
        print_json(
            {
                **run.summary(),
                "elapsed": done.elapsed,
                "shares": dict(done.shares),
                "figures": [str(p) for p in figure],
                "rows": [
                    {"channel": r.channel, "value": r.sensitivity, "unit": r.unit, "basis": r.basis} for r in rows
                ],
                "unmet": missed,
            }
        )
    else:
        click.echo(run_as_text(run, rows))
        _print_ending(done, figure, run)
    if missed:
        from rig.errors import VerdictNotMet

        raise VerdictNotMet("; ".join(missed))


def _print_ending(done: Outcome, figure: list[Path], run: Run) -> None:
    parts = ", ".join(f"{name} {seconds / done.elapsed:.0%}" for name, seconds in done.shares.items())
    click.echo(f"took {duration_text(done.elapsed)}: {parts}")
    for path in figure:
        click.echo(f"figure: {path}")
    click.echo(f"next: rig show {run.name}, rig verify {run.name}")


def run_as_text(run: Run, rows: list[Row] | None = None) -> str:
    """A run for a reader: what it is, how far it came, its table."""
    from rig import first_look

    summary = run.summary()
    mark = "  SIMULATED" if summary["simulated"] else ""
    lines = [
        f"run {run.name}{mark}",
        f"  {run.header['title']}: {summary['status']}, {summary['points_done']} of {summary['points_total']} points",
    ]
    rows = first_look.rows_of(first_look.Records(run)) if rows is None else rows
    if rows:
        lines += ["", *table(rows), f"  ({CAVEAT})"]
    return "\n".join(lines)


def table(rows: list[Row]) -> list[str]:
    """The rows in the units that technicians use."""
    cells = [(row.channel, *_shown(row), row.basis) for row in rows]
    widths = [max(len(cell[column]) for cell in cells) for column in range(3)]
    return [f"  {a:<{widths[0]}}  {b:>{widths[1]}} {c:<{widths[2]}}  {d}" for a, b, c, d in cells]


def _shown(row: Row) -> tuple[str, str]:
    import math

    if row.unit == "V/(m/s²)":
        return f"{row.sensitivity * 9.80665e3:.2f}", "mV/g"
    if row.unit == "V/(rad/s)":
        return f"{row.sensitivity * 1e3 * math.pi / 180:.4f}", "mV/(°/s)"
    return f"{row.sensitivity * 1e3:.3f}", "mV rms"


def _unmet(plan: Plan, rows: list[Row]) -> list[str]:
    """`expect: sensitivity` is judged on unit A, the axis that was driven."""
    if "sensitivity" not in plan.expect:
        return []
    low, high = plan.expect["sensitivity"]
    judged = [row for row in rows if row.channel.startswith("unit_a") and row.unit == "V/(m/s²)"]
    return [
        f"expect sensitivity of {row.channel}: found {row.sensitivity * 9.80665e3:.2f} mV/g, "
        f"wanted {low * 9.80665e3:.2f} to {high * 9.80665e3:.2f} mV/g"
        for row in judged
        if not low <= row.sensitivity <= high
    ]


def plan_as_text(plan: Plan) -> str:
    """The dry run: every step, its peaks, and how long it takes; nothing is moved."""
    lines = [f"{plan.title}: {len(plan.steps)} steps, {plan.points} points, about {duration_text(plan.duration)}"]
    lines += [f"  {number:>4}  {step.label:<32} {step_detail(step)}" for number, step in enumerate(plan.steps, start=1)]
    lines.append("nothing was moved; next: the same command without --dry-run")
    return "\n".join(lines)


def step_detail(step: Step) -> str:
    """What a step asks of the bench, in one line."""
    from rig.bench.steps import Sine, requests_of

    if isinstance(step, Sine):
        peaks = sine_peaks(step)
        g, micrometres = peaks["acceleration"] / 9.80665, peaks["stroke"] * 1e6
        return f"{g:.3f} g  {micrometres:.2f} µm  {peaks['velocity'] * 1e3:.2f} mm/s"
    asked = "; ".join(request.text for request in requests_of(step))
    return asked or f"{duration_text(step.duration)}"


def sine_peaks(step: Sine) -> dict[str, float]:
    """Peak acceleration m/s², stroke m and velocity m/s of a sine point."""
    import math

    omega = 2.0 * math.pi * step.frequency
    return {
        "acceleration": step.acceleration,
        "stroke": step.acceleration / omega**2,
        "velocity": step.acceleration / omega,
    }


def plan_as_json(plan: Plan) -> dict[str, Any]:
    """The dry run as data; SI."""
    from rig.bench.steps import Sine

    return {
        "title": plan.title,
        "points": plan.points,
        "duration": plan.duration,
        "steps": [
            {"kind": type(step).__name__, "label": step.label, "duration": step.duration, "point": step.point}
            | (sine_peaks(step) if isinstance(step, Sine) else {})
            for step in plan.steps
        ],
    }
