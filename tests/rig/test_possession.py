"""A bench has one driver at a time, whatever its addresses are spelled like and however its last driver ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from rig.bench.possession import Holder, folder, place, possessed
from rig.errors import BenchHeld

GATEWAY = "PRLGX-TCPIP0::192.168.1.20::1234::INTFC"
PROGRAM = """
import sys
from rig.bench.possession import possessed
with possessed("mine", sys.argv[1:]):
    print("have it", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@contextmanager
def other(*addresses: str) -> Iterator[subprocess.Popen[bytes]]:
    """Another program that has this bench."""
    command = [sys.executable, "-c", PROGRAM, *addresses]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == b"have it\n"
        yield program
        program.kill()


@pytest.mark.parametrize(
    ("one", "same"),
    [
        (GATEWAY, "prlgx-tcpip7::192.168.1.20::1234::intfc"),
        (GATEWAY, "TCPIP0::192.168.1.20::1234::SOCKET"),
        ("socket://localhost:4001", "127.0.0.1:4001"),
        ("gpib0::19::instr", "GPIB0::19::INSTR"),
    ],
)
def test_spellings_of_one_place_are_one_place(one: str, same: str) -> None:
    assert place(one) == place(same)


def test_a_link_to_a_device_is_the_device(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB0")
    assert place(f"ASRL{tmp_path / 'by-id'}::INSTR") == place(str(tmp_path / "ttyUSB0"))


def test_other_places_are_other_places() -> None:
    assert len({place(one) for one in ("10.0.0.1:1", "10.0.0.1:2", "10.0.0.2:1", "/dev/ttyUSB0", "/dev/ttyUSB1")}) == 5


def test_a_bench_that_shares_one_instrument_is_refused_with_who_has_it() -> None:
    with (
        other(GATEWAY, "/dev/ttyUSB0") as program,
        pytest.raises(BenchHeld, match=rf"bench yours: found it held by process {program.pid} \(-c .*since 20"),
        possessed("yours", ["/dev/ttyUSB5", "TCPIP::192.168.1.20::1234::SOCKET"]),
    ):
        pass
    with possessed("yours", ["/dev/ttyUSB5", GATEWAY]):
        pass  # what was had in vain was given back


def test_who_has_a_bench_is_told_although_it_has_not_said_so_yet() -> None:
    """Between taking a lock and saying so a busy machine may let another program look."""
    with other("socket://localhost:4001"):
        (path,) = folder().glob("*.lock")
        said = path.read_bytes()
        path.write_bytes(b"")
        late = threading.Timer(0.2, path.write_bytes, (said,))
        late.start()
        with pytest.raises(BenchHeld, match=r"found it held by process \d+"), possessed("mine", ["127.0.0.1:4001"]):
            pass
        late.join()


def test_a_bench_is_free_as_soon_as_its_driver_was_killed() -> None:
    with other(GATEWAY) as program:
        program.kill()
        program.wait()
        with possessed("yours", [GATEWAY]) as taken:
            assert not taken.passed
    assert list(folder().glob("*.lock")) == []


def test_nobody_is_passed_over_but_the_stopped() -> None:
    with other(GATEWAY) as program:
        with pytest.raises(BenchHeld), possessed("yours", [GATEWAY], passing=True):
            pass
        program.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, program.pid, os.WSTOPPED)
        with possessed("yours", [GATEWAY], passing=True) as taken:
            assert f"passed over process {program.pid}" in taken.passed[0]
            assert "stopped" in taken.passed[0]
        with pytest.raises(BenchHeld, match="stopped"), possessed("yours", [GATEWAY]):
            pass


def test_a_later_process_of_the_same_number_is_another_one() -> None:
    me = Holder.myself()
    assert me.state == "alive"
    assert Holder(me.pid, me.boot, "1", me.since, me.command).state == "dead"
    assert Holder(me.pid, "another start", me.started, me.since, me.command).state == "dead"
