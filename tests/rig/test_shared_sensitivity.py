"""A model with one sensitivity for all channels of a quantity, and what is said when they have their own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from imported_sweeps import made
from imported_worlds import Unit, evidence, rotation

from rig.diagnose.conclusion import OWN_SENSITIVITY, conclude
from rig.fit.evidence import Evidence
from rig.fit.fit import begin, fit, linearised, residual, stepped
from rig.model import Channels
from rig.parts.pose_records import PoseRecords
from rig.parts.poses import Poses
from rig.parts.reading.imported_sweep import sweeps
from rig.parts.sweep import Sweep
from rig.shelf import shelf

SAME = (1.012, 1.012, 1.012)
OWN = (1.012, 0.985, 1.004)
G = 9.80665


def turned(rate: tuple[float, float, float], force: tuple[float, float, float] = SAME) -> Evidence:
    """Turned about a level axis, so that two accelerometers see gravity."""
    return evidence(rotation(Unit(rate_gain=rate, force_gain=force), axis="z", upright=False))


def posed(gains: tuple[float, float, float], seed: int = 1, count: int = 40) -> Poses:
    """A triad at rest in attitudes all over the sphere; gains alone are wrong."""
    random = np.random.default_rng(seed)
    vectors = random.normal(size=(3, count))
    force = G * vectors / np.linalg.norm(vectors, axis=0)
    observed = np.array(gains)[:, None] * force + 1e-3 * random.normal(size=force.shape)
    channels = Channels(
        names=("acc_x", "acc_y", "acc_z"), rates=np.zeros(3, np.bool_), axis=np.arange(3), slot=np.zeros(3, np.intp),
        side=np.full(3, math.nan), sensitivity=np.ones(3), tolerance=np.full(3, 0.1), pole=np.full(3, math.inf),
        unit=("unit",) * 3,
    )  # fmt: skip
    still = np.zeros((3, count))
    return Poses(
        PoseRecords(
            name="r#0", run="r", channels=channels, observed=observed, variance=np.full(force.shape, 1e-6), turn=still,
            u_turn=np.zeros(count), seconds=np.full(count, 2.0), time=np.arange(count, dtype=np.float64) * 5.0,
            held=np.arange(count) % 3 == 2, temperature=np.full(count, 25.0), supply=np.full(count, 5.0), gravity=G,
            u_gravity=1e-5,
        )
    )  # fmt: skip


def seeded(seed: int) -> Poses:
    return posed(SAME, seed)


def sines() -> Sweep:
    """Two accelerometers along the drive at several levels."""
    columns = [
        {"column": "base", "quantity": "unstated", "role": "reference"},
        *({"column": f"board{k}", "quantity": "unstated", "axis": "z"} for k in range(2)),
        {"column": "drive", "quantity": "voltage", "unit": "V", "role": "drive"},
    ]
    foreign = made()
    random = np.random.default_rng(9)
    tables = []
    for table in foreign.tables:
        base = table.of("base")
        boards = [gain * base + 1e-3 * random.normal(size=len(base)) for gain in (1.03, 0.97)]
        values = np.column_stack([table.of("drive"), base, *boards])
        tables.append(replace(table, names=("drive", "base", "board0", "board1"), values=values))
    both = made(columns_=columns).manifest
    return Sweep(sweeps(replace(foreign, manifest=both, tables=tuple(tables)))[0])


def test_a_shared_start_has_one_leader_for_each_quantity() -> None:
    state = turned(SAME).start(shared=True)
    assert state.shared
    assert {name: leader for name, leader in state.leader.items() if name.startswith("gyro")} == dict.fromkeys(
        ("gyro_x", "gyro_y", "gyro_z"), "gyro_x"
    )
    assert set(state.leader.values()) == {"gyro_x", "acc_x"}
    assert not turned(SAME).start().shared


def test_one_gain_is_fitted_and_all_channels_have_it() -> None:
    there = turned(SAME)
    found = there.fitted(shared=True)
    local = found.state.local(there.parts[0], 0)
    rates = there.parts[0].channels.rates
    assert np.ptp(local.sensitivity[rates]) == np.ptp(local.sensitivity[~rates]) == 0.0
    assert local.sensitivity[rates][0] == pytest.approx(1.012, abs=1e-3)
    assert local.sensitivity[~rates][0] == pytest.approx(1.012, abs=1e-3)
    assert found.chi2 / found.count == pytest.approx(1.0, abs=0.15)


def test_sensitivities_of_their_own_take_the_error_away_and_are_named_first() -> None:
    there = turned(SAME, (1.0, 1.01, 0.97))
    shared, own = there.fitted(shared=True), there.fitted()
    assert shared.chi2 / shared.count > 5.0
    assert own.chi2 / own.count == pytest.approx(1.0, abs=0.15)
    said = conclude(there, [], shelf(), shared=True)
    assert said.verdict == "missing"
    assert said.taken[0].effect == OWN_SENSITIVITY
    assert said.error > 2.0 > 1.1 > said.taken[0].error_after
    assert said.taken[0].parameters["sensitivity acc_y"].value == pytest.approx(1.01, abs=2e-3)


def test_equal_sensitivities_need_none_of_their_own() -> None:
    said = conclude(turned(SAME), [], shelf(), shared=True)
    assert said.verdict == "undecided"  # nothing is missing, of a noise that no rest tells
    assert said.taken == ()


def test_rows_that_belong_to_three_channels_share_a_gain() -> None:
    part = posed(SAME)
    found = fit([part], begin([part], [], shared=True))
    assert found.state.gain["acc_x"] == pytest.approx(0.012, abs=2e-4)
    whole = [fit([one], begin([one], [], shared=True)).chi2 / one.counted.sum() for one in map(seeded, range(12))]
    assert np.mean(whole) == pytest.approx(36.0 / 40.0, abs=0.2)  # of 40 poses, less one gain and three zeros
    own = posed(OWN)
    apart = fit([own], begin([own], []))
    bound = fit([own], begin([own], [], shared=True))
    assert bound.chi2 > 100.0 * apart.chi2
    assert [apart.state.gain[n] for n in own.channels.names] == pytest.approx([0.012, -0.015, 0.004], abs=1e-3)


@pytest.mark.parametrize("part", [posed(OWN), sines()], ids=["poses", "sines"])
def test_the_shared_column_is_what_a_small_change_of_the_gain_moves(part: Poses | Sweep) -> None:
    state = begin([part], [], shared=True)
    found = linearised([part], state)
    leader = part.channels.names[0]
    step = np.zeros(found.layout.size)
    step[found.layout.gains[leader]] = 1e-5
    moved = residual([part], stepped(state, found.layout, step)) - found.left
    column = np.zeros(len(found.left))
    for block in found.blocks:
        column[block.rows] += block.matrix @ step[block.columns]
    np.testing.assert_allclose(moved, -column, atol=2e-3 * np.abs(column).max())


def test_accelerometers_on_a_shaker_share_a_gain_until_they_may_have_their_own() -> None:
    part = sines()
    shared, own = (fit([part], begin([part], [], shared=flag)) for flag in (True, False))
    assert shared.state.local(part, 0).sensitivity.tolist() == pytest.approx([1.0, 1.0], abs=0.01)
    assert len(set(shared.state.local(part, 0).sensitivity.tolist())) == 1
    assert own.state.local(part, 0).sensitivity.tolist() == pytest.approx([1.03, 0.97], abs=2e-3)
    assert shared.chi2 > 20.0 * own.chi2
