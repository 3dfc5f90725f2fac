"""HP 54542A oscilloscope: four channels at the same instants, one `:DIG` for all of them.

Its programmer's reference was not available. Commands are those that published code has sent to a 54542 (PythonLabTools
`vxi_11_scopes`), the preamble's order is that of the 54520/54540 family, and the conversion to volts that of the HP
54501A Programming Reference; verify on the bench. Words are used, not bytes: they keep what averaging gains.

The command set is not the analyzer's: errors come as bare numbers, one reply is pending at most, and the parser is busy
during a digitize, so the end is waited for by serial poll. A digitize that meets no trigger ends only by device clear
(inferred from the family).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from drivers.links import VisaLink
from rig.errors import AcquisitionFailed, BadReply, InstrumentError, NoAnswer, SettingRefused, WrongIdentity
from rig.record import Identity, Traces
from rig.room import Room
from rig.units import Time

CHANNELS = (1, 2, 3, 4)
ALL = "CHAN1,CHAN2,CHAN3,CHAN4"
BYTES = {1: ("i1", 1), 2: (">i2", 2)}
"""Sample type and size by the preamble's format code, 1 BYTE and 2 WORD. Newer families number them otherwise."""
KINDS = (1, 2, 4)  # preamble's type code: normal, average, raw
HOLE = -1  # in place of a sample that was never taken
CONVERTER_STEPS = 256  # 8 bits (widely quoted, no source found: verify on the bench)
SMALLEST_RECORD, LARGEST_RECORD = 512, 32_768  # points (inferred: verify on the bench)
SHORTEST, LONGEST = 5e-9, 50.0  # s, ten divisions
EVENT_SUMMARY = 32  # status byte, bit 5
POLL = 0.02  # s on the bench's clock
ERRORS_AT_MOST = 35  # the queue holds 30
SAME_STEPS = 0.01  # relative, of what share of its range a step is

PLAIN = ":SYST:HEADER OFF;:SYST:LONGFORM OFF;:EOI ON;:WAV:FORM WORD"
RECORD = ":TIM:MODE {mode};SAMPLE REAL;RANGE {duration:.6g};REF LEFT;DEL 0;RANGE?"
POINTS = ":ACQ:TYPE NORM;POINTS {points};COUNT 1;COMPLETE 100;POINTS?"
CHANNEL = ":CHAN{channel}:PROBE 1;RANGE {full:.6g};OFFS {offset:.6g};COUP DC;RANGE?;OFFS?"
TRIGGER = ":TRIG:SOUR CHAN{channel};SLOP {slope};LEVEL {level:.6g}"
READY = ":STOP;*ESR?;*ESE 1"
DIGITIZE = f":DIG {ALL};*OPC"
PREAMBLE = ":WAV:SOUR CHAN{channel};PRE?"
DATA = ":WAV:DATA?"
ERROR = ":SYST:ERR?"
TIME_BACK = ":TIM:RANGE?;:ACQ:POINTS?"
CHANNEL_BACK = ":CHAN{channel}:RANGE?;OFFS?"

MESSAGES: tuple[str, ...] = (
    "*IDN?",
    "*CLS",
    PLAIN,
    RECORD.format(mode="TRIG", duration=0.5),
    RECORD.format(mode="AUTO", duration=0.5),
    POINTS.format(points=8192),
    *(CHANNEL.format(channel=channel, full=8.0, offset=0.0) for channel in CHANNELS),
    TRIGGER.format(channel=1, slope="POS", level=0.0),
    READY,
    DIGITIZE,
    *(PREAMBLE.format(channel=channel) for channel in CHANNELS),
    DATA,
    TIME_BACK,
    *(CHANNEL_BACK.format(channel=channel) for channel in CHANNELS),
    ":STOP",
    ERROR,
)
"""Every message, in an order in which the instrument takes all of them."""


class Settings(BaseModel):
    """Where the oscilloscope is, and what its four channels see."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    address: str = Field(min_length=1)
    gateway: str | None = None
    timeout: Time = Field(default=3.0, gt=0, le=60)
    backend: str = "@py"
    names: tuple[str, str, str, str] | None = Field(
        default=None, description="what its channels see; as the bench wires it unless stated"
    )


@dataclass(frozen=True)
class EdgeTrigger:
    """Start at the edge of a channel (1…4) through `level`, V."""

    channel: int
    level: float = 0.0
    slope: Literal["POS", "NEG"] = "POS"


@dataclass(frozen=True)
class Preamble:
    """How codes become volts and seconds: volts = (code − y_reference)·y_increment + y_origin, likewise for time."""

    format: int
    points: int
    x_increment: float
    x_origin: float
    x_reference: float
    y_increment: float
    y_origin: float
    y_reference: float

    @property
    def start(self) -> float:
        """Time of the first sample from the trigger, s."""
        return (0 - self.x_reference) * self.x_increment + self.x_origin


@dataclass(frozen=True)
class Window:
    """What a channel can show: full scale and the voltage in its middle, V, as read back."""

    full: float
    offset: float


def parse_preamble(text: str) -> Preamble:
    """Ten fields: format, type, points, count, x-increment, -origin, -reference, y-increment, -origin, -reference.

    Raises ValueError for anything else, or for samples that are neither bytes nor words.
    """
    try:
        fields = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise ValueError("ten numbers") from error
    if len(fields) != 10 or not all(map(math.isfinite, fields)):
        raise ValueError("ten finite numbers")
    if any(field != int(field) for field in fields[:4]) or fields[2] < 1:
        raise ValueError("whole numbers for format, type, points and count, and at least one point")
    if int(fields[0]) not in BYTES:
        raise ValueError("format 1 (bytes) or 2 (words)")
    if int(fields[1]) not in KINDS:
        raise ValueError(f"a record of type {KINDS}")
    if fields[4] <= 0 or fields[7] <= 0:
        raise ValueError("increments above zero")
    return Preamble(int(fields[0]), int(fields[2]), *fields[4:])


def to_volts(payload: bytes, preamble: Preamble) -> NDArray[np.float64]:
    """Volts, shape (points,). Raises ValueError for a wrong length or for holes (samples that were never taken)."""
    kind, size = BYTES[preamble.format]
    if len(payload) != size * preamble.points:
        raise ValueError(f"{size * preamble.points} bytes, found {len(payload)}")
    codes = np.frombuffer(payload, kind)
    holes = int(np.count_nonzero(codes == HOLE))
    if holes:
        raise ValueError(f"every sample, found {holes} of {preamble.points} never taken")
    return (codes.astype(np.float64) - preamble.y_reference) * preamble.y_increment + preamble.y_origin


def clipped(volts: NDArray[np.float64], window: Window) -> int:
    """How many samples sit on the converter's first or last step, or beyond: what they were is not known.

    Told from the voltages, because where the codes end is not documented: the first step is the bottom of the window,
    the last one step below its top.
    """
    step = window.full / CONVERTER_STEPS
    bottom, top = window.offset - window.full / 2, window.offset + window.full / 2
    return int(np.count_nonzero((volts <= bottom + 0.5 * step) | (volts >= top - 1.5 * step)))


class HP54542A:
    """Simultaneous recorder of four channels."""

    def __init__(self, link: VisaLink, settings: Settings, room: Room) -> None:
        self._link, self._room = link, room
        self._names = settings.names or tuple(f"channel {number}" for number in CHANNELS)
        self._duration = 0.0
        self._windows: tuple[Window, ...] = ()

    def identify(self) -> Identity:
        """Raises WrongIdentity if anything but a 54542 answers."""
        reply = self._link.query("*IDN?")
        parts = [part.strip() for part in reply.split(",")]
        if len(parts) != 4 or not parts[1].startswith("54542"):
            raise self._error(WrongIdentity, "a 54542A", "*IDN?", reply)
        return Identity(*parts)

    def configure(
        self,
        *,
        duration: float,
        ranges: Sequence[tuple[float, float]],
        points: int = 8192,
        trigger: EdgeTrigger | None = None,
    ) -> None:
        """Real-time record of `duration` (s); `ranges` is (full scale, offset) in V for each of the four channels.

        The instrument takes the next larger steps of its own; each is read back and must hold what was asked for.
        Without a `trigger` the record begins by itself. Raises SettingRefused: beforehand (nothing is sent) for what
        the instrument cannot do, afterwards for what it did not take.
        """
        self._check(duration, ranges, points, trigger)
        self._link.write("*CLS")  # errors from before are not those of the set-up
        self._link.write(PLAIN)
        self._at_least(RECORD.format(mode="TRIG" if trigger else "AUTO", duration=duration), duration)
        self._at_least(POINTS.format(points=points), points)
        pairs = zip(CHANNELS, ranges, strict=True)
        windows = tuple(self._set_channel(channel, full, offset) for channel, (full, offset) in pairs)
        if trigger:
            self._link.write(TRIGGER.format(channel=trigger.channel, slope=trigger.slope, level=trigger.level))
        self._raise_errors("the set-up")
        self._duration, self._windows = duration, windows

    def capture(self, patience: float | None = None) -> Traces:
        """One shot of all four channels. `patience` (s, bench clock) defaults to three durations and five seconds.

        Raises NoAnswer if no trigger comes (after a device clear), BadReply for a preamble or block that is none,
        AcquisitionFailed for a record with holes, SettingRefused with the instrument's errors or if not configured.
        """
        if not self._windows:
            raise self._error(SettingRefused, "a configured record", None, None)
        self._link.query(READY)  # an old completion must not end the new wait
        self._link.write(DIGITIZE)
        self._await_completion(3.0 * self._duration + 5.0 if patience is None else patience)
        read = [self._channel(channel) for channel in CHANNELS]
        self._raise_errors(DIGITIZE)
        first = read[0][0]
        if any(
            (one.points, one.start, one.x_increment) != (first.points, first.start, first.x_increment)
            for one, _ in read
        ):
            raise self._error(BadReply, "the same sample instants in all channels", PREAMBLE.format(channel=4), None)
        self._refuse_other_steps([one.y_increment for one, _ in read])
        volts = np.vstack([one for _, one in read])
        counts = tuple(clipped(one, window) for one, window in zip(volts, self._windows, strict=True))
        return Traces(self._names, volts, start=first.start, interval=first.x_increment, clipped=counts)

    def _refuse_other_steps(self, increments: Sequence[float]) -> None:
        """How many steps a range has is not documented, but all channels have the same converter."""
        shares = [step / window.full for step, window in zip(increments, self._windows, strict=True)]
        for channel, share in zip(CHANNELS, shares, strict=True):
            if abs(share / sorted(shares)[1] - 1.0) > SAME_STEPS:
                wanted = f"steps of the same share of the range as in other channels, found {share:.4g} of it"
                raise self._error(BadReply, wanted, PREAMBLE.format(channel=channel), None)

    def errors(self) -> list[str]:
        """Error numbers in the queue, oldest first; the queue is empty afterwards. Raises BadReply."""
        found: list[str] = []
        for _ in range(ERRORS_AT_MOST):
            reply = self._link.query(ERROR)
            number = reply.split(",")[0].split(" ")[-1]  # with headers on, the command comes first
            if int(self._numbers(ERROR, number, 1)[0]) == 0:
                break
            found.append(reply)
        return found

    def settings(self) -> dict[str, str | float | int | bool]:
        """Read back from the instrument: s, V."""
        duration, points = self._numbers(TIME_BACK, self._link.query(TIME_BACK), 2)
        found: dict[str, str | float | int | bool] = {"duration": duration, "points": int(points)}
        for channel, name in zip(CHANNELS, self._names, strict=True):
            sent = CHANNEL_BACK.format(channel=channel)
            full, offset = self._numbers(sent, self._link.query(sent), 2)
            found |= {f"channel_{channel}": name, f"range_{channel}": full, f"offset_{channel}": offset}
        return found

    def close(self) -> None:
        """Close the link; the instrument keeps its state."""
        self._link.close()

    def _check(
        self, duration: float, ranges: Sequence[tuple[float, float]], points: int, trigger: EdgeTrigger | None
    ) -> None:
        if not SHORTEST <= duration <= LONGEST:
            raise self._error(
                SettingRefused, f"a duration of {SHORTEST:g} to {LONGEST:g} s, found {duration:g}", None, None
            )
        if not SMALLEST_RECORD <= points <= LARGEST_RECORD:
            wanted = f"{SMALLEST_RECORD} to {LARGEST_RECORD} points, found {points}"
            raise self._error(SettingRefused, wanted, None, None)
        if len(ranges) != len(CHANNELS) or not all(0.0 < full < math.inf and math.isfinite(at) for full, at in ranges):
            raise self._error(SettingRefused, f"four ranges above zero with their offsets, found {ranges}", None, None)
        if trigger is not None and trigger.channel not in CHANNELS:
            raise self._error(SettingRefused, f"a trigger on channel 1 to 4, found {trigger.channel}", None, None)

    def _at_least(self, message: str, wanted: float) -> None:
        found = self._link.query(message)
        if self._numbers(message, found, 1)[0] < wanted * (1.0 - 1e-4):
            raise self._error(SettingRefused, f"at least {wanted:g}", message, found)

    def _set_channel(self, channel: int, full: float, offset: float) -> Window:
        message = CHANNEL.format(channel=channel, full=full, offset=offset)
        found = self._link.query(message)
        window = Window(*self._numbers(message, found, 2))
        if window.full < full * (1.0 - 1e-4) or abs(window.offset - offset) > 0.01 * window.full:
            raise self._error(SettingRefused, f"a range of at least {full:g} V about {offset:g} V", message, found)
        return window

    def _await_completion(self, patience: float) -> None:
        begun = self._room.clock.now()
        while not self._link.poll() & EVENT_SUMMARY:
            waited = self._room.clock.now() - begun
            if waited >= patience:
                self._link.clear()  # nothing else ends a digitize that waits for its trigger
                self._link.write(":STOP")
                self._raise_errors(DIGITIZE)
                raise self._error(NoAnswer, f"a trigger and a full record within {patience:g} s", DIGITIZE, None)
            self._room.clock.sleep(max(self._duration - waited, POLL))

    def _channel(self, channel: int) -> tuple[Preamble, NDArray[np.float64]]:
        sent = PREAMBLE.format(channel=channel)
        text = self._link.query(sent)
        try:
            preamble = parse_preamble(text)
        except ValueError as error:
            raise self._error(BadReply, f"a preamble of {error}", sent, text) from error
        payload = self._link.query_block(DATA)
        try:
            return preamble, to_volts(payload, preamble)
        except ValueError as error:
            raise self._error(AcquisitionFailed, str(error), DATA, f"{len(payload)} bytes") from error

    def _raise_errors(self, sent: str) -> None:
        found = self.errors()
        if found:
            raise self._error(SettingRefused, "no error", sent, f"error {', '.join(found)}")

    def _numbers(self, sent: str, reply: str, count: int) -> tuple[float, ...]:
        """Numbers joined by `;`. A header in front of one means that headers are still on: not a number."""
        try:
            values = tuple(float(part) for part in reply.split(";"))
        except ValueError as error:
            raise self._error(BadReply, f"{count} numbers", sent, reply) from error
        if len(values) != count or not all(map(math.isfinite, values)):
            raise self._error(BadReply, f"{count} numbers", sent, reply)
        return values

    def _error(
        self, kind: type[InstrumentError], wanted: str, sent: str | None, received: str | None
    ) -> InstrumentError:
        return kind(self._link.instrument, self._link.address, sent=sent, received=received, wanted=wanted)


def connect(name: str, settings: Settings, room: Room) -> HP54542A:
    """Open the link; nothing is sent to the oscilloscope. Raises Disconnected."""
    link = VisaLink.open(
        name, settings.address, gateway=settings.gateway, timeout=settings.timeout, room=room, backend=settings.backend
    )
    return HP54542A(link, settings, room)
