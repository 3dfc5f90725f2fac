"""Transducer and motion effects against values worked by hand, and each one's limit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from rig.effects.asymmetry import Asymmetry
from rig.effects.axis_offset import AxisOffset
from rig.effects.cubic import Cubic
from rig.effects.dead_zone import DeadZone
from rig.effects.g_sensitivity import GSensitivity
from rig.effects.gravity_tilt import GravityTilt
from rig.effects.hysteresis import Hysteresis
from rig.effects.lever_arm import LeverArm
from rig.effects.odd_quadratic import OddQuadratic
from rig.effects.offset import Offset
from rig.effects.platen_tilt import PlatenTilt
from rig.effects.rocking import Rocking
from rig.effects.saturation import Saturation
from rig.effects.sensitivity import Sensitivity
from rig.effects.supply_ratio import SupplyRatio
from rig.effects.temperature_bias import TemperatureBias
from rig.effects.transverse_motion import TransverseMotion
from rig.effects.warm_up import WarmUp
from rig.model import Array, Channels, Effect, Motion, Periods, Quantity, Stretches, Term, at_work
from rig.motion import FINE, PHASES

G = 10.0  # m/s², easy to reckon with
X, Y, Z = np.eye(3)
PHASE = 2.0 * math.pi * np.arange(PHASES) / PHASES


def shaken(*frequency: float, amplitude: float = 1.0) -> Motion:
    """a = amplitude·cos along x at each frequency, up along z."""
    grid, count = Periods(np.array(frequency)), len(frequency)
    along = np.zeros((count, 6), np.complex128)
    along[:, 1] = amplitude
    ones = np.ones(count)
    force = np.multiply.outer(X, grid.waveform(along)) + G * Z[:, None, None]
    still, drive, up = np.zeros_like(force), np.outer(X, ones), np.outer(Z, ones)
    return Motion(grid, "shaker", force, still, still, up, G, 25.0 * ones, 5.0 * ones, 0.0 * ones, along, drive)


def turned(rate: float, turning: float = 0.0, angle: float = 0.0) -> Motion:
    """One instant on the turntable: up along y, outward along z, so the tangent is along x."""
    up, one = Y[:, None], np.ones(1)
    out, tangent = Z[:, None], X[:, None]
    return Motion(
        Stretches(1.0, ((0, 1),)), "turntable", G * up, rate * up, turning * up, up, G,
        25.0 * one, 5.0 * one, 0.0 * one,
        angle=angle * one, motor=one, outward=out, tangent=tangent,
    )  # fmt: skip


def channels(*axis: int, rates: bool = False, side: float = math.nan) -> Channels:
    """Channels of 0.5 V/SI along these axes."""
    count = len(axis)
    half = np.full(count, 0.5)
    return Channels(
        tuple("abcdef"[:count]), np.full(count, rates), np.array(axis), np.arange(count), np.full(count, side),
        half, half, np.full(count, 1e3), ("unit",) * count,
    )  # fmt: skip


def line(effect: Effect, at: dict[str, float], order: int, amplitude: float) -> complex:
    """Harmonic of amplitude·cos through a characteristic."""
    phase = 2.0 * math.pi * np.arange(FINE) / FINE + 0.001
    found = effect.transduce((amplitude * np.cos(phase))[None, None, :], shaken(80.0), at)
    return complex(np.mean(found * np.exp(-1j * order * phase)) * (2.0 if order else 1.0))


@pytest.mark.parametrize(
    ("effect", "at", "u", "out"),
    [
        (Sensitivity(), {"relative": 0.02}, [10.0, -5.0], [10.2, -5.1]),
        (Offset(), {"shift": 0.3}, [1.0, -1.0], [1.3, -0.7]),
        (Cubic(), {"coefficient": 1e-3}, [10.0, -2.0], [11.0, -2.008]),
        (Asymmetry(), {"ratio": 0.01}, [10.0, -10.0], [10.1, -9.9]),
        (OddQuadratic(), {"coefficient": 1e-3}, [10.0, -10.0], [10.1, -10.1]),
        (DeadZone(), {"width": 0.5}, [2.0, -2.0, 0.4], [1.5, -1.5, 0.0]),
        (DeadZone(), {"width": -0.5}, [2.0, -2.0], [2.5, -2.5]),
        (Saturation(), {"limit": 3.0}, [2.0, -4.0, 5.0], [2.0, -3.0, 3.0]),
        (Hysteresis(), {"width": 0.5}, [0.0, 2.0, 1.5, 0.0, -2.0, -1.5], [-0.5, 1.5, 1.5, 0.5, -1.5, -1.5]),
        (Hysteresis(), {"width": -0.5}, [0.0, 2.0, 1.5, 0.0, -2.0, -1.5], [0.5, 2.5, 1.5, -0.5, -2.5, -1.5]),
        (Hysteresis(), {"width": 0.5}, [9.81, 9.81], [9.81, 9.81]),
    ],
)
def test_a_characteristic_gives_the_values_worked_by_hand(
    effect: Effect, at: dict[str, float], u: list[float], out: list[float]
) -> None:
    assert effect.transduce(np.array([u]), shaken(80.0), at)[0] == pytest.approx(out)


@pytest.mark.parametrize(
    ("effect", "at", "order", "amplitude", "value"),
    [
        (Cubic(), {"coefficient": 1e-3}, 1, 2.0, 2.006),  # A(1 + ¾·1e-3·A²)
        (Cubic(), {"coefficient": 1e-3}, 3, 2.0, 0.002),  # 1e-3·A³/4
        (Asymmetry(), {"ratio": 0.01}, 0, 2.0, 0.04 / math.pi),
        (Asymmetry(), {"ratio": 0.01}, 2, 2.0, 0.08 / (3.0 * math.pi)),
        (Asymmetry(), {"ratio": 0.01}, 4, 2.0, -0.08 / (15.0 * math.pi)),
        (OddQuadratic(), {"coefficient": 1e-3}, 1, 2.0, 2.0 + 8.0 / (3.0 * math.pi) * 4e-3),
        (DeadZone(), {"width": 0.1}, 1, 2.0, 2.0 * 0.9364),  # the catalogue's 0.936 at d/A = 0.05
        (Saturation(), {"limit": 1.8}, 1, 2.0, 2.0 * 0.9629),  # −3.7 % at q = 0.9
        (Hysteresis(), {"width": 0.1}, 1, 2.0, 2.0 * (0.9813 - 0.0605j)),  # −(4/π)β(1 − β) at β = 0.05
    ],
)
def test_a_sine_leaves_the_lines_of_the_catalogue(
    effect: Effect, at: dict[str, float], order: int, amplitude: float, value: complex
) -> None:
    assert line(effect, at, order, amplitude) == pytest.approx(value, rel=2e-3)


@pytest.mark.parametrize(("effect", "width"), [(DeadZone(), 1e-6), (Hysteresis(), 1e-6)])
def test_a_width_has_the_same_slope_on_either_side_of_zero(effect: Effect, width: float) -> None:
    up, down = (line(effect, {"width": one}, 1, 2.0) - 2.0 for one in (width, -width))
    assert up == pytest.approx(-down, abs=1e-3 * width)


def test_play_wider_than_the_swing_lets_nothing_through() -> None:
    assert line(Hysteresis(), {"width": 2.1}, 1, 2.0) == pytest.approx(0.0, abs=1e-12)


def test_play_takes_every_row_by_itself() -> None:
    u = np.multiply.outer([[1.0, 2.0], [0.0, 5.0]], np.cos(PHASE)) + 3.0
    rows = [[Hysteresis().transduce(u[i, j], shaken(80.0), {"width": 0.2}) for j in range(2)] for i in range(2)]
    np.testing.assert_array_equal(Hysteresis().transduce(u, shaken(80.0), {"width": 0.2}), rows)


@pytest.mark.parametrize(
    ("motion", "on", "peak"),
    [(shaken(80.0, 160.0, amplitude=8.0), "acceleration", 8.0), (turned(-4.0), "rate", 4.0)],
)
def test_saturation_is_looked_for_just_below_the_largest_input(motion: Motion, on: Quantity, peak: float) -> None:
    limits = [start["limit"] for start in Saturation().starts(motion, on)]
    assert max(limits) < peak
    assert min(peak - one for one in limits) < 0.01 * peak
    assert min(limits) < 0.7 * peak


def test_saturation_is_not_looked_for_where_nothing_swings() -> None:
    assert Saturation().starts(shaken(80.0, 160.0, amplitude=8.0), "rate") == []


@pytest.mark.parametrize(("axis", "out"), [(0, 1.0 + 1e-3 * G), (1, 1.0), (2, 1.0)])
def test_a_gyro_takes_gravity_on_the_next_axis_for_rate(axis: int, out: float) -> None:
    gyro = channels(axis, rates=True)
    assert GSensitivity().felt(np.ones((1, 1)), turned(1.0), gyro, {"coefficient": 1e-3}) == pytest.approx(out)


def with_conditions(temperature: float, supply: float, elapsed: float) -> Motion:
    one = np.ones(1)
    return replace(turned(0.0), temperature=temperature * one, supply=supply * one, elapsed=elapsed * one)


@pytest.mark.parametrize(
    ("effect", "at", "conditions", "signal", "zero"),
    [
        (TemperatureBias(), {"coefficient": 0.01}, (35.0, 5.0, 0.0), 1.0, 2.05),  # 0.5 V/SI · 0.01 SI/K · 10 K
        (TemperatureBias(), {"coefficient": 0.01}, (25.0, 5.0, 0.0), 1.0, 2.0),
        (WarmUp(), {"shift": 0.2, "time_constant": 100.0}, (25.0, 5.0, 0.0), 1.0, 2.1),
        (WarmUp(), {"shift": 0.2, "time_constant": 100.0}, (25.0, 5.0, 100.0), 1.0, 2.0 + 0.1 / math.e),
        (WarmUp(), {"shift": 0.2, "time_constant": 100.0}, (25.0, 5.0, 1e5), 1.0, 2.0),
        (SupplyRatio(), {"share": 1.0}, (25.0, 5.5, 0.0), 1.1, 2.2),
        (SupplyRatio(), {"share": 0.5}, (25.0, 4.0, 0.0), 0.9, 1.8),
        (SupplyRatio(), {"share": 1.0}, (25.0, 5.0, 0.0), 1.0, 2.0),
    ],
)
def test_the_output_follows_the_conditions(
    effect: Effect, at: dict[str, float], conditions: tuple[float, float, float], signal: float, zero: float
) -> None:
    found = effect.output(np.ones((1, 1)), np.full((1, 1), 2.0), with_conditions(*conditions), channels(0), at)
    assert [one.item() for one in found] == pytest.approx([signal, zero])


def test_supply_scales_harmonics_point_by_point() -> None:
    motion = replace(shaken(20.0, 80.0), supply=np.array([5.0, 5.5]))
    signal, zero = SupplyRatio().output(np.ones((1, 2, 6)), np.ones((1, 2)), motion, channels(0), {"share": 1.0})
    np.testing.assert_allclose(signal[0, :, 0], [1.0, 1.1])
    np.testing.assert_allclose(zero[0], [1.0, 1.1])


@pytest.mark.parametrize(("frequency", "share"), [(0.5 / math.pi, 1.0), (1.0 / math.pi, 0.25), (1e4, 0.0)])
def test_gravity_through_tilt_falls_with_the_square_of_the_frequency(frequency: float, share: float) -> None:
    """At ω = 1 rad/s and 1 m/s² the table moves 1 m: 0.01 rad/m brings 0.01·g against the acceleration."""
    motion = shaken(frequency)
    more = GravityTilt().motion(motion, {"per_metre": 0.01}).force - motion.force
    np.testing.assert_allclose(more[0, 0], -0.01 * G * share * np.cos(PHASE), atol=1e-9)
    assert not more[1:].any()


def felt(effect: Effect, motion: Motion, at: dict[str, float]) -> list[float]:
    """What x, y and z feel more on the turntable."""
    return [float(v) for v in effect.felt(np.zeros((3, 1)), motion, channels(0, 1, 2), at)[:, 0]]


@pytest.mark.parametrize(
    ("rate", "turning", "x", "y", "z", "out"),
    [
        (3.0, 0.0, 0.0, 0.0, 0.1, [0.0, 0.0, -0.9]),  # ω²r inwards
        (-3.0, 0.0, 0.2, 0.0, 0.0, [-1.8, 0.0, 0.0]),
        (0.0, 2.0, 0.0, 0.0, 0.1, [0.2, 0.0, 0.0]),  # y × z = x
        (3.0, 2.0, 0.0, 0.7, 0.0, [0.0, 0.0, 0.0]),  # along the axis nothing moves
    ],
)
def test_an_arm_feels_the_centripetal_and_the_tangential_acceleration(
    rate: float, turning: float, x: float, y: float, z: float, out: list[float]
) -> None:
    assert felt(LeverArm(), turned(rate, turning), {"x": x, "y": y, "z": z}) == pytest.approx(out)


@pytest.mark.parametrize(
    ("rate", "turning", "out"),
    [(2.0, 0.0, [-0.04, 0.0, -0.04]), (0.0, 3.0, [0.0, 0.0, -0.03]), (0.0, 0.0, [0.0, 0.0, 0.0])],
)
def test_every_axis_feels_the_acceleration_of_its_own_point(rate: float, turning: float, out: list[float]) -> None:
    """Points at 0.01 m·(x + y), (y + z) and (z + x)."""
    assert felt(AxisOffset(), turned(rate, turning), {"offset": 0.01 * math.sqrt(2.0)}) == pytest.approx(out, abs=1e-15)


@pytest.mark.parametrize(
    ("angle", "outward", "tangential"),
    [(0.0, 0.1, 0.0), (0.5 * math.pi, 0.0, -0.1), (math.pi, -0.1, 0.0), (math.nan, 0.0, 0.0)],
)
def test_gravity_goes_round_on_a_leaning_platter(angle: float, outward: float, tangential: float) -> None:
    at = PlatenTilt().from_physical({"tilt": 0.01, "direction": 0.0})
    force = PlatenTilt().motion(turned(1.0, angle=angle), at).force[:, 0]
    assert force == pytest.approx([tangential, G, outward], abs=1e-12)


@pytest.mark.parametrize(
    ("frequency", "side", "wave"),
    [
        (100.0, 0.02, 0.2 * np.sin(PHASE)),  # at the mode 1/(2j·0.05) = −10j: a quarter turn late
        (100.0, -0.02, -0.2 * np.sin(PHASE)),
        (0.1, 0.02, 0.02 * np.cos(PHASE)),  # far below it, in phase
        (100.0, math.nan, 0.0 * PHASE),
    ],
)
def test_rocking_moves_the_sides_against_each_other(frequency: float, side: float, wave: Array) -> None:
    at = {"ratio": 1.0, "frequency": 100.0, "damping": 0.05}
    more = Rocking().felt(np.zeros((1, 1, PHASES)), shaken(frequency), channels(0, side=side), at)
    np.testing.assert_allclose(more[0, 0], wave, atol=1e-5)
    assert not Rocking().felt(np.zeros((1, 1, PHASES)), shaken(frequency), channels(0, rates=True, side=side), at).any()


def test_rocking_turns_the_case_about_the_vertical() -> None:
    found = Rocking().motion(shaken(100.0), {"ratio": 1.0, "frequency": 100.0, "damping": 0.05})
    np.testing.assert_allclose(found.turning[2, 0], 10.0 * np.sin(PHASE), atol=1e-12)
    np.testing.assert_allclose(found.rate[2, 0], -np.cos(PHASE) / (20.0 * math.pi), atol=1e-12)
    assert not found.turning[:2].any()


@pytest.mark.parametrize(
    ("frequency", "wave"), [(0.1, 0.01 * np.cos(PHASE)), (100.0, 0.1 * np.sin(PHASE)), (1e5, 0.0 * PHASE)]
)
def test_transverse_motion_is_upright_and_largest_at_its_mode(frequency: float, wave: Array) -> None:
    motion = shaken(frequency)
    found = TransverseMotion().motion(motion, {"ratio": 0.01, "frequency": 100.0, "damping": 0.05})
    np.testing.assert_allclose((found.force - motion.force)[2, 0], wave, atol=2e-6)
    np.testing.assert_array_equal(found.force[:2], motion.force[:2])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("effect", [Rocking(), TransverseMotion(), WarmUp()])
def test_an_effect_of_no_size_needs_no_frequency_and_no_time(effect: Effect) -> None:
    motion, at = shaken(80.0), dict.fromkeys((c.name for c in effect.coordinates), 0.0)
    np.testing.assert_array_equal(effect.motion(motion, at).force, motion.force)
    assert not effect.felt(np.zeros((1, 1, PHASES)), motion, channels(0, side=0.01), at).any()
    assert not effect.output(np.zeros((1, 1, 6)), np.zeros((1, 1)), motion, channels(0), at)[1].any()


@pytest.mark.parametrize("effect", [GravityTilt(), Rocking(), TransverseMotion(), Hysteresis()])
def test_the_shaker_is_not_on_the_turntable(effect: Effect) -> None:
    term = Term(effect, None, {c.name: 1.0 for c in effect.coordinates})
    assert at_work([term], "turntable", "a run") == []
    assert at_work([term], "shaker", "a run") == [term]


@pytest.mark.parametrize("effect", [PlatenTilt(), LeverArm(), AxisOffset()])
def test_the_turntable_is_not_on_the_shaker(effect: Effect) -> None:
    term = Term(effect, None, {c.name: 1.0 for c in effect.coordinates})
    assert at_work([term], "shaker", "a run") == []
    assert at_work([term], "turntable", "a run") == [term]


def test_an_arm_is_read_as_length_and_direction_from_z_towards_x() -> None:
    found = LeverArm().physical({"x": 0.03, "y": 0.002, "z": 0.04})
    assert found == pytest.approx({"length": 0.05, "direction": math.atan2(3.0, 4.0), "y": 0.002})
