"""The blind worlds of the suite, diagnosed, and that in the form in which it is kept beside other numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import blind_trials
from blind_scores import Trial
from blind_worlds import Answer

SCENARIO = "blind_slice"
ANSWERS = Path(__file__).parent / "rig" / "blind_slice.json"


def answers() -> list[Answer]:
    """What is hidden in each world."""
    return [Answer(**one) for one in json.loads(ANSWERS.read_text(encoding="utf-8"))["answers"]]


def diagnosed(answer: Answer) -> Trial:
    """A world measured and diagnosed from its records alone."""
    return Trial(answer, blind_trials.said_of(answer))


def kept_of(trials: Sequence[Trial]) -> dict[str, Any]:
    """Verdict, effects, their classes and what they explain, by world."""
    return {"diagnoses": {one.answer.id: _kept(one.result) for one in trials}}


def _kept(said: Mapping[str, Any]) -> dict[str, Any]:
    steps = [
        {"name": one["name"], "members": sorted(one["members"]), "gain": float(one["gain"]),
         "probability": float(one["probability"])}
        for one in said["steps"]
    ]  # fmt: skip
    numbers = {"chi2": float(said["chi2"]), "count": int(said["count"])}
    return {"verdict": said["verdict"], "named": list(said["named"]), "steps": steps, **numbers}
