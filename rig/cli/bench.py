"""Commands about the bench itself: check, safe, serve, reveal."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli.onward import command, say_next
from rig.cli.options import MODEL, bench_option, bench_path, effects_option, json_option, print_json, runs_option

if TYPE_CHECKING:
    from rig.bench.assembly import Bench
    from rig.bench.benchfile import BenchDescription
    from rig.bench.possession import Possession
    from rig.bench.safe_action import Done


@click.group()
def bench() -> None:
    """The bench itself: find its instruments, make it safe, serve the simulated one, reveal what it hides."""


@bench.command()
@bench_option
@runs_option
@json_option
@click.option(
    "--watch", type=click.IntRange(min=1), metavar="N", help="Show the optical level N times while you align the beam."
)
def check(bench: Path | None, runs: Path, as_json: bool, watch: int | None) -> None:
    """Find every instrument, its identity, its errors, and the due dates of the standards.

    Exit code 1 if an instrument does not answer as it should.

    \f
    ```json
    {"bench": "simulated", "simulated": true,
     "instruments": [{"role": "analyzer", "driver": "hp89410a",
                      "identity": "HEWLETT-PACKARD 89410A (serial 3416A01211, firmware A.09.01)", "error": "",
                      "pending": []}],
     "standards": [{"standard": "vibrometer", "instrument": "Polytec OFV-3001 with OVD-01",
                    "certificate": "EX-LDV-2026-014", "calibrated": "2026-03-02", "due": "2027-03-02",
                    "overdue": false}],
     "optical_level": 36}
    ```

    `pending` are errors that the instrument kept in its queue; `optical_level` is in bars of 40, or `null`.
    """
    from rig.bench.assembly import occupied
    from rig.bench.benchfile import describe
    from rig.errors import WorkFailed

    description = describe(bench_path(bench))
    with occupied(description, runs) as possession:
        rows = _instrument_rows(description, runs, possession)
        standards, level = _standard_rows(description, runs, possession, watch, quiet=as_json)
    report = {
        "bench": description.file.bench,
        "simulated": description.simulated,
        "instruments": rows,
        "standards": standards,
        "optical_level": level,
    }
    if as_json:
        print_json(report)
    else:
        _print_report(report)
    missing = [row["role"] for row in rows if row["error"]]
    if missing:
        raise WorkFailed(f"found no working {', '.join(missing)}; wanted every instrument of {description.path.name}")


def _instrument_rows(description: BenchDescription, runs: Path, possession: Possession) -> list[dict[str, Any]]:
    """One row for each instrument; one that fails does not hide the others."""
    from rig.bench.assembly import connected, fittings
    from rig.errors import WorkFailed

    rows = []
    for role, fitting in fittings(description).items():
        row: dict[str, Any] = {"role": role, "driver": fitting.driver, "identity": "", "error": "", "pending": []}
        try:
            with connected(description, runs, role.__eq__, possession=possession) as found:
                instrument = found.instruments[role]
                row["identity"] = str(instrument.identify())
                errors = getattr(instrument, "errors", None)
                row["pending"] = list(errors()) if errors is not None else []
        except WorkFailed as error:
            row["error"] = str(error)
        rows.append(row)
    return rows


def _standard_rows(
    description: BenchDescription, runs: Path, possession: Possession, watch: int | None, *, quiet: bool
) -> tuple[list[dict[str, Any]], int | None]:
    from rig.bench.assembly import connected
    from rig.errors import WorkFailed

    level = None
    try:
        with connected(description, runs, "vibrometer".__eq__, possession=possession) as found:
            late = {standard.standard for standard in description.overdue(found.room.clock.now())}
            if "vibrometer" in found.instruments:
                level = _watched_level(found, watch, quiet)
    except WorkFailed:
        late = {standard.standard for standard in description.overdue(time.time())}
    return [
        {
            "standard": s.standard,
            "instrument": s.instrument,
            "certificate": s.certificate,
            "calibrated": s.calibrated.isoformat(),
            "due": s.due.isoformat(),
            "overdue": s.standard in late,
        }
        for s in description.standards
    ], level


def _watched_level(found: Bench, watch: int | None, quiet: bool) -> int:
    vibrometer: Any = found.instruments["vibrometer"]
    level = int(vibrometer.level())
    for _ in range(watch or 0):
        level = int(vibrometer.level())
        if not quiet:
            click.echo(f"optical level {level:2d} of 40  {'█' * level}")
        found.room.clock.sleep(0.2)
    return level


def _print_report(report: dict[str, Any]) -> None:
    mark = " (SIMULATED)" if report["simulated"] else ""
    click.echo(f"bench {report['bench']}{mark}")
    for row in report["instruments"]:
        click.echo(f"  {row['role']:<11} {row['error'] or row['identity']}")
        for error in row["pending"]:
            click.echo(f"  {'':<11} error queue: {error}")
    for row in report["standards"]:
        due = f"OVERDUE since {row['due']}" if row["overdue"] else f"due {row['due']}"
        dates = f"calibrated {row['calibrated']}, {due}"
        click.echo(f"  {row['standard']:<11} {row['instrument']}, certificate {row['certificate']}, {dates}")
    if report["optical_level"] is not None:
        click.echo(f"  {'beam':<11} optical level {report['optical_level']} of 40")
    say_next(command("sweep", "--axis", "x"))


@bench.command()
@bench_option
@runs_option
@json_option
def safe(bench: Path | None, runs: Path, as_json: bool) -> None:
    """Switch off whatever the bench's instruments energise, and read back that it is off.

    After NOT SAFE, no other command touches the bench until this one has succeeded. A program that has ended or is
    stopped is passed over; one that is at work is not: interrupt it, and it makes the bench safe itself. Exit code 1 if
    something was not read back as off. A platter has no remote control: look at it.

    \f
    ```json
    {"bench": "simulated", "simulated": true, "safe": true,
     "instruments": [{"role": "analyzer", "off": true, "in_words": "off, read back"}],
     "platter": "not confirmed", "passed": [], "left": null}
    ```

    `passed` are programs that had the bench and were passed over; `left` says what was left armed on it, if anything.
    """
    from rig.bench import safe_action
    from rig.bench.benchfile import describe
    from rig.errors import NotSafe

    description = describe(bench_path(bench))
    done = safe_action.make_safe(description, runs)
    if as_json:
        instruments = [{"role": one.role, "off": one.off, "in_words": one.in_words} for one in done.found]
        report = {"bench": description.file.bench, "simulated": description.simulated, "safe": done.safe}
        platter = "not confirmed" if done.platter else None
        print_json(
            {**report, "instruments": instruments, "platter": platter, "passed": list(done.passed), "left": done.left}
        )
    else:
        _print_safe(description, done)
    if not done.safe:
        raise NotSafe("; ".join(f"{one.role}: {one.in_words}" for one in done.found if not one.off))


def _print_safe(description: BenchDescription, done: Done) -> None:
    click.echo(f"bench {description.file.bench}{' (SIMULATED)' if description.simulated else ''}")
    for text in [*done.passed, *([] if done.left is None else [f"was left: {done.left}"])]:
        click.echo(f"  {text}")
    for one in done.found:
        click.echo(f"  {one.role:<11} {one.in_words if one.off else 'NOT SAFE'}")
    if done.platter:
        click.echo(f"  {'platter':<11} not confirmed")
    if done.safe:
        say_next(command("bench", "check"))


@bench.command()
@bench_option
@runs_option
@json_option
@click.option(
    "--hidden-seed", type=click.IntRange(min=0), help="Hide one effect, drawn with this seed, until `rig bench reveal`."
)
def serve(bench: Path | None, runs: Path, as_json: bool, hidden_seed: int | None) -> None:
    """Serve the simulated bench until Ctrl-C, so that any program can talk to it; prints its addresses.

    What --hidden-seed hides belongs to the world from then on, in its own folder of runs.
    """
    from rig.bench import assembly, control
    from rig.bench.benchfile import describe
    from rig.bench.stopping import stoppable
    from rig.errors import BadInput

    description = describe(bench_path(bench))
    simulated = description.file.simulated
    if simulated is None:
        raise BadInput(f"{description.path.name}: found a bench of real instruments, wanted a simulated one")
    state = assembly.state_folder(description, runs)
    world = description.beside(simulated.world)
    addresses = control.ensure_served(world, simulated.seed, state, hidden_seed)
    if as_json:
        print_json(addresses)
    else:
        for name, address in addresses.items():
            click.echo(f"{name:<9} {address}")
        click.echo("serving until Ctrl-C; elsewhere, any VISA program, or")
        say_next(command("sweep", "--axis", "x"))
    # The open connection is what keeps the bench: it ends by itself soon after we are gone, however we go.
    with stoppable(), control.Control(int(str(addresses["control"]))) as held:
        try:
            while held.ask("hello")["ok"]:
                time.sleep(1.0)
        finally:
            control.stop(state)


@bench.command()
@bench_option
@MODEL
@effects_option
@runs_option
@json_option
def reveal(bench: Path | None, model: Path | None, effects: Path | None, runs: Path, as_json: bool) -> None:
    """Tell what the simulated world hides, with its strength d′, and beside it what a model has found of it.

    Both are SI in the same convention: amplitudes from zero to peak, densities one-sided, and what counts from the
    beginning of a session (a warm-up) from that of the model's runs. Found values have their expanded uncertainty
    (k = 2).

    \f
    `--json` gives `{"effects": []}`, of each effect `name`, `stage`, `quantity` (of the channels it acts on, or
    `null`), `parameters` (true, SI), `units`, `d_prime`, and `found`: by parameter `value`, `unit` and `u`, or `null`
    where it is not in the model.
    """
    from rig.bench import assembly
    from rig.bench.benchfile import describe
    from rig.bench.control import Control
    from rig.cli import truth
    from rig.shelf import shelf

    description = describe(bench_path(bench))
    held = truth.model_of(description, runs, model)
    addresses = assembly.start_simulated(description, runs)
    with Control(int(str(addresses["control"]))) as control:
        hidden = control.ask("reveal", begun=truth.begun(held, runs))["effects"]
    found = truth.beside(hidden, held, shelf(effects))
    if as_json:
        print_json({"effects": found})
        return
    for one in found:
        click.echo("\n".join(truth.in_words(one, modelled=held is not None)))
    if not found:
        click.echo("nothing is hidden: this is a clean world")
