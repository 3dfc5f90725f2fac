"""What a command prints when it is done: the table, the figure, the verdict, and what to do next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli.onward import again, command, completed, say_next
from rig.cli.options import print_json
from rig.cli.progress import duration_text

if TYPE_CHECKING:
    from rig.archive.reader import Run
    from rig.archive.records import Records
    from rig.bench.runner import Order, Outcome
    from rig.bench.steps import Plan, Sine, Step
    from rig.calibrate.calibration import Calibration, Result

KEY_MEASURANDS = ("sensitivity_combined", "sensitivity", "sensitivity_gravity")


def present(done: Outcome, order: Order, *, as_json: bool) -> None:
    """Print what a finished run came to.

    Raises VerdictNotMet if an `expect` of the procedure is not met, or something was measured that cannot be believed.
    """
    from rig.archive.records import Records
    from rig.archive.runs import Runs
    from rig.calibrate.calibration import text as words
    from rig.cli.calibration import row_of
    from rig.report.run_figures import draw

    run = Runs(order.runs).open(done.name)
    records = Records(run)
    made, why = concluded(records)
    figure = draw(records, made, order.runs / "reports" / run.name)
    rows = [] if made is None else key_results(made, records)
    missed = [*unmet(order.plan, made), *(f"{r.key}: {words(r)}" for r in rows if r.rejected)]
    if missed or order.plan.expect:
        run.keep_unmet(missed)
    if as_json:
        print_json(
            {
                **run.summary(),
                "elapsed": done.elapsed,
                "shares": dict(done.shares),
                "figures": [str(p) for p in figure],
                "rows": [{"channel": r.channel, **row_of(r)} for r in rows],
            }
        )
    else:
        click.echo("\n".join(_run_lines(records, made, why)))
        _print_ending(done, figure)
        say_next(*([command("show", run.name)] if made is None else concluding(run.name)))
    if missed:
        from rig.errors import VerdictNotMet

        raise VerdictNotMet("; ".join(missed))


def concluded(records: Records) -> tuple[Calibration | None, str]:
    """The calibration that this run alone gives, or None and why there is none."""
    from rig.calibrate.calibrate import calibrate
    from rig.errors import BadInput

    try:
        return calibrate([records], records.name, assumed=None), ""
    except BadInput as error:
        return None, str(error)


def key_results(made: Calibration, records: Records) -> list[Result]:
    """What a technician looks at first: sensitivities; of a noise record, or a run without any, deviations at rest.

    What was measured and cannot be believed is among them, with why.
    """
    from rig.archive.records import statics

    rows = [r for r in made.results if r.rejected or (r.determined and r.measurand in KEY_MEASURANDS)]
    noise = any(body["purpose"] == "noise" for body in statics(records))
    known = any(r.determined for r in rows)
    return [*rows, *(made.of("deviation") if noise or not known else ())]


def concluding(*names: str) -> list[str]:
    """The commands that conclude from runs."""
    return [command("calibrate", *names), command("report", *names)]


def _print_ending(done: Outcome, figure: list[Path]) -> None:
    parts = ", ".join(f"{name} {seconds / done.elapsed:.0%}" for name, seconds in done.shares.items())
    click.echo(f"took {duration_text(done.elapsed)}: {parts}")
    for path in figure:
        click.echo(f"figure: {path}")


def run_as_text(run: Run) -> str:
    """A run for a reader: what it is, how far it came, its table."""
    from rig.archive.records import Records, is_imported

    records = Records(run)
    if is_imported(records):
        return "\n".join(_imported_lines(records))
    return "\n".join(_run_lines(records, *concluded(records)))


def findings_as_json(run: Run) -> dict[str, Any]:
    """What was found on import; nothing of a run that was measured here, or is damaged."""
    from rig.archive.records import Records, is_imported
    from rig.errors import RigError
    from rig.foreign.tables import foreign_of

    try:
        records = Records(run)
        return {"findings": [one.as_json() for one in foreign_of(records).found]} if is_imported(records) else {}
    except RigError:
        return {}


def _imported_lines(records: Records) -> list[str]:
    """An imported run: its files, what was found on import, and where the data come from."""
    from rig.foreign.tables import foreign_of

    data = foreign_of(records)
    made, summary = data.manifest, records.run.summary()
    files = f"{summary['points_done']} of {summary['points_total']} files"
    lines = [f"run {records.name}", f"  {records.header['title']}: {summary['status']}, {files}"]
    if unit := " ".join(part for part in (made.unit.maker, made.unit.model) if part):
        lines += [f"  unit {made.unit.serial}: {unit}"]
    lines += [f"  from {made.provenance.source}, {made.provenance.licence}"]
    lines += [f"  {text}" for text in (made.provenance.citation, made.provenance.note) if text]
    if (standard := made.standard) is not None:
        known = ", ".join(filter(None, [standard.instrument, standard.serial, standard.due and f"due {standard.due}"]))
        said = f"certificate {standard.certificate} of {standard.laboratory}{known and f' ({known})'}"
        lines += [f"  traceable by {standard.name}, {said}"]
    lines += [f"  {t.label}: {len(t.values)} rows{', held out' if t.held_out else ''}" for t in data.tables]
    lines += [f"  channel {c.channel}: {c.quantity}, {c.role}" for c in made.columns]
    lines += [f"  found on import: {one.in_words}" for one in data.found]
    if made.kind == "static":
        from rig.parts.reading.rest import at_rest

        noises = (f"  {one.in_words}" for one in at_rest(data))
        more = "a record of the same unit in motion, imported too, can be compared with a model"
        return [*lines, *noises, more, f"next: {command('calibrate', records.name)}"]
    return [*lines, f"next: {command('compare', records.name)}"]


def _run_lines(records: Records, made: Calibration | None, why: str) -> list[str]:
    from rig.calibrate.calibration import text
    from rig.cli.calibration import flagged_lines

    run, summary = records.run, records.run.summary()
    mark = "  SIMULATED" if summary["simulated"] else ""
    lines = [
        f"run {run.name}{mark}",
        f"  {run.header['title']}: {status_text(summary)}, "
        f"{summary['points_done']} of {summary['points_total']} points",
        *(f"  not met: {one}" for one in summary["unmet"]),
    ]
    if made is None:
        return [*lines, f"  not calibrated: {why}"]
    rows = key_results(made, records)
    if rows:
        width = max(len(r.channel) for r in rows)
        lines += ["", *(f"  {r.channel:<{width}}  {text(r):<26} {r.title}; {r.reference}" for r in rows)]
        lines += ["  (expanded uncertainty for 95 %, from this run alone)"]
    lines += flagged_lines(made)
    return [completed(line) for line in (*lines, *(f"  note: {flag}" for flag in made.flags))]


def status_text(summary: Mapping[str, Any]) -> str:
    """How a run ended, how many of its limits were not met, and how much was measured in vain."""
    limits = sum(one.startswith("expect ") for one in summary["unmet"])
    vain = len(summary["unmet"]) - limits
    said = [summary["status"]]
    said += [f"{limits} {'limit' if limits == 1 else 'limits'} not met"] if limits else []
    said += [f"{vain} {'result' if vain == 1 else 'results'} not determined"] if vain else []
    return ", ".join(said)


def unmet(plan: Plan, made: Calibration | None) -> Iterator[str]:
    """Every expected sensitivity, named by its result, that was not determined or found outside its limits."""
    for key, (low, high) in plan.expect.items():
        found = None if made is None else made.find(key)
        if found is None or found.value is None:
            yield f"expect {key}: found none in this run, wanted a sweep that determines it"
        elif not low <= found.value <= high:
            yield (
                f"expect sensitivity of {found.channel}: found {found.value * 9.80665e3:.2f} mV/g, "
                f"wanted {low * 9.80665e3:.2f} to {high * 9.80665e3:.2f} mV/g"
            )


def plan_as_text(plan: Plan) -> str:
    """The dry run: every step, its peaks, and how long it takes; nothing is moved."""
    lines = [f"{plan.title}: {len(plan.steps)} steps, {plan.points} points, about {duration_text(plan.duration)}"]
    lines += [f"  {number:>4}  {step.label:<32} {step_detail(step)}" for number, step in enumerate(plan.steps, start=1)]
    lines += ["nothing was moved", f"next: {again(without='dry_run')}"]
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
