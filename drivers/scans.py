"""Scans out of a stream of conversions: what the local converter and the remote one have in common.

A multiplexed converter gives one number after another in lumps that end anywhere. Here the lumps become scans again,
and every scan is checked on the way in:

- a *tag* channel carries a known reference voltage. If a conversion was lost between board and memory nothing says so,
  but every later number stands in the wrong column, and the tag is no longer where it should be (das16 driver: hardware
  overruns are never looked at). A scan counts as good once its own tag and that of the next scan have been seen; so
  one scan more is asked of the board than is handed out.
- the pacer: the 1/10 MHz jumper is not probed by the board's driver, and a wrong one makes every rate wrong by ten. The
  conversions that arrived are held against the clock of the machine the board is in.

Nothing is handed out after the first sign of trouble, and nothing before it is lost: `Record.failure` says what
happened, and `Record.take` still gives the good scans before it.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.record import Channel, Samples, Timing
from rig.room import Clock

LUMP = 0.05
"""The board's driver moves data on a timer of this period, s (das16 driver: HZ/20)."""

LATENESS = 0.03
"""Time allowed beyond a lump for data to be on their way, s."""

PACER = 1e-4
"""The pacer's crystal may be slower than the bench's clock by this share (typical 50–100 ppm)."""

PIECE = 1.0
"""Longest bench time between two looks at the data, s."""

CHANNELS = 16
FASTEST = 100_000.0
"""Conversions per second of the whole board (ADS7805: 10 µs each)."""


@dataclass(frozen=True)
class Tag:
    """The channel that proves the order of channels.

    `column` of the scan; V `expected` ± `tolerance`; and no step larger than `step` (V) from one scan to the next,
    because a sensor at rest may happen to sit within the tolerance.
    """

    column: int
    expected: float
    tolerance: float
    step: float


@dataclass(frozen=True)
class Failure:
    """Why a record ended early: a `state` of one word, what was `found`, what was `wanted`."""

    state: str
    found: str
    wanted: str


def refusal(rate: float, channels: Sequence[str], tag: str) -> str:
    """What is wrong with a configuration, as `found …, wanted …`; empty if nothing is."""
    if not 1 <= len(channels) <= CHANNELS or len(set(channels)) != len(channels):
        return f"found channels {', '.join(channels) or 'none'}, wanted 1…{CHANNELS} different names"
    if tag not in channels:
        return f"found channels {', '.join(channels)}, wanted the tag channel '{tag}' among them"
    if not 0 < rate * len(channels) <= FASTEST:
        return f"found {rate:g} Hz on {len(channels)} channels, wanted at most {FASTEST:g} conversions per second"
    return ""


class Pacer:
    """Conversions against the clock of the machine that takes them, from the moment the run was started.

    What has arrived is late by a lump at most and early never; `tolerance` is the relative error allowed besides.
    """

    def __init__(self, convert_period: float, tolerance: float) -> None:
        self._period, self._tolerance = convert_period, tolerance
        self._begun: tuple[int, int] | None = None
        self.pace: tuple[float, float] | None = None
        """What was converted since then, s by the pacer, and when it was taken, s by the machine's clock: of the lump
        before the last one, for what ends a record is less than a lump and waits for the same tick."""
        self._latest: tuple[float, float] | None = None

    def begin(self, conversions: int, taken_ns: int) -> None:
        """So many conversions had been made at this time. Only the first call counts."""
        self._begun = self._begun or (conversions, taken_ns)

    def compare(self, conversions: int, taken_ns: int, *, prompt: bool = True) -> Failure | None:
        """What is not plausible about so many `conversions` so far, taken from the board at this time.

        Too few are suspicious only if they were taken `prompt`ly, as soon as the board had them.
        """
        self.begin(conversions, taken_ns)
        assert self._begun is not None
        elapsed = (taken_ns - self._begun[1]) * 1e-9
        converted = (conversions - self._begun[0]) * self._period
        if prompt:
            self.pace, self._latest = self._latest, (converted, elapsed)
        fast = converted > elapsed * (1.0 + self._tolerance) + LATENESS
        slow = prompt and converted < elapsed * (1.0 - self._tolerance) - LUMP - LATENESS
        if not (fast or slow):
            return None
        return Failure(
            "clock",
            f"conversions {converted / max(elapsed, 1e-3):.3g} times as fast as the board says",
            f"conversions every {self._period * 1e6:g} µs: check the board's 1/10 MHz pacer clock jumper against the "
            "clock option of comedi_config",
        )


class Record:
    """One record while it grows: lumps of codes in, good scans out."""

    def __init__(
        self,
        channels: tuple[Channel, ...],
        timing: Timing,
        tag: Tag,
        *,
        scans: int | None,
        start: float,
        pacer_tolerance: float,
    ) -> None:
        """`scans` to be handed out (None: until stopped); `start`: bench-clock time of the first conversion, s."""
        self.channels, self.timing, self.scans, self.start = channels, timing, scans, start
        self.received = 0
        """Conversions taken in."""
        self.handed = 0
        """Scans handed out."""
        self.failure: Failure | None = None
        self.ended = self.stopped = False
        """`ended`: no more conversions will come. `stopped`: because we said so."""
        self._tag = tag
        self._low, self._high, self._step = _tag_codes(tag, channels[tag.column])
        self._tags_seen, self._last_tag = 0, 0
        self._pacer = Pacer(timing.convert_period, pacer_tolerance)
        self._pieces: deque[NDArray[np.uint16]] = deque()

    @property
    def available(self) -> int:
        """Good scans not handed out yet."""
        proven = min(self._tags_seen - 1, self.received // len(self.channels))
        if self.scans is not None:
            proven = min(proven, self.scans)
        return max(proven - self.handed, 0)

    @property
    def complete(self) -> bool:
        """Whether all the scans that were wanted have been handed out."""
        return self.scans is not None and self.handed >= self.scans

    @property
    def state(self) -> str:
        """`running`, `done`, `stopped`, or the failure's state."""
        if self.failure is not None:
            return self.failure.state
        if self.complete:
            return "done"
        return "stopped" if self.ended else "running"

    @property
    def short(self) -> bool:
        """Whether more scans were wanted than have been proven good."""
        return self.scans is None or self.handed + self.available < self.scans

    def has(self, scans: int) -> bool:
        """Whether `scans` more, or all that are still wanted, can be handed out; never with a wrong pacer clock."""
        if self.failure is not None and self.failure.state == "clock":
            return False
        wanted = scans if self.scans is None else min(scans, self.scans - self.handed)
        return self.available >= wanted

    def begin(self, taken_ns: int) -> None:
        """The run was started at this time of the machine that the board is in."""
        self._pacer.begin(0, taken_ns)

    def add(self, codes: NDArray[np.uint16], taken_ns: int, *, prompt: bool = True) -> None:
        """Take in the next conversions, in order, that were taken from the board at `taken_ns` (machine's clock).

        `prompt`: as soon as the board had them, so that too few of them mean a slow pacer.
        """
        if self.failure is not None or not len(codes):
            return
        self._check_tags(codes)
        self._pieces.append(codes)
        self.received += len(codes)
        implausible = self._pacer.compare(self.received, taken_ns, prompt=prompt)
        self.failure = self.failure or implausible

    def fail(self, state: str, found: str, wanted: str) -> None:
        """Nothing that comes after this belongs to the record. The first failure stays."""
        if self.failure is None:
            self.failure = Failure(state, found, wanted)

    def stop(self) -> None:
        """No more is wanted; what has arrived stays."""
        self.ended = self.stopped = True

    def take(self, scans: int) -> Samples:
        """The next stretch: so many scans, or the good ones that are there if they are fewer.

        Flags: "clipped" if a first or last code is among them; "last" when the record is over; when it ended early the
        failure's state, if nothing good is left after this stretch.
        """
        count = min(scans, self.available)
        counts = self._cut(count * len(self.channels)).reshape(count, len(self.channels))
        counts.flags.writeable = False
        first, self.handed = self.handed, self.handed + count
        flags = self._flags(counts)
        return Samples(counts, self.channels, self.timing, self.start, first, flags, self._pacer.pace)

    def _flags(self, counts: NDArray[np.uint16]) -> frozenset[str]:
        flags = set()
        if counts.size and (int(counts.min()) == 0 or int(counts.max()) == 65535):
            flags.add("clipped")
        if self.failure is not None and not self.available:
            flags.add(self.failure.state)
        elif self.complete or (self.ended and not self.available):
            flags.add("last")
        return frozenset(flags)

    def _cut(self, conversions: int) -> NDArray[np.uint16]:
        """The next codes as one array of their own."""
        taken: list[NDArray[np.uint16]] = [np.empty(0, np.uint16)]
        while conversions:
            piece = self._pieces.popleft()
            if len(piece) > conversions:
                self._pieces.appendleft(piece[conversions:])
                piece = piece[:conversions]
            taken.append(piece)
            conversions -= len(piece)
        return np.concatenate(taken)

    def _check_tags(self, codes: NDArray[np.uint16]) -> None:
        """Look at the tag of every scan in these codes; the first wrong one is a slip."""
        width = len(self.channels)
        tags = codes[(self._tag.column - self.received) % width :: width].astype(np.int32)
        if not len(tags):
            return
        before = self._last_tag if self._tags_seen else int(tags[0])
        steps = np.abs(np.diff(tags, prepend=before))
        wrong = (tags < self._low) | (tags > self._high) | (steps > self._step)
        if not wrong.any():
            self._tags_seen, self._last_tag = self._tags_seen + len(tags), int(tags[-1])
            return
        first = int(np.argmax(wrong))
        self._tags_seen += first
        self._slipped(self._tags_seen, int(tags[first]))

    def _slipped(self, scan: int, code: int) -> None:
        channel = self.channels[self._tag.column]
        volts = code / 65535.0 * (channel.high - channel.low) + channel.low
        self.fail(
            "slip",
            f"{volts:.4f} V on channel '{channel.name}' in scan {scan}",
            f"{self._tag.expected:g} V ± {self._tag.tolerance:g} V, steady within {self._tag.step:g} V: a "
            f"conversion was lost, or the tag is not wired; scans before {max(scan - 1, 0)} are good",
        )


def _tag_codes(tag: Tag, channel: Channel) -> tuple[float, float, float]:
    """Lowest and highest code of a good tag, and the largest step, in codes."""
    scale = 65535.0 / (channel.high - channel.low)
    middle = (tag.expected - channel.low) * scale
    return middle - tag.tolerance * scale, middle + tag.tolerance * scale, tag.step * scale


def await_scans(record: Record, scans: int, clock: Clock, pump: Callable[[float], bool], patience: float) -> bool:
    """Let the bench's time pass until `scans` more must be there, then wait for them in real time.

    `pump(seconds)` takes in what comes within so much real time and says whether anything came. False after `patience`
    seconds of real time without anything. How long the bench's time passes depends only on the bench's clock, so a
    simulated bench gives the same world every time.
    """

    def settled() -> bool:
        return record.has(scans) or record.failure is not None or record.ended

    if record.stopped:
        return True
    left = _due(record, scans) - clock.now()
    while left > 0 and record.failure is None:
        clock.sleep(min(left, PIECE))
        left -= PIECE
        while not settled() and pump(0.0):
            pass
    silent_at = time.monotonic() + patience
    while not settled():
        rest = silent_at - time.monotonic()
        if rest <= 0:
            return False
        if pump(rest):
            silent_at = time.monotonic() + patience
    return True


def _due(record: Record, scans: int) -> float:
    """The bench-clock time (s) at which `scans` more, and the next one's tag, must have left the board."""
    last = record.handed + scans if record.scans is None else min(record.handed + scans, record.scans)
    conversions = (last + 1) * len(record.channels)
    return record.start + conversions * record.timing.convert_period * (1.0 + PACER) + LUMP + LATENESS
