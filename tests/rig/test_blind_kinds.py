"""A world of nearly every other kind that the blind test has: noise, imported records, faults, a stranger, a pair.

Their answers were drawn once. Together they take a few seconds; how often all that is right is for `make blind`.
"""

from __future__ import annotations

import json
from pathlib import Path

import blind_trials
import blind_worlds
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
    assert bool(found.result["faults"]) == (answer.names[0] not in ("gain_step", "drift"))


def test_the_frozen_worlds_are_those_that_would_be_drawn() -> None:
    assert [one.id for one in ANSWERS] == [case.id for case in blind_worlds.slice_of_kinds()]
