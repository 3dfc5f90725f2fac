"""Going on with an interrupted run: what is repeated before the rest, as far as the bench still stands as it did.

A point may be repeated only with the cables and the mounting that it was recorded with. What an operator was asked to
do when the run stopped may be done, half done or not done, so nothing from before an open request is repeated: the
request is made again. A platter may be turning or not, whatever it did then.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rig.bench.steps import Ask, Sine, Spin, Step


@dataclass(frozen=True)
class Again:
    """A step that is carried out before the run goes on; `kind` is that of its journal line, `index` the step's."""

    kind: str
    index: int
    step: Step


def again(steps: Sequence[Step], done: Collection[int]) -> Again | None:
    """What to carry out before the first step that is not done; None if it can be begun as it is."""
    first = next((index for index in range(len(steps)) if index not in done), None)
    if first is None:
        return None
    step = steps[first]
    if isinstance(step, Spin):
        return _platter(steps, first, step)
    for index in range(first, -1, -1):
        if isinstance(steps[index], Ask):
            return None
        if isinstance(steps[index], Sine) and index in done:
            return Again("repeated", index, steps[index])
    return None


def _platter(steps: Sequence[Step], first: int, step: Spin) -> Again:
    """A spin-up begins at rest, every other phase at a steady rate."""
    if step.phase == "spin_up":
        return Again("prepared", first, replace(step, label=f"rest before {step.label}", phase="coast_down"))
    up = max(n for n in range(first) if isinstance(one := steps[n], Spin) and one.phase == "spin_up")
    return Again("repeated", up, steps[up])


def cables_of(steps: Sequence[Step], done: Collection[int]) -> str:
    """The cable set that was connected last; that of the shaker if none was."""
    for index in sorted(done, reverse=True):
        step = steps[index]
        if isinstance(step, Ask) and step.request.action == "cables":
            return str(step.request.settings["set"])
    return "shaker"


def drive_constants(recorded: Mapping[int, Mapping[str, Any]]) -> dict[float, float]:
    """Drive constants by frequency (Hz) as the points done so far measured them, m/V."""
    return {body["frequency"]: body["drive_constant"] for body in recorded.values() if "drive_constant" in body}
