"""A calibrated unit calibrates others: the truth is inside, whatever the bench's own reference says."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import fast_bench
import numpy as np
import pytest

from rig.calibrate.budget import Budget
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration, Result
from rig.calibrate.qualifying import against, qualified
from rig.errors import BadInput

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 4}
TUMBLE = {"procedure": "tumble", "poses": 24}
TURNS = {"procedure": "turntable", "axis": "yaw", "revolutions": 8}
SEEDS = range(40, 44)


@cache
def run(seed: int, kind: str, again: str = "") -> fast_bench.MemoryRecords:
    document = {"sweep": SWEEP, "tumble": TUMBLE, "turns": TURNS}[kind]
    found = fast_bench.measure(document, fast_bench.world(seed))
    return replace(found, name=f"{found.name}{again}")


@cache
def known(seed: int, *kinds: str) -> Calibration:
    return calibrate([run(seed, kind) for kind in kinds], "known")


def ride(seed: int, kind: str, **standard: Any) -> Calibration:
    """Another run, by a bench whose first standard (the vibrometer) states these of its gain."""
    found = run(seed, kind, "-again")
    first, *others = found.header["standards"]
    values = {**first["values"], "gain": {**first["values"]["gain"], **standard}}
    header = {**found.header, "standards": [{**first, "values": values}, *others]}
    return calibrate([replace(found, header=header)], "ride")


def away(result: Result, seed: int) -> float:
    """From the truth, in standard uncertainties."""
    return (float(result.value or 0.0) - fast_bench.world(seed).truth["sensitivity"][result.channel]) / result.u


def test_a_unit_calibrated_against_gravity_carries_that_through_a_wrong_vibrometer() -> None:
    errors = []
    for seed in SEEDS:
        made = qualified(ride(seed, "sweep", value="1.04"), known(seed, "tumble"), "unit_a")
        for key in ("unit_b_x.sensitivity", "unit_c_x.sensitivity"):
            result = made.result(key)
            assert result.u < 2e-3 * abs(result.value or 0.0)  # the vibrometer alone gives 5e-3, and 4 % off
            assert result.reference == "unit_a_x by calibration known"
            errors.append(away(result, seed))
    assert np.sqrt(np.mean(np.square(errors))) < 1.5
    assert np.abs(errors).max() < 3.5


def test_the_vibrometer_stays_in_the_budget_where_the_reference_unit_owes_it_its_calibration() -> None:
    made = qualified(ride(41, "sweep"), known(41, "sweep"), "unit_a", ["unit_b"])
    result = made.result("unit_b_x.sensitivity")
    gain = next(c for c in result.contributions if c.name == "vibrometer gain")
    assert gain.contribution == pytest.approx(0.005 * abs(result.value or 0.0), rel=1e-3)
    assert [r.key for r in made.results if r.measurand == "sensitivity" and r.determined] == ["unit_b_x.sensitivity"]
    assert abs(away(result, 41)) < 2.5


def test_gyros_carry_their_calibration_with_what_one_sense_hides_of_each() -> None:
    made = qualified(ride(42, "turns"), known(42, "turns"), "gyro")
    result = made.result("backup_yaw.sensitivity")
    assert abs(away(result, 42)) < 2.0
    hidden = [c.name for c in result.contributions if c.name.startswith("asymmetry")]
    assert len(hidden) == 2  # of both gyros; of the reference the same one in both runs, which is one line
    assert made.result("backup_yaw.lag").determined
    assert made.result("backup_yaw.offset").value == ride(42, "turns").result("backup_yaw.offset").value


def test_what_sits_in_another_place_of_the_table_is_counted_for_each() -> None:
    riding = ride(43, "sweep")
    stated = {"laser_spot": {"half_width": "0.3 %", "source": "estimate"}}
    found = run(43, "sweep", "-again")
    header = {**found.header, "bench_file": {**found.header["bench_file"], "influences": stated}}
    wide = calibrate([replace(found, header=header)], "ride")
    plain, more = (
        qualified(one, known(43, "tumble"), "unit_a").result("unit_b_x.sensitivity") for one in (riding, wide)
    )
    spots = [c.contribution for c in more.contributions if c.name.startswith("laser spot")]
    assert len(spots) == 2
    assert more.u**2 - plain.u**2 == pytest.approx(2 * (0.003 / 3**0.5 * abs(more.value or 0.0)) ** 2, rel=0.01)


def test_a_unit_that_has_changed_is_told_from_one_that_has_not() -> None:
    made = qualified(ride(44, "sweep"), known(44, "tumble"), "unit_a")
    last = known(44, "tumble")
    same = {row.key: row for row in against(made, last)}
    assert all(row.agrees and row.source == "calibration known" for row in same.values())
    changed = replace(last, results=tuple(_scaled(r, 1.02) for r in last.results))
    assert not any(row.agrees for row in against(made, changed))
    (sheet,) = {row.source for row in against(made, None)}
    assert sheet == "data sheet"


def test_en_leaves_out_what_both_calibrations_share() -> None:
    made, last = qualified(ride(41, "sweep"), known(41, "sweep"), "unit_a"), known(41, "sweep")
    moved = replace(last, results=tuple(_scaled(r, 1.005, "sensitivity") for r in last.results))
    one, other = (of.result("unit_b_x.sensitivity") for of in (made, moved))
    apart = abs(float(one.value or 0.0) - float(other.value or 0.0))
    assert apart < 0.5 * (one.expanded**2 + other.expanded**2) ** 0.5  # nothing, were the vibrometer's gain not in both
    (row,) = [found for found in against(made, moved) if found.key == "unit_b_x.sensitivity"]
    assert not row.agrees


def _scaled(row: Result, factor: float, measurand: str = "sensitivity_gravity") -> Result:
    if row.measurand != measurand or row.value is None or row.budget is None:
        return row
    lines = tuple(replace(c, sensitivity=c.sensitivity * factor) for c in row.contributions)
    return replace(row, value=row.value * factor, budget=Budget(lines))


def test_what_cannot_be_carried_is_refused_with_what_is_missing() -> None:
    with pytest.raises(BadInput, match="wanted one from other runs"):
        qualified(known(45, "sweep"), known(45, "sweep"), "unit_a")
    with pytest.raises(BadInput, match="found no unit 'unit_z'"):
        qualified(ride(45, "sweep"), known(45, "tumble"), "unit_z")
    for other in ("unit_a", "gyro"):  # itself; an accelerometer tells nothing of a rate
        with pytest.raises(BadInput, match=f"found {other}, wanted other acceleration sensors than unit_a"):
            qualified(ride(45, "sweep"), known(45, "tumble"), "unit_a", [other])
    with pytest.raises(BadInput, match="found no axis along which gyro is calibrated in known"):
        qualified(ride(45, "turns"), known(45, "tumble"), "gyro")
