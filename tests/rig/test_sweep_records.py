"""Records of a sweep as rows: what each piece of a rest saw, and lines that cannot be told from the mains."""

from __future__ import annotations

import fast_bench
import numpy as np
import pytest

from rig.parts.reading.sweep import shaken
from rig.parts.sweep import Sweep
from rig.parts.sweep_records import LINES, WIDTH, SweepRecords

POINTS = {"procedure": "frequency_sweep", "axis": "x", "start": "30 Hz", "stop": "37 Hz", "points": 2}


@pytest.fixture(scope="module")
def records() -> SweepRecords:
    """Two frequencies in a world with mains at 50 Hz: five times the first is three times the mains."""
    (found,) = shaken(fast_bench.measure(POINTS, fast_bench.world(5)))
    return found


def test_every_second_of_a_rest_has_the_temperature_and_supply_of_that_second() -> None:
    world = fast_bench.world(5)
    (found,) = shaken(fast_bench.measure(POINTS, world))
    rest = (found.index < 0) & (found.begin < found.begin[found.index >= 0].min())
    assert rest.sum() == 30
    middle = 0.5 * (found.begin + found.end)[rest] - world.epoch
    truth = np.array([float(world.physics.surroundings.temperature(np.array([at]))[0]) for at in middle])
    assert np.ptp(truth) > 0.05
    np.testing.assert_allclose(found.temperature[rest], truth, atol=0.02)


def test_a_harmonic_that_lies_on_a_mains_line_is_not_compared_and_neither_is_that_line(records: SweepRecords) -> None:
    part = Sweep(records)
    counted = part.counted.reshape(len(part.row_names), len(records.frequency), WIDTH)[:, :, 1::2]
    names = [f"{k}f" for k in range(1, LINES - 2)] + ["mains", "3×mains"]
    at_30 = counted[:, records.nominal == 30.0].all(axis=(0, 1))
    at_37 = counted[:, records.nominal == 37.0].all(axis=(0, 1))
    assert dict(zip(names, at_30.tolist(), strict=True)) == {
        "1f": True, "2f": True, "3f": True, "4f": True, "5f": False, "mains": True, "3×mains": False,
    }  # fmt: skip
    assert at_37.all()
