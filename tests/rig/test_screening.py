"""A channel that shows nothing costs that channel: it is among the results, and why, and all others are as ever."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import fast_bench
import numpy as np
import pytest
from miswired import Wrong, WrongWorld
from scipy.signal import lfilter

from rig.calibrate import accelerometers
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import MISSING, Calibration, text
from rig.calibrate.screening import screened
from rig.cli.calibration import failures, text_of
from rig.errors import BadInput
from rig.sensor import Sensor
from rig.signals.sample_faults import faults

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 2, "static": "3 s", "static_after": "0 s"}
TURNS = {"procedure": "turntable", "revolutions": 2, "rest": "3 s"}
TUMBLE = {"procedure": "tumble", "record": "1 s"}
NOISE = {"procedure": "noise", "length": "5 s"}
RESONANCE = {"name": "resonance", "parameters": {"frequency": 1040.0, "damping": 0.01}}


def noisy(count: int = 4000, seed: int = 1, codes: float = 3.0) -> np.ndarray:
    return np.rint(38000 + codes * np.random.default_rng(seed).standard_normal(count)).astype(np.uint16)


def concluded(procedure: Mapping[str, Any], wrong: Wrong, seed: int = 5) -> Calibration:
    return calibrate([fast_bench.measure(procedure, WrongWorld(seed, wrong))], "screened")


def test_codes_say_what_is_wrong_with_them() -> None:
    good = noisy()
    stuck, held, railed, spike, step, hangs = (good.copy() for _ in range(6))
    stuck[:] = 0x8A3D
    held[500:900] = held[500]
    railed[700:1100] = 0xFFFF
    spike[1234] += 2000
    step[2000:] += 2000
    hangs = noisy(codes=300.0) & ~np.uint16(16)
    assert list(faults(stuck)) == ["stuck at 0x8A3D, 100 % of samples"]
    assert list(faults(held)) == [f"stuck at 0x{held[500]:04X}, 10 % of samples"]
    assert list(faults(railed)) == ["stuck at 0xFFFF, 10 % of samples"]
    assert list(faults(spike)) == ["1 sample stands alone"]
    assert list(faults(hangs)) == ["bit 4 never changes"]
    assert list(faults(np.clip(noisy(codes=60.0), 0, 38030))) == [
        "cut off inside the range, 31 % of samples at an extreme"
    ]
    assert not list(faults(step))
    time = np.arange(3125) / 3125.0
    for seed, codes in enumerate((0.3, 1.0, 3.0, 18.0)):
        for sine in (0.0, 20.0, 498.0):
            moved = noisy(3125, seed, codes) + np.rint(1000.0 * np.sin(2.0 * np.pi * sine * time)).astype(int)
            assert not list(faults(moved.astype(np.uint16)))


def test_a_bit_that_hangs_is_told_where_noise_hardly_goes_beyond_it() -> None:
    """Three codes of noise where bit 3 changes, and twelve behind a slow filter where bit 4 does."""
    fast = noisy(8000, codes=3.0) - np.uint16(38000) + np.uint16(0x9478)
    steps = np.random.default_rng(2).standard_normal(8000)
    slow = np.rint(38000 + 12.0 * lfilter([math.sqrt(1.0 - 0.97**2)], [1.0, -0.97], steps)).astype(np.uint16)
    for clean, bits in ((fast, (3,)), (slow, (4, 5))):
        assert not list(faults(clean))
        for bit in bits:
            for hangs in (clean | np.uint16(1 << bit), clean & ~np.uint16(1 << bit)):
                assert list(faults(hangs)) == [f"bit {bit} never changes"], (bits, bit)


def test_a_sine_of_few_points_has_no_hanging_bit() -> None:
    """Its steps are of few sizes: two to three points a cycle look like jumps by a bit."""
    n, told = np.arange(3125), 0
    for share in (0.45, 0.41, 0.4, 0.36, 1.0 / 3.0, 0.3):
        for size in (40.0, 81.0, 162.0, 300.0, 900.0):
            moved = noisy(3125, 3, 2.0) + np.rint(size * np.sin(2.0 * np.pi * share * n)).astype(int)
            told += faults(moved.astype(np.uint16)).bit >= 0
    assert told == 0


@pytest.mark.parametrize("name", ["gyro_yaw", "gyro_roll", "unit_a_x"])
@pytest.mark.parametrize("bit", [3, 4, 5])
def test_noise_that_a_hanging_bit_makes_wrong_is_flagged(name: str, bit: int) -> None:
    clean, made = concluded(NOISE, Wrong()), concluded(NOISE, Wrong(hanging={name: 1 << bit}))
    moved = []
    for row in (one for one in made.results if one.channel == name and one.value is not None):
        before = clean.result(row.key)
        if before.value is not None and abs(float(row.value or 0.0) - before.value) > 2.0 * before.expanded:
            moved.append(row.key)
            assert row.status == "flagged", row.key
            assert f"bit {bit} never changes" in row.remarks[-1]
    assert bool(moved) == ((name, bit) != ("unit_a_x", 5))  # which is set there anyway


@pytest.mark.parametrize(
    ("procedure", "channel", "measurand"),
    [
        (SWEEP, "unit_a_x", "sensitivity"), (TURNS, "gyro_yaw", "sensitivity"), (NOISE, "unit_c_y", "deviation"),
        (TUMBLE, "unit_b_z", "sensitivity_gravity"),
    ],
)  # fmt: skip
def test_a_stuck_channel_has_its_row_and_its_exit_code_and_takes_no_other_with_it(
    procedure: Mapping[str, Any], channel: str, measurand: str
) -> None:
    clean, made = concluded(procedure, Wrong()), concluded(procedure, Wrong(stuck={channel: 1.65}))
    row = made.result(f"{channel}.{measurand}")
    assert text(row) == "not determined: stuck at 0x951E, 100 % of samples"
    assert row.rejected
    assert any(row.key in line and text(row) in line for line in text_of(made))
    assert any(row.key in failure for failure in failures(made))
    assert not list(failures(clean))
    kept = {r.key: r for r in made.results if r.channel != channel and r.determined}
    for before in (r for r in clean.results if r.determined and r.channel != channel):
        if before.measurand in ("sensitivity", "sensitivity_gravity", "offset", "deviation"):
            assert kept[before.key].value == pytest.approx(before.value, abs=before.expanded)
            assert kept[before.key].status == before.status


def test_what_a_spike_spoils_is_flagged_and_nothing_else() -> None:
    made = concluded(NOISE, Wrong(spikes={"unit_a_x": (1, 5.0)}))
    flagged = {r.channel for r in made.results if r.status == "flagged"}
    assert flagged == {"unit_a_x"}
    assert "1 sample stands alone" in made.result("unit_a_x.deviation").remarks[-1]


def test_noise_in_motion_that_is_none_is_flagged_where_no_look_at_codes_can_tell() -> None:
    """Coarse codes of a few points a cycle, as the oscilloscope's: a sample that stands out hides in the sine."""
    spiked = concluded({**SWEEP, "points": 4}, Wrong(spikes={"unit_a_x": (3, 0.1)})).result(
        "unit_a_x.deviation_in_motion"
    )
    assert spiked.status == "flagged"
    assert any("standard deviations off: no noise" in one for one in spiked.remarks)
    bent = concluded({**SWEEP, "points": 4}, Wrong(hanging={"unit_a_x": 1 << 8}))
    assert bent.result("unit_a_x.sensitivity").status == "flagged"
    assert "the points do not follow a one-pole response" in str(bent.result("unit_a_x.deviation_in_motion").remarks)
    assert all(bent.result(f"unit_{one}_x.deviation_in_motion").status == "determined" for one in "bc")


def test_a_response_that_no_pole_follows_is_lost_or_flagged_and_costs_no_tumble() -> None:
    world = WrongWorld(3, Wrong(), [RESONANCE])
    runs = [fast_bench.measure(one, world) for one in ({**SWEEP, "points": 4}, TUMBLE)]
    made = calibrate(runs, "both")
    for unit in "abc":  # whether the iteration ends depends on the last bit of the processor's arithmetic
        found = made.result(f"unit_{unit}_x.sensitivity")
        assert found.verdict == "inconclusive"
        assert "found no solution" in text(found) if found.rejected else MISSING in found.remarks[0]
    assert len(list(made.of("sensitivity_gravity"))) == 9


def test_a_fit_without_a_solution_costs_its_channel_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted = accelerometers.fit_channel

    def endless(seen: Any, channel: str, *more: Any) -> Any:
        if channel == "unit_a_x":
            raise BadInput("adjust: found no solution in 50 steps, wanted one")
        return fitted(seen, channel, *more)

    monkeypatch.setattr(accelerometers, "fit_channel", endless)
    world = WrongWorld(3, Wrong())
    made = calibrate([fast_bench.measure(one, world) for one in (SWEEP, TUMBLE)], "both")
    assert [r.key for r in made.results if r.rejected] == ["unit_a_x.sensitivity"]
    assert "found no solution" in text(made.result("unit_a_x.sensitivity"))
    assert made.result("unit_b_x.sensitivity").determined
    assert len(list(made.of("sensitivity_gravity"))) == 9


def test_clean_records_have_nothing_wrong() -> None:
    for seed, procedure in enumerate((SWEEP, TURNS, NOISE)):
        run = fast_bench.measure(procedure, WrongWorld(100 + seed, Wrong()))
        looked = screened([run], Sensor.of(run.header))
        assert (looked.rejected, looked.doubted, looked.runs) == ((), (), (run,))
