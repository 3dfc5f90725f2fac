"""The program's side of the control socket, against a stand-in that says exactly what a test wants."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rig.bench import control
from rig.bench.control import BenchClock, BenchOperator, Control
from rig.errors import BadInput, BenchUnreachable, OperatorRefused
from rig.room import Request

CABLES = Request("cables", "Connect the shaker cable set to the converter.", {"set": "shaker"})


class Bench:
    """Answers each line with the next of its replies (None: silence, b"": hangs up), connection after connection."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self.replies: list[bytes | None] = []
        self.heard: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def says(self, *answers: dict[str, Any] | bytes | None) -> None:
        self.replies += [json.dumps(a).encode() + b"\n" if isinstance(a, dict) else a for a in answers]

    def _serve(self) -> None:
        while True:
            link, _ = self._server.accept()
            with link, link.makefile("rb") as lines:
                for line in lines:
                    if line == b"end\n":
                        return
                    self.heard.append(json.loads(line))
                    reply = self.replies.pop(0)
                    if reply == b"":
                        break
                    if reply is not None:
                        link.sendall(reply)

    def close(self) -> None:
        with socket.create_connection(("127.0.0.1", self.port)) as link:
            link.sendall(b"end\n")
        self._thread.join()
        self._server.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    stand_in = Bench()
    yield stand_in
    stand_in.close()


@pytest.fixture
def client(bench: Bench) -> Iterator[Control]:
    with Control(bench.port, timeout=5.0) as link:
        yield link


def test_the_clock_reads_and_moves_the_bench_s_time(bench: Bench, client: Control) -> None:
    bench.says({"ok": True, "now": 100.0}, {"ok": True, "now": 102.5})
    clock = BenchClock(client)
    assert clock.now() == 100.0
    clock.sleep(2.5)
    assert bench.heard == [{"do": "now"}, {"do": "sleep", "seconds": 2.5}]


def test_the_operator_confirms_with_name_time_and_remark(bench: Bench, client: Control) -> None:
    bench.says({"ok": True, "who": "twin", "said": "done"}, {"ok": True, "now": 7.0})
    confirmation = BenchOperator(client).ask(CABLES)
    assert (confirmation.who, confirmation.when, confirmation.said) == ("twin", 7.0, "done")
    assert bench.heard[0] == {"do": "operator", "action": "cables", "settings": {"set": "shaker"}, "text": CABLES.text}


def test_an_operator_s_no_is_a_refusal(bench: Bench, client: Control) -> None:
    bench.says({"ok": False, "error": "no such cable set"})
    with pytest.raises(OperatorRefused, match="no such cable set"):
        BenchOperator(client).ask(CABLES)


def test_an_error_of_the_bench_is_shown(bench: Bench, client: Control) -> None:
    bench.says({"ok": False, "error": "seconds: found -1"})
    with pytest.raises(BenchUnreachable, match=r"asked 'sleep'.*found -1"):
        BenchClock(client).sleep(-1)


@pytest.mark.parametrize("reply", [b"nonsense\n", b"[1]\n", b"{}\n", b'{"ok": "yes"}\n', b"\xff\n", b""])
def test_nonsense_and_a_hang_up_are_unreachable_and_the_next_request_connects_anew(
    bench: Bench, client: Control, reply: bytes
) -> None:
    bench.says(reply, {"ok": True, "now": 1.0})
    with pytest.raises(BenchUnreachable, match="asked 'now'"):
        client.ask("now")
    assert client.ask("now")["now"] == 1.0


def test_silence_ends_in_time_and_a_late_answer_is_never_taken_for_the_next(bench: Bench) -> None:
    bench.says(None, {"ok": True, "now": 2.0})
    with Control(bench.port, timeout=0.05) as client:
        with pytest.raises(BenchUnreachable, match="no answer in time"):
            client.ask("now")
        assert client.ask("now", patience=5.0)["now"] == 2.0


def test_a_refused_connection_is_unreachable() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(BenchUnreachable, match=f"127.0.0.1:{port}"):
        Control(port).ask("hello")


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"control": "x", "pid": 1}', '{"control": 1, "pid": 1}'])
def test_addresses_left_behind_are_not_a_bench(content: str, tmp_path: Path) -> None:
    (tmp_path / "addresses.json").write_text(content)
    assert control.served(tmp_path) is None
    assert not control.stop(tmp_path)


def test_a_bench_with_another_pid_at_the_same_port_is_not_the_one(bench: Bench, tmp_path: Path) -> None:
    bench.says({"ok": True, "pid": 2})
    (tmp_path / "addresses.json").write_text(json.dumps({"control": bench.port, "pid": 1}))
    assert control.served(tmp_path) is None


def test_the_world_of_another_seed_is_refused(bench: Bench, tmp_path: Path) -> None:
    bench.says({"ok": True, "pid": 1}, {"ok": True, "seed": 3})
    (tmp_path / "addresses.json").write_text(json.dumps({"control": bench.port, "pid": 1}))
    with pytest.raises(BadInput, match="found the world of seed 3, wanted seed 4"):
        control.ensure_served(Path("clean.yaml"), 4, tmp_path)


def test_a_state_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchUnreachable, match="file"):
        control.ensure_served(Path("clean.yaml"), 1, tmp_path / "file" / "state")


def test_a_world_that_cannot_be_read_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"no_such\.yaml"):
        control.ensure_served(tmp_path / "no_such.yaml", 1, tmp_path / "state")
