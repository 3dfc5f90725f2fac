"""Cables, mounts and poses are checked by measurement: what is not as it was said to be gives no number."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import fast_bench
import numpy as np
import pytest
from miswired import Poses, Wrong, WrongWorld, mounted, turned

from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration, text
from rig.certificate.document import document
from rig.signals.gravity_poses import following

TUMBLE = {"procedure": "tumble", "record": "1 s"}
NOISE = {"procedure": "noise", "length": "5 s"}
SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 2, "static": "3 s", "static_after": "0 s"}
TURNS = {"procedure": "turntable", "revolutions": 2, "rest": "3 s"}
MOUNTS: Mapping[str, tuple[Mapping[str, Any], Wrong, tuple[str, ...], str]] = {
    "reversed reference": (
        SWEEP, Wrong(inverted=frozenset({"ldv"})), ("unit_a_x.sensitivity", "unit_c_x.sensitivity"),
        "times as declared",
    ),
    "upside down": (
        TURNS, Wrong(told=mounted(inverted="not")), ("gyro_yaw.sensitivity", "backup_yaw.sensitivity"), "is suspected",
    ),
    "another radius": (
        TURNS, Wrong(told=mounted(radius=0.06)), ("unit_a_z.sensitivity_centripetal",), "radius or angle",
    ),
    "another axis": (
        TURNS, Wrong(told=mounted(axis="pitch")), ("gyro_pitch.cross_coupling_yaw", "gyro_yaw.sensitivity"),
        "another axis",
    ),
}  # fmt: skip
Told = Callable[[int, np.ndarray, np.ndarray], np.ndarray]
POSES: Mapping[str, tuple[Told, str]] = {
    "skipped": (lambda n, up, last: last if n == 2 else up, "pose 2 (-1.00x): found gravity along +0.99x"),
    "negated": (lambda n, up, last: -up if n == 3 else up, "pose 3 (+1.00y): found gravity along -0.00x -0.98y"),
    "tilted": (lambda n, up, last: turned(up, 20.0) if n == 5 else turned(up, 20.0) if n == 1 else up, "pose 1"),
    "rotated": (lambda n, up, last: turned(up, 90.0), "pose 1 (+1.00x) (and 3 poses more)"),
    "exchanged": (lambda n, up, last: -up if n < 3 else up, "all 3 units have the other sign along x"),
}


def concluded(procedure: Mapping[str, Any], wrong: Wrong, seed: int = 3) -> Calibration:
    return calibrate([fast_bench.measure(procedure, WrongWorld(seed, wrong))], "wired")


@pytest.mark.parametrize("case", POSES)
def test_a_pose_that_was_another_gives_no_sensitivity_and_says_which_it_was(case: str) -> None:
    told, why = POSES[case]
    made = concluded(TUMBLE, Wrong(told=Poses(told)))
    along = "x" if case == "exchanged" else "xyz"
    for name in (f"unit_{unit}_{axis}" for unit in "abc" for axis in along):
        row = made.result(f"{name}.sensitivity_gravity")
        assert row.rejected
        assert why in text(row)
    assert len(list(made.of("sensitivity_gravity"))) == 9 - 3 * len(along)


def test_channels_that_are_swapped_have_no_sensitivity_and_all_others_have() -> None:
    made = concluded(TUMBLE, Wrong(swapped=("unit_a_x", "unit_a_y")))
    lost = {r.channel for r in made.results if r.rejected}
    assert lost == {"unit_a_x", "unit_a_y"}
    assert len(list(made.of("sensitivity_gravity"))) == 7


def test_a_pose_that_is_askew_by_less_flags_what_stands_on_it() -> None:
    told = Poses(lambda n, up, last: turned(up, 5.0) if n == 1 else up)
    made = concluded(TUMBLE, Wrong(told=told))
    flagged = {r.channel for r in made.of("sensitivity_gravity") if r.status == "flagged"}
    assert {"unit_a_y", "unit_b_y"} <= flagged
    clean = concluded(TUMBLE, Wrong())
    assert {r.status for r in clean.of("sensitivity_gravity")} == {"determined"}


def test_any_gain_follows_and_a_wire_without_gravity_does_not() -> None:
    expected = np.column_stack([[1.0, -1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0, 0.0, 0.0]])
    gains, off = following(expected * [0.5, -1.02] + [3.0, -2.0], expected)
    assert gains == pytest.approx([0.5, -1.02])
    assert not off.any()
    _, off = following(np.column_stack([expected[:, 1], np.full(6, 2.0)]), expected)
    assert off[:, 0].tolist() == [True] * 4 + [False] * 2
    assert off[:, 1].tolist() == [False, False, True, True, False, False]


@pytest.mark.parametrize(
    ("procedure", "swapped", "why"),
    [
        (TUMBLE, ("unit_b_y", "unit_c_y"), "sensitivity_gravity "),
        (NOISE, ("unit_c_x", "gyro_pitch"), "times that of its data sheet"),
    ],
)
def test_all_that_is_said_of_a_channel_that_may_be_another_is_flagged(
    procedure: Mapping[str, Any], swapped: tuple[str, str], why: str
) -> None:
    made = concluded(procedure, Wrong(swapped=swapped))
    theirs = [row for row in made.results if row.channel in swapped and row.determined]
    assert {row.channel for row in theirs} == set(swapped)
    assert all(row.status == "flagged" and why in row.remarks[-1] for row in theirs)
    others = [row for row in made.results if row.channel not in swapped]
    assert not any("may be another" in remark for row in others for remark in row.remarks)


def test_a_sensitivity_that_cannot_be_told_from_none_flags_its_channel() -> None:
    made = concluded(SWEEP, Wrong(swapped=("unit_c_x", "gyro_pitch")))
    found = made.result("unit_c_x.sensitivity")
    assert found.value is None or abs(found.value) <= found.expanded
    assert made.result("unit_c_x.noise_bandwidth").status == "flagged"
    assert made.result("unit_b_x.noise_bandwidth").status == "determined"


def test_a_certificate_says_which_wires_no_measurement_tells_apart() -> None:
    """Swapped, both are silently wrong by what the two differ: the cable table alone knows."""
    said, *_ = document(concluded(SWEEP, Wrong())).remarks
    assert said.startswith("Taken from the cable table")
    assert said.endswith(": unit_a_x and unit_b_x")
    assert not any("cable table" in one for one in document(concluded(TURNS, Wrong())).remarks)


def test_channels_on_one_wire_are_told_by_their_noise() -> None:
    made = concluded(TUMBLE, Wrong(copied={"unit_b_x": "unit_a_x"}))
    for name, other in (("unit_a_x", "unit_b_x"), ("unit_b_x", "unit_a_x")):
        row = made.result(f"{name}.sensitivity_gravity")
        assert row.status == "flagged"
        assert f"the same noise as {other}" in text(row) + row.remarks[-1]
    assert made.result("unit_c_x.sensitivity_gravity").status == "determined"


def test_units_within_their_tolerance_are_doubted_where_one_fails_by_the_factor_of_all() -> None:
    """Of three units one fails where the vibrometer tells 5 % more: the widest tolerance takes it in."""
    made = concluded({**SWEEP, "points": 4}, Wrong(gain={"ldv": 1.05}))
    rows = {row.channel: row for row in made.of("sensitivity")}
    assert rows["unit_b_x"].verdict == "fail"
    for name in ("unit_a_x", "unit_c_x"):
        assert rows[name].status == "flagged"
        assert "the reference may be off" in rows[name].remarks[-1]
    clean = concluded({**SWEEP, "points": 4}, Wrong())
    assert all(row.status == "determined" for row in clean.of("sensitivity"))


def test_one_hum_on_all_wires_is_not_one_wire() -> None:
    run = fast_bench.measure(NOISE, WrongWorld(3, Wrong()))
    (name,) = run.arrays
    codes = run.block(name)
    wave = np.sin(2.0 * np.pi * 50.0 * np.arange(len(codes)) * 320e-6)
    run.arrays[name] = [(codes + np.rint(330.0 * wave)[:, None]).astype(np.uint16)]  # 0.1 V
    made = calibrate([run], "hummed")
    assert not any("the same noise" in remark for row in made.results for remark in row.remarks)
    assert any(flag.startswith("steady lines are not counted as noise: 50 Hz (") for flag in made.flags)


@pytest.mark.parametrize("case", MOUNTS)
def test_a_mounting_or_a_reference_that_is_another_gives_no_number(case: str) -> None:
    procedure, wrong, keys, why = MOUNTS[case]
    made = concluded(procedure, wrong)
    for key in keys:
        assert made.result(key).rejected
        assert why in text(made.result(key))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (Wrong(stuck={"supply": 5.0}), "supply stuck at 0xBFFF, 100 % of samples"),
        (Wrong(stuck={"temperature": 0.25}), "temperature stuck at 0x8333, 100 % of samples"),
        (Wrong(swapped=("supply", "temperature")), "found a temperature of 500 °C, wanted -40 to 85 °C"),
        (Wrong(), ""),
    ],
)
def test_a_supply_or_thermometer_that_cannot_be_believed_is_said(wrong: Wrong, said: str) -> None:
    flags = concluded(NOISE, wrong).flags
    assert any(said in flag for flag in flags) if said else not flags
