"""Cases that somebody else's reference followed: an encoder's log and a camera's track, made here by their physics."""

from __future__ import annotations

import math

import imported_worlds as worlds
import numpy as np
import pytest
from imported_worlds import Unit, clean, evidence, motion, rotation

from rig.diagnose.conclusion import Conclusion, conclude
from rig.diagnose.diagnose import Diagnosis, diagnose
from rig.fit.adequacy import untold
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.parts.track import TrackedMotion
from rig.shelf import effect_of, nothing_of, shelf

LATE, ARM, TILT = 8e-3, (0.02, -0.03, 0.05), (0.02, -0.03, 0.01)
THROWN = Unit(rate_delay=4e-3, force_delay=7e-3, tilt=TILT, arm=ARM)


def fitted(made: Evidence, **names: str | None) -> Fit:
    return made.fitted([nothing_of(effect_of(name.strip("_")), on) for name, on in names.items()])  # type: ignore[arg-type]


def at(found: Fit, name: str) -> dict[str, tuple[float, float]]:
    """Coordinates of an effect in a fit, with their standard uncertainties."""
    for number, term in enumerate(found.state.terms):
        if term.effect.name == name:
            u = found.u(number)
            return {key: (value, u[key]) for key, value in term.at.items()}
    raise AssertionError(f"{name} is not in the model")


def near(found: tuple[float, float], true: float, floor: float) -> bool:
    """Within three standard uncertainties, or within what such data can be wrong by."""
    return abs(found[0] - true) < max(3.0 * found[1], floor)


def members(found: Diagnosis) -> list[set[str]]:
    return [{step.taken.name, *(one.name for one in step.members)} for step in found.steps]


# turned with an encoder


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_gyros_delay_and_gain_are_found_against_an_encoder_whatever_the_axis(axis: str) -> None:
    gain = [1.0, 1.0, 1.0]
    gain["xyz".index(axis)] = 0.98
    made = evidence(rotation(Unit(rate_gain=gain, rate_delay=LATE), axis=axis))
    found = fitted(made, delay="rate")
    assert near(at(found, "delay")["time"], LATE, 1e-4)
    assert found.state.gain[f"gyro_{axis}"] == pytest.approx(-0.02, abs=5e-4)
    assert found.chi2 / found.count == pytest.approx(1.0, abs=0.15)


def test_a_delay_against_an_encoder_is_named() -> None:
    found = diagnose(evidence(rotation(Unit(rate_delay=LATE), channels="r")))
    assert found.verdict == "missing"
    assert len(found.steps) == 1
    assert {"delay", "reference_delay"} & members(found)[0]


def test_one_delay_of_gyros_and_accelerometers_alike_is_the_references() -> None:
    found = diagnose(evidence(rotation(Unit(rate_delay=LATE, force_delay=LATE), upright=False)))
    assert found.named == ("reference_delay",)
    assert near(at(found.final, "reference_delay")["time"], -LATE, 1e-4)


def test_a_case_that_is_tilted_on_its_shaft_shows_by_how_much() -> None:
    made = evidence(rotation(Unit(tilt=(0.03, -0.02, 0.0))))
    found = diagnose(made)
    assert found.named == ("reference_tilt",)
    tilt = at(found.final, "reference_tilt")
    assert near(tilt["x"], 0.03, 5e-4)
    assert near(tilt["y"], -0.02, 5e-4)


def test_the_angle_about_the_shaft_stays_where_it_is_since_nothing_shows_it() -> None:
    found = fitted(evidence(rotation(Unit(tilt=(0.03, -0.02, 0.0), rate_delay=LATE, force_delay=LATE), upright=False)),
                   reference_tilt=None, reference_delay=None)  # fmt: skip
    assert at(found, "reference_tilt")["z"] == (0.0, 0.0)
    assert near(at(found, "reference_tilt")["x"], 0.03, 1e-3)


@pytest.mark.parametrize(("sense", "said"), [(1, False), (-1, True)])
def test_the_sense_of_an_encoder_is_found_where_nobody_states_it(sense: int, said: bool) -> None:
    made = evidence(rotation(Unit(), sense=sense, seconds=30.0))
    assert any("counts against the encoder" in note for note in made.notes) is said
    assert made.fitted().chi2 / made.fitted().count == pytest.approx(1.0, abs=0.25)


def test_a_sense_that_is_stated_is_believed() -> None:
    made = evidence(rotation(Unit(), sense=-1, stated=1, seconds=30.0))
    assert not any("counts against" in note for note in made.notes)
    found = made.fitted()
    assert found.state.gain["gyro_z"] == pytest.approx(-2.0, abs=0.01)
    assert found.penalty > 1000.0


@pytest.mark.parametrize(("axis", "lies"), [("x", 0.7), ("y", 2.9), ("z", -1.8)])
def test_how_gravity_lies_about_a_level_axis_is_found(axis: str, lies: float) -> None:
    made = evidence(rotation(Unit(), axis=axis, upright=False, lies=lies))
    part, found = made.parts[0], made.fitted()
    assert isinstance(part, TrackedMotion)
    angle = part.data.phase + at(found, "gravity_angle")["angle"][0]
    turns = (angle - lies) / (2.0 * math.pi)
    assert 2.0 * math.pi * (turns - round(turns)) == pytest.approx(0.0, abs=2e-3)
    assert found.chi2 / found.count == pytest.approx(1.0, abs=0.15)


def test_rows_that_stand_twice_are_dropped_and_said() -> None:
    made = evidence(rotation(Unit(), seconds=20.0, doubled=0.01))
    assert any(note.startswith("dropped 20 of 2020 rows") for note in made.notes)


# thrown about before cameras


@pytest.fixture(scope="module")
def thrown() -> Evidence:
    return evidence(motion(THROWN))


@pytest.fixture(scope="module")
def concluded(thrown: Evidence) -> Conclusion:
    return conclude(thrown, [], shelf())


def test_arm_delays_and_tilt_come_back_from_free_motion(thrown: Evidence) -> None:
    terms = [("delay", "rate"), ("delay", "acceleration"), ("reference_tilt", None), ("lever_arm", "acceleration")]
    found = thrown.fitted([nothing_of(effect_of(name), on) for name, on in terms])  # type: ignore[arg-type]
    delays = [term.at["time"] for term in found.state.terms if term.effect.name == "delay"]
    assert delays == pytest.approx([4e-3, 7e-3], abs=5e-5)
    for name, true, floor in (("reference_tilt", TILT, 1e-4), ("lever_arm", ARM, 2e-4)):
        assert [
            key for key, value in zip("xyz", true, strict=True) if not near(at(found, name)[key], value, floor)
        ] == []
    assert found.chi2 / found.count == pytest.approx(1.0, abs=0.1)


def test_diagnosis_names_arm_tilt_and_delays_and_leaves_noise(concluded: Conclusion) -> None:
    found = concluded.diagnosis
    assert found.verdict == "missing"
    assert {"lever_arm", "reference_tilt"} <= set(found.named)
    assert concluded.error > 50.0
    assert concluded.after < 1.1
    late = {"delay", "reference_delay", "moving_average", "butterworth_filter", "bessel_filter"}
    assert sum(bool(late & one) for one in members(found)) == 2
    arm = at(found.final, "lever_arm")
    assert [key for key, value in zip("xyz", ARM, strict=True) if not near(arm[key], value, 2e-4)] == []


@pytest.mark.parametrize(
    ("unit", "names"),
    [
        (Unit(arm=ARM), {"lever_arm"}),
        (Unit(tilt=TILT), {"reference_tilt"}),
        (Unit(tilt=TILT, arm=ARM), {"lever_arm", "reference_tilt"}),
        (Unit(rate_delay=4e-3, force_delay=4e-3), {"reference_delay"}),
    ],
)
def test_each_alone_is_named(unit: Unit, names: set[str]) -> None:
    found = diagnose(evidence(motion(unit, seed=2)))
    assert set(found.named) == names
    assert found.verdict == "missing"


def test_that_nobody_can_tell_a_delay_from_a_wrong_clock_is_said(thrown: Evidence, concluded: Conclusion) -> None:
    sentence = "a delay that all channels share and an offset of the reference's time stamps are one and the same"
    assert any(sentence in one for one in thrown.blind)


def test_gaps_are_left_out_and_counted(thrown: Evidence) -> None:
    part = thrown.parts[0]
    assert isinstance(part, TrackedMotion)
    assert len(part.data.records) >= 2
    assert any("gaps are longer" in note for note in thrown.notes)


# noise


def test_error_over_stated_uncertainty_of_a_lever_arm_is_near_one() -> None:
    offs = []
    for seed in range(12):
        found = fitted(evidence(motion(Unit(arm=ARM), seed, seconds=20.0)), lever_arm="acceleration")
        arm = at(found, "lever_arm")
        offs += [(arm[key][0] - true) / arm[key][1] for key, true in zip("xyz", ARM, strict=True)]
    assert 0.6 < math.sqrt(float(np.mean(np.square(offs)))) < 1.6


def test_no_line_has_hardly_any_noise_though_the_filter_follows_it() -> None:
    part = evidence(motion(Unit(), seconds=20.0)).parts[0]
    assert isinstance(part, TrackedMotion)
    assert (part.variance.max(axis=1) / part.variance.min(axis=1)).max() < 1e4


@pytest.mark.parametrize("band", [0.6, 0.9, 1.5])
def test_a_band_of_few_lines_has_its_noise_though_a_filter_could_follow_them_all(band: float) -> None:
    wide, narrow = (evidence(motion(Unit(), seconds=20.0, bands=(6.0, f))).parts[0] for f in (6.0, band))
    assert isinstance(wide, TrackedMotion)
    assert isinstance(narrow, TrackedMotion)
    here = (wide.frequency_of > 0.0) & (wide.frequency_of < 0.4)
    ratio = np.sqrt(narrow.variance[3:, here].mean(axis=1) / wide.variance[3:, here].mean(axis=1))
    assert np.all((ratio > 0.4) & (ratio < 2.5)), ratio


def test_noise_that_is_louder_while_the_motion_is_counts_for_more_doubt() -> None:
    part = evidence(rotation(Unit(), channels="r", seconds=30.0)).parts[0]
    assert isinstance(part, TrackedMotion)
    random = np.random.default_rng(1)
    fast = np.abs(part.reference.rate[2])
    signals = [random.normal(size=(3, len(fast))) for _ in range(3)]
    effect, even, loud = (part.lines(s * w).reshape(-1) for s, w in zip(signals, (fast, 1.0, fast), strict=True))
    assert part.unevenness(effect, even) < 1.3
    assert part.unevenness(effect, loud) > 1.8


CLEAN = {
    "upright": lambda seed: rotation(clean(seed), seed, seconds=30.0),
    "lying": lambda seed: rotation(
        clean(seed), seed, seconds=30.0, axis="xyz"[seed % 3], upright=False, lies=0.7 * seed
    ),
    "free": lambda seed: motion(clean(seed), seed, seconds=20.0),
}


@pytest.mark.parametrize("kind", CLEAN)
def test_a_clean_record_names_nothing(kind: str) -> None:
    """Adequate where the band above the motion tells the noise, else undecided."""
    made = [evidence(CLEAN[kind](seed)) for seed in range(20)]
    wanted = ["undecided" if untold(one.fitted()) else "adequate" for one in made]
    wrong = [seed for seed, one in enumerate(made) if diagnose(one).verdict != wanted[seed]]
    assert len(wrong) <= 1, wrong


def test_the_worlds_own_force_is_gravity_at_rest_and_centripetal_in_a_turn() -> None:
    body = worlds.Tumbling.of(1)
    t = np.array([1.0, 2.0])
    apart = body.force(t, np.array([0.1, 0.0, 0.0])) - body.force(t, np.zeros(3))
    rate = body.rate(t)
    turning = (body.rate(t + 1e-3) - body.rate(t - 1e-3)) / 2e-3
    arm = np.array([0.1, 0.0, 0.0])[:, None] * np.ones(2)
    rigid = np.cross(turning, arm, axis=0) + np.cross(rate, np.cross(rate, arm, axis=0), axis=0)
    np.testing.assert_allclose(apart, rigid, atol=2e-4)


def test_sampled_lines_of_an_encoder_give_the_delay_that_its_angle_gives() -> None:
    how = {"seconds": 12.0, "rows": 5000.0, "jitter": 0.0, "doubled": 0.0, "steps": 0.0}
    foreign = rotation(Unit(rate_delay=LATE), channels="r", **how)  # type: ignore[arg-type]
    counted = worlds.with_lines(foreign, 360)
    for made in (evidence(foreign), evidence(counted)):
        assert near(at(fitted(made, delay="rate"), "delay")["time"], LATE, 1e-4)
