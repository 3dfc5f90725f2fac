"""A command that dies at the n-th time it touches the file system: what a power cut may leave behind, state by state.

`died` carries a command out in a process of its own, which kills itself before it opens a file to write, renames,
removes or makes something below its folder for the n-th time, or in the middle of what it writes by a call of its own.
`make kills` goes through all of them for every command that writes conclusions; the tests take a few.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fast_bench
import in_process

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 3, "static": "5 s", "static_after": "0 s"}
CUBIC = {"name": "cubic", "parameters": {"coefficient": 2e-5}}
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "calibrate": ("calibrate", "all", "--name", "first"),
    "certify": ("certify", "all", "--name", "signed"),
    "fit": ("fit", "all"),
    "add": ("add", "delay", "all", "--on", "unit_a_x"),
    "export": ("export", "kept", "--to", "csv", "--out", "robot"),
    "import": ("import", "other.yaml"),
}
RUN = re.compile(rf"runs{os.sep}\d{{4}}-\d\d-\d\dT")  # its name has the time when it was begun
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
TOUCHES = {"os.rename": 1, "os.remove": 0, "os.rmdir": 0, "os.mkdir": 0, "os.truncate": 0}  # which argument is written


@dataclass(frozen=True)
class Left:
    """What a killed command left: at which touch it died, and everything that is not as it must be."""

    touch: int
    wrong: tuple[str, ...]


def prepared(folder: Path) -> None:
    """A folder with a run, a calibration of it, and a file to be imported."""
    fast_bench.keep(SWEEP, fast_bench.world(3, [CUBIC]), folder / "runs")
    rows = "\n".join(f"{n / 100.0},{0.01 * ((7 * n) % 11) - 0.05:.3f}" for n in range(1500))
    (folder / "other.csv").write_text(f"t,gyro_z\n{rows}\n", encoding="utf-8")
    (folder / "other.yaml").write_text(MANIFEST, encoding="utf-8")
    done = in_process.rig("calibrate", "all", "--name", "kept", folder=folder)
    if done.returncode:
        raise RuntimeError(done.stderr)
    shutil.rmtree(folder / "runs" / ".cache")  # so that what is kept beside the runs is written too


MANIFEST = """\
format: 1
kind: static
label: other
unit: {serial: A1}
provenance: {source: made here, licence: CC0-1.0}
files: [{path: other.csv}]
time: {column: t}
columns:
- {column: gyro_z, quantity: rate, unit: rad/s, axis: z}
"""


def died(words: Sequence[str], folder: Path, touch: int) -> tuple[int | None, int]:
    """Exit code of a command that dies at this touch of the folder, None if it did; and how often it touched it."""
    told, tell = os.pipe()
    child = os.fork()
    if not child:
        os._exit(_child(words, folder, touch, tell))
    os.close(tell)
    with os.fdopen(told, "rb") as end:
        count = len(end.read())
    _, status = os.waitpid(child, 0)
    killed = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL
    return None if killed else os.waitstatus_to_exitcode(status), count


def _child(words: Sequence[str], folder: Path, touch: int, tell: int) -> int:
    count, inside = 0, f"{folder.resolve()}{os.sep}"
    plain: Callable[[int, Any], int] = os.write

    def touched() -> bool:
        nonlocal count
        count += 1
        plain(tell, b".")
        return count == touch

    def heard(event: str, told: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(told[0], str) and isinstance(told[2], int) and told[2] & WRITING:
            path: Any = told[0]
        elif event in TOUCHES and not isinstance(told[TOUCHES[event]], int):
            path = told[TOUCHES[event]]
        else:
            return
        if os.path.abspath(os.fspath(path)).startswith(inside) and touched():
            os.kill(os.getpid(), signal.SIGKILL)

    def write(descriptor: int, data: Any) -> int:
        if os.readlink(f"/proc/self/fd/{descriptor}").startswith(inside) and touched():
            plain(descriptor, bytes(data)[: len(data) // 2])
            os.kill(os.getpid(), signal.SIGKILL)
        return plain(descriptor, data)

    os.write = write  # type: ignore[assignment]
    sys.addaudithook(heard)
    return in_process.rig(*words, folder=folder).returncode


def left(name: str, before: Path, few: bool) -> Iterator[Left]:
    """Of one command, begun anew in a copy of a folder and killed at each touch; `few`: in the middle and at the last.

    What comes last is the file that the command was called for: made, written, and given its name.
    """
    words = COMMANDS[name]
    with tempfile.TemporaryDirectory() as made:
        whole = _copy(before, Path(made) / "whole")
        code, count = died(words, whole, 0)
        if code != 0:
            raise RuntimeError(f"{name}: found it failing by itself: {in_process.rig(*words, folder=whole)}")
        for touch in sorted({count // 2, count - 2, count - 1, count}) if few else range(1, count + 1):
            folder = _copy(before, Path(made) / f"at-{touch}")
            if died(words, folder, touch)[0] is not None:
                raise RuntimeError(f"{name}: found it alive after touch {touch} of {count}")
            wrong = list(_wrong(before, whole, folder))
            if (code := died(words, folder, 0)[0]) != 0:
                wrong.append(f"the same command again ends with {code}")
            wrong += [f"{path}: not there after the same command" for path in _lacking(before, whole, folder)]
            wrong += _unsound(folder)
            yield Left(touch, tuple(wrong))
            shutil.rmtree(folder)


def _copy(before: Path, folder: Path) -> Path:
    shutil.copytree(before, folder)
    return folder


def _wrong(before: Path, whole: Path, folder: Path) -> Iterator[str]:
    """Files that are neither as they were nor as the command makes them. What a run is made of tells that itself."""
    was, would, found = _contents(before), _contents(whole), _contents(folder)
    for path in was.keys() | found.keys():
        if path not in was and RUN.match(path):
            continue
        if found.get(path) not in (was.get(path), would.get(path)):
            yield f"{path}: neither as it was nor as it is to be"


def _lacking(before: Path, whole: Path, folder: Path) -> list[str]:
    """Files that the command makes, and that are not there."""
    made = _contents(whole).keys() - _contents(before).keys() - _contents(folder).keys()
    return [path for path in made if not RUN.match(path)]


def _contents(folder: Path) -> dict[str, str]:
    """Digests of all files that a user sees."""
    seen = (one for one in folder.rglob("*") if one.is_file())
    return {
        str(path): hashlib.sha256((folder / path).read_bytes()).hexdigest()
        for path in (one.relative_to(folder) for one in seen) if not any(part.startswith(".") for part in path.parts)
    }  # fmt: skip


def _unsound(folder: Path) -> Iterator[str]:
    """What the program finds wrong: a run that says it is completed and is not sound."""
    listed = in_process.rig("runs", "--json", folder=folder)
    if listed.returncode:
        yield f"runs: {listed.stderr}"
        return
    for run in json.loads(listed.stdout):
        checked = in_process.rig("verify", run["run"], folder=folder)
        if run["status"] == "completed" and checked.returncode:
            yield f"{run['run']}: {checked.stdout}{checked.stderr}"


def main() -> int:
    """Kill what is asked for. Exit 1 if anything is not as it must be."""
    parser = argparse.ArgumentParser(description="Kill every command that concludes at every touch of the file system.")
    every = [*COMMANDS, []]  # an empty list is what argparse makes of no words, and checks too
    parser.add_argument("only", nargs="*", choices=every, help="commands (all)")
    parser.add_argument("--few", action="store_true", help="in the middle, and at the last three touches")
    options = parser.parse_args()
    faults = 0
    with tempfile.TemporaryDirectory() as made:
        before = Path(made) / "before"
        before.mkdir()
        prepared(before)
        for name in options.only or list(COMMANDS):
            found = list(left(name, before, options.few))
            wrong = [f"  touch {one.touch}: {text}" for one in found for text in one.wrong]
            print("\n".join([f"{name:<10} killed {len(found)} times, {len(wrong)} faults", *wrong]), flush=True)
            faults += len(wrong)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
