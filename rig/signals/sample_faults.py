"""Samples that are no measurement, seen in a converter's codes: stuck, on the rails, cut off, alone, a bit that hangs.

A sensor behind a filter always shows noise of some codes, so that codes repeat only by chance, and what it feels lasts
for several samples. Nothing here knows what the channel is or how it moves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.uint16]
LAST = 65535  # code of a 16-bit converter
BY_CHANCE = 1e-9  # stretches of one code in a record that chance may make
HELD = 32  # samples of one code at least: behind a slow filter neighbours are alike for more than chance
SPAN = 50  # blocks of a piece, of whose shares of equal neighbours the median is taken
PILE, EMPTY, INWARD = 16, 5.0, 10  # samples at an extreme; times as many as at any of the next codes
VISITS = 4  # stretches at an extreme: noise behind a slow filter may linger at its own once
ALONE = 20.0  # robust standard deviations off the middle of both neighbours: a step between two stretches is no spike
COARSE = 2.0  # codes: behind a slow filter neighbours differ by a few, and those are not normally distributed
SINGLE = 1.5  # times what the neighbours are off: exactly two for a single sample, one for a step
WINDOWS = 4  # side by side, each with both values of a bit
EDGE = 8  # parts of half a window, of which the one beside an empty half is looked at
ABRUPT = 0.25  # of what it would hold if all did alike
JUMPS = 1e-3  # share of steps that jump by a bit
STILL = 0.2  # of a bit, standard deviation of the others: two or three points of a sine leave more
ALIKE = 1.5  # times that, of what jumps are off a bit
FEWEST = 16  # samples that say something


@dataclass(frozen=True)
class Faults:
    """Of one channel in one record: `count` samples; how many are on the rails, in a stretch of one `code` that chance
    does not make, at an extreme inside the range where they pile up, and alone; the bit that never changes, or -1.
    """

    count: int
    railed: int = 0
    stuck: int = 0
    code: int = 0
    cut: int = 0
    alone: int = 0
    bit: int = -1

    def joined(self, other: Faults) -> Faults:
        """Of two stretches of a record; a bit hangs only if it does in both."""
        return Faults(
            self.count + other.count, self.railed + other.railed, self.stuck + other.stuck,
            self.code if self.stuck >= other.stuck else other.code, self.cut + other.cut, self.alone + other.alone,
            self.bit if self.bit == other.bit else -1,
        )  # fmt: skip

    @property
    def lost(self) -> float:
        """Share of the samples that show nothing at all."""
        return max(self.stuck, self.railed) / max(self.count, 1)

    def __iter__(self) -> Iterator[str]:
        """Everything that is wrong, in words."""
        if self.stuck:
            yield f"stuck at 0x{self.code:04X}, {_share(self.stuck / self.count)} of samples"
        elif self.railed:
            yield f"clipped, {_share(self.railed / self.count)} of samples"
        if self.cut:
            yield f"cut off inside the range, {_share(self.cut / self.count)} of samples at an extreme"
        if self.alone:
            yield f"{self.alone} sample{'s stand' if self.alone > 1 else ' stands'} alone"
        if self.bit >= 0:
            yield f"bit {self.bit} never changes"


def faults(codes: Codes) -> Faults:
    """What is wrong with one channel's codes in a stretch of a record, (n,)."""
    count = len(codes)
    railed = int(np.count_nonzero((codes == 0) | (codes == LAST)))
    if count < FEWEST:
        return Faults(count, railed)
    stuck, code = _stuck(codes)
    return Faults(
        count, railed, stuck, code, 0 if stuck or railed else _cut(codes), 0 if stuck > count // 2 else _alone(codes),
        -1 if stuck else _hanging(codes),
    )  # fmt: skip


def together(pieces: Iterable[Faults]) -> Faults:
    """Of all stretches of a record."""
    found: Faults | None = None
    for piece in pieces:
        found = piece if found is None else found.joined(piece)
    return found or Faults(0)


def _share(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share >= 0.01 else f"{100.0 * share:.2g} %"


def _stuck(codes: Codes) -> tuple[int, int]:
    """Samples in stretches of one code longer than chance makes them, and the code of the longest.

    With a share p of samples like the one before, n samples have a stretch of r by chance n·p^(r−1) times.
    """
    ends = np.flatnonzero(np.diff(codes)) + 1
    bounds = np.concatenate([[0], ends, [len(codes)]])
    lengths = np.diff(bounds)
    longest = int(lengths.argmax())
    if lengths[longest] == len(codes):
        return len(codes), int(codes[0])
    p = min(max(_alike(codes), 1.0 / len(codes)), 1.0 - 1e-9)
    most = max(math.log(len(codes) / BY_CHANCE) / -math.log(p) + 2.0, HELD)
    long = lengths > most
    return int(lengths[long].sum()), int(codes[bounds[longest]])


def _alike(codes: Codes) -> float:
    """Share of samples like the one before: the median of blocks, so that one stuck stretch does not count."""
    same = np.diff(codes) == 0
    size = max(len(same) // SPAN, 1)
    blocks = same[: len(same) // size * size].reshape(-1, size).mean(axis=1)
    return float(np.median(blocks))


def _cut(codes: Codes) -> int:
    """Samples that pile up at an extreme code as at none of the next inside it."""
    found, low, high = 0, int(codes.min()), int(codes.max())
    if high - low <= 2 * INWARD:
        return 0
    for extreme, inward in ((low, range(low + 1, low + INWARD + 1)), (high, range(high - INWARD, high))):
        at = codes == extreme
        here, visits = int(np.count_nonzero(at)), int(np.count_nonzero(at[1:] > at[:-1]))
        if (
            here >= PILE
            and visits >= VISITS
            and here > EMPTY * max(int(np.count_nonzero(codes == one)) for one in inward)
        ):
            found += here
    return found


def _alone(codes: Codes) -> int:
    """Single samples far off the middle of their neighbours."""
    values = codes.astype(np.float64)
    off = values[1:-1] - 0.5 * (values[:-2] + values[2:])
    size = np.abs(off)
    scale = max(1.4826 * float(np.median(size)), float(np.quantile(size, 0.99)) / 2.576, COARSE)
    far = np.flatnonzero(size[1:-1] > ALONE * scale) + 1
    beside = np.maximum(size[far - 1], size[far + 1])
    return int(np.count_nonzero(size[far] > SINGLE * beside))


def _hanging(codes: Codes) -> int:
    """The highest bit that never changes though the codes go through both its values; -1 without one.

    Of neighbouring windows that hold both, one half is always empty; two levels far apart are no neighbours. Of few
    windows, the codes end as abruptly on both sides of what is empty as no noise about two levels does; or they jump by
    the bit again and again, and otherwise hardly move.
    """
    changed = int(np.bitwise_or.reduce(codes ^ codes[0]))
    span = int(codes.max()) - int(codes.min())
    steps = np.asarray(np.diff(codes.astype(np.int64)), np.int64)
    for bit in (one for one in range(13, -1, -1) if not changed >> one & 1 and 1 << one <= 2 * span):
        windows, each = np.unique(codes >> (bit + 1), return_counts=True)
        used = windows[each >= PILE].astype(np.int64)
        rows = np.split(used, np.flatnonzero(np.diff(used) != 1) + 1)
        many = WINDOWS << (bit + 1) <= span and max(map(len, rows)) >= WINDOWS
        if many or any(_torn(codes, bit, int(low)) for row in rows for low in row[:-1]) or _jumps(steps, 1 << bit):
            return bit
    return -1


def _torn(codes: Codes, bit: int, window: int) -> bool:
    """Whether codes end abruptly on both sides of the empty half between a window and the next."""
    half = 1 << bit
    edge = half // EDGE
    first = (window << (bit + 1)) + (half if codes[0] >> bit & 1 else 0)
    for begin, at in ((first, first + half - edge), (first + 2 * half, first + 2 * half)):
        inside = np.count_nonzero((codes >= begin) & (codes < begin + half))
        beside = np.count_nonzero((codes >= at) & (codes < at + edge))
        if beside < max(PILE, ABRUPT * inside / EDGE):
            return False
    return edge > 0


def _jumps(steps: NDArray[np.int64], size: int) -> bool:
    """Whether the steps from sample to sample are as large as a bit, give or take what they are otherwise, or small."""
    jumps = np.abs(steps) > size // 2
    if np.count_nonzero(jumps) < max(PILE, JUMPS * len(steps)) or jumps.all():
        return False
    small = max(float(np.std(steps[~jumps])), 0.5)
    left = np.abs(steps[jumps]) - size
    return small < STILL * size and math.sqrt(float(np.mean(left**2))) < ALIKE * small
