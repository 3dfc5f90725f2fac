"""Effects from the dynamics to the noise, and those of the reference: values worked by hand, and limits."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest

from rig.effects.aliasing import Aliasing
from rig.effects.bessel_filter import BesselFilter
from rig.effects.buffer_gain import BufferGain
from rig.effects.butterworth_filter import ButterworthFilter
from rig.effects.channel_skew import ChannelSkew
from rig.effects.clock_ratio import ClockRatio
from rig.effects.crosstalk import Crosstalk
from rig.effects.delay import Delay
from rig.effects.drive_feedthrough import DriveFeedthrough
from rig.effects.encoder_graduation import EncoderGraduation
from rig.effects.encoder_second_harmonic import EncoderSecondHarmonic
from rig.effects.flicker import Flicker
from rig.effects.high_pass import HighPass
from rig.effects.ldv_cosine import LdvCosine
from rig.effects.ldv_delay import LdvDelay
from rig.effects.ldv_dropout import LdvDropout
from rig.effects.ldv_gain_step import LdvGainStep
from rig.effects.ldv_low_pass import LdvLowPass
from rig.effects.mains_hum import MainsHum
from rig.effects.missed_counts import MissedCounts
from rig.effects.motor_pickup import MotorPickup
from rig.effects.moving_average import MovingAverage
from rig.effects.multiplexer_settling import MultiplexerSettling
from rig.effects.quantisation import Quantisation
from rig.effects.random_walk import RandomWalk
from rig.effects.spur import Spur
from rig.effects.white import White
from rig.model import Channels, Effect, Local, Motion, Periods, Stretches, Term, at_work, volts
from rig.motion import ORDERS, PHASES

DYNAMICS: list[Effect] = [ButterworthFilter(), BesselFilter(), MovingAverage(), Delay(), HighPass()]
HOOKED: list[Effect] = [
    *DYNAMICS, MainsHum(), DriveFeedthrough(), Crosstalk(), BufferGain(), MotorPickup(), ChannelSkew(),
    MultiplexerSettling(), LdvGainStep(), LdvLowPass(), LdvDelay(), LdvCosine(), EncoderSecondHarmonic(),
]  # fmt: skip
LOOKED_AT: dict[str, list[Effect]] = {
    "codes": [Quantisation()], "clock": [ClockRatio()], "lines": [Aliasing(), Spur()], "dropouts": [LdvDropout()],
    "graduation": [EncoderGraduation()], "closure": [MissedCounts()],
}  # fmt: skip
UNHOOKED = [effect for effects in LOOKED_AT.values() for effect in effects]
SPECTRAL: list[Effect] = [White(), Flicker(), RandomWalk()]
ALONG = np.array([[0, 2.0, 0, 0, 0, 0], [0, 3j, 0, 0, 0, 0]], np.complex128)


def name_of(effect: Effect) -> str:
    return type(effect).__name__


def channels(axes: tuple[int, ...] = (0, 1, 2), rates: bool = False) -> Channels:
    """Ideal channels, 1 V/SI."""
    count = len(axes)
    return Channels(
        names=tuple("xyz"[axis] for axis in axes),
        rates=np.full(count, rates),
        axis=np.array(axes, np.intp),
        slot=np.arange(count, dtype=np.intp),
        side=np.full(count, math.nan),
        sensitivity=np.ones(count),
        tolerance=np.full(count, 0.05),
        pole=np.full(count, 1e12),
        unit=("imu",) * count,
    )


def shaken(scale: tuple[float, float] = (0.01, 0.1)) -> Motion:
    """Two sines along x: 2 m/s² at 50 Hz from 0.5 V, 3j m/s² at 200 Hz from 0.25 V."""
    grid = Periods(np.array([50.0, 200.0]))
    x = np.tile([[1.0], [0.0], [0.0]], 2)
    force = x[..., None] * grid.waveform(ALONG)
    still, rest = np.zeros((3, 2, PHASES)), np.zeros(2)
    return Motion(
        grid, "shaker", force, still, still, x[[1, 2, 0]], 9.81, rest + 25.0, rest + 5.0, rest,
        along=ALONG, drive=x, side=x[[1, 0, 2]], source=np.array([0.5, 0.25]), scale=np.array(scale),
    )  # fmt: skip


def spun(angle: list[float], motor: list[float]) -> Motion:
    """Instants at these angles of the platter, the motor driven or not."""
    count = len(angle)
    still, rest = np.zeros((3, count)), np.zeros(count)
    return Motion(
        Stretches(0.01, ((0, count),)), "turntable", still, still, still, still, 9.81, rest + 25.0, rest + 5.0, rest,
        angle=np.array(angle), motor=np.array(motor),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("effect", "at", "frequency", "magnitude", "degrees"),
    [
        (ButterworthFilter(), {"period": 1e-3}, 500.0, 1.0 / math.sqrt(1.0 + 0.5**8), -78.0),
        (ButterworthFilter(), {"period": 1e-3}, 1000.0, math.sqrt(0.5), -180.0),
        (BesselFilter(), {"period": 2e-4}, 500.0, 1.0 - 0.0031, -10.06),
        (BesselFilter(), {"period": 2e-4}, 5000.0, math.sqrt(0.5), -99.48),
        (MovingAverage(), {"window": 1e-3}, 500.0, 2.0 / math.pi, -90.0),
        (MovingAverage(), {"window": 1e-3}, 1000.0, 0.0, None),
        (Delay(), {"time": 20e-6}, 500.0, 1.0, -3.6),
        (Delay(), {"time": 1e-3}, 250.0, 1.0, -90.0),
    ],
)
def test_a_filter_has_the_gain_and_the_phase_of_its_textbook(
    effect: Effect, at: dict[str, float], frequency: float, magnitude: float, degrees: float | None
) -> None:
    found = complex(effect.response(np.array([frequency]), at)[0])
    assert abs(found) == pytest.approx(magnitude, abs=5e-5)
    if degrees is not None:
        turned = math.degrees(cmath.phase(found / cmath.rect(1.0, math.radians(degrees))))
        assert turned == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize(("corner", "magnitude", "degrees"), [(2.0, 1.0 - 0.00496, 5.71), (20.0, math.sqrt(0.5), 45.0)])
def test_a_high_pass_leads(corner: float, magnitude: float, degrees: float) -> None:
    grid = Periods(np.array([20.0]))
    first = grid.leaked(np.ones((1, ORDERS), np.complex128), HighPass().leaks({"corner": corner}))[0, 1]
    assert abs(first) == pytest.approx(magnitude, abs=5e-5)
    assert math.degrees(cmath.phase(first)) == pytest.approx(degrees, abs=0.05)


@pytest.mark.parametrize("effect", DYNAMICS, ids=name_of)
def test_a_filter_leaves_what_does_not_move_as_it_is(effect: Effect) -> None:
    (coordinate,) = effect.coordinates
    assert effect.response(np.zeros(2), {coordinate.name: coordinate.step}) == pytest.approx(1.0)


@pytest.mark.parametrize("effect", [ButterworthFilter(), BesselFilter(), LdvLowPass()], ids=name_of)
def test_no_period_is_no_corner(effect: Effect) -> None:
    assert effect.physical({"period": 2e-4}) == {"corner": pytest.approx(5000.0)}
    assert math.isnan(effect.physical({"period": 0.0})["corner"])
    assert math.isnan(effect.physical({"period": -1e-5})["corner"])


def test_hum_turns_on_by_the_offset_from_record_to_record_and_its_third_harmonic_thrice_as_fast() -> None:
    at = {"cosine": 3e-3, "sine": 4e-3, "cosine_third": 0.0, "sine_third": 1e-3, "offset": 0.01}
    elapsed = np.array([0.0, 25.0])  # a quarter of a turn at 0.01 Hz
    assert MainsHum().at_mains(1, elapsed, at) == pytest.approx(np.array([3e-3 - 4e-3j, 4e-3 + 3e-3j]))
    assert MainsHum().at_mains(3, elapsed, at) == pytest.approx(np.array([-1e-3j, -1e-3]))
    assert MainsHum().at_mains(2, elapsed, at) is None


def test_hum_reads_as_its_size_and_a_phase_that_leads() -> None:
    at = {"cosine": 3e-3, "sine": 4e-3, "cosine_third": 0.0, "sine_third": 1e-3, "offset": 0.01}
    found = MainsHum().physical(at)
    assert (found["amplitude"], found["third"], found["offset"]) == pytest.approx((5e-3, 1e-3, 0.01))
    assert (found["phase"], found["phase_third"]) == pytest.approx((-math.atan2(4, 3), -math.pi / 2))


def test_feed_through_is_the_source_s_voltage_against_the_acceleration_in_every_channel() -> None:
    motion = shaken()
    added = DriveFeedthrough().added(motion, channels(), {"share": 0.01})
    assert added is not None
    assert added.shape == (3, 2, PHASES)
    found = motion.grid.observed(np.asarray(added), lambda f: np.ones(f.shape, np.complex128))
    assert found[:, :, 1] == pytest.approx(np.tile([-5e-3, -2.5e-3j], (3, 1)))


def test_crosstalk_is_a_quarter_turn_ahead_and_grows_with_the_frequency() -> None:
    motion, few = shaken(), channels((2, 0))
    felt = Crosstalk().felt(np.zeros((2, 2, PHASES)), motion, few, {"time_constant": 1e-3})
    found = motion.grid.observed(felt, lambda f: np.ones(f.shape, np.complex128))
    assert found[0, :, 1] == pytest.approx(1e-3 * 2j * math.pi * np.array([50.0 * 2.0, 200.0 * 3j]), rel=2e-4)
    assert not found[1].any()


def test_a_gain_behind_the_sensor_is_nothing_but_another_sensitivity_and_zero() -> None:
    local, more = (Local(np.array([2.0 * k]), np.array([1e3]), np.array([0.5 * k])) for k in (1.0, 1.01))
    term = Term(BufferGain(), "acceleration", {"error": 0.01})
    assert volts(shaken(), channels((0,)), local, [term]) == pytest.approx(volts(shaken(), channels((0,)), more, []))


def test_pickup_comes_so_many_times_per_turn_and_only_while_the_motor_is_driven() -> None:
    motion = spun([0.0, math.pi / 8, math.pi / 4, math.nan, math.pi / 4], [1.0, 1.0, 1.0, 1.0, 0.0])
    at = {"cosine": 3e-4, "sine": 4e-4, "order": 4.0}
    added = MotorPickup().added(motion, channels((2, 1), rates=True), at)
    assert added == pytest.approx(np.tile([3e-4, 4e-4, -3e-4, 3e-4, 0.0], (2, 1)))
    assert MotorPickup().physical(at) == pytest.approx({"amplitude": 5e-4, "phase": math.atan2(4, 3), "order": 4.0})
    orders = [start["order"] for start in MotorPickup().starts(motion, None)]
    assert orders[:12] == [float(n) for n in range(1, 13)]


def test_every_slot_is_later_by_the_same_time_and_slots_before_the_reference_are_earlier() -> None:
    assert ChannelSkew().late(np.array([-1, 0, 3]), {"extra": 2e-6}) == pytest.approx([-2e-6, 0.0, 6e-6])


def test_a_share_of_the_slot_before_stays() -> None:
    shown = MultiplexerSettling().mixed(np.array([1.0, 2j]), np.array([3.0, 0.0]), {"share": 0.25})
    assert shown == pytest.approx(np.array([1.5, 1.5j]))


@pytest.mark.parametrize(
    ("effect", "at", "true"),
    [
        (LdvGainStep(), {"step": 0.25, "range": 0.01}, (1.6, 3j)),
        (LdvGainStep(), {"step": 0.25, "range": 0.1}, (1.6, 2.4j)),
        (LdvDelay(), {"time": 5e-3}, (2j, 3j)),
        (LdvDelay(), {"time": 1.25e-3}, (2.0 * cmath.exp(0.125j * math.pi), -3.0)),
        (LdvCosine(), {"angle": math.pi / 3}, (4.0, 6j)),
        (LdvCosine(), {"angle": 0.0}, (2.0, 3j)),
        (LdvLowPass(), {"period": 5e-3}, (2.0 / BesselFilter().response(np.array([0.25]), {"period": 1.0})[0],
                                          3j / BesselFilter().response(np.array([1.0]), {"period": 1.0})[0])),
        (LdvLowPass(), {"period": 0.0}, (2.0, 3j)),
    ],
)  # fmt: skip
def test_the_true_acceleration_is_what_the_vibrometer_would_have_to_show_less_of(
    effect: Effect, at: dict[str, float], true: tuple[complex, complex]
) -> None:
    motion = shaken()
    assert isinstance(motion.grid, Periods)
    found = effect.shaken(motion.along, motion.grid.harmonics, motion.scale, at)
    assert found[:, 1] == pytest.approx(np.array(true))
    assert found.shape == (2, ORDERS)


def test_a_gain_step_starts_at_every_range_but_the_coarsest() -> None:
    assert LdvGainStep().starts(shaken((0.01, 0.1)), None) == [{"step": 0.0, "range": 0.01}]
    assert LdvGainStep().starts(shaken((0.1, 0.1)), None) == []
    assert LdvGainStep().starts(shaken((math.nan, 0.0)), None) == []


def test_an_oval_disk_shows_too_much_twice_per_turn_with_its_derivatives() -> None:
    at = EncoderSecondHarmonic().from_physical({"ratio": 3e-4, "direction": 0.5})
    angle = -np.array([0.5, 0.5 + math.pi / 4, 0.5 + math.pi])  # the platter turns clockwise
    shown, slope, bend = EncoderSecondHarmonic().turned(angle, at)
    assert shown == pytest.approx([0.0, -3e-4, 0.0], abs=1e-15)
    assert slope == pytest.approx([6e-4, 0.0, 6e-4], abs=1e-15)
    assert bend == pytest.approx([0.0, 12e-4, 0.0], abs=1e-15)


@pytest.mark.parametrize("effect", [*HOOKED, *UNHOOKED, *SPECTRAL], ids=name_of)
def test_what_a_person_reads_leads_back_to_the_coordinates(effect: Effect) -> None:
    at = {c.name: 3.0 * c.step for c in effect.coordinates}
    assert effect.from_physical(effect.physical(at)) == pytest.approx(at)
    assert set(effect.physical(at)) == {p.name for p in effect.parameters}


@pytest.mark.parametrize("effect", HOOKED, ids=name_of)
def test_at_zero_nothing_is_changed(effect: Effect) -> None:
    zero = {c.name: 0.0 for c in effect.coordinates}
    on = effect.quantities[0] if effect.quantities else None
    motion, some = shaken(), channels(rates=on == "rate")
    local = Local(np.array([0.1, 0.2, 0.3]), np.array([400.0, 500.0, 600.0]), np.array([1.0, 2.0, 3.0]))
    before = volts(motion, some, local, [])[[2, 0, 1]]
    assert isinstance(motion.grid, Periods)
    terms = at_work([Term(effect, on, zero)], motion.place, "a run")
    assert np.allclose(volts(motion, some, local, terms, before), volts(motion, some, local, []))
    assert np.allclose(effect.shaken(motion.along, motion.grid.harmonics, motion.scale, zero), motion.along)
    assert not np.any(effect.turned(np.arange(3.0), zero))


@pytest.mark.parametrize(("where", "effects"), LOOKED_AT.items())
def test_what_no_harmonic_shows_is_left_to_a_test_of_its_own_and_moves_no_observable(
    where: str, effects: list[Effect]
) -> None:
    for effect in effects:
        assert effect.looks_in == where
        hooks = {"shaken", "turned", "motion", "felt", "transduce", "response", "output", "added", "late", "mixed"}
        assert hooks.isdisjoint(vars(type(effect)))


@pytest.mark.parametrize(
    ("effect", "parameters", "density"),
    [
        (White(), {"density": 2e-4}, [4e-8, 4e-8]),
        (Flicker(), {"level": 3e-3, "reach": 1e9}, [9e-6, 9e-7]),
        (RandomWalk(), {"coefficient": 1e-3}, [2e-6 / (2.0 * np.pi) ** 2, 2e-8 / (2.0 * np.pi) ** 2]),
    ],
    ids=["White", "Flicker", "RandomWalk"],
)
def test_a_density_is_one_sided_and_goes_with_the_square_of_the_sensitivity(
    effect: Effect, parameters: dict[str, float], density: list[float]
) -> None:
    """At 1 and 10 Hz, of channels of 1 V/SI and of two that are as sensitive as 3 V/SI."""
    some = replace(channels(), sensitivity=np.array([1.0, 3.0, -3.0]))
    found = effect.density(np.array([1.0, 10.0]), 1e3, some, effect.from_physical(parameters))
    assert found == pytest.approx(np.outer([1.0, 9.0, 9.0], density))
    assert effect.spectral
    assert not MainsHum().spectral
