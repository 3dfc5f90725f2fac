"""One cell of the fault matrix: the program measures and concludes on a simulated bench that something is wrong with.

The bench is served in this process, in a thread of its own; the program is `rig` as a shell calls it, with its drivers,
its guard and its archive. Between them stands a proxy on every line (`wire_proxy`), and the world may be miswired
(`miswired`) or have faults of its twins. What comes back is what the program said, and what was true.
"""

from __future__ import annotations

import asyncio
import contextlib
import copy
import json
import threading
import time
import traceback
from collections.abc import Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import yaml
from in_process import Done, rig
from miswired import Wrong, WrongWorld
from wire_proxy import TURNS, Bus, Frames, Lines, Proxy, Spoilt, Stuffed

from fixtures import serve
from rig.cli import outcome

CONFIGS = Path(__file__).parents[1] / "configs"
SEED = 3
LANGUAGES: Mapping[str, Callable[[], Any]] = {
    "gpib": Bus, "daq": Lines, "data": Frames, "ldv": Lines, "cube": Stuffed, "control": Lines,
}  # fmt: skip
PROMPT = {"gpib": "3 s", "daq": "3 s", "data": "3 s", "ldv": "3 s", "cube": "3 s"}
"""How long a driver waits for an answer here: long enough for a busy machine, and the same for all."""

PROCEDURES: Mapping[str, Mapping[str, Any]] = {
    "sweep": {"procedure": "frequency_sweep", "axis": "x", "points": 3, "levels": ["full"], "static": "4 s",
              "static_after": "0 s"},
    "turntable": {"procedure": "turntable", "revolutions": 6, "rest": "4 s"},
    "tumble": {"procedure": "tumble", "record": "1 s"},
    "noise": {"procedure": "noise", "length": "5 s"},
    "sweep by the oscilloscope": {"procedure": "frequency_sweep", "axis": "x", "points": 3, "levels": ["full"],
                                  "static": "0 s", "static_after": "0 s"},
    "tumble by the cube": {"procedure": "tumble", "record": "1 s"},
}  # fmt: skip
RECORDERS = {"sweep by the oscilloscope": ["scope"], "tumble by the cube": ["cube"]}
"""Of procedures that others keep than the bench's."""


@dataclass(frozen=True, eq=False)
class Cell:
    """What is wrong, in whose hands, while what is measured. `line` is where `spoilt` is spoilt; `plants` are faults of
    the twins, by name; a `pty` stands in for the sockets of serial lines.
    """

    procedure: str
    instrument: str
    fault: str
    line: str = ""
    spoilt: Spoilt | None = None
    wrong: Wrong = field(default_factory=Wrong)
    plants: Mapping[str, Any] = field(default_factory=dict)
    pty: bool = False

    @property
    def name(self) -> str:
        return f"{self.procedure}: {self.instrument}, {self.fault}"


@dataclass(frozen=True)
class Said:
    """What the program said in the end, and what was true: `rows` and `flags` are those of the calibration."""

    code: int
    stderr: str
    calibrated: int
    calibrated_stderr: str
    rows: list[dict[str, Any]]
    flags: list[str]
    truth: dict[str, Any]
    injected: int
    """How often something was spoilt on a line."""
    seconds: float
    """Processor time, without that of the guard."""


class _Forgetful:
    """No memory is kept."""

    def changed(self) -> None:
        """Nothing is saved."""


class Served:
    """The bench and its proxies in a thread; `addresses` are those that a program finds."""

    def __init__(self, world: WrongWorld, line: str = "", spoilt: Spoilt | None = None, pty: bool = False) -> None:
        self._bench = serve.Bench(world)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._host = serve.Host(self._bench, _Forgetful(), 0)  # type: ignore[arg-type]
        self.proxies: dict[str, Proxy] = {}
        self.addresses = self._do(self._listen(line, () if spoilt is None else (spoilt,), pty))

    def _do(self, action: Awaitable[Any]) -> Any:
        async def done() -> Any:
            return await action

        return asyncio.run_coroutine_threadsafe(done(), self._loop).result(60)

    async def _listen(self, line: str, spoilt: tuple[Spoilt, ...], pty: bool) -> dict[str, Any]:
        found = await self._host.listen(dict.fromkeys(serve.SERVICES, 0))
        targets = {"gpib": found["gpib"], "daq": found["daq"], "data": self._bench.daq.data_port,
                   "ldv": found["ldv_tcp"], "cube": found["cube_tcp"], "control": found["control"]}  # fmt: skip
        for name, target in targets.items():
            self.proxies[name] = Proxy(LANGUAGES[name], int(target), spoilt if name == line else ())
        self.proxies["daq"].renamed = self.proxies["data"]
        self.proxies["control"].turns = TURNS
        ports = {name: await one.listen() for name, one in self.proxies.items() if not (pty and name == "ldv")}
        self._bench.daq.data_port = ports["data"]
        ldv: int | str = await self.proxies["ldv"].terminal() if pty else f"socket://127.0.0.1:{ports['ldv']}"
        return {"pid": found["pid"], "control": ports["control"], "gpib": ports["gpib"], "daq": ports["daq"],
                "ldv": ldv, "ldv_tcp": ports.get("ldv", 0), "cube": "", "cube_tcp": ports["cube"]}  # fmt: skip

    async def _end(self) -> None:
        for proxy in self.proxies.values():
            proxy.close()
        self._host.close()
        await asyncio.sleep(0)
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    def close(self) -> None:
        """Stop serving."""
        self._do(self._end())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


@contextlib.contextmanager
def served(cell: Cell, folder: Path) -> Iterator[tuple[Served, WrongWorld]]:
    """The bench of a cell, found by a program that keeps its runs in `folder`/runs; its bench file stands there too."""
    world = WrongWorld(SEED, copy.deepcopy(cell.wrong))
    world.faults.update(cell.plants)
    bench = Served(world, cell.line, cell.spoilt, cell.pty)
    try:
        state = folder / "runs" / ".bench" / "simulated"
        state.mkdir(parents=True)
        (state / "addresses.json").write_text(json.dumps(bench.addresses))
        (folder / "bench.yaml").write_text(yaml.safe_dump(_bench_file(cell), allow_unicode=True))
        (folder / "procedure.yaml").write_text(yaml.safe_dump(dict(PROCEDURES[cell.procedure]), allow_unicode=True))
        yield bench, world
    finally:
        bench.close()


def carried_out(cell: Cell, folder: Path) -> Said:
    """Measure and calibrate; `folder` is empty.

    Table and figures of the run alone, more than half of the work, are made without a fault only: what is judged is the
    calibration.
    """
    began = time.process_time()
    environment = {"XDG_RUNTIME_DIR": str(folder)}
    silent = mock.patch.object(outcome, "present", return_value=None)
    with served(cell, folder) as (bench, world), silent if cell.fault != "none" else contextlib.nullcontext():
        ran = _rig("run", "procedure.yaml", "--bench", "bench.yaml", folder=folder, **environment)
        made = _rig("calibrate", "last", folder=folder, **environment)
        injected = sum(len(proxy.injected) for proxy in bench.proxies.values())
        truth = {key: value for key, value in world.truth.items() if key in ("sensitivity", "pole")}
    found = json.loads(made.stdout) if made.stdout else {"results": [], "flags": []}
    seconds = time.process_time() - began
    return Said(
        ran.returncode, ran.stderr, made.returncode, made.stderr, found["results"], found["flags"], truth, injected,
        seconds,
    )  # fmt: skip


def _rig(*words: str, folder: Path, **environment: str) -> Done:
    """As a shell would see it, also where it ends by an error that is not deliberate."""
    try:
        return rig(*words, "--runs", "runs", "--json", folder=folder, **environment)
    except Exception:  # noqa: BLE001 - whatever it is, it is what the matrix looks for
        return Done(1, "", traceback.format_exc())


def _bench_file(cell: Cell) -> dict[str, Any]:
    """The simulated bench's, with shorter waits, its other files where they are."""
    file: dict[str, Any] = yaml.safe_load((CONFIGS / "benches" / "simulated.yaml").read_text(encoding="utf-8"))
    file["simulated"] = {"world": str(CONFIGS / "worlds" / "clean.yaml"), "seed": SEED}
    file["sensors"] = str(CONFIGS / "benches" / file["sensors"])
    file["standards"] = [str(CONFIGS / "benches" / one) for one in file["standards"]]
    file["recorders"] = RECORDERS.get(cell.procedure, file["recorders"])
    lines = {"analyzer": "gpib", "scope": "gpib", "recorder": "daq", "vibrometer": "ldv", "cube": "cube"}
    for role, line in lines.items():
        file["instruments"][role]["timeout"] = PROMPT[line]
    file["instruments"]["vibrometer"]["address"] = "${ldv}"
    return file
