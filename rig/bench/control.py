"""The simulated bench as the program sees it: start it, find it again, ask its clock and its operator.

The bench is a process of its own (`python -m fixtures`), reached by JSON lines on loopback ("Control socket" in
docs/reference/wire.md). It is started by name and never imported. It runs in a session of its own, so that Ctrl-C
and the kills meant for the program do not reach it.
"""

from __future__ import annotations

import fcntl
import json
import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rig.errors import BadInput, BenchUnreachable, OperatorRefused
from rig.room import Confirmation, Request

Addresses = dict[str, int | str]

_HOST = "127.0.0.1"
_BAD_INPUT = 2  # exit codes of `python -m fixtures`, see its docstring
_ALREADY_SERVED = 75
SIZING = 60.0  # s, real: a hidden effect is tried at several sizes before the bench listens


class Control:
    """Client of the control socket: one JSON object out, one in; a lock spans the whole exchange.

    `timeout` (s, real time) bounds every exchange. A broken exchange closes the connection, so that a late answer is
    never taken for the next one; the next request connects again.
    """

    def __init__(self, port: int, *, host: str = _HOST, timeout: float = 30.0) -> None:
        self._address = (host, port)
        self._timeout = timeout
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._pending = b""

    def ask(self, do: str, *, patience: float = 0.0, **fields: object) -> dict[str, Any]:
        """The bench's answer to `do`; `patience` (s) is added to the timeout.

        Raises BenchUnreachable if the bench does not answer, answers nonsense, or answers with an error.
        """
        answer = self.exchange({"do": do, **fields}, patience)
        if answer["ok"] is not True:
            raise BenchUnreachable(f"{self}: asked {do!r}, the bench says: {answer.get('error', 'no reason given')}")
        return answer

    def exchange(self, request: Mapping[str, object], patience: float = 0.0) -> dict[str, Any]:
        """The raw answer, `ok` or not.

        Raises BenchUnreachable if none comes, or something that is not an answer.
        """
        with self._lock:
            try:
                return _answer(self._line(json.dumps(dict(request)).encode() + b"\n", self._timeout + patience))
            except (OSError, ValueError) as error:
                self._drop()
                raise BenchUnreachable(f"{self}: asked {request['do']!r}, {_reason(error)}") from error
            except BaseException:  # Ctrl-C: the answer under way must not answer the next request
                self._drop()
                raise

    def close(self) -> None:
        """Close the connection; the bench keeps running until it has been idle for long enough."""
        with self._lock:
            self._drop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def __str__(self) -> str:
        return f"bench control at {self._address[0]}:{self._address[1]}"

    def _line(self, request: bytes, timeout: float) -> bytes:
        """Send one line and return the answer's line, all within `timeout` s."""
        deadline = time.monotonic() + timeout
        link = self._connected(timeout)
        link.settimeout(timeout)
        link.sendall(request)
        while b"\n" not in self._pending:
            link.settimeout(max(deadline - time.monotonic(), 1e-3))
            received = link.recv(1 << 16)
            if not received:
                raise ConnectionResetError("the bench closed the connection")
            self._pending += received
        line, self._pending = self._pending.split(b"\n", 1)
        return line

    def _connected(self, timeout: float) -> socket.socket:
        if self._socket is None:
            self._socket = socket.create_connection(self._address, timeout=timeout)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return self._socket

    def _drop(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self._pending = None, b""


class BenchClock:
    """The simulated bench's virtual time: `sleep` is what moves its world on."""

    def __init__(self, control: Control) -> None:
        self._control = control

    def now(self) -> float:
        """Seconds since 1970-01-01 UTC by the bench's clock."""
        return float(self._control.ask("now")["now"])

    def sleep(self, seconds: float) -> None:
        """Let `seconds` ≥ 0 of virtual time pass; takes as long as the simulation needs.

        Raises BenchUnreachable if the bench does not answer within its timeout plus `seconds` of real time.
        """
        self._control.ask("sleep", patience=seconds, seconds=seconds)


class BenchOperator:
    """The simulated bench's own operator, who turns the simulated knobs and cables at once."""

    def __init__(self, control: Control) -> None:
        self._control = control

    def check(self, requests: Iterable[Request]) -> None:
        """This operator is always there."""

    def ask(self, request: Request) -> Confirmation:
        """Have it done.

        Raises OperatorRefused if the bench's operator cannot do it, BenchUnreachable if the bench does not answer.
        """
        question = {
            "do": "operator",
            "action": request.action,
            "settings": dict(request.settings),
            "text": request.text,
        }
        answer = self._control.exchange(question)
        if answer["ok"] is not True:
            raise OperatorRefused(f"operator, asked to {request.action}: {answer.get('error', 'no reason given')}")
        when = float(self._control.ask("now")["now"])
        return Confirmation(request, str(answer["who"]), when, str(answer["said"]))


def ensure_served(
    world: Path,
    seed: int,
    state: Path,
    hidden_seed: int | None = None,
    *,
    idle: float = 15.0,
    deadline: float = 20.0,
) -> Addresses:
    """Addresses of the bench that keeps its world in the folder `state`; started if none is running there.

    `idle`: real seconds without any client after which a bench started here ends (0: never). `deadline`: real seconds
    it may take to start. Raises BadInput if the world's file cannot be used or the folder holds the world of another
    seed, BenchUnreachable if the bench does not start.
    """
    until = time.monotonic() + deadline + (SIZING if hidden_seed is not None else 0.0)
    if (addresses := served(state)) is not None:
        return _of_seed(addresses, seed, state)
    # -P: nothing of the working folder is imported
    command = [sys.executable, "-P", "-m", "fixtures", "--world", str(world), "--seed", str(seed)]
    command += ["--state", str(state), "--idle", str(idle)]
    if hidden_seed is not None:
        command += ["--hidden-seed", str(hidden_seed)]
    return _start(command, state, until) or _of_seed(_await_other(state, until), seed, state)


def served(state: Path) -> Addresses | None:
    """Addresses of the bench that is alive in this state folder, or None."""
    try:
        addresses = json.loads((state / "addresses.json").read_text(encoding="utf-8"))
        with Control(int(addresses["control"]), timeout=5.0) as control:
            alive = control.ask("hello")["pid"] == addresses["pid"]
    except (OSError, ValueError, KeyError, TypeError, BenchUnreachable):
        return None  # no file, half a file, or a file left behind by a bench that was killed
    return dict(addresses) if alive else None


def stop(state: Path, *, deadline: float = 10.0) -> bool:
    """Ask the bench in this state folder to save its world and end, and wait until it has; False if none was running.

    Raises BenchUnreachable if it has not ended within `deadline` s.
    """
    addresses = served(state)
    if addresses is None:
        return False
    with Control(int(addresses["control"]), timeout=deadline) as control:
        control.ask("shutdown")
    until = time.monotonic() + deadline
    while not _unlocked(state):
        if time.monotonic() > until:
            raise BenchUnreachable(f"{state}: the simulated bench (pid {addresses['pid']}) has not ended")
        time.sleep(0.005)
    return True


def _start(command: list[str], state: Path, until: float) -> Addresses | None:
    """Start a bench process and return its addresses; None if another one was quicker in the same folder."""
    try:
        state.mkdir(parents=True, exist_ok=True)
        log_start = _size(state / "bench.log")
        pid, ready = _spawn(command, state / "bench.log")
    except OSError as error:
        raise BenchUnreachable(f"{state}: the simulated bench cannot live here: {_reason(error)}") from error
    try:
        line = _first_line(ready, until)
    finally:
        os.close(ready)
    if line:
        return dict(json.loads(line))
    code = _exit_code(pid)
    if code == _ALREADY_SERVED:
        return None
    said = _since(state / "bench.log", log_start)
    if code == _BAD_INPUT:
        raise BadInput(said)
    how = "did not get ready in time" if code is None else f"ended with exit code {code}"
    raise BenchUnreachable(f"the simulated bench {how}: {said or 'it said nothing'} (see {state / 'bench.log'})")


def _spawn(command: list[str], log: Path) -> tuple[int, int]:
    """Process id, and the read end of its standard output. Standard error goes to the log."""
    read, write = os.pipe()
    files = [
        (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
        (os.POSIX_SPAWN_DUP2, write, 1),
        (os.POSIX_SPAWN_OPEN, 2, str(log), os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644),
    ]
    # On a small machine numpy's own threads slow everything down.
    environment = {"OPENBLAS_NUM_THREADS": "1", **os.environ}
    try:
        # A new session, and no Popen object: the bench outlives the program that started it.
        return os.posix_spawn(command[0], command, environment, file_actions=files, setsid=True), read
    except OSError:
        os.close(read)
        raise
    finally:
        os.close(write)


def _first_line(pipe: int, until: float) -> bytes:
    """The first whole line from a pipe; empty if it closes, or time is up, before that."""
    received = b""
    while not received.endswith(b"\n"):
        if not select.select([pipe], [], [], max(until - time.monotonic(), 0.0))[0]:
            return b""
        part = os.read(pipe, 1 << 16)
        if not part:
            return b""
        received += part
    return received


def _exit_code(pid: int) -> int | None:
    """How a bench that never got ready ended; None if it was still trying and had to be stopped."""
    for _ in range(100):
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.005)  # it has closed its standard output and is about to exit
    os.kill(pid, signal.SIGTERM)
    return None


def _await_other(state: Path, until: float) -> Addresses:
    """The addresses of a bench that somebody else is starting in the same folder."""
    while time.monotonic() < until:
        if (addresses := served(state)) is not None:
            return addresses
        time.sleep(0.02)
    raise BenchUnreachable(f"{state}: another simulated bench holds this folder and does not answer")


def _of_seed(addresses: Addresses, seed: int, state: Path) -> Addresses:
    with Control(int(addresses["control"])) as control:
        found = control.ask("hello")["seed"]
    if found != seed:
        raise BadInput(
            f"{state}: found the world of seed {found}, wanted seed {seed} (another folder, or stop that bench)"
        )
    return addresses


def _unlocked(state: Path) -> bool:
    """Whether no bench holds the folder; the lock goes with its process, however that ends."""
    with (state / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def _answer(line: bytes) -> dict[str, Any]:
    answer = json.loads(line)
    if not isinstance(answer, dict) or not isinstance(answer.get("ok"), bool):
        raise ValueError(f"received {line[:80]!r}, wanted an object with 'ok'")
    return answer


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "no answer in time"
    return getattr(error, "strerror", None) or str(error)


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _since(path: Path, start: int) -> str:
    """What was added to a log, whole if it is short, else its last line."""
    text = path.read_bytes()[start:].decode("utf-8", "replace").strip()
    return text if len(text) < 2000 else text.rsplit("\n", 1)[-1]
