"""Commands that explain a sensor: compare, diagnose, add, remove, fit, history.

All of these take several runs by name, `last`, or `all` for every completed run in the folder, and one model: that of
the unit, or the one that `--model` names. They end with exit code 0 whatever the answer.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from rig.cli.onward import Carried, command, completed, say_next
from rig.cli.options import MODEL, effects_option, json_option, print_json, runs_option
from rig.cli.progress import Doing

if TYPE_CHECKING:
    from rig.diagnose.conclusion import Candidate, Conclusion
    from rig.diagnose.misfit import Comparison, Group
    from rig.diagnose.prediction import Prediction
    from rig.fit.quality import Place
    from rig.model import Term
    from rig.repair.model_file import Model, Step
    from rig.repair.repair import Bench, Repaired

F = TypeVar("F", bound=Callable[..., Any])

FEW = 4  # faults of records that a verdict names
NEAR = 0.5  # of the excess that the nearest on the shelf explains: worth trying
RUN_NAMES = click.argument("names", metavar="RUN...", nargs=-1, required=True)
MODEL_STARTS = ("datasheet", "paper", "shared")
EFFECT = click.argument("effect", metavar="EFFECT")
START = click.option(
    "--start",
    cls=Carried,
    type=click.Choice(MODEL_STARTS),
    show_default="datasheet",
    help="Where a new model starts: the data sheet's, the paper's without output filter, or one with a single "
    "sensitivity for all axes.",
)
ON = click.option(
    "--on",
    multiple=True,
    metavar="CHANNELS",
    help="acceleration or rate, if it can act on both; or the channels or the unit that alone have it, by name "
    "(repeat for several).",
)


class Starts(Carried):
    """Starts of a model and of coefficients; only the first go along, because a formula is added once."""

    def texts(self, value: Any) -> tuple[str, ...]:
        return tuple(one for one in value if "=" not in one)


def model_options(*, start: bool = True) -> Callable[[F], F]:
    """Everything that says which model is meant, and where the runs are."""
    options = (MODEL, *((START,) if start else ()), effects_option, runs_option, json_option)
    return lambda command: functools.reduce(lambda made, option: option(made), reversed(options), command)


@dataclass(frozen=True)
class Opened:
    """Runs and model that a command works on: `path` is the model's file, whether or not it is there yet."""

    bench: Bench
    model: Model
    path: Path
    names: tuple[str, ...]
    runs: Path

    @property
    def figures(self) -> Path:
        """Folder for figures of these runs."""
        return self.runs / "reports" / self.bench.evidence.runs[0]


def opened(names: Sequence[str], runs: Path, model: Path | None, start: Any, effects: Path | None) -> Opened:
    """Runs and model by the options that the commands share. Raises BadInput."""
    from rig.fit import floor
    from rig.notebook import records_of
    from rig.repair.model_file import path_of
    from rig.repair.repair import bench_of, model_at
    from rig.shelf import shelf

    bench = bench_of(records_of(names, runs), shelf(effects), floor.load(floor.path_of(runs)))
    path = model or path_of(runs, bench.evidence.serial)
    return Opened(bench, model_at(path, bench, start), path, tuple(names), runs)


@click.command()
@RUN_NAMES
@click.option("--as-is", is_flag=True, help="Hold the model's values: does it predict runs that it was not fitted to?")
@click.option("--figures", is_flag=True, help="Draw what is left over, as SVG.")
@click.option("--png", is_flag=True, help="Draw it as PNG too.")
@model_options()
def compare(
    names: tuple[str, ...], as_is: bool, figures: bool, png: bool, model: Path | None, start: str | None,
    effects: Path | None, runs: Path, as_json: bool,
) -> None:  # fmt: skip
    """Fit the model to runs and compare its error with the noise measured independently; 1 is noise and nothing else.

    RUN is a run's name, `last`, or `all` for every completed run in the folder. Without a model file the data sheet's
    model is compared. Figures that are asked for go to reports/<first run>/ under the runs folder. With --as-is it is
    said besides what one level of its own for every channel would explain.

    \f
    `--json` gives `groups` (a list of `name`, `channels`, `experiment`, `error`, `noise`, `unit`, `ratio`,
    `heldout_ratio`, `heldout_error`, `noise_from`), `error` and `heldout_error` of all rows together (noise = 1, null
    where too few are held out), `worst_at` (`where` it is worst, with `ratio`, `heldout_ratio`, `error`, `unit`),
    `worst` (a list of `where`, `ratio`, `in_words`), `references` that would have to leave their stated uncertainty
    (`effect`, `parameter`, `times`, `in_words`), `findings` (as `rig import` gives them) and `figures`; with
    `--as-is` `groups`, `with_levels` (groups again), `levels` (a list of `channel`, `relative`, `u`) and
    `shape_holds`.
    """
    work = opened(names, runs, model, start, effects)
    if as_is:
        _predict(work, as_json)
        return
    found = _compared(work, work.model)
    drawn = _drawn(work, found, (*(("svg",) if figures or png else ()), *(("png",) if png else ())))
    if as_json:
        print_json(found.as_json(drawn))
        return
    notes = _notes_text(work)
    left_out = [f"found: {one.in_words}" for one in found.faults]
    said = [
        *groups_text(found.groups), all_text(found), *worst_text(found), *untold_text(found.groups), *left_out, *notes
    ]  # fmt: skip
    click.echo("\n".join([_title("compare", work), *said]))
    for path in drawn:
        click.echo(f"figure: {path}")
    if not drawn:
        click.echo(f"figures: {command('compare', *names, '--figures')}")
    say_next(command("diagnose", *names))


def _drawn(work: Opened, found: Comparison, kinds: Sequence[str]) -> list[Path]:
    """Figures of these kinds; none asked, none drawn: that takes as long as all the rest."""
    if not kinds:
        return []
    from rig.report.misfit_figures import draw

    return draw(work.bench.evidence, found.fit, work.figures, kinds)


def _predict(work: Opened, as_json: bool) -> None:
    """Compare with the model's values held, and say what a level of its own for every channel would explain."""
    from rig.diagnose.prediction import predict
    from rig.errors import BadInput
    from rig.repair.model_file import terms_of

    model = work.model
    if not model.channels:
        raise BadInput(
            f"{work.path}: found no fitted model, wanted one to hold, as `{command('fit', *work.names)}` makes"
        )
    sensitivity = {name: one.sensitivity.value for name, one in model.channels.items()}
    pole = {name: one.pole.value for name, one in model.channels.items() if one.pole is not None}
    terms = terms_of(model, work.bench.shelf)
    found = predict(work.bench.evidence, terms, sensitivity, pole, poles=model.poles)
    if as_json:
        print_json(found.as_json())
        return
    said = [*prediction_text(found), *_notes_text(work)]
    click.echo("\n".join([_title("compare as it is", work), *said]))
    say_next(command("fit" if found.holds else "diagnose", *work.names))


def prediction_text(found: Prediction) -> list[str]:
    """A model held as it is: its error, and what one factor per channel explains of it."""
    lines = [*groups_text(found.as_is.groups), "  with a level of its own for every channel:"]
    lines += groups_text(found.levelled.groups)
    lines += [f"  {one.channel}: level {one.relative:+.3%} ± {2.0 * one.u:.3%} (k = 2)" for one in found.levels]
    if found.holds:
        lines.append(
            "  the shape holds: what differs is one factor at every condition, which is sensitivity, reference"
        )
        lines.append("  or mounting, and not the sensor's dynamics")
    else:
        lines.append("  the shape does not hold: no factor explains what is left")
    return lines


def _notes_text(work: Opened) -> list[str]:
    """What is to be said of imported records; of the rig's own, a diagnosis says it among what cannot be seen."""
    evidence = work.bench.evidence
    return (
        ["of the records:", *(f"  {completed(note)}" for note in evidence.notes)]
        if evidence.imported and evidence.notes
        else []
    )


def _compared(work: Opened, model: Model) -> Comparison:
    from rig.diagnose.misfit import compare as compared
    from rig.repair.model_file import terms_of

    return compared(work.bench.evidence, terms_of(model, work.bench.shelf), model.poles, model.shared)


def _title(what: str, work: Opened) -> str:
    evidence, model = work.bench.evidence, work.model
    with_what = ", ".join(entry.effect for entry in model.effects) or "no effect"
    mark = "  SIMULATED" if evidence.simulated else ""
    return f"{what}: {evidence.serial}, {model.start} model with {with_what}, {', '.join(evidence.runs)}{mark}"


def groups_text(groups: Iterable[Group]) -> list[str]:
    """The table of errors by group of rows, SI, or per cent of powers."""
    from rig.fit.quality import relative

    rows = list(groups)
    width = max((len(one.name) for one in rows), default=0)
    lines = [f"  {'':<{width}}  {'error':>9}  {'noise':>9}  {'ratio':>7}  {'held out: error':>15}  {'ratio':>7}"]
    for one in rows:
        unit, scale = relative(one.unit)
        error, noise, later = (scale * value for value in (one.error, one.noise, one.heldout_error))
        few = not math.isfinite(one.heldout_ratio)
        held = f"{'too few':>15}  {'':>7}" if few else f"{later:>15.3g}  {one.heldout_ratio:>7.3g}"
        lines.append(f"  {one.name:<{width}}  {error:>9.3g}  {noise:>9.3g}  {one.ratio:>7.3g}  {held}  {unit}".rstrip())
    return lines


def all_text(found: Comparison) -> str:
    """The error of all rows together, as every other command says it, and where it is largest."""
    errors = found.errors
    return (
        f"together: error {errors.error:.4g} times the noise, on held-out data {held_text(errors.heldout)}; "
        f"most in {place_text(errors.worst)}"
    )


def place_text(one: Place) -> str:
    """Where an error is largest, with what it is there."""
    return f"{one.where}: {ratio_text(one)}" + ("" if math.isnan(one.heldout) else f", held out {one.heldout:.3g}")


def ratio_text(one: Place) -> str:
    """An error against its noise, and in SI."""
    return f"{one.ratio:.3g}" + (f" ({one.size})" if one.size else "")


def held_text(value: float | None) -> str:
    """An error on held-out data."""
    return "not judged (too few rows)" if value is None or math.isnan(value) else f"{value:.4g}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def worst_text(found: Comparison) -> list[str]:
    """The worst conditions in words, those that noise hardly makes, and references that cannot be as stated."""
    rows = [f"  {one.in_words} ({one.ratio:.3g} times {one.against})" for one in found.worst if one.stands_out]
    rows += [f"  {one.in_words}" for one in found.references]
    return ["worst:", *rows] if rows else ["nothing stands out of the noise"]


def untold_text(groups: Iterable[Group]) -> list[str]:
    """Which ratios say nothing, and what would make them."""
    blind = [one for one in groups if not one.told]
    if not blind:
        return []
    names = ", ".join(one.name for one in blind)
    return [
        f"noise known only from what a model leaves over, so that its ratio judges nothing: {names}; {_to_know(blind)}"
    ]


def _to_know(blind: Iterable[Group]) -> str:
    """What would make the noise of these groups known."""
    return "; ".join(dict.fromkeys(one.to_know for one in blind))


@click.command()
@RUN_NAMES
@model_options()
def fit(
    names: tuple[str, ...], model: Path | None, start: str | None, effects: Path | None, runs: Path, as_json: bool
) -> None:
    """Fit the model to every RUN, or start one, and write it with values, uncertainties, covariance and history.

    \f
    `--json` of `fit`, `add` and `remove` gives `model`, `unit`, `simulated`, `runs`, `effects` as they stand in the
    model's file, the steps of the history `before` and `after`, and `remarks`.
    """
    from rig.repair.repair import fitted

    work = opened(names, runs, model, start, effects)
    _conclude(work, fitted(work.bench, work.model), as_json)


@click.command()
@RUN_NAMES
@model_options()
def diagnose(
    names: tuple[str, ...], model: Path | None, start: str | None, effects: Path | None, runs: Path, as_json: bool
) -> None:
    """Find the physical effects that the model lacks, with reasons, probabilities, and what would tell them apart.

    Several are found one after another, with every RUN together. If nothing on the shelf brings the error to the noise,
    the answer is `unlisted`. The answer ends with what this data cannot see. The exit code is 0 whatever the answer.

    \f
    `--json` gives `verdict` (`adequate`, `missing`, `unlisted`, `undecided`); `error`, `heldout_error` and `worst_at`
    of the model as it is and `error_after`, `heldout_error_after`, `worst_after` and `references` with all steps taken,
    which are those of `rig compare`, as `groups` are; `untold` (groups with all steps taken whose noise is known only
    from what the model leaves over: on these no `adequate` stands), `findings` (as `rig import` gives them: samples
    that were left out, and what else looks wrong), `candidates` best first (`effect`, `on`, `channels` of that which
    alone have it, `class` with itself included, `probability`, `error_after`, `heldout_error_after`, `worst_after`,
    `parameters` by name with `value`, `unit`, `u`; `not_known_apart`, null or two `parameters` with their `correlation`
    and what is known of them `together`; `depends_on_band`, `plausible`, `because`, `separate_by`, and the `step` in
    which it was or could be `taken`), `excluded` (`step`, `effect`, `error_after`, null where it was not refitted,
    `why`), `description` and
    `cannot_see`. Errors of a candidate are √(χ²/n): noise is 1.
    """
    from rig.diagnose.conclusion import conclude
    from rig.repair.model_file import terms_of

    with Doing() as told:
        told("reading the runs")
        work = opened(names, runs, model, start, effects)
        shelf, of = work.bench.shelf, work.model
        said = conclude(work.bench.evidence, terms_of(of, shelf), shelf, poles=of.poles, shared=of.shared, told=told)
    if as_json:
        print_json(diagnosis_as_json(said, _compared(work, work.model).as_json([])["groups"]))
        return
    click.echo("\n".join([_title("diagnose", work), *diagnosis_text(said), *_notes_text(work)]))
    say_next(*_next_after(said, work))


def diagnosis_as_json(said: Conclusion, groups: Sequence[Any]) -> dict[str, Any]:
    """What `rig diagnose --json` prints."""
    from rig.diagnose.misfit import finite, place_as_json

    return {
        "verdict": said.verdict,
        "error": said.error,
        "heldout_error": finite(said.heldout_error),
        "error_after": said.after,
        "heldout_error_after": finite(said.heldout_after),
        "worst_at": place_as_json(said.worst),
        "worst_after": place_as_json(said.worst_after),
        "references": [one.as_json() for one in said.references],
        "groups": list(groups),
        "candidates": [one.as_json() for one in said.candidates],
        "excluded": [one.as_json() for one in said.excluded],
        "untold": [one.as_json() for one in said.untold],
        "findings": [one.as_json() for one in said.faults],
        "description": completed(said.description),
        "cannot_see": [completed(one) for one in said.cannot_see],
    }


def diagnosis_text(said: Conclusion) -> list[str]:
    """A diagnosis as a person reads it."""
    lines = [verdict_text(said)]
    for step in range(1, len(said.taken) + 1):
        here = [one for one in said.candidates if one.step == step]
        lines += ["", *candidate_text(here[0], said.verdict == "unlisted")]
        lines += [f"  not excluded by this data: {_other_text(one)}" for one in here[1:]]
        lines += [
            f"  ranked below: {one.effect}, not refitted: {one.why}" if one.error_after is None else
            f"  ranked below: in its place {one.effect} would leave {one.error_after:.4g}, {one.why}"
            for one in said.excluded if one.step == step
        ]  # fmt: skip
    if said.description:
        lines += ["", *(f"  {piece}" for piece in said.description.replace(".; ", "; ").split("; "))]
    lines += ["", *(f"  {one.in_words}" for one in said.references)] if said.references else []
    lines += ["", "this data cannot see:", *(f"  {one}" for one in said.cannot_see)] if said.cannot_see else []
    return [completed(line) for line in lines]


def verdict_text(said: Conclusion) -> str:
    """The verdict in one line."""
    errors = f"error {said.error:.4g} times the noise"
    names = " and ".join(one.effect for one in said.taken)
    there = f"where it is worst ({said.worst.where}) {ratio_text(said.worst)}"
    match said.verdict:
        case "adequate":
            return f"verdict: adequate - the model leaves nothing but noise ({errors})"
        case "missing":
            after = f"with it {said.after:.4g}, there {ratio_text(said.worst_after)}"
            return f"verdict: missing {names} - {errors}, {there}; {after}"
        case "unlisted":
            return f"verdict: unlisted effect - {errors}, {there}; with the best of the shelf {said.after:.4g}"
        case _:
            return f"verdict: undecided - {'; '.join(_undecided(said, errors))}"


def _undecided(said: Conclusion, errors: str) -> Iterator[str]:
    """Why nothing stands out, and the model is not called adequate all the same."""
    from rig.fit.quality import with_unit

    if wrong := [one.in_words for one in said.faults if one.misread]:
        more = f" and {len(wrong) - FEW} more" if len(wrong) > FEW else ""
        yield f"{errors}; axes are not those of the manifest, so no effect was looked for: mend it and import again"
        yield f"{'; '.join(wrong[:FEW])}{more}"
        return
    if said.untold:
        sizes = ", ".join(f"{with_unit(one.error, one.unit)} ({one.name})" for one in said.untold)
        yield f"error is {sizes}"
        yield f"whether that is noise cannot be told: {_to_know(said.untold)}"
    else:
        yield errors
    if said.unjudged:
        yield said.unjudged
    if words := [one.in_words for one in said.faults if not one.accepted]:
        more = f" and {len(words) - FEW} more" if len(words) > FEW else ""
        yield f"the records hold what is no measurement ({'; '.join(words[:FEW])}{more}): look at it first"


def candidate_text(one: Candidate, nearest: bool) -> list[str]:
    """One missing effect with all that speaks for it."""
    on = f" of {', '.join(one.channels)} only" if one.channels else f" of the {one.on} channels" if one.on else ""
    head = f"{'nearest' if nearest else one.step}: {one.effect} ({one.title}{on}), probability {one.probability:.3g}"
    lines = [f"  {head}"]
    lines += [f"     {said}" for said in _sizes(one)]
    if one.depends_on_band:
        lines.append("     its size DEPENDS ON THE BAND: another comes out where twice the band is compared")
    size = "usual" if one.plausible else "NOT usual: look for another cause too"
    lines.append(f"     its size is {size}; U is expanded (k = 2)")
    held = held_text(one.heldout_error_after)
    lines.append(f"     error with it {one.error_after:.4g}, on held-out data {held} (noise 1)")
    if one.there.where:
        lines.append(f"     where it was worst ({one.there.where}) it leaves {ratio_text(one.there)}")
    lines.append(f"     because {one.because}")
    if len(one.members) > 1:
        lines.append(f"     class: {', '.join(one.members)}")
    lines.append(f"     to be sure: {one.separate_by}")
    return lines


def _sizes(one: Candidate) -> Iterator[str]:
    """Its parameters; those that are not known apart in one sentence."""
    apart = () if one.tied is None else one.tied.names
    yield from (f"{name} = {value.text}" for name, value in one.parameters.items() if name not in apart)
    if one.tied is not None:
        yield one.tied.text


def _other_text(one: Candidate) -> str:
    values = ", ".join(_sizes(one))
    size = "" if one.plausible else ", not a usual size"
    return f"{one.effect} ({values}{size}), error {one.error_after:.4g}, probability {one.probability:.2g}"


def _first(said: Conclusion, work: Opened) -> str:
    """The command that adds the first effect taken."""
    first = said.taken[0]
    effect = work.bench.shelf.get(first.effect)
    on = first.on if effect is not None and len(effect.quantities) > 1 else None
    return adding(first.effect, work.names, first.channels or (on,))


def adding(effect: str, names: Sequence[str], on: Sequence[str | None]) -> str:
    """The command that adds an effect; `on` what, where it has to be said."""
    return command("add", effect, *names, *(word for one in on if one for word in ("--on", one)))


def on_what(term: Term) -> tuple[str, ...]:
    """What `--on` has to say of a term."""
    return term.only or ((term.on,) if term.on is not None and len(term.effect.quantities) > 1 else ())


def _next_after(said: Conclusion, work: Opened) -> list[str]:
    if any(one.misread for one in said.faults):
        return [command("show", one) for one in work.bench.evidence.runs]
    if said.verdict == "missing":
        return [_first(said, work)]
    if said.verdict in ("adequate", "undecided"):
        return [f"{command('fit', *work.names)} && {command('history', *work.names)}"]
    if said.taken and said.diagnosis.explained > NEAR:
        return [_first(said, work), command("compare", *work.names)]
    return [command("compare", *work.names)]


@click.command()
@EFFECT
@RUN_NAMES
@ON
@click.option("--formula", metavar="TEXT", help="A term of your own, e.g. 'k * omega**2'; EFFECT is its name then.")
@click.option(
    "--start",
    cls=Starts,
    multiple=True,
    metavar="WHERE",
    help="Where the fit of a formula's coefficient starts, with its unit: --start 'tau=10 s' (repeat for others, or to "
    "try several); or where a new model starts: datasheet, paper or shared.",
)
@model_options(start=False)
def add(
    effect: str, names: tuple[str, ...], on: tuple[str, ...], formula: str | None, start: tuple[str, ...],
    model: Path | None, effects: Path | None, runs: Path, as_json: bool,
) -> None:  # fmt: skip
    """Add EFFECT to the model, refit to every RUN, and write the model with one more step of history.

    Prints the errors before and after, on fitted and on held-out data. An effect may be in some channels only. A term
    of your own needs a name that no effect of the shelf has, and starts for coefficients to which it is not
    proportional:

    \b
    rig add delay last --on unit_a_x
    rig add creep last --formula 'k*exp(-t/tau)' --start 'tau=10 s' --on rate

    \f
    More of formulas: [a term of your own](../how-to/add-an-effect.md#a-formula).
    """
    from rig.errors import BadInput
    from rig.formula import own_term
    from rig.repair.repair import added, channels_named

    words, starts = start_words(start), [one for one in start if "=" in one]
    if starts and formula is None:
        raise BadInput(f"--start: found '{starts[0]}' without a formula, wanted --formula with it")
    work = opened(names, runs, model, words[-1] if words else None, effects)
    quantity, channels = channels_named(work.bench, on)
    own = None if formula is None else own_term(formula, starts, channels)
    _conclude(work, added(work.bench, work.model, effect, quantity, own, channels), as_json)


def start_words(given: Sequence[str]) -> list[str]:
    """Starts of a model among starts of coefficients. Raises BadInput for what is neither."""
    from rig.errors import BadInput

    found = [one for one in given if "=" not in one]
    for one in found:
        if one not in MODEL_STARTS:
            raise BadInput(f"--start: found '{one}', wanted {', '.join(MODEL_STARTS)}, or a coefficient's 'tau=10 s'")
    return found


@click.command()
@EFFECT
@RUN_NAMES
@ON
@model_options()
def remove(
    effect: str, names: tuple[str, ...], on: tuple[str, ...], model: Path | None, start: str | None,
    effects: Path | None, runs: Path, as_json: bool,
) -> None:  # fmt: skip
    """Take EFFECT out of the model, refit to every RUN, and write the model with one more step of history."""
    from rig.repair.repair import channels_named, removed

    work = opened(names, runs, model, start, effects)
    _conclude(work, removed(work.bench, work.model, effect, *channels_named(work.bench, on)), as_json)


def _conclude(work: Opened, made: Repaired, as_json: bool) -> None:
    """Keep the model and say what became of it."""
    from rig.repair.model_file import save

    save(work.path, made.model)
    if as_json:
        print_json(repaired_as_json(work.path, made))
        return
    click.echo("\n".join(repaired_text(made)))
    click.echo(f"model: {work.path}")
    say_next(command("diagnose", *work.names), command("history", *work.names))


def repaired_as_json(path: Path, made: Repaired) -> dict[str, Any]:
    """A step of repair: the model's effects, and errors before and after (noise = 1)."""
    model = made.model.model_dump(mode="json", exclude_none=True)
    return {
        "model": str(path),
        "unit": made.model.unit,
        "simulated": made.model.simulated,
        "runs": list(made.model.runs),
        "effects": model["effects"],
        "before": made.before.model_dump(mode="json"),
        "after": made.after.model_dump(mode="json"),
        "remarks": list(made.remarks),
    }


def repaired_text(made: Repaired) -> list[str]:
    """The effects of a model after a step, and its errors before and after."""
    from rig.fit.parameters import Estimate

    mark = "  SIMULATED" if made.model.simulated else ""
    done = " ".join(part for part in (made.after.action, made.after.effect) if part)
    lines = [f"{done}: {made.model.unit}, {made.model.start} model{mark}"]
    for entry in made.model.effects:
        values = ", ".join(f"{n} = {Estimate(v.value, v.unit, v.u).text}" for n, v in entry.parameters.items())
        lines.append(f"  {entry.effect}{f' ({entry.where})' if entry.where else ''}{f': {values}' if values else ''}")
    lines += [f"  note: {remark}" for remark in made.remarks]
    return [*lines, *_errors_text(made)]


def _errors_text(made: Repaired) -> list[str]:
    """Errors before and after a step, over everything and where they were worst."""
    before, after = made.before, made.after
    if before is after:
        lines = [f"  error {after.error:.4g} times the noise, on held-out data {held_text(after.heldout)}"]
        return [*lines, *_worst_now(after)]
    lines = [
        f"  error {before.error:.4g} -> {after.error:.4g} times the noise, "
        f"on held-out data {held_text(before.heldout)} -> {held_text(after.heldout)}"
    ]
    if after.action == "remove" or not before.worst_at:
        return [*lines, *_worst_now(after)]
    was, now = before.place, made.at(before.worst_at)
    lines.append(f"  where it was worst ({was.where}): {ratio_text(was)} -> {ratio_text(now)}")
    if math.isfinite(was.heldout) and math.isfinite(now.heldout):
        lines.append(f"  there on held-out data: {was.heldout:.3g} -> {now.heldout:.3g}")
    return lines


def _worst_now(step: Step) -> list[str]:
    return [f"  where it is worst: {place_text(step.place)}"] if step.worst_at else []


@click.command()
@click.argument("names", metavar="[RUN...]", nargs=-1)
@MODEL
@runs_option
@json_option
def history(names: tuple[str, ...], model: Path | None, runs: Path, as_json: bool) -> None:
    """Every step of the model's repair with its error on fitted and held-out data against the noise floor.

    RUN says whose unit's model is meant, without it the newest run; with --model it is not needed.

    \f
    `--json` gives `model`, `unit`, `simulated`, `history` (the steps) and `figures`.
    """
    from rig.repair.ladder_figure import draw
    from rig.repair.model_file import load

    path = model or _model_of(names or ("last",), runs)
    found = load(path)
    figures = draw(found, runs / "reports" / path.stem)
    if as_json:
        steps = [step.model_dump(mode="json") for step in found.history]
        print_json({"model": str(path), "unit": found.unit, "simulated": found.simulated, "history": steps,
                    "figures": [str(one) for one in figures]})  # fmt: skip
        return
    mark = "  SIMULATED" if found.simulated else ""
    click.echo("\n".join([f"history of {found.unit}, {path}{mark}", *history_text(found.history)]))
    for one in figures:
        click.echo(f"figure: {one}")
    say_next(command("diagnose", *(names or found.runs or ("last",))))


def _model_of(names: Sequence[str], runs: Path) -> Path:
    """The model file of the unit that a run measured."""
    from rig.notebook import records_of
    from rig.repair.model_file import path_of

    return path_of(runs, str(records_of(names, runs)[0].header["sensor"]["serial"]))


def history_text(steps: Sequence[Step]) -> list[str]:
    """The ladder as a table; the noise floor is 1. `worst` is the error of the channel and domain furthest above it,
    then that of the rows held out there.
    """
    names = [" ".join(p for p in (s.action, s.effect, f"({s.where})" if s.where else None) if p) for s in steps]
    width = max((len(name) for name in names), default=0)
    heads = ("error", "held out", "worst", "held out", "noise", "χ²/dof")
    lines = [f"  {'':>2}  {'':<{width}}  {'  '.join(f'{head:>8}' for head in heads)}  runs  where it is worst"]
    for number, (step, name) in enumerate(zip(steps, names, strict=True), 1):
        values = (step.error, step.heldout, step.worst, step.worst_heldout, step.noise, step.chi2_dof)
        table, size = "  ".join(f"{_number(value):>8}" for value in values), step.place.size
        worst = f"{step.worst_at}{f': {size}' if size else ''}"
        lines.append(f"  {number:>2}  {name:<{width}}  {table}  {len(step.runs):>4}  {worst}".rstrip())
    return lines
