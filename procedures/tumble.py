"""Tumble: the cube at rest in known poses, gravity as the reference.

Six poses are the faces. Twelve and twenty-four tilt every face by 30° on one wedge, towards two or four sides, so that
the pairs of axes share gravity and the cross terms of the triad show.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from rig.bench.steps import Ask, BenchFacts, Mistake, Plan, Static, Step, cables_request
from rig.room import Request
from rig.units import Time

WEDGE = math.radians(30.0)
Vector = tuple[float, float, float]


class Settings(BaseModel):
    """Static poses against gravity."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    procedure: Literal["tumble"] = "tumble"
    title: str = ""
    poses: Literal[6, 12, 24] = 6
    record: Time = Field(default=5.0, description="at each pose")
    settle: Time = Field(default=1.0, description="after the cube was put down")


def expand(settings: Settings, facts: BenchFacts) -> Plan:
    """One static record for each pose."""
    return Plan(
        procedure=settings.procedure,
        title=settings.title or f"Tumble, {settings.poses} poses",
        settings=settings.model_dump(mode="json"),
        steps=(Ask("cables", request=cables_request("shaker"), duration=20), *_records(settings)),
        mistakes=tuple(_mistakes(settings, facts)),
    )


def poses(number: int) -> list[Vector]:
    """Direction of "up" in the cube frame for each pose, unit vectors."""
    faces = [_unit(axis, sign) for axis in range(3) for sign in (1, -1)]
    if number == 6:
        return faces
    sides = (1,) if number == 12 else (1, -1)
    return [_tilted(face, towards, side) for face in faces for towards in (1, 2) for side in sides]


def _unit(axis: int, sign: int) -> Vector:
    x, y, z = (float(sign) if i == axis else 0.0 for i in range(3))
    return (x, y, z)


def _tilted(face: Vector, towards: int, side: int) -> Vector:
    axis = next(i for i in range(3) if face[i])
    other = (axis + towards) % 3
    x, y, z = (
        face[i] * math.cos(WEDGE) if i == axis else side * math.sin(WEDGE) if i == other else 0.0 for i in range(3)
    )
    return (x, y, z)


def _records(settings: Settings) -> Iterator[Step]:
    for number, up in enumerate(poses(settings.poses), start=1):
        name = " ".join(f"{value:+.2f}{axis}" for axis, value in zip("xyz", up, strict=True) if value)
        values = {"up_x": up[0], "up_y": up[1], "up_z": up[2]}
        yield Ask(f"pose {number}", request=Request("pose", f"Put the cube down with {name} up.", values), duration=30)
        yield Static(
            f"pose {number} ({name})",
            duration=settings.record + settings.settle,
            point=True,
            seconds=settings.record,
            purpose="pose",
            settle=settings.settle,
        )


def _mistakes(settings: Settings, facts: BenchFacts) -> Iterator[Mistake]:
    if not 1.0 <= settings.record <= 3600:
        yield Mistake(("record",), f"found {settings.record:g} s, wanted 1 s to 1 h")
    if not facts.has & {"recorder", "cube"}:
        yield Mistake(("procedure",), "found no recorder on this bench, wanted one for a tumble")
