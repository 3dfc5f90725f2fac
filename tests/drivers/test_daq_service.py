"""The real DAQ service over real sockets: a board of callbacks behind it in virtual time, and tapes played into it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import signal
import socket
import struct
import threading
from collections.abc import Callable, Coroutine, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers import comedi, daq_service, das16jr
from fixtures import comedi as fake
from rig.errors import AcquisitionFailed, Disconnected, SettingRefused
from rig.record import Samples
from rig.room import Confirmation, Request, Room

NAMES = ("tag", *(f"channel_{slot}" for slot in range(1, 16)))
STEP = 0.01  # s of virtual time between two looks of the service


class Kernel:
    """Time and wires behind the library of callbacks."""

    def __init__(self) -> None:
        self.now = 3.0
        self.faults: dict[str, Any] = {}
        self.callbacks: list[Callable[[float, float], None]] = []

    def subscribe(self, callback: Callable[[float, float], None]) -> None:
        self.callbacks.append(callback)

    def advance(self, seconds: float) -> None:
        for callback in self.callbacks:
            callback(self.now, self.now + seconds)
        self.now += seconds

    def signals(self, slots: Sequence[int], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        return [
            np.full(len(when), 2.5) if slot == 0 else np.sin(2 * np.pi * 50.0 * when)
            for slot, when in zip(slots, times, strict=True)
        ]


class Host:
    """A service in an event loop in a thread of its own; also a bench clock that moves the kernel's time."""

    def __init__(self, board: daq_service.Board, kernel: Kernel, **options: Any) -> None:
        self.kernel = kernel
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self.service = daq_service.Service(board, **{"monotonic_ns": lambda: round(kernel.now * 1e9), **options})
        self._servers = self.do(daq_service.listen(self.service, "127.0.0.1", 0))
        self.port = int(self._servers[0].sockets[0].getsockname()[1])

    def do(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(20.0)

    async def _sleep(self, seconds: float) -> None:
        steps = max(round(seconds / STEP), 1)
        for _ in range(steps):
            self.kernel.advance(seconds / steps)
            await asyncio.sleep(0)
            await asyncio.sleep(0)

    def now(self) -> float:
        return self.kernel.now

    def sleep(self, seconds: float) -> None:
        self.do(self._sleep(seconds))

    def ask(self, request: Request) -> Confirmation:
        raise AssertionError("nobody is asked")

    async def _close(self) -> None:
        self.service.close()
        for server in self._servers:
            server.close()

    def close(self) -> None:
        self.do(self._close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10.0)
        self._loop.close()


@pytest.fixture
def host() -> Iterator[Host]:
    kernel = Kernel()
    library = fake.Comedi(kernel, kernel.signals)
    board = comedi.open_board("board", comedi.Settings(serial="77"), comedi.Library(library), library.read)
    made = Host(board, kernel)
    yield made
    made.close()
    board.close()


@pytest.fixture
def client(host: Host) -> Iterator[das16jr.Das16jr]:
    made = open_client(host)
    yield made
    made.close()


def open_client(host: Host) -> das16jr.Das16jr:
    return das16jr.connect("recorder", das16jr.Settings(address=f"127.0.0.1:{host.port}"), Room(host, host))


class Line:
    """A control connection by hand."""

    def __init__(self, host: Host) -> None:
        self.raw = socket.create_connection(("127.0.0.1", host.port), 5.0)
        self._file = self.raw.makefile("rb")

    def ask(self, line: str) -> str:
        self.raw.sendall(line.encode() + b"\n")
        return self._file.readline().decode().rstrip("\n")

    def close(self) -> None:
        self._file.close()
        self.raw.close()


@pytest.fixture
def line(host: Host) -> Iterator[Line]:
    made = Line(host)
    yield made
    made.close()


def test_it_names_the_board_that_comedi_found(client: das16jr.Das16jr) -> None:
    identity = client.identify()
    assert (identity.model, identity.serial) == ("PC104-DAS16JR/16", "77")


@pytest.mark.parametrize(
    ("sent", "answer"),
    [
        ("HELLO", 'ERR -100,"Unknown command HELLO"'),
        ("CONF:CHAN", 'ERR -109,"Missing parameter"'),
        ("CONF:CHAN 3", 'ERR -109,"Missing parameter"'),
        ("CONF:CHAN 5,2", 'ERR -222,"Out of range: wanted 0 <= first <= last <= 15"'),
        ("CONF:CHAN 0,16", 'ERR -222,"Out of range: wanted 0 <= first <= last <= 15"'),
        ("CONF:RANG x", 'ERR -222,"Out of range: wanted 1 whole numbers"'),
        ("CONF:RANG 8", 'ERR -222,"Out of range: gain code 0…7, found 8"'),
        ("CONF:RATE", 'ERR -109,"Missing parameter"'),
        ("CONF:RATE 6251", 'ERR -222,"Out of range: wanted at most 100000 conversions per second"'),
        ("CONF:RATE nan", 'ERR -222,"Out of range: wanted scans per second"'),
        ("INIT 10", 'ERR -241,"No data connection"'),
        ("INIT -1", 'ERR -222,"Out of range: wanted 0 or more scans"'),
        ("*idn?", "OK Measurement Computing,PC104-DAS16JR/16,77,rig-daq 1 (das16)"),
        ("CONF:RANG 4", "OK 0,10"),
        ("CONF:RATE 3125", "OK 20000"),
        ("CONF?", "OK 0,15,0,20000"),
        ("STAT?", "OK IDLE,0"),
        ("ABOR", "OK"),
        ("SYST:ERR?", 'OK 0,"No error"'),
    ],
)
def test_every_line_has_its_answer_and_a_refused_one_changes_nothing(line: Line, sent: str, answer: str) -> None:
    assert line.ask(sent) == answer.replace("…", "?")
    if answer.startswith("ERR"):
        assert line.ask("CONF?") == "OK 0,15,0,20000"
        assert line.ask("SYST:ERR?") == "OK " + answer.removeprefix("ERR ").replace("…", "?")
    assert line.ask("SYST:ERR?") == 'OK 0,"No error"'


def test_changing_the_channels_keeps_the_conversion_period(line: Line) -> None:
    assert line.ask("CONF:RATE 6250") == "OK 10000"
    assert line.ask("CONF:CHAN 0,3") == "OK"
    assert line.ask("CONF?") == "OK 0,3,0,10000"


def test_nothing_is_changed_while_running(client: das16jr.Das16jr, line: Line) -> None:
    client.configure(rate=3125.0, channels=NAMES)
    client.start(None)
    for command in ("CONF:CHAN 0,1", "CONF:RANG 1", "CONF:RATE 100", "INIT 5"):
        with pytest.raises(SettingRefused, match=r"-200,.Refused while running"):
            client._control.query(command)
        assert line.ask(command) == 'ERR -203,"Command protected: the board is owned by 127.0.0.1"'
    assert line.ask("STAT?").startswith("OK RUNNING,")


def test_a_record_goes_through_the_board_the_service_and_the_client(client: das16jr.Das16jr, line: Line) -> None:
    client.configure(rate=3125.0, channels=NAMES)
    client.start(1500)
    pieces = [client.read(n) for n in (1, 999, 500)]
    assert pieces[-1].flags == {"last"}
    for piece in pieces:
        expected = np.sin(2 * np.pi * 50.0 * (piece.start + piece.instants("channel_9")))
        assert piece.volts("channel_9") == pytest.approx(expected, abs=2e-4)
    assert client.metadata["clock"] == 1_000_000
    assert line.ask("STAT?") == f"OK DONE,{1501 * 16}"


def test_runs_follow_one_another(client: das16jr.Das16jr) -> None:
    client.configure(rate=3125.0, channels=NAMES)
    for _ in range(3):
        client.start(300)
        assert len(client.read(300).counts) == 300
    client.start(None)
    client.read(100)
    client.stop()
    assert client.state == "stopped"
    client.configure(rate=1000.0, channels=NAMES[:4])
    client.start(100)
    assert client.read(100).counts.shape == (100, 4)


def test_an_overflow_of_the_kernel_s_buffer_is_an_overflow_at_the_client(
    host: Host, client: das16jr.Das16jr, line: Line
) -> None:
    client.configure(rate=3125.0, channels=NAMES)
    host.kernel.faults["das16jr.overflow"] = 800
    client.start(1000)
    with pytest.raises(AcquisitionFailed, match="overflow"):
        client.read(1000)
    assert len(client.received().counts) == 799
    assert line.ask("STAT?") == "OK OVERFLOW,12800"


def test_a_lost_conversion_and_a_wrong_clock_are_seen_from_afar(host: Host, client: das16jr.Das16jr) -> None:
    client.configure(rate=3125.0, channels=NAMES)
    host.kernel.faults["das16jr.slip"] = 200
    client.start(1000)
    with pytest.raises(AcquisitionFailed, match=r"scan 201\b"):
        client.read(1000)
    host.kernel.faults["das16jr.clock"] = 10
    client.start(1000)
    with pytest.raises(AcquisitionFailed, match="jumper"):
        client.read(1000)


def test_a_client_that_goes_away_frees_the_board(host: Host, line: Line) -> None:
    first = open_client(host)
    first.configure(rate=3125.0, channels=NAMES)
    first.start(None)
    assert first._data is not None
    first._data.close()  # as a killed process does
    first._control.close()
    first._data, first._over = None, True
    second = open_client(host)
    host.sleep(0.2)
    assert line.ask("STAT?").startswith("OK IDLE,")
    second.configure(rate=3125.0, channels=NAMES)
    second.start(50)
    assert len(second.read(50).counts) == 50
    second.close()


def test_the_board_has_one_owner_and_others_may_watch(host: Host, client: das16jr.Das16jr, line: Line) -> None:
    client.configure(rate=3125.0, channels=NAMES)
    early = socket.create_connection(("127.0.0.1", int(line.ask("DATA?").split()[1])), 5.0)
    client.start(None)
    late = socket.create_connection(early.getpeername(), 5.0)
    other = open_client(host)
    with pytest.raises(SettingRefused, match=r"-203,.Command protected: the board is owned by 127\.0\.0\.1"):
        other.configure(rate=3125.0, channels=NAMES)
    assert line.ask("ABOR").startswith("ERR -203,")
    assert line.ask("STAT?").startswith("OK RUNNING,")
    assert len(client.read(1000).counts) == 1000
    for watching in (early, late):
        kinds = [frame.kind for frame in das16jr.FrameParser().feed(watching.recv(1 << 20))]
        assert das16jr.METADATA in kinds
        watching.close()
    assert len(client.read(1000).counts) == 1000
    other.close()
    client.stop()
    assert other._control.query("STAT?").startswith("IDLE")
    client.close()
    assert other.configure(rate=3125.0, channels=NAMES).channels == 16
    other.close()


@pytest.mark.parametrize(
    "sent",
    [
        "CONF:CHAN +-1,2",
        "CONF:CHAN 0,--5",
        "CONF:RANG 1_0",
        "INIT 5,",
        "INIT 1,2,3",
        f"CONF:RANG {'9' * 900}",
        "INIT ٣",
    ],
)
def test_a_number_that_is_none_is_answered(line: Line, sent: str) -> None:
    assert line.ask(sent).startswith('ERR -222,"Out of range: wanted ')
    assert line.ask("CONF:RATE 1_000").startswith('ERR -222,"Out of range: wanted ')
    assert line.ask("CONF?") == "OK 0,15,0,20000"


def test_a_client_that_does_not_read_its_answers_is_not_heard_until_it_does(host: Host, line: Line) -> None:
    sent, line_is_full = 0, False
    line.raw.settimeout(0.5)
    while not line_is_full:
        try:
            sent += line.raw.send(b"*IDN?\n" * 10_000)
        except TimeoutError:
            line_is_full = True
        assert sent < 1 << 26  # memory would grow by as much, if they were heard
    other = Line(host)
    assert other.ask("STAT?") == "OK IDLE,0"
    other.close()


# --- tapes ------------------------------------------------------------------------------------------------------------


class Tape:
    """A board that plays lumps, which split scans, as fast as they are taken; read() ends as `end` says.

    Its machine's clock is the tape's own.
    """

    name, driver, serial, clock = "pc104-das16jr/16", "tape", "1", 1_000_000

    def __init__(self, scans: int, end: OSError | None = None) -> None:
        self._scans, self._end, self._played = scans, end, 0
        self._reading, self._writing = os.pipe()
        os.write(self._writing, b"1")  # always readable
        self._lumps: Iterator[bytes] = iter(())

    def range(self, gain: int) -> tuple[float, float]:
        return -10.0, 10.0

    def set_up(self, first: int, last: int, gain: int, scan_ns: int) -> int:
        return 20_000

    def start(self, scans: int) -> None:
        numbers = np.arange(min(scans or self._scans, self._scans), dtype=np.uint32)
        codes = np.full((len(numbers), 16), 30_000, np.uint16)
        codes[:, 0] = round((2.5 + 10.0) / 20.0 * 65535.0)
        codes[:, 1], codes[:, 2] = numbers & 0xFFFF, numbers >> 16
        data = codes.tobytes()
        self._lumps = (data[at : at + 5002] for at in range(0, len(data), 5002))

    def fileno(self) -> int:
        return self._reading

    def read(self) -> bytes:
        lump = next(self._lumps, b"")
        self._played += len(lump) // 2
        if not lump and self._end is not None:
            raise self._end
        return lump

    def monotonic_ns(self) -> int:
        return self._played * 20_000

    def cancel(self) -> None:
        self._lumps = iter(())

    def close(self) -> None:
        os.close(self._reading)
        os.close(self._writing)


def played(
    scans: int, take: Callable[[Host, das16jr.Das16jr], None], end: OSError | None = None, **options: Any
) -> None:
    tape = Tape(scans, end)
    host = Host(tape, Kernel(), monotonic_ns=tape.monotonic_ns, **options)
    client = open_client(host)
    client.configure(rate=3125.0, channels=NAMES)
    take(host, client)
    client.close()
    host.close()
    tape.close()


def scan_numbers(samples: Samples) -> NDArray[np.uint32]:
    return samples.counts[:, 1].astype(np.uint32) | samples.counts[:, 2].astype(np.uint32) << 16


def test_no_scan_is_lost_or_twice_or_out_of_order() -> None:
    def take(host: Host, client: das16jr.Das16jr) -> None:
        client.start(99_999)
        numbers = [scan_numbers(client.read(9973)) for _ in range(11)]
        assert np.array_equal(np.concatenate(numbers), np.arange(99_999))

    played(100_000, take)


def test_a_failing_board_ends_the_run_as_failed() -> None:
    def take(host: Host, client: das16jr.Das16jr) -> None:
        client.start(2000)
        with pytest.raises(AcquisitionFailed, match="failure of the board"):
            client.read(2000)
        assert len(client.received().counts) == 999

    played(1000, take, OSError(errno.ENODEV, "gone"))


def test_a_client_that_does_not_read_is_cut_off_and_memory_stays_bounded() -> None:
    def take(host: Host, client: das16jr.Das16jr) -> None:
        client.start(None)
        line = Line(host)
        while (status := line.ask("STAT?")).startswith("OK RUNNING"):
            pass
        assert status.startswith("OK SLOW,")
        line.close()
        conversions = int(status.partition(",")[2])
        assert conversions * 2 < 16 << 20  # the queue, and what the sockets of both sides hold
        with pytest.raises(AcquisitionFailed, match="too slow"):
            client.read(10_000_000)
        good = client.received()
        assert np.array_equal(scan_numbers(good), np.arange(conversions // 16 - (conversions % 16 == 0)))

    played(1_000_000, take, queue=1 << 20)


def test_one_who_watches_and_does_not_read_is_hung_up_on_and_the_run_goes_on() -> None:
    def take(host: Host, client: das16jr.Das16jr) -> None:
        deaf = socket.create_connection(("127.0.0.1", client._control.integers("DATA?", 1)[0]), 5.0)
        client.start(400_000)
        assert len(client.read(400_000).counts) == 400_000  # 12.8 MB, of which 4 MB may wait for the deaf
        with contextlib.suppress(ConnectionResetError):
            while deaf.recv(1 << 20):
                pass  # until it ends: nothing more came after it was hung up on
        deaf.close()

    played(400_001, take)


def test_a_silent_service_sends_heartbeats_with_the_right_sum() -> None:
    def take(host: Host, client: das16jr.Das16jr) -> None:
        port = client._control.integers("DATA?", 1)[0]
        raw = socket.create_connection(("127.0.0.1", port), 5.0)
        data = b""
        while len(data) < 88:  # the one at once, and the first after a second
            data += raw.recv(88 - len(data))
        raw.close()
        parser = das16jr.FrameParser()
        assert [frame.kind for frame in parser.feed(data)] == [das16jr.HEARTBEAT] * 2
        assert struct.unpack_from("<H", data, 6) == (2,)

    played(10, take)


def test_serve_listens_on_loopback_and_ends_on_a_signal_with_the_board_closed() -> None:
    tape = Tape(1000)
    seen: list[Any] = []

    def use(address: str, port: int) -> None:
        try:
            clock = Nothing()
            settings = das16jr.Settings(address=f"{address}:{port}")
            client = das16jr.connect("recorder", settings, Room(clock, clock))
            client.configure(rate=3125.0, channels=NAMES)
            client.start(500)
            seen.append(len(client.read(500).counts))
            client.close()
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    def announce(address: str, port: int) -> None:
        seen.append(address)
        threading.Thread(target=use, args=(address, port)).start()

    daq_service.serve(tape, port=0, announce=announce, monotonic_ns=tape.monotonic_ns)
    assert seen == ["127.0.0.1", 500]
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(tape.fileno())


class Nothing:
    """A clock that takes no time."""

    def now(self) -> float:
        return 0.0

    def sleep(self, seconds: float) -> None:
        return None

    def ask(self, request: Request) -> Confirmation:
        raise AssertionError("nobody is asked")


def test_a_port_that_is_taken_is_an_error() -> None:
    taken = socket.create_server(("127.0.0.1", 0))
    with pytest.raises(OSError, match="in use"):
        daq_service.serve(Tape(1), port=taken.getsockname()[1])
    taken.close()


def test_a_service_that_is_gone_is_disconnected(host: Host) -> None:
    client = open_client(host)
    client.configure(rate=3125.0, channels=NAMES)
    client.start(None)

    async def vanish() -> None:
        assert host.service._data is not None
        host.service._data.end()

    host.do(vanish())
    with pytest.raises(Disconnected):
        client.read(5000)
    client.close()
