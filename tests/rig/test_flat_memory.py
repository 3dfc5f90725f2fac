"""What a long record needs of memory while it is concluded: pieces of it, never all of it."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterator
from functools import cache

import fast_bench
import numpy as np
import pytest
from numpy.typing import NDArray

from rig.calibrate import resting
from rig.parts.platter import Platter
from rig.parts.reading import turntable
from rig.parts.reading.turntable import AT_ONCE, LOCAL, _local_median
from rig.record import Channel, Samples, Timing

DRAWS, RATE = 200, 3125
PIECE = 1 << 17  # scans


def peak(work: Callable[[], object]) -> float:
    """Most that it had at once beyond what was there before, MB; arrays count, mapped files do not."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


@cache
def platter(revolutions: int) -> Platter:
    document = {"procedure": "turntable", "axis": "yaw", "revolutions": revolutions, "rest": "4 s"}
    (part,) = turntable.read([fast_bench.measure(document, fast_bench.world(1))]).parts
    assert isinstance(part, Platter)
    return part


class Long:
    """Minutes of noise in pieces that are made as they are asked for."""

    name, header = "long", {"bench_file": {"cables": {"shaker": ["a"]}}}

    def __init__(self, minutes: float) -> None:
        self.scans = round(60.0 * minutes * RATE)
        body = {"purpose": "noise", "samples": "static", "cables": "shaker", "seconds": 60.0 * minutes}
        self.lines = [type("Line", (), {"kind": "point", "body": body})]

    def pieces(self, name: str) -> Iterator[Samples]:
        random = np.random.default_rng(1)
        for first in range(0, self.scans, PIECE):
            count = min(PIECE, self.scans - first)
            codes = (32768 + 40 * random.standard_normal((count, 1), np.float32)).astype(np.uint16)
            yield Samples(codes, (Channel("a", 0, -10.0, 10.0),), Timing(1.0 / RATE, 1), 0.0, first)


def test_noise_of_a_record_three_times_as_long_takes_no_more_memory() -> None:
    def looked(minutes: float) -> float:
        return peak(lambda: resting.noise_of([Long(minutes)], ["a"], {}))  # type: ignore[list-item]

    looked(0.5)  # what is loaded and planned once
    two, six = looked(2.0), looked(6.0)
    assert six < 1.1 * two + 1.0


def test_noise_is_drawn_without_ever_being_there() -> None:
    part = platter(24)

    def asked() -> None:
        drawn = part.noise_like(0, np.random.default_rng(3), DRAWS)
        part.felt(0, drawn, np.ones(part.rows))

    asked()
    assert peak(asked) < DRAWS * part.observed.shape[1] * 8e-6  # less than one array of it


def test_what_an_estimate_feels_of_drawn_noise_is_what_it_makes_of_its_windows() -> None:
    part, row = platter(2), 1
    random, n = np.random.default_rng(4), part.observed.shape[1]
    generator = np.random.default_rng(5)
    drawn = part.noise_like(row, generator, 2)
    windows = np.stack([part.summed(row, drawn, one) for one in np.eye(n)], axis=1)  # (draws, n)
    influence = random.standard_normal(part.rows)
    for noise, felt in zip(windows, part.felt(row, drawn, influence), strict=True):
        raw = np.zeros_like(part.observed)
        raw[row] = noise
        assert felt == pytest.approx(part.whitened(raw) @ influence, rel=1e-9)
    behind = generator.standard_normal()
    assert part.noise_like(row, np.random.default_rng(5), 2) == drawn
    assert behind != np.random.default_rng(5).standard_normal()  # what is drawn next comes behind it


def test_intervals_beside_the_seam_of_two_stretches_have_the_median_of_both() -> None:
    gaps: NDArray[np.float64] = np.random.default_rng(6).random(AT_ONCE + 100)
    padded = np.pad(gaps, LOCAL, mode="reflect")
    found = _local_median(gaps)
    for k in (0, AT_ONCE - 1, AT_ONCE, AT_ONCE + 1, len(gaps) - 1):
        assert found[k] == np.median(padded[k : k + 2 * LOCAL + 1])
