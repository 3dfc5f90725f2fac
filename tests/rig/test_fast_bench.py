"""The bench in memory against the world's own truth, and against a run that the program made over its links."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fast_bench
import numpy as np
import pytest

from fixtures.channels import SHAKER_CABLES
from rig.archive.journal import Entry
from rig.archive.runs import Runs
from rig.bench.assembly import state_folder
from rig.bench.benchfile import describe
from rig.bench.control import stop
from rig.signals import tone

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 3, "static": "1 s"}


def test_sine_points_are_the_true_sensitivity_times_acceleration_through_the_true_pole() -> None:
    world = fast_bench.world(7)
    records = fast_bench.measure(SWEEP, world)
    truth, pacer = world.truth, 1.0 + world.truth["pacer_error"]
    assert len(records.points) == 6
    for body in records.points.values():
        samples = records.samples(body["samples"])
        frequency = body["frequency"] * (1.0 + truth["generator_error"])  # as the converter's crystal counts
        stroke = abs(world.physics.shaker.stroke(frequency)) * body["source"]
        acceleration = stroke * (2.0 * math.pi * frequency * pacer) ** 2
        for name in ("unit_a_x", "unit_b_x", "unit_c_x"):
            fitted = tone.fit_three(samples.instants(name), samples.volts(name), frequency)
            through = abs(1.0 / (1.0 + 1j * frequency / truth["pole"][name]))
            noise = 5.0 * 2e-3 * math.sqrt(2.0 / len(samples.counts))  # five sigma of 2 mV, the noisiest unit
            assert abs(fitted.amplitude) == pytest.approx(
                truth["sensitivity"][name] * acceleration * through, abs=noise
            )
        shown = body["velocity"] / truth["ldv_gain"] * 2.0 * math.pi * frequency
        assert shown == pytest.approx(acceleration, rel=2e-3)


def test_the_delay_between_channels_is_that_of_their_slots() -> None:
    world = fast_bench.world(7)
    records = fast_bench.measure({**SWEEP, "levels": ["full"]}, world)
    body = max(records.points.values(), key=lambda point: point["frequency"])
    frequency = body["frequency"] * (1.0 + world.truth["generator_error"])
    samples = records.samples(body["samples"])
    found = {}
    for name in ("ldv", "unit_b_x"):
        fitted = tone.fit_three(samples.instants(name), samples.volts(name), frequency)
        found[name] = complex(fitted.amplitude)
    pole = world.truth["pole"]["unit_b_x"]
    optics = world.vibrometer.response(np.array([frequency]))[0] * world.physics.filter.at(np.array([frequency]))[0]
    wanted = 1j / (1.0 + 1j * frequency / pole) / (optics / abs(optics))
    ratio = found["unit_b_x"] / found["ldv"]
    # one slot is 20 µs, 3.6° at 500 Hz; noise of 1 mV over 3125 samples of 320 mV leaves 0.1 mrad
    assert np.angle(ratio / wanted) == pytest.approx(0.0, abs=1e-3)


def test_a_hold_has_the_rate_of_the_platter_between_the_same_instants() -> None:
    world = fast_bench.world(3)
    document = {"procedure": "turntable", "speed": "33 1/3 rpm", "axis": "yaw", "revolutions": 6, "rest": "2 s"}
    records = fast_bench.measure(document, world)
    body = next(body for body in records.points.values() if body.get("phase") == "hold")
    begun = records.samples(body["samples"]).start - world.epoch
    ends = np.array([body["first_index"], body["last_index"]]) + begun
    first, last = world.physics.platter.motion(ends)[0]
    # each end of the 54 s lies within one sample, and the disk is right within 20 arcsec
    assert last - first == pytest.approx(2.0 * math.pi * 6, abs=4.0 * 320e-6 * abs(body["rate"]))
    assert body["rate"] == pytest.approx(-(last - first) / (ends[1] - ends[0]), rel=2e-4)
    assert [b["phase"] for b in records.points.values() if "phase" in b] == ["spin_up", "hold", "coast_down"]


def test_long_records_go_on_without_a_break_and_the_world_goes_on_between_runs() -> None:
    world = fast_bench.world(1)
    records = fast_bench.measure({"procedure": "noise", "length": "20 s"}, world)
    (body,) = records.points.values()
    samples = records.samples(body["samples"])
    assert [c.name for c in samples.channels] == list(SHAKER_CABLES)
    assert samples.counts.shape == (62_500, 16)
    yaw = samples.volts("gyro_yaw") - samples.volts("gyro_yaw").mean()
    # a one-pole of 55 Hz keeps 0.9 from sample to sample, also where one stretch of 8 s follows another
    seams = np.array([25_000, 50_000])
    assert np.all(np.abs(yaw[seams] - yaw[seams - 1]) < 6.0 * np.std(np.diff(yaw)))
    again = fast_bench.measure({"procedure": "noise", "length": "1 s"}, world)
    assert again.header["started"] == pytest.approx(records.lines[-1].t)
    assert not np.array_equal(again.block(body["samples"])[:100], samples.counts[:100])
    records.close()
    with pytest.raises(KeyError):
        records.samples(body["samples"])


def test_the_same_seed_gives_the_same_counts_and_another_seed_others() -> None:
    def counts(seed: int) -> np.ndarray[Any, Any]:
        records = fast_bench.measure({"procedure": "noise", "length": "1 s"}, fast_bench.world(seed))
        return records.block(next(iter(records.points.values()))["samples"])

    assert np.array_equal(counts(5), counts(5))
    assert not np.array_equal(counts(5), counts(6))


def test_a_sequence_with_a_remount_leaves_the_filter_as_verified() -> None:
    text = (
        "title: small\nsteps:\n  - prompt: Warm?\n  - repeat: 2\n    steps:\n"
        "      - {procedure: frequency_sweep, axis: z, points: 1, static: 0 s}\n"
    )
    world = fast_bench.world(1)
    records = fast_bench.measure(text, world)
    asked = [entry.body["action"] for entry in records.lines if entry.kind == "confirmed"]
    assert (asked[0], asked.count("remount"), len(records.points)) == ("confirm", 1, 4)
    found = next(e.body["filter"] for e in records.lines if e.kind == "step" and "filter" in e.body)
    assert found["measured_cutoff"] == pytest.approx(world.physics.filter.true_cutoff, rel=1e-4)


def test_the_journal_is_that_of_a_run_over_the_links(tmp_path: Path) -> None:
    arguments = ["sweep", "--axis", "x", "--points", "1", "--runs", str(tmp_path)]
    try:
        subprocess.run([sys.executable, "-m", "rig", *arguments], check=True, capture_output=True)
    finally:
        stop(state_folder(describe(fast_bench.BENCH), tmp_path))
    real = list(Runs(tmp_path).open("last").lines())
    here = fast_bench.measure({"procedure": "frequency_sweep", "axis": "x", "points": 1}, fast_bench.world(1)).lines
    assert [_shape(entry) for entry in here] == [_shape(entry) for entry in real]
    pairs = [(a.body, b.body) for a, b in zip(here, real, strict=True) if a.kind == "point"]
    assert pairs
    for mine, theirs in pairs:
        assert mine["scale"] == theirs["scale"]
        assert mine["drive_constant"] == pytest.approx(theirs["drive_constant"], rel=1e-3)
        assert mine["conditions"] == pytest.approx(theirs["conditions"], rel=1e-3)


def _shape(entry: Entry) -> tuple[str, object]:
    return entry.kind, _keys(entry.body)


def _keys(value: object) -> object:
    """Keys in order, however deep; lists by their length and first element."""
    if isinstance(value, Mapping):
        return [(key, _keys(item)) for key, item in value.items() if key != "shape"]
    if isinstance(value, list):
        return [len(value), _keys(value[0]) if value else None]
    return isinstance(value, str)
