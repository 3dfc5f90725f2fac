"""Two GPIB twins behind a gateway on loopback, watching a plant small enough to work out by hand."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from fixtures.hp54542a import HP54542A
from fixtures.hp89410a import HP89410A
from fixtures.prologix import Prologix
from rig.errors import OperatorMissing
from rig.room import Confirmation, Request, Room

ADDRESSES = {"hp89410a": 19, "hp54542a": 7}


class Plant:
    """`one` is the source itself, `two` follows it with gain 2 and one pole at 400 Hz, `three` and `four` are DC."""

    def __init__(self) -> None:
        self.now, self.seed = 0.0, 7
        self.faults: dict[str, Any] = {}
        self.switched: list[bool] = []
        self.analyzer_inputs = ("one", "two")
        self.scope_inputs = ("one", "two", "three", "four")
        self.frequency, self.level, self.on = 100.0, 0.0, False
        self._subscribers: list[Callable[[float, float], None]] = []

    def response(self, frequency: float) -> complex:
        return 2.0 / (1 + 1j * frequency / 400.0)

    def advance(self, seconds: float) -> None:
        end = self.now + seconds
        for subscriber in self._subscribers:
            subscriber(self.now, end)
        self.now = end

    def subscribe(self, callback: Callable[[float, float], None]) -> None:
        self._subscribers.append(callback)

    def set_source(self, *, frequency: float, level: float, on: bool) -> None:
        self.frequency, self.level, self.on = frequency, level, on

    def log(self, event: str, **details: Any) -> None:
        self.switched.append(bool(details["on"]))

    def volts(self, names: Sequence[str], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        return [self.signal(name, np.asarray(when)) for name, when in zip(names, times, strict=True)]

    def signal(self, name: str, times: np.ndarray) -> np.ndarray:
        if name in ("three", "four"):
            return np.full(len(times), {"three": 1.25, "four": -30.0}[name])
        response = self.response(self.frequency) if name == "two" else 1.0
        level = self.level * self.on * abs(response)
        return level * np.sin(2 * np.pi * self.frequency * times + np.angle(response))


class Nobody:
    def ask(self, request: Request) -> Confirmation:
        raise OperatorMissing(request.text)


class Pages:
    """A transcript on paper."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, bytes]] = []

    def note(self, instrument: str, direction: str, data: bytes) -> None:
        self.lines.append((direction, data))

    def sent(self) -> list[bytes]:
        return [data for direction, data in self.lines if direction == "sent"]


class GpibBench:
    """The served gateway; its clock is the plant's, and everything of the plant happens in the server's thread."""

    def __init__(self) -> None:
        self.plant = Plant()
        self.twins: dict[str, Any] = {"hp89410a": HP89410A(self.plant), "hp54542a": HP54542A(self.plant)}
        self.adapter = Prologix(self.plant, {ADDRESSES[name]: twin for name, twin in self.twins.items()})
        self.pages = Pages()
        self.room = Room(self, Nobody(), self.pages)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._server = self.do(lambda: self._loop.create_server(self.adapter.connect, "127.0.0.1", 0))
        self.port = int(self._server.sockets[0].getsockname()[1])
        self._opened: list[Any] = []

    def do(self, action: Callable[[], Any]) -> Any:
        """Carry out something in the server's thread and give its result."""

        async def run() -> Any:
            result = action()
            return await result if asyncio.iscoroutine(result) else result

        return asyncio.run_coroutine_threadsafe(run(), self._loop).result(30)

    def now(self) -> float:
        return self.plant.now

    def sleep(self, seconds: float) -> None:
        self.do(lambda: self.plant.advance(seconds))

    def connect(self, driver: ModuleType, timeout: str = "3 s", **more: Any) -> Any:
        name = driver.__name__.rpartition(".")[2]
        gateway = f"PRLGX-TCPIP0::127.0.0.1::{self.port}::INTFC"
        where = {"address": f"GPIB0::{ADDRESSES[name]}::INSTR", "gateway": gateway, "timeout": timeout, **more}
        self._opened.append(driver.connect(name, driver.Settings.model_validate(where), self.room))
        return self._opened[-1]

    def close(self) -> None:
        for instrument in self._opened:
            instrument.close()
        self.do(self._server.close)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


@pytest.fixture
def gpib() -> Iterator[GpibBench]:
    bench = GpibBench()
    yield bench
    bench.close()
