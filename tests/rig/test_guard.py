"""The guard leaves the bench at rest, whatever becomes of the program.

The instrument is a stand-in behind a real socket; its driver is installed the way a user's own would be, as an entry
point of the group `rig.drivers`. At the end the same is shown with the analyzer of the simulated bench.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.bench import guard as guard_of
from rig.bench.armed import Armed, left_armed
from rig.bench.control import Addresses, Control
from rig.bench.guard import DYING, Charge, Guard, load_driver
from rig.bench.possession import Holder
from rig.errors import NotSafe, WorkFailed

DRIVER = '''
"""A source with two commands, on a socket."""
import socket
from pydantic import BaseModel, ConfigDict

class Settings(BaseModel):
    model_config = ConfigDict(extra="forbid")
    port: int

class Source:
    def __init__(self, link):
        self.link = link
    def make_safe(self):
        self.link.sendall(b"OUTP OFF\\n")
        if self.link.recv(16) != b"0\\n":
            raise ConnectionError("wanted 0")
    def close(self):
        self.link.close()

def connect(name, settings, room):
    return Source(socket.create_connection(("127.0.0.1", settings.port)))
'''

PROGRAM = """
import sys
from pathlib import Path
from rig.bench.control import Addresses, Control
from rig.bench.guard import Charge, Guard
with Guard.start() as guard:
    guard.arm([Charge("standin", "source", {"port": int(sys.argv[1])})], within=60.0, log=Path(sys.argv[2]))
    print(guard.pid, flush=True)
    sys.stdin.read()
"""


class Instrument:
    """The stand-in's end of the wire. The kernel takes connections; `answer` looks at the next one."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(20)
        self.port = self._server.getsockname()[1]

    def answer(self, reply: bytes | None = b"0\n") -> float:
        """Take one connection and its message; returns when the message was there (monotonic clock, s)."""
        link, _ = self._server.accept()
        with link:
            link.settimeout(20)
            assert link.recv(64) == b"OUTP OFF\n"
            arrived = time.monotonic()
            if reply is None:
                assert link.recv(1) == b""  # the other end is killed while it waits for ever
            else:
                link.sendall(reply)
        return arrived

    def answered_if_asked(self) -> None:
        """Take a connection if there is one."""
        if not self.untouched():
            self.answer()

    def untouched(self) -> bool:
        return not select.select([self._server], [], [], 0)[0]

    def close(self) -> None:
        self._server.close()


@pytest.fixture
def instrument() -> Iterator[Instrument]:
    stand_in = Instrument()
    yield stand_in
    stand_in.close()


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A distribution that offers the driver `standin`."""
    metadata = tmp_path / "site" / "standin-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: standin\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[rig.drivers]\nstandin = standin_driver\n")
    (tmp_path / "site" / "standin_driver.py").write_text(DRIVER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"), prepend=os.pathsep)


def charge(instrument: Instrument, name: str = "source") -> Charge:
    return Charge("standin", name, {"port": instrument.port})


def events(log: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.read_text().splitlines()]


def named(log: Path) -> list[str]:
    return [entry["event"] for entry in events(log)]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_the_source_is_off_within_a_tenth_of_a_second_after_the_program_is_killed(
    number: signal.Signals, instrument: Instrument, tmp_path: Path
) -> None:
    command = [sys.executable, "-c", PROGRAM, str(instrument.port), str(tmp_path / "guard.jsonl")]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, **pipes) as program:  # type: ignore[call-overload]
        program.stdout.readline()
        killed = time.monotonic()
        program.send_signal(number)
        assert instrument.answer() - killed < 0.1
        while "done" not in named(tmp_path / "guard.jsonl"):  # once more if it was only dying
            instrument.answered_if_asked()
        program.stdin.close()
        program.wait()
    found = events(tmp_path / "guard.jsonl")
    assert [one["event"] for one in found][:2] == ["armed", "acting"]
    first, last = ([one["event"] for one in found].index(what) for what in ("acting", "done"))
    safe = [n for n, one in enumerate(found) if one["event"] == "made safe"]
    gone = [n for n, one in enumerate(found) if one["event"] == "gone"]
    assert len(gone) == (found[first]["because"] == "the program is dying")
    assert first < safe[0] <= safe[-1] < last
    assert not gone or gone[0] < safe[-1]


def test_a_thread_that_ends_with_the_bench_armed_makes_the_guard_act(instrument: Instrument, tmp_path: Path) -> None:
    """Only the kernel's word tells it: the program goes on, and the pipe stays open."""
    log = tmp_path / "guard.jsonl"
    with Guard.start() as guard:
        if guard._lifeline is None:
            pytest.skip("no robust mutexes here")
        working = threading.Thread(target=lambda: guard.arm([charge(instrument)], log=log))
        working.start()
        working.join()
        instrument.answer()
        guard._process.stdin.close()  # type: ignore[union-attr]
        while "done" not in named(log):
            instrument.answered_if_asked()
    (acting,) = (one for one in events(log) if one["event"] == "acting")
    assert acting["because"] == DYING


def test_work_that_does_not_get_on_makes_the_guard_act_and_the_program_is_told(
    instrument: Instrument, tmp_path: Path
) -> None:
    with Guard.start() as guard:
        guard.arm([charge(instrument)], within=10.0, log=tmp_path / "guard.jsonl")
        guard.beat(within=0.0)
        instrument.answer()
        with pytest.raises(WorkFailed, match="guard"):
            guard.disarm()
    assert named(tmp_path / "guard.jsonl") == ["armed", "acting", "made safe", "done"]
    assert events(tmp_path / "guard.jsonl")[1]["because"] == "work has not got on from token 2 in time"


def test_what_hangs_is_acted_upon_within_five_seconds_by_the_times_that_the_guard_allows() -> None:
    assert guard_of.SILENCE < 5.0  # of a program that was stopped just after a heartbeat
    assert guard_of.PATIENCE + guard_of._BEAT < 5.0  # of work that hangs, by a token that came half a second late
    assert 4.0 * guard_of._BEAT < guard_of.SILENCE  # and some heartbeats may be late


def test_a_main_thread_that_waits_for_ever_is_found_though_others_go_on(instrument: Instrument, tmp_path: Path) -> None:
    over = threading.Event()
    with Guard.start() as guard:
        other = threading.Thread(target=lambda: [guard.expect() for _ in iter(lambda: over.wait(0.2), True)])
        guard.arm([charge(instrument)], log=tmp_path / "guard.jsonl")
        guard.beat(within=60.0)
        waits = time.monotonic()
        other.start()
        assert instrument.answer() - waits < 30.0  # its step may take 60 s; how soon on a quiet machine: bench_guard
        over.set()
        other.join()
    assert "work has not got on" in events(tmp_path / "guard.jsonl")[1]["because"]


def test_a_step_may_not_outlast_its_time_however_busy_it_looks(instrument: Instrument, tmp_path: Path) -> None:
    def busy() -> None:
        while True:
            guard.expect()
            instrument.answered_if_asked()

    with Guard.start() as guard:
        guard.arm([charge(instrument)], log=tmp_path / "guard.jsonl")
        guard.beat(within=1.0)
        with pytest.raises(WorkFailed, match="gone or has acted"):
            busy()


def test_what_was_announced_is_waited_for(instrument: Instrument, tmp_path: Path) -> None:
    with Guard.start() as guard:
        guard.arm([charge(instrument)], log=tmp_path / "guard.jsonl")
        guard.beat(within=0.5)
        guard.expect(60.0)  # a person is asked, in a step that was thought to be short
        time.sleep(2.0)
        guard.expect()
        guard.disarm()
    assert instrument.untouched()


def test_a_guard_that_is_killed_is_found_before_the_next_message(instrument: Instrument, tmp_path: Path) -> None:
    armed = an_armed(tmp_path)
    with Guard.start() as guard:
        guard.arm([charge(instrument)], log=tmp_path / "guard.jsonl", armed=armed)
        os.kill(guard.pid, signal.SIGKILL)
        guard._process.wait()
        with pytest.raises(WorkFailed, match="gone or has acted"):
            guard.expect()
    with pytest.raises(NotSafe, match="source: not read back as off; the guard has ended"):
        guard.how_left()
    found = left_armed([Path(armed.files[0])])
    assert found is not None
    assert "armed, and nobody has read it back as off" in str(found)


def test_what_is_armed_stands_in_a_file_until_it_was_read_back(instrument: Instrument, tmp_path: Path) -> None:
    armed = an_armed(tmp_path)
    with Guard.start() as guard:
        guard.arm([charge(instrument)], log=tmp_path / "guard.jsonl", armed=armed)
        assert left_armed([Path(armed.files[0])]) is not None
        guard.disarm()
    assert left_armed([Path(armed.files[0])]) is None
    assert guard.how_left() == "source: off, read back"
    with Guard.start() as guard:
        guard.arm([charge(instrument)], log=tmp_path / "guard.jsonl", armed=armed)
        guard._process.stdin.close()  # type: ignore[union-attr]  # what leaving the block does first
        instrument.answer()
    assert left_armed([Path(armed.files[0])]) is None
    assert guard.how_left() == "source: off, read back by the guard"


def an_armed(folder: Path) -> Armed:
    file = str(folder / "bench.armed")
    return Armed((file,), "stand-in", ("source",), str(folder / "guard.jsonl"), "", Holder.myself())


def test_nothing_of_the_working_folder_is_imported(
    instrument: Instrument, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "serial.py").write_text('raise SystemExit("a serial.py of the working folder was executed")')
    monkeypatch.chdir(tmp_path)
    with Guard.start() as guard:
        guard.arm([charge(instrument)], log=tmp_path / "guard.jsonl")
        guard.disarm()


def test_a_guard_that_was_disarmed_leaves_the_instrument_alone(instrument: Instrument, tmp_path: Path) -> None:
    with Guard.start() as guard:
        guard.arm([charge(instrument)], within=10.0, log=tmp_path / "guard.jsonl")
        guard.beat(within=5.0)
        guard.disarm()
    assert instrument.untouched()
    assert named(tmp_path / "guard.jsonl") == ["armed", "disarmed"]


def test_leaving_the_block_by_an_error_lets_the_guard_act(instrument: Instrument, tmp_path: Path) -> None:
    guard = Guard.start()
    guard.arm([charge(instrument)], within=10.0, log=tmp_path / "guard.jsonl")
    guard._process.stdin.close()  # type: ignore[union-attr]  # what leaving the block does first
    instrument.answer()
    with pytest.raises(ZeroDivisionError), guard:
        raise ZeroDivisionError
    assert named(tmp_path / "guard.jsonl")[-1] == "done"


def test_a_failed_attempt_is_repeated(instrument: Instrument, tmp_path: Path) -> None:
    with Guard.start() as guard:
        guard.arm([charge(instrument)], within=0.0, log=tmp_path / "guard.jsonl")
        instrument.answer(b"what?\n")
        instrument.answer()
    assert named(tmp_path / "guard.jsonl") == ["armed", "acting", "attempt failed", "made safe", "done"]


@pytest.mark.slow
def test_an_instrument_that_hangs_does_not_keep_another_from_its_safe_state(
    instrument: Instrument, tmp_path: Path
) -> None:
    deaf = Instrument()
    with Guard.start() as guard:
        guard.arm([charge(deaf, "deaf"), charge(instrument)], within=0.0, log=tmp_path / "guard.jsonl")
        instrument.answer()  # both are tried at once: this one is safe before the other is given up
        deaf.answer(None)
        deaf.answer()
    deaf.close()
    assert named(tmp_path / "guard.jsonl") == ["armed", "acting", "made safe", "attempt hung", "made safe", "done"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_no_signal_ends_the_guard_before_it_has_acted(
    number: signal.Signals, instrument: Instrument, tmp_path: Path
) -> None:
    guard = Guard.start()
    guard.arm([charge(instrument)], within=10.0, log=tmp_path / "guard.jsonl")
    os.kill(guard.pid, number)
    guard.beat(within=0.0)
    instrument.answer()
    guard.__exit__(None, None, None)
    assert named(tmp_path / "guard.jsonl")[-1] == "done"


def test_a_log_that_cannot_be_written_does_not_keep_the_guard_from_acting(
    instrument: Instrument, tmp_path: Path
) -> None:
    with Guard.start() as guard:
        guard.arm([charge(instrument)], within=0.0, log=tmp_path / "no such folder" / "guard.jsonl")
        instrument.answer()


@pytest.mark.parametrize(
    "order",
    [
        Charge("no_such_driver", "source", {}),
        Charge("os.path", "source", {}),
        Charge("standin", "source", {"port": "nonsense"}),
        Charge("standin", "source", {"port": 1, "colour": "red"}),
    ],
    ids=["no driver", "not a plain name", "a bad setting", "an unknown setting"],
)
def test_what_the_guard_cannot_act_on_is_refused_before_anything_is_energised(order: Charge, tmp_path: Path) -> None:
    with Guard.start() as guard, pytest.raises(WorkFailed, match="nothing may be energised"):
        guard.arm([order], within=10.0, log=tmp_path / "guard.jsonl")


def test_a_guard_that_was_never_armed_just_goes() -> None:
    with Guard.start() as guard:
        pass
    assert guard._process.returncode == 0


def test_a_driver_is_never_loaded_by_a_dotted_path() -> None:
    with pytest.raises(ImportError, match="plain name"):
        load_driver("os.path")


SWEEP = """
import sys
from importlib import import_module
from pathlib import Path
from rig.bench.control import BenchClock, BenchOperator, Control
from rig.bench.control import Addresses, Control
from rig.bench.guard import Charge, Guard
from rig.room import Room
driver = import_module("drivers.hp89410a")
settings = {"address": "GPIB0::19::INSTR", "gateway": f"PRLGX-TCPIP0::127.0.0.1::{sys.argv[2]}::INTFC"}
with Guard.start() as guard:
    guard.arm([Charge("hp89410a", "analyzer", settings)], within=60.0, log=Path(sys.argv[3]))
    control = Control(int(sys.argv[1]))
    room = Room(BenchClock(control), BenchOperator(control))
    analyzer = driver.connect("analyzer", driver.Settings(**settings), room)
    analyzer.preset()
    analyzer.set_sine(100.0, 0.5)
    analyzer.output(True)
    print("on", flush=True)
    while True:
        room.clock.sleep(0.1)
        analyzer.errors()
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_the_analyzer_on_the_bench_is_off_within_a_tenth_of_a_second_by_its_own_log(
    number: signal.Signals, own_bench: Callable[..., Addresses], tmp_path: Path
) -> None:
    bench = own_bench()
    command = [sys.executable, "-c", SWEEP, str(bench["control"]), str(bench["gpib"]), str(tmp_path / "guard.jsonl")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == b"on\n"
        killed = time.monotonic()
        program.send_signal(number)
    with Control(int(bench["control"])) as link:
        while not (off := switched_off(link.ask("log")["events"], killed)):
            assert time.monotonic() < killed + 10
    assert off[0] - killed < 0.1


def switched_off(events: list[dict[str, Any]], since: float) -> list[float]:
    """When the source was switched off, by the bench's log (monotonic clock, s)."""
    return [one["wall"] for one in events if one["event"] == "source" and not one["on"] and one["wall"] > since]
