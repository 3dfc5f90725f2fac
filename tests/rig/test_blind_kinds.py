"""A world of nearly every other kind that the blind test has: noise, imported records, faults, a stranger, a pair.

Their answers were drawn once. Together they take a few seconds; how often all that is right is for `make blind`.
"""

from __future__ import annotations

import json
from pathlib import Path

import blind_imports
import blind_laws
import blind_scores
import blind_trials
import blind_worlds
import numpy as np
import pytest
from blind_scores import Trial
from blind_worlds import Answer

ANSWERS = [
    Answer(**one)
    for one in json.loads((Path(__file__).parent / "blind_kinds.json").read_text(encoding="utf-8"))["answers"]
]


def trial(answer: Answer) -> Trial:
    return Trial(answer, blind_trials.said_of(answer))


def of(*tables: str) -> pytest.MarkDecorator:
    """Every such world is a test of its own."""
    return pytest.mark.parametrize("answer", [pytest.param(one, id=one.id) for one in ANSWERS if one.table in tables])


@of("imported_clean")
def test_a_clean_record_whose_noise_is_known_is_adequate(answer: Answer) -> None:
    found = trial(answer)
    assert found.is_said("adequate")
    assert found.known


@of("imported_unknown")
def test_a_clean_record_whose_noise_is_not_known_is_undecided(answer: Answer) -> None:
    found = trial(answer)
    assert found.is_said("undecided")
    assert not found.known
    assert not found.result["named"]


@of("imported_one", "others")
def test_what_is_hidden_is_in_the_first_class(answer: Answer) -> None:
    found = trial(answer)
    assert found.in_first_class
    assert not found.wrong_and_sure
    if answer.bench == "response":  # a delay and a lag are a pair that such a table does not tell apart
        assert len(found.result["steps"][0]["members"]) > 1
    else:
        assert found.exact


@of("imported_strangers")
def test_a_stranger_is_unlisted(answer: Answer) -> None:
    found = trial(answer)
    assert found.is_said("unlisted")
    assert not found.wrong_and_sure


@of("faults")
def test_a_fault_is_never_adequate_and_never_surely_an_effect(answer: Answer) -> None:
    found = trial(answer)
    assert found.result["verdict"] in ("undecided", "unlisted")
    assert not found.wrong_and_sure
    assert found.result["faults"]


def test_the_frozen_worlds_are_those_that_would_be_drawn() -> None:
    assert [one.id for one in ANSWERS] == [case.id for case in blind_worlds.slice_of_kinds()]


def scored(table: str, verdict: str, *stated: tuple[str, float], d_prime: float = 60.0) -> Trial:
    hidden = [{"name": "cubic", "parameters": {}, "d_prime": d_prime}]
    steps = [{"name": name, "members": [name], "probability": p, "stated": [[name, p]]} for name, p in stated]
    said = {"verdict": verdict, "named": [name for name, _ in stated], "steps": steps, "origins": ["at rest"]}
    return Trial(Answer("x", table, "rotation", 1, hidden), said)


def test_records_of_others_are_scored_apart_by_kind_and_strength() -> None:
    found = [
        scored("imported_one", "missing", ("cubic", 1.0)), scored("imported_one", "missing", ("delay", 0.95)),
        scored("imported_one", "adequate", d_prime=12.0), scored("faults", "adequate"),
        scored("faults", "missing", ("warm_up", 0.95)), scored("faults", "unlisted", ("warm_up", 0.5)),
        scored("imported_strangers", "unlisted"), scored("imported_strangers", "missing", ("cubic", 0.5)),
    ]  # fmt: skip
    said = {row.what: row.found.partition(" =")[0] for row in blind_scores.rows(found)}
    assert said["imported, one effect, d′ ≥ 20: in a first class of ≤ 3"] == "1/2"
    assert said["… rotation, d′ 10 to 20"] == "0/1"
    assert said["imported, faults, d′ ≥ 30: adequate"] == "1/3"
    assert said["… a physical effect named with p ≥ 0.9"] == "1/3"
    assert said["imported, strangers, d′ ≥ 20, noise known: unlisted"] == "1/2"
    assert said["a wrong name with probability ≥ 0.9, imported"] == "2/8"


@pytest.mark.parametrize("wanted", [15.0, 150.0])
def test_what_is_hidden_in_a_record_is_as_strong_as_wanted(wanted: float) -> None:
    """And twice the size is twice as strong, where the law is straight."""
    for kind, name in (("poses", "cross_axis"), ("response", "delay"), ("sweep", "quadratic")):
        law = blind_laws.law_of(name)
        record = blind_imports.Record(kind, 5, law, law.drawn(np.random.default_rng(1), ("acceleration",)))
        made, reached = blind_imports.of_strength(record, wanted)
        assert reached == pytest.approx(wanted, rel=0.03)
        twice = made.with_size(2.0 * float((made.at or {})["size"]))
        assert blind_imports.detected(twice, twice.made(), twice.without().made()) == pytest.approx(
            2.0 * reached, rel=0.1
        )
