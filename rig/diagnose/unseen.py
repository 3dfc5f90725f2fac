"""What this data cannot see, in words: an honest diagnosis ends with it.

An effect is invisible if the fit takes it up entirely, if its signature lies within what the model fits anyway, if
nothing in the runs excites it, or if it needs a record that is not there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from rig.diagnose.search import Score
from rig.fit.evidence import Evidence
from rig.fit.fit import HIDDEN
from rig.model import Effect
from rig.parts import experiments

TESTED = ("closure", "dropouts", "clock", "lines", "codes", "graduation")  # looked for by tests of their own
LOGGED = {"temperature": "the temperature", "supply": "the supply", "source": "the drive's voltage"}


def cannot_see(
    evidence: Evidence, scores: Iterable[Score], shelf: Mapping[str, Effect], misplaced: Sequence[str] = ()
) -> tuple[str, ...]:
    """Every limitation of these runs, one sentence each; `misplaced` is metadata that cannot be right.

    Of imported records alone nothing is said about this bench's own experiments.
    """
    scores = tuple(scores)
    if evidence.imported:
        return tuple(
            dict.fromkeys(
                [*misplaced, *evidence.blind, *_unlogged(evidence, shelf), *_within(scores), *_entries(scores)]
            )
        )
    said = [
        *misplaced,
        *experiments.lacks(evidence.parts),
        *_hidden(evidence, scores),
        *_entries(scores),
        *_elsewhere(evidence, shelf),
    ]
    said += [
        *_unlogged(evidence, shelf),
        *_absorbed(evidence, shelf),
        *_faint(evidence, shelf),
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


def _entries(scores: Iterable[Score]) -> Iterator[str]:
    """Of effects that these runs show in part, what they do not show."""
    for one in scores:
        if one.unseen and one.visible > HIDDEN:
            effect = one.start.effect
            yield f"{one.start.key}: nothing here shows {', '.join(one.unseen)} by itself; {effect.separate_by}"


def _unlogged(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[str]:
    """Signals that no record holds, and what can therefore not be found to be the cause."""
    held = {name for part in evidence.parts for name in part.logged}
    here = [e for e in shelf.values() if any(part.acts(e) for part in evidence.parts) and not e.absorbed]
    for signal, words in LOGGED.items():
        names = sorted(one.name for one in here if signal in one.needs)
        if names and signal not in held:
            yield f"{words} is in no record, and so cannot be the cause: {', '.join(names)}"


def _hidden(evidence: Evidence, scores: Iterable[Score]) -> Iterator[str]:
    invisible = [score for score in scores if score.visible < HIDDEN]
    turned = any(part.excites("rate") for part in evidence.parts)
    still = [s.start.effect.name for s in invisible if s.start.on == "rate" and not turned]
    if still:
        yield f"the gyros were not turned, so these of theirs do not show: {', '.join(sorted(still))}"
    for score in invisible:
        if score.start.effect.name not in still or score.start.on != "rate":
            effect = score.start.effect
            on = f" ({score.start.on})" if score.start.on and len(effect.quantities) > 1 else ""
            yield f"{effect.name}{on}: what it does here is within what the model fits anyway; {effect.separate_by}"


def _elsewhere(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[str]:
    for place in experiments.absent(evidence.parts):
        names = sorted(e.name for e in shelf.values() if tuple(e.places) == (place,) and not e.absorbed)
        if names:
            yield f"nothing was measured on the {place}, where alone these show: {', '.join(names)}"


def _absorbed(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[str]:
    for effect in shelf.values():
        if effect.absorbed and any(part.acts(effect) for part in evidence.parts):
            yield f"{effect.name}: {effect.absorbed}"


def _faint(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[str]:
    """Noise: how strong it would have to be to be seen, or why none is looked for."""
    spectral = [effect for effect in shelf.values() if effect.spectral]
    for effect in spectral:
        for part in evidence.parts:
            yield from part.faintest(effect)
    names = sorted(e.name for e in spectral if not any(part.acts(e) for part in evidence.parts))
    if names:
        yield f"no record at rest of sensors whose noise a sheet states, where alone these show: {', '.join(names)}"


def _untested(shelf: Mapping[str, Effect]) -> Iterator[str]:
    names = sorted(e.name for e in shelf.values() if e.looks_in and e.looks_in not in TESTED and not e.absorbed)
    if names:
        yield f"not looked for, because noise is taken from these records and not from a model: {', '.join(names)}"
