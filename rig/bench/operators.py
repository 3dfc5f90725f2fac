"""Operators for a bench of real instruments: a person at the terminal, or a file of answers given beforehand."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TextIO

from pydantic import BaseModel, ConfigDict, Field, RootModel

from rig.errors import OperatorMissing, OperatorRefused
from rig.room import Clock, Confirmation, Request, Value
from rig.yaml import config

_NO = frozenset({"n", "no"})


class TerminalOperator:
    """A person: reads the card, does what it says and presses Enter; `n` refuses; other text goes on record.

    Who it is, is asked once.
    """

    def __init__(self, clock: Clock, answers: TextIO | None = None, cards: TextIO | None = None) -> None:
        self._clock = clock
        self._answers = sys.stdin if answers is None else answers
        self._cards = sys.stderr if cards is None else cards
        self._who = ""

    def check(self, requests: Iterable[Request]) -> None:
        """Raises OperatorMissing if anything will be asked and there is no terminal to ask at."""
        if any(True for _ in requests):
            self._attended()

    def ask(self, request: Request) -> Confirmation:
        """Show the card and wait.

        Raises OperatorMissing without a terminal, OperatorRefused on `n` and at the end of input.
        """
        self._attended()
        if not self._who:
            self._who = self._reply("Your name, for the record: ")
        said = self._reply(f"\n  {request.text}\n  Enter when done, n to refuse, or a remark: ")
        if said.lower() in _NO:
            raise OperatorRefused(f"{self._who or 'operator'}, asked to {request.action}: refused ({request.text})")
        return Confirmation(request, self._who or "unnamed", self._clock.now(), said)

    def _attended(self) -> None:
        if self._answers.closed or not self._answers.isatty():
            raise OperatorMissing(
                "operator: found no terminal on standard input, wanted a person there, "
                "or `operator:` naming a file of answers"
            )

    def _reply(self, prompt: str) -> str:
        self._cards.write(prompt)
        self._cards.flush()
        line = self._answers.readline()
        if not line:
            raise OperatorRefused("operator: the terminal was closed before an answer was given")
        return line.strip()


class Answer(BaseModel):
    """One confirmation given beforehand: `who` has done `action`; `settings` (SI) narrow it to requests that agree."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    action: str
    who: str = Field(min_length=1)
    said: str = ""
    settings: dict[str, str | float | int | bool] = Field(default_factory=dict)

    def fits(self, request: Request) -> bool:
        """Whether this answers the request: same action, and every setting written here agrees."""
        return self.action == request.action and all(
            key in request.settings and _agree(value, request.settings[key]) for key, value in self.settings.items()
        )


class Answers(RootModel[list[Answer]]):
    """The file: a list of answers."""


class AnswersOperator:
    """Answers from a file, for a bench whose cables and dials are already as a procedure needs them.

    The first answer that fits is taken, however often it is asked for.
    """

    def __init__(self, answers: Sequence[Answer], clock: Clock, source: str = "the answers file") -> None:
        self._given, self._clock, self._source = tuple(answers), clock, source

    @classmethod
    def load(cls, path: Path, clock: Clock) -> AnswersOperator:
        """Raises ConfigError with every mistake in the file."""
        return cls(config.load(path, Answers).root, clock, str(path))

    def check(self, requests: Iterable[Request]) -> None:
        """Raises OperatorMissing naming every request that has no answer."""
        missing = [_shown(request) for request in requests if self._found(request) is None]
        if missing:
            raise OperatorMissing(f"{self._source}: found no answer to {'; '.join(dict.fromkeys(missing))}")

    def ask(self, request: Request) -> Confirmation:
        """The answer given beforehand; raises OperatorMissing if there is none."""
        answer = self._found(request)
        if answer is None:
            raise OperatorMissing(f"{self._source}: found no answer to {_shown(request)}")
        return Confirmation(request, answer.who, self._clock.now(), answer.said)

    def _found(self, request: Request) -> Answer | None:
        return next((answer for answer in self._given if answer.fits(request)), None)


def _agree(given: Value, asked: Value) -> bool:
    numeric = (int, float)
    if isinstance(given, numeric) and isinstance(asked, numeric) and bool not in (type(given), type(asked)):
        return math.isclose(given, asked, rel_tol=1e-3)  # a person writes 33.3, a procedure 100/3
    return type(given) is type(asked) and given == asked


def _shown(request: Request) -> str:
    return f"{request.action} {_listed(request.settings)}".rstrip()


def _listed(settings: Mapping[str, Value]) -> str:
    return ", ".join(f"{key}={value}" for key, value in settings.items())
