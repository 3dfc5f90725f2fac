"""The DAQ service: one board of this machine, served over TCP to the laptop that controls it (`rig daq serve`).

The protocol is on the page "On the wire". One thread, one event loop: lines on the control port, frames on the data
port, and the board's own descriptor, read whenever it has something. Acquisition is never held up: frames wait in a
bounded queue, and a client that lets it fill ends its run with a flag. There is no authentication: listen on loopback
(the default) or on a private interface only.

The first control connection that changes something owns the board until it closes; others may ask, and take data
connections to watch.

Choices where the page is silent: `CONF:CHAN` keeps the conversion period, so that it can never be out of range; a run
whose owner's data connection closes is stopped; after `ABOR` what the board had ready is still sent; what comes beyond
`CONNECTIONS` of a kind is closed at once.
"""

from __future__ import annotations

import asyncio
import errno
import json
import logging
import re
import select
import signal
import socket
import struct
import time
import zlib
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from rig.errors import InstrumentError

MAKER, VERSION = "Measurement Computing", "rig-daq 1"
METADATA, SAMPLES, HEARTBEAT = 0, 1, 2
OVERFLOW, LAST, CLIPPED, ABORTED, SLOW, FAILED = 1, 2, 4, 8, 16, 32
FASTEST_NS = 10_000
DEFAULT_NS = 20_000
"""Conversion period until one is set: 16 channels at 3125 Hz."""

QUEUE = 32 << 20
"""Bytes that may wait for the client: five minutes at 100 kB/s."""

WATCHED = 4 << 20
"""Bytes that may wait for one who only watches, before it is hung up on."""

CONNECTIONS = 16
LONGEST_LINE = 1024
WHOLE, NUMBER = re.compile(r"[+-]?[0-9]{1,12}"), re.compile(r"[+-]?[0-9]{1,12}(\.[0-9]{0,12})?([eE][+-]?[0-9]{1,2})?")
HEARTBEAT_EVERY = 1.0  # s
KEEPALIVE = 10  # s after which a silent client is probed

CHANGING = frozenset({"CONF:CHAN", "CONF:RANG", "CONF:RATE", "INIT", "ABOR"})
"""What only the owner may say."""

LOG = logging.getLogger(__name__)


class Board(Protocol):
    """What the service needs of a board in this machine. Methods raise InstrumentError with the reason."""

    name: str
    driver: str
    serial: str
    clock: int

    def range(self, gain: int) -> tuple[float, float]:
        """Ends of a range, V."""
        ...

    def set_up(self, first: int, last: int, gain: int, scan_ns: int) -> int:
        """Prepare; returns the conversion period that the board really gives, ns."""
        ...

    def start(self, scans: int) -> None:
        """0 scans means until `cancel`."""
        ...

    def fileno(self) -> int:
        """A descriptor that is readable when there are codes or the run has ended."""
        ...

    def read(self) -> bytes:
        """Codes that are there; empty at the end; OSError with EPIPE after an overflow of the board's buffer."""
        ...

    def cancel(self) -> None: ...
    def close(self) -> None: ...


class RefusalError(Exception):
    """A command that is answered by ERR."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f'{code},"{text}"')


@dataclass(frozen=True)
class Setup:
    """What the board was last asked for and gave."""

    first: int = 0
    last: int = 15
    gain: int = 0
    convert_ns: int = DEFAULT_NS

    @property
    def width(self) -> int:
        """Channels per scan."""
        return self.last - self.first + 1

    def __str__(self) -> str:
        return f"{self.first},{self.last},{self.gain},{self.convert_ns}"


class Service:
    """The board, its settings, and the run under way."""

    def __init__(
        self, board: Board, *, queue: int = QUEUE, monotonic_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        self.data_port = 0
        self._board, self._queue, self._monotonic_ns = board, queue, monotonic_ns
        self._setup = Setup()
        self._run = self._sent = 0
        self._state = "IDLE"
        self._odd = b""
        self._owner: Control | None = None
        self._connections: list[Data] = []
        self._data: Data | None = None  # of the run's owner
        self._errors: deque[str] = deque(maxlen=30)
        self._commands: Mapping[str, Callable[[str], str]] = {
            "*IDN?": lambda _: f"{MAKER},{board.name.upper()},{board.serial},{VERSION} ({board.driver})",
            "CONF:CHAN": self._set_channels,
            "CONF:RANG": self._set_gain,
            "CONF:RATE": self._set_rate,
            "CONF?": lambda _: str(self._setup),
            "DATA?": lambda _: str(self.data_port),
            "INIT": self._init,
            "ABOR": self._abort,
            "STAT?": lambda _: f"{self._state},{self._sent}",
            "SYST:ERR?": lambda _: self._errors.popleft() if self._errors else '0,"No error"',
        }

    def answer(self, line: str, asker: Control) -> str:
        """The answer to one line, both without line feed."""
        word, _, parameter = line.strip().partition(" ")
        try:
            command = self._commands.get(word.upper())
            if command is None:
                raise RefusalError(-100, f"Unknown command {word[:40]}")
            if word.upper() in CHANGING:
                self._own(asker)
            return f"OK {command(parameter.strip())}".rstrip()
        except RefusalError as refused:
            self._errors.append(str(refused))
            return f"ERR {refused}"

    def came(self, connection: Data) -> None:
        """A data connection was made; while a run is under way it may watch, and is told what it sees."""
        if len(self._connections) >= CONNECTIONS:
            connection.end()
            return
        self._connections.append(connection)
        if self._state == "RUNNING":
            connection.send(self._frame(METADATA, json.dumps(self._metadata()).encode(), 0))

    def went(self, connection: Data) -> None:
        """A data connection is gone, and with that of the owner the run."""
        if connection in self._connections:
            self._connections.remove(connection)
        if connection is self._data:
            self._data = None
            if self._state == "RUNNING":
                LOG.warning("run %d: the client is gone", self._run)
                self._finish("IDLE", None)

    def gone(self, asker: Control) -> None:
        """A control connection is gone; if it owned the board, the board is free."""
        if asker is self._owner:
            self._owner = None

    def _own(self, asker: Control) -> None:
        """Only the owner changes anything; whoever is first is the owner."""
        if self._owner is None or self._owner.hung_up:
            self._owner = asker
        if asker is not self._owner:
            raise RefusalError(-203, f"Command protected: the board is owned by {self._owner.peer[0]}")

    def _its_data(self, port: int | None) -> Data | None:
        """The owner's data connection: that from this port of its host, else the newest from there."""
        assert self._owner is not None
        host = self._owner.peer[0]
        mine = [one for one in self._connections if one.peer[0] == host and port in (None, one.peer[1])]
        return mine[-1] if mine else None

    def _send(self, frame: bytes) -> None:
        """To the owner, and to all that watch and read what they get."""
        for one in tuple(self._connections):
            if one is self._data or one.waiting <= WATCHED:
                one.send(frame)
            else:
                LOG.warning("one that watches does not read")
                one.cut()

    def heartbeat(self) -> bytes:
        """A frame that says only that the service is alive."""
        return self._frame(HEARTBEAT, b"", 0)

    def close(self) -> None:
        """Stop what runs."""
        if self._state == "RUNNING":
            self._finish("IDLE", ABORTED)

    def _set_channels(self, parameter: str) -> str:
        first, last = self._integers(parameter, 2)
        if not 0 <= first <= last <= 15:
            raise RefusalError(-222, "Out of range: wanted 0 <= first <= last <= 15")
        self._set_up(first, last, self._setup.gain, self._setup.convert_ns * (last - first + 1))
        return ""

    def _set_gain(self, parameter: str) -> str:
        (gain,) = self._integers(parameter, 1)
        try:
            low, high = self._board.range(gain)
        except InstrumentError as error:
            raise RefusalError(-222, f"Out of range: {error.wanted}") from error
        one = self._setup
        self._set_up(one.first, one.last, gain, one.convert_ns * one.width)
        return f"{low:g},{high:g}"

    def _set_rate(self, parameter: str) -> str:
        self._refuse_while_running()
        if not parameter:
            raise RefusalError(-109, "Missing parameter")
        if not NUMBER.fullmatch(parameter):
            raise RefusalError(-222, "Out of range: wanted scans per second")
        rate = float(parameter)
        one = self._setup
        if not 1e-3 <= rate * one.width <= 1e9 / FASTEST_NS:
            raise RefusalError(-222, f"Out of range: wanted at most {1e9 / FASTEST_NS:g} conversions per second")
        self._set_up(one.first, one.last, one.gain, round(1e9 / rate))
        return str(self._setup.convert_ns)

    def _set_up(self, first: int, last: int, gain: int, scan_ns: int) -> None:
        try:
            convert_ns = self._board.set_up(first, last, gain, scan_ns)
        except InstrumentError as error:
            raise RefusalError(-222, f"Out of range: {error.wanted}") from error
        self._setup = Setup(first, last, gain, convert_ns)

    def _init(self, parameter: str) -> str:
        scans, *port = self._integers(parameter, 1, 2)
        if not 0 <= scans < 1 << 32:
            raise RefusalError(-222, "Out of range: wanted 0 or more scans")
        self._data = self._its_data(port[0] if port else None)
        if self._data is None:
            raise RefusalError(-241, "No data connection")
        one = self._setup
        self._set_up(one.first, one.last, one.gain, one.convert_ns * one.width)
        try:
            self._board.start(scans)
        except InstrumentError as error:
            raise RefusalError(-240, f"Board failure: {error}") from error
        self._run, self._sent, self._odd, self._state = self._run + 1, 0, b"", "RUNNING"
        self._send(self._frame(METADATA, json.dumps(self._metadata()).encode(), 0))
        asyncio.get_running_loop().add_reader(self._board.fileno(), self._readable)
        return str(self._run)

    def _abort(self, parameter: str) -> str:
        if self._state == "RUNNING":
            self._readable(waiting=True)
        if self._state == "RUNNING":
            self._finish("IDLE", ABORTED)
        return ""

    def _readable(self, waiting: bool = False) -> None:
        """The board has something; with `waiting`, only if it really has (its descriptor may block)."""
        if waiting and not _is_readable(self._board.fileno()):
            return
        try:
            data = self._board.read()
        except BlockingIOError:
            return
        except OSError as error:
            LOG.error("run %d: %s", self._run, error)
            if error.errno == errno.EPIPE:
                self._finish("OVERFLOW", OVERFLOW)
            else:
                self._finish("FAILED", FAILED)
            return
        if data:
            self._send_codes(data)
        else:
            self._finish("DONE", 0)

    def _send_codes(self, data: bytes) -> None:
        assert self._data is not None
        data = self._odd + data
        whole = len(data) // 2 * 2
        payload, self._odd = data[:whole], data[whole:]
        if not payload:
            return
        if self._data.waiting + len(payload) > self._queue:
            LOG.error("run %d: the client does not read", self._run)
            self._finish("SLOW", SLOW)
            return
        codes = np.frombuffer(payload, np.uint16)
        clipped = bool(codes.min() == 0 or codes.max() == 65535)
        self._send(self._frame(SAMPLES, codes.astype("<u2", copy=False).tobytes(), CLIPPED * clipped))
        self._sent += len(codes)

    def _finish(self, state: str, flags: int | None) -> None:
        """The run is over; `flags` besides LAST of the last frame, None if nobody is there to get one."""
        asyncio.get_running_loop().remove_reader(self._board.fileno())
        self._state = state
        if flags is not None:
            self._send(self._frame(SAMPLES, b"", LAST | flags))
        try:
            self._board.cancel()
        except InstrumentError as error:
            LOG.error("run %d: %s", self._run, error)
            self._errors.append(f'-240,"Board failure: {error}"')

    def _metadata(self) -> dict[str, Any]:
        one, board = self._setup, self._board
        return {
            "board": board.name,
            "serial": board.serial,
            "range": list(board.range(one.gain)),
            "gain": one.gain,
            "first": one.first,
            "last": one.last,
            "convert_ns": one.convert_ns,
            "clock": board.clock,
            "driver": board.driver,
        }

    def _frame(self, kind: int, payload: bytes, flags: int) -> bytes:
        index = 0 if kind == METADATA else self._sent
        head = struct.pack(
            "<4sHHIQQIHHI",
            b"RDAQ",
            1,
            kind,
            self._run,
            index,
            self._monotonic_ns(),
            self._setup.convert_ns,
            self._setup.width,
            flags,
            len(payload),
        )
        crc = zlib.crc32(payload, zlib.crc32(head + bytes(4)))
        return b"".join((head, struct.pack("<I", crc), payload))

    def _integers(self, parameter: str, count: int, most: int | None = None) -> list[int]:
        self._refuse_while_running()
        parts = [part.strip() for part in parameter.split(",")] if parameter else []
        if len(parts) < count:
            raise RefusalError(-109, "Missing parameter")
        if len(parts) > (most or count) or not all(map(WHOLE.fullmatch, parts)):
            raise RefusalError(-222, f"Out of range: wanted {count} whole numbers")
        return [int(part) for part in parts]

    def _refuse_while_running(self) -> None:
        if self._state == "RUNNING":
            raise RefusalError(-200, "Refused while running")


class Control(asyncio.Protocol):
    """One client's lines. One that does not read its answers is not heard until it does."""

    def __init__(self, service: Service) -> None:
        self._service, self._heard = service, b""
        self._transport: asyncio.Transport | None = None
        self.peer: tuple[str, int] = ("", 0)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.peer = _peer(transport)
        _keep_alive(transport)

    @property
    def hung_up(self) -> bool:
        """Whether the other end has closed, even if our loop has not come to see it."""
        if self._transport is None:
            return True
        watch = select.poll()
        watch.register(self._transport.get_extra_info("socket").fileno(), select.POLLRDHUP)
        return bool(watch.poll(0))

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        self._service.gone(self)

    def pause_writing(self) -> None:
        assert self._transport is not None
        self._transport.pause_reading()

    def resume_writing(self) -> None:
        assert self._transport is not None
        self._transport.resume_reading()

    def data_received(self, data: bytes) -> None:
        assert self._transport is not None
        *lines, self._heard = (self._heard + data).split(b"\n")
        for line in lines:
            answer = self._service.answer(line.decode("latin-1"), self)
            self._transport.write(answer.encode("ascii", "replace") + b"\n")
        if len(self._heard) > LONGEST_LINE:
            self._transport.close()


class Data(asyncio.Protocol):
    """The connection that carries frames, and a heartbeat in every second in which nothing else went."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._transport: asyncio.Transport | None = None
        self._beat: asyncio.TimerHandle | None = None
        self._quiet, self._ended = True, False
        self.peer: tuple[str, int] = ("", 0)

    @property
    def waiting(self) -> int:
        """Bytes that the client has not taken."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.peer = _peer(transport)
        _keep_alive(transport)
        self._beat = asyncio.get_running_loop().call_later(HEARTBEAT_EVERY, self._heartbeat)
        self._service.came(self)
        self.send(self._service.heartbeat())  # says that frames can flow

    def connection_lost(self, exc: Exception | None) -> None:
        self._transport = None
        if self._beat is not None:
            self._beat.cancel()
        self._service.went(self)

    def send(self, frame: bytes) -> None:
        """Queue a frame; never waits."""
        if self._transport is not None and not self._ended:
            self._transport.write(frame)
            self._quiet = False

    def end(self) -> None:
        """Hang up once everything is out."""
        self._ended = True
        if self._transport is not None:
            self._transport.close()

    def cut(self) -> None:
        """Hang up at once; what waits is thrown away."""
        self._ended = True
        if self._transport is not None:
            self._transport.abort()

    def _heartbeat(self) -> None:
        if self._quiet and not self.waiting:
            self.send(self._service.heartbeat())
        self._quiet = True
        self._beat = asyncio.get_running_loop().call_later(HEARTBEAT_EVERY, self._heartbeat)


def _peer(transport: asyncio.Transport) -> tuple[str, int]:
    """Host and port of the other end."""
    host, port = transport.get_extra_info("peername")[:2]
    return str(host), int(port)


def _keep_alive(transport: asyncio.Transport) -> None:
    """A client that vanished without a word (a pulled cable) must not keep the board for ever."""
    raw = transport.get_extra_info("socket")
    raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, KEEPALIVE)
    raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, KEEPALIVE)
    raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)


def _is_readable(descriptor: int) -> bool:
    return bool(select.select([descriptor], [], [], 0)[0])


async def listen(service: Service, host: str, port: int, data_port: int = 0) -> tuple[asyncio.Server, asyncio.Server]:
    """Open the control port and the data port (0: free ones). Raises OSError if one cannot be had."""
    loop = asyncio.get_running_loop()
    data = await loop.create_server(lambda: Data(service), host, data_port)
    try:
        control = await loop.create_server(lambda: Control(service), host, port)
    except OSError:
        data.close()
        raise
    service.data_port = int(data.sockets[0].getsockname()[1])
    return control, data


def serve(
    board: Board,
    host: str = "127.0.0.1",
    port: int = 30431,
    *,
    data_port: int = 0,
    queue: int = QUEUE,
    monotonic_ns: Callable[[], int] = time.monotonic_ns,
    announce: Callable[[str, int], None] | None = None,
) -> None:
    """Serve the board until SIGINT or SIGTERM; the board is closed at the end.

    `queue` bytes may wait for a client. `announce(host, port)` is called when all is ready, with the control port that
    was really opened. Raises OSError if a port cannot be had.
    """

    async def until_told() -> None:
        over = asyncio.Event()
        service = Service(board, queue=queue, monotonic_ns=monotonic_ns)
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, over.set)
        servers = await listen(service, host, port, data_port)
        if announce is not None:
            announce(host, int(servers[0].sockets[0].getsockname()[1]))
        await over.wait()
        service.close()
        for server in servers:
            server.close()

    try:
        asyncio.run(until_told())
    finally:
        board.close()
