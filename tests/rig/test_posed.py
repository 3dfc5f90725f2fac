"""Poses against gravity: what a magnitude tells of a triad, how surely, and what two published records show."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rig.effects.non_orthogonality import NonOrthogonality
from rig.errors import BadInput
from rig.fit.fit import Fit, begin, fit, linearised, residual, stepped
from rig.foreign.manifest import Manifest
from rig.foreign.tables import Foreign, Table
from rig.model import Channels, Local, Term
from rig.parts.pose_records import PoseRecords
from rig.parts.poses import GRAVITY, Poses
from rig.parts.reading.poses import posed
from rig.signals.noise_at_rest import noises_at_rest

Array = NDArray[np.float64]
DATA = Path(os.environ.get("RIG_REAL_DATA", Path(__file__).parents[3] / "shared" / "data"))
G = 9.81
NAMES = ("acc_x", "acc_y", "acc_z", "gyro_x", "gyro_y", "gyro_z")
GAINS = np.array([0.02, -0.01, 0.005, 0.03, -0.02, 0.01])
ZEROS = np.array([3.0, -2.0, 1.0, 4.0, -5.0, 6.0])
ANGLES = {"yz": 0.004, "zy": -0.008, "zx": 0.012}
NOMINAL = np.array([100.0] * 3 + [1000.0] * 3)


def square(count: int = 3, angles: dict[str, float] | None = None) -> Term:
    """The angles between the axes of the accelerometers."""
    return Term(NonOrthogonality(), "acceleration", angles or dict.fromkeys(("yz", "zy", "zx"), 0.0))


def directions(count: int, draw: np.random.Generator) -> Array:
    """Unit vectors all over the sphere, (3, n)."""
    vectors = draw.normal(size=(3, count))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=0))


def felt(force: Array) -> Array:
    """What axes feel that are not square, by the inverse of the published matrix, (3, n)."""
    a = ANGLES
    shown = np.array([[1.0, -a["yz"], a["zy"]], [0.0, 1.0, -a["zx"]], [0.0, 0.0, 1.0]])
    return np.asarray(np.linalg.solve(shown, force))


def channels() -> Channels:
    return Channels(
        names=NAMES, rates=np.repeat([False, True], 3), axis=np.tile(np.arange(3), 2), slot=np.arange(6),
        side=np.full(6, math.nan), sensitivity=NOMINAL, tolerance=np.full(6, 0.2), pole=np.full(6, math.inf),
        unit=("u",) * 6,
    )  # fmt: skip


def records(seed: int, poses: int = 30, u_gravity: float = 1e-6) -> PoseRecords:
    """Random attitudes, then one turn of 360° about each axis; noise of 0.1 count."""
    draw = np.random.default_rng(seed)
    n = poses + 3
    turn = np.zeros((3, n))
    turn[:, poses:] = 2.0 * math.pi * np.eye(3)
    seconds = np.full(n, 4.0)
    gravity = G + u_gravity * draw.normal()
    u_turn = np.where(turn.any(axis=0), 0.002, 0.0)
    true = turn * (1.0 + np.where(turn.any(axis=0), u_turn * draw.normal(size=n) / (2.0 * math.pi), 0.0))
    whole = np.concatenate([felt(gravity * directions(n, draw)), true / seconds])
    clean = (NOMINAL * (1.0 + GAINS))[:, None] * whole + ZEROS[:, None]
    return PoseRecords(
        name="r#0", run="r", channels=channels(), observed=clean + 0.1 * draw.normal(size=clean.shape),
        variance=np.full(clean.shape, 0.01), turn=turn, u_turn=u_turn, seconds=seconds,
        time=np.linspace(0.0, 5.0 * n, n),
        held=np.arange(n) >= 20, temperature=np.full(n, 25.0), supply=np.full(n, 5.0), gravity=G, u_gravity=u_gravity,
    )  # fmt: skip


def fitted(part: Poses, *terms: Term, shared: bool = False) -> Fit:
    return fit([part], begin([part], list(terms), shared=shared))


def errors(found: Fit) -> dict[str, float]:
    """Every parameter's error in its own standard uncertainties."""
    u = np.sqrt(np.diag(found.covariance))
    order = found.layout
    off = {f"gain {n}": (found.state.gain[n] - GAINS[k]) / u[order.gains[n]] for k, n in enumerate(NAMES)}
    off |= {f"zero {n}": (found.state.zero[0][k] - ZEROS[k]) / u[order.zeros[0] + k] for k, n in enumerate(NAMES)}
    at, us = found.state.terms[0].at, found.u(0)
    return off | {n: (at[n] - ANGLES[n]) / us[n] for n in ANGLES}


def test_known_scales_zeros_and_angles_come_back_within_their_uncertainties() -> None:
    found = fitted(Poses(records(1)), square())
    assert {name: one for name, one in errors(found).items() if abs(one) > 3.5} == {}
    assert found.u(0)["zx"] < 5e-4


def test_error_over_stated_uncertainty_is_near_one_over_seeds() -> None:
    whole = [errors(fitted(Poses(records(seed, u_gravity=0.02)), square())) for seed in range(40)]
    for name in whole[0]:
        rms = math.sqrt(float(np.mean([one[name] ** 2 for one in whole])))
        assert rms < 1.4, name
        assert rms > 0.65 or name.startswith("gain gyro"), name  # those carry the tilt of the axis, which is not drawn


def test_squares_of_what_is_left_are_as_many_as_the_poses_less_the_parameters() -> None:
    left = []
    for seed in range(20):
        part = Poses(records(seed))
        left.append(fitted(part, square()).left[: part.width])
    assert np.mean([float(one @ one) for one in left]) == pytest.approx(30 - 9, rel=0.2)


def test_few_parts_tell_noise_without_bias() -> None:
    draw = np.random.default_rng(9)
    for parts in (1, 2, 3, 6, 7):
        found = [noises_at_rest([[draw.normal(size=40) for _ in range(parts)]], 10.0)[0].density(0.2)
                 for _ in range(400)]  # fmt: skip
        assert np.mean(found) == pytest.approx(0.2, rel=0.3), parts  # some see flicker that is not there


def wandering(seed: int) -> PoseRecords:
    """The same poses with noise that is mostly one slow wander."""
    data, draw = records(seed), np.random.default_rng(1000 + seed)
    seconds = data.time - data.time[0]
    one = 0.5 * np.exp(-np.abs(seconds[:, None] - seconds) / 100.0) + 0.01 * np.eye(data.observed.shape[1])
    slow = np.linalg.cholesky(one) @ draw.normal(size=(len(one), len(data.observed)))
    covariance = np.repeat(one[None], len(data.observed), axis=0)
    noise = draw.normal(size=data.observed.shape)
    return replace(data, observed=data.observed + slow.T, covariance=covariance + 0.01 * np.eye(len(one)),
                   variance=np.full(noise.shape, 0.52))  # fmt: skip


def test_means_that_wander_together_are_not_taken_for_independent_ones() -> None:
    found = [fitted(Poses(wandering(seed)), square()) for seed in range(30)]
    whole = [errors(one) for one in found]
    for name in (one for one in whole[0] if "gyro" not in one):
        assert 0.65 < math.sqrt(float(np.mean([one[name] ** 2 for one in whole]))) < 1.4, name
    left = np.array([one.left[:33] for one in found])
    assert np.mean(np.sum(left**2, axis=1)) == pytest.approx(30 - 9, rel=0.15)
    apart = fitted(Poses(replace(wandering(0), covariance=None)), square())
    row = found[0].layout.gains["acc_x"]
    assert found[0].covariance[row, row] < 0.5 * apart.covariance[row, row]


def test_what_is_fitted_is_not_told_by_what_is_held_out() -> None:
    data = wandering(0)
    part, changed = Poses(data), Poses(replace(data, observed=data.observed + np.where(data.held, 7.0, 0.0)))
    fitted_rows = ~part.held_out
    np.testing.assert_array_equal(part.target[fitted_rows], changed.target[fitted_rows])
    assert np.abs((part.target - changed.target)[part.held_out & part.counted]).max() > 1.0


def test_rows_and_the_residual_that_they_stand_for_are_told_from_each_other() -> None:
    part = Poses(wandering(0))
    table = np.where(part.counted, np.random.default_rng(3).normal(size=part.rows), 0.0).reshape(4, -1)
    np.testing.assert_allclose(part.residual(part.whitened(table)), table, atol=1e-9)
    apart = float(part.data.time[7] - part.data.time[0])
    both = np.array([part.residual(np.eye(part.rows)[k]).reshape(-1) for k in range(part.rows)])
    assert (both.T @ both)[33, 40] == pytest.approx(0.5 * math.exp(-apart / 100.0), rel=1e-6)  # gyro_x, in units²


def oracle(data: PoseRecords, sigma: Array) -> Array:
    """Three gains, three zeros, three angles and every direction by an independent least squares."""
    count = int(np.count_nonzero(~data.turn.any(axis=0)))
    y = data.observed[:3, :count]

    def left(x: Array) -> Array:
        gains, zeros, angles = x[:3], x[3:6], x[6:9]
        lift, round_ = x[9:].reshape(2, count)
        d = np.stack([np.cos(lift) * np.cos(round_), np.cos(lift) * np.sin(round_), np.sin(lift)])
        shown = np.array([[1.0, -angles[0], angles[1]], [0.0, 1.0, -angles[2]], [0.0, 0.0, 1.0]])
        made = NOMINAL[:3, None] * (1.0 + gains[:, None]) * np.linalg.solve(shown, G * d) + zeros[:, None]
        return np.concatenate([((y - made) / sigma[:, None]).reshape(-1), gains / 0.2])

    d = y / np.linalg.norm(y, axis=0)
    start = np.concatenate([np.zeros(9), np.arcsin(d[2]), np.arctan2(d[1], d[0])])
    found = least_squares(left, start, xtol=1e-14, ftol=1e-14, gtol=1e-14, x_scale="jac")
    return np.append(found.x[:9], 2.0 * found.cost)


@pytest.mark.parametrize("sigma", [(0.1, 0.1, 0.1), (0.1, 0.3, 0.15)])
def test_parameters_and_chi_squared_agree_with_a_fit_of_all_directions(sigma: tuple[float, ...]) -> None:
    data = replace(records(3), u_gravity=1e-9)
    data.variance[:3] = np.array(sigma)[:, None] ** 2
    part = Poses(data)
    found, truth = fitted(part, square()), oracle(data, np.array(sigma))
    x = [*(found.state.gain[n] for n in NAMES[:3]), *found.state.zero[0][:3], *found.state.terms[0].at.values()]
    u = np.sqrt(np.diag(found.covariance))
    typical = float(u[found.layout.gains["acc_x"]])
    np.testing.assert_allclose(x[:3], truth[:3], atol=0.05 * typical)
    np.testing.assert_allclose(x[3:6], truth[3:6], atol=0.05 * float(u[found.layout.zeros[0]]))
    np.testing.assert_allclose(x[6:], truth[6:9], atol=0.05 * found.u(0)["yz"])
    rows = found.left[: part.width]
    prior = sum((found.state.gain[n] / 0.2) ** 2 for n in NAMES[:3])
    assert float(rows @ rows) + prior == pytest.approx(truth[9], rel=0.03)


def test_columns_are_the_derivatives_of_the_rows() -> None:
    part = Poses(records(4))
    state = begin([part], [square(angles=ANGLES)])
    found = linearised([part], state)
    whole = np.zeros((part.rows, found.layout.size))
    for block in found.blocks:
        whole[np.ix_(block.rows, block.columns)] = block.matrix
    for k in range(found.layout.size):
        size = 1e-3 if found.layout.zeros[0] <= k < found.layout.zeros[0] + 6 else 1e-6
        step = np.zeros(found.layout.size)
        step[k] = size
        up, down = (residual([part], stepped(state, found.layout, sign * step)) for sign in (1.0, -1.0))
        scale = float(np.abs(whole[:, k]).max()) or 1.0
        np.testing.assert_allclose(whole[:, k], (down - up) / (2.0 * size), atol=5e-3 * scale)


def test_a_magnitude_counts_in_poses_and_gyros_count_in_turns_too() -> None:
    part = Poses(records(5))
    counted = part.counted.reshape(4, -1)
    assert part.row_names == (GRAVITY, "gyro_x", "gyro_y", "gyro_z")
    assert counted.sum(axis=1).tolist() == [30, 33, 33, 33]
    assert part.domains()["turns"].tolist() == [False] * 30 + [True] * 3
    assert np.isfinite(part.noise()).all()


def test_a_pose_without_an_observation_is_left_out() -> None:
    data = records(5)
    data.observed[1, 7] = math.nan
    part = Poses(data)
    found = fitted(part, square())
    assert not part.counted[7]
    assert found.left[7] == 0.0
    assert np.isfinite(found.left).all()


def test_rows_are_metres_per_second_squared_above_gravity_once_the_noise_is_taken_off() -> None:
    data = records(6)
    part = Poses(data)
    local = Local(NOMINAL, channels().pole, np.zeros(6))
    left = part.target - part.whitened(part.raw(local, []))
    size = np.linalg.norm(data.observed[:3] / NOMINAL[:3, None], axis=0) - G
    found = (left.reshape(4, -1) * np.sqrt(part.noise()))[0, :30]
    np.testing.assert_allclose(found, G * np.log1p(size[:30] / G), rtol=1e-6)
    np.testing.assert_allclose(found, size[:30], atol=0.01)


def test_turns_are_told_as_the_angles_that_they_integrate_to() -> None:
    part = Poses(records(7))
    start = begin([part], [])
    zeros = Local(NOMINAL, channels().pole, ZEROS)
    said = part.remarks(part.target - part.whitened(part.raw(zeros, [])), zeros, [])
    shown = float(said[1].split("to ")[1].split("°")[0])
    assert said[1].startswith("x turn: integrates to ")
    assert "(reference 360° ± 0.11°)" in said[1]
    assert shown == pytest.approx(360.0 * 1.03, abs=0.5)
    found = fit([part], start)
    after = part.remarks(found.left, found.state.local(part, 0), found.state.terms)
    assert float(after[1].split("to ")[1].split("°")[0]) == pytest.approx(360.0, abs=0.02)


def test_a_turn_is_known_as_well_as_its_angle_and_its_axis() -> None:
    data = records(7)
    part = Poses(replace(data, u_turn=10.0 * data.u_turn))
    sigma = np.sqrt(part.noise())[1:, 30]  # of a turn about x in 4 s, rad/s
    tilt = math.radians(2.0)
    own = math.hypot(0.02, 0.5 * tilt**2 * 2.0 * math.pi) / 4.0
    assert sigma == pytest.approx([own, *[tilt * 2.0 * math.pi / 4.0] * 2], rel=1e-3)


def test_one_accelerometer_short_of_a_triad_is_refused() -> None:
    data = records(8)
    short = replace(
        data, channels=data.channels.only(np.arange(1, 6)), observed=data.observed[1:], variance=data.variance[1:]
    )
    with pytest.raises(BadInput, match="found accelerometers along y, z, wanted one along each of x, y and z"):
        Poses(short)


def test_gyros_alone_need_no_accelerometer() -> None:
    data = records(9)
    part = Poses(
        replace(
            data, channels=data.channels.only(np.arange(3, 6)), observed=data.observed[3:], variance=data.variance[3:]
        )
    )
    found = fitted(part)
    assert part.row_names == NAMES[3:]
    assert [found.state.gain[n] for n in NAMES[3:]] == pytest.approx(GAINS[3:], abs=0.003)


def test_few_attitudes_and_missing_turns_are_said_to_be_blind() -> None:
    said = " ".join(Poses(records(9, poses=6)).blind)
    assert "6 attitudes are fewer than the 9 parameters" in said
    assert "the whole triad is turned in its case" in said
    data = records(9)
    data.turn[:, -1] = 0.0
    assert any("no turn by a known angle about z" in one for one in Poses(data).blind)


def test_the_noise_of_a_mean_is_that_of_its_flicker_not_of_its_samples() -> None:
    draw = np.random.default_rng(2)
    count, rate = 512, 100.0
    f = np.fft.rfftfreq(64 * count, 1.0 / rate)
    shape = np.sqrt(rate / 2.0 * (1e-4 + np.divide(1e-2, f, out=np.zeros_like(f), where=f > 0.0)))
    values = np.fft.irfft(np.fft.rfft(draw.normal(size=64 * count)) * shape)
    parts = list(values.reshape(64, count))
    model = noises_at_rest([parts], rate)[0]
    begin_ = np.arange(64) * count / rate
    covariance = model.covariance(begin_, begin_ + count / rate)
    centred = np.eye(64) - 1.0 / 64
    predicted = math.sqrt(float(np.mean(np.diag(centred @ covariance @ centred))))
    assert predicted == pytest.approx(float(np.std([part.mean() for part in parts])), rel=0.35)
    assert predicted > 3.0 * float(np.std(values)) / math.sqrt(count)


# from a file


def foreign(text: dict[str, object], values: Array) -> Foreign:
    """A run of kind "poses" from an array with columns ax ay az gx gy gz."""
    base: dict[str, object] = {
        "format": 1, "kind": "poses", "unit": {"serial": "u"}, "provenance": {"source": "s", "licence": "l"},
        "files": [{"path": "a.csv"}], "time": {"rate": "100 Hz"},
    }  # fmt: skip
    names = ("ax", "ay", "az", "gx", "gy", "gz")
    table = Table("", names, values, {}, False)
    return Foreign("r", Manifest.model_validate({**base, **text}, strict=False), (table,), ())


def columns(
    per: tuple[str, str], zero: float = 0.0, unit: tuple[str, str] = ("m/s²", "rad/s")
) -> list[dict[str, object]]:
    made: list[dict[str, object]] = []
    for k, (quantity, letter) in enumerate((("acceleration", "a"), ("rate", "g"))):
        for axis in "xyz":
            one: dict[str, object] = {
                "column": f"{letter}{axis}", "name": f"{'acc' if k == 0 else 'gyro'}_{axis}", "quantity": quantity,
                "axis": axis, "unit": unit[k], "tolerance": "20 %",
            }  # fmt: skip
            made.append({**one, "sensitivity": per[k], "zero": zero, "unit": "counts"} if per[k] else one)
    return made


def recorded(poses: int, seed: int = 0, turn: float = 1.0) -> tuple[Array, list[dict[str, object]]]:
    """Counts of poses of 300 samples, and one turn about z of one second, with segments of both."""
    draw = np.random.default_rng(seed)
    still = np.repeat(G * directions(poses, draw), 300, axis=1)
    flat = np.repeat(G * np.eye(3)[:, 2:], 100, axis=1)
    rate = np.concatenate(
        [np.zeros((3, 300 * poses)), np.repeat(turn * np.eye(3)[:, 2:] * 2 * math.pi, 100, axis=1)], 1
    )
    whole = np.concatenate([np.concatenate([still, flat], axis=1), rate])
    counts = (NOMINAL * (1 + GAINS))[:, None] * whole + 1000.0 + ZEROS[:, None]
    counts = np.round(counts + 2.0 * draw.normal(size=counts.shape))
    segments: list[dict[str, object]] = [{"first": 300 * k, "last": 300 * (k + 1)} for k in range(poses)]
    turned = {"first": 300 * poses, "last": 300 * poses + 100, "turn": "z", "angle": "360 °"}
    return counts.T, [*segments, turned]


PER = ("100 counts per m/s²", "1000 counts per rad/s")


def test_a_named_pose_is_the_mean_of_its_rows_less_what_stands_for_nothing() -> None:
    values, segments = recorded(24)
    data = posed(foreign({"columns": columns(PER, 1000.0), "segments": segments}, values))[0]
    np.testing.assert_allclose(data.observed[:, 3], values[900:1200].mean(axis=0) - 1000.0)
    np.testing.assert_allclose(data.channels.sensitivity, NOMINAL)
    assert data.turn[2, 24] == pytest.approx(2 * math.pi)
    np.testing.assert_allclose(data.variance[:, :24].mean(axis=1), 4.0 / 300.0, rtol=0.4)
    found = fitted(Poses(data))
    assert found.state.gain["gyro_z"] == pytest.approx(GAINS[5], abs=0.003)


@pytest.mark.parametrize(
    ("poses", "held", "words"),
    [
        (24, 9, "9 of 24 poses"), (20, 6, "6 of 20 poses"), (6, 6, "the last 40% of the time of"),
    ],
)  # fmt: skip
def test_what_is_held_out_depends_on_how_many_poses_can_be_spared(poses: int, held: int, words: str) -> None:
    values, segments = recorded(poses)
    data = posed(foreign({"columns": columns(PER, 1000.0), "segments": segments}, values))[0]
    assert np.count_nonzero(data.held) == held
    assert not data.held[-1]  # the only turn
    assert any(words in note for note in data.notes)


def test_poses_taken_twice_tell_how_well_they_come_back() -> None:
    data, segments = recorded(24)
    stretch = np.repeat(np.random.default_rng(1).normal(1.0, 0.002, (24, 1)), 300, axis=0)
    again = 1000.0 + (data[: 24 * 300] - 1000.0) * stretch
    values = np.concatenate([data[: 24 * 300], again])
    twice = [{"first": 300 * k, "last": 300 * (k + 1)} for k in range(48)]
    found = posed(foreign({"columns": columns(PER, 1000.0), "segments": twice}, values))[0]
    assert any("pairs of poses agree" in note for note in found.notes)
    alone = posed(foreign({"columns": columns(PER, 1000.0), "segments": segments}, data))[0]
    assert float(found.variance[:3].mean()) > 5.0 * float(alone.variance[:3].mean())


def test_a_turn_stated_the_wrong_way_round_is_said() -> None:
    values, segments = recorded(24, turn=-1.0)
    data = posed(foreign({"columns": columns(PER, 1000.0), "segments": segments}, values))[0]
    assert any(note.startswith("gyro_z shows -3") and "stated as 360°" in note for note in data.notes)


def test_gyros_alone_feel_gravity_along_the_axis_that_is_stated_to_be_up() -> None:
    values, _ = recorded(24)
    said = [{"first": 300 * k, "last": 300 * (k + 1), "up": up} for k, up in enumerate(("+x", "-y", None))]
    gyros = columns(PER, 1000.0)[3:]
    part = Poses(posed(foreign({"columns": gyros, "segments": said}, values))[0])
    np.testing.assert_allclose(part.reference.up[:, ::2], np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1]]).T, atol=1e-12)


def test_a_pose_that_the_accelerometers_have_upside_down_is_said_by_its_label() -> None:
    values, segments = recorded(24)
    largest = values[:300, :3].mean(axis=0) - 1000.0
    axis = int(np.abs(largest).argmax())
    for sign, count in (("-", 1), ("+", 0)) if largest[axis] > 0.0 else (("+", 1), ("-", 0)):
        told = [{**segments[0], "label": "first face", "up": f"{sign}{'xyz'[axis]}"}, *segments[1:]]
        data = posed(foreign({"columns": columns(PER, 1000.0), "segments": told}, values))[0]
        assert sum("in first face, stated with" in note for note in data.notes) == count


def test_a_segment_beyond_the_record_is_refused() -> None:
    values, segments = recorded(24)
    with pytest.raises(BadInput, match="found a segment up to row 99999, wanted at most 7300"):
        posed(foreign({"columns": columns(PER), "segments": [*segments, {"first": 0, "last": 99999}]}, values))


# published records


def real(name: str) -> Path:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"no {path}: set RIG_REAL_DATA to the folder with the real measurements")
    return path


def rms(found: Fit) -> float:
    """Of the magnitude less gravity, m/s², over all poses."""
    part = found.parts[0]
    assert isinstance(part, Poses)
    said = part.remarks(found.left, found.state.local(part, 0), found.state.terms)[0]
    return float(said.removeprefix("magnitude less g: ").split()[0])


@pytest.fixture(scope="module")
def xsens() -> Poses:
    values = np.loadtxt(real("imu-tk-xsens-multiposition") / "xsens_acc_gyro_raw.csv", delimiter=",", skiprows=1)
    made = foreign(
        {
            "columns": columns(("415 counts per m/s²", "4778 counts per rad/s"), 32768.0),
            "time": {"rate": "100 Hz"}, "gravity": {"value": "9.81744 m/s²", "uncertainty": "0.0001 m/s²"},
        },
        values[:, 1:],
    )  # fmt: skip
    return Poses(posed(made)[0])


def test_published_poses_come_down_step_by_step_to_a_millimetre_per_second_squared(xsens: Poses) -> None:
    ladder = [fitted(xsens, shared=True), fitted(xsens), fitted(xsens, square())]
    errors_ = [rms(found) for found in ladder]
    assert xsens.width in (37, 38, 39)
    assert errors_[0] == pytest.approx(0.0373, rel=0.03)
    assert errors_[1] == pytest.approx(0.0337, rel=0.03)
    assert errors_[2] <= 0.0012


def unseen(xsens: Poses, held: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> float:
    """Rms of the magnitude of poses, (width,), that a fit to all others predicts, m/s²."""
    found = fit([xsens], begin([xsens], [square()]), use=~np.tile(held, len(xsens.row_names)))
    left = residual([xsens], found.state).reshape(len(xsens.row_names), -1) * np.sqrt(xsens.noise())
    return math.sqrt(float(np.mean(left[0, held] ** 2)))


def test_published_poses_that_no_fit_has_seen_are_predicted_to_a_millimetre_per_second_squared(xsens: Poses) -> None:
    """The last fifteen; those all over the record, which differ more from each other, nearly as well."""
    assert xsens.data.held.sum() == 15
    assert unseen(xsens, np.arange(xsens.width) >= xsens.width - 15) <= 0.0012
    assert unseen(xsens, xsens.data.held) <= 0.0015


def test_published_angles_between_the_axes_come_out(xsens: Poses) -> None:
    found = fitted(xsens, square())
    degrees = sorted(abs(math.degrees(one)) for one in found.state.terms[0].at.values())
    assert degrees == pytest.approx([0.2, 0.5, 1.2], abs=0.06)  # of the published figures


@pytest.fixture(scope="module")
def ferraris() -> Poses:
    values = np.loadtxt(real("imucal-ferraris") / "example_ferraris_session.csv", delimiter=",", skiprows=1)
    rest = {"+x": (540, 1271), "-x": (1620, 2361), "+y": (2814, 3298), "-y": (3740, 4152), "+z": (4522, 4975),
            "-z": (5376, 5983)}  # fmt: skip
    turns = {"x": (6770, 7093), "y": (8081, 8405), "z": (9205, 9512)}
    segments: list[dict[str, object]] = [{"first": b, "last": e, "up": up} for up, (b, e) in rest.items()]
    segments += [{"first": b, "last": e, "turn": a, "angle": "-360 °"} for a, (b, e) in turns.items()]
    made = foreign(
        {"columns": columns(("", ""), unit=("m/s²", "°/s")), "time": {"rate": "102.4 Hz"}, "segments": segments},
        values[:, [4, 5, 6, 1, 2, 3]],
    )
    return Poses(posed(made)[0])


def test_a_published_session_of_six_faces_comes_down_to_millimetres_per_second_squared(ferraris: Poses) -> None:
    def left(x: Array) -> Array:
        """Weighed as the poses are, without logarithms."""
        shown = np.linalg.norm(ferraris.data.observed[:3, :12] - x[:3, None], axis=0) / (1.0 + x[3])
        return np.asarray((shown - 9.80665) / np.sqrt(ferraris.noise()[0, :12]))

    x = least_squares(left, np.zeros(4), x_scale="jac").x
    plain = math.sqrt(float(np.mean(left(x) ** 2 * ferraris.noise()[0, :12])))
    assert rms(linearised([ferraris], begin([ferraris], []))) == pytest.approx(0.564, rel=0.03)
    assert rms(fitted(ferraris, shared=True)) == pytest.approx(plain, rel=0.05)
    assert 0.09 < plain < 0.13
    assert rms(fitted(ferraris)) <= 0.0024


def test_published_turns_integrate_to_a_whole_turn_after_calibration(ferraris: Poses) -> None:
    found = fitted(ferraris)
    said = ferraris.remarks(found.left, found.state.local(ferraris, 0), found.state.terms)
    shown = [float(one.split("to ")[1].split("°")[0]) for one in said[1:]]
    assert shown == pytest.approx([-360.0] * 3, abs=0.1)
