"""The page of the blind test: what was done, what it says in plain words, and all tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import blind_next
import blind_scores
import blind_wire
from blind_scores import Trial

Table = Sequence[Sequence[str]]  # the head first

INTRODUCTION = """\
# Blind test: how often is a hidden effect found?

`rig diagnose` says which physical effect a sensor's model lacks (try it in [the tutorial](tutorial/hidden-effect.md);
[how it works](explanation/model-repair.md)). This page says how often that is right. It is measured on simulated
benches, where the truth can be known: a world is drawn, nothing or one or two effects are hidden in it, and the answer
is written to a file and its digest noted before the records are diagnosed. The diagnosis sees the records alone. The
simulation is written separately from the program's own effects and shares no code with them.

How strong an effect is, is said by d′ (d prime): the size of its signature in the standard run, in units of the
noise, after everything has been taken away that the data-sheet model can adjust to it. Strengths are drawn between 6
and 600, each factor of ten as often as another, but never beyond the size that such instruments and sensors can have.
An effect of d′ 6 can just be seen by somebody who knows what to look for. Noise counts by what spectra of records at
rest show beside the levels that a data sheet leaves open.

Imported records are simulated too, as others might hand them in, with no band stated: rotations with an encoder of
4096 codes and stamps that jitter, sweeps of two frequencies at three levels, free motion before cameras, 48 poses,
tables of responses at two levels. Their d′ counts against the noise of device and reference together, in the whole
record, up to 4 Hz where something moves; of a stranger only what no single effect of the shelf takes up. A fault's d′
is √Σ(Δ/σ)² over the samples that it changes, σ the noise of one sample (of a reference that slips the noise of its
difference from row to row): what it does in the band that is compared may be a tenth of that.
"""

COLUMNS = """\
Shares are given with their 95 % interval (Clopper and Pearson); a small study has wide ones. The *bar* is what was
asked for before the study was made. A world whose diagnosis ended with an error counts as wrong everywhere.

- *Exactly*: the hidden effect is named, and nothing else.
- *Noise known*: at rest, by a data sheet, from repeats, by the band above the motion; *not known*: only from what the
  model leaves over. Free motion before cameras is always of the second sort, and rightly `undecided` where nothing is
  found.
- *Any other effect*: also those that are not scored by name above, such as noise, lines and coarse codes.
- *In a first class of ≤ 3*: effects that the data cannot tell apart are named together, as a class; the first one has
  at most three members, and the truth is one of them.
- *On a fresh run*: the repaired model meets another run of the same unit. Only each channel's zero was adjusted, and
  what counts from a run's own beginning (the phase of the mains, the rest of a warm-up).
- *Held-out χ²* is compared with what the true effect leaves in the same rows; one sigma is √(2·rows).
- Times are those of one core, which other work may have shared.
"""

RELIABILITY = """\
Every effect that a diagnosis says is possible comes with a probability, and here stands how often such statements were
right: all that said nearly the same are counted together. *Honest*: the mean of what was stated lies within the 95 %
interval (Clopper and Pearson) of how often it was true. Where the hidden effect is on no shelf, and where nothing is
hidden, every name is wrong.
"""

NEXT = """\
A world that was not named exactly is measured and diagnosed anew; then the measurement that `rig next` ranks first is
carried out in the same world, and all runs are diagnosed together. *Power* is the χ² between the two effects in
question that is expected of the measurement; from 16 on it is expected to decide, from 4 on to help. When `rig next`
says that nothing is open (usually because a weak effect was not seen at all), nothing is measured.
"""

WIRE = """\
These worlds are behind sockets, and everything is done by the commands that a user has, each a process of its own:
`rig demo hidden` (a sealed world and its two standard runs, sweep and turntable), `rig diagnose`, `rig add`, and last
`rig bench reveal`. Any effect that the simulated bench can hide is drawn, also noise and the references' own errors.
Errors are in units of the noise, so 1 is as good as it gets. They are those of all channels together, in which one
channel's trouble is diluted.
"""

PEERS = """\
Other methods get what the program's own search begins with: the whitened residuals of the data-sheet model, and one
column for each effect of the shelf, both without what the model's own parameters can take up. They compete on the
choice alone, where linear methods are at home, and they are told the size of the noise. Penalty and threshold are
chosen by BIC.

- *pysindy STLSQ*: sequentially thresholded least squares (Brunton 2016), as pysindy does it, with a
  ridge of 1e-6.
- *lasso*: least squares with a penalty on the sum of coefficients (Tibshirani 1996).
- *BIC forward selection*: effects are added one after another as long as BIC falls (Schwarz 1978).

*Effects named* is the mean number in worlds with one hidden effect: 1 would be right. *Clean: one named* counts worlds
in which nothing is hidden and something was blamed. All methods are scored on the same worlds: those that the peers
were shown, which may be fewer than the study has.
"""


@dataclass(frozen=True)
class Study:
    """Everything that a page is made from. `peers` is a table, its head first; `made_by` the command; `asked` how many
    worlds that would make (0: those that are there).
    """

    made_by: str
    found: Sequence[Trial]
    again: Sequence[Trial] = ()
    wire: Sequence[Mapping[str, Any]] = ()
    peers: Table = field(default=())
    asked: int = 0


def page(study: Study) -> str:
    """The whole page."""
    rows = [*blind_scores.rows(study.found), *blind_next.rows(study.again), *blind_wire.rows(study.wire)]
    main = [("what", "found", "bar"), *((row.what, row.found, row.bar) for row in rows)]
    effects = blind_scores.by_effect(study.found)
    parts = [INTRODUCTION, f"{_made(study)}\n", *_section("What the figures say", "\n".join(in_words(study)))]
    parts += _section("All figures", COLUMNS, main)
    if effects:
        said = "In how many worlds each effect was named exactly, and what was said when it was not.\n"
        parts += _section("By effect", said, [("bench", "effect", "exact", "in the class", "instead"), *effects])
    stated = [one.row() for one in blind_scores.reliability(study.found)]
    if stated:
        head = ("hidden", "stated", "mean", "right", "honest")
        parts += _section("What stated probabilities are worth", RELIABILITY, [head, *stated])
    if study.again:
        parts += _section("After one more measurement", NEXT, blind_next.listed(study.again))
    if study.wire:
        parts += _section("Over the wire", WIRE, blind_wire.table(study.wire))
    if study.peers:
        parts += _section("Against other methods", PEERS, study.peers)
    return "\n".join(parts).rstrip("\n") + "\n"


def _made(study: Study) -> str:
    worlds = len(study.found) + len(study.wire)
    return (
        f"This page was made by `{study.made_by}` from {worlds} worlds{_of(study.asked, len(study.found))}.\n"
        "`make blind` without N makes the whole study, which takes hours; started again, it goes on where it was."
    )


def _of(asked: int, there: int) -> str:
    return f" (it was stopped before all {asked}; they are done in a mixed order)" if asked > there else ""


def _section(title: str, text: str, body: Table = ()) -> Iterator[str]:
    yield f"## {title}\n"
    yield text.rstrip("\n") + "\n"
    if body:
        yield "\n".join(_lines(body[0], body[1:])) + "\n"


def _lines(head: Sequence[str], body: Iterable[Sequence[str]]) -> list[str]:
    made = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return made + [f"| {' | '.join(row)} |" for row in body]


def in_words(study: Study) -> Iterator[str]:
    """One sentence for each thing that was measured."""
    clean = [one for one in study.found if one.table == "clean"]
    yield from _imported(study.found)
    single = [one for one in study.found if one.table == "one"]
    if clean:
        blamed = sum(bool(one.result["named"]) for one in clean)
        yield f"- Nothing hidden: in {len(clean)} clean worlds an effect was {_times(blamed)} blamed."
    if single:
        exact, held = sum(one.exact for one in single), sum(one.in_first_class for one in single)
        yield (
            f"- One effect hidden: in {exact} of {len(single)} worlds exactly that was named; in {held} the truth is "
            "in the first class."
        )
        yield from _misses(single)
    yield from _later(study)
    if study.peers:
        yield from _against(study.peers)


def _imported(found: Sequence[Trial]) -> Iterator[str]:
    """What was found in the records of others."""
    of = {table: [one for one in found if one.table == table] for table in ("imported_clean", "imported_one", "faults")}
    if clean := of["imported_clean"]:
        blamed = sum(bool(one.result["named"]) for one in clean)
        yield f"- Imported, nothing hidden: in {len(clean)} clean records an effect was {_times(blamed)} blamed."
    if single := [one for one in of["imported_one"] if one.answer.d_prime >= blind_scores.STRONG]:
        held = sum(one.in_first_class for one in single)
        yield f"- Imported, one effect of d′ ≥ 20: in {held} of {len(single)} records it is in the first class."
    if faulty := of["faults"]:
        fine, sure = (sum(map(of_what, faulty)) for of_what in (_adequate, lambda one: one.wrong_and_sure))
        yield (
            f"- Imported, samples that are no measurement, drifts, steps: of {len(faulty)} records {fine} were called "
            f"adequate, and in {sure} a physical effect was named with a probability of 0.9 or more."
        )


def _adequate(one: Trial) -> bool:
    return one.is_said("adequate")


def _misses(single: Sequence[Trial]) -> Iterator[str]:
    wrong = [one for one in single if not one.exact]
    silent = sum(not one.result["named"] for one in wrong)
    weak = sum(one.answer.d_prime < 10.0 for one in wrong)
    if wrong:
        yield (
            f"- Not exact: {len(wrong)}. Not seen at all: {silent}; another name, one too many or none that is sure: "
            f"{len(wrong) - silent}. With a d′ below 10: {weak}."
        )


def _later(study: Study) -> Iterator[str]:
    if study.again:
        exact = sum(one.exact for one in study.again)
        silent = sum(one.result["said"] == "nothing open" for one in study.again)
        measured = len(study.again) - silent
        yield (
            f"- One more measurement: worlds that were not exact, looked at again: {len(study.again)}. `rig next` "
            f"had a measurement for {measured} of them; exact afterwards: {exact}."
        )
    if study.wire:
        exact = sum(map(blind_wire.exact, study.wire))
        held = sum(map(blind_wire.in_class, study.wire))
        yield (
            f"- Over the wire: in {exact} of {len(study.wire)} sealed worlds the commands alone named exactly what was "
            f"hidden; in {held} the truth is in the first class."
        )


def _against(peers: Table) -> Iterator[str]:
    said = "; ".join(f"{row[0]} {row[1].partition(' (')[0]}" for row in peers[1:])
    yield f"- Exactly the hidden effect, on the same worlds: {said}."
    said = "; ".join(f"{row[0]} {row[3]}" for row in peers[1:])
    yield f"- Effects named where one is hidden, on average: {said}."


def _times(count: int) -> str:
    return {0: "never", 1: "once"}.get(count, f"{count} times")
