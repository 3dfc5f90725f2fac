"""Sensor Cube over its serial link: COBS frames with CRC, raw counts with sequence number and device time.

The protocol is on the page "On the wire". Two halves: pure functions and a parser from bytes to values (`encode_frame`,
`FrameParser`, `fit_clock`), and the driver, which commands the device and waits. After any damage the parser takes up
at the next zero byte; it counts what it lost and fills nothing in.

A device that streams must be read: the operating system holds about a second of frames for a client that does other
things meanwhile (Linux terminal buffers, 64 KiB; inferred for USB adapters: verify on the bench). What is lost shows as
gaps in the sequence.
"""

from __future__ import annotations

import binascii
import itertools
import math
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from drivers.links import SerialLink
from rig.errors import (
    AcquisitionFailed,
    BadReply,
    InstrumentError,
    NoAnswer,
    SettingRefused,
    WrongIdentity,
)
from rig.record import ClockFit, CubeSamples, Identity
from rig.room import Room
from rig.units import Frequency, Time

VERSION = 1
SAMPLE, IDENTIFY, SET_RATE, START, STOP, SELF_TEST, ANSWER = 0x01, 0x10, 0x11, 0x12, 0x13, 0x14, 0x80
VALUES = 15
"""In a frame: units A, B, C x y z, gyros pitch roll yaw, backup gyros pitch roll yaw."""

LOWEST_RATE, HIGHEST_RATE = 50, 1500  # Hz
STATUS = ("done", "unknown command", "bad parameter", "refused while streaming", "failed")
LONGEST_FRAME = 512
"""Encoded bytes; what goes on longer without a zero is damage."""

CHUNK = 0.02
"""Mean bench time between two looks at the line, s: 30 frames at the highest rate."""

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
"""Looks at multiples of the sample period would all come equally late and hide the drift of the clock."""

ON_THE_WAY = 3
"""Frames that may still be on the line when their sampling instant is past."""

LUMP_WAIT = 0.05
"""Real time to wait for frames that the bench's clock says must have been sent, s."""

CRYSTAL = 1e-4
"""Relative tolerance of the device's clock: a common crystal."""

STALLED = 1.0
"""Bench time without one good frame after which a record has ended early, s."""

_HEADER = struct.Struct("<BB")
_SAMPLE = struct.Struct("<IIHHH15H")


@dataclass(frozen=True)
class Sample:
    """One sample frame as it came: wrapping counters, raw counts."""

    sequence: int
    device_us: int
    flags: int
    supply: int
    temperature: int
    counts: tuple[int, ...]


@dataclass(frozen=True)
class Answer:
    """The device's answer to a command: `command` is the command's type."""

    command: int
    token: int
    status: int
    data: bytes


class FrameError(ValueError):
    """Bytes between two zeros that are no frame; the text says why."""


def cobs_encode(data: bytes) -> bytes:
    """Consistent overhead byte stuffing (Cheshire and Baker, 1999): the same content without a zero byte."""
    encoded, block = bytearray(), bytearray()
    for byte in data:
        if byte:
            block.append(byte)
        if not byte or len(block) == 254:
            encoded += bytes([len(block) + 1]) + block
            block.clear()
    # A full last block (254) needs no successor; everything else ends with what is left, even if that is nothing.
    if block or not data or data[-1] == 0 or len(encoded) == 0:
        encoded += bytes([len(block) + 1]) + block
    return bytes(encoded)


def cobs_decode(encoded: bytes) -> bytes:
    """The inverse. Raises FrameError for what no encoder can have made."""
    decoded, at = bytearray(), 0
    if not encoded or 0 in encoded:
        raise FrameError("wanted COBS: at least one byte, none of them zero")
    while at < len(encoded):
        code = encoded[at]
        if at + code > len(encoded):
            raise FrameError("wanted COBS: a block ends beyond the frame")
        decoded += encoded[at + 1 : at + code]
        at += code
        if code < 255 and at < len(encoded):
            decoded.append(0)
    return bytes(decoded)


def crc(body: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, initial 0xFFFF; 0x29B1 for b"123456789"."""
    return binascii.crc_hqx(body, 0xFFFF)


def encode_frame(body: bytes) -> bytes:
    """A body with its CRC, stuffed, and the zero that ends it."""
    return cobs_encode(body + struct.pack("<H", crc(body))) + b"\0"


def decode_frame(encoded: bytes) -> Sample | Answer:
    """One frame without its zero. Raises FrameError."""
    content = cobs_decode(encoded)
    if len(content) < _HEADER.size + 2:
        raise FrameError("wanted a version, a type and a CRC")
    body, sum_received = content[:-2], int.from_bytes(content[-2:], "little")
    if crc(body) != sum_received:
        raise FrameError(f"wanted CRC {crc(body):04X}, found {sum_received:04X}")
    version, kind = _HEADER.unpack_from(body)
    fields = body[_HEADER.size :]
    if version == VERSION and kind == SAMPLE and len(fields) == _SAMPLE.size:
        sequence, device_us, flags, supply, temperature, *counts = _SAMPLE.unpack(fields)
        return Sample(sequence, device_us, flags, supply, temperature, tuple(counts))
    if version == VERSION and kind & ANSWER and len(fields) >= 2:
        return Answer(kind & ~ANSWER, fields[0], fields[1], fields[2:])
    raise FrameError(f"wanted version {VERSION} and a known type, found {version} and 0x{kind:02X}")


def command(kind: int, token: int, data: bytes = b"") -> bytes:
    """A command's bytes on the line."""
    return encode_frame(_HEADER.pack(VERSION, kind) + bytes([token]) + data)


MESSAGES: tuple[bytes, ...] = (
    command(IDENTIFY, 1),
    command(STOP, 2),
    command(SET_RATE, 3, struct.pack("<H", 1000)),
    command(SELF_TEST, 4),
    command(START, 5),
    command(STOP, 6),
)


class FrameParser:
    """Bytes in, frames out. Never raises; `bad` counts stretches between zeros that were no frame."""

    def __init__(self) -> None:
        self.bad = 0
        self._left = bytearray()
        self._overlong = False

    def feed(self, data: bytes) -> list[Sample | Answer]:
        """The frames that are now complete, in the order of arrival."""
        *complete, rest = data.split(b"\0")
        frames: list[Sample | Answer] = []
        for part in complete:
            frames += self._frame(bytes(self._left) + part)
            self._left.clear()
        self._left += rest
        if len(self._left) > LONGEST_FRAME:
            self._overlong = True
            self._left.clear()
        return frames

    def _frame(self, encoded: bytes) -> Iterator[Sample | Answer]:
        overlong, self._overlong = self._overlong, False
        if not encoded and not overlong:
            return  # two zeros in a row: an idle line, not damage
        try:
            if overlong or len(encoded) > LONGEST_FRAME:
                raise FrameError(f"wanted a zero within {LONGEST_FRAME} bytes")
            yield decode_frame(encoded)
        except FrameError:
            self.bad += 1


class Unwrapped:
    """A wrapping 32-bit counter as a growing integer that starts at zero."""

    def __init__(self) -> None:
        self._last: int | None = None
        self.value = 0

    def step(self, raw: int) -> int:
        """How far the counter has moved on since the last value, modulo 2³²."""
        return 0 if self._last is None else (raw - self._last) % (1 << 32)

    def advance(self, raw: int) -> int:
        """Take in the next value."""
        self.value += self.step(raw)
        self._last = raw
        return self.value


def fit_clock(device: NDArray[np.float64], arrival: NDArray[np.float64], resolution: float = 0.0) -> ClockFit | None:
    """Straight line through arrival times (bench clock, s) over device times (s), both shape (n,), n ≥ 3, or None.

    Least squares, repeated without arrivals later than three robust standard deviations (1.4826 median absolute
    deviations) above the line, until none is left; an arrival can be late but not early. Standard uncertainties come
    from the scatter of those used, which is never taken to be less than `resolution` (s): an arrival that can be
    anywhere within a sample period has a standard deviation of the period over √12. None without a line.
    """
    keep = np.ones(len(device), bool)
    for _ in range(30):
        if keep.sum() < 3 or np.ptp(device[keep]) == 0:
            return None
        residual = _residuals(device, arrival, keep)
        spread = max(1.4826 * float(np.median(np.abs(residual[keep]))), resolution, 1e-7)
        timely = residual <= 3.0 * spread
        if np.array_equal(timely, keep):
            break
        keep = timely
    return _clock_line(device, arrival, keep, resolution) if keep.sum() >= 3 else None


def clock_of(device: NDArray[np.float64], arrival: NDArray[np.float64], resolution: float) -> ClockFit | None:
    """The fitted line, or where arrivals are few or close together one of the nominal rate, right to `CRYSTAL`."""
    fitted = fit_clock(device, arrival, resolution)
    if fitted is not None and fitted.u_rate < CRYSTAL:
        return fitted
    if not len(device):
        return None
    apart = arrival - device
    u = max(float(np.std(apart)), resolution)
    return ClockFit(float(np.median(apart)), 0.0, u, CRYSTAL, used=len(apart), late=0)


def _residuals(
    device: NDArray[np.float64], arrival: NDArray[np.float64], keep: NDArray[np.bool_]
) -> NDArray[np.float64]:
    slope, mean_device, mean_arrival = _line(device[keep], arrival[keep])
    late = (arrival - mean_arrival) - slope * (device - mean_device)
    return np.asarray(late - np.median(late[keep]))


def _line(device: NDArray[np.float64], arrival: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y = device - device.mean(), arrival - arrival[0]
    return float(x @ (y - y.mean()) / (x @ x)), float(device.mean()), float(arrival[0] + y.mean())


def _clock_line(
    device: NDArray[np.float64], arrival: NDArray[np.float64], keep: NDArray[np.bool_], resolution: float
) -> ClockFit | None:
    x, y = device[keep], arrival[keep]
    slope, mean_x, mean_y = _line(x, y)
    if slope <= 0:
        return None
    n, sxx = len(x), float(((x - mean_x) ** 2).sum())
    scatter = math.sqrt(float((((y - mean_y) - slope * (x - mean_x)) ** 2).sum()) / max(n - 2, 1))
    scatter = max(scatter, resolution)
    u_slope = scatter / math.sqrt(sxx)
    u_offset = math.hypot(scatter / math.sqrt(n), u_slope * mean_x)
    return ClockFit(
        offset=mean_y - slope * mean_x,
        rate_error=1.0 / slope - 1.0,
        u_offset=u_offset,
        u_rate=u_slope / slope**2,
        used=n,
        late=len(device) - n,
    )


class Settings(BaseModel):
    """`model` is what the device must call itself."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    address: str = Field(description="serial port, pseudo-terminal or socket://host:port")
    baud: int = Field(default=921_600, gt=0)
    rate: Frequency = Field(default=1000.0, ge=LOWEST_RATE, le=HIGHEST_RATE, description="samples per second")
    model: str = "Sensor Cube"
    timeout: Time = Field(default=0.5, gt=0, description="silence before an answer is missing")
    attempts: int = Field(default=3, ge=1, le=20, description="times a command is sent before it counts as lost")
    names: tuple[str, ...] | None = Field(
        default=None, description="of the values in a frame; the sensor file's channels if they are as many"
    )

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the values: nothing is claimed of them where there are not as many names."""
        if self.names is not None and len(self.names) == VALUES:
            return self.names
        return tuple(f"value {number}" for number in range(1, VALUES + 1))


@dataclass
class _Record:
    """What has arrived since `start`."""

    rate: float
    begun: float
    sequence: Unwrapped = field(default_factory=Unwrapped)
    device_us: Unwrapped = field(default_factory=Unwrapped)
    rows: list[tuple[int, int, Sample]] = field(default_factory=list)
    arrivals: list[tuple[float, float]] = field(default_factory=list)  # newest device time of a lump, bench time
    first_arrival: float = math.nan
    next_sequence: int = 0
    last_good: float = 0.0
    bad_before: int = 0
    looks: int = 0

    def add(self, samples: Sequence[Sample]) -> None:
        """Take in what has arrived. Raises ValueError if the device began anew."""
        for sample in samples:
            if self.sequence.step(sample.sequence) >= 1 << 31:
                raise ValueError(f"sequence number {sample.sequence}, before the last one")
            row = (self.sequence.advance(sample.sequence), self.device_us.advance(sample.device_us), sample)
            self.rows.append(row)

    def stamp(self, now: float) -> None:
        """The lump that was just added arrived at bench time `now`."""
        # Older frames of a lump have waited on the line; only the newest says what time it is.
        self.arrivals.append((self.device_us.value * 1e-6, now))
        self.last_good = now
        if math.isnan(self.first_arrival):
            self.first_arrival = now

    def pause(self) -> float:
        """Bench time until the next look, s: between a half and three halves of CHUNK."""
        self.looks += 1
        return CHUNK * (0.5 + self.looks * GOLDEN % 1.0)

    def due(self, now: float) -> int:
        """The sequence number that must have arrived by now (0.2 % allowed for the device's clock)."""
        return math.floor((now - self.begun) * self.rate * 0.998) - ON_THE_WAY


class SensorCube:
    """The cube as a recorder of its fifteen channels."""

    def __init__(self, link: SerialLink, settings: Settings, room: Room) -> None:
        self._link, self._settings, self._room = link, settings, room
        self._parser = FrameParser()
        self._tokens = itertools.cycle(range(1, 256))
        self._rate: float | None = None
        self._record: _Record | None = None
        self._waiting: list[Sample] = []

    def identify(self) -> Identity:
        """Who answers. Raises WrongIdentity if it is no Sensor Cube, NoAnswer, Disconnected."""
        answer = self._command(IDENTIFY)
        parts = answer.data.decode("latin-1").split(",")
        if len(parts) != 4 or parts[1] != self._settings.model:
            wanted = f"maker,{self._settings.model},serial,firmware"
            raise self._error(WrongIdentity, "identify", answer.data, wanted)
        return Identity(*parts)

    def configure(self, rate: float | None = None) -> float:
        """Stop, and set samples per second (default: the bench file's); returns what the device really set, Hz.

        Raises SettingRefused (outside 50…1500 Hz or not whole: nothing is sent), NoAnswer, Disconnected.
        """
        wanted = self._settings.rate if rate is None else rate
        if not (LOWEST_RATE <= wanted <= HIGHEST_RATE and float(wanted).is_integer()):
            limits = f"a whole number of samples per second, {LOWEST_RATE}…{HIGHEST_RATE}"
            raise self._error(SettingRefused, None, None, f"{limits}, found {wanted}")
        self._command(STOP)
        answer = self._command(SET_RATE, struct.pack("<H", int(wanted)))
        if len(answer.data) != 2:
            raise self._error(BadReply, "set rate", answer.data, "the rate that was set, two bytes")
        self._rate = float(int.from_bytes(answer.data, "little"))
        if self._rate <= 0:
            raise self._error(BadReply, "set rate", answer.data, "a rate above zero")
        return self._rate

    def settings(self) -> dict[str, str | float | int | bool]:
        """What the device confirmed (the protocol cannot read it back) and what the line has done so far."""
        return {
            "rate": 0.0 if self._rate is None else self._rate,
            "streaming": self._record is not None,
            "bad_frames": self._parser.bad,
            "baud": self._settings.baud,
        }

    def self_test(self) -> None:
        """Let the device test itself. Raises SettingRefused while streaming or if the test failed."""
        self._command(SELF_TEST)

    def start(self) -> None:
        """Begin a new record, at the rate of `configure` (called if it was not)."""
        rate = self._rate or self.configure()
        self._waiting.clear()
        self._record = record = _Record(rate, self._room.clock.now())
        self._command(START)
        record.begun = record.last_good = self._room.clock.now()
        record.bad_before = self._parser.bad

    def read(self, duration: float | None = None, *, frames: int | None = None) -> CubeSamples:
        """The next stretch of the record: `duration` (s by the device's rate) or `frames` sampling instants.

        Lost samples are part of the stretch and absent from it: `gaps` counts them. Raises AcquisitionFailed when the
        stream ends early or the device begins anew (what came before is kept: `received` gives it), Disconnected.
        """
        record = self._running()
        if (duration is None) == (frames is None):
            raise self._error(SettingRefused, None, None, "either a duration or a number of frames")
        count = frames if frames is not None else math.ceil((duration or 0.0) * record.rate - 1e-9)
        end = record.next_sequence + count
        while not record.rows or record.rows[-1][0] + 1 < end:
            missing = end - record.sequence.value + ON_THE_WAY
            self._room.clock.sleep(min(record.pause(), missing / record.rate))
            self._catch_up(record)
        return self._cut(record, end)

    def received(self) -> CubeSamples:
        """What has arrived of the record and was not read yet, without waiting."""
        record = self._running()
        return self._cut(record, record.rows[-1][0] + 1 if record.rows else record.next_sequence)

    def stop(self) -> None:
        """End the record; frames that were not read are thrown away."""
        self._command(STOP)
        self._record = None
        self._waiting.clear()

    def close(self) -> None:
        """Close the line; a device that streams is left to itself."""
        self._link.close()

    def _running(self) -> _Record:
        if self._record is None:
            raise self._error(SettingRefused, None, None, "a started record")
        return self._record

    def _catch_up(self, record: _Record) -> None:
        """Take in everything that was sent up to now, waiting a little for what must be on its way."""
        now = self._room.clock.now()
        patience = LUMP_WAIT if now - record.last_good < STALLED / 4 else 0.0
        wait_until = time.monotonic() + patience
        before = len(record.rows)
        while True:
            left = wait_until - time.monotonic()
            self._add(record, self._take(max(left, 0.0)))
            if record.sequence.value >= record.due(now) or left <= 0:
                break
        if len(record.rows) > before:
            record.stamp(now)
        elif now - record.last_good > STALLED:
            self._stalled(record, now)

    def _stalled(self, record: _Record, now: float) -> None:
        """One last look in real time, then the record has ended early."""
        lump = self._take(self._settings.timeout)
        if not lump:
            silence = f"frames, silent for {now - record.last_good:.1f} s after {record.sequence.value + 1} samples"
            raise self._error(AcquisitionFailed, "start", None, silence)
        self._add(record, lump)
        record.stamp(now)

    def _add(self, record: _Record, lump: Sequence[Sample]) -> None:
        try:
            record.add(lump)
        except ValueError as error:
            wanted = "an uninterrupted stream; the device began anew"
            raise self._error(AcquisitionFailed, "start", str(error), wanted) from error

    def _take(self, timeout: float) -> list[Sample]:
        """Samples that have arrived, the waiting ones first; stray answers are dropped."""
        frames = self._parser.feed(self._link.read_available(timeout))
        waiting, self._waiting = self._waiting, []
        return waiting + [frame for frame in frames if isinstance(frame, Sample)]

    def _cut(self, record: _Record, end: int) -> CubeSamples:
        """Hand out everything before sequence number `end`."""
        taken = [row for row in record.rows if row[0] < end]
        record.rows = record.rows[len(taken) :]
        begin, record.next_sequence = record.next_sequence, end
        bad, record.bad_before = self._parser.bad - record.bad_before, self._parser.bad
        columns = np.array([row[2].counts for row in taken], np.uint16).reshape(-1, VALUES)
        device, arrival = np.array(record.arrivals, float).reshape(-1, 2).T
        return CubeSamples(
            names=self._settings.channels,
            counts=columns,
            sequence=np.array([row[0] for row in taken], np.int64),
            device_us=np.array([row[1] for row in taken], np.int64),
            flags=np.array([row[2].flags for row in taken], np.uint16),
            supply=np.array([row[2].supply for row in taken], np.uint16),
            temperature=np.array([row[2].temperature for row in taken], np.uint16),
            gaps=end - begin - len(taken),
            bad_frames=bad,
            rate=record.rate,
            start=record.first_arrival,
            clock=clock_of(device, arrival, resolution=1.0 / record.rate / math.sqrt(12.0)),
        )

    def _command(self, kind: int, data: bytes = b"") -> Answer:
        """Send until it is answered. Raises NoAnswer after all attempts, SettingRefused with the device's reason."""
        sent = b""
        for _ in range(self._settings.attempts):
            token = next(self._tokens)
            sent = command(kind, token, data)
            with self._link.lock:
                self._link.write(sent)
                answer = self._answer_to(kind, token)
            if answer is not None:
                return self._accepted(answer, sent)
        silence = f"an answer within {self._settings.timeout:g} s, {self._settings.attempts} times"
        raise self._error(NoAnswer, sent, None, silence)

    def _answer_to(self, kind: int, token: int) -> Answer | None:
        """The answer with this token, or None in time; samples that come before it are kept in order."""
        deadline = time.monotonic() + self._settings.timeout
        found: Answer | None = None
        while found is None and (left := deadline - time.monotonic()) > 0:
            for frame in self._parser.feed(self._link.read_available(left)):
                if isinstance(frame, Sample):
                    self._waiting.append(frame)
                elif (frame.command, frame.token) == (kind, token):
                    found = frame
        return found

    def _accepted(self, answer: Answer, sent: bytes) -> Answer:
        if answer.status:
            reason = STATUS[answer.status] if answer.status < len(STATUS) else "an unknown status"
            received = f"status {answer.status}, {reason}"
            raise self._error(SettingRefused, sent, received, "status 0, done")
        return answer

    def _error(
        self, kind: type[InstrumentError], sent: bytes | str | None, received: bytes | str | None, wanted: str
    ) -> InstrumentError:
        return kind(self._link.instrument, self._link.address, sent=sent, received=received, wanted=wanted)


def connect(name: str, settings: Settings, room: Room) -> SensorCube:
    """Open the line; nothing is sent. Raises Disconnected."""
    link = SerialLink.open(name, settings.address, baud=settings.baud, timeout=settings.timeout, room=room)
    return SensorCube(link, settings, room)
