"""What may be energised on a bench: a file beside its lock that outlives the program and its guard.

It is there from before the first instrument may be energised until each of them was read back as off. So a file whose
program and guard have both ended says that nobody has confirmed it; the next program that wants the bench finds it.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from rig.bench.possession import Holder, Possession, folder


@dataclass(frozen=True)
class Armed:
    """`instruments` by their names on the bench; `files`, one for each lock of the bench, are all alike.

    `log` is where the guard writes, `runs` the folder that a simulated bench belongs to. `reason` says what went wrong,
    if that is known.
    """

    files: tuple[str, ...]
    bench: str
    instruments: tuple[str, ...]
    log: str
    runs: str
    program: Holder
    guard: Holder | None = None
    reason: str = ""

    @classmethod
    def of(cls, possession: Possession, instruments: Sequence[str], log: Path, runs: str = "") -> Self:
        """What is about to be armed on a bench that we have. Nothing is written yet."""
        files = tuple(map(str, possession.armed))
        return cls(files, possession.bench, tuple(instruments), str(log), runs, possession.holder)

    @classmethod
    def from_json(cls, text: str | bytes) -> Self:
        """Raises ValueError, TypeError or KeyError if it is something else."""
        found: dict[str, Any] = json.loads(text)
        found["files"], found["instruments"] = tuple(found["files"]), tuple(found["instruments"])
        found["program"] = Holder(**found["program"])
        found["guard"] = found["guard"] and Holder(**found["guard"])
        return cls(**found)

    def as_json(self) -> str:
        return json.dumps(asdict(self))

    def write(self) -> None:
        """Let it be known, whole or not at all; raises OSError."""
        for file in map(Path, self.files if self.instruments else ()):
            part = file.with_name(f".{file.name}.{os.getpid()}")
            part.write_text(self.as_json(), encoding="utf-8")
            part.replace(file)

    def clear(self) -> None:
        """Each instrument was read back as off."""
        for file in map(Path, self.files):
            file.unlink(missing_ok=True)

    @property
    def attended(self) -> bool:
        """Whether somebody is still there to make it safe: the program at work, or its guard."""
        return self.program.state == "alive" or (self.guard is not None and self.guard.state == "alive")

    def __str__(self) -> str:
        names = ", ".join(self.instruments) or "something"
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.program.since))
        by = f"bench {self.bench}, process {self.program.pid} ({self.program.command}) since {since}"
        return f"{names} of {by}: {self.reason or 'armed, and nobody has read it back as off'}"


def left_armed(files: Sequence[Path]) -> Armed | None:
    """What was left armed on a bench that nobody has any more; None if nothing was."""
    for file in files:
        if (found := _read(file)) is not None:
            return found
    return None


def unattended(runs: Path) -> Iterator[Armed]:
    """What is left armed on this machine with nobody there any more; of simulated benches only that of this folder."""
    seen: set[tuple[str, ...]] = set()
    for file in sorted(folder().glob("*.armed")):
        found = _read(file)
        if found is None or found.attended or found.files in seen:
            continue
        seen.add(found.files)
        if not found.runs or Path(found.runs) == runs.resolve():
            yield found


def _read(file: Path) -> Armed | None:
    """What a file says. One that cannot be understood still says that something was armed."""
    try:
        return Armed.from_json(file.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, KeyError):
        reason = f"{file}: found something unreadable, wanted what was armed"
        return Armed((str(file),), "of unknown name", (), "", "", Holder(0, "", "", 0.0, "unknown"), None, reason)
