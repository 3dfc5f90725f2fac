"""`rig` that kills itself: `python killed.py KIND WHAT ARGUMENTS…` dies by SIGKILL once such a line is in the journal.

The line is one of KIND whose body holds the text WHAT. It has been handed to the operating system when the program
dies, as always, so a test meets the run in one state whatever the speed of the machine.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from typing import Any

from rig.archive.writer import RunWriter
from rig.cli import main


def deadly(kind: str, what: str) -> None:
    """Let the writer's next such line be the program's last."""
    written = RunWriter._append

    def last(self: RunWriter, line: str, body: Any) -> int:
        number = written(self, line, body)
        if line == kind and what in json.dumps(body, default=str):
            os.kill(os.getpid(), signal.SIGKILL)
        return number

    RunWriter._append = last  # type: ignore[method-assign]


if __name__ == "__main__":
    deadly(*sys.argv[1:3])
    sys.argv = ["rig", *sys.argv[3:]]
    main()
