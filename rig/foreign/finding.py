"""Something that looks wrong with data, as a value: what, in which channel, in which rows, and when."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

SHOWN = 3  # row numbers that a sentence lists
MISREAD = ("frame", "quaternion_sense")  # kinds: the manifest has the axes otherwise than the numbers
Rows = NDArray[np.intp]
Spans = tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Finding:
    """Something that looks wrong: its `kind` in one word, the file's label, and a sentence with numbers.

    `channel` it is about, if one; `stretches` of rows, first and last of each, from 0, if rows are to blame. `times` of
    these on the file's clock, s; `since` the file's first stamp, s; `stamp` the first row's own number in the column
    of time stamps. `manifest_line` (from 1) where the manifest names the column. `left_out`: these rows are no
    measurement, and nothing is compared with them. `accepted`: the manifest says that it was looked at.
    """

    kind: str
    where: str
    text: str
    channel: str = ""
    stretches: Spans = ()
    times: tuple[tuple[float, float], ...] = ()
    since: float = 0.0
    stamp: float | None = None
    manifest_line: int | None = None
    left_out: bool = False
    accepted: bool = False

    @property
    def misread(self) -> bool:
        """Whether axes are not those that the manifest states: till that is mended nothing is learned of physics."""
        return self.kind in MISREAD and not self.accepted

    @property
    def rows(self) -> Rows:
        """All rows, (k,)."""
        each = [np.arange(first, last + 1) for first, last in self.stretches]
        return np.concatenate([np.zeros(0, np.intp), *each])

    @property
    def time(self) -> tuple[float, float] | None:
        """From the record's first row to the first and to the last of them, s."""
        found = (self.times[0][0] - self.since, self.times[-1][1] - self.since) if self.times else (math.nan,) * 2
        return found if math.isfinite(sum(found)) else None

    @property
    def in_words(self) -> str:
        """With the file, when, and what is done about it."""
        when = f" ({self.time[0]:.4g} s after the record's beginning)" if self.time is not None else ""
        done = f"; left out{', accepted' if self.accepted else ''}" if self.left_out else ""
        return f"{self.where}: {self.text}{when}{done}"

    def as_json(self) -> dict[str, Any]:
        """As the commands print it and a run's journal keeps it; `from_json` reads it back."""
        ends = [self.stretches[0][0], self.stretches[-1][1]] if self.stretches else None
        return {
            "kind": self.kind, "where": self.where, "channel": self.channel or None, "rows": ends,
            "stretches": [list(one) for one in self.stretches], "time": None if self.time is None else list(self.time),
            "stamp": self.stamp, "manifest_line": self.manifest_line, "left_out": self.left_out,
            "accepted": self.accepted, "text": self.text,
        }  # fmt: skip


def from_json(body: Mapping[str, Any]) -> Finding:
    """What a journal holds."""
    time = body.get("time")
    kind = str(body["kind"] if "kind" in body else body["kind_of"])
    return Finding(
        kind, str(body.get("where", "")), str(body["text"]), str(body.get("channel") or ""),
        tuple((int(first), int(last)) for first, last in body.get("stretches", ())),
        () if time is None else ((float(time[0]), float(time[1])),), 0.0, body.get("stamp"), body.get("manifest_line"),
        bool(body.get("left_out")), bool(body.get("accepted")),
    )  # fmt: skip


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Stretches of true: first row and length."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return [(int(begin), int(end - begin)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def stretches_of(rows: Rows) -> Spans:
    """Rows that follow one another together: first and last of each."""
    if not len(rows):
        return ()
    flags = np.zeros(int(rows.max()) + 1, np.bool_)
    flags[rows] = True
    return tuple((first, first + count - 1) for first, count in runs(flags))


def listed(rows: Rows) -> str:
    """Row numbers in words: `row 5`, `rows 5, 9, 12 and 19 more`."""
    some = ", ".join(str(row) for row in rows[:SHOWN])
    more = f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else ""
    return f"row{'' if len(rows) == 1 else 's'} {some}{more}"
