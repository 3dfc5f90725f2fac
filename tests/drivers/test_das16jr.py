"""The DAQ client against its twin over real sockets, in virtual time; and the frame parser on its own."""

from __future__ import annotations

import asyncio
import struct
import threading
import zlib
from collections.abc import Callable, Coroutine, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers import das16jr
from drivers.das16jr import FrameError, FrameParser, Settings, connect, parse_answer, parse_frame, parse_header
from fixtures.das16jr import Das16jr
from rig.errors import (
    AcquisitionFailed,
    BadReply,
    Disconnected,
    InstrumentError,
    NoAnswer,
    SettingRefused,
    WrongIdentity,
)
from rig.room import Confirmation, Request, Room

NAMES = ("tag", *(f"sine_{slot}" for slot in range(1, 16)))
EPOCH = 1_793_606_400.0


class Sines:
    """A world of one sine on every wire but the tag, with virtual time and nothing else."""

    def __init__(self) -> None:
        self.now = 10.0
        self.faults: dict[str, Any] = {}
        self.events: list[str] = []
        self.cables = NAMES
        self.level = 1.0
        self._subscribers: list[Callable[[float, float], None]] = []

    def advance(self, seconds: float) -> None:
        for subscriber in self._subscribers:
            subscriber(self.now, self.now + seconds)
        self.now += seconds

    def subscribe(self, callback: Callable[[float, float], None]) -> None:
        self._subscribers.append(callback)

    def log(self, event: str, **details: Any) -> None:
        self.events.append(event)

    def volts(self, names: Sequence[str], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
        return [
            np.full(len(when), 2.5) if name == "tag" else self.level * np.sin(2 * np.pi * 50.0 * when)
            for name, when in zip(names, times, strict=True)
        ]


class Desk:
    """The twin, served from a loop in a thread of its own; also the bench's clock, as the control socket is."""

    def __init__(self) -> None:
        self.world = Sines()
        self.twin = Das16jr(self.world)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._servers: list[asyncio.Server] = []
        self.twin.data_port = self.do(self._listen(self.twin.connect_data))
        self.port = self.do(self._listen(self.twin.connect_control))

    def do(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result(10.0)

    async def _listen(self, factory: Callable[[], asyncio.Protocol]) -> int:
        server = await asyncio.get_running_loop().create_server(factory, "127.0.0.1", 0)
        self._servers.append(server)
        return int(server.sockets[0].getsockname()[1])

    async def _advance(self, seconds: float) -> None:
        self.world.advance(seconds)

    async def _hang_up(self) -> None:
        for server in self._servers:
            server.close()

    def now(self) -> float:
        return EPOCH + self.world.now

    def sleep(self, seconds: float) -> None:
        self.do(self._advance(seconds))

    def ask(self, request: Request) -> Confirmation:
        raise AssertionError("nobody is asked")

    def close(self) -> None:
        self.do(self._hang_up())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10.0)
        self._loop.close()


@pytest.fixture
def desk() -> Iterator[Desk]:
    made = Desk()
    yield made
    made.close()


@pytest.fixture
def board(desk: Desk) -> Iterator[das16jr.Das16jr]:
    made = open_board(desk)
    yield made
    made.close()


def open_board(desk: Desk, timeout: str = "1 s", **more: Any) -> das16jr.Das16jr:
    settings = Settings(address=f"127.0.0.1:{desk.port}", timeout=timeout, **more)
    return connect("recorder", settings, Room(desk, desk))


def frame(kind: int, run: int, index: int, payload: bytes, flags: int = 0) -> bytes:
    """A frame as the page "On the wire" has it."""
    head = struct.pack("<4sHHIQQIHHI", b"RDAQ", 1, kind, run, index, 123, 20_000, 16, flags, len(payload))
    return head + struct.pack("<I", zlib.crc32(head + bytes(4) + payload)) + payload


# --- frames -----------------------------------------------------------------------------------------------------------


def test_a_header_is_44_bytes() -> None:
    assert das16jr.HEADER.size == 44


payloads = st.lists(
    st.tuples(st.integers(0, 2), st.binary(max_size=200).map(lambda b: b[: len(b) // 2 * 2])), max_size=8
)


@given(payloads, st.lists(st.integers(0, 3000), max_size=10))
def test_frames_come_out_whole_however_the_bytes_are_cut(frames: list[tuple[int, bytes]], cuts: list[int]) -> None:
    stream = b"".join(frame(kind, 7, n, payload) for n, (kind, payload) in enumerate(frames))
    bounds = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    parser = FrameParser()
    found = [one for a, b in pairwise(bounds) for one in parser.feed(stream[a:b])]
    assert [(one.kind, one.index, one.payload) for one in found] == [
        (kind, n, payload) for n, (kind, payload) in enumerate(frames)
    ]
    assert not parser.damage


@given(st.integers(0, 99), st.integers(1, 255))
def test_no_changed_byte_goes_unnoticed(at: int, change: int) -> None:
    sound = frame(1, 1, 0, bytes(range(56)))
    damaged = bytearray(sound)
    damaged[at] ^= change
    parser = FrameParser()
    found = parser.feed(bytes(damaged) + sound)
    assert parser.damage or not found  # a longer length only makes it wait for more


@given(st.binary(max_size=300))
def test_noise_is_damage_or_not_yet_a_frame(data: bytes) -> None:
    parser = FrameParser()
    assert parser.feed(data) == []
    assert parser.feed(data) == [] or not parser.damage


def test_sound_frames_before_the_damage_are_kept() -> None:
    parser = FrameParser()
    found = parser.feed(frame(1, 1, 0, b"\1\2") + b"garbage" * 10)
    assert [one.codes.tolist() for one in found] == [[513]]
    assert "RDAQ" in parser.damage


@pytest.mark.parametrize(
    "change",
    [lambda f: b"XDAQ" + f[4:], lambda f: f[:4] + b"\2" + f[5:], lambda f: f[:6] + b"\7" + f[7:]],
    ids=["magic", "version", "kind"],
)
def test_a_header_of_something_else_is_refused(change: Callable[[bytes], bytes]) -> None:
    with pytest.raises(FrameError):
        parse_header(change(frame(1, 1, 0, b""))[:44])


def test_half_a_conversion_is_no_payload() -> None:
    with pytest.raises(FrameError, match="whole conversions"):
        parse_frame(frame(1, 1, 0, b"abc"))


def test_answers_are_ok_or_err() -> None:
    assert parse_answer(b"OK 20000") == (True, "20000")
    assert parse_answer(b"OK") == (True, "")
    assert parse_answer(b'ERR -222,"Out of range"') == (False, '-222,"Out of range"')
    with pytest.raises(ValueError, match="OK or ERR"):
        parse_answer(b"hello")


# --- the driver -------------------------------------------------------------------------------------------------------


def test_the_twin_says_who_it_is(board: das16jr.Das16jr) -> None:
    identity = board.identify()
    assert (identity.model, identity.serial) == ("PC104-DAS16JR/16", "SIM-DAS-1")


def test_the_conversion_period_is_read_back(board: das16jr.Das16jr) -> None:
    timing = board.configure(rate=3125.0, channels=NAMES)
    assert timing.convert_period == pytest.approx(20e-6)
    assert timing.scan_rate == pytest.approx(3125.0)
    fourteen = board.configure(rate=3125.0, channels=NAMES[:14])
    assert fourteen.scan_rate == pytest.approx(3132.83, abs=0.01)  # what a 10 MHz pacer makes of it
    assert board.settings()["last"] == 13


def test_every_channel_is_sampled_at_its_own_instants(desk: Desk, board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    board.start(1000)
    samples = board.read(1000)
    assert samples.counts.shape == (1000, 16)
    assert samples.flags == {"last"}
    for name in ("sine_1", "sine_15"):
        expected = np.sin(2 * np.pi * 50.0 * (samples.start - EPOCH + samples.instants(name)))
        assert samples.volts(name) == pytest.approx(expected, abs=2e-4)
    assert samples.volts("tag") == pytest.approx(2.5, abs=2e-4)
    assert not samples.counts.flags.writeable


def test_reading_in_pieces_gives_the_same_scans_as_reading_at_once(desk: Desk, board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    board.start(2000)
    pieces = [board.read(n) for n in (1, 7, 300, 1692, 50)]
    assert [piece.first_scan for piece in pieces] == [0, 1, 8, 308, 2000]
    assert [len(piece.counts) for piece in pieces] == [1, 7, 300, 1692, 0]
    assert ["last" in piece.flags for piece in pieces] == [False, False, False, True, True]
    counts = np.concatenate([piece.counts for piece in pieces])
    start = pieces[0].start - EPOCH
    expected = np.sin(2 * np.pi * 50.0 * (start + pieces[0].timing.instants(3, 2000)))
    assert counts[:, 3] / 65535 * 20 - 10 == pytest.approx(expected, abs=2e-4)


def test_waiting_takes_the_time_the_data_need_and_little_more(desk: Desk, board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    board.start(3125)
    begun = desk.now()
    board.read(3125)
    assert 1.0 <= desk.now() - begun <= 1.1


def test_the_same_conversation_takes_the_same_virtual_time_to_the_last_bit() -> None:
    ends = []
    for _ in range(3):
        desk = Desk()
        board = open_board(desk)
        board.configure(rate=3125.0, channels=NAMES)
        board.start(4000)
        desk.sleep(0.7)
        for scans in (100, 1000, 900, 2000):
            board.read(scans)
        ends.append(desk.now())
        board.close()
        desk.close()
    assert len(set(ends)) == 1


def test_an_endless_record_ends_when_it_is_stopped(board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    board.start(None)
    assert len(board.read(500).counts) == 500
    assert board.state == "running"
    board.stop()
    rest = board.received()
    assert rest.first_scan == 500
    assert "last" in rest.flags
    assert board.state == "stopped"
    assert "last" in board.read(10).flags


def test_one_record_after_another(board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    for _ in range(3):
        board.start(400)
        assert len(board.read(400).counts) == 400
    board.start(None)
    board.read(10)
    board.start(100)  # stops the endless one
    assert board.read(100).first_scan == 0
    assert board.metadata["convert_ns"] == 20_000


def test_clipped_codes_are_flagged_and_kept_raw(desk: Desk, board: das16jr.Das16jr) -> None:
    desk.world.level = 12.0
    board.configure(rate=3125.0, channels=NAMES)
    board.start(200)
    samples = board.read(200)
    assert "clipped" in samples.flags
    assert samples.clipped("sine_4") > 0
    assert samples.counts.max() == 65535


@pytest.mark.parametrize(("scan", "slot"), [(700, 5), (700, 0), (700, 15), (0, 3), (998, 15)])
def test_a_lost_conversion_is_named_by_its_scan_and_the_scans_before_are_kept(
    desk: Desk, board: das16jr.Das16jr, scan: int, slot: int
) -> None:
    desk.world.faults["das16jr.slip"] = [scan, slot]
    board.configure(rate=3125.0, channels=NAMES)
    board.start(1000)
    bad = scan if slot == 0 else scan + 1  # whose tag is not where it should be
    with pytest.raises(AcquisitionFailed, match=rf"channel 'tag' in scan {bad}\b"):
        board.read(1000)
    good = board.received()
    assert len(good.counts) == max(bad - 1, 0)
    assert good.flags == {"slip"}
    assert good.volts("tag") == pytest.approx(2.5, abs=2e-4)
    with pytest.raises(AcquisitionFailed):
        board.read(1)
    assert board.state == "slip"


def test_a_slip_later_than_what_is_read_does_not_spoil_it(desk: Desk, board: das16jr.Das16jr) -> None:
    desk.world.faults["das16jr.slip"] = 700
    board.configure(rate=3125.0, channels=NAMES)
    board.start(1000)
    assert len(board.read(650).counts) == 650
    with pytest.raises(AcquisitionFailed, match=r"scan 701\b"):
        board.read(350)
    assert len(board.received().counts) == 50


def test_an_overflow_of_the_board_ends_the_record_with_its_name(desk: Desk, board: das16jr.Das16jr) -> None:
    desk.world.faults["das16jr.overflow"] = 500
    board.configure(rate=3125.0, channels=NAMES)
    board.start(1000)
    with pytest.raises(AcquisitionFailed, match="overflow of the board's buffer"):
        board.read(1000)
    assert board.state == "overflow"
    assert len(board.received().counts) == 499  # the last one has no tag after it to prove it
    board.start(100)
    assert len(board.read(100).counts) == 100


@pytest.mark.parametrize(("factor", "scans"), [(True, 50), (True, 2000), (0.1, 500), (0.1, 2000), (1.1, 3000)])
def test_a_wrong_pacer_clock_is_an_error_that_names_the_jumper(
    desk: Desk, board: das16jr.Das16jr, factor: float, scans: int
) -> None:
    desk.world.faults["das16jr.clock"] = factor
    board.configure(rate=3125.0, channels=NAMES)
    board.start(None)
    with pytest.raises(AcquisitionFailed, match="1/10 MHz pacer clock jumper"):
        board.read(scans)
    assert board.state == "clock"


def test_a_damaged_frame_ends_the_record_and_the_next_one_is_sound(desk: Desk, board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    board.start(None)
    board.read(100)
    desk.world.faults["das16jr.corrupt"] = True
    with pytest.raises(BadReply, match="CRC-32"):
        board.read(1000)
    assert board.state == "corrupt"
    assert len(board.received().counts) > 0
    board.start(100)
    assert len(board.read(100).counts) == 100


def test_a_connection_that_breaks_in_mid_frame_is_disconnected_and_nothing_is_lost(
    desk: Desk, board: das16jr.Das16jr
) -> None:
    desk.world.faults["das16jr.drop"] = 600
    board.configure(rate=3125.0, channels=NAMES)
    board.start(1000)
    with pytest.raises(Disconnected, match="connection to last"):
        board.read(1000)
    assert len(board.received().counts) >= 590
    board.start(100)
    assert len(board.read(100).counts) == 100


def test_a_service_that_says_nothing_is_no_answer(desk: Desk) -> None:
    board = open_board(desk, timeout="50 ms")
    desk.world.faults["das16jr.silence"] = True
    with pytest.raises(NoAnswer, match=r"sent '\*IDN\?'"):
        board.identify()
    desk.world.faults.clear()
    assert board.identify().maker == "Measurement Computing"
    board.close()


def test_a_board_that_gives_no_data_is_no_answer_with_the_service_s_own_state(desk: Desk) -> None:
    board = open_board(desk, timeout="50 ms")
    board.configure(rate=3125.0, channels=NAMES)
    desk.world.faults["das16jr.silence"] = "data"
    board.start(100)
    with pytest.raises(NoAnswer, match="DONE"):
        board.read(100)
    board.close()


def test_a_period_that_changes_under_way_ends_the_record(desk: Desk, board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    board.start(None)
    before = board.read(500)
    desk.twin._convert_ns = 40_000
    with pytest.raises(AcquisitionFailed, match=r"16 channels every 40000 ns.*what was configured"):
        board.read(3000)
    assert len(before.counts) == 500


def test_conversions_that_are_missing_on_the_way_are_a_gap(desk: Desk, board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    board.start(None)
    board.read(100)
    desk.world.faults["das16jr.silence"] = "data"
    desk.sleep(0.2)
    desk.world.faults.clear()
    with pytest.raises(AcquisitionFailed, match="conversions without a gap"):
        board.read(2000)
    assert board.state == "gap"


@pytest.mark.parametrize(
    ("rate", "channels", "gain", "wanted"),
    [
        (3125.0, NAMES[1:], 0, "tag channel 'tag'"),
        (3125.0, (*NAMES, "more"), 0, "different names"),
        (3125.0, ("tag", "tag"), 0, "different names"),
        (7000.0, NAMES, 0, "conversions per second"),
        (0.0, NAMES, 0, "conversions per second"),
        (3125.0, NAMES, 9, "gain code"),
    ],
)
def test_a_bad_setting_is_refused_without_sending_it(
    board: das16jr.Das16jr, desk: Desk, rate: float, channels: tuple[str, ...], gain: int, wanted: str
) -> None:
    before = desk.now()
    with pytest.raises(SettingRefused, match=wanted):
        board.configure(rate=rate, channels=channels, gain=gain)
    assert desk.now() == before  # no command has taken its time


def test_a_record_before_configure_is_refused(board: das16jr.Das16jr) -> None:
    with pytest.raises(SettingRefused, match="configure first"):
        board.start(10)
    with pytest.raises(SettingRefused, match="started record"):
        board.read(10)


def test_another_gain_gives_another_range(board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES, gain=1)
    board.start(50)
    samples = board.read(50)
    assert (samples.channels[0].low, samples.channels[0].high) == (-5.0, 5.0)
    assert samples.volts("tag") == pytest.approx(2.5, abs=1e-4)


def test_a_second_client_can_look_but_not_start(desk: Desk, board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    board.start(None)
    other = open_board(desk)
    assert other.identify().model == "PC104-DAS16JR/16"
    with pytest.raises(InstrumentError):
        other.configure(rate=100.0, channels=NAMES)
    other.close()
    assert len(board.read(500).counts) == 500


def test_nobody_listening_is_disconnected() -> None:
    room = Room(Desk(), Desk())
    with pytest.raises(Disconnected, match="DAQ service at port 1 "):
        connect("recorder", Settings(address="127.0.0.1:1"), room)


def test_a_bench_that_ends_in_mid_run_is_disconnected(desk: Desk) -> None:
    board = open_board(desk)
    board.configure(rate=3125.0, channels=NAMES)
    board.start(None)

    async def vanish() -> None:
        data = desk.twin._data
        assert data is not None
        data.end()

    desk.do(vanish())
    with pytest.raises(Disconnected):
        board.read(1000)
    board.close()


class Impostor(asyncio.Protocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        assert isinstance(self.transport, asyncio.Transport)
        self.transport.write(b"OK Measurement Computing,USB-1608,1,2\n" if b"IDN" in data else b"what?\n")


def test_another_instrument_at_the_address_is_a_wrong_identity(desk: Desk) -> None:
    desk.port = desk.do(desk._listen(Impostor))
    board = open_board(desk)
    with pytest.raises(WrongIdentity, match="USB-1608"):
        board.identify()
    with pytest.raises(BadReply, match=r"sent 'CONF\?', received 'what\?'"):
        board.settings()
    board.close()


def test_every_message_is_understood_by_the_twin(desk: Desk, board: das16jr.Das16jr) -> None:
    board.configure(rate=3125.0, channels=NAMES)
    board.start(10)
    board.read(10)

    async def walk() -> list[str | None]:
        return [desk.twin.answer(message) for message in das16jr.MESSAGES]

    assert all(answer is not None and answer.startswith("OK") for answer in desk.do(walk()))
    assert board.errors() == []


def test_errors_of_the_service_can_be_read_and_are_then_gone(desk: Desk, board: das16jr.Das16jr) -> None:
    async def nonsense() -> str | None:
        return desk.twin.answer("CONF:RATE fast")

    assert desk.do(nonsense()) == 'ERR -222,"Out of range: wanted scans per second"'
    assert board.errors() == ['-222,"Out of range: wanted scans per second"']
    assert board.errors() == []


def test_a_client_that_does_not_read_loses_its_run_and_the_bench_goes_on(desk: Desk) -> None:
    desk.twin._queue = 100_000
    board = open_board(desk)
    board.configure(rate=6250.0, channels=NAMES)
    board.start(None)
    desk.sleep(60.0)  # 12 MB that nobody takes
    with pytest.raises(AcquisitionFailed, match="too slow"):
        board.read(60 * 6250)
    assert board.state == "slow"
    board.close()
