"""Noise: one long record at rest, for densities and Allan deviations."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from rig.bench.steps import Ask, BenchFacts, Mistake, Plan, Static, cables_request
from rig.units import Time


class Settings(BaseModel):
    """A record at rest."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    procedure: Literal["noise"] = "noise"
    title: str = ""
    length: Time = Field(default=300.0, description="of the record")
    settle: Time = Field(default=2.0, description="after the cables were touched")
    cables: Literal["shaker", "turntable"] = "shaker"


def expand(settings: Settings, facts: BenchFacts) -> Plan:
    """Connect the cable set, let it settle, record."""
    return Plan(
        procedure=settings.procedure,
        title=settings.title or f"Noise at rest, {settings.cables} cables",
        settings=settings.model_dump(mode="json"),
        steps=(
            Ask("cables", request=cables_request(settings.cables), duration=20),
            Static(
                "noise",
                duration=settings.length + settings.settle,
                point=True,
                seconds=settings.length,
                cables=settings.cables,
                purpose="noise",
                settle=settings.settle,
            ),
        ),
        mistakes=tuple(_mistakes(settings, facts)),
    )


def _mistakes(settings: Settings, facts: BenchFacts) -> Iterator[Mistake]:
    if not 1.0 <= settings.length <= 172_800:
        yield Mistake(("length",), f"found {settings.length:g} s, wanted 1 s to 48 h")
    if not facts.has & {"recorder", "cube"}:
        yield Mistake(("procedure",), "found no recorder on this bench, wanted one for a noise record")
