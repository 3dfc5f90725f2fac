"""Links over real sockets and pseudo-terminals: what is sent, what is understood, how an exchange can break."""

from __future__ import annotations

import os
import pty
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.links import SerialLink, VisaLink, block_span
from rig.errors import BadReply, Disconnected, NoAnswer, OperatorMissing
from rig.room import Confirmation, Request, Room

EVERY_BYTE = bytes(range(256)) * 256
QUICK, PATIENT = 0.25, 30.0  # s


class Pages:
    """A transcript on paper."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str, bytes]] = []

    def note(self, instrument: str, direction: str, data: bytes) -> None:
        self.lines.append((instrument, direction, data))


class Counted:
    """A clock on which sleeping costs nothing."""

    time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds


class Nobody:
    def ask(self, request: Request) -> Confirmation:
        raise OperatorMissing(request.text)


Answer = bytes | list[bytes] | None
"""What to send: bytes, pieces of bytes, or None to close the connection."""


class Server:
    """A TCP server on loopback that hears lines and answers them by rule; keeps what it heard as it came."""

    def __init__(self, rule: Callable[[bytes], Answer]) -> None:
        self.rule = rule
        self.heard: list[bytes] = []
        self.segments: list[bytes] = []
        self.connections: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.connections.append(connection)
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        rest = b""
        try:
            while data := connection.recv(65536):
                self.segments.append(data)
                *lines, rest = (rest + data).split(b"\n")
                for line in lines:
                    self.heard.append(line)
                    if not self._say(connection, self.rule(line)):
                        return
        except OSError:
            return

    @staticmethod
    def _say(connection: socket.socket, answer: Answer) -> bool:
        if answer is None:
            connection.shutdown(socket.SHUT_RDWR)
            connection.close()
            return False
        for piece in [answer] if isinstance(answer, bytes) else answer:
            connection.sendall(piece)
        return True

    def close(self) -> None:
        self._listener.close()
        for connection in self.connections:
            connection.close()


class Adapter:
    """The rule of a gateway with simple instruments: what they answer to which message, on `++read`."""

    def __init__(self, **answers: Answer) -> None:
        self.answers = {name.encode(): answer for name, answer in answers.items()}
        self.address = b""
        self.pending: Answer = b""

    def __call__(self, line: bytes) -> Answer:
        if line == b"++read eoi":
            answer, self.pending = self.pending, b""
            return answer
        if line == b"++read_tmo_ms":
            return b"3000\r\n"
        if line.startswith(b"++addr"):
            self.address = line.split()[1]
        elif line.startswith(b"++spoll"):
            return b"80\r\n"
        elif not line.startswith(b"++"):
            self.pending = self.answers.get(line, line + b" from " + self.address + b"\n")
        return b""


@pytest.fixture
def pages() -> Pages:
    return Pages()


@pytest.fixture
def room(pages) -> Room:
    return Room(Counted(), Nobody(), pages)


@pytest.fixture
def serve() -> Iterator[Callable[[Callable[[bytes], Answer]], Server]]:
    servers: list[Server] = []

    def start(rule: Callable[[bytes], Answer]) -> Server:
        servers.append(Server(rule))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


@pytest.fixture
def connect(room) -> Iterator[Callable[..., VisaLink]]:
    links: list[VisaLink] = []

    def make(server: Server, timeout: float = QUICK, pad: int = 19, board: int = 0) -> VisaLink:
        gateway = f"PRLGX-TCPIP{board}::127.0.0.1::{server.port}::INTFC"
        link = VisaLink.open("analyzer", f"GPIB{board}::{pad}::INSTR", gateway=gateway, timeout=timeout, room=room)
        links.append(link)
        return link

    yield make
    for link in links:
        link.close()


# ------------------------------------------------------------------------------------------- what goes over the wire


def test_the_gateway_is_set_up_once_and_saves_nothing(serve, connect) -> None:
    server = serve(Adapter())
    connect(server).query("A")
    connect(server, pad=7).query("B")
    assert len(server.connections) == 1
    first = [line for line in server.heard if line.startswith(b"++")][:8]
    assert {b"++mode 1", b"++auto 0", b"++eos 3", b"++eoi 1", b"++savecfg 0", b"++read_tmo_ms 3000"} <= set(first)


def test_a_query_is_one_segment_with_its_address_and_its_read(serve, connect) -> None:
    server = serve(Adapter())
    link = connect(server)
    link.query("first")
    assert link.query("*IDN?") == "*IDN? from 19"
    assert server.segments[-1] == b"++addr 19\n*IDN?\n++read eoi\n"


def test_a_write_asks_for_no_reply_and_plus_signs_are_escaped(serve, connect) -> None:
    server = serve(Adapter())
    link = connect(server)
    link.write("SOUR:VOLT +1E+0 VPK")
    link.query("*IDN?")
    assert b"++addr 19\nSOUR:VOLT \x1b+1E\x1b+0 VPK\n" in b"".join(server.segments)
    assert [line for line in server.heard if line.startswith(b"++read")] == [
        b"++read_tmo_ms 50",
        b"++read_tmo_ms 3000",
        b"++read eoi",
    ]


def test_every_exchange_is_in_the_transcript(serve, connect, pages) -> None:
    connect(serve(Adapter())).query("*IDN?")
    assert pages.lines == [("analyzer", "sent", b"*IDN?"), ("analyzer", "received", b"*IDN? from 19")]


def test_a_block_arrives_byte_for_byte_with_line_feeds_inside(serve, connect) -> None:
    block = b"#6065536" + EVERY_BYTE + b"\n"
    link = connect(serve(Adapter(BLOCK=block)), timeout=PATIENT)
    assert link.query_block("BLOCK") == EVERY_BYTE
    assert link.query("*IDN?") == "*IDN? from 19"


@given(cuts=st.lists(st.integers(0, 540), max_size=6))
def test_a_block_may_come_in_any_pieces(cuts: list[int]) -> None:
    block = b"#3512" + EVERY_BYTE[:512] + b"\n"
    edges = [0, *sorted(min(cut, len(block)) for cut in cuts), len(block)]
    pieces = [block[a:b] for a, b in pairwise(edges)]
    server = Server(Adapter(BLOCK=pieces))
    room = Room(Counted(), Nobody())
    gateway = f"PRLGX-TCPIP::127.0.0.1::{server.port}::INTFC"
    with closing(server), closing(VisaLink.open("a", "GPIB::19::INSTR", gateway=gateway, timeout=5, room=room)) as link:
        assert link.query_block("BLOCK") == EVERY_BYTE[:512]


def test_a_large_block_is_fast(serve, connect) -> None:
    link = connect(serve(Adapter(BLOCK=b"#6065536" + EVERY_BYTE + b"\n")), timeout=PATIENT)
    link.query_block("BLOCK")
    begun = time.perf_counter()
    for _ in range(20):
        link.query_block("BLOCK")
    assert (time.perf_counter() - begun) / 20 < 0.02  # 44 ms each with Nagle's algorithm


def test_a_serial_poll_leaves_a_pending_reply_alone(serve, connect) -> None:
    server = serve(Adapter())
    link = connect(server)
    link.write("A")
    assert link.poll() == 80
    assert server.heard[-1] == b"++spoll 19"
    assert b"++read eoi" not in server.heard


def test_a_device_clear_goes_to_the_instrument_and_waits_on_the_rooms_clock(serve, connect, room) -> None:
    server = serve(Adapter())
    link = connect(server)
    link.clear()
    assert link.query("A") == "A from 19"
    assert server.heard[server.heard.index(b"++clr") - 1] == b"++addr 19"
    assert room.clock.now() == pytest.approx(0.1)


# ---------------------------------------------------------------------------------------------- how exchanges break


def test_a_silent_instrument_is_no_answer_and_both_halves_are_shown(serve, connect) -> None:
    link = connect(serve(Adapter(MUTE=b"")))
    with pytest.raises(NoAnswer, match=r"analyzer at GPIB0::19::INSTR: sent 'MUTE', wanted an answer within 0.25 s"):
        link.query("MUTE")


def test_after_a_silent_instrument_the_next_exchange_works(serve, connect) -> None:
    server = serve(Adapter(MUTE=b""))
    link = connect(server)
    with pytest.raises(NoAnswer):
        link.query("MUTE")
    assert link.query("A") == "A from 19"
    assert b"++clr" in server.heard


def test_a_late_reply_is_never_taken_for_the_next_one_even_by_another_instrument(serve, connect) -> None:
    class Late(Adapter):
        """The gateway delivers the reply only when it has to work on, as one that was blocked in its read."""

        kept = b""

        def __call__(self, line: bytes) -> Answer:
            answer = super().__call__(line)
            if answer == b"LATE from 19\n":
                self.kept = answer
                return b""
            if answer and self.kept:
                answer, self.kept = [self.kept, bytes(answer)], b""
            return answer

    server = serve(Late())
    analyzer, scope = connect(server), connect(server, pad=7)
    with pytest.raises(NoAnswer):
        analyzer.query("LATE")
    assert scope.query("A") == "A from 7"
    assert analyzer.query("B") == "B from 19"


def test_a_truncated_block_shows_what_was_received(serve, connect, pages) -> None:
    link = connect(serve(Adapter(BLOCK=b"#3512" + EVERY_BYTE[:100])))
    with pytest.raises(NoAnswer, match="the rest of the answer") as caught:
        link.query_block("BLOCK")
    assert caught.value.received == b"#3512" + EVERY_BYTE[:100]
    assert pages.lines[-1] == ("analyzer", "received", b"#3512" + EVERY_BYTE[:100])


@pytest.mark.parametrize(
    "answer",
    [b"garbage\n", b"#0abc\n", b"#x12\n", b"#3a12\n", b"#9999999999" + b"\n", b"#15abcdefgh\n"],
    ids=["text", "indefinite", "no digit", "length not digits", "absurd length", "longer than it says"],
)
def test_what_is_no_block_is_a_bad_reply(serve, connect, answer: bytes) -> None:
    with pytest.raises(BadReply, match="block"):
        connect(serve(Adapter(BLOCK=answer))).query_block("BLOCK")


def test_two_lines_where_one_was_wanted_are_a_bad_reply(serve, connect) -> None:
    with pytest.raises(BadReply, match="wanted one line"):
        connect(serve(Adapter(TWO=b"one\ntwo\n"))).query("TWO")


def test_a_status_byte_that_is_none_is_a_bad_reply(serve, connect) -> None:
    class Odd(Adapter):
        def __call__(self, line: bytes) -> Answer:
            return b"300\r\n" if line.startswith(b"++spoll") else super().__call__(line)

    with pytest.raises(BadReply, match="a status byte"):
        connect(serve(Odd())).poll()


@pytest.mark.parametrize("answer", [None, [b"#3512" + EVERY_BYTE[:100]]], ids=["at once", "in mid-block"])
def test_a_closing_gateway_is_noticed_at_once_and_never_loops(serve, connect, answer: Answer) -> None:
    server = serve(Adapter(BLOCK=answer))
    link = connect(server, timeout=PATIENT)
    if answer is not None:
        threading.Timer(0.1, lambda: server.connections[0].shutdown(socket.SHUT_RDWR)).start()
    begun = time.monotonic()
    with pytest.raises(Disconnected, match="BLOCK"):
        link.query_block("BLOCK")
    for attempt in (lambda: link.write("A"), lambda: link.query("B"), link.poll, link.clear):
        with pytest.raises(Disconnected):
            attempt()
    assert time.monotonic() - begun < 2.0


def test_a_gateway_that_closed_while_nobody_spoke_is_noticed_by_the_next_write(serve, connect) -> None:
    server = serve(Adapter())
    link = connect(server, timeout=PATIENT)
    link.query("A")
    server.connections[0].shutdown(socket.SHUT_RDWR)
    begun = time.monotonic()
    with pytest.raises(Disconnected, match="sent 'OUTP OFF'"):
        link.query("OUTP OFF")
    assert time.monotonic() - begun < 1.0


def test_after_a_lost_gateway_a_new_link_reaches_it_again(serve, connect) -> None:
    server = serve(Adapter())
    lost = connect(server)
    lost.query("A")
    server.connections[0].shutdown(socket.SHUT_RDWR)
    with pytest.raises(Disconnected):
        lost.query("A")
    assert connect(server).query("B") == "B from 19"


def test_a_refused_connection_is_disconnected_and_leaves_nothing_behind(serve, connect, room) -> None:
    from pyvisa_py.prologix import _PrologixIntfcSession

    before = dict(_PrologixIntfcSession.boards)
    with closing(socket.create_server(("127.0.0.1", 0))) as unused:
        port = unused.getsockname()[1]
    gateway = f"PRLGX-TCPIP0::127.0.0.1::{port}::INTFC"
    with pytest.raises(Disconnected, match="a connection"):
        VisaLink.open("analyzer", "GPIB0::19::INSTR", gateway=gateway, timeout=QUICK, room=room)
    assert before == _PrologixIntfcSession.boards
    assert connect(serve(Adapter())).query("A") == "A from 19"


@pytest.mark.parametrize("resource", ["nonsense", "GPIB7::19::INSTR", "TCPIP::127.0.0.1::1::SOCKET"])
def test_what_cannot_be_opened_is_disconnected(resource: str, room) -> None:
    with pytest.raises(Disconnected, match="a connection"):
        VisaLink.open("analyzer", resource, timeout=QUICK, room=room)


def test_a_closed_link_says_so(serve, connect) -> None:
    link = connect(serve(Adapter()))
    link.close()
    link.close()
    with pytest.raises(Disconnected, match="an open link"):
        link.write("A")


# ----------------------------------------------------------------------------------------------------- sharing


def test_two_gateways_may_have_the_same_board_number_in_one_process(serve, connect) -> None:
    one, other = serve(Adapter(WHO=b"one\n")), serve(Adapter(WHO=b"other\n"))
    first, second = connect(one), connect(other)
    assert (first.query("WHO"), second.query("WHO"), first.query("WHO")) == ("one", "other", "one")


def test_the_connection_lasts_as_long_as_its_last_link(serve, connect) -> None:
    server = serve(Adapter())
    first, second = connect(server), connect(server, pad=7)
    first.close()
    assert second.query("A") == "A from 7"
    second.close()
    assert connect(server).query("B") == "B from 19"
    assert len(server.connections) == 2


def test_threads_on_one_gateway_never_get_each_others_replies(serve, connect) -> None:
    server = serve(Adapter())
    links = [connect(server, timeout=PATIENT, pad=pad) for pad in (7, 19)]
    wrong: list[str] = []

    def talk(link: VisaLink, pad: int) -> None:
        for number in range(200):
            reply = link.query(f"Q{number}")
            if reply != f"Q{number} from {pad}":
                wrong.append(reply)

    threads = [threading.Thread(target=talk, args=(link, pad)) for link, pad in zip(links, (7, 19), strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


# ------------------------------------------------------------------------------------------- other VISA resources


def plain(line: bytes) -> Answer:
    """An instrument on a bare socket or serial line."""
    return {b"*IDN?": b"maker,model,0,1\n", b"*STB?": b"+36\n", b"BLOCK?": b"#3512" + EVERY_BYTE[:512] + b"\n"}.get(
        line, b""
    )


def test_a_bare_socket_works_and_its_status_byte_comes_from_a_query(serve, room) -> None:
    server = serve(plain)
    address = f"TCPIP0::127.0.0.1::{server.port}::SOCKET"
    with closing(VisaLink.open("analyzer", address, timeout=PATIENT, room=room)) as link:
        link.write("*CLS")
        assert link.query("*IDN?") == "maker,model,0,1"
        assert link.query_block("BLOCK?") == EVERY_BYTE[:512]
        assert link.poll() == 36
        link.clear()
        server.connections[0].shutdown(socket.SHUT_RDWR)
        with pytest.raises(Disconnected):
            link.query("*IDN?")


class Vxi11:
    """A VXI-11 core server without portmapper, for one link: create, write, read, read status, clear."""

    def __init__(self, rule: Callable[[bytes], Answer]) -> None:
        self._rule, self.output, self.cleared = rule, b"", 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _serve(self) -> None:
        connection, _ = self._listener.accept()
        with connection, connection.makefile("rb") as stream:
            while len(head := stream.read(4)) == 4:
                call = stream.read(struct.unpack(">I", head)[0] & 0x7FFFFFFF)
                xid, procedure = struct.unpack(">I", call[:4])[0], struct.unpack(">I", call[20:24])[0]
                reply = struct.pack(">6I", xid, 1, 0, 0, 0, 0) + self._result(procedure, call[40:])
                connection.sendall(struct.pack(">I", 0x80000000 | len(reply)) + reply)

    def _result(self, procedure: int, arguments: bytes) -> bytes:
        if procedure == 10:
            return struct.pack(">4I", 0, 1, 0, 1 << 20)
        if procedure == 11:
            size = struct.unpack(">I", arguments[16:20])[0]
            self.output = bytes(self._rule(arguments[20 : 20 + size].rstrip(b"\n")) or b"")
            return struct.pack(">2I", 0, size)
        if procedure == 12:
            data, self.output = self.output, b""
            if not data:
                return struct.pack(">3I", 15, 0, 0)
            return struct.pack(">3I", 0, 4, len(data)) + data + b"\0" * (-len(data) % 4)
        if procedure == 13:
            return struct.pack(">2I", 0, 48)
        self.cleared += procedure == 15
        return struct.pack(">I", 0)


def test_a_vxi11_gateway_works_with_its_own_serial_poll_and_clear(room) -> None:
    with closing(Vxi11(plain)) as server:
        address = f"TCPIP0::127.0.0.1,{server.port}::gpib0,19::INSTR"
        with closing(VisaLink.open("analyzer", address, timeout=QUICK, room=room)) as link:
            assert link.query("*IDN?") == "maker,model,0,1"
            assert link.query_block("BLOCK?") == EVERY_BYTE[:512]
            assert link.poll() == 48
            with pytest.raises(NoAnswer):
                link.query("MUTE")
            assert link.query("*IDN?") == "maker,model,0,1"
            assert server.cleared == 1


# ---------------------------------------------------------------------------------------------------- serial lines


class Line:
    """The far end of a pseudo-terminal, raw."""

    def __init__(self) -> None:
        self.master, slave = pty.openpty()
        tty.setraw(self.master)
        tty.setraw(slave)
        self.path, self._slave = os.ttyname(slave), slave

    def say(self, data: bytes) -> None:
        os.write(self.master, data)

    def hear(self) -> bytes:
        return os.read(self.master, 65536)

    def close(self) -> None:
        for end in (self.master, self._slave):
            try:
                os.close(end)
            except OSError:
                continue


@pytest.fixture
def line() -> Iterator[Line]:
    with closing(Line()) as one:
        yield one


@pytest.fixture
def serial_link(line, room) -> Iterator[SerialLink]:
    with closing(SerialLink.open("vibrometer", line.path, baud=9600, timeout=QUICK, room=room)) as link:
        yield link


def test_a_serial_answer_ends_at_its_terminator_and_the_rest_is_kept(line, serial_link) -> None:
    line.say(b"5\r\n7\r\nrest")
    assert serial_link.read_until(b"\r\n") == b"5\r\n"
    assert serial_link.read_until(b"\r\n") == b"7\r\n"
    assert serial_link.read_available() == b"rest"
    assert serial_link.read_available() == b""


def test_a_serial_query_ignores_what_was_left_over(line, serial_link, pages) -> None:
    line.say(b"stale\n")
    answer = threading.Thread(target=lambda: (line.hear(), line.say(b"fresh\n")))
    assert serial_link.read_available(timeout=1.0) == b"stale\n"
    line.say(b"stale\n")
    answer.start()
    assert serial_link.query(b"VELO?\n", b"\n") == b"fresh\n"
    answer.join()
    assert pages.lines[-2:] == [("vibrometer", "sent", b"VELO?\n"), ("vibrometer", "received", b"fresh\n")]


def test_a_silent_serial_line_shows_what_had_come(line, serial_link) -> None:
    line.say(b"half")
    with pytest.raises(NoAnswer, match="received 'half'"):
        serial_link.read_until(b"\n")


def test_a_serial_line_that_goes_away_is_disconnected(line, serial_link) -> None:
    line.close()
    with pytest.raises(Disconnected):
        serial_link.read_until(b"\n")


def test_a_serial_line_over_a_socket_works_and_notices_its_end(serve, room) -> None:
    server = serve(lambda heard: b"5\n" if heard == b"VELO?" else None)
    with closing(
        SerialLink.open("vibrometer", f"socket://127.0.0.1:{server.port}", baud=9600, timeout=PATIENT, room=room)
    ) as link:
        assert link.query(b"VELO?\n", b"\n") == b"5\n"
        link.write(b"bye\n")
        with pytest.raises(Disconnected):
            link.read_until(b"\n")


@pytest.mark.parametrize("address", ["/nowhere/tty", "socket://127.0.0.1:1", "nonsense://"])
def test_a_serial_line_that_cannot_be_opened_is_disconnected(address: str, room) -> None:
    with pytest.raises(Disconnected, match="a serial line"):
        SerialLink.open("vibrometer", address, baud=9600, timeout=QUICK, room=room)


def test_visa_reaches_a_serial_line_too(line, room) -> None:
    with closing(VisaLink.open("analyzer", f"ASRL{line.path}::INSTR", timeout=PATIENT, room=room)) as link:
        answer = threading.Thread(target=lambda: line.say(plain(line.hear().rstrip(b"\n"))))
        answer.start()
        assert link.query("*IDN?") == "maker,model,0,1"
        answer.join()


def test_a_gateway_on_a_serial_port_works_the_same(line, room) -> None:
    rule, done = Adapter(), threading.Event()

    def serve() -> None:
        rest = b""
        while not done.is_set():
            *lines, rest = (rest + line.hear()).split(b"\n")
            for heard in lines:
                line.say(bytes(rule(heard) or b""))

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    gateway = f"PRLGX-ASRL::{line.path}::INTFC"
    # an answer that is there is not waited for: the test itself may take less than one such time
    with closing(VisaLink.open("analyzer", "GPIB::19::INSTR", gateway=gateway, timeout=1e3, room=room)) as link:
        assert link.query("*IDN?") == "*IDN? from 19"
        assert link.poll() == 80
        done.set()
        link.write("the last")
    server.join()


# ------------------------------------------------------------------------------------------------------- the parser


@given(payload=st.binary(max_size=2000), digits=st.integers(1, 9), tail=st.binary(max_size=5), cut=st.integers(0, 2020))
def test_a_definite_block_is_found_whatever_it_holds(payload: bytes, digits: int, tail: bytes, cut: int) -> None:
    count = str(len(payload))
    width = max(digits, len(count))
    head = f"#{width}{count.zfill(width)}".encode()
    whole = head + payload + tail
    assert block_span(whole) == (len(head), len(head) + len(payload))
    part = whole[:cut]
    assert block_span(part) == (None if len(part) < len(head) else (len(head), len(head) + len(payload)))


@given(data=st.binary(max_size=30))
def test_no_bytes_upset_the_block_parser(data: bytes) -> None:
    try:
        span = block_span(data)
    except ValueError:
        return
    assert span is None or span[0] <= span[1]
