"""The transcript of a run: every exchange with every instrument, a line each, in the run's `transcript.txt`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import IO, Literal

SHOWN = 120  # bytes of one message; a block of samples is told by its length


class RunTranscript:
    """Keeps lines in memory until the run has a folder; from then on each is with the operating system at once."""

    def __init__(self) -> None:
        self._early: list[str] = []
        self._file: IO[str] | None = None

    def attach(self, folder: Path) -> None:
        """Write into the run's folder from now on, beginning with what was said before it existed."""
        self._file = (folder / "transcript.txt").open("a", buffering=1, encoding="utf-8")
        self._file.writelines(self._early)
        self._early = []

    def note(self, instrument: str, direction: Literal["sent", "received"], data: bytes) -> None:
        """One message, with the machine's monotonic clock (s)."""
        shown = repr(data[:SHOWN])[1:] + (f" … {len(data)} bytes" if len(data) > SHOWN else "")
        line = f"{time.monotonic():.6f} {instrument} {'<' if direction == 'sent' else '>'} {shown}\n"
        if self._file is None:
            self._early.append(line)
        else:
            self._file.write(line)

    def close(self) -> None:
        """Close the file; lines that come later stay in memory."""
        if self._file is not None:
            self._file.close()
            self._file = None
