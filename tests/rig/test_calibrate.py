"""From records to results: the truth lies where the intervals say, and bad records never become silent numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import fast_bench
import numpy as np
import pytest

from fixtures.world import World
from rig.archive.journal import Entry
from rig.archive.records import Recorded, Signals
from rig.calibrate import checking
from rig.calibrate.budget import DIVISORS
from rig.calibrate.calibrate import calibrate
from rig.calibrate.calibration import Calibration, Result, load, save, text
from rig.calibrate.comparison import compare, correlation
from rig.errors import BadInput, StandardOverdue
from rig.printed import rounded
from rig.record import CubeSamples, Response, Samples

SWEEP = {"procedure": "frequency_sweep", "axis": "x", "points": 8}


class Altered:
    """A run as it was recorded, but for what a test changes in its header, journal or counts."""

    def __init__(self, run: fast_bench.MemoryRecords, **changes: Any) -> None:
        self._run, self._changes = run, changes
        self.name = changes.get("name", run.name)
        self.status = str(changes.get("status", "completed"))
        self.header: Mapping[str, Any] = changes.get("header", run.header)
        self.lines: Sequence[Entry] = changes.get("lines", run.lines)
        self.points: Mapping[int, Mapping[str, Any]] = changes.get("points", run.points)

    def samples(self, name: str) -> Samples:
        alter = self._changes.get("samples", lambda samples: samples)
        altered: Samples = alter(self._run.samples(name))
        return altered

    def pieces(self, name: str) -> Iterator[Samples]:
        yield self.samples(name)

    def earlier(self) -> Iterator[Recorded]:
        return self._run.earlier()

    def traces(self, name: str) -> Signals:
        return self._run.traces(name)

    def response(self, name: str) -> Response:
        return self._run.response(name)

    def cube(self, name: str) -> CubeSamples:
        return self._run.cube(name)


@pytest.fixture(scope="module")
def world() -> World:
    return fast_bench.world(11)


@pytest.fixture(scope="module")
def sweep(world: World) -> fast_bench.MemoryRecords:
    return fast_bench.measure(SWEEP, world)


@pytest.fixture(scope="module")
def noise(world: World) -> fast_bench.MemoryRecords:
    return fast_bench.measure({"procedure": "noise", "length": "60 s", "cables": "turntable"}, world)


@pytest.fixture(scope="module")
def turning(world: World) -> fast_bench.MemoryRecords:
    return fast_bench.measure({"procedure": "turntable", "axis": "yaw", "revolutions": 20, "all": True}, world)


@pytest.fixture(scope="module")
def made(
    sweep: fast_bench.MemoryRecords, noise: fast_bench.MemoryRecords, turning: fast_bench.MemoryRecords
) -> Calibration:
    return calibrate([sweep, noise, turning], "made")


def away(made: Calibration, key: str, truth: float) -> float:
    """Error in units of the stated standard uncertainty."""
    result = made.result(key)
    assert result.value is not None, result.remarks
    return (result.value - truth) / result.u


@pytest.mark.parametrize("channel", ["unit_a_x", "unit_b_x", "unit_c_x", "gyro_yaw", "backup_yaw"])
def test_sensitivities_are_true_within_what_they_state(made: Calibration, world: World, channel: str) -> None:
    assert abs(away(made, f"{channel}.sensitivity", world.truth["sensitivity"][channel])) < 3.5
    assert abs(away(made, f"{channel}.offset", world.truth["zero"][channel])) < 3.5
    assert made.result(f"{channel}.sensitivity").status == "determined"


def test_without_the_reference_s_own_error_only_the_noise_is_left(made: Calibration, world: World) -> None:
    result = made.result("unit_a_x.sensitivity")
    assert result.value is not None
    known = result.value * world.truth["ldv_gain"]
    small = [c.contribution for c in result.contributions if c.name != "vibrometer gain"]
    assert abs(known - world.truth["sensitivity"]["unit_a_x"]) < 4.0 * float(np.linalg.norm(small))


def test_the_corner_of_the_output_filter_is_found(made: Calibration, world: World) -> None:
    assert abs(away(made, "unit_a_x.bandwidth", world.truth["pole"]["unit_a_x"])) < 3.5
    assert made.result("unit_a_x.bandwidth").u < 1.0


@pytest.mark.parametrize(
    "key",
    ["unit_a_x.nonlinearity", "gyro_roll.cross_coupling_yaw", "gyro_yaw.asymmetry",
     "gyro_yaw.quadratic", "gyro_yaw.cubic", "backup_yaw.asymmetry"],
)  # fmt: skip
def test_a_clean_sensor_shows_nothing_that_is_not_there(made: Calibration, key: str) -> None:
    assert abs(away(made, key, 0.0)) < 3.5


def test_noise_in_motion_is_the_noise_at_rest(made: Calibration) -> None:
    rest, motion = made.result("gyro_yaw.deviation"), made.result("gyro_yaw.deviation_in_motion")
    assert rest.value == pytest.approx(motion.value, rel=0.06)
    still, shaken = made.result("unit_a_x.deviation"), made.result("unit_a_x.deviation_in_motion")
    assert still.value == pytest.approx(shaken.value, rel=0.06)


def test_one_sense_leaves_asymmetry_undetermined_and_says_what_would_help(
    turning: fast_bench.MemoryRecords, world: World
) -> None:
    one = fast_bench.measure({"procedure": "turntable", "axis": "roll", "revolutions": 6, "rest": "10 s"}, world)
    result = calibrate([one], "one").result("gyro_roll.asymmetry")
    assert result.value is None
    assert "--all" in result.remarks[0]


def test_centripetal_acceleration_is_a_reference_of_its_own(made: Calibration, world: World) -> None:
    assert abs(away(made, "unit_a_z.sensitivity_centripetal", world.truth["sensitivity"]["unit_a_z"])) < 3.5


def test_centripetal_acceleration_stands_on_the_model_with_the_direct_value_beside(made: Calibration) -> None:
    result = made.result("unit_a_z.sensitivity_centripetal")
    assert result.method.startswith("model fitted to all records of the turntable")
    assert result.check is not None
    assert result.check.agrees
    lines = {line.name: line for line in result.contributions}
    assert set(lines) >= {"noise and wandering", "radius", "time base"}
    assert lines["radius"].sensitivity == pytest.approx(float(result.value or 0.0) / 0.05, rel=1e-9)


def test_a_missing_effect_is_flagged_and_widens_the_interval() -> None:
    hidden = fast_bench.world(11, [{"name": "first_order_lag"}])
    result = calibrate([fast_bench.measure(SWEEP, hidden)], "hidden").result("unit_a_x.sensitivity")
    assert result.status == "flagged"
    assert "effect is missing" in " ".join(result.remarks)


def test_shared_standards_tie_results_together(made: Calibration) -> None:
    both = made.covariance(["unit_a_x.sensitivity", "unit_b_x.sensitivity", "gyro_yaw.sensitivity"])
    correlation = both / np.sqrt(np.outer(np.diag(both), np.diag(both)))
    assert correlation[0, 1] > 0.99
    assert abs(correlation[0, 2]) < 0.01


def test_monte_carlo_agrees_with_the_budgets(made: Calibration) -> None:
    found = list(checking.checked(made, draws=400_000))
    assert len(found) >= 6
    # a rectangle has shorter tails than a normal law: where limits make most of the variance, U is a little long
    tolerance = [max(abs(one.distribution.low - (one.result.value or 0.0) + one.result.expanded),
                     abs(one.distribution.high - (one.result.value or 0.0) - one.result.expanded)) / one.result.u
                 for one in found]  # fmt: skip
    wanted = [max(0.15 * _by_limits(one.result), 0.02) for one in found]
    assert all(found < limit for found, limit in zip(tolerance, wanted, strict=True))


def _by_limits(result: Result) -> float:
    """Share of the variance that comes from limits, which are no normal law."""
    return sum(c.contribution**2 for c in result.contributions if c.distribution in DIVISORS) / result.u**2


def test_the_same_records_give_the_same_calibration(sweep: fast_bench.MemoryRecords) -> None:
    assert calibrate([sweep], "one") == calibrate([sweep], "one")


def test_a_calibration_reads_back_as_it_was_written(made: Calibration, tmp_path: Any) -> None:
    save(made, tmp_path / "made.yaml")
    assert load(tmp_path / "made.yaml") == made


def test_a_changed_or_foreign_file_is_refused(tmp_path: Any) -> None:
    (tmp_path / "other.yaml").write_text("format: 1\nname: x\n")
    with pytest.raises(BadInput, match="parts missing"):
        load(tmp_path / "other.yaml")
    (tmp_path / "list.yaml").write_text("- 1\n")
    with pytest.raises(BadInput, match="no calibration of format"):
        load(tmp_path / "list.yaml")


def test_values_are_rounded_where_their_uncertainty_ends() -> None:
    assert rounded(650.1234, 6.4321) == ("650.1", "6.4")
    assert rounded(0.0123456, 0.000995) == ("0.0123", "0.0010")
    assert rounded(12345.6, 432.1) == ("12350", "430")


def test_the_same_unit_compared_with_itself_agrees(made: Calibration) -> None:
    rows = compare(made, made)
    assert rows
    assert all(row.en == 0.0 and row.agrees for row in rows)


def test_common_standards_cancel_between_two_calibrations(sweep: fast_bench.MemoryRecords, world: World) -> None:
    first, second = (calibrate([run], run.name) for run in (sweep, fast_bench.measure(SWEEP, world)))
    row = next(r for r in compare(first, second) if r.key == "unit_a_x.sensitivity")
    assert row.expanded < 0.1 * first.result("unit_a_x.sensitivity").expanded
    assert row.agrees


def test_what_is_aligned_anew_is_no_common_error_of_two_calibrations(turning: fast_bench.MemoryRecords) -> None:
    stated = {**turning.header["bench_file"], "alignment": {"beam": "0.2°", "mount": "1°", "radius": "0.5 mm"}}
    tilted = replace(turning, header={**turning.header, "bench_file": stated})
    again = replace(tilted, name="another-day")
    one, same, other = (calibrate([run], "one").result("gyro_yaw.sensitivity") for run in (tilted, tilted, again))
    lines = [c for c in one.contributions if c.kind == "B"]
    anew = sum(c.contribution**2 for c in lines if turning.name in c.source)
    common = sum(c.contribution**2 for c in lines if turning.name not in c.source)  # certificates, the unit's own sheet
    assert next(c for c in lines if c.name == "axis to platter axis").contribution ** 2 == pytest.approx(anew, rel=0.01)
    assert correlation(one, same) * one.u**2 == pytest.approx(anew + common)  # the same records and mounting
    assert correlation(one, other) * one.u**2 == pytest.approx(common)


def test_two_units_share_no_data_sheet(sweep: fast_bench.MemoryRecords) -> None:
    made = calibrate([sweep], "one")
    line = next(c for c in made.result("unit_a_x.bandwidth").contributions if c.source == "data sheet of unit_a_x")
    assert line.contribution > 0.0
    row, apart = (
        next(r for r in compare(made, other) if r.key == "unit_a_x.bandwidth")
        for other in (made, replace(made, serial="ANOTHER"))
    )
    assert apart.expanded > row.expanded


def test_a_clipped_channel_is_left_out_with_a_note(sweep: fast_bench.MemoryRecords) -> None:
    def clip(samples: Samples) -> Samples:
        counts = samples.counts.copy()
        counts[::50, samples.index("unit_a_x")] = 65535
        return replace(samples, counts=counts)

    made = calibrate([Altered(sweep, samples=clip)], "clipped")
    clipped = made.result("unit_a_x.sensitivity")
    assert clipped.value is None
    assert "found 0 usable points" in clipped.remarks[0]
    assert made.result("unit_a_x.deviation").value is None
    assert made.result("unit_b_x.sensitivity").status == "determined"


def test_a_clipped_gyro_is_not_determined_and_the_other_is(turning: fast_bench.MemoryRecords) -> None:
    def clip(samples: Samples) -> Samples:
        counts = samples.counts.copy()
        counts[5, samples.index("gyro_yaw")] = 0
        return replace(samples, counts=counts)

    made = calibrate([Altered(turning, samples=clip)], "clipped")
    assert "clipped" in made.result("gyro_yaw.sensitivity").remarks[0]
    assert made.result("gyro_yaw.sensitivity").value is None
    assert made.result("gyro_yaw.deviation").value is None
    assert made.result("backup_yaw.sensitivity").value is not None


def test_an_interrupted_run_is_noted(sweep: fast_bench.MemoryRecords) -> None:
    assert any("is interrupted" in flag for flag in calibrate([Altered(sweep, status="interrupted")], "half").flags)


def test_a_record_without_its_reference_is_refused(sweep: fast_bench.MemoryRecords) -> None:
    def rename(samples: Samples) -> Samples:
        return replace(
            samples, channels=tuple(replace(c, name="spare" if c.name == "ldv" else c.name) for c in samples.channels)
        )

    with pytest.raises(BadInput, match="no record of the reference"):
        calibrate([Altered(sweep, samples=rename)], "lost")


def test_a_cube_on_another_face_than_the_run_says_is_refused(sweep: fast_bench.MemoryRecords) -> None:
    points = {i: {**body, **({"axis": "y"} if "axis" in body else {})} for i, body in sweep.points.items()}
    with pytest.raises(BadInput, match="motion along x, wanted it along y"):
        calibrate([Altered(sweep, points=points)], "turned")


def test_a_record_of_a_few_cycles_is_refused(sweep: fast_bench.MemoryRecords) -> None:
    def shorten(samples: Samples) -> Samples:
        return replace(samples, counts=samples.counts[:400])

    with pytest.raises(BadInput, match="cycles, wanted at least 5"):
        calibrate([Altered(sweep, samples=shorten)], "short")


def test_a_record_of_no_whole_cycles_is_left_out_with_a_note(sweep: fast_bench.MemoryRecords) -> None:
    def shorten(samples: Samples) -> Samples:
        return samples if len(samples.counts) != 3125 else replace(samples, counts=samples.counts[:3100])

    made = calibrate([Altered(sweep, samples=shorten)], "ragged")
    left_out = [flag for flag in made.flags if "not whole cycles" in flag and "left out" in flag]
    assert len(left_out) >= 8
    assert any(point.flags for point in made.responses["unit_a_x"])


def test_an_incoherent_reference_is_left_out(sweep: fast_bench.MemoryRecords) -> None:
    rng = np.random.default_rng(1)

    def disturb(samples: Samples) -> Samples:
        counts = samples.counts.copy()
        column = samples.index("ldv")
        size = float(np.std(counts[:, column].astype(float)))
        noisy = counts[:, column] + rng.normal(0.0, size, len(counts))
        counts[:, column] = np.clip(noisy, 1, 65534).astype(np.uint16)
        return replace(samples, counts=counts)

    made = calibrate([Altered(sweep, samples=disturb)], "noisy")
    assert made.result("unit_a_x.sensitivity").value is None
    assert any("low coherence" in flag for flag in made.flags)


def test_an_overdue_standard_is_refused_unless_somebody_ordered_it(sweep: fast_bench.MemoryRecords) -> None:
    standards = [{**s, "due": "2020-01-01"} if s["standard"] == "vibrometer" else s for s in sweep.header["standards"]]
    late = {**sweep.header, "standards": standards}
    with pytest.raises(StandardOverdue, match="EX-LDV"):
        calibrate([Altered(sweep, header=late)], "late")
    ordered = calibrate([Altered(sweep, header={**late, "overdue_overridden": ["vibrometer"]})], "ordered")
    assert ordered.overdue == ("vibrometer",)


def test_runs_of_two_units_are_not_merged(sweep: fast_bench.MemoryRecords) -> None:
    other = {**sweep.header, "sensor": {**sweep.header["sensor"], "serial": "another"}}
    with pytest.raises(BadInput, match="another sensor"):
        calibrate([sweep, Altered(sweep, header=other, name="other")], "mixed")


def test_a_part_that_follows_its_supply_is_brought_to_the_nominal_one(
    turning: fast_bench.MemoryRecords, noise: fast_bench.MemoryRecords
) -> None:
    """At 4.999 V a ratiometric gyro puts out 4.999/5 of what it would at 5 V."""
    channels = turning.header["sensor"]["channels"]
    stated = {**channels, "gyro_yaw": {**channels["gyro_yaw"], "ratiometric": "5 V"}}
    header = {**turning.header, "sensor": {**turning.header["sensor"], "channels": stated}}
    plain = calibrate([turning], "plain").result("gyro_yaw.sensitivity")
    moved = calibrate([Altered(turning, header=header)], "moved").result("gyro_yaw.sensitivity")
    supply = calibrate([turning], "plain").conditions["supply"][0]
    assert plain.value is not None
    assert moved.value is not None
    assert moved.value / plain.value == pytest.approx(5.0 / supply, abs=1e-4)
    assert "nominal supply" in " ".join(moved.remarks)


def test_side_axes_of_a_clean_cube_show_no_cross_axis(sweep: fast_bench.MemoryRecords, world: World) -> None:
    other = fast_bench.measure({**SWEEP, "axis": "y"}, world)
    both = calibrate([sweep, other], "both")
    for key in ("unit_a_y.cross_axis_x", "unit_a_x.cross_axis_y", "unit_b_y.cross_axis_x"):
        assert abs(away(both, key, 0.0)) < 3.5


def test_remounts_are_merged_and_their_scatter_is_in_the_budget(sweep: fast_bench.MemoryRecords, world: World) -> None:
    again = fast_bench.measure(SWEEP, world)
    merged = calibrate([sweep, again], "merged").result("unit_a_x.sensitivity")
    assert "repeatability across remounts" in {c.name for c in merged.contributions}
    assert "not measured" in " ".join(calibrate([sweep], "single").result("unit_a_x.sensitivity").remarks)


def test_poses_give_the_triad_s_angles() -> None:
    world = fast_bench.world(12)
    made = calibrate([fast_bench.measure({"procedure": "tumble", "poses": 24}, world)], "poses")
    for angle in ("xy", "xz", "yz"):
        assert abs(away(made, f"unit_a.angle_{angle}", 0.0)) < 3.5
    for channel in ("unit_a_x", "unit_b_y", "unit_c_z"):
        assert abs(away(made, f"{channel}.sensitivity_gravity", world.truth["sensitivity"][channel])) < 4.0
    six = calibrate([fast_bench.measure({"procedure": "tumble", "poses": 6}, world)], "six")
    assert "24" in six.result("unit_a.angle_xy").remarks[0]


def test_what_is_not_determined_says_why(sweep: fast_bench.MemoryRecords) -> None:
    alone = calibrate(
        [Altered(sweep, points={i: b for i, b in sweep.points.items() if b.get("level") != "quarter"})], "a"
    )
    result = alone.result("unit_a_x.nonlinearity")
    assert text(result).startswith("not determined: one level")
