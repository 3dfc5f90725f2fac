"""A platter that speeds up or coasts down: the encoder shows its motion to a small part of a gyro's noise."""

from __future__ import annotations

import fast_bench
import numpy as np
import pytest
from numpy.typing import NDArray

from fixtures.world import World
from rig.fit.evidence import evidence_of
from rig.parts.platter import Platter

Array = NDArray[np.float64]
SEED = 3
INSTANTS = 8  # of a window, whose mean rate is meant


@pytest.fixture(scope="module")
def turned() -> tuple[Platter, World]:
    """A short run, in which most of what moves speeds up or coasts down."""
    world = fast_bench.world(SEED)
    document = {"procedure": "turntable", "speed": "45 rpm", "revolutions": 4, "rest": "10 s"}
    parts = evidence_of([fast_bench.measure(document, world)]).parts
    return next(part for part in parts if isinstance(part, Platter)), world


def true_rate(platter: Platter, world: World) -> Array:
    """Mean rate of every window about the upward axis, rad/s, from the world's own formula."""
    data = platter.data
    within = (np.arange(INSTANTS) + 0.5) / INSTANTS - 0.5
    times = (data.time - world.epoch)[:, None] + data.interval * within
    _, rate, _ = world.physics.platter.motion(times.reshape(-1))
    return -np.asarray(rate, np.float64).reshape(times.shape).mean(axis=1)


def test_what_the_encoder_leaves_out_of_a_ramp_is_far_below_the_best_gyros_noise(turned: tuple[Platter, World]) -> None:
    platter, world = turned
    wrong = np.where(platter.data.counted.rate != 0.0, platter.data.counted.rate - true_rate(platter, world), 0.0)
    rows = platter.whitened(platter.channels.sensitivity[:, None] * wrong).reshape(len(platter.row_names), -1)
    backup = rows[platter.row_names.index("backup_yaw")]
    ramps = ~platter.of.steady[platter.of.stretch_of] & platter.domains()["1.2–3 Hz, moving"]
    assert np.count_nonzero(ramps) > 40
    assert float(np.mean(backup[ramps] ** 2)) < 0.1
