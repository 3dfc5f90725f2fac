"""What steps, creeps or strays in the course of an imported record is no physical effect, and no model is adequate."""

from __future__ import annotations

import math
from dataclasses import replace

import blind_imports
import blind_worlds
import imported_sweeps
import numpy as np
import pytest
from imported_runs import posed
from imported_worlds import Sensor, Unit, clean, evidence, motion, response, response_table, rotation
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.diagnose.conclusion import Conclusion, conclude
from rig.fit.adequacy import changes, unsteady
from rig.foreign.faults import left_out
from rig.foreign.repeats import contradicted
from rig.foreign.straying import findings as straying
from rig.foreign.tables import Foreign
from rig.parts.track import TrackedMotion
from rig.shelf import shelf

Array = NDArray[np.float64]
SIZE, PHASE = 2, 4  # columns of a table of responses


def said(foreign: Foreign) -> Conclusion:
    return conclude(evidence(foreign), [], shelf())


def with_values(foreign: Foreign, number: int, **columns: Array) -> Foreign:
    """The same with columns of one of its files in the place of theirs."""
    tables, table = list(foreign.tables), foreign.tables[number]
    values = table.values.copy()
    for name, column in columns.items():
        values[:, table.names.index(name)] = column
    tables[number] = replace(table, values=values)
    return replace(foreign, tables=tuple(tables))


def nothing_is_named(found: Conclusion) -> bool:
    return found.verdict in ("unlisted", "undecided") and all(one.probability < 0.9 for one in found.taken)


# tables of responses


@pytest.mark.parametrize("column", [SIZE, PHASE])
def test_a_repeat_that_contradicts_the_others_is_left_out_and_said(column: int) -> None:
    table = response_table(Sensor(gain=1.01).phasor, 3)
    table[27, column] += 0.03
    bad = response([table])
    (finding,) = left_out(bad)
    assert finding.rows.tolist() == [27]
    found, clean_one = said(bad), said(response([response_table(Sensor(gain=1.01).phasor, 3)]))
    assert (found.verdict, clean_one.verdict) == ("undecided", "adequate")
    assert found.error == pytest.approx(clean_one.error, rel=0.05)


def test_two_that_contradict_each_other_are_both_left_out_and_scatter_is_not() -> None:
    random = np.random.default_rng(5)
    frequency = np.tile(np.geomspace(10.0, 200.0, 20), 2)
    for _ in range(200):
        assert not len(contradicted(random.normal(size=40), frequency))
    values = random.normal(size=40)
    values[7] += 40.0
    assert contradicted(values, frequency).tolist() == [7, 27]


@pytest.mark.parametrize("column", [SIZE, PHASE])
def test_a_gain_or_a_phase_that_steps_between_repeats_is_no_scatter(column: int) -> None:
    table = response_table(Sensor().phasor, 4)
    table[30:, column] += 0.008
    found = said(response([table]))
    assert nothing_is_named(found)
    assert found.verdict == "unlisted"
    assert "in the course of the table" in found.description


# poses


@pytest.mark.parametrize("law", ["a zero that drifts", "a sensitivity that steps"])
def test_poses_that_change_in_their_course_show_no_angle_between_axes(law: str) -> None:
    made = posed(9, gain=np.ones(3), zero=np.zeros(3))
    values = made.tables[0].of("acc_y")
    course = np.linspace(0.0, 1.0, len(values))
    drifted = values + 1.2 * course if law == "a zero that drifts" else values * np.where(course > 0.45, 1.001, 1.0)
    found = said(with_values(made, 0, acc_y=drifted))
    assert nothing_is_named(found)
    assert found.verdict == "unlisted"
    assert not unsteady(evidence(made).fitted())


def test_a_pose_beyond_the_range_is_left_out_whole_and_the_others_give_the_sensitivity() -> None:
    made = posed(3, gain=np.full(3, 1.004), zero=np.zeros(3))
    values = made.tables[0].of("acc_z")
    means = values.reshape(-1, 200).mean(axis=1)
    level = float(np.sort(means)[-2]) + 1.0  # a noise of one: the outermost pose all, the next partly
    cut = with_values(made, 0, acc_z=np.minimum(values, level))
    assert left_out(cut)
    fit = evidence(cut).fitted()
    z = fit.layout.gains["acc_z"]
    assert fit.state.gain["acc_z"] == pytest.approx(0.004, abs=3.0 * math.sqrt(fit.covariance[z, z]))
    assert said(cut).verdict == "undecided"


# references


def test_a_marker_that_slips_while_a_body_is_thrown_about_is_no_tilt_of_the_reference() -> None:
    made = motion(clean(11), 11, rows=100.0, channels="r")
    attitude = np.stack([made.tables[0].of(name) for name in ("qx", "qy", "qz", "qw")], axis=1)
    there = np.flatnonzero(np.isfinite(attitude).all(axis=1))
    late = there[there > 2200]
    attitude[late] = (Rotation.from_quat(attitude[late]) * Rotation.from_rotvec([0.0, 0.0, 0.006])).as_quat()
    slipped = dict(zip(("qx", "qy", "qz", "qw"), attitude.T, strict=True))
    found = said(with_values(made, 0, **slipped))
    assert found.verdict == "unlisted"
    assert nothing_is_named(found)
    always = said(motion(replace(clean(11), tilt=(0.0, 0.0, 0.006)), 11, rows=100.0, channels="r"))
    assert [one.effect for one in always.taken] == ["reference_tilt"]
    assert always.verdict == "missing"


@pytest.mark.parametrize("name", ["base", "board"])
def test_a_zero_that_strays_in_a_sweep_is_said_and_left_to_look_at(name: str) -> None:
    made = imported_sweeps.made(levels=(0.3, 0.6, 1.0))
    assert not list(straying(made))
    values = made.tables[2].of(name)
    course = np.linspace(0.0, 1.0, len(values))
    drift = 1.5e-4 * (course if name == "board" else (course > 0.6))
    bad = with_values(made, 2, **{name: values + drift})
    (finding,) = straying(bad)
    assert (finding.kind, finding.channel, finding.where) == ("strays", "board", "file 2")
    assert said(bad).verdict == "undecided"


# samples


@pytest.mark.parametrize("rows", [(2266, 2268), (2265, 2268)])
def test_two_or_three_rows_held_amid_motion_are_found(rows: tuple[int, int]) -> None:
    made = rotation(Unit(), 2, rest=10.0, channels="r", jitter=1e-4, doubled=0.0)
    values = made.tables[0].of("gyro_z").copy()
    first = 1500 + int(np.argmax(np.abs(np.gradient(np.convolve(values, np.ones(9) / 9.0, "same")))[1500:5000]))
    values[first + 1 : first + rows[1] - rows[0]] = values[first]
    found = left_out(with_values(made, 0, gyro_z=values))
    assert found
    assert {row for one in found for row in one.rows.tolist()} <= set(range(first, first + 4))


def test_a_sensor_stuck_at_the_turn_of_a_sine_is_found_though_little_moves_beside() -> None:
    made = imported_sweeps.made(levels=(0.3, 0.6, 1.0))
    values = made.tables[3].of("board").copy()
    top = 4000 + int(np.argmax(values[4000:4400]))
    values[top - 13 : top + 13] = values[top - 13]
    (finding,) = left_out(with_values(made, 3, board=values))
    assert (finding.kind, len(finding.rows)) == ("frozen", 26)


@pytest.mark.parametrize("gap", [False, True])
def test_what_a_step_and_a_trend_do_is_as_the_rows_of_outputs_that_do_so_are(gap: bool) -> None:
    made = rotation(clean(2), seconds=30.0)
    if gap:
        column = made.tables[0].values[:, made.tables[0].names.index("gyro_z")].copy()
        column[700:760] = math.nan
        made = with_values(made, 0, gyro_z=column)
    (part,) = evidence(made).parts
    assert isinstance(part, TrackedMotion)
    row = list(part.channels.names).index("gyro_z")
    answer = part.reference.rate[2] * part.channels.sensitivity[row]
    there = {words: columns for name, words, columns in part.changes() if name == "gyro_z"}
    trend = np.linspace(0.0, 1.0, len(answer))
    moving = np.any(there["its gain in the course of time"], axis=1)
    assert moving.sum() > 50
    for words, law in (
        ("a trend", trend),
        ("its gain in the course of time", (np.arange(len(answer)) >= part._steps[5]).astype(float)),
    ):
        always, changed = (np.zeros((len(part.channels.names), len(answer))) for _ in range(2))
        always[row], changed[row] = answer, answer * law
        whole, expected = (part.whitened(one) * moving for one in (always, changed))
        expected -= whole * (whole @ expected) / (whole @ whole)
        found = there[words][:, 5 if "course" in words else 0]
        assert found == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("number", [121, 141, 186, 204])
def test_what_changes_by_rounding_alone_is_no_direction(number: int) -> None:
    """A gain that steps while the case rests is the very gain that it has: of the step nothing but rounding is left."""
    answer = blind_worlds.drawn(blind_worlds.Case("imported_clean", "rotation", (), number, "cl"))
    fit = blind_imports.evidence(blind_worlds.imported(answer)).fitted()
    found = changes(fit)
    assert len(found) > 5
    assert max(one.chi2 for one in found) < 20.0
