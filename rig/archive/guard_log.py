"""What the guard of a run did, in JSON lines beside the journal: they are written when nobody else can write any more.

Each line has `event` and `monotonic` (s, the machine's monotonic clock):

    armed           `instruments` may be energised from now on
    acting          `because` of what the program did, or did not do
    attempt failed  with the `error` of one `instrument`; `attempt hung` without
    made safe       one `instrument` was read back as off
    done            all were;  gave up: those of `instruments` were not
    disarmed        the program itself read back that all are off
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

GUARD_LOG = "guard.jsonl"
SAFE = ("disarmed", "done")


@dataclass(frozen=True)
class GuardLog:
    """The file of one run. A log that cannot be written never keeps anybody from acting."""

    path: Path

    def write(self, event: str, **details: object) -> None:
        line = json.dumps({"event": event, "monotonic": time.monotonic(), **details}) + "\n"
        with contextlib.suppress(OSError), self.path.open("a", encoding="utf-8") as file:
            file.write(line)

    def events(self) -> Sequence[Mapping[str, Any]]:
        """Every whole line, oldest first; none without a file. What cannot be read is left out."""
        found = []
        with contextlib.suppress(OSError):
            for line in self.path.read_text(encoding="utf-8", errors="replace").splitlines():
                with contextlib.suppress(ValueError):
                    event = json.loads(line)
                    if isinstance(event, dict) and "event" in event:
                        found.append(event)
        return found

    def not_safe(self) -> str | None:
        """Why it is not known that the bench was left off; None if it is known, or nothing was armed."""
        events = self.events()
        if not events or events[-1]["event"] in SAFE:
            return None
        armed = [event for event in events if event["event"] == "armed"]
        names = armed[-1].get("instruments", ()) if armed else ()
        if events[-1]["event"] == "gave up":
            names = events[-1].get("instruments", names)
            errors = [event["error"] for event in events if "error" in event]
            reason = errors[-1] if errors else "no attempt came to an end"
        else:
            reason = "armed, and nobody has read it back as off"
        return f"{', '.join(map(str, names))}: {reason}" if names else None
