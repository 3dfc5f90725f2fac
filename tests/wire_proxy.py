"""A proxy of bytes between a driver and an instrument: everything passes as it is, but for what it was told to spoil.

It stands on real sockets, or on a pseudo-terminal towards the driver, and knows of a language only where an answer ends
and what was asked. What is spoilt is whole answers (or frames), chosen by what was asked and by their number:

- silence: from then on no such answer arrives; late: it comes after `size` s, and all that follows behind it;
- truncated: its first half, and never the rest; garbage: as many other bytes;
- duplicated: it comes twice; previous: the answer before it comes again in its place; behind: so does every later one;
- other: `says` in its place; number: of its numbers, the one at `place` is `size` times as large;
- not_a_number, overload: a number of it is NaN, or what SCPI says for infinity;
- flipped: bit `bit` of byte `place` of the text, or of a block's or a frame's payload, is another (-1: in the middle);
- scaled: all numbers of a block of reals are `size` times as large, from then on;
- disconnect: the line is closed instead; hung: from then on nothing passes, and nobody is told;
- second_client: another client connects and says `says`;
- of the DAQ service's frames: lost, doubled: the frame; lost_scans, doubled_scans: `size` scans of it, by the service's
  own count; hidden_loss, hidden_double: the same, and the count goes on as if nothing had been; slipped: one
  conversion, the same; inside: `flipped`, before the check sum was made.
"""

from __future__ import annotations

import asyncio
import os
import re
import socket
import struct
import tty
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

HOST = "127.0.0.1"
TURNS = 6  # of the loop, by which the bench's clock is asked later than the instruments: see fixtures.control
LASTING = frozenset({"silence", "behind", "scaled", "hung"})
HEADER = struct.Struct("<4sHHIQQIHHI")  # of a DAQ frame, without its check sum: "On the wire"
SAMPLES, BYTES_A_CODE = 1, 2
NUMBER = re.compile(rb"[+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")


@dataclass(frozen=True)
class Spoilt:
    """See the module; `asked` is looked for in what was asked, after `skip` such answers; once, unless `lasting`."""

    kind: str
    asked: str = ""
    skip: int = 0
    size: float = 0.0
    bit: int = 0
    place: int = -1
    says: bytes = b""
    lasting: bool = False


class Language(Protocol):
    """What a proxy must know of a language."""

    asked: str
    """What the next answer is about."""

    def heard(self, data: bytes) -> None:
        """The client said something."""
        ...

    def answers(self, data: bytes) -> Iterable[bytes]:
        """Whole answers; what is left waits for the rest."""
        ...


class Lines:
    """One line out, one line in."""

    def __init__(self) -> None:
        self.asked = ""
        self._said, self._left = b"", b""

    def heard(self, data: bytes) -> None:
        *lines, self._said = (self._said + data).split(b"\n")
        for line in lines:
            self.line(line)

    def line(self, line: bytes) -> None:
        self.asked = line.decode("latin-1").strip()

    def answers(self, data: bytes) -> list[bytes]:
        self._left += data
        found = []
        while (end := self.end(self._left)) > 0:
            found.append(self._left[:end])
            self._left = self._left[end:]
        return found

    def end(self, data: bytes) -> int:
        """Length of the answer at the beginning; 0 while it is not whole."""
        return data.find(b"\n") + 1


class Bus(Lines):
    """A Prologix gateway: what is asked begins with the bus address; an answer may be a block."""

    def __init__(self) -> None:
        super().__init__()
        self._address = ""

    def line(self, line: bytes) -> None:
        text = line.decode("latin-1")
        if text.startswith("++addr "):
            self._address = text.removeprefix("++addr ").strip()
        elif text.startswith("++spoll"):
            self.asked = f"{text.split()[-1]}:spoll"
        elif not text.startswith("++"):
            self.asked = f"{self._address}:{text}"
        elif text.strip() == "++read_tmo_ms":
            self.asked = f"gateway:{text}"

    def end(self, data: bytes) -> int:
        match = re.match(rb"#([1-9])", data)
        if match is None:
            return super().end(data)
        digits = data[2 : 2 + int(match[1])]
        end = 2 + int(match[1]) + int(digits) + 1 if len(digits) == int(match[1]) else len(data) + 1
        return end if len(data) >= end else 0


class Frames:
    """The DAQ service's data connection; what is asked is the frame's kind."""

    KINDS = ("metadata", "samples", "heartbeat")

    def __init__(self) -> None:
        self.asked, self.shift, self._left = "", 0, b""

    def heard(self, data: bytes) -> None:
        """Nothing is said on it."""

    def answers(self, data: bytes) -> Iterator[bytes]:
        """One by one: what was made of a frame moves the count of the next."""
        self._left += data
        while len(self._left) >= HEADER.size + 4:
            end = HEADER.size + 4 + HEADER.unpack_from(self._left)[-1]
            if len(self._left) < end:
                break
            frame, self._left = self._left[:end], self._left[end:]
            yield self._moved(frame)

    def about(self, frame: bytes) -> str:
        """The kind of a frame; samples without any are its end."""
        kind = HEADER.unpack_from(frame)[2]
        return "end" if kind == SAMPLES and len(frame) == HEADER.size + 4 else self.KINDS[kind]

    def _moved(self, frame: bytes) -> bytes:
        head = list(HEADER.unpack_from(frame))
        if not head[4]:  # a run begins
            self.shift = 0
        if not self.shift or head[2] != SAMPLES:
            return frame
        head[4] += self.shift
        return framed(head, frame[HEADER.size + 4 :])


class Stuffed:
    """The Sensor Cube's frames, each ended by a zero; what is asked is the type of the frame in hexadecimal."""

    def __init__(self) -> None:
        self.asked, self._left = "", b""

    def heard(self, data: bytes) -> None:
        """Types of frames say enough."""

    def answers(self, data: bytes) -> list[bytes]:
        *whole, self._left = (self._left + data).split(b"\0")
        return [one + b"\0" for one in whole]

    def about(self, frame: bytes) -> str:
        return f"{frame[2]:02x}" if len(frame) > 3 else ""


def framed(head: Sequence[Any], payload: bytes) -> bytes:
    """A DAQ frame with the right length and check sum."""
    packed = HEADER.pack(*head[:-1], len(payload))
    return packed + struct.pack("<I", zlib.crc32(packed + b"\0\0\0\0" + payload)) + payload


class Proxy:
    """Stands before the port `target`, says `kind` of language by `language()`, and spoils as told."""

    def __init__(self, language: Callable[[], Any], target: int, spoilt: Sequence[Spoilt] = ()) -> None:
        self.language, self.target, self.spoilt = language, target, tuple(spoilt)
        self.hung = False
        self.ports: dict[int, int] = {}
        """A client's port → the port by which the service knows it."""
        self.renamed: Proxy | None = None
        """Whose ports are named on this line, as `INIT` of the DAQ service does."""
        self.turns = 0
        self.injected: list[Spoilt] = []
        self.answers = 0
        """How many came from the instrument."""
        self._seen = [0] * len(self.spoilt)
        self._server: asyncio.Server | None = None
        self._terminal: Terminal | None = None

    async def listen(self) -> int:
        """Open a port and give it."""
        self._server = await asyncio.get_running_loop().create_server(lambda: _Client(self), HOST, 0)
        return int(self._server.sockets[0].getsockname()[1])

    async def terminal(self) -> str:
        """Open a pseudo-terminal instead and give its path."""
        self._terminal = Terminal(self)
        return self._terminal.path

    def close(self) -> None:
        """Stop listening."""
        if self._server is not None:
            self._server.close()
        if self._terminal is not None:
            self._terminal.close()

    def due(self, asked: str) -> Spoilt | None:
        """What is to be done with the next answer about this, if anything."""
        for number, one in enumerate(self.spoilt):
            if not re.search(one.asked, asked):
                continue
            self._seen[number] += 1
            after = self._seen[number] - one.skip
            if after == 1 or (after > 1 and (one.lasting or one.kind in LASTING)):
                self.injected.append(one)
                return one
        return None


@dataclass
class Passage:
    """One client's connection and its way on."""

    proxy: Proxy
    send: Callable[[bytes], None]
    hang_up: Callable[[], None]
    language: Any
    before: dict[str, bytes] = field(default_factory=dict)
    """The last answer, by who gave it."""
    upstream: asyncio.Transport | None = None
    waiting: bytes = b""
    clear_at: float = 0.0
    held: list[bytes] | None = None
    """What waits for another client to be heard."""

    async def go_on(self, port: int) -> None:
        """Connect to the instrument, and say what has been waiting."""
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_connection(lambda: _Upstream(self), HOST, self.proxy.target)
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.proxy.ports[port] = int(transport.get_extra_info("sockname")[1])
        self.upstream = transport
        transport.write(self.waiting)

    def heard(self, data: bytes) -> None:
        """The client's bytes."""
        if self.proxy.hung:
            return
        self.language.heard(data)
        if self.proxy.renamed is not None:
            data = re.sub(rb"^(INIT \d+,)(\d+)", self._other_port, data, flags=re.MULTILINE)
        self._later(self.proxy.turns, data)

    def _other_port(self, match: re.Match[bytes]) -> bytes:
        assert self.proxy.renamed is not None
        return match[1] + str(self.proxy.renamed.ports.get(int(match[2]), int(match[2]))).encode()

    def _later(self, turns: int, data: bytes) -> None:
        if turns:
            asyncio.get_running_loop().call_soon(self._later, turns - 1, data)
        elif self.upstream is None:
            self.waiting += data
        else:
            self.upstream.write(data)

    def answered(self, data: bytes) -> None:
        """The instrument's bytes."""
        if self.proxy.hung:
            return
        for answer in self.language.answers(data):
            self.proxy.answers += 1
            asked = self.language.about(answer) if hasattr(self.language, "about") else self.language.asked
            self._pass_on(answer, asked)

    def _pass_on(self, answer: bytes, asked: str) -> None:
        spoilt, who = self.proxy.due(asked), asked.partition(":")[0] if ":" in asked else ""
        before, self.before[who] = self.before.get(who, answer), answer
        match spoilt.kind if spoilt else "":
            case "":
                self._deliver(answer)
            case "silence":
                return
            case "hung":
                self.proxy.hung = True
            case "disconnect":
                self.hang_up()
            case "late":
                assert spoilt
                self._deliver(answer, spoilt.size)
            case "second_client":
                assert spoilt
                self.held = [answer]
                self.intrusion = asyncio.get_running_loop().create_task(self._intrude(spoilt))
            case _:
                assert spoilt
                self._deliver(MADE[spoilt.kind](answer, before, spoilt, self.language))

    def _deliver(self, data: bytes, late: float = 0.0) -> None:
        if self.held is not None:
            self.held.append(data)
            return
        loop = asyncio.get_running_loop()
        self.clear_at = max(self.clear_at, loop.time() + late if late else 0.0)
        if self.clear_at > loop.time():
            loop.call_at(self.clear_at, self.send, data)
        else:
            self.send(data)

    async def _intrude(self, spoilt: Spoilt) -> None:
        """Another client says its say; the answers that were due come when it has been heard."""
        _, writer = await asyncio.open_connection(HOST, self.proxy.target)
        writer.write(spoilt.says)
        await writer.drain()
        for _ in range(2 * TURNS):
            await asyncio.sleep(0)
        held, self.held = self.held or [], None
        for answer in held:
            self._deliver(answer)

    def close(self) -> None:
        """The client has gone."""
        if self.upstream is not None:
            self.upstream.close()


class _Client(asyncio.Protocol):
    def __init__(self, proxy: Proxy) -> None:
        self._proxy = proxy

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._passage = Passage(self._proxy, transport.write, transport.close, self._proxy.language())
        port = int(transport.get_extra_info("peername")[1])
        self._way = asyncio.get_running_loop().create_task(self._passage.go_on(port))

    def data_received(self, data: bytes) -> None:
        self._passage.heard(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._passage.close()


class _Upstream(asyncio.Protocol):
    def __init__(self, passage: Passage) -> None:
        self._passage = passage

    def data_received(self, data: bytes) -> None:
        self._passage.answered(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if not self._passage.proxy.hung:
            self._passage.hang_up()


class Terminal:
    """The client's end is a pseudo-terminal; pulling the plug closes it."""

    def __init__(self, proxy: Proxy) -> None:
        self._loop = asyncio.get_running_loop()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path, self._open = os.ttyname(self._slave), True
        self._passage = Passage(proxy, self._write, self.close, proxy.language())
        self._way = self._loop.create_task(self._passage.go_on(0))
        self._loop.add_reader(self._master, self._readable)

    def close(self) -> None:
        if self._open:
            self._open = False
            self._loop.remove_reader(self._master)
            os.close(self._master)
            os.close(self._slave)
            self._passage.close()

    def _readable(self) -> None:
        try:
            self._passage.heard(os.read(self._master, 1 << 16))
        except OSError:
            self.close()

    def _write(self, data: bytes) -> None:
        if self._open:
            os.write(self._master, data)


Maker = Callable[[bytes, bytes, Spoilt, Any], bytes]


def _payload(answer: bytes) -> int:
    """Where the numbers of a block, the samples of a DAQ frame, begin; 0 for text."""
    if answer[:4] == b"RDAQ":
        return HEADER.size + 4
    return 2 + int(answer[1:2]) if re.match(rb"#[1-9]", answer) else 0


def _flipped(answer: bytes, before: bytes, spoilt: Spoilt, language: Any) -> bytes:
    begin, changed = _payload(answer), bytearray(answer)
    place = begin + spoilt.place if spoilt.place >= 0 else (begin + len(answer.rstrip(b"\r\n"))) // 2
    changed[min(place, len(answer) - 1)] ^= 1 << spoilt.bit
    return bytes(changed)


def _inside(answer: bytes, before: bytes, spoilt: Spoilt, language: Any) -> bytes:
    changed = _flipped(answer, before, spoilt, language)
    return framed(HEADER.unpack_from(answer), changed[HEADER.size + 4 :])


def _garbage(answer: bytes, before: bytes, spoilt: Spoilt, language: Any) -> bytes:
    """Other bytes, the end of the line as it was; the length of a block or a frame too."""
    begin, end = _payload(answer), len(answer.rstrip(b"\r\n\0")) if not _payload(answer) else len(answer)
    other = bytes(33 + (37 * k + 11) % 93 for k in range(end - begin))
    return answer[:begin] + other + answer[end:]


def _number(text: bytes) -> Maker:
    def made(answer: bytes, before: bytes, spoilt: Spoilt, language: Any) -> bytes:
        if (begin := _payload(answer)) and answer[:1] == b"#":
            reals = len(answer.rstrip(b"\n")[begin:]) // 8
            value = float("nan") if text == b"NAN" else float(text)
            return answer[:begin] + struct.pack(">d", value) * reals + answer[begin + 8 * reals :]
        return NUMBER.sub(text, answer, count=1)

    return made


def _told(answer: bytes, before: bytes, spoilt: Spoilt, language: Any) -> bytes:
    """Whole numbers stay whole."""
    match = list(NUMBER.finditer(answer))[spoilt.place]
    value = float(match[0]) * spoilt.size
    text = f"{value:.10E}" if re.search(rb"[.eE]", match[0]) else f"{value:.0f}"
    return answer[: match.start()] + text.encode() + answer[match.end() :]


def _scaled(answer: bytes, before: bytes, spoilt: Spoilt, language: Any) -> bytes:
    begin, count = _payload(answer), (len(answer) - _payload(answer)) // 8
    reals = struct.unpack_from(f">{count}d", answer, begin)
    return answer[:begin] + struct.pack(f">{count}d", *(spoilt.size * x for x in reals)) + answer[begin + 8 * count :]


def _scans(count: int, hidden: bool) -> Maker:
    """Scans lost (negative) or doubled in the middle of a frame, as often as `size` says."""

    def made(answer: bytes, before: bytes, spoilt: Spoilt, language: Any) -> bytes:
        head, payload = list(HEADER.unpack_from(answer)), answer[HEADER.size + 4 :]
        width = int(head[7]) * BYTES_A_CODE * max(int(spoilt.size), 1) if abs(count) == 1 else BYTES_A_CODE
        first = len(payload) // 2 // BYTES_A_CODE * BYTES_A_CODE
        piece = payload[first : first + width]
        if hidden:
            language.shift += (1 if count > 0 else -1) * len(piece) // BYTES_A_CODE
        return framed(head, payload[:first] + (piece + piece if count > 0 else b"") + payload[first + width :])

    return made


MADE: dict[str, Maker] = {
    "truncated": lambda answer, before, spoilt, language: answer[: len(answer) // 2],
    "garbage": _garbage,
    "duplicated": lambda answer, before, spoilt, language: answer + answer,
    "doubled": lambda answer, before, spoilt, language: answer + answer,
    "lost": lambda answer, before, spoilt, language: b"",
    "previous": lambda answer, before, spoilt, language: before,
    "behind": lambda answer, before, spoilt, language: before,
    "other": lambda answer, before, spoilt, language: spoilt.says,
    "number": _told,
    "not_a_number": _number(b"NAN"),
    "overload": _number(b"9.90000E+37"),
    "flipped": _flipped,
    "inside": _inside,
    "scaled": _scaled,
    "lost_scans": _scans(-1, hidden=False),
    "doubled_scans": _scans(1, hidden=False),
    "hidden_loss": _scans(-1, hidden=True),
    "hidden_double": _scans(1, hidden=True),
    "slipped": _scans(-2, hidden=True),
}
