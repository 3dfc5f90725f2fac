"""Turntable (Technics SL-BD10) without remote control: the operator sets the speed, the encoder says when it is steady.

Nominal speeds are "not guaranteed or regulated" (the calibration paper), so they are a gate and never a reference:
the gate opens when whole revolutions, as the encoder saw them, stay within limits; what the rate then is, the encoder
says. 33⅓ rpm is exactly 100/3.

Everything that judges is plain data in, verdict out. Times are seconds on one time line (the record's or the bench
clock's), rates are rad/s, negative for clockwise seen from above (about z up).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from rig.errors import SettingRefused, VerdictNotMet
from rig.record import Identity
from rig.room import Confirmation, Request, Room
from rig.units import Rate, Ratio, Time

LINES = 1000
"""Encoder lines per revolution."""

SPEEDS = (100.0 / 3.0, 45.0)
"""What the speed selector has, rpm."""

RPM = 2.0 * math.pi / 60.0
SECTORS = 8
"""Parts of a revolution whose rates show wow up to about 6 Hz at 45 rpm; each still averages 125 lines."""

STANDING = 1.0
"""s without a line edge before a platter is called standing, whatever its limit of rest."""

MISSED_AT_MOST = 3
"""Revolutions without an index that are still told from a wrong count."""


def speed_card(rpm: float) -> Request:
    """What the operator is asked."""
    text = f"Start the platter at {rpm:.4g} rpm." if rpm else "Switch the platter's drive off and let it coast to rest."
    return Request("turntable_speed", text, {"rpm": rpm})


MESSAGES: tuple[str, ...] = ("turntable_speed",)
"""Actions asked of the operator: all that this driver can 'send'."""

REQUESTS: tuple[Request, ...] = (speed_card(SPEEDS[0]), speed_card(SPEEDS[1]), speed_card(0.0))
"""The same with all its settings."""


@dataclass(frozen=True)
class Limits:
    """When a rate counts as steady.

    `rate`: relative distance of each revolution's rate from nominal. `slope`: relative change of rate per revolution,
    fitted over the judged revolutions. `wow`: largest relative distance of a sector's rate from its revolution's.
    `revolutions` judged together; `timeout` s.
    """

    rate: float = 0.05
    slope: float = 0.0005
    wow: float = 0.03
    revolutions: int = 5
    timeout: float = 60.0


@dataclass(frozen=True)
class Revolution:
    """One revolution between two index pulses: when it began and ended (s), lines counted, sector rates (rad/s).

    `direction` is +1 or -1 as channel B says (about z up), 0 if it could not be told. `missed` says that the index
    pulse at its end was not seen.
    """

    begin: float
    end: float
    lines: int
    direction: int
    sectors: tuple[float, ...]
    missed: bool = False

    @property
    def rate(self) -> float:
        """Mean rate, rad/s, signed: eccentricity and graduation errors cancel over a whole revolution."""
        return math.copysign(2.0 * math.pi / (self.end - self.begin), self.direction or 1)

    @property
    def wow(self) -> float:
        """Largest relative distance of a sector's rate from the mean of the sectors."""
        if not self.sectors:
            return 0.0
        mean = sum(self.sectors) / len(self.sectors)
        return max(abs(sector / mean - 1.0) for sector in self.sectors)


def revolutions(edges: NDArray[np.float64], index: NDArray[np.float64], direction: int) -> list[Revolution]:
    """Whole revolutions from the times of line edges (one polarity of A) and of index pulses, both s, ascending.

    A revolution begins with the first edge after an index pulse. A count of two or three thousand lines is a missed
    index, and gives as many revolutions; any other count is passed on as it is, for the gate to refuse.
    """
    at = np.searchsorted(edges, index, side="right")
    found: list[Revolution] = []
    for first, last in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
        if last >= len(edges) or last == first:
            continue
        turns, rest = divmod(last - first, LINES)
        if rest or not 1 <= turns <= MISSED_AT_MOST:
            found.append(_revolution(edges[first : last + 1], direction, missed=False))
            continue
        for turn in range(turns):
            begin = first + turn * LINES
            found.append(_revolution(edges[begin : begin + LINES + 1], direction, missed=turn < turns - 1))
    return found


def _revolution(edges: NDArray[np.float64], direction: int, *, missed: bool) -> Revolution:
    lines = len(edges) - 1
    sectors: tuple[float, ...] = ()
    if lines == LINES:
        step = LINES // SECTORS
        sectors = tuple(_sector_rate(edges[k * step : (k + 1) * step + 1]) for k in range(SECTORS))
    return Revolution(float(edges[0]), float(edges[-1]), lines, direction, sectors, missed)


def _sector_rate(edges: NDArray[np.float64]) -> float:
    """Rate (rad/s) from a straight line through time over line number: unbiased, unlike the mean of 1/interval."""
    n = np.arange(len(edges)) - (len(edges) - 1) / 2.0
    period = float(n @ (edges - edges[0]) / (n @ n))
    return 2.0 * math.pi / (LINES * period) if period > 0 else math.inf


def stopped(edges: NDArray[np.float64], now: float, *, rate: float = math.radians(0.2)) -> bool:
    """Whether the platter turns slower than `rate` (rad/s): no line edge for as long as one line takes then, and 1 s.

    Without any edge the time line must already be that long: `now` counts from its beginning.
    """
    last = float(edges[-1]) if len(edges) else 0.0
    return now - last > max(2.0 * math.pi / LINES / rate, STANDING)


@dataclass(frozen=True)
class Verdict:
    """What the gate says. `rate` rad/s is the mean of the judged revolutions, `slope` relative per revolution."""

    state: Literal["waiting", "steady", "failed"]
    reason: str = ""
    revolutions: int = 0
    missed_index: int = 0
    rate: float = math.nan
    slope: float = math.nan
    wow: float = math.nan

    def __str__(self) -> str:
        return f"{self.state}: {self.reason}" if self.reason else self.state


# The rate is judged from index to index, whatever lines were lost between; lost lines are on record with the hold, and
# conclusions that rest on them refuse or repair. More than this is no encoder any more.
LOST_AT_MOST = 50


class Gate:
    """Judges revolutions as they come: waiting, steady, or failed with the reason. Once failed it stays failed."""

    def __init__(self, rpm: float, *, started: float = 0.0, direction: int = -1, limits: Limits | None = None) -> None:
        """`rpm` nominal, > 0; `started` s on the revolutions' time line; `direction` -1 is clockwise from above."""
        self._nominal, self._started, self._direction = rpm * RPM, started, direction
        self._limits = limits or Limits()
        self._judged: deque[Revolution] = deque(maxlen=self._limits.revolutions)
        self._seen = self._missed = 0
        self.verdict = Verdict("waiting", "no whole revolution yet")

    def feed(self, revolution: Revolution) -> Verdict:
        """Judge the next revolution together with those before it."""
        if self.verdict.state == "failed":
            return self.verdict
        self._seen += 1
        self._missed += revolution.missed
        if revolution.direction == -self._direction:
            return self._say("failed", f"turns {_sense(-self._direction)}, wanted {_sense(self._direction)}")
        if self._judged and abs(revolution.begin - self._judged[-1].end) > 1e-6:
            self._judged.clear()  # what lies between was not seen
        self._judged.append(revolution)
        reason = self._objection()
        self._say("waiting" if reason else "steady", reason)
        return self.look(revolution.end) if reason else self.verdict

    def look(self, now: float) -> Verdict:
        """Time has passed, with or without revolutions."""
        if self.verdict.state == "waiting" and now - self._started > self._limits.timeout:
            return self._say("failed", f"{self.verdict.reason}; not steady within {self._limits.timeout:g} s")
        return self.verdict

    def _objection(self) -> str:
        """Why the judged revolutions are not steady; empty if they are."""
        limits, last = self._limits, self._judged[-1]
        if abs(last.lines - LINES) > LOST_AT_MOST:
            self._judged.clear()
            return f"{last.lines} lines between index pulses, wanted {LINES}"
        if not last.direction:
            return "the direction cannot be told"
        for revolution in self._judged:
            error = abs(revolution.rate) / self._nominal - 1.0
            if not abs(error) <= limits.rate:
                wanted = f"{self._nominal / RPM:.2f} rpm ± {limits.rate:.0%} for {limits.revolutions} revolutions"
                return f"{abs(revolution.rate) / RPM:.2f} rpm, wanted {wanted}"
            if revolution.lines == LINES and not revolution.wow <= limits.wow:
                return f"wow {revolution.wow:.2%}, wanted at most {limits.wow:.2%}"
        if len(self._judged) < limits.revolutions:
            return f"{len(self._judged)} good revolutions, wanted {limits.revolutions}"
        if not abs(self._slope()) <= limits.slope:
            return f"rate changes by {self._slope():+.3%} per revolution, wanted at most {limits.slope:.3%}"
        return ""

    def _slope(self) -> float:
        """Relative change of rate per revolution: straight line through the judged revolutions."""
        rates = np.array([abs(revolution.rate) for revolution in self._judged])
        n = np.arange(len(rates)) - (len(rates) - 1) / 2.0
        spread = float(n @ n)
        return float(n @ rates) / spread / float(rates.mean()) if spread else 0.0

    def _say(self, state: Literal["waiting", "steady", "failed"], reason: str) -> Verdict:
        judged = self._judged
        self.verdict = Verdict(
            state,
            reason,
            self._seen,
            self._missed,
            rate=sum(one.rate for one in judged) / len(judged) if judged else math.nan,
            slope=self._slope() if judged else math.nan,
            wow=max((one.wow for one in judged), default=math.nan),
        )
        return self.verdict


def _sense(direction: int) -> str:
    return "clockwise" if direction < 0 else "anticlockwise"


class Settings(BaseModel):
    """Limits of the gate. `direction` is the platter's only sense: -1, clockwise seen from above."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rate_limit: Ratio = Field(default=0.05, gt=0, lt=0.2)
    slope_limit: Ratio = Field(default=0.0005, gt=0, description="relative change of rate per revolution")
    wow_limit: Ratio = Field(default=0.03, gt=0, description="largest distance of a sector's rate from the mean")
    revolutions: int = Field(default=5, ge=2, le=100, description="consecutive revolutions judged together")
    timeout: Time = Field(default=60.0, gt=0, description="on the bench's clock")
    direction: Literal[-1, 1] = -1
    rest: Rate = Field(default=math.radians(0.2), gt=0, description="below this the platter is at rest")


class Turntable:
    """The platter that a person starts and stops."""

    def __init__(self, name: str, settings: Settings, room: Room) -> None:
        self._name, self._settings, self._room = name, settings, room
        self._rpm = 0.0
        self.confirmation: Confirmation | None = None
        self.verdict: Verdict | None = None

    def identify(self) -> Identity:
        """From the calibration paper: there is nothing to ask."""
        return Identity("Technics", "SL-BD10", "not stated", "none; run by hand")

    def settings(self) -> dict[str, str | float | int | bool]:
        """What was confirmed and what the gate said last; rates in rad/s."""
        values: dict[str, str | float | int | bool] = {"rpm": self._rpm, "direction": self._settings.direction}
        if self.confirmation is not None:
            values |= {"confirmed_by": self.confirmation.who, "confirmed_at": self.confirmation.when}
        if self.verdict is not None:
            values |= {"gate": str(self.verdict), "rate": self.verdict.rate, "missed_index": self.verdict.missed_index}
        return values

    def set_speed(self, rpm: float) -> Confirmation:
        """Have the operator start the platter at 100/3 or 45 rpm, or stop it (0).

        Raises SettingRefused for any other speed (nobody is asked), OperatorRefused, OperatorMissing.
        """
        known = next((speed for speed in (0.0, *SPEEDS) if abs(rpm - speed) <= 1e-6), None)
        if known is None:
            raise SettingRefused(self._name, "the platter", wanted=f"100/3 rpm, 45 rpm or 0, found {rpm:g} rpm")
        self.verdict = None
        self.confirmation = self._room.operator.ask(speed_card(known))
        self._rpm = known
        return self.confirmation

    def gate(self, started: float = 0.0, rpm: float | None = None) -> Gate:
        """A new gate for the speed that was set (or `rpm`), from `started` s on the time line of the revolutions."""
        nominal = self._rpm if rpm is None else rpm
        if nominal <= 0:
            raise SettingRefused(self._name, "the platter", wanted="a speed above zero to wait for")
        one = self._settings
        limits = Limits(one.rate_limit, one.slope_limit, one.wow_limit, one.revolutions, one.timeout)
        return Gate(nominal, started=started, direction=one.direction, limits=limits)

    def wait_until_steady(
        self, look: Callable[[], tuple[float, Sequence[Revolution]]], started: float = 0.0
    ) -> Verdict:
        """Feed a gate until it opens. `look` gives the time (s) and the revolutions completed since the last look.

        Raises VerdictNotMet with the reason when the gate fails.
        """
        gate = self.gate(started)
        while True:
            now, completed = look()
            for revolution in completed:
                if gate.feed(revolution).state != "waiting":
                    break
            self.verdict = gate.look(now)
            if self.verdict.state == "steady":
                return self.verdict
            if self.verdict.state == "failed":
                raise VerdictNotMet(f"{self._name} at {self._rpm:.4g} rpm: found {self.verdict.reason}")

    def completed(self, edges: NDArray[np.float64], index: NDArray[np.float64], direction: int) -> list[Revolution]:
        """Whole revolutions between index pulses; see `revolutions`."""
        return revolutions(edges, index, direction)

    def at_rest(self, edges: NDArray[np.float64], now: float) -> bool:
        """Whether the platter is at rest; `edges` and `now` in s on one time line from 0."""
        return stopped(edges, now, rate=self._settings.rest)

    def require_rest(self, edges: NDArray[np.float64], now: float) -> None:
        """Raises VerdictNotMet unless the platter is at rest; `edges` and `now` in s on one time line from 0."""
        if not stopped(edges, now, rate=self._settings.rest):
            last = now - float(edges[-1]) if len(edges) else now
            raise VerdictNotMet(
                f"{self._name}: found a line edge {last:.2f} s ago, wanted a platter slower than "
                f"{math.degrees(self._settings.rest):g} °/s"
            )

    def close(self) -> None:
        """Nothing to close."""


def connect(name: str, settings: Settings, room: Room) -> Turntable:
    """Nothing is opened."""
    return Turntable(name, settings, room)
