"""How bytes reach an instrument: a VISA link (GPIB through a gateway, VXI-11, sockets) and a serial link.

Both keep a transcript, hold one lock over a whole query, and turn every failure into an error of `rig.errors` that
shows what was sent and what came back: silence is NoAnswer, nonsense is BadReply, a closed line is Disconnected.

GPIB instruments stand behind a Prologix GPIB-ETHERNET adapter, named the way pyvisa-py names it: the adapter
`PRLGX-TCPIP0::host::1234::INTFC`, the instrument `GPIB0::19::INSTR`. pyvisa opens both; the exchange then goes over the
socket that pyvisa-py opened, one segment per message, because the released pyvisa-py 0.8.1 (measured)

- loops for ever in the next write once the gateway has closed the connection,
- spins through the whole timeout in a read for the same reason,
- sends `++spoll` together with a stray `++read eoi`, which costs a pending reply or provokes error -420,
- and needs 44 ms per query (Nagle's algorithm against delayed acknowledgement).

The private attributes used for this are `sessions`, `interface`, `gpib_addr`, `plus_plus_read` and the table `boards`;
the version of pyvisa-py is pinned for this file alone.
"""

from __future__ import annotations

import re
import select
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol

from rig.errors import BadReply, Disconnected, InstrumentError, NoAnswer
from rig.room import Room

READ_TIMEOUT_MS = 3000
"""The adapter's own read timeout, its largest (Prologix GPIB-ETHERNET manual 1.6.6.0); a later reply is lost."""

CLEAR_PAUSE = 0.1
"""Time an instrument gets after a device clear, s (inferred: verify on the bench)."""

LARGEST_BLOCK = 1 << 26
"""A block that claims to be longer than this (bytes) is nonsense, not data."""

CHUNK = 1 << 18


class _LineError(Exception):
    """The stream's other end is gone; the text says how that showed."""


class _Stream(Protocol):
    """A two-way stream of bytes. Every method raises _LineError when the other end is gone."""

    whole_messages: bool
    """True if one `receive` gives one complete message, so that its end needs no line feed."""

    def send(self, data: bytes) -> None: ...

    def receive(self, timeout: float) -> bytes:
        """What has arrived, at least one byte; empty after `timeout` seconds of silence."""
        ...

    def drain(self) -> None:
        """Throw away what has arrived unasked, without waiting."""
        ...


class _SocketStream:
    """The TCP socket of a pyvisa-py session."""

    whole_messages = False

    def __init__(self, raw: socket.socket, timeout: float) -> None:
        self._raw = raw
        raw.getpeername()  # pyvisa-py takes a refused connection for an open one; here it is an OSError
        raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        raw.settimeout(timeout)

    def send(self, data: bytes) -> None:
        try:
            self._raw.sendall(data)
        except OSError as error:
            raise _LineError(f"the connection to take the message ({error})") from error

    def receive(self, timeout: float) -> bytes:
        try:
            if not select.select([self._raw], [], [], timeout)[0]:
                return b""
            data = self._raw.recv(CHUNK)
        except (OSError, ValueError) as error:
            raise _LineError(f"the connection to last ({error})") from error
        if not data:
            raise _LineError("the connection to last (closed by the other side)")
        return data

    def drain(self) -> None:
        while self.receive(0.0):
            pass


class _SerialStream:
    """An open pyserial port with a file descriptor: real ports, pseudo-terminals and socket:// alike."""

    whole_messages = False

    def __init__(self, port: Any) -> None:
        self._port = port

    def send(self, data: bytes) -> None:
        import serial

        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as error:
            raise _LineError(f"the line to take the message ({error})") from error

    def receive(self, timeout: float) -> bytes:
        import serial

        try:
            if not select.select([self._port.fileno()], [], [], timeout)[0]:
                return b""
            self._port.timeout = 0  # one read takes all that has arrived, whatever a gateway's library set meanwhile
            return bytes(self._port.read(CHUNK))
        except (serial.SerialException, OSError, ValueError, TypeError) as error:
            raise _LineError(
                f"the line to last ({error})"
            ) from error  # TypeError: pyserial after a close in another thread

    def drain(self) -> None:
        while self.receive(0.0):
            pass


class _MessageStream:
    """Any other VISA resource (VXI-11, a GPIB card, USB): the transport itself marks where a message ends."""

    whole_messages = True

    def __init__(self, resource: Any) -> None:
        self._resource = resource
        # Replies of an exact multiple of the default 20 480 time out in pyvisa-py 0.8.1 (its issue 608).
        resource.chunk_size = 1 << 20

    def send(self, data: bytes) -> None:
        from pyvisa import errors

        try:
            self._resource.write_raw(data)
        except (errors.Error, OSError) as error:
            raise _LineError(f"the transport to take the message ({error})") from error

    def receive(self, timeout: float) -> bytes:
        from pyvisa import constants, errors

        try:
            self._resource.timeout = max(1, round(timeout * 1000))
            return bytes(self._resource.read_raw())
        except errors.VisaIOError as error:
            if error.error_code == constants.StatusCode.error_timeout:
                return b""
            raise _LineError(f"the transport to answer ({error})") from error
        except (errors.Error, OSError) as error:
            raise _LineError(f"the transport to answer ({error})") from error

    def drain(self) -> None:
        return None


class _Opening:
    """Turns whatever a VISA backend raises while it connects into Disconnected.

    A class and not an except clause: pyvisa-py raises bare `Exception` for a connection that cannot be made in time and
    for a VXI-11 link that is refused, so the type alone decides.
    """

    def __init__(self, instrument: str, address: str) -> None:
        self._instrument, self._address = instrument, address

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        from pyvisa import errors

        if type(error) is Exception or isinstance(error, errors.Error | OSError | ValueError | _LineError):
            raise Disconnected(self._instrument, self._address, wanted=f"a connection ({error})") from error


@dataclass(eq=False)
class Gateway:
    """A Prologix adapter, opened once and shared by the instruments behind it; closed with the last of them.

    `board` is pyvisa-py's name for it in this process: the number in the bench file, or the next free one if another
    gateway has that number already.
    """

    address: str
    board: str
    interface: Any
    stream: _Stream
    users: int = 0
    lost: bool = False
    unsettled: set[str] = field(default_factory=set)
    """Bus addresses whose last exchange broke off: a late reply may still come, and would look like another's."""
    lock: threading.RLock = field(default_factory=threading.RLock)

    @classmethod
    def share(cls, manager: Any, address: str, timeout: float) -> Gateway:
        """The open gateway at this address, or a new one; the caller owes it one `release`."""
        from pyvisa import rname

        parsed: Any = rname.parse_resource_name(address)
        key = re.sub(r"^(PRLGX-[A-Z]+)\d*", r"\1", str(parsed))
        # What is open in this process is known to the resource manager; so is the lock that keeps two threads from
        # opening the same adapter twice (dict.setdefault is atomic).
        with vars(manager).setdefault("rig_opening", threading.RLock()):
            for resource in manager.list_opened_resources():
                known = vars(resource).get("rig_gateway")
                if isinstance(known, cls) and known.address == key and known.join():
                    return known
            return cls._open(manager, key, parsed, timeout)

    @classmethod
    def _open(cls, manager: Any, key: str, parsed: Any, timeout: float) -> Gateway:
        board = _free_board(parsed.board)
        name = re.sub(r"^(PRLGX-[A-Z]+)\d*", rf"\g<1>{board}", str(parsed))
        try:
            interface = manager.open_resource(name, open_timeout=round(max(timeout, 1.0) * 1000))
            session = manager.visalib.sessions[interface.session]
            gateway = cls(key, board, interface, _stream_of(session.interface, timeout), users=1)
            # Saving is on after every power-up and wears the adapter's memory at each change of address.
            gateway.stream.send(f"++savecfg 0\n++read_tmo_ms {READ_TIMEOUT_MS}\n".encode())
        except BaseException:
            _forget_board(board)
            raise
        interface.timeout = round(timeout * 1000)
        session.plus_plus_read = False
        vars(interface)["rig_gateway"] = gateway
        return gateway

    def join(self) -> bool:
        """One instrument more; False if the connection is lost, or closed by the last one a moment ago."""
        with self.lock:
            if self.lost or not self.users:
                return False
            self.users += 1
            return True

    def release(self) -> None:
        """One instrument less; the connection is closed with the last one."""
        with self.lock:
            self.users -= 1
            if self.users == 0:
                self.interface.close()


def _free_board(wanted: str) -> str:
    """`wanted`, or the next number that no gateway of this process has."""
    from pyvisa_py.prologix import _PrologixIntfcSession

    number = int(wanted or 0)
    while str(number) in _PrologixIntfcSession.boards:
        number += 1
    return str(number)


def _forget_board(board: str) -> None:
    """Remove a gateway that could not be reached: pyvisa-py leaves it in its table with its socket open."""
    from pyvisa_py.prologix import _PrologixIntfcSession

    dead = _PrologixIntfcSession.boards.pop(board, None)
    if dead is not None and dead.interface is not None:
        dead.interface.close()


def _stream_of(raw: Any, timeout: float) -> _Stream:
    """The stream inside a pyvisa-py session: a socket or a pyserial port."""
    return _SocketStream(raw, timeout) if isinstance(raw, socket.socket) else _SerialStream(raw)


def _escaped(message: bytes) -> bytes:
    """Data for the instrument, safe from the adapter: ESC before CR, LF, ESC and `+` (Prologix manual)."""
    return re.sub(rb"([\r\n\x1b+])", b"\x1b\\1", message)


def block_span(data: bytes | bytearray) -> tuple[int, int] | None:
    """Where the payload of an IEEE 488.2 definite-length block begins and ends in `data`.

    None while the header is still incomplete. Raises ValueError if `data` cannot be the beginning of such a block
    (`#`, one digit d from 1 to 9, d digits of byte count).
    """
    if data[:1] not in (b"", b"#"):
        raise ValueError("a definite-length block, which begins with '#'")
    if len(data) < 2:
        return None
    if data[1:2] not in (b"1", b"2", b"3", b"4", b"5", b"6", b"7", b"8", b"9"):
        raise ValueError("a definite-length block, whose second character is 1…9")
    start = 2 + data[1] - ord("0")
    digits = bytes(data[2:start])
    if digits and not re.fullmatch(rb"[0-9]+", digits):
        raise ValueError("a definite-length block, whose length is all digits")
    if len(digits) < start - 2:
        return None
    if int(digits) > LARGEST_BLOCK:
        raise ValueError(f"a block of at most {LARGEST_BLOCK} bytes")
    return start, start + int(digits)


class VisaLink:
    """Messages to one instrument and its replies, over any VISA resource.

    `timeout` (s) bounds the silence before a reply and between its parts. Behind a Prologix adapter a reply must begin
    within 3 s whatever the timeout says: wait for slow work with `poll`, never with `*OPC?`.
    `lock` is held over a whole exchange, and shared by all instruments of one gateway; hold it yourself around
    several exchanges that belong together.
    """

    def __init__(
        self,
        instrument: str,
        address: str,
        resource: Any,
        stream: _Stream,
        *,
        timeout: float,
        room: Room,
        gateway: Gateway | None = None,
        bus_address: str = "",
    ) -> None:
        self.instrument, self.address, self.timeout = instrument, address, timeout
        self.lock = gateway.lock if gateway else threading.RLock()
        self._resource, self._stream, self._room = resource, stream, room
        self._gateway, self._bus_address = gateway, bus_address
        self._unsettled = False  # without a gateway: the last exchange broke off
        self._open = True

    @classmethod
    def open(
        cls,
        instrument: str,
        resource: str,
        *,
        gateway: str | None = None,
        timeout: float,
        room: Room,
        backend: str = "@py",
    ) -> VisaLink:
        """Open a link; nothing is sent to the instrument itself.

        `resource` is a VISA resource string, `gateway` the adapter's if there is one, `backend` the VISA library as
        pyvisa names it. Raises Disconnected if it cannot be opened.
        """
        import pyvisa

        with _Opening(instrument, resource if gateway is None else f"{resource} through {gateway}"):
            manager = pyvisa.ResourceManager(backend)
            if gateway is not None:
                return cls._behind(
                    instrument, resource, Gateway.share(manager, gateway, timeout), manager, timeout, room
                )
            opened = manager.open_resource(resource, open_timeout=round(max(timeout, 3.0) * 1000))
            try:
                stream = _direct(manager, opened, timeout)
            except BaseException:
                opened.close()
                raise
            return cls(instrument, resource, opened, stream, timeout=timeout, room=room)

    @classmethod
    def _behind(
        cls, instrument: str, resource: str, gateway: Gateway, manager: Any, timeout: float, room: Room
    ) -> VisaLink:
        name = re.sub(r"^GPIB\d*", f"GPIB{gateway.board}", resource, flags=re.IGNORECASE)
        try:
            opened = manager.open_resource(name)
            address = manager.visalib.sessions[opened.session].gpib_addr
        except BaseException:
            gateway.release()
            raise
        return cls(
            instrument,
            resource,
            opened,
            gateway.stream,
            timeout=timeout,
            room=room,
            gateway=gateway,
            bus_address=address,
        )

    def write(self, text: str) -> None:
        """Send one message that has no reply. Raises Disconnected."""
        with self._exchange():
            self._send(text, reading=False)

    def query(self, text: str) -> str:
        """Send one message and give its one-line reply, stripped.

        Raises NoAnswer, BadReply, Disconnected.
        """
        with self._exchange():
            self._send(text, reading=True)
            reply = self._line(text)
            self._note_received(reply)
        return reply.decode("latin-1").strip()

    def query_block(self, text: str) -> bytes:
        """Send one message and give the payload of the definite-length block that answers it.

        Raises NoAnswer (silence, also in mid-block, with what came), BadReply (not a block), Disconnected.
        """
        with self._exchange():
            self._send(text, reading=True)
            reply, (start, end) = self._block(text)
            self._note_received(bytes(reply))
        return bytes(memoryview(reply)[start:end])

    def poll(self) -> int:
        """The status byte by serial poll, which leaves a pending reply where it is.

        Where the transport has no serial poll (raw sockets, serial lines) the byte comes from `*STB?`.
        """
        with self._exchange():
            if self._gateway is not None:
                return self._adapter_poll()
            if isinstance(self._stream, _MessageStream):
                return self._transport_poll()
            return self._status(self.query("*STB?"), "*STB?")

    @contextmanager
    def _exchange(self) -> Iterator[None]:
        """One whole exchange. After a Ctrl-C inside, its reply must not answer the next one."""
        with self.lock:
            try:
                yield
            except InstrumentError:
                raise  # whoever raised it has said whether anything is still to come
            except BaseException:
                self._mark_unsettled()
                raise

    def clear(self) -> None:
        """Device clear: the instrument drops what it was doing for the bus, its parser and output become empty."""
        from pyvisa import errors

        with self.lock:
            if self._gateway is not None:
                self._transmit(b"device clear", f"++addr {self._bus_address}\n++clr\n".encode())
            elif isinstance(self._stream, _MessageStream):
                try:
                    self._resource.clear()
                except (errors.Error, OSError) as error:
                    raise self._gone("device clear", _LineError(f"the transport to pass it on ({error})")) from error
            self._room.clock.sleep(CLEAR_PAUSE)

    def close(self) -> None:
        """Close the link, and the gateway with its last link. Closing twice is harmless."""
        with self.lock:
            if not self._open:
                return
            self._open = False
            self._close_resource()
            if self._gateway is not None:
                self._gateway.release()

    def _close_resource(self) -> None:
        from pyvisa import errors

        try:
            self._resource.close()
        except errors.InvalidSession:
            return  # somebody closed the resource manager that all of this process share

    def _send(self, text: str, *, reading: bool) -> None:
        self._settle()
        message = text.encode("latin-1")
        framed = message + b"\n"
        if self._gateway is not None:
            # The address goes with every message: nothing here depends on what the adapter remembers, and the whole
            # exchange is one segment.
            ask = b"++read eoi\n" if reading else b""
            framed = f"++addr {self._bus_address}\n".encode() + _escaped(message) + b"\n" + ask
        self._transmit(message, framed)

    def _transmit(self, message: bytes, framed: bytes) -> None:
        if not self._open:
            raise Disconnected(self.instrument, self.address, sent=message, wanted="an open link")
        self._room.transcript.note(self.instrument, "sent", message)
        try:
            self._stream.drain()
            self._stream.send(framed)
        except _LineError as gone:
            raise self._gone(message, gone) from gone

    def _receive(self, sent: str, so_far: bytearray) -> None:
        """Add what arrives next to `so_far`. Raises NoAnswer after a silent timeout, Disconnected."""
        try:
            data = self._stream.receive(self.timeout)
        except _LineError as gone:
            raise self._gone(sent, gone, bytes(so_far)) from gone
        if not data:
            part = bytes(so_far) or None
            what = "an answer" if part is None else "the rest of the answer"
            raise self._broken(NoAnswer, sent, part, f"{what} within {self.timeout:g} s")
        so_far += data

    def _line(self, sent: str) -> bytes:
        reply = bytearray()
        while b"\n" not in reply:
            self._receive(sent, reply)
            if self._stream.whole_messages:
                break
        if b"\n" in reply[:-1]:
            raise self._broken(BadReply, sent, bytes(reply), "one line")
        return bytes(reply)

    def _block(self, sent: str) -> tuple[bytearray, tuple[int, int]]:
        reply = bytearray()
        span: tuple[int, int] | None = None
        while span is None or len(reply) <= span[1]:
            self._receive(sent, reply)
            try:
                span = span or block_span(reply)
            except ValueError as error:
                raise self._broken(BadReply, sent, bytes(reply), str(error)) from error
            if span and len(reply) == span[1] and self._stream.whole_messages:
                break
        if reply[span[1] :].strip(b"\r\n"):
            raise self._broken(BadReply, sent, bytes(reply), f"a line feed after {span[1] - span[0]} bytes of block")
        return reply, span

    def _adapter_poll(self) -> int:
        command = f"++spoll {self._bus_address}"
        self._settle()
        self._transmit(command.encode(), f"{command}\n".encode())
        reply = self._line(command)
        self._note_received(reply)
        return self._status(reply.decode("latin-1").strip(), command)

    def _transport_poll(self) -> int:
        from pyvisa import constants, errors

        try:
            return int(self._resource.read_stb())
        except errors.VisaIOError as error:
            if error.error_code == constants.StatusCode.error_timeout:
                raise self._broken(NoAnswer, "serial poll", None, f"a status byte within {self.timeout:g} s") from error
            raise self._gone("serial poll", _LineError(f"a status byte ({error})")) from error
        except (errors.Error, OSError) as error:
            raise self._gone("serial poll", _LineError(f"a status byte ({error})")) from error

    def _status(self, reply: str, sent: str) -> int:
        if not re.fullmatch(r"\+?\d{1,3}", reply) or int(reply) > 255:
            raise self._broken(BadReply, sent, reply, "a status byte")
        return int(reply)

    def _settle(self) -> None:
        """After a broken exchange: clear the instrument concerned, and wait out a late reply."""
        if self._unsettled:
            self._unsettled = False
            self.clear()
        if self._gateway is None or not self._gateway.unsettled:
            return
        clears = "".join(f"++addr {address}\n++clr\n" for address in sorted(self._gateway.unsettled))
        # The adapter works through its commands in order, so nothing of the old exchange can come after its answer to
        # a question of our own.
        self._transmit(b"device clear", f"{clears}++read_tmo_ms\n".encode())
        self._await_own_answer()
        self._gateway.unsettled.clear()
        self._room.clock.sleep(CLEAR_PAUSE)

    def _await_own_answer(self) -> None:
        tail, deadline = bytearray(), time.monotonic() + 1.5 * READ_TIMEOUT_MS / 1000
        while not re.search(rb"(^|\n)%d\r?\n$" % READ_TIMEOUT_MS, tail):
            try:
                data = self._stream.receive(max(0.0, deadline - time.monotonic()))
            except _LineError as gone:
                raise self._gone("++read_tmo_ms", gone, bytes(tail)) from gone
            if not data:
                raise self._broken(NoAnswer, "++read_tmo_ms", bytes(tail) or None, "an answer of the gateway itself")
            tail += data

    def _note_received(self, data: bytes) -> None:
        self._room.transcript.note(self.instrument, "received", data.rstrip(b"\n"))

    def _broken(
        self, kind: type[InstrumentError], sent: bytes | str, received: bytes | str | None, wanted: str
    ) -> InstrumentError:
        if isinstance(received, bytes):
            self._note_received(received)
        self._mark_unsettled()
        return kind(self.instrument, self.address, sent=sent, received=received, wanted=wanted)

    def _mark_unsettled(self) -> None:
        if self._gateway is not None:
            self._gateway.unsettled.add(self._bus_address)
        else:
            self._unsettled = True

    def _gone(self, sent: bytes | str, gone: _LineError, received: bytes = b"") -> Disconnected:
        if received:
            self._note_received(received)
        if self._gateway is not None:
            self._gateway.lost = True
        return Disconnected(self.instrument, self.address, sent=sent, received=received or None, wanted=str(gone))


def rehearse(room: Room) -> None:
    """Open, use and close a link to a gateway where nobody listens, so that what the first one loads is loaded."""
    import serial  # noqa: F401

    with socket.create_server(("127.0.0.1", 0)) as nobody:
        gateway = f"PRLGX-TCPIP0::127.0.0.1::{nobody.getsockname()[1]}::INTFC"
        link = VisaLink.open("nobody", "GPIB0::1::INSTR", gateway=gateway, timeout=1.0, room=room)
        link.write("*CLS")
        link.timeout = 0.0
        try:
            link.query("*IDN?")
        except NoAnswer:
            link.close()


def _direct(manager: Any, resource: Any, timeout: float) -> _Stream:
    """The stream of a resource without gateway: its socket or serial port if pyvisa-py has one, else VISA calls."""
    session = getattr(manager.visalib, "sessions", {}).get(resource.session)
    raw = getattr(session, "interface", None)
    if isinstance(raw, socket.socket):
        return _SocketStream(raw, timeout)
    if re.match(r"ASRL", resource.resource_name, re.IGNORECASE) and hasattr(raw, "fileno"):
        return _SerialStream(raw)
    return _MessageStream(resource)


class SerialLink:
    """Bytes over a serial line: a real port, a pseudo-terminal, or `socket://host:port`.

    `timeout` (s) bounds the silence before and within an answer.
    """

    def __init__(self, instrument: str, address: str, port: Any, *, timeout: float, room: Room) -> None:
        self.instrument, self.address, self.timeout = instrument, address, timeout
        self.lock = threading.RLock()
        self._port, self._room = port, room
        self._stream = _SerialStream(port)
        self._left = bytearray()  # arrived behind the last terminator

    @classmethod
    def open(cls, instrument: str, address: str, *, baud: int, timeout: float, room: Room) -> SerialLink:
        """Open the line, 8N1 without flow control. Raises Disconnected."""
        import serial

        failures: tuple[type[Exception], ...] = (OSError, ValueError, *_terminal_errors())
        try:
            port = serial.serial_for_url(address, baudrate=baud, timeout=0, write_timeout=timeout)
        except failures as error:
            raise Disconnected(instrument, address, wanted=f"a serial line ({error})") from error
        return cls(instrument, address, port, timeout=timeout, room=room)

    def write(self, data: bytes) -> None:
        """Send bytes as they are. Raises Disconnected."""
        with self.lock:
            self._room.transcript.note(self.instrument, "sent", data)
            try:
                self._stream.send(data)
            except _LineError as gone:
                raise self._gone(gone, sent=data) from gone

    def read_until(self, terminator: bytes, *, sent: bytes | None = None) -> bytes:
        """Bytes up to and with the terminator; what came behind it is kept for the next read.

        `sent` is only for the error message. Raises NoAnswer with what had arrived, Disconnected.
        """
        with self.lock:
            while (at := self._left.find(terminator)) < 0:
                data = self._next(self.timeout, sent)
                if not data:
                    raise NoAnswer(
                        self.instrument,
                        self.address,
                        sent=sent,
                        received=bytes(self._left) or None,
                        wanted=f"an answer ending in {terminator!r} within {self.timeout:g} s",
                    )
                self._left += data
            return self._take(at + len(terminator))

    def read_available(self, timeout: float = 0.0) -> bytes:
        """All that has arrived, after at most `timeout` s of waiting; empty if nothing. Raises Disconnected."""
        with self.lock:
            wait = 0.0 if self._left else timeout
            self._left += self._next(wait, None)
            return self._take(len(self._left))

    def query(self, data: bytes, terminator: bytes) -> bytes:
        """Throw away what is left over, send, and read up to and with the terminator, as one exchange.

        Raises NoAnswer, Disconnected.
        """
        with self.lock:
            self.read_available()
            self.write(data)
            return self.read_until(terminator, sent=data)

    def close(self) -> None:
        """Close the line. Closing twice is harmless."""
        with self.lock:
            self._port.close()

    def _next(self, timeout: float, sent: bytes | None) -> bytes:
        try:
            return self._stream.receive(timeout)
        except _LineError as gone:
            raise self._gone(gone, sent=sent) from gone

    def _take(self, count: int) -> bytes:
        data = bytes(self._left[:count])
        del self._left[:count]
        if data:
            self._room.transcript.note(self.instrument, "received", data)
        return data

    def _gone(self, gone: _LineError, *, sent: bytes | None) -> Disconnected:
        received = bytes(self._left) or None
        return Disconnected(self.instrument, self.address, sent=sent, received=received, wanted=str(gone))


def _terminal_errors() -> tuple[type[Exception], ...]:
    """`termios.error` where there is a termios: it is no OSError, and a pseudo-terminal that is closing raises it."""
    try:
        import termios
    except ImportError:
        return ()
    return (termios.error,)
