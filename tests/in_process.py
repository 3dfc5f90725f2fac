"""The program as a shell calls it, in this process: what saves the second that loading it takes each time."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from unittest import mock


@dataclass(frozen=True)
class Done:
    """What a command ended with."""

    returncode: int
    stdout: str
    stderr: str


def rig(*words: str, folder: Path | None = None, **environment: str) -> Done:
    """Carry out a command in a folder, without a terminal, with no options of ours from the environment but these."""
    out, wrong = io.StringIO(), io.StringIO()
    clean = {name: value for name, value in os.environ.items() if not name.startswith("RIG_")} | environment
    (program,) = entry_points(group="console_scripts", name="rig")
    with (
        mock.patch.dict(os.environ, clean, clear=True),
        mock.patch.object(sys, "argv", ["rig", *words]),
        mock.patch.object(sys, "stdin", io.StringIO()),
        contextlib.chdir(folder or Path.cwd()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(wrong),
    ):
        try:
            program.load()()
            code: object = 0
        except SystemExit as end:
            code = end.code
    return Done(code if isinstance(code, int) else int(code is not None), out.getvalue(), wrong.getvalue())
