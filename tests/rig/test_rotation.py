"""The encoder's motion: whole turns have no bias, the track states its error, a long record is one fit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import make_lsq_spline

from rig.errors import BadInput
from rig.signals.rotation import DEGREE, KNOT, Edges, Track, graduation_map, turns

INTERVAL = 320e-6  # s between samples of a channel
OMEGA = 2.0 * np.pi * 0.75  # rad/s, 45 rpm


def angle(t: np.ndarray) -> np.ndarray:
    """Wow of 0.2 % once per revolution."""
    return OMEGA * t + 0.002 * np.sin(OMEGA * t)


def rate(t: np.ndarray) -> np.ndarray:
    return OMEGA * (1.0 + 0.002 * np.cos(OMEGA * t))


def edges_at(angles: np.ndarray, *, jitter: int | None = None, sampled: bool = False) -> Edges:
    """Edges where the platter reaches these angles; uniform timing error, or seen by samples."""
    t = angles / OMEGA
    for _ in range(30):
        t = t - (angle(t) - angles) / rate(t)
    if jitter is not None:
        t = t + INTERVAL * (np.random.default_rng(jitter).random(len(t)) - 0.5)
    if sampled:
        t = (np.ceil(t / INTERVAL) - 0.5) * INTERVAL
    lines = np.arange(999, len(t), 1000)
    return Edges(t, -1, t[lines], lines, (), 0, INTERVAL)


def test_whole_revolutions_have_no_bias_with_wow_and_eccentricity() -> None:
    lines = 2.0 * np.pi * np.arange(60_500) / 1000.0
    found = turns(edges_at(lines + 0.001 * np.sin(lines), sampled=True))
    assert len(found.bounds) == 60
    assert abs(found.mean_rate / -OMEGA - 1.0) < 1e-5
    assert abs(found.mean_rate + OMEGA) < 4.0 * found.u_mean_rate


def test_the_error_of_the_local_rate_is_what_the_track_states() -> None:
    lines = 2.0 * np.pi * np.arange(6_000) / 1000.0
    where = np.linspace(0.7, 7.0, 150)
    ratios = []
    for seed in range(25):
        track = Track(edges_at(lines, jitter=seed))
        ratios.append((track.rate(where) + rate(where)) / np.sqrt(track.variance(where)[1]))
    assert 0.9 < float(np.sqrt(np.mean(np.square(ratios)))) < 1.1


def test_a_long_record_fitted_in_stretches_is_the_same_as_one_fit() -> None:
    edges = edges_at(2.0 * np.pi * np.arange(30_000) / 1000.0, jitter=3)
    track = Track(edges)
    whole = make_lsq_spline(
        edges.times, -2.0 * np.pi * np.arange(30_000) / 1000.0, track.knots, DEGREE, w=track._weights
    )
    where = np.linspace(edges.times[10], edges.times[-10], 5_000)
    assert len(track.knots) > 3 * 256
    assert float(np.max(np.abs(track.angle(where) - whole(where)))) < 1e-9


def test_a_planted_pattern_of_the_disk_comes_back() -> None:
    number = np.arange(30_500)
    planted = 1e-3 * np.cos(2.0 * np.pi * 100.0 * number / 1000.0)  # shorter than a knot: the spline cannot follow it
    found = graduation_map(Track(edges_at(2.0 * np.pi * number / 1000.0 - planted, jitter=1)))
    first = 1000  # the line after the first index
    seen = found.lines - found.lines.mean()
    expected = -1e-3 * np.cos(2.0 * np.pi * 100.0 * (first + np.arange(1000)) / 1000.0)
    assert float(np.corrcoef(seen, expected)[0, 1]) ** 2 > 0.9
    assert KNOT > 10
    assert found.revolutions >= 28


def test_lost_lines_are_refused() -> None:
    edges = edges_at(2.0 * np.pi * np.arange(5_000) / 1000.0)
    lost = Edges(edges.times, -1, edges.index, np.array([999, 1999, 2990, 3999]), (), 0, INTERVAL)
    with pytest.raises(BadInput, match="lines were lost"):
        turns(lost)
