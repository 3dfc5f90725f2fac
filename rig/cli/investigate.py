"""Commands that go on measuring until a model is understood: floor, next, investigate, demo."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli.onward import BOTH, carry, carrying, command, completed, say_next
from rig.cli.options import MODEL, bench_option, bench_path, effects_option, json_option, print_json, runs_option
from rig.cli.progress import Doing
from rig.cli.repair import RUN_NAMES, START, Opened, adding, model_options, on_what, opened

if TYPE_CHECKING:
    from rig.bench.steps import BenchFacts
    from rig.diagnose.diagnose import Diagnosis
    from rig.diagnose.next_measurement import Ranked
    from rig.fit.evidence import Evidence

MOST_ROUNDS = 10
STANDARD: tuple[dict[str, Any], ...] = (
    {"procedure": "frequency_sweep", "axis": "x"},
    {"procedure": "turntable", "all": True},
)


@click.command()
@RUN_NAMES
@runs_option
@json_option
def floor(names: tuple[str, ...], runs: Path, as_json: bool) -> None:
    """Find the smooth ripple between three or more mountings of one axis, and keep it for every later fit.

    RUN as for `rig compare`; take them with: rig run remounts.yaml. The floor is written to floor.yaml under the runs
    folder.

    \f
    `--json` gives `floor` (the file), `size` (relative), `length` (of the logarithm of frequency), `mountings` and
    `runs`.
    """
    from rig.fit.evidence import evidence_of
    from rig.fit.floor import floor_of, path_of, save
    from rig.notebook import records_of
    from rig.parts.ripple import said

    found = floor_of(evidence_of(records_of(names, runs)))
    path = path_of(runs)
    save(path, found)
    if as_json:
        print_json({"floor": str(path), **found.as_dict()})
        return
    click.echo(said(found))
    click.echo(f"floor: {path}")
    say_next(command("diagnose", *names))


@click.command("next")
@RUN_NAMES
@bench_option
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Where to write the procedure.",
    show_default="reports/<first run>/next.yaml",
)
@model_options()
def next_(
    names: tuple[str, ...], bench: Path | None, out: Path | None, model: Path | None, start: str | None,
    effects: Path | None, runs: Path, as_json: bool,
) -> None:  # fmt: skip
    """Rank the measurements that this bench can do by how well they would decide between what the data leave open.

    RUN as for `rig compare`. Power is the χ² between two rivals that is expected after the measurement; 16 decides. The
    procedure of the first is written as YAML.

    \f
    `--json` gives `verdict`, `named` (effects), `measurements` (a list of `name`, `why`, `power`, `decides`, `between`,
    `minutes`, `procedure`), `procedure` (the file that was written) and `unmeasured` (a list of `lacks`, `command`).
    """
    from rig.diagnose.next_measurement import unmeasured

    work = opened(names, runs, model, start, effects)
    diagnosis = _diagnosed(work)
    ours = not work.bench.evidence.imported  # this bench cannot repeat what others measured
    timed = [(one, _minutes(one, bench)) for one in (_ranked(diagnosis, runs) if ours else [])]
    rows = [(one, minutes) for one, minutes in timed if minutes is not None]
    lacking = [(lacks, carrying(line)) for lacks, line in unmeasured(work.bench.evidence)] if ours else []
    path = _written(rows[0][0], out or work.figures / "next.yaml") if rows else None
    if as_json:
        print_json(_ranking_as_json(diagnosis, rows, path, lacking))
        return
    refused = [one for one, minutes in timed if minutes is None]
    said = [*_ranking_text(diagnosis, rows, refused), *_lacking_text(lacking)]
    click.echo("\n".join(said if ours else _elsewhere_text(diagnosis, work.bench.evidence)))
    if path is not None:
        click.echo(f"procedure: {path}")
    worth = path is not None and rows[0][0].helps
    say_next(_next_after(diagnosis, work, path if worth else None, lacking))


globals()["next"] = next_  # the command's name is a built-in function's


def _diagnosed(work: Opened) -> Diagnosis:
    from rig.diagnose.diagnose import diagnose
    from rig.repair.model_file import terms_of

    terms = terms_of(work.model, work.bench.shelf)
    model = work.model
    with Doing() as told:
        return diagnose(
            work.bench.evidence, terms, shelf=work.bench.shelf, poles=model.poles, shared=model.shared, told=told
        )


def _next_after(
    diagnosis: Diagnosis, work: Opened, path: Path | None, lacking: Sequence[tuple[str, str]]
) -> str:  # fmt: skip
    """The command that follows; the runs by name, because `last` will be another one."""
    names = work.names if work.names == ("all",) else work.bench.evidence.runs
    if path is not None:
        after = names if names == ("all",) else (*names, "last")
        return BOTH.join([command("run", path), command("diagnose", *after)])
    if diagnosis.verdict == "missing":
        taken = diagnosis.steps[0].taken
        return adding(taken.name, names, on_what(taken.term))
    if diagnosis.verdict == "adequate" and lacking:
        return lacking[0][1]
    return command("fit" if diagnosis.verdict == "adequate" else "compare", *names)


def _ranked(diagnosis: Diagnosis, runs: Path) -> list[Ranked]:
    from rig.diagnose.next_measurement import ranked
    from rig.fit import floor

    return ranked(diagnosis, floor.load(floor.path_of(runs)))


def _minutes(one: Ranked, bench: Path | None) -> float | None:
    """How long the measurement takes on this bench; None if the bench refuses it."""
    from rig.bench import procedure_file
    from rig.errors import ConfigError

    try:
        return procedure_file.plan(_document(one.option.document), _facts(bench)).duration / 60.0
    except ConfigError:
        return None


def _facts(bench: Path | None) -> BenchFacts:
    from rig.bench.benchfile import describe

    return describe(bench_path(bench)).facts()


def _document(body: Any) -> Any:
    from rig.yaml import document

    return document.read_text(document.written(body), "(next measurement)")


def _written(one: Ranked, path: Path) -> Path:
    from rig.yaml import document

    path.parent.mkdir(parents=True, exist_ok=True)
    text = document.written({"title": f"{one.option.name}: {one.option.why}", **one.option.document})
    path.write_text(f"# decides between {one.pair[0]} and {one.pair[1]}\n{text}", encoding="utf-8")
    return path


def _ranking_as_json(
    diagnosis: Diagnosis, rows: Sequence[tuple[Ranked, float]], path: Path | None, lacking: Sequence[tuple[str, str]]
) -> dict[str, Any]:  # fmt: skip
    return {
        "verdict": diagnosis.verdict,
        "named": list(diagnosis.named),
        "measurements": [
            {"name": one.option.name, "why": one.option.why, "power": one.power, "decides": one.decides,
             "between": list(one.pair), "minutes": minutes, "procedure": dict(one.option.document)}
            for one, minutes in rows
        ],
        "procedure": None if path is None else str(path),
        "unmeasured": [{"lacks": lacks, "command": command} for lacks, command in lacking],
    }  # fmt: skip


def _ranking_text(
    diagnosis: Diagnosis, rows: Sequence[tuple[Ranked, float]], refused: Sequence[Ranked]
) -> list[str]:  # fmt: skip
    if not rows and refused:
        return [
            f"open: {' and '.join(refused[0].pair)}, but this bench can do none of the measurements that might decide"
        ]
    if not rows:
        return [f"nothing is open between two effects: {_verdict_in_words(diagnosis)}"]
    width = max(len(one.option.name) for one, _ in rows)
    lines = [f"  {'measurement':<{width}}  {'power':>8}  {'minutes':>7}  between"]
    for one, minutes in rows:
        lines.append(f"  {one.option.name:<{width}}  {one.power:>8.3g}  {minutes:>7.0f}  {' and '.join(one.pair)}")
    best = rows[0][0]
    if best.decides:
        return [*lines, f"first: {best.option.name} - {best.option.why}"]
    return [
        *lines,
        f"none is expected to decide between {best.pair[0]} and {best.pair[1]} (a power of 16 would): "
        + ("the first helps, several of it may do" if best.helps else "on this bench they are one class"),
    ]


def _verdict_in_words(diagnosis: Diagnosis) -> str:
    what = " and ".join(diagnosis.named)
    match diagnosis.verdict:
        case "adequate":
            return "the model leaves nothing but noise in these runs"
        case "missing":
            return f"what is missing is {what}"
        case _:
            return f"an effect that is on no shelf{f', nearest {what}' if what else ''}"


def _elsewhere_text(diagnosis: Diagnosis, evidence: Evidence) -> list[str]:
    """What would tell effects apart on the bench where imported records come from."""
    lines = ["imported records: this bench cannot measure that; on the bench they come from, these would tell:"]
    for step in diagnosis.steps:
        for effect in dict.fromkeys(choice.term.effect for choice in step.members):
            lines.append(f"  {effect.name}: {effect.separate_by}")
    return [*lines, *(f"  not seen: {completed(one)}" for one in evidence.blind)]


def _lacking_text(lacking: Sequence[tuple[str, str]]) -> list[str]:
    """What these runs cannot show, with the command that measures it."""
    width = max((len(lacks) for lacks, _ in lacking), default=0)
    rows = [f"  {lacks:<{width}}  {command}" for lacks, command in lacking]
    return ["not measured yet, but this bench could:", *rows] if rows else []


@click.command()
@bench_option
@click.option("--yes", is_flag=True, help="Do not ask before each step.")
@click.option("--axis", type=click.Choice(["x", "y", "z"]), default="x", show_default=True, help="Of the first sweep.")
@click.option("--only", type=click.Choice(["shaker", "turntable"]), help="Use this half of the bench only.")
@MODEL
@START
@effects_option
@runs_option
@json_option
def investigate(
    bench: Path | None, yes: bool, axis: str, only: str | None, model: Path | None, start: str | None,
    effects: Path | None, runs: Path, as_json: bool,
) -> None:  # fmt: skip
    """Close the loop on a bench: measure, compare, diagnose, add what is missing, measure what is still open.

    Every measurement is shown with its duration before it is taken. The loop ends when the model is adequate, when no
    measurement of this bench would decide, or when you say no. What cannot be decided is said, and the likeliest taken.
    Without a terminal, or with --json, it needs --yes.

    \f
    `--json` gives `verdict` (`adequate`, `missing`, `unlisted` or `undecided`), `runs`, `effects` (those that were
    added), `undecided_between` and `model`.
    """
    _askable(yes, as_json)
    loop = _Loop(bench, yes, runs, model, start, effects, as_json)
    standard = {"shaker": {**STANDARD[0], "axis": axis}, "turntable": STANDARD[1]}
    for place, document in standard.items():
        if only in (None, place) and not loop.measured(document, "a standard run"):
            break
    verdict = loop.settled() if loop.names else "undecided"
    if as_json:
        kept = None if loop.path is None else str(loop.path)
        print_json({"verdict": verdict, "runs": loop.names, "effects": loop.added, "undecided_between": loop.open,
                    "model": kept})  # fmt: skip
    elif loop.names:
        click.echo(f"the end: {verdict}; added to the model: {', '.join(loop.added) or 'nothing'}; {loop.path}")
        say_next(command("history" if verdict == "adequate" else "next", *loop.names), command("compare", *loop.names))
    else:
        click.echo("nothing was measured")
        say_next(command("sweep", "--axis", "x"))


def _askable(yes: bool, as_json: bool) -> None:
    """Whether there is somebody to ask before a bench is set in motion. Raises BadInput."""
    import sys

    from rig.errors import BadInput

    if yes:
        return
    if as_json:
        raise BadInput("investigate: found --json, wanted --yes with it, as nobody is asked before a measurement")
    if not sys.stdin.isatty():
        raise BadInput("investigate: found no terminal to ask before a measurement, wanted one, or --yes")


class _Loop:
    """Runs taken so far, and effects that were added to the model's file."""

    def __init__(
        self, bench: Path | None, yes: bool, runs: Path, model: Path | None, start: str | None, effects: Path | None,
        quiet: bool,
    ) -> None:  # fmt: skip
        self._bench, self._yes, self._runs, self._quiet = bench, yes, runs, quiet
        self._model, self._start, self._effects = model, start, effects
        self.names: list[str] = []
        self.added: list[str] = []
        self.open: list[list[str]] = []
        self.path: Path | None = None
        self._tried: set[str] = set()

    def measured(self, document: dict[str, Any], why: str) -> bool:
        """Take one run, if it is wanted."""
        from rig.bench import procedure_file

        plan = procedure_file.plan(_document(document), _facts(self._bench))
        self._say(f"measure: {plan.title}, about {plan.duration / 60.0:.0f} min - {why}")
        if not self._yes and not click.confirm("  take it?", default=True):
            return False
        self.names.append(take(document, self._bench, self._runs, quiet=self._quiet))
        return True

    def settled(self) -> str:
        """Diagnose, add, and measure again until nothing is left to do; the last verdict."""
        from rig.cli.repair import verdict_text
        from rig.diagnose.conclusion import concluded

        for _ in range(MOST_ROUNDS):
            work = opened(self.names, self._runs, self._model, self._start, self._effects)
            self.path = work.path
            diagnosis = _diagnosed(work)
            self._say(verdict_text(concluded(work.bench.evidence, diagnosis, work.bench.shelf)))
            if diagnosis.verdict != "missing":
                self._keeps(work)
                return diagnosis.verdict
            if self._decides(diagnosis):
                continue
            self._leaves_open(diagnosis)
            if not self._adds(work, diagnosis):
                return "undecided"
        return "undecided"

    def _decides(self, diagnosis: Diagnosis) -> bool:
        """Take the first measurement that is expected to decide and was not taken yet; False if there is none."""
        for one in _ranked(diagnosis, self._runs):
            fresh = one.decides and one.option.name not in self._tried and _minutes(one, self._bench) is not None
            if fresh:
                self._tried.add(one.option.name)
                return self.measured(dict(one.option.document), f"to decide between {' and '.join(one.pair)}")
        return False

    def _leaves_open(self, diagnosis: Diagnosis) -> None:
        """Note the effects between which nothing was decided."""
        from rig.diagnose.next_measurement import rivals

        names = list(dict.fromkeys(one.name for one in rivals(diagnosis)))
        if len(names) > 1:
            self.open.append(names)
            self._say(f"not decided: {' or '.join(names)}; the first is the likeliest")

    def _keeps(self, work: Opened) -> None:
        """Write the model, refitted to all runs."""
        from rig.repair.model_file import save
        from rig.repair.repair import fitted

        if set(work.model.runs) != set(work.bench.evidence.runs) or not work.path.exists():
            save(work.path, fitted(work.bench, work.model).model)

    def _adds(self, work: Opened, diagnosis: Diagnosis) -> bool:
        from rig.repair.model_file import save
        from rig.repair.repair import added

        taken = diagnosis.steps[0].taken
        self._say(f"add: {taken.name}")
        if not self._yes and not click.confirm("  add it to the model?", default=True):
            return False
        made = added(work.bench, work.model, taken.name, taken.term.on, channels=taken.term.only)
        save(work.path, made.model)
        self.added.append(taken.name)
        return True

    def _say(self, text: str) -> None:
        if not self._quiet:
            click.echo(text)


def take(document: dict[str, Any], bench: Path | None, runs: Path, *, quiet: bool) -> str:
    """Carry a procedure out as `rig run` does; the run's name."""
    from dataclasses import replace

    from rig.bench import procedure_file, runner
    from rig.bench.benchfile import describe
    from rig.cli.progress import Bar

    description = describe(bench_path(bench))
    read = _document(document)
    plan = procedure_file.plan(read, description.facts())
    order = runner.Order(
        plan=plan, document=read.data, description=description, runs=runs, label=plan.procedure or "sequence"
    )
    with Bar(plan.title, quiet=quiet) as bar:
        done = runner.run(replace(order, on_progress=bar.show))
    return done.name


@click.group()
def demo() -> None:
    """Something to learn on, on the simulated bench."""


@demo.command()
@bench_option
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Which effect is hidden.")
@click.option("--yes", is_flag=True, help="Do not wait between the steps; with --json only take the runs.")
@runs_option
@json_option
@click.pass_context
def hidden(ctx: click.Context, bench: Path | None, seed: int, yes: bool, runs: Path, as_json: bool) -> None:
    """A sealed world with one hidden effect: measure, compare, diagnose, add it, and see the error fall.

    The world belongs to the runs folder. `rig bench reveal` tells what was hidden.

    \f
    `--json` only takes the runs, without a guide: `{"runs": [...]}`.
    """
    from rig.bench import assembly, control
    from rig.bench.benchfile import describe

    description = describe(bench_path(bench))
    with assembly.occupied(description, runs):  # another program's bench is not taken from under it
        control.stop(assembly.state_folder(description, runs))
        assembly.start_simulated(description, runs, seed)
    names = [take(dict(document), bench, runs, quiet=as_json) for document in STANDARD]
    if as_json:
        print_json({"runs": names})
        return
    _guide(ctx, names, runs, yes)


def _guide(ctx: click.Context, names: list[str], runs: Path, yes: bool) -> None:
    """The steps that a person would take, one after another, on a model of this demonstration's own."""
    from rig.cli import repair
    from rig.repair.model_file import path_of

    path = path_of(runs, f"demo-{names[0]}")
    carry(model=path)
    common = {"names": tuple(names), "model": path, "runs": runs, "as_json": False}
    asking = {**common, "start": None, "effects": None}
    click.echo(f"\nOne effect is hidden in this world. Two runs were taken: {' '.join(names)}")
    _pause(yes, command("compare", *names))
    ctx.invoke(repair.compare, **asking)
    _pause(yes, command("diagnose", *names))
    ctx.invoke(repair.diagnose, **asking)
    taken = _taken(names, runs, path)
    if taken is not None:
        name, on = taken
        _pause(yes, adding(name, names, on))
        ctx.invoke(repair.add, effect=name, on=on, formula=None, **{**asking, "start": ()})
        _pause(yes, command("history", *names))
        ctx.invoke(repair.history, **common)
    else:
        click.echo("\nnothing to add: what is hidden does not show in these two runs")
    click.echo("\nnow see whether it was true")
    say_next(command("bench", "reveal"))


def _taken(names: Sequence[str], runs: Path, path: Path) -> tuple[str, tuple[str, ...]] | None:
    """The effect that the diagnosis takes first, and the channels it acts on."""
    steps = _diagnosed(opened(names, runs, path, None, None)).steps
    return (steps[0].taken.name, on_what(steps[0].taken.term)) if steps else None


def _pause(yes: bool, command: str) -> None:
    click.echo(f"\n$ {command}")
    if not yes:
        click.pause("  press a key to run it ")
