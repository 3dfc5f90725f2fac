"""Frequency sweep: the shaker drives one axis with sines, level by level, and the vibrometer is the reference.

The drive is V = A sin ωt, the platform moves x = kA sin ωt and a = −ω²x (the paper's equations 2 to 4), so the drive
that a level needs, and the stroke and velocity that it brings, are known before anything moves.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from rig.bench.steps import (
    AlignBeam,
    Ask,
    Axis,
    BenchFacts,
    Hold,
    Mistake,
    Plan,
    SetFilter,
    Sine,
    Static,
    Step,
    cables_request,
)
from rig.room import Request
from rig.units import Acceleration, Frequency, Length, Sensitivity, Time, format_quantity

UP = {"x": "y", "y": "z", "z": "x"}
SHARES = {"full": 1.0, "half": 0.5, "quarter": 0.25, "eighth": 0.125}
MAINS_CLEARANCE = 1.0  # Hz; a sine this close to a mains line cannot be told from hum in a one-second record


class LimitSettings(BaseModel):
    """Tighter limits than the bench's own; they can never be wider."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    acceleration: Acceleration | None = None
    stroke: Length | None = None


class Expected(BaseModel):
    """What the result must lie within; outside it the run ends with exit code 3."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    within: tuple[Sensitivity, Sensitivity]


class Expectations(BaseModel):
    """Results that can be expected of a sweep."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    sensitivity: Expected | None = None


class Settings(BaseModel):
    """A frequency sweep of one axis."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    procedure: Literal["frequency_sweep"] = "frequency_sweep"
    title: str = ""
    axis: Axis = Field(default="x", description="cube axis that the shaker drives")
    start: Frequency = Field(default=20.0, description="lowest frequency")
    stop: Frequency = Field(default=500.0, description="highest frequency")
    points: int = Field(default=24, ge=1, le=2000, description="frequencies, spaced evenly in their logarithm")
    levels: tuple[Literal["full", "half", "quarter", "eighth"], ...] = Field(default=("full", "quarter"), min_length=1)
    level: Hold = Field(default="acceleration", description="what a level holds over frequency")
    order: Literal["random", "ascending"] = "random"
    seed: int = Field(default=1, ge=0, description="of the random order")
    settle: Time = Field(default=0.3, description="after every change of the drive")
    record: Time = Field(default=1.0, description="at least this long, whole cycles")
    static: Time = Field(default=30.0, description="record at rest before, which says how noisy it is; 0 s: none")
    static_after: Time = Field(default=5.0, description="record at rest after, at most as long as the one before")
    limits: LimitSettings = LimitSettings()
    expect: Expectations = Expectations()


def expand(settings: Settings, facts: BenchFacts) -> Plan:
    """Steps of the sweep: set up, rest, every frequency at every level, rest."""
    mistakes = [*_setting_mistakes(settings, facts), *_wider_than_bench(settings, facts)]
    sines: list[Sine] = []
    if not mistakes:
        sines = list(_sines(settings, facts))
        mistakes += _limit_mistakes(settings, facts, sines)
    expect, plug = settings.expect.sensitivity, facts.plugs.get(settings.axis)
    return Plan(
        procedure=settings.procedure,
        title=settings.title or f"Frequency sweep, {settings.axis}",
        settings=settings.model_dump(mode="json"),
        steps=(
            *_set_up(settings, facts),
            *_rest(settings, "before", settings.static),
            *_ordered(settings, sines),
            *_rest(settings, "after", min(settings.static, settings.static_after)),
        ),
        mistakes=tuple(mistakes),
        expect={} if expect is None or plug is None else {f"{plug.channel}.sensitivity": expect.within},
    )


def frequencies(settings: Settings, facts: BenchFacts) -> list[float]:
    """Log-spaced frequencies, Hz, each a whole number of cycles in the record and clear of the mains lines."""
    seconds = record_scans(settings, facts) / facts.scan_rate
    ratio = settings.stop / settings.start
    wanted = [settings.start * ratio ** (i / max(settings.points - 1, 1)) for i in range(settings.points)]
    found: list[float] = []
    for frequency in wanted:
        best = _nearest_clear(frequency, seconds, settings, facts.mains, found)
        if best is not None:
            found.append(best)
    return found


def record_scans(settings: Settings, facts: BenchFacts) -> int:
    """Scans in one record: at least the time asked for."""
    return math.ceil(settings.record * facts.scan_rate - 1e-9)


def _nearest_clear(
    frequency: float, seconds: float, settings: Settings, mains: float, taken: list[float]
) -> float | None:
    cycles = round(frequency * seconds)
    reach = max(4, math.ceil(3 * MAINS_CLEARANCE * seconds))
    candidates = [c / seconds for c in range(max(1, cycles - reach), cycles + reach + 1)]
    usable = [
        f
        for f in candidates
        if settings.start - 1e-9 <= f <= settings.stop + 1e-9
        and abs(f - mains * round(f / mains)) > MAINS_CLEARANCE
        and all(abs(f - other) > 1e-9 for other in taken)
    ]
    return min(usable, key=lambda f: abs(math.log(f / frequency)), default=None)


def _sines(settings: Settings, facts: BenchFacts) -> Iterator[Sine]:
    scans = record_scans(settings, facts)
    grid = frequencies(settings, facts)
    full = {f: min(facts.full_stroke * _omega(f) ** 2, facts.full_acceleration) for f in grid}
    for level in settings.levels:
        for f in grid:
            target, acceleration = _target(settings.level, f, SHARES[level], full, facts)
            yield Sine(
                label=f"{f:g} Hz {level}",
                duration=settings.settle + max(scans / facts.scan_rate, 1.2) + 0.6,
                point=True,
                axis=settings.axis,
                frequency=f,
                level=level,
                hold=settings.level,
                target=target,
                acceleration=acceleration,
                settle=settings.settle,
                scans=scans,
            )


def _target(hold: Hold, f: float, share: float, full: dict[float, float], facts: BenchFacts) -> tuple[float, float]:
    """The held quantity and the acceleration that goes with it; full is what every frequency of the sweep may have."""
    if hold == "acceleration":
        return share * full[f], share * full[f]
    if hold == "velocity":
        velocity = share * min(a / _omega(g) for g, a in full.items())
        return velocity, velocity * _omega(f)
    drive = share * min(a / _omega(g) ** 2 for g, a in full.items()) / facts.drive_constant
    return drive, drive * facts.drive_constant * _omega(f) ** 2


def _omega(frequency: float) -> float:
    return 2.0 * math.pi * frequency


def _ordered(settings: Settings, sines: list[Sine]) -> list[Sine]:
    """Random order: with an ascending sweep, a drift of temperature or supply looks like a frequency response."""
    shuffled = list(sines)
    if settings.order == "random":
        random.Random(settings.seed).shuffle(shuffled)  # noqa: S311 - an order of measurement, no secret
    return shuffled


def _set_up(settings: Settings, facts: BenchFacts) -> Iterator[Step]:
    axis = settings.axis
    yield Ask("cables", request=cables_request("shaker"), duration=20)
    if "filter" in facts.has:
        yield SetFilter("filter", cutoff=facts.filter_cutoff, verify="analyzer" in facts.has, duration=30)
    card = f"Mount the cube on the shaker with {axis} along the drive and {UP[axis]} up."
    yield Ask("mount", request=Request("mount_on_shaker", card, {"axis": axis}), duration=60)
    plug = facts.plugs.get(axis)
    if "analyzer" in facts.has and plug is not None:
        card = f"Connect analyzer input 2 to {plug.title}."
        yield Ask("plug", request=Request("plug_analyzer", card, {"input": 2, "slot": plug.slot}), duration=10)
    yield AlignBeam("beam", duration=20)


def _rest(settings: Settings, when: str, seconds: float) -> Iterator[Static]:
    if seconds > 0:
        yield Static(
            f"static {when}",
            duration=seconds + settings.settle,
            seconds=seconds,
            purpose=f"static_{when}",
            settle=settings.settle,
        )


def _setting_mistakes(settings: Settings, facts: BenchFacts) -> Iterator[Mistake]:
    if settings.start < 1.0:
        yield Mistake(("start",), f"found {settings.start:g} Hz, wanted at least 1 Hz")
    if settings.stop <= settings.start and settings.points > 1:
        yield Mistake(("stop",), f"found {settings.stop:g} Hz, wanted more than start ({settings.start:g} Hz)")
    highest = facts.scan_rate / 2.56
    if settings.stop > highest:
        yield Mistake(
            ("stop",),
            f"found {settings.stop:g} Hz, wanted at most {highest:.0f} Hz (converter at {facts.scan_rate:g} Hz)",
        )
    if len(set(settings.levels)) != len(settings.levels):
        yield Mistake(("levels",), "found a level twice, wanted each once")
    if not 0 < settings.record <= 600:
        yield Mistake(("record",), f"found {settings.record:g} s, wanted more than 0 s and at most 600 s")
    if settings.settle < 0.3:
        yield Mistake(("settle",), f"found {settings.settle:g} s, wanted at least 0.3 s")
    for missing in sorted({"analyzer", "vibrometer"} - facts.has):
        yield Mistake(("procedure",), f"found no {missing} on this bench, wanted one for a sweep")
    if settings.expect.sensitivity and settings.expect.sensitivity.within[0] >= settings.expect.sensitivity.within[1]:
        yield Mistake(("expect", "sensitivity", "within"), "found limits in the wrong order, wanted [lower, upper]")
    if settings.expect.sensitivity and settings.axis not in facts.plugs:
        axes = ", ".join(facts.plugs) or "none"
        yield Mistake(("expect", "sensitivity"), f"found no accelerometer along {settings.axis}, wanted one of {axes}")


def _wider_than_bench(settings: Settings, facts: BenchFacts) -> Iterator[Mistake]:
    own, bench = settings.limits, facts.limits
    for name, kind, asked, most in (
        ("acceleration", "acceleration", own.acceleration, bench.acceleration),
        ("stroke", "length", own.stroke, bench.stroke),
    ):
        if asked is not None and asked > most * (1 + 1e-9):
            text = f"found {format_quantity(asked, kind)}, wanted at most the bench's {format_quantity(most, kind)}"
            yield Mistake(("limits", name), text)


def _limit_mistakes(settings: Settings, facts: BenchFacts, sines: list[Sine]) -> Iterator[Mistake]:
    different = len({sine.frequency for sine in sines})
    if different < settings.points:
        text = f"found {settings.points}, wanted at most {different} (whole cycles, clear of mains)"
        yield Mistake(("points",), text)
    own, bench = settings.limits, facts.limits
    yield from _over(
        sines, "acceleration", "acceleration", _tighter(own.acceleration, bench.acceleration), _acceleration
    )
    yield from _over(sines, "stroke", "length", _tighter(own.stroke, bench.stroke), _stroke)
    yield from _over(sines, "velocity", "velocity", bench.velocity, _velocity)
    yield from _over(sines, "source", "peak_voltage", bench.source, lambda sine: _stroke(sine) / facts.drive_constant)


def _over(sines: list[Sine], name: str, kind: str, limit: float, value: Callable[[Sine], float]) -> Iterator[Mistake]:
    worst = max(sines, key=value, default=None)
    if worst is not None and value(worst) > limit * (1 + 1e-9):
        found, most = format_quantity(value(worst), kind), format_quantity(limit, kind)
        yield Mistake(("levels",), f"found {name} {found} at {worst.label}, wanted at most {most}")


def _tighter(own: float | None, bench: float) -> float:
    return bench if own is None else min(own, bench)


def _acceleration(sine: Sine) -> float:
    return sine.acceleration


def _velocity(sine: Sine) -> float:
    return sine.acceleration / _omega(sine.frequency)


def _stroke(sine: Sine) -> float:
    return sine.acceleration / _omega(sine.frequency) ** 2
