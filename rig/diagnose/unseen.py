"""What this data cannot see, in words: an honest diagnosis ends with it.

An effect is invisible if the fit takes it up entirely, if its signature lies within what the model fits anyway, if
nothing in the runs excites it, or if it needs a record that is not there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from rig.diagnose.search import HIDDEN, Score
from rig.fit.evidence import Evidence
from rig.model import Effect

TESTED = ("closure", "dropouts", "clock")  # effects with a test of their own that looks for them
MOVING = 0.5  # rad/s
LOGGED = {"temperature": "the temperature", "supply": "the supply", "source": "the drive's voltage"}


def cannot_see(
    evidence: Evidence, scores: Iterable[Score], shelf: Mapping[str, Effect], misplaced: Sequence[str] = ()
) -> tuple[str, ...]:
    """Every limitation of these runs, one sentence each; `misplaced` is metadata that cannot be right.

    Of imported records alone nothing is said about this bench's own experiments.
    """
    if evidence.imported:
        return tuple(dict.fromkeys([*misplaced, *evidence.blind, *_unlogged(evidence, shelf), *_within(scores)]))
    said = [*misplaced, *_conditions(evidence), *_hidden(evidence, scores), *_elsewhere(evidence, shelf)]
    said += [
        *_unlogged(evidence, shelf),
        *_absorbed(evidence, shelf),
        *_untested(shelf),
        *evidence.blind,
        *evidence.notes,
    ]
    return tuple(dict.fromkeys(said))


def _within(scores: Iterable[Score]) -> Iterator[str]:
    """Effects of the shelf that imported records cannot show, in one sentence."""
    names = sorted({score.start.key for score in scores if score.visible < HIDDEN})
    if names:
        yield f"within what the model fits anyway, and so not seen in this data: {', '.join(names)}"


def _unlogged(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[str]:
    """Signals that no record holds, and what can therefore not be found to be the cause."""
    there = {part.place for part in evidence.parts}
    held = {name for part in evidence.parts for name in part.logged}
    here = [one for one in shelf.values() if there.intersection(one.places) and not one.absorbed]
    for signal, words in LOGGED.items():
        names = sorted(one.name for one in here if signal in one.needs)
        if names and signal not in held:
            yield f"{words} is in no record, and so cannot be the cause: {', '.join(names)}"


def _conditions(evidence: Evidence) -> Iterator[str]:
    """What the runs lack."""
    if evidence.sines:
        yield from _of_shaker(evidence)
    if evidence.turnings:
        yield from _of_turntable(evidence)
    if not evidence.sines:
        yield "no sweep: the dynamics of the accelerometers, their nonlinearity and cross-axis sensitivity"
    if not evidence.turnings:
        yield "no turntable run: everything that only a rate shows, the gyros' nonlinearity and asymmetry among it"


def _of_shaker(evidence: Evidence) -> Iterator[str]:
    levels = {level for part in evidence.sines for level in part.data.level if level != "rest"}
    if len(levels) == 1:
        yield (
            "one drive level only: gain that depends on level cannot be told from gain that depends on frequency; "
            "repeat with --levels full,quarter"
        )
    if not any("rest" in part.data.level for part in evidence.sines):
        yield "no static record: zero output, its drift and slow noise at rest on the shaker; add a record at rest"
    axes = sorted({part.data.axis for part in evidence.sines})
    if len(axes) < 3:
        yield f"driven along {', '.join(axes)} only: accelerometers across it feel no drive but gravity"


def _of_turntable(evidence: Evidence) -> Iterator[str]:
    signs: set[float] = set()
    for part in evidence.turnings:
        rate = part.data.counted.rate
        # the encoder turns one way; which way the unit feels it depends on what is up
        up = part.data.up[np.argmax(np.abs(part.data.up), axis=0), np.arange(part.data.up.shape[1])]
        felt = (rate * up)[np.abs(rate) > MOVING]
        signs |= set(np.unique(np.sign(felt[np.isfinite(felt)])).tolist())
    if len(signs) == 1:
        yield "one sense of rotation only: asymmetry and even nonlinearity of the gyros hide in their sensitivity"
    rest = any(bool(np.any(np.abs(part.data.counted.rate) < MOVING)) for part in evidence.turnings)
    if not rest:
        yield "no static record on the turntable: zero output of the gyros and its drift"


def _hidden(evidence: Evidence, scores: Iterable[Score]) -> Iterator[str]:
    invisible = [score for score in scores if score.visible < HIDDEN]
    still = [s.start.effect.name for s in invisible if s.start.on == "rate" and not evidence.turnings]
    if still:
        yield f"the gyros were not turned, so these of theirs do not show: {', '.join(sorted(still))}"
    for score in invisible:
        if score.start.effect.name not in still or score.start.on != "rate":
            effect = score.start.effect
            on = f" ({score.start.on})" if score.start.on and len(effect.quantities) > 1 else ""
            yield f"{effect.name}{on}: what it does here is within what the model fits anyway; {effect.separate_by}"


def _elsewhere(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[str]:
    there = {part.place for part in evidence.parts}
    for place in ("shaker", "turntable"):
        if place not in there:
            names = sorted(e.name for e in shelf.values() if tuple(e.places) == (place,) and not e.absorbed)
            if names:
                yield f"nothing was measured on the {place}, where alone these show: {', '.join(names)}"


def _absorbed(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[str]:
    there = {part.place for part in evidence.parts}
    for effect in shelf.values():
        if effect.absorbed and there.intersection(effect.places):
            yield f"{effect.name}: {effect.absorbed}"


def _untested(shelf: Mapping[str, Effect]) -> Iterator[str]:
    names = sorted(e.name for e in shelf.values() if e.looks_in and e.looks_in not in TESTED and not e.absorbed)
    if names:
        yield f"not looked for, because noise is taken from these records and not from a model: {', '.join(names)}"
