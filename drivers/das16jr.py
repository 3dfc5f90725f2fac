"""PC104-DAS16JR/16 over the network: client of the DAQ service that runs beside the board.

The protocol is on the page "On the wire". Two halves: pure functions from bytes to values (`parse_header`,
`FrameParser`, `parse_answer`), and the driver, which commands the service over one connection and takes frames from
the other.

The board converts one channel after another, evenly spread through the scan (no burst mode on the PC/104 board), so
each channel has its own sample instants; they follow from the conversion period that is read back. Codes stay raw.

When a record ends early (a lost conversion, an overflow, an implausible pacer clock, a gap, a broken connection) `read`
raises at once, and `received` still gives the good scans that were not read yet.
"""

from __future__ import annotations

import contextlib
import json
import math
import select
import socket
import struct
import threading
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from drivers import scans as scanning
from drivers.scans import Record, Tag
from rig.errors import (
    AcquisitionFailed,
    BadReply,
    Disconnected,
    InstrumentError,
    NoAnswer,
    SettingRefused,
    WrongIdentity,
)
from rig.record import Channel, Identity, Samples, Timing
from rig.room import Room
from rig.units import Ratio, Time, Voltage

MODEL = "PC104-DAS16JR/16"
MAGIC, VERSION = b"RDAQ", 1
METADATA, SAMPLES, HEARTBEAT = 0, 1, 2
OVERFLOW, LAST, CLIPPED, ABORTED, SLOW, FAILED = 1, 2, 4, 8, 16, 32
HEADER = struct.Struct("<4sHHIQQIHHII")
LONGEST_PAYLOAD = 1 << 24
"""A frame that claims to carry more than this (bytes) is nonsense, not data."""

LONGEST_LINE = 4096
CHUNK = 1 << 20
"""Bytes taken from the data connection at once."""

MESSAGES: tuple[str, ...] = (
    "*IDN?",
    "CONF:CHAN 0,15",
    "CONF:RANG 0",
    "CONF:RATE 3125",
    "CONF?",
    "DATA?",
    "INIT 3126",
    "STAT?",
    "ABOR",
    "SYST:ERR?",
)


FAILURES: Mapping[str, type[InstrumentError]] = MappingProxyType(
    {"disconnected": Disconnected, "corrupt": BadReply, "silent": NoAnswer}
)
"""How a record ended, where that is not AcquisitionFailed."""


class FrameError(ValueError):
    """Bytes that are no frame of the DAQ service; the text says what was wanted."""


@dataclass(frozen=True)
class Frame:
    """One frame: its kind and run, the index of its first conversion, when it was taken (service's clock, ns)."""

    kind: int
    run: int
    index: int
    taken_ns: int
    convert_ns: int
    channels: int
    flags: int
    payload: bytes

    @property
    def codes(self) -> NDArray[np.uint16]:
        """The payload of a samples frame, uint16 offset binary, shape (conversions,)."""
        return np.frombuffer(self.payload, "<u2").astype(np.uint16, copy=False)


def parse_header(header: bytes) -> tuple[Frame, int, int]:
    """A frame without its payload, the payload's length, and the CRC that was sent. Raises FrameError."""
    magic, version, kind, run, index, taken, convert, channels, flags, length, crc = HEADER.unpack(header)
    if magic != MAGIC or version != VERSION:
        raise FrameError(f"a frame that begins with {MAGIC.decode()} and version {VERSION}")
    if kind not in (METADATA, SAMPLES, HEARTBEAT) or length > LONGEST_PAYLOAD or (kind == SAMPLES and length % 2):
        raise FrameError("a frame of a known kind with whole conversions, 16 MiB at most")
    return Frame(kind, run, index, taken, convert, channels, flags, b""), length, crc


class FrameParser:
    """Bytes in pieces of any size in, whole frames out. `damage` says why the stream cannot be trusted any more."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.damage = ""

    def feed(self, data: bytes) -> list[Frame]:
        """All frames that are complete now; none after damage."""
        frames: list[Frame] = []
        if self.damage:
            return frames
        self._buffer += data
        at = 0
        try:
            while (end := self._end_of(at)) is not None:
                frames.append(parse_frame(bytes(memoryview(self._buffer)[at:end])))
                at = end
        except FrameError as error:
            self.damage = str(error)
        del self._buffer[:at]
        return frames

    def _end_of(self, at: int) -> int | None:
        if len(self._buffer) - at < HEADER.size:
            return None
        _, length, _ = parse_header(bytes(self._buffer[at : at + HEADER.size]))
        end = at + HEADER.size + length
        return end if end <= len(self._buffer) else None


def parse_frame(data: bytes) -> Frame:
    """Exactly one frame. Raises FrameError."""
    frame, length, sent = parse_header(data[: HEADER.size])
    payload = data[HEADER.size :]
    # The CRC covers the header with its own field (the last four bytes) zero, then the payload.
    found = zlib.crc32(payload, zlib.crc32(data[: HEADER.size - 4] + bytes(4)))
    if len(payload) != length or found != sent:
        raise FrameError(f"a frame with CRC-32 {sent:08x}, found {found:08x}")
    return replace(frame, payload=payload)


def parse_answer(line: bytes) -> tuple[bool, str]:
    """An answer of the control connection without its line feed: whether it is `OK`, and what follows.

    Raises ValueError, saying what was wanted, if it is no answer.
    """
    try:
        text = line.decode("ascii").strip()
    except UnicodeDecodeError as error:
        raise ValueError("OK or ERR in ASCII") from error
    word, _, rest = text.partition(" ")
    if word not in ("OK", "ERR"):
        raise ValueError("OK or ERR")
    return word == "OK", rest.strip()


def _integers(text: str, count: int) -> list[int]:
    """Comma-separated integers. Raises ValueError saying what was wanted."""
    parts = text.split(",")
    if len(parts) != count or not all(part.strip().lstrip("-").isdecimal() for part in parts):
        raise ValueError(f"{count} integer{'s' if count > 1 else ''}")
    return [int(part) for part in parts]


class Settings(BaseModel):
    """`tag` names the channel with the reference voltage, which every scan must show."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    address: str = Field(
        pattern=r".+:\d{1,5}$|^.+:\$\{\w+\}$", description="host:port of the DAQ service's control connection"
    )
    tag: str = Field(default="tag", description="name of the channel that carries the tag voltage")
    tag_voltage: Voltage = Field(default=2.5, description="what the tag channel must read")
    tag_tolerance: Voltage = Field(default=0.05, gt=0)
    tag_step: Voltage = Field(default=0.01, gt=0, description="largest change of the tag from one scan to the next")
    clock_tolerance: Ratio = Field(default=0.02, gt=0, lt=1, description="pacer against the service's clock")
    timeout: Time = Field(default=2.0, gt=0, description="real time of silence before an answer or data are missing")

    @property
    def host(self) -> str:
        return self.address.rpartition(":")[0].strip("[]")

    @property
    def port(self) -> int:
        return int(self.address.rpartition(":")[2])


class Control:
    """The text connection: one line out, one line in, one lock over both. Opened when first needed."""

    def __init__(self, instrument: str, settings: Settings, room: Room) -> None:
        self.instrument, self.address = instrument, settings.address
        self._settings, self._room = settings, room
        self._socket: socket.socket | None = None
        self._heard = b""
        self._lock = threading.RLock()

    def open(self) -> None:
        """Raises Disconnected."""
        with self._lock:
            if self._socket is None:
                self._socket = self.dial(self._settings.port)
                self._heard = b""

    def dial(self, port: int) -> socket.socket:
        """A new connection to a port of the service. Raises Disconnected."""
        try:
            made = socket.create_connection((self._settings.host, port), self._settings.timeout)
        except OSError as error:
            raise Disconnected(
                self.instrument, self.address, wanted=f"a DAQ service at port {port} ({error})"
            ) from error
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return made

    def query(self, line: str) -> str:
        """What follows `OK`.

        Raises SettingRefused with the service's reason, BadReply, NoAnswer, Disconnected. After the last three the
        connection is dropped, so that a late answer is never taken for another's; the next query opens it anew.
        """
        with self._lock:
            self.open()
            self._room.transcript.note(self.instrument, "sent", line.encode() + b"\n")
            answer = self._exchange(line)
            self._room.transcript.note(self.instrument, "received", answer + b"\n")
            try:
                accepted, rest = parse_answer(answer)
            except ValueError as error:
                self.close()
                raise self.error(BadReply, line, answer, str(error)) from error
        if not accepted:
            raise self.error(SettingRefused, line, answer, "OK")
        return rest

    def integers(self, line: str, count: int) -> list[int]:
        """A query that is answered by integers."""
        rest = self.query(line)
        try:
            return _integers(rest, count)
        except ValueError as error:
            raise self.error(BadReply, line, rest, str(error)) from error

    def close(self) -> None:
        with self._lock:
            if self._socket is not None:
                self._socket.close()
                self._socket = None

    def error(
        self, kind: type[InstrumentError], sent: str | None, received: bytes | str | None, wanted: str
    ) -> InstrumentError:
        return kind(self.instrument, self.address, sent=sent, received=received, wanted=wanted)

    def _exchange(self, line: str) -> bytes:
        assert self._socket is not None
        try:
            self._socket.settimeout(self._settings.timeout)
            self._socket.sendall(line.encode() + b"\n")
            return self._line(self._socket, line)
        except TimeoutError as error:
            self.close()
            wanted = f"a line within {self._settings.timeout:g} s"
            raise self.error(NoAnswer, line, self._heard or None, wanted) from error
        except OSError as error:
            self.close()
            raise self.error(Disconnected, line, None, f"the connection to last ({error})") from error

    def _line(self, raw: socket.socket, sent: str) -> bytes:
        deadline = time.monotonic() + self._settings.timeout
        while b"\n" not in self._heard:
            raw.settimeout(max(deadline - time.monotonic(), 1e-3))
            data = raw.recv(LONGEST_LINE)
            self._heard += data
            if not data or len(self._heard) > LONGEST_LINE:
                self.close()
                kind, wanted = (BadReply, "one line") if data else (Disconnected, "the connection to last")
                raise self.error(kind, sent, self._heard or None, wanted)
        line, _, self._heard = self._heard.partition(b"\n")
        return line.rstrip(b"\r")


class Das16jr:
    """The converter as a recorder, through its service."""

    def __init__(self, control: Control, settings: Settings, room: Room) -> None:
        self._control, self._settings, self._room = control, settings, room
        self._data: socket.socket | None = None
        self._parser = FrameParser()
        self._channels: tuple[Channel, ...] = ()
        self._timing: Timing | None = None
        self._record: Record | None = None
        self._run = 0
        self.metadata: dict[str, Any] = {}
        """What the service said of the board when the run began."""
        self._over = True  # whether the run's last frame has come
        self._stopping = self._orphaned = False

    def identify(self) -> Identity:
        """Who answers. Raises WrongIdentity if it is no PC104-DAS16JR/16, NoAnswer, Disconnected."""
        parts = self._control.query("*IDN?").split(",")
        if len(parts) != 4 or parts[1] != MODEL:
            raise self._control.error(WrongIdentity, "*IDN?", ",".join(parts), f"maker,{MODEL},serial,version")
        return Identity(*parts)

    def configure(self, *, rate: float, channels: Sequence[str], gain: int = 0) -> Timing:
        """Channels 0…n−1 by name, scans per second (Hz), gain code 0 (±10 V) to 7; returns what the board really does.

        Raises SettingRefused: before anything is sent if the tag is missing or the rate is out of range, and if the
        read-back is not what was asked for.
        """
        wrong = scanning.refusal(rate, channels, self._settings.tag)
        if wrong or gain not in range(8):
            raise self._control.error(SettingRefused, None, None, wrong or f"gain code 0…7, found {gain}")
        self.stop()
        last = len(channels) - 1
        self._control.query(f"CONF:CHAN 0,{last}")
        low, high = self._range(gain)
        period = self._control.integers(f"CONF:RATE {rate:.10g}", 1)[0]
        found = self._control.integers("CONF?", 4)
        if found != [0, last, gain, period] or period <= 0:
            wanted = f"0,{last},{gain},{period} as it was set"
            raise self._control.error(SettingRefused, "CONF?", ",".join(map(str, found)), wanted)
        self._channels = tuple(Channel(name, slot, low, high) for slot, name in enumerate(channels))
        self._timing = Timing(period * 1e-9, len(channels))
        return self._timing

    def start(self, scans: int | None) -> None:
        """Begin a record of so many scans, or until `stop`.

        Raises SettingRefused before `configure`, or for a number of scans that is not positive.
        """
        if self._timing is None or (scans is not None and scans < 1):
            wanted = "configure first" if self._timing is None else f"at least one scan, found {scans}"
            raise self._control.error(SettingRefused, None, None, wanted)
        self.stop()
        self._open_data()
        # One scan more than will be handed out: its tag proves that the last one did not slip.
        assert self._data is not None
        ours = self._data.getsockname()[1]  # which of the data connections from this host
        self._run = self._control.integers(f"INIT {0 if scans is None else scans + 1},{ours}", 1)[0]
        self._over, self._stopping, self.metadata = False, False, {}
        self._record = Record(
            self._channels,
            self._timing,
            self._tag(),
            scans=scans,
            start=self._room.clock.now(),
            pacer_tolerance=self._settings.clock_tolerance,
        )

    def read(self, scans: int) -> Samples:
        """The next `scans` scans; fewer, with the flag "last", when the record ends there.

        Lets the bench's time pass as long as the data need, then waits in real time. Raises AcquisitionFailed when the
        record ended early (the flags and the state say how; `received` gives the good scans that are left),
        NoAnswer, BadReply, Disconnected.
        """
        record = self._running()
        if not scanning.await_scans(record, scans, self._room.clock, self._pump, self._settings.timeout):
            self._silent(record)
        self._refuse_failure(record, scans)
        samples = record.take(scans)
        if record.complete:
            self._await_last_frame()
        return samples

    def received(self) -> Samples:
        """The good scans that have arrived and were not read yet, without waiting; also after a failure or `stop`."""
        return self._running().take(self._running().available)

    @property
    def state(self) -> str:
        """`idle`, `running`, `done`, or how the record ended: `stopped`, `slip`, `clock`, `gap`, `overflow`, …"""
        return "idle" if self._record is None else self._record.state

    def stop(self) -> None:
        """End the record, if one is running. What had arrived is still there for `received`."""
        if self._orphaned or not self._over:
            self._stopping = True
            self._control.query("ABOR")
            self._await_last_frame()
            self._orphaned, self._over = False, True
        if self._record is not None:
            self._record.stop()

    def errors(self) -> list[str]:
        """The service's error queue, emptied."""
        found: list[str] = []
        while len(found) < 100:
            text = self._control.query("SYST:ERR?")
            if text.split(",")[0].strip() in ("0", "+0"):
                break
            found.append(text)
        return found

    def settings(self) -> dict[str, str | float | int | bool]:
        """Read back from the service: channels, gain code, conversion period (s); and what the tag must be."""
        first, last, gain, period = self._control.integers("CONF?", 4)
        return {
            "first": first,
            "last": last,
            "gain": gain,
            "convert_period": period * 1e-9,
            "tag_voltage": self._settings.tag_voltage,
        }

    def close(self) -> None:
        """Stop a running record and close both connections; a service that is gone already is no error."""
        with contextlib.suppress(InstrumentError):
            self.stop()
        self._drop_data()
        self._control.close()

    def _range(self, gain: int) -> tuple[float, float]:
        line = f"CONF:RANG {gain}"
        text = self._control.query(line)
        try:
            low, high = (float(part) for part in text.split(","))
        except ValueError as error:
            raise self._control.error(BadReply, line, text, "two voltages") from error
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise self._control.error(BadReply, line, text, "the low and the high end of a range")
        return low, high

    def _tag(self) -> Tag:
        one = self._settings
        column = [channel.name for channel in self._channels].index(one.tag)
        return Tag(column, one.tag_voltage, one.tag_tolerance, one.tag_step)

    def _running(self) -> Record:
        if self._record is None:
            raise self._control.error(SettingRefused, None, None, "a started record")
        return self._record

    def _open_data(self) -> None:
        """Raises Disconnected if there is no data connection to be had."""
        if self._data is not None and self._dead():
            self._drop_data()
        if self._data is not None:
            return
        self._data = self._control.dial(self._control.integers("DATA?", 1)[0])
        self._data.setblocking(False)
        self._parser = FrameParser()
        # The first frame, a heartbeat, says that the service has taken the connection; INIT may then refer to it.
        self._ready(self._settings.timeout)
        if self._dead():
            self._drop_data()
            raise self._control.error(Disconnected, "DATA?", None, "a data connection that is not another client's")

    def _dead(self) -> bool:
        """Whether the data connection was closed, or damaged, since the last record; throws away what waits in it."""
        try:
            while self._ready(0.0):
                self._parser.feed(self._receive())
        except OSError:
            return True
        return bool(self._parser.damage)

    def _drop_data(self) -> None:
        if self._data is not None:
            self._data.close()
            self._data = None

    def _ready(self, timeout: float) -> bool:
        return self._data is not None and bool(select.select([self._data], [], [], timeout)[0])

    def _receive(self) -> bytes:
        """What is there, at least one byte; raises OSError if the other end is gone."""
        data = b"" if self._data is None else self._data.recv(CHUNK)
        if not data:
            raise ConnectionResetError("closed by the other side")
        return data

    def _pump(self, timeout: float) -> bool:
        """Take in what comes within `timeout` s of real time; whether any of it belongs to the run."""
        try:
            if not self._ready(timeout):
                return False
            frames = self._parser.feed(self._receive())
        except OSError as error:
            self._broken("disconnected", f"the end of the data connection ({error})", "the connection to last")
            return True
        ours = [frame for frame in frames if frame.run == self._run and frame.kind != HEARTBEAT]
        for frame in ours:
            self._take_in(frame)
        if self._parser.damage:
            self._broken("corrupt", "a damaged frame", self._parser.damage)
        return bool(ours or self._parser.damage)

    def _broken(self, state: str, found: str, wanted: str) -> None:
        """The data connection is of no use any more; what arrived before stays."""
        self._drop_data()
        self._orphaned, self._over = not self._over, True
        if self._record is not None:
            self._record.fail(state, found, wanted)

    def _take_in(self, frame: Frame) -> None:
        record = self._running()
        if frame.kind == METADATA:
            self._keep_metadata(frame)
            record.begin(frame.taken_ns)
            return
        if frame.index != record.received and record.failure is None:
            missing = f"conversion {frame.index} after {record.received}"
            record.fail("gap", missing, "conversions without a gap")
        if frame.convert_ns != round(record.timing.convert_period * 1e9) or frame.channels != len(record.channels):
            record.fail("changed", f"{frame.channels} channels every {frame.convert_ns} ns", "what was configured")
        record.add(frame.codes, frame.taken_ns)
        self._heed(frame.flags, record)

    def _keep_metadata(self, frame: Frame) -> None:
        self._room.transcript.note(self._control.instrument, "received", frame.payload)
        try:
            metadata = json.loads(frame.payload)
        except ValueError:
            metadata = None
        if isinstance(metadata, dict):
            self.metadata = metadata
        else:
            self._running().fail("corrupt", f"metadata {frame.payload[:40]!r}", "a JSON object")

    def _heed(self, flags: int, record: Record) -> None:
        if flags & OVERFLOW:
            record.fail("overflow", "an overflow of the board's buffer", "a service quick enough for the board")
        if flags & SLOW:
            record.fail("slow", "the service giving up on a client too slow", "data read as they come")
        if flags & FAILED:
            record.fail("failed", "a failure of the board", "a board that converts (the service's log says why)")
        if flags & LAST:
            self._over = record.ended = True
            if not self._stopping and record.short:
                found = "a stop by somebody else" if flags & ABORTED else f"the end after {record.received} conversions"
                record.fail("short", found, f"{record.scans or 'endless'} scans and one for proof")

    def _await_last_frame(self) -> None:
        """Take in frames until the run is over, for `timeout` s of real time at most."""
        deadline = time.monotonic() + self._settings.timeout
        while not self._over and (left := deadline - time.monotonic()) > 0:
            self._pump(left)

    def _silent(self, record: Record) -> None:
        """Nothing came although it should have; ask the service what it is doing."""
        try:
            status = self._control.query("STAT?")
        except InstrumentError as error:
            status = f"no status ({error})"
        found = f"{status}, and no data for {self._settings.timeout:g} s"
        record.fail("silent", found, f"samples after conversion {record.received}")

    def _refuse_failure(self, record: Record, scans: int) -> None:
        """Raises what ended the record, unless `scans` good ones are there all the same."""
        failure = record.failure
        if failure is None or record.has(scans):
            return
        kind = FAILURES.get(failure.state, AcquisitionFailed)
        wanted = f"{failure.wanted} ({record.handed + record.available} good scans, {record.available} not read yet)"
        raise self._control.error(kind, f"INIT (run {self._run})", failure.found, wanted)


def connect(name: str, settings: Settings, room: Room) -> Das16jr:
    """Open the control connection; nothing is sent. Raises Disconnected."""
    control = Control(name, settings, room)
    control.open()
    return Das16jr(control, settings, room)
