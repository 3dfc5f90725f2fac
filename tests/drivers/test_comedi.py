"""The local board through comedilib's own calling convention, against a library made of callbacks."""

from __future__ import annotations

import ctypes
import ctypes.util
import errno
import math
import os
import select
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers import comedi
from drivers.comedi import Board, CommandStructure, Library, RangeStructure, Settings, cr_pack
from fixtures import comedi as fake
from rig.errors import AcquisitionFailed, NoAnswer, SettingRefused, WrongIdentity
from rig.room import Confirmation, Request, Room

NAMES = ("tag", *(f"sine_{slot}" for slot in range(1, 16)))


class Time:
    """Virtual time that is also the bench's clock; nothing else is in this world."""

    def __init__(self) -> None:
        self.world_now = 5.0
        self.faults: dict[str, Any] = {}
        self._subscribers: list[Callable[[float, float], None]] = []

    def subscribe(self, callback: Callable[[float, float], None]) -> None:
        self._subscribers.append(callback)

    def sleep(self, seconds: float) -> None:
        for subscriber in self._subscribers:
            subscriber(self.world_now, self.world_now + seconds)
        self.world_now += seconds

    def now(self) -> float:
        return self.world_now

    def monotonic_ns(self) -> int:
        return round(self.world_now * 1e9)


class World:
    """The same time as the fake library wants it."""

    def __init__(self, time: Time) -> None:
        self._time = time
        self.faults, self.subscribe = time.faults, time.subscribe

    @property
    def now(self) -> float:
        return self._time.world_now


class Nobody:
    def ask(self, request: Request) -> Confirmation:
        raise AssertionError("nobody is asked")


def signals(slots: Sequence[int], times: Sequence[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    return [
        np.full(len(when), 2.5) if slot == 0 else np.sin(2 * np.pi * 50.0 * when)
        for slot, when in zip(slots, times, strict=True)
    ]


class Rig:
    """Time, library, board and recorder, put together."""

    def __init__(self, **library: Any) -> None:
        self.time = Time()
        self.library = fake.Comedi(World(self.time), signals, **library)
        settings = Settings(timeout="50 ms")
        self.board = comedi.open_board("board", settings, Library(self.library), self.library.read)
        self.recorder = comedi.Comedi(self.board, settings, Room(self.time, Nobody()), self.time.monotonic_ns)


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    made.recorder.close()


# --- the binary interface ---------------------------------------------------------------------------------------------


@pytest.mark.skipif(ctypes.sizeof(ctypes.c_void_p) != 8, reason="64-bit layout")
def test_structures_lie_in_memory_as_comedi_h_says() -> None:
    assert ctypes.sizeof(CommandStructure) == 80
    assert [getattr(CommandStructure, name).offset for name in ("subdev", "convert_arg", "stop_arg")] == [0, 28, 44]
    offsets = [getattr(CommandStructure, name).offset for name in ("chanlist", "chanlist_len", "data", "data_len")]
    assert offsets == [48, 56, 64, 72]
    assert ctypes.sizeof(RangeStructure) == 24


def test_cr_pack_is_reference_range_channel() -> None:
    assert cr_pack(3, 2, 1) == 1 << 24 | 2 << 16 | 3


def test_the_real_library_has_every_function_and_its_own_error_texts() -> None:
    try:
        library = comedi.load("libcomedi.so.0")
    except OSError:
        pytest.skip("libcomedi.so.0 is not installed (Debian package libcomedi0)")
    assert library.comedi_open(b"/dev/no-such-board") is None
    assert library.comedi_errno() == errno.ENOENT
    assert b"No such file" in library.comedi_strerror(errno.ENOENT)
    with pytest.raises(NoAnswer, match="No such file"):
        comedi.open_board("board", Settings(device="/dev/no-such-board"), library)
    with pytest.raises(NoAnswer, match="error 25"):
        comedi.open_board("board", Settings(device="/dev/null"), library)


def test_a_missing_library_says_which_package_has_it() -> None:
    with pytest.raises(NoAnswer, match="libcomedi0"):
        comedi.connect("board", Settings(library="libno-such-thing.so.9"), Room(Time(), Nobody()))


def test_a_library_that_is_not_comedi_is_refused() -> None:
    path = ctypes.util.find_library("c")
    assert path is not None
    with pytest.raises(OSError, match="not comedilib"):
        comedi.load(path)


def test_a_node_that_is_not_there_shows_comedi_s_own_words() -> None:
    library = Library(fake.Comedi(World(Time()), signals))
    with pytest.raises(NoAnswer, match="No such file"):
        comedi.open_board("board", Settings(device="/dev/comedi7"), library)


def test_comedi_s_own_conversion_has_no_number_for_the_end_codes_so_codes_stay_raw(rig: Rig) -> None:
    bounds = ctypes.pointer(fake.RangeMemory(-10.0, 10.0, 0))
    volts = [rig.library.comedi_to_phys(code, bounds, 65535) for code in (0, 32768, 65535)]
    assert math.isnan(volts[0])
    assert math.isnan(volts[2])
    assert volts[1] == pytest.approx(152.6e-6, abs=1e-7)
    assert rig.library.comedi_set_global_oor_behavior(0) == 1
    assert rig.library.comedi_to_phys(0, bounds, 65535) == -10.0


# --- the recorder -----------------------------------------------------------------------------------------------------


def test_it_says_what_comedi_says_it_is(rig: Rig) -> None:
    identity = rig.recorder.identify()
    assert (identity.model, identity.firmware) == ("PC104-DAS16JR/16", "das16")


def test_another_board_is_a_wrong_identity(rig: Rig) -> None:
    rig.board.name = "das08"
    with pytest.raises(WrongIdentity, match="das08"):
        rig.recorder.identify()


@pytest.mark.parametrize(
    ("clock", "channels", "rate"),
    [(1_000_000, 16, 3125.0), (1_000_000, 14, 3246.753), (10_000_000, 14, 3132.832), (1_000_000, 15, 3174.603)],
)
def test_the_rate_is_what_the_counters_make_of_it(clock: int, channels: int, rate: float) -> None:
    rig = Rig(clock=clock)
    timing = rig.recorder.configure(rate=3125.0, channels=NAMES[:channels])
    assert timing.scan_rate == pytest.approx(rate, abs=1e-3)
    assert rig.recorder.settings()["convert_period"] == pytest.approx(timing.convert_period)
    rig.recorder.close()


def test_every_channel_is_sampled_at_its_own_instants(rig: Rig) -> None:
    rig.recorder.configure(rate=3125.0, channels=NAMES)
    rig.recorder.start(1000)
    pieces = [rig.recorder.read(n) for n in (333, 667)]
    assert pieces[-1].flags == {"last"}
    for piece in pieces:
        for name in ("sine_1", "sine_15"):
            expected = np.sin(2 * np.pi * 50.0 * (piece.start + piece.instants(name)))
            assert piece.volts(name) == pytest.approx(expected, abs=2e-4)


def test_one_record_after_another_on_the_same_descriptor(rig: Rig) -> None:
    rig.recorder.configure(rate=3125.0, channels=NAMES)
    descriptor = rig.board.fileno()
    for _ in range(3):
        rig.recorder.start(200)
        assert len(rig.recorder.read(200).counts) == 200
        assert rig.recorder.state == "done"
    assert rig.board.fileno() == descriptor


def test_an_endless_record_ends_when_it_is_stopped(rig: Rig) -> None:
    rig.recorder.configure(rate=3125.0, channels=NAMES)
    rig.recorder.start(None)
    rig.recorder.read(100)
    rig.recorder.stop()
    assert "last" in rig.recorder.received().flags
    assert rig.recorder.state == "stopped"


def test_an_overflow_lets_the_buffer_be_read_and_is_then_an_error() -> None:
    rig = Rig(buffer=64_000)
    rig.recorder.configure(rate=3125.0, channels=NAMES)
    rig.recorder.start(None)
    rig.time.sleep(3.0)  # 300 kB into a buffer of 64 kB
    with pytest.raises(AcquisitionFailed, match="EPIPE"):
        rig.recorder.read(9000)
    assert rig.recorder.state == "overflow"
    assert len(rig.recorder.received().counts) == 1875  # twelve lumps of 2500, and the tag of the next scan
    rig.recorder.start(100)
    assert len(rig.recorder.read(100).counts) == 100
    rig.recorder.close()


def test_the_kernel_s_end_of_a_command_is_data_then_zero(rig: Rig) -> None:
    rig.board.set_up(0, 15, 0, 320_000)
    rig.board.start(100)
    rig.time.sleep(1.0)
    data = bytearray()
    while select.select([rig.board.fileno()], [], [], 0)[0] and (lump := rig.board.read()):
        data += lump
    assert len(data) == 3200
    assert rig.board.read() == b""


def test_a_lost_conversion_is_named_by_its_scan(rig: Rig) -> None:
    rig.recorder.configure(rate=3125.0, channels=NAMES)
    rig.time.faults["das16jr.slip"] = 300
    rig.recorder.start(1000)
    with pytest.raises(AcquisitionFailed, match=r"in scan 301\b"):
        rig.recorder.read(1000)
    assert len(rig.recorder.received().counts) == 300


@pytest.mark.parametrize("factor", [True, 0.1])
def test_a_wrong_pacer_clock_is_an_error_that_names_the_jumper(rig: Rig, factor: float) -> None:
    rig.time.faults["das16jr.clock"] = factor
    with pytest.raises(AcquisitionFailed, match="pacer clock jumper"):
        rig.recorder.configure(rate=3125.0, channels=NAMES)


def test_a_board_without_data_is_no_answer(rig: Rig) -> None:
    rig.recorder.configure(rate=3125.0, channels=NAMES)
    rig.recorder.start(100)
    rig.time._subscribers.clear()  # the board's time stands still
    with pytest.raises(NoAnswer, match="no data for"):
        rig.recorder.read(100)


def test_other_errors_of_read_end_the_record_as_failed() -> None:
    rig = Rig()

    present = True

    def detached(descriptor: int, size: int) -> bytes:
        if present:
            return rig.library.read(descriptor, size)
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))

    settings = Settings(timeout="50 ms")
    rig.recorder.close()
    board = Board("board", settings, Library(rig.library), detached)
    recorder = comedi.Comedi(board, settings, Room(rig.time, Nobody()), rig.time.monotonic_ns)
    recorder.configure(rate=3125.0, channels=NAMES)
    recorder.start(100)
    present = False
    with pytest.raises(AcquisitionFailed, match="No such device"):
        recorder.read(100)
    assert recorder.state == "failed"
    recorder.close()


@pytest.mark.parametrize(
    ("rate", "channels", "gain", "wanted"),
    [
        (3125.0, NAMES[1:], 0, "tag channel"),
        (7000.0, NAMES, 0, "conversions per second"),
        (3125.0, NAMES, 8, "gain code 0…7"),
    ],
)
def test_a_bad_setting_is_refused(rig: Rig, rate: float, channels: tuple[str, ...], gain: int, wanted: str) -> None:
    with pytest.raises(SettingRefused, match=wanted):
        rig.recorder.configure(rate=rate, channels=channels, gain=gain)


def test_what_the_driver_objects_to_is_said_in_words(rig: Rig) -> None:
    with pytest.raises(SettingRefused, match="not consecutive"):
        rig.board.set_up(10, 17, 0, 320_000)


def test_every_function_is_in_the_fake_library() -> None:
    library = fake.Comedi(World(Time()), signals)
    assert all(hasattr(library, name) for name in comedi.MESSAGES)
