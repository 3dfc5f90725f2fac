"""Turntable run: rest, spin up, whole revolutions at one speed, coast down, rest; the encoder is the reference.

The platter turns clockwise seen from above; turning the cube over gives the other sense. Nominal speeds (33⅓ and
45 rpm) are gates for the operator's choice, never references.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from rig import units
from rig.bench.steps import Ask, BenchFacts, Mistake, Plan, Spin, Static, Step, cables_request
from rig.errors import BadInput
from rig.room import Request
from rig.units import Angle, Length, Rate, Time

LINES = 1000  # encoder lines per revolution
SPELLED = {"33 1/3 rpm": 100.0 / 3.0, "45 rpm": 45.0}
SPEEDS = tuple(SPELLED.values())  # rpm
WANTED = " or ".join(SPELLED)
FINEST = 6  # digits of a speed that is written out
RPM = 2.0 * math.pi / 60.0
RAD_TO_DEG = 180.0 / math.pi
PERTURBATIONS = (-0.06, -0.03, 0.03)  # of the rate; a light touch, as the paper used


class Settings(BaseModel):
    """A turntable run of one gyro axis."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    procedure: Literal["turntable"] = "turntable"
    title: str = ""
    speed: Rate = Field(default=45.0 * RPM, description=WANTED)
    axis: Literal["pitch", "roll", "yaw"] = Field(default="yaw", description="gyro axis on the platter's axis")
    inverted: bool = Field(default=False, description="the cube upside down: the other sense")
    all: bool = Field(default=False, description="also the other speed, and both again in the other sense")
    perturb: bool = Field(default=False, description="also stretches at rates changed by a light touch")
    revolutions: int = Field(default=40, ge=2, le=10_000, description="whole revolutions held")
    rest: Time = Field(default=30.0, description="record at rest before and after")
    radius: Length = Field(default=0.05, ge=0, le=0.14, description="of the cube's centre from the platter's axis")
    angle: Angle = Field(default=0.0, description="of the cube about the platter's axis")

    @field_validator("speed")
    @classmethod
    def _as_selected(cls, speed: float) -> float:
        """A speed of the selector by any of its spellings, rad/s; another one stays as it is and is a mistake."""
        return selected(speed / RPM, speed / RPM) * RPM


def selected(rpm: float, otherwise: float = math.nan) -> float:
    """The speed of the selector that a number spells, whole or cut after any digit (33, 33.3, 33.33 is 100/3), rpm."""
    spelled = ((speed, round(speed, digits)) for speed in SPEEDS for digits in range(FINEST + 1))
    return next((speed for speed, spelling in spelled if abs(rpm - spelling) < 10.0**-FINEST), otherwise)


def speed_of(text: str) -> str:
    """The selector's speed that a text means, with or without unit. Raises BadInput with the speeds there are."""
    for spelling in (f"{text} rpm", text):
        try:
            rpm = selected(units.parse(spelling, "rate") / RPM)
        except units.UnitError:
            continue
        if math.isfinite(rpm):
            return next(name for name, speed in SPELLED.items() if speed == rpm)
    raise BadInput(f"found '{text}', wanted a speed of the turntable: {WANTED}")


def expand(settings: Settings, facts: BenchFacts) -> Plan:
    """Steps of the run; `all` gives both speeds in both senses."""
    mistakes = tuple(_mistakes(settings, facts))
    return Plan(
        procedure=settings.procedure,
        title=settings.title or f"Turntable, {settings.axis}, {settings.speed / RPM:.4g} rpm",
        settings=settings.model_dump(mode="json"),
        steps=() if mistakes else tuple(_steps(settings)),
        mistakes=mistakes,
    )


def _steps(settings: Settings) -> Iterator[Step]:
    yield Ask("cables", request=cables_request("turntable"), duration=20)
    senses = (settings.inverted, not settings.inverted) if settings.all else (settings.inverted,)
    first = settings.speed / RPM
    speeds = (first, *(rpm for rpm in SPEEDS if abs(rpm - first) > 1)) if settings.all else (first,)
    for inverted in senses:
        yield _mount(settings, inverted)
        yield _rest(settings, "before")
        for rpm in speeds:
            yield from _turn(settings, rpm, inverted)
        yield _rest(settings, "after")


def _turn(settings: Settings, rpm: float, inverted: bool) -> Iterator[Spin]:
    where = f"{rpm:.4g} rpm{' inverted' if inverted else ''}"
    turn = 60.0 / rpm
    phase = partial(Spin, point=True, rpm=rpm, gyro_axis=settings.axis, inverted=inverted)
    held = settings.revolutions
    yield phase(f"spin-up {where}", duration=8 + 7 * turn, phase="spin_up")
    yield phase(f"hold {where}", duration=held * turn, phase="hold", revolutions=held)
    for fraction in PERTURBATIONS if settings.perturb else ():
        label = f"touch {fraction:+.0%} {where}"
        yield phase(label, duration=10 * turn, phase="perturbed", revolutions=8, fraction=fraction)
    yield phase(f"coast-down {where}", duration=12, phase="coast_down")


def _mount(settings: Settings, inverted: bool) -> Ask:
    card = (
        f"Place the cube on the platter: {settings.axis} gyro on the platter's axis, "
        f"{'upside down' if inverted else 'upright'}, centre {settings.radius * 1000:.0f} mm from the axis, "
        f"turned {settings.angle * RAD_TO_DEG:.0f}°. Route the cable freely."
    )
    values = {"axis": settings.axis, "inverted": inverted, "radius": settings.radius, "angle": settings.angle}
    return Ask("mount", request=Request("mount_on_turntable", card, values), duration=60)


def _rest(settings: Settings, when: str) -> Static:
    return Static(
        f"rest {when}",
        duration=settings.rest,
        point=True,
        seconds=settings.rest,
        cables="turntable",
        purpose=f"rest_{when}",
    )


def _mistakes(settings: Settings, facts: BenchFacts) -> Iterator[Mistake]:
    rpm = settings.speed / RPM
    if not math.isfinite(selected(rpm)):
        yield Mistake(("speed",), f"found {rpm:.4g} rpm, wanted {WANTED}")
    lines = rpm / 60.0 * LINES
    if lines * 2 > facts.scan_rate:
        yield Mistake(
            ("speed",), f"found {lines:.0f} encoder lines per second, wanted at most half of {facts.scan_rate:g} Hz"
        )
    if not 1.0 <= settings.rest <= 36_000:
        yield Mistake(("rest",), f"found {settings.rest:g} s, wanted 1 s to 10 h")
    for missing in sorted({"recorder", "turntable"} - facts.has):
        yield Mistake(("procedure",), f"found no {missing} on this bench, wanted one for a turntable run")
