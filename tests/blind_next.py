"""Worlds that were not named exactly, once more: the measurement that `rig next` ranks first, then all runs together.

The world, the standard run and its diagnosis are those of the first round. The measurement is carried out in the same
world afterwards, from the procedure that `rig next` would write; one that the bench refuses is passed over, as there.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import blind_scores
import blind_trials
import blind_worlds as worlds
import fast_bench
from blind_scores import Row, Trial, share
from blind_worlds import Answer

from rig.diagnose.diagnose import Diagnosis, diagnose
from rig.diagnose.next_measurement import Ranked, ranked
from rig.fit.evidence import evidence_of

FOLDER = "next"
SUBSET = 100  # worlds of a whole study
SAID = ("decides", "helps", "one class", "nothing open")  # of the first measurement, as `rig next` says it
BAR = "≥ 80 %"


def chosen(found: Sequence[Trial], study: int) -> list[Answer]:
    """Answers of the worlds with one effect that were not named exactly, in an order that no result has a part in.

    Of a whole study (30 worlds for each effect) a hundred, of a smaller one as many in proportion.
    """
    wrong = [one.answer for one in found if one.table == "one" and not one.exact]
    order = sorted(wrong, key=lambda answer: zlib.crc32(f"next {answer.id}".encode()))
    return order[: max(round(SUBSET * study / 30), 1)]


def again(answer: Answer, folder: Path) -> None:
    """Measure and diagnose a world anew, take the measurement ranked first, and write what is then said."""
    _, sealed = worlds.unsealed(folder / "answers" / f"{answer.id}.json")
    result: dict[str, Any] = {"id": answer.id, "table": "next", "bench": answer.bench, "sealed": sealed}
    try:
        result |= _again(answer)
    except blind_trials.FAILURES as error:
        why = f"{type(error).__name__}: {error}"
        result = {"said": "nothing open", **result, "verdict": "failed", "named": [], "steps": [], "why": why}
    worlds.write(folder / FOLDER / f"{answer.id}.json", result)


def _again(answer: Answer) -> dict[str, Any]:
    world = worlds.world_of(answer)
    records = worlds.measured(world, answer.bench)
    before = diagnose(evidence_of([records]))
    kept = {"before": {"verdict": before.verdict, "named": list(before.named)}}
    first = first_of(before)
    if first is None:
        return {**blind_trials.said(before), **kept, "said": "nothing open"}
    more = fast_bench.measure(first.option.document, world)
    after = diagnose(evidence_of([records, more]))
    measurement = {"name": first.option.name, "power": first.power, "between": list(first.pair)}
    return {**blind_trials.said(after), **kept, "said": promise(first), "measurement": measurement}


def first_of(diagnosis: Diagnosis) -> Ranked | None:
    """The first measurement that the bench accepts; None if nothing is open between two effects."""
    return next((one for one in ranked(diagnosis) if fast_bench.accepts(one.option.document)), None)


def promise(one: Ranked) -> str:
    """What `rig next` says that the measurement will do: decides, helps, or leaves them one class."""
    return "decides" if one.decides else "helps" if one.helps else "one class"


def trials(folder: Path) -> list[Trial]:
    """The second round. Raises ValueError if an answer is not the one that was sealed."""
    return blind_scores.trials(folder, FOLDER)


def rows(found: Sequence[Trial]) -> list[Row]:
    """How many became exact, by what `rig next` had promised; those it cannot help are counted on their own."""
    if not found:
        return []
    of = {said: [one for one in found if one.result["said"] == said] for said in SAID}
    able = of["decides"] + of["helps"]
    return [
        _row("not exact, after the measurement that `rig next` ranks first: exact", found, BAR),
        _row("… of those where it says that this decides or helps", able, ""),
        _row("… of those where it says that this decides", of["decides"], ""),
        _row("… of those where it says that they stay one class on this bench", of["one class"], ""),
        _count("… `rig next` says that no measurement helps: one class", of["one class"], found),
        _count("… `rig next` says that nothing is open between two effects", of["nothing open"], found),
    ]


def _row(what: str, chosen: Sequence[Trial], bar: str) -> Row:
    return Row(what, share(sum(one.exact for one in chosen), len(chosen)), bar, len(chosen))


def _count(what: str, chosen: Sequence[Trial], found: Sequence[Trial]) -> Row:
    return Row(what, f"{len(chosen)} of {len(found)}", "", len(found))


def listed(found: Sequence[Trial]) -> list[tuple[str, ...]]:
    """Head and a row for each world: what was hidden, said before, measured, and said then."""
    head = ("bench", "hidden", "d′", "said before", "measured", "power", "said then")
    return [head, *(_listed(one) for one in found)]


def _listed(one: Trial) -> tuple[str, ...]:
    measured = one.result.get("measurement", {"name": "nothing", "power": 0.0})
    before = one.result.get("before", {"verdict": "failed", "named": []})
    then = "**exact**" if one.exact else _words(one.result)
    hidden, d_prime = "+".join(one.answer.names), f"{one.answer.d_prime:.0f}"
    return one.answer.bench, hidden, d_prime, _words(before), measured["name"], f"{measured['power']:.3g}", then


def _words(said: Any) -> str:
    return f"{said['verdict']}: {' + '.join(said['named']) or 'nothing'}"
