"""A progress line with the time left, for anything over two seconds; plain lines where there is no terminal."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from rig.bench.runner import Progress

LINE_ANEW = "\r\x1b[2K"
PLAIN_EVERY = 5.0  # s of real time between lines where nobody watches a terminal


class Bar:
    """Shows where a run is. The time left is learnt from the run itself: bench time left × real time per bench time."""

    def __init__(self, title: str, *, quiet: bool = False) -> None:
        self._title, self._quiet = title, quiet
        self._begun = self._last = time.monotonic()
        self._first: float | None = None
        self._live: Any = None
        self._task: Any = None

    def __enter__(self) -> Self:
        if not self._quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            self._live = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.completed:.0f}/{task.total:.0f}  {task.fields[left]}  {task.fields[label]}"),
                console=Console(stderr=True),
                transient=True,
            )
            self._live.start()
            self._task = self._live.add_task(self._title, total=1, left="", label="")
        return self

    def show(self, progress: Progress) -> None:
        """Take note of where the run is."""
        left = self._left(progress)
        if self._live is not None:
            self._live.update(
                self._task, completed=progress.done, total=progress.total, left=left, label=progress.label
            )
        elif not self._quiet and time.monotonic() - self._last > PLAIN_EVERY:
            self._last = time.monotonic()
            points = f"{progress.points_done} of {progress.points} points"
            print(f"{self._title}: {points}, {left or 'starting'} ({progress.label})", file=sys.stderr, flush=True)

    def _left(self, progress: Progress) -> str:
        if self._first is None:
            self._first = progress.remaining
        elapsed, covered = time.monotonic() - self._begun, self._first - progress.remaining
        if covered <= 0.02 * self._first:
            return ""
        return f"{duration_text(progress.remaining * elapsed / covered)} left"

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._live is not None:
            self._live.stop()


class Doing:
    """What a long computation is at, in one line of a terminal that is gone at the end; nothing where there is none."""

    def __init__(self) -> None:
        self._seen = sys.stderr.isatty()

    def __enter__(self) -> Self:
        return self

    def __call__(self, doing: str) -> None:
        """Show what is done now."""
        if self._seen:
            print(f"{LINE_ANEW}{doing} …", end="", file=sys.stderr, flush=True)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._seen:
            print(LINE_ANEW, end="", file=sys.stderr, flush=True)


def duration_text(seconds: float) -> str:
    """A duration as a person says it: 8 s, 3 min 20 s, 2 h 5 min."""
    whole = round(seconds)
    if whole < 100:
        return f"{whole} s"
    if whole < 6000:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
