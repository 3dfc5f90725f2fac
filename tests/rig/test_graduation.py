"""The pattern of an encoder's disk: found where two speeds share it, and not made of lines that err by themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rig.signals.encoder import LINES
from rig.signals.graduation import Graduation, graduation, line_errors
from rig.signals.rotation import Edges

SCAN = 320e-6  # s


def held(speed: float, disk: np.ndarray, turns: int = 20) -> Edges:
    """A hold at a constant speed, rad/s, each line seen at the end of the scan in which it passed; disk in rad."""
    angle = 2.0 * math.pi * np.arange(turns * LINES + 1) / LINES + np.append(np.tile(disk, turns), disk[0])
    times = np.ceil(angle / speed / SCAN) * SCAN
    first = np.arange(0, turns * LINES + 1, LINES)
    return Edges(times, -1, times[first], first - 1, (), 0, SCAN)


def found(disk: np.ndarray, speeds: tuple[float, ...] = (3.4907, 4.7124)) -> Graduation | None:
    return graduation([one for speed in speeds if (one := line_errors(held(speed, disk))) is not None])


def own(seed: int) -> np.ndarray:
    """Lines that err each for themselves, and a disk that sits beside the axis."""
    around = 2.0 * math.pi * np.arange(LINES) / LINES
    return 3.9e-5 * np.random.default_rng(seed).standard_normal(LINES) + 5e-5 * np.sin(around)


def pattern(rms: float, seed: int = 9) -> np.ndarray:
    """Straight lines between values at every tenth line."""
    nodes = np.random.default_rng(seed).standard_normal(LINES // 10)
    drawn = np.interp(np.arange(LINES), np.arange(0, LINES + 1, 10), np.append(nodes, nodes[0]))
    return np.asarray(drawn * rms / drawn.std())


@pytest.mark.parametrize("rms", [4e-5, 8e-5])
def test_a_pattern_is_found_as_large_as_it_is(rms: float) -> None:
    told = found(own(1) + pattern(rms))
    assert told is not None
    assert told.rms == pytest.approx(rms, rel=0.2)
    assert told.evidence > 100.0


def test_a_disk_whose_lines_err_each_for_themselves_has_none() -> None:
    for seed in range(6):
        told = found(own(seed))
        assert told is None or told.evidence < 15.0


def test_one_speed_says_nothing() -> None:
    assert found(pattern(8e-5), (4.7124, 4.7200)) is None


def test_lines_that_are_lost_or_too_few_turns_say_nothing() -> None:
    assert line_errors(held(4.7124, own(1), turns=5)) is None
    edges = held(4.7124, own(1))
    lost = Edges(np.delete(edges.times, 4321), -1, edges.index, edges.index_line, (999,), 0, SCAN)
    shifted = Edges(lost.times, -1, lost.index, lost.index_line - (lost.index_line > 4321), (999,), 0, SCAN)
    assert line_errors(shifted) is None
