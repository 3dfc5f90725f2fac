"""Polytec OFV-3001 vibrometer over RS-232: range by decoder table, every set confirmed, level and over-range.

9600 baud 8N1, lines end in LF (OFV-3001 manual E.2.4). What the driver has to live with: range numbers are not in
order and depend on the velocity decoder, settings have no reply, an invalid setting is ignored without a word, settings
may be ignored until `REN` was sent (inferred from the order in published code: verify on the bench), and the echo
mode, which a person can switch at the front panel, changes every reply (`5` becomes `VELO5`).

The analog output is ±10 V full scale (ITA-Toolbox), so a range of s (m/s)/V measures up to 10·s.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.links import SerialLink
from rig.errors import BadReply, InstrumentError, NoAnswer, SettingRefused, SignalLow, SignalOverload, WrongIdentity
from rig.record import Identity
from rig.room import Room
from rig.units import Time, VibrometerScale

BAUD = 9600
FULL_SCALE = 10.0
"""Volts at the end of every range."""

HEADROOM = 0.8
"""The peak may fill this share of a range (20…80 % is the maker's advice for accuracy)."""

DECODERS: Mapping[str, Mapping[int, float]] = MappingProxyType(
    {
        "OVD-01": MappingProxyType({5: 1e-3, 1: 5e-3, 2: 25e-3, 3: 125e-3, 4: 1.0}),
        "OVD-02": MappingProxyType({6: 5e-3, 7: 25e-3, 8: 125e-3, 9: 1.0}),
    }
)
"""Range number to scale, (m/s)/V (OFV-3001 manual, command VELO)."""

LIMITS: Mapping[str, tuple[int, int]] = MappingProxyType(
    {"VELO?": (1, 9), "OVR": (0, 1), "LEV": (0, 40), "REM": (0, 2)}
)
"""Every query, with the smallest and largest number that answers it."""

SET_PAUSE = 0.2
"""Between a set and the query that confirms it, s (published code)."""

MESSAGES: tuple[bytes, ...] = (b"REN\n", b"VELO?\n", b"VELO5\n", b"OVR\n", b"LEV\n", b"REM\n")


class Settings(BaseModel):
    """`decoder` names one of the maker's tables; `ranges` is a table of one's own, number to scale, and wins."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    address: str = Field(description="serial port, pseudo-terminal or socket://host:port")
    decoder: Literal["OVD-01", "OVD-02"] | None = None
    ranges: dict[int, VibrometerScale] = Field(default_factory=dict, description="range number to scale")
    serial: str = Field(default="not stated", description="from the plate: the controller cannot be asked")
    minimum_level: int = Field(default=5, ge=0, le=40, description="bars of optical level needed to trust a record")
    timeout: Time = Field(default=1.0, gt=0, description="silence before an answer is missing")
    attempts: int = Field(default=5, ge=1, le=50, description="sets before the range counts as refused")
    settle: Time = Field(default=2.0, ge=0, description="after a change of range, before OVR can be trusted")

    @model_validator(mode="after")
    def _has_ranges(self) -> Settings:
        if not self.table:
            raise ValueError("found neither decoder nor ranges, wanted a decoder (OVD-01, OVD-02) or a table of ranges")
        if not all(1 <= number <= 9 and scale > 0 for number, scale in self.table.items()):
            raise ValueError(f"found ranges {dict(self.table)}, wanted numbers 1…9 and positive scales")
        return self

    @property
    def table(self) -> Mapping[int, float]:
        """Range number to scale, (m/s)/V."""
        return self.ranges or (DECODERS[self.decoder] if self.decoder else {})


@dataclass(frozen=True)
class Check:
    """One look: optical level (bars, 0…40), whether the decoder was over its range since the last look, the scale."""

    level: int
    overrange: bool
    range_number: int
    scale: float


def parse_reply(query: str, line: bytes) -> int | None:
    """The number that answers `query` in one line, with echo off (`5`) or on (`VELO5`).

    None if the line only echoes a command (also a set whose echo came late). Raises ValueError, saying what was
    wanted, for anything else.
    """
    low, high = LIMITS[query]
    name = query.rstrip("?")
    wanted = f"{low}…{high}, alone or after {name}"
    text = line.decode("latin-1").strip().upper()
    if text in (query, name) or re.fullmatch(r"REN|ECHOON|ECHOOFF", text):
        return None
    match = re.fullmatch(rf"(?:{name})?[ =]*([0-9]{{1,3}})", text, re.ASCII)
    if match is None or not low <= int(match[1]) <= high:
        raise ValueError(wanted)
    return int(match[1])


class OFV3001:
    """The vibrometer: velocity out as volts, `scale` (m/s)/V."""

    def __init__(self, link: SerialLink, settings: Settings, room: Room) -> None:
        self._link, self._settings, self._room = link, settings, room
        self._echo = False  # known from the form of every reply
        self._remote = False

    def identify(self) -> Identity:
        """What stands in for an identity: REM, VELO? and LEV answered as only this language answers them.

        The controller has no identity query; maker and model follow from the language, the serial number from the
        bench file. Raises WrongIdentity, NoAnswer, Disconnected.
        """
        try:
            for query in ("REM", "VELO?", "LEV"):
                self._ask(query)
        except BadReply as error:
            raise WrongIdentity(
                error.instrument,
                error.address,
                sent=error.sent,
                received=error.received,
                wanted=f"an OFV-3001, which answers {error.wanted}",
            ) from error
        return Identity("Polytec", "OFV-3001", self._settings.serial, "no identity query; known by its language")

    def settings(self) -> dict[str, str | float | int | bool]:
        """Read back: range number, its scale (0 if the table does not have it), remote state, echo mode."""
        number = self._ask("VELO?")
        return {
            "decoder": self._settings.decoder or "own table",
            "range": number,
            "scale": self._settings.table.get(number, 0.0),
            "full_scale": FULL_SCALE,
            "remote": self._ask("REM"),
            "echo": self._echo,
        }

    def set_range_for(self, velocity_peak: float) -> float:
        """Choose the most sensitive range that the peak (m/s) fills to at most 80 %; returns its scale, (m/s)/V.

        Raises SettingRefused if no range is wide enough (nothing is sent) or the controller does not take the set.
        """
        number, scale = self._fitting(velocity_peak)
        if self._ask("VELO?") != number:
            self._set_range(number)
            self._room.clock.sleep(self._settings.settle)
            self.overrange()  # what the change itself latched is not the signal's
        return scale

    def level(self) -> int:
        """Optical level, bars 0…40."""
        return self._ask("LEV")

    def overrange(self) -> bool:
        """Whether the decoder is, or was since this was last asked, over its range."""
        return self._ask("OVR") == 1

    def check(self, *, require: bool = False) -> Check:
        """Level, over-range and range in one look; before, during and after every record.

        With `require`, raises SignalOverload or SignalLow if a record made now cannot be trusted, and SettingRefused
        if the range on the instrument is not in the table.
        """
        level, over, number = self.level(), self.overrange(), self._ask("VELO?")
        check = Check(level, over, number, self._settings.table.get(number, math.nan))
        if require:
            self._require(check)
        return check

    def close(self) -> None:
        """Close the line; the controller keeps its range."""
        self._link.close()

    def _require(self, check: Check) -> None:
        if check.overrange:
            limit = f"a velocity below {FULL_SCALE * check.scale:g} m/s"
            raise self._error(SignalOverload, "OVR", "1", limit)
        if check.level < self._settings.minimum_level:
            raise self._error(SignalLow, "LEV", str(check.level), f"at least {self._settings.minimum_level} of 40 bars")
        if math.isnan(check.scale):
            known = ", ".join(f"VELO{number}" for number in sorted(self._settings.table))
            raise self._error(SettingRefused, "VELO?", str(check.range_number), f"one of {known}")

    def _fitting(self, velocity_peak: float) -> tuple[int, float]:
        table = self._settings.table
        if not (math.isfinite(velocity_peak) and velocity_peak >= 0):
            raise self._error(SettingRefused, None, None, f"a peak velocity ≥ 0, found {velocity_peak} m/s")
        for number, scale in sorted(table.items(), key=lambda entry: entry[1]):
            if velocity_peak <= HEADROOM * FULL_SCALE * scale:
                return number, scale
        widest = HEADROOM * FULL_SCALE * max(table.values())
        raise self._error(SettingRefused, None, None, f"a peak of at most {widest:g} m/s, found {velocity_peak:g} m/s")

    def _set_range(self, number: int) -> None:
        """Set and confirm, again if need be: the controller never says that it ignored a setting."""
        command, found = f"VELO{number}", None
        for _ in range(self._settings.attempts):
            if not self._remote:
                self._tell("REN")
            self._tell(command)
            self._room.clock.sleep(SET_PAUSE)
            found = self._ask("VELO?")
            self._remote = found == number
            if found == number:
                return
        tries = self._settings.attempts
        raise self._error(SettingRefused, command, f"VELO? answers {found}", f"range {number} after {tries} sets")

    def _tell(self, command: str) -> None:
        """Send a setting; with echo on its echo is read, so that it cannot be taken for the answer to a query."""
        sent = f"{command}\n".encode("ascii")
        with self._link.lock:
            self._link.write(sent)
            if not self._echo:
                return
            try:
                self._link.read_until(b"\n", sent=sent)
            except NoAnswer:
                self._echo = False  # switched off at the panel meanwhile; the query that follows will tell

    def _ask(self, query: str) -> int:
        sent = f"{query}\n".encode("ascii")
        with self._link.lock:
            line = self._link.query(sent, b"\n")
            for _ in range(4):  # the query's own echo, or late echoes of sets, may come first
                number = self._number(query, line)
                if number is not None:
                    self._echo = bool(re.match(rb"\s*[A-Za-z]", line))
                    return number
                self._echo = True
                line = self._link.read_until(b"\n", sent=sent)
        raise self._error(BadReply, query, line, "a number, not echoes only")

    def _number(self, query: str, line: bytes) -> int | None:
        try:
            return parse_reply(query, line)
        except ValueError as error:
            raise self._error(BadReply, query, line, str(error)) from error

    def _error(
        self, kind: type[InstrumentError], sent: str | None, received: str | bytes | None, wanted: str
    ) -> InstrumentError:
        return kind(self._link.instrument, self._link.address, sent=sent, received=received, wanted=wanted)


def connect(name: str, settings: Settings, room: Room) -> OFV3001:
    """Open the line; nothing is sent. Raises Disconnected."""
    link = SerialLink.open(name, settings.address, baud=BAUD, timeout=settings.timeout, room=room)
    return OFV3001(link, settings, room)
