"""Planted faults are as strong as they say, where they say, the same for the same seed, and spare everything else."""

from __future__ import annotations

import fast_bench
import faults
import numpy as np
import pytest
from faults import KINDS, Record, planted, planted_in_run

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 4, "static": "2 s", "static_after": "1 s"}
TURNS = {"procedure": "turntable", "revolutions": 3, "rest": "3 s"}
GAIN, NOISE, ZERO = 0.07, 0.01, 1.65


def record(seed: int = 0) -> Record:
    """Ten seconds of a slow swing, in volts."""
    time = np.arange(0.0, 10.0, 0.01)
    reference = 9.0 * np.sin(2.0 * np.pi * 0.7 * time)
    device = ZERO + GAIN * reference + NOISE * np.random.default_rng(seed).standard_normal(len(time))
    return Record(time, reference, device, NOISE, GAIN, ZERO)


@pytest.fixture(scope="module")
def sweep() -> fast_bench.MemoryRecords:
    return fast_bench.measure(SWEEP, fast_bench.world(4))


@pytest.fixture(scope="module")
def turns() -> fast_bench.MemoryRecords:
    return fast_bench.measure(TURNS, fast_bench.world(4))


@pytest.mark.parametrize("wanted", [10.0, 60.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_adds_the_chi_squared_that_is_wanted(kind: str, wanted: float) -> None:
    for seed in range(5):
        clean = record(seed)
        faulty, fault = planted(clean, kind, wanted, seed)
        left = (faulty.device - GAIN * faulty.reference) - (clean.device - GAIN * clean.reference)
        strength = np.sqrt(np.sum((left / NOISE) ** 2))
        assert strength == pytest.approx(fault.d_prime, rel=1e-9)
        # an output sticks for whole samples, and where it swings the next one adds much
        assert strength == pytest.approx(wanted, rel=0.8 if kind == "stuck" else 0.01)
        assert strength > 0.99 * wanted
        outside = np.ones(len(left), np.bool_)
        outside[fault.first : fault.last] = False
        assert not left[outside].any()


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_tells_all_and_another_seed_something_else(kind: str) -> None:
    (one, first), (two, again), (other, third) = (planted(record(), kind, 30.0, seed) for seed in (3, 3, 4))
    assert first == again
    assert np.array_equal(one.device, two.device)
    assert np.array_equal(one.reference, two.reference)
    different = not np.array_equal(one.device, other.device) or not np.array_equal(one.reference, other.reference)
    assert different or first.size == third.size  # of a drift or clipping only the sign is drawn


def test_each_kind_is_what_its_name_says() -> None:
    clean = record()
    made = {kind: planted(clean, kind, 50.0, 1) for kind in KINDS}
    glitchy, fault = made["glitch"]
    assert 1 <= np.count_nonzero(glitchy.device - clean.device) <= faults.MOST_GLITCHES
    stuck, fault = made["stuck"]
    assert np.ptp(stuck.device[fault.first - 1 : fault.last]) == 0.0
    clipped, fault = made["clipping"]
    assert fault.size in (clipped.device.max(), clipped.device.min())
    assert np.count_nonzero(clipped.device == fault.size) > 10
    stepped, fault = made["reference_step"]
    assert np.array_equal(stepped.device, clean.device)
    assert stepped.reference[-1] - clean.reference[-1] == pytest.approx(fault.size)
    drifted, fault = made["drift"]
    assert (drifted.device - clean.device)[[0, -1]] == pytest.approx([0.0, fault.size])
    louder, fault = made["gain_step"]
    after = slice(fault.first, None)
    assert (louder.device - ZERO)[after] == pytest.approx((1.0 + fault.size) * (clean.device - ZERO)[after])


def test_what_a_record_cannot_have_is_refused() -> None:
    still = Record(np.arange(10.0), np.zeros(10), ZERO + NOISE * np.arange(10.0), NOISE, GAIN, ZERO)
    with pytest.raises(ValueError, match="found a record at rest, wanted one with motion"):
        planted(still, "gain_step", 10.0, 1)
    with pytest.raises(ValueError, match="wanted one of glitch, stuck"):
        planted(still, "gremlin", 10.0, 1)


@pytest.mark.parametrize("kind", KINDS)
def test_in_a_run_one_channel_of_one_record_is_changed(sweep: fast_bench.MemoryRecords, kind: str) -> None:
    faulty, fault = planted_in_run(sweep, kind, 40.0, 2)
    changed = {
        (name, column)
        for name in sweep.metas
        if name in sweep.arrays
        for column in np.flatnonzero(
            (np.atleast_2d(faulty.block(name)) != np.atleast_2d(sweep.block(name))).any(axis=0)
        )
    }
    ((block, column),) = changed
    assert block == fault.block
    assert sweep.metas[block]["channels"][column][0] == fault.channel
    assert fault.channel.startswith("ldv" if kind == "reference_step" else ("unit", "gyro"))
    assert faulty.block(block).dtype == sweep.block(block).dtype
    assert 20.0 < fault.d_prime < 160.0  # in whole codes, of which the vibrometer's noise is hardly one
    assert planted_in_run(sweep, kind, 40.0, 2)[1] == fault


def test_a_turntable_has_no_reference_in_volts_but_every_other_fault(turns: fast_bench.MemoryRecords) -> None:
    with pytest.raises(ValueError, match="found no channel for reference_step"):
        planted_in_run(turns, "reference_step", 40.0, 1)
    for kind in KINDS:
        if kind != "reference_step":
            assert planted_in_run(turns, kind, 40.0, 1)[1].d_prime > 30.0
