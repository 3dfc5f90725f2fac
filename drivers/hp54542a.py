"""HP 54542A oscilloscope: four channels at the same instants, one `:DIG` for all of them.

Its programmer's reference was not available. Commands are those that published code has sent to a 54542 (PythonLabTools
`vxi_11_scopes`), the preamble's order is that of the 54520/54540 family, and the conversion to volts that of the HP
54501A Programming Reference; verify on the bench. Words are used, not bytes: they keep what averaging gains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from drivers.links import VisaLink
from rig.errors import AcquisitionFailed, BadReply, NoAnswer, SettingRefused, WrongIdentity
from rig.record import Identity, Traces
from rig.room import Room
from rig.units import Time

CHANNELS = (1, 2, 3, 4)
ALL = "CHAN1,CHAN2,CHAN3,CHAN4"
WORD_FORMAT, REAL_TIME = 2, (1, 2, 4)  # preamble codes: format WORD; normal, average, raw
HOLE = -1
FIRST_CODE, LAST_CODE = 0, 32640  # first and last word of an 8-bit converter (255 · 128); inferred
EVENT_SUMMARY = 32
POLL = 0.05  # s on the bench's clock
ERRORS_AT_MOST = 35  # the queue holds 30

SETUP = (
    ":SYST:HEADER OFF",
    ":SYST:LONGFORM OFF",
    ":EOI ON",
    ":TIM:MODE AUTO;SAMPLE REAL",
    ":WAV:FORM WORD",
)

MESSAGES: tuple[str, ...] = (
    "*IDN?",
    *SETUP,
    ":ACQ:TYPE NORM;POINTS 8192;COUNT 1;COMPLETE 100",
    ":TIM:RANGE 1.0;REF LEFT;DEL 0",
    ":CHAN1:PROBE 1;RANGE 8;OFFS 0;COUP DC",
    ":CHAN1:RANGE?;OFFS?",
    ":TIM:RANGE?;:ACQ:POINTS?",
    ":STOP;*ESR?",
    "*ESE 1;*CLS",
    f":DIG {ALL};*OPC",
    ":WAV:SOUR CHAN1",
    ":WAV:PRE?",
    ":WAV:DATA?",
    ":SYST:ERR?",
)


class Settings(BaseModel):
    """Where the oscilloscope is, and what its four channels see."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    address: str = Field(min_length=1)
    gateway: str | None = None
    timeout: Time = Field(default=3.0, gt=0, le=60)
    backend: str = "@py"
    names: tuple[str, str, str, str] = ("ldv", "unit_a_x", "unit_a_y", "unit_a_z")


@dataclass(frozen=True)
class Preamble:
    """How codes become volts and seconds: volts = (code − y_reference)·y_increment + y_origin, likewise for time."""

    kind: int
    points: int
    x_increment: float
    x_origin: float
    x_reference: float
    y_increment: float
    y_origin: float
    y_reference: float


def parse_preamble(text: str) -> Preamble:
    """Ten fields: format, type, points, count, x-increment, -origin, -reference, y-increment, -origin, -reference.

    Raises ValueError for anything else, or for a format other than words.
    """
    fields = [float(part) for part in text.split(",")]
    if len(fields) != 10 or not all(math.isfinite(field) for field in fields):
        raise ValueError(f"found {len(fields)} fields, wanted 10 finite ones")
    if int(fields[0]) != WORD_FORMAT:
        raise ValueError(f"found format {fields[0]:g}, wanted {WORD_FORMAT} (words)")
    if int(fields[1]) not in REAL_TIME:
        raise ValueError(f"found type {fields[1]:g}, wanted one of {REAL_TIME}")
    return Preamble(int(fields[1]), int(fields[2]), fields[4], fields[5], fields[6], fields[7], fields[8], fields[9])


def to_volts(payload: bytes, preamble: Preamble) -> tuple[NDArray[np.float64], int]:
    """Volts, shape (points,), and how many samples sit on the first or last code.

    Raises ValueError for a wrong length or for holes (samples that were never taken).
    """
    if len(payload) != 2 * preamble.points:
        raise ValueError(f"found {len(payload)} bytes, wanted {2 * preamble.points}")
    codes = np.frombuffer(payload, ">i2")
    holes = int(np.count_nonzero(codes == HOLE))
    if holes:
        raise ValueError(f"found {holes} samples that were never taken, wanted none")
    clipped = int(np.count_nonzero((codes <= FIRST_CODE) | (codes >= LAST_CODE)))
    volts = (codes.astype(np.float64) - preamble.y_reference) * preamble.y_increment + preamble.y_origin
    return volts, clipped


class HP54542A:
    """Simultaneous recorder of four channels."""

    def __init__(self, link: VisaLink, settings: Settings, room: Room) -> None:
        self._link, self._names, self._room = link, settings.names, room
        self._duration = 0.0

    def identify(self) -> Identity:
        """Raises WrongIdentity if anything but a 54542 answers."""
        reply = self._link.query("*IDN?")
        parts = [part.strip() for part in reply.split(",")]
        if len(parts) != 4 or not parts[1].startswith("54542"):
            raise WrongIdentity(self._link.instrument, self._link.address, sent="*IDN?", received=reply, wanted="a 54542A")
        return Identity(*parts)

    def configure(self, *, duration: float, ranges: Sequence[tuple[float, float]], points: int = 8192) -> None:
        """Real-time record of `duration` (s); `ranges` is (full scale, offset) in V for each of the four channels.

        Raises SettingRefused: beforehand (nothing is sent) for nonsense, afterwards with the instrument's errors.
        """
        if not 1e-6 <= duration <= 100 or len(ranges) != len(CHANNELS) or any(full <= 0 for full, _ in ranges):
            raise self._refused("a duration of 1 µs to 100 s and four ranges above zero", None, f"{duration:g} s, {ranges}")
        for message in SETUP:
            self._link.write(message)
        self._link.write(f":ACQ:TYPE NORM;POINTS {points};COUNT 1;COMPLETE 100")
        self._link.write(f":TIM:RANGE {duration:.6g};REF LEFT;DEL 0")
        for channel, (full, offset) in zip(CHANNELS, ranges, strict=True):
            self._link.write(f":CHAN{channel}:PROBE 1;RANGE {full:.5g};OFFS {offset:.5g};COUP DC")
        errors = self.errors()
        if errors:
            raise self._refused("no error", "the set-up", ", ".join(errors))
        self._duration = duration

    def capture(self, patience: float | None = None) -> Traces:
        """One shot of all four channels. `patience` (s, bench clock) defaults to three durations and five seconds.

        Raises NoAnswer if no trigger comes (after a device clear), BadReply, AcquisitionFailed for holes.
        """
        self._link.query(":STOP;*ESR?")  # an old completion must not end the new wait
        self._link.write("*ESE 1;*CLS")
        self._link.write(f":DIG {ALL};*OPC")
        self._wait(3.0 * self._duration + 5.0 if patience is None else patience)
        read = [self._channel(channel) for channel in CHANNELS]
        preamble = read[0][0]
        return Traces(
            names=self._names,
            volts=np.vstack([volts for _, volts, _ in read]),
            start=(0 - preamble.x_reference) * preamble.x_increment + preamble.x_origin,
            interval=preamble.x_increment,
            clipped=tuple(clipped for _, _, clipped in read),
        )

    def errors(self) -> list[str]:
        """Error numbers in the queue, oldest first; the queue is empty afterwards."""
        found: list[str] = []
        for _ in range(ERRORS_AT_MOST):
            reply = self._link.query(":SYST:ERR?")
            if reply.split(",")[0].lstrip("+") == "0":
                return found
            found.append(reply)
        return found

    def settings(self) -> dict[str, str | float | int | bool]:
        """Read back from the instrument."""
        duration, points = self._link.query(":TIM:RANGE?;:ACQ:POINTS?").split(";")
        found: dict[str, str | float | int | bool] = {"duration": float(duration), "points": int(float(points))}
        for channel in CHANNELS:
            full, offset = self._link.query(f":CHAN{channel}:RANGE?;OFFS?").split(";")
            found |= {f"range_{channel}": float(full), f"offset_{channel}": float(offset)}
        return found

    def close(self) -> None:
        """Close the link; the instrument keeps its state."""
        self._link.close()

    def _wait(self, patience: float) -> None:
        waited, pause = 0.0, max(self._duration, POLL)
        while waited < patience:
            self._room.clock.sleep(pause)
            waited, pause = waited + pause, POLL
            if self._link.poll() & EVENT_SUMMARY:
                return
        self._link.clear()  # nothing else ends a digitize that waits for its trigger
        raise NoAnswer(self._link.instrument, self._link.address, sent=f":DIG {ALL};*OPC", wanted=f"a trigger within {patience:g} s")

    def _channel(self, channel: int) -> tuple[Preamble, NDArray[np.float64], int]:
        self._link.write(f":WAV:SOUR CHAN{channel}")
        text = self._link.query(":WAV:PRE?")
        try:
            preamble = parse_preamble(text)
        except ValueError as error:
            raise BadReply(
                self._link.instrument, self._link.address, sent=":WAV:PRE?", received=text, wanted=f"a preamble ({error})"
            ) from error
        payload = self._link.query_block(":WAV:DATA?")
        try:
            return (preamble, *to_volts(payload, preamble))
        except ValueError as error:
            raise AcquisitionFailed(
                self._link.instrument, self._link.address, sent=":WAV:DATA?", wanted=f"a whole record ({error})"
            ) from error

    def _refused(self, wanted: str, sent: str | None, received: str | None) -> SettingRefused:
        return SettingRefused(self._link.instrument, self._link.address, sent=sent, received=received, wanted=wanted)


def connect(name: str, settings: Settings, room: Room) -> HP54542A:
    """Open the link; nothing is sent to the oscilloscope."""
    link = VisaLink.open(
        name, settings.address, gateway=settings.gateway, timeout=settings.timeout, room=room, backend=settings.backend
    )
    return HP54542A(link, settings, room)
