"""The DAQ path, 16 channels: from the service to closed block files, against real time (3125 scans/s, 50 kS/s)."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers import daq_service, das16jr
from rig.bench import control
from rig.room import Confirmation, Request, Room

CHANNELS = 16
REAL_TIME = 3125.0 * CHANNELS  # conversions per second
BAR = 20.0  # times real time, which is 1 MS/s
BLOCK = 62_500  # scans: 2 MB
SCANS = 500_000  # 160 s of real time, 16 MB: less than the service's queue, so that even a slow client loses nothing
RUNS = 4
MEMORY = 100 << 20  # bytes that all of it may add: the service's queue, the client's pieces and one block
NAMES = ("tag", *(f"channel_{slot}" for slot in range(1, CHANNELS)))


class Tape:
    """A board that has recorded its lumps before and gives them as fast as they are taken; scan numbers in 1 and 2."""

    name, driver, serial, clock = "pc104-das16jr/16", "tape", "1", 1_000_000

    def __init__(self, scans: int) -> None:
        codes = np.full((scans, CHANNELS), 30_000, np.uint16)
        numbers = np.arange(scans, dtype=np.uint32)
        codes[:, 0], codes[:, 1], codes[:, 2] = 40_959, numbers & 0xFFFF, numbers >> 16
        self._data = memoryview(codes.tobytes())
        self._at = 0
        self._reading, self._writing = os.pipe()
        os.write(self._writing, b"1")  # always readable

    def range(self, gain: int) -> tuple[float, float]:
        return -10.0, 10.0

    def set_up(self, first: int, last: int, gain: int, scan_ns: int) -> int:
        return 20_000

    def start(self, scans: int) -> None:
        self._at = 0

    def fileno(self) -> int:
        return self._reading

    def read(self) -> bytes:
        lump = bytes(self._data[self._at : self._at + 5002])  # as the kernel's timer gives them, and splitting scans
        self._at += len(lump)
        return lump

    def monotonic_ns(self) -> int:
        return self._at // 2 * 20_000

    def cancel(self) -> None:
        self._at = len(self._data)

    def close(self) -> None:
        os.close(self._reading)
        os.close(self._writing)


class NoTime:
    """A bench clock on which everything has happened already."""

    def now(self) -> float:
        return 0.0

    def sleep(self, seconds: float) -> None:
        return None

    def ask(self, request: Request) -> Confirmation:
        raise AssertionError("nobody is asked")


def served(tape: Tape) -> tuple[int, Callable[[], None]]:
    """The real service in a thread of its own; its port, and how to end it."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    service = daq_service.Service(tape, monotonic_ns=tape.monotonic_ns)
    listening = asyncio.run_coroutine_threadsafe(daq_service.listen(service, "127.0.0.1", 0), loop).result(10.0)

    async def hang_up() -> None:
        service.close()
        for server in listening:
            server.close()

    def end() -> None:
        asyncio.run_coroutine_threadsafe(hang_up(), loop).result(10.0)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()

    return int(listening[0].sockets[0].getsockname()[1]), end


def blocks(board: das16jr.Das16jr, scans: int, folder: Path) -> Iterator[Path]:
    """One record, written to closed and synced files."""
    board.start(scans)
    for first in range(0, scans, BLOCK):
        samples = board.read(BLOCK)
        path = folder / f"{first}.u16"
        with path.open("wb") as file:
            file.write(memoryview(samples.counts))
            file.flush()
            os.fsync(file.fileno())
        yield path


def scan_numbers(path: Path) -> NDArray[np.uint32]:
    counts = np.fromfile(path, np.uint16).reshape(-1, CHANNELS).astype(np.uint32)
    return np.asarray(counts[:, 1] | counts[:, 2] << 16, np.uint32)


def resident() -> int:
    """Memory that this process holds now (service and client together), bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_the_service_reaches_closed_blocks_at_twenty_times_real_time_without_losing_a_sample(tmp_path: Path) -> None:
    tape = Tape(SCANS + 1)
    port, end = served(tape)
    board = das16jr.connect("recorder", das16jr.Settings(address=f"127.0.0.1:{port}"), Room(NoTime(), NoTime()))
    board.configure(rate=3125.0, channels=NAMES)
    before, most, seconds = resident(), 0, 0.0
    for run in range(RUNS):
        folder = tmp_path / str(run)
        folder.mkdir()
        begun = time.perf_counter()
        written = []
        for path in blocks(board, SCANS, folder):
            written.append(path)
            most = max(most, resident())
        seconds += time.perf_counter() - begun
        assert np.array_equal(np.concatenate([scan_numbers(path) for path in written]), np.arange(SCANS))
    grown = most - before
    board.close()
    end()
    tape.close()
    rate = RUNS * SCANS * CHANNELS / seconds
    print(
        f"\nDAQ service to closed blocks: {rate / 1e6:.1f} MS/s, {rate / REAL_TIME:.0f} times real time "
        f"(bar {BAR:.0f}), {grown / 1e6:.0f} MB more memory"
    )
    assert rate >= BAR * REAL_TIME
    assert grown < MEMORY


def test_the_simulated_bench_reaches_closed_blocks_faster_than_real_time(
    own_bench: Callable[..., control.Addresses], tmp_path: Path
) -> None:
    addresses = own_bench()
    with control.Control(int(addresses["control"])) as link:
        clock = control.BenchClock(link)
        room = Room(clock, NoTime())
        board = das16jr.connect("recorder", das16jr.Settings(address=f"127.0.0.1:{addresses['daq']}"), room)
        board.configure(rate=3125.0, channels=NAMES)
        computed = float(link.ask("cost")["simulation_s"])
        begun = time.perf_counter()
        written = list(blocks(board, 4 * BLOCK, tmp_path))
        seconds = time.perf_counter() - begun
        computed = float(link.ask("cost")["simulation_s"]) - computed
        board.close()
    rate = 4 * BLOCK * CHANNELS / seconds
    print(
        f"\nsimulated bench to closed blocks: {rate / 1e6:.1f} MS/s, {rate / REAL_TIME:.0f} times real time, "
        f"{computed / seconds:.0%} of it spent on the world's signals"
    )
    assert sum(path.stat().st_size for path in written) == 4 * BLOCK * CHANNELS * 2
    assert rate >= BAR * REAL_TIME
