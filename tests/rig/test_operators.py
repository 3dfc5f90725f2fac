"""Operators: a person at a real pseudo-terminal, and answers from a file."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from rig.bench.operators import Answer, AnswersOperator, TerminalOperator
from rig.errors import ConfigError, OperatorMissing, OperatorRefused
from rig.room import Request

CABLES = Request("cables", "Connect the shaker cable set to the converter.", {"set": "shaker"})
SPEED = Request("turntable_speed", "Start the platter at 33.33 rpm.", {"rpm": 100 / 3})


class StoppedClock:
    """A clock that a test holds."""

    def now(self) -> float:
        return 1234.5

    def sleep(self, seconds: float) -> None:
        raise AssertionError("an operator does not sleep")


class Person:
    """A technician's end of a pseudo-terminal: types ahead, and reads the cards."""

    def __init__(self) -> None:
        self._keyboard, slave = os.openpty()
        self.cards = io.StringIO()
        self._stdin = os.fdopen(slave, "r", encoding="utf-8")
        self.operator = TerminalOperator(StoppedClock(), self._stdin, self.cards)

    def types(self, *lines: str) -> None:
        os.write(self._keyboard, "".join(line + "\n" for line in lines).encode())

    def hangs_up(self) -> None:
        os.write(self._keyboard, b"\x04")

    def close(self) -> None:
        self._stdin.close()
        os.close(self._keyboard)


@pytest.fixture
def person() -> Iterator[Person]:
    someone = Person()
    yield someone
    someone.close()


def test_enter_confirms_and_the_name_is_asked_once(person: Person) -> None:
    person.types("A. Nowak", "", "dial at 4.9 kHz")
    first, second = person.operator.ask(CABLES), person.operator.ask(SPEED)
    assert (first.who, first.said, first.when) == ("A. Nowak", "", 1234.5)
    assert (second.who, second.said) == ("A. Nowak", "dial at 4.9 kHz")
    assert person.cards.getvalue().count("name") == 1
    assert CABLES.text in person.cards.getvalue()


@pytest.mark.parametrize("no", ["n", "N", "no"])
def test_n_refuses_and_the_error_says_who_and_what(person: Person, no: str) -> None:
    person.types("A. Nowak", no)
    with pytest.raises(OperatorRefused, match=r"A\. Nowak, asked to cables"):
        person.operator.ask(CABLES)


def test_a_closed_terminal_is_a_refusal(person: Person) -> None:
    person.hangs_up()
    with pytest.raises(OperatorRefused, match="closed"):
        person.operator.ask(CABLES)


def test_without_a_terminal_nobody_is_asked() -> None:
    operator = TerminalOperator(StoppedClock(), io.StringIO("\n"), io.StringIO())
    with pytest.raises(OperatorMissing, match="terminal"):
        operator.check([CABLES])
    with pytest.raises(OperatorMissing, match="terminal"):
        operator.ask(CABLES)


def test_without_anything_to_ask_no_terminal_is_needed() -> None:
    TerminalOperator(StoppedClock(), io.StringIO(), io.StringIO()).check([])


def answers(tmp_path: Path, text: str) -> AnswersOperator:
    path = tmp_path / "answers.yaml"
    path.write_text(text, encoding="utf-8")
    return AnswersOperator.load(path, StoppedClock())


def test_an_answer_from_the_file_says_who_and_what(tmp_path: Path) -> None:
    operator = answers(tmp_path, "- {action: cables, who: A. Nowak, said: as on Monday}\n")
    operator.check([CABLES])
    confirmation = operator.ask(CABLES)
    assert (confirmation.who, confirmation.said, confirmation.request) == ("A. Nowak", "as on Monday", CABLES)


def test_settings_choose_between_answers_and_a_person_may_round(tmp_path: Path) -> None:
    operator = answers(
        tmp_path,
        "- {action: turntable_speed, who: A, settings: {rpm: 45}}\n"
        "- {action: turntable_speed, who: B, settings: {rpm: 33.33}}\n",
    )
    assert operator.ask(SPEED).who == "B"


def test_every_missing_answer_is_named_before_anything_moves(tmp_path: Path) -> None:
    operator = answers(tmp_path, "- {action: cables, who: A, settings: {set: turntable}}\n")
    with pytest.raises(OperatorMissing, match=r"cables set=shaker; turntable_speed rpm=33\.3"):
        operator.check([CABLES, SPEED])
    with pytest.raises(OperatorMissing, match="cables"):
        operator.ask(CABLES)


def test_a_mistake_in_the_file_is_named_by_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"answers\.yaml:2:"):
        answers(tmp_path, "- {action: cables, who: A}\n- {action: cables, whom: A}\n")


def test_a_truth_value_never_agrees_with_a_number() -> None:
    request = Request("filter_test", "", {"on": True})
    assert Answer(action="filter_test", who="A", settings={"on": True}).fits(request)
    assert not Answer(action="filter_test", who="A", settings={"on": 1}).fits(request)
