"""Every effect and its twin: the same parameters, as the world states them, change the same motion in the same way.

The simulated world works in volts at instants, the model in harmonics of a steady sine or on an even grid, and neither
imports the other. So a sign, a unit, a factor of two or a phase that one of them means otherwise shows here. What no
harmonic shows is measured from the world's volts and held against the parameters as the effect states them.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from fixtures.channels import SHAKER_CABLES, TURNTABLE_CABLES
from fixtures.imperfections import Beginning, Imperfection
from fixtures.motion import on_shaker, on_turntable
from fixtures.shelf import SHELF
from fixtures.strength import Quiet
from rig.model import Channels, Effect, Local, Motion, Periods, Stretches, Term, Values, volts
from rig.motion import FINE, ORDERS

MAINS, SCAN, SLOT = 50.0, 3125.0, 20e-6
FREQUENCIES, LEVELS = (25.0, 110.0, 290.0), (0.6, 0.9, 0.8)  # Hz; of the largest level of a sweep
SCALES = (0.005, 0.005, 0.001)  # (m/s)/V
FIRST, APART = 60.0, 30.0  # s: first record, and from one to the next
BEGUN = Beginning(FIRST, 0.37, MAINS)  # the bench clock shows a whole second 0.37 s after the world's start
SIDE = {"unit_a": 0.010, "unit_b": -0.010, "unit_c": 0.005}  # m, from the spot, by the sensor file
LOOKED_AT = {
    "clock_ratio", "aliasing", "spur", "quantisation", "ldv_dropout", "encoder_graduation", "missed_counts", "white",
    "flicker", "random_walk",
}  # fmt: skip
ABOUT_ZERO = {"gravity_tilt", "high_pass"}  # on one mount a constant tilt, and gravity that leaks away, are the zero's
REFERENCE = {"ldv_gain_step", "ldv_low_pass", "ldv_delay", "ldv_cosine"}
DISK = {"encoder_eccentricity", "encoder_second_harmonic"}
ON_SHAKER = [
    name for name in SHELF.names
    if "shaker" in SHELF.kind(name).benches and name not in LOOKED_AT | REFERENCE | {"mains_hum"}
]  # fmt: skip
ON_TURNTABLE = [
    name
    for name in SHELF.names
    if "turntable" in SHELF.kind(name).benches and name not in LOOKED_AT | DISK | {"mains_hum"}
] + ["high_pass"]  # its strength is counted on the shaker
Lines = np.ndarray[Any, np.dtype[np.complex128]]


def effect_of(name: str) -> Effect:
    module = importlib.import_module(f"rig.effects.{name}")
    (kind,) = (one for one in vars(module).values() if isinstance(one, type) and one.__module__ == module.__name__)
    kind.name = name
    made = kind()
    assert isinstance(made, Effect)
    return made


def twin_of(name: str, bench: str, seed: int = 4) -> Imperfection:
    """With parameters of usual sizes."""
    parameters = SHELF.kind(name).drawn(np.random.default_rng(seed), bench)
    if name in ("saturation", "one_sided_saturation"):
        parameters["limit"] = 3.0  # here is less motion than in a standard run
    if name == "one_sided_saturation":
        parameters["side"] = -1.0  # the way that the table turns
    return SHELF.make(name, parameters)


def term_of(twin: Imperfection) -> Term:
    """The effect with the parameters that the world states."""
    effect, said = effect_of(twin.name), twin.stated(BEGUN)
    at = effect.from_physical({one.name: said[one.name] for one in effect.parameters})
    quantity = getattr(twin, "quantity", None) or (effect.quantities[0] if effect.quantities else None)
    return Term(effect, quantity, at)


class Shaken:
    """Three records of one second, driven along x, without noise: `lines` V (16, 3, 6) as if sampled at one instant."""

    def __init__(self, *hidden: Imperfection) -> None:
        self.physics = physics = Quiet(1, MAINS, hidden)
        physics.put(on_shaker("x"))
        physics.vibrometer.level, physics.source.clock = 36.0, 0.0
        made = list(self._records())
        self.lines, self.before = (np.array(one).transpose(1, 0, 2) for one in zip(*made, strict=True))

    def _records(self) -> Iterator[tuple[Lines, Lines]]:
        for number, (f, share, scale) in enumerate(zip(FREQUENCIES, LEVELS, SCALES, strict=True)):
            begin = FIRST + APART * number
            self.physics.vibrometer.scale = scale
            self.physics.set_source(begin - 2.0, f, share * level(self.physics, f), True, 0.0, True)
            times = begin + np.arange(round(SCAN)) / SCAN
            found = self.physics.volts(SHAKER_CABLES, [times + slot * SLOT for slot in range(16)])
            whole = np.fft.rfft(np.array(found)) * (2.0 / SCAN)
            whole[:, 0] /= 2.0
            at = np.round(f * np.arange(ORDERS)).astype(int)
            late = np.exp(-2j * math.pi * at * SLOT * np.arange(16)[:, None])
            yield whole[:, at] * late, np.roll(whole[:, at], 1, axis=0) * late

    def shown(self) -> Lines:
        """Acceleration that the vibrometer shows if nothing is hidden in it, m/s², (3, 6)."""
        physics, shown = Quiet(1, MAINS, ()), np.zeros((3, ORDERS), np.complex128)
        for number, (f, scale) in enumerate(zip(FREQUENCIES, SCALES, strict=True)):
            physics.vibrometer.scale = scale
            at = f * np.arange(1.0, ORDERS)
            known = physics.vibrometer.response(at) * physics.filter.at(at)
            shown[number, 1:] = 2j * math.pi * at * self.lines[1, number, 1:] / known
        return shown


def level(physics: Quiet, f: float) -> float:
    """Volts programmed that shake as a sweep does at full level."""
    stroke = min(80e-6, 0.5 * 9.80665 / (2.0 * math.pi * f) ** 2)
    return stroke / abs(physics.shaker.stroke(f))


@lru_cache
def still_shaken() -> Shaken:
    return Shaken()


def recorder(physics: Quiet, cables: tuple[str, ...], origin: int) -> tuple[Channels, Local, list[int]]:
    """Sensors among the cables as the model has them, with their true values; their slots."""
    slots = [slot for slot, name in enumerate(cables) if physics.channels[name].is_sensor]
    found = [physics.channels[cables[slot]] for slot in slots]
    numbers = {key: np.array([getattr(one, key) for one in found]) for key in ("sensitivity", "pole", "zero")}
    channels = Channels(
        tuple(one.name for one in found), np.array([one.quantity == "rate" for one in found]),
        np.array([one.axis for one in found]), np.array(slots) - origin,
        np.array([SIDE.get(one.unit, math.nan) for one in found]), numbers["sensitivity"],
        np.full(len(found), 0.05), numbers["pole"], tuple(one.unit for one in found),
    )  # fmt: skip
    return channels, Local(numbers["sensitivity"], numbers["pole"], numbers["zero"]), slots


def motion_of(clean: Shaken) -> Motion:
    """What the cube went through, by the records of the clean world."""
    grid, along, mount = Periods(np.array(FREQUENCIES), FINE), clean.shown(), on_shaker("x")
    drive, up, side = (np.repeat(mount.case_from_bench[:, [k]], 3, axis=1) for k in range(3))
    surroundings, middle = clean.physics.surroundings, FIRST + APART * np.arange(3) + 0.5
    gravity = surroundings.gravity
    force = drive[:, :, None] * grid.waveform(along) + gravity * up[:, :, None]
    still = np.zeros_like(force)
    source = np.array([2.0 * share * level(clean.physics, f) for f, share in zip(FREQUENCIES, LEVELS, strict=True)])
    return Motion(
        grid, "shaker", force, still, still.copy(), up, gravity, surroundings.temperature(middle),
        surroundings.supply(middle), middle - FIRST, along=along, drive=drive, side=side, source=source,
        scale=np.array(SCALES),
    )  # fmt: skip


def same(found: np.ndarray, expected: np.ndarray, relative: float) -> None:
    """Within a share of the largest change, which is there."""
    largest = float(np.max(np.abs(expected)))
    assert largest > 1e-7
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=relative * largest)


def test_the_model_of_a_clean_world_is_its_world() -> None:
    clean = still_shaken()
    channels, local, slots = recorder(clean.physics, SHAKER_CABLES, 1)
    found = volts(motion_of(clean), channels, local, [])
    np.testing.assert_allclose(
        found, clean.lines[slots], rtol=1e-5, atol=1e-6
    )  # the converter's second is not quite a second


@pytest.mark.parametrize("name", ON_SHAKER)
def test_on_the_shaker_both_change_the_same_volts(name: str) -> None:
    clean, twin = still_shaken(), twin_of(name, "shaker")
    there = Shaken(twin)
    channels, local, slots = recorder(clean.physics, SHAKER_CABLES, 1)
    before, term = clean.before[slots], term_of(twin)
    with_, without = (volts(motion_of(clean), channels, local, terms, before) for terms in ([term], []))
    lines = there.lines[slots]
    if name == "channel_skew":  # the reference is late by a slot too, and phases count from it
        harmonics = np.multiply.outer(FREQUENCIES, np.arange(ORDERS))
        lines = lines * np.exp(-2j * math.pi * harmonics * float(twin.stated(BEGUN)["extra"]))
    first = 1 if name in ABOUT_ZERO else 0
    same((lines - clean.lines[slots])[..., first:], (with_ - without)[..., first:], 5e-3)


@pytest.mark.parametrize("name", sorted(REFERENCE))
def test_both_change_what_the_vibrometer_shows(name: str) -> None:
    clean, twin = still_shaken(), twin_of(name, "shaker")
    shown, true = Shaken(twin).shown(), clean.shown()
    effect, term = effect_of(name), term_of(twin)
    harmonics = np.multiply.outer(FREQUENCIES, np.arange(ORDERS))
    found = effect.shaken(shown, harmonics, np.array(SCALES), term.at)
    same(shown - found, shown - true, 1e-3)


@pytest.mark.parametrize("bench", ["shaker", "turntable"])
def test_hum_has_its_phase_in_whole_seconds_of_the_bench_clock_in_both(bench: str) -> None:
    twin = twin_of("mains_hum", bench)
    term = term_of(twin)
    physics = [Quiet(1, MAINS, more) for more in ((twin,), ())]
    name = "unit_a_x" if bench == "shaker" else "gyro_yaw"
    for elapsed in (0.0, 7.3):
        times = [FIRST + elapsed + np.arange(round(SCAN)) / SCAN]
        with_, without = (one.volts([name], times)[0] for one in physics)
        for order in (1, 3):
            nominal = np.exp(-2j * math.pi * MAINS * order * (times[0] - BEGUN.second))
            (found,) = term.effect.at_mains(order, np.array([elapsed]), term.at)  # type: ignore[misc]
            assert found == pytest.approx(2.0 * np.mean((with_ - without) * nominal), rel=1e-6)


class Turned:
    """A run on the turntable without noise: at rest, up to 45 rpm, coasting; every 1/128 s, all at one instant."""

    RATE, SPANS = 128.0, ((4.0, 0.0), (20.0, 45.0), (12.0, 0.0))

    def __init__(self, *hidden: Imperfection) -> None:
        self.physics = physics = Quiet(1, MAINS, hidden)
        physics.put(on_turntable("yaw", False, 0.05, 0.3))
        now, times, found, motor = FIRST, [], [], []
        for seconds, rpm in self.SPANS:
            physics.platter.turn(now, rpm)
            here = now + np.arange(round(seconds * self.RATE)) / self.RATE
            found.append(np.array(physics.volts(TURNTABLE_CABLES, [here] * 16)))
            motor.append(np.full(len(here), float(physics.platter.driven)))
            times.append(here)
            now += seconds
        self.times, self.motor = np.concatenate(times), np.concatenate(motor)
        self.volts = np.concatenate(found, axis=1)

    def motion(self) -> Motion:
        """What the cube went through, about the upward axis; the platter turns clockwise."""
        physics, mount, count = self.physics, on_turntable("yaw", False, 0.05, 0.3), len(self.times)
        angle, rate, turning = physics.platter.motion(self.times)
        second, surroundings = physics.surroundings.second, physics.surroundings
        rate, turning = -rate * second, -turning * second**2
        outward, tangent, up = (np.repeat(mount.case_from_bench[:, [k]], count, axis=1) for k in range(3))
        gravity = surroundings.gravity
        force = gravity * up - 0.05 * rate**2 * outward + 0.05 * turning * tangent
        return Motion(
            Stretches(1.0 / self.RATE, ((0, count),)), "turntable", force, rate * up, turning * up, up, gravity,
            surroundings.temperature(self.times), surroundings.supply(self.times), self.times - FIRST,
            angle=-angle, motor=self.motor, outward=outward, tangent=tangent,
        )  # fmt: skip


@lru_cache
def still_turned() -> Turned:
    return Turned()


@pytest.mark.parametrize("name", ON_TURNTABLE)
def test_on_the_turntable_both_change_the_same_volts(name: str) -> None:
    clean, twin = still_turned(), twin_of(name, "turntable")
    there = Turned(twin)
    channels, local, slots = recorder(clean.physics, TURNTABLE_CABLES, 0)
    with_, without = (volts(clean.motion(), channels, local, more) for more in ([term_of(twin)], []))
    away = np.abs(clean.times[:, None] - (FIRST + np.array([0.0, 4.0, 24.0, 36.0]))).min(axis=1) > 0.15  # from jerks
    changed, expected = (there.volts - clean.volts)[slots][:, away], (with_ - without)[:, away]
    same(changed, expected, 0.03)
    assert np.linalg.norm(changed - expected) < 0.01 * np.linalg.norm(expected)


@pytest.mark.parametrize("name", sorted(DISK))
def test_both_disks_show_the_same_angle_too_much(name: str) -> None:
    twin, clockwise = twin_of(name, "turntable"), np.linspace(0.0, 6.0 * math.pi, 500)
    effect, term = effect_of(name), term_of(twin)
    same(effect.turned(-clockwise, term.at)[0], -(twin.graduation(clockwise) - clockwise), 1e-9)


def recorded(name: str, rate: float, seconds: float, twin: Imperfection) -> np.ndarray:
    """What one channel has more in a world with this in it, V."""
    times = [FIRST + np.arange(round(rate * seconds)) / rate]
    with_, without = (Quiet(1, MAINS, more).volts([name], times)[0] for more in ((twin,), ()))
    return np.asarray(with_ - without)


@pytest.mark.parametrize("name", ["spur", "aliasing"])
def test_a_line_has_the_amplitude_from_zero_to_peak_and_the_frequency_that_are_stated(name: str) -> None:
    twin = twin_of(name, "shaker")
    said = twin.stated(BEGUN)
    shown = abs(said["frequency"] - SCAN * round(said["frequency"] / SCAN))  # |f − k·f_sampling|
    more = recorded("unit_a_x", SCAN, 8.0, twin)
    turned = np.exp(-2j * math.pi * shown * np.arange(len(more)) / SCAN)
    unit = Quiet(1, MAINS, ()).channels["unit_a_x"].sensitivity if name == "spur" else 1.0
    assert 2.0 * abs(np.mean(more * turned)) / unit == pytest.approx(said["amplitude"], rel=0.01)
    assert np.sqrt(2.0) * more.std() / unit == pytest.approx(said["amplitude"], rel=0.01)
    assert {one.unit for one in effect_of(name).parameters} == {"V" if name == "aliasing" else "SI", "Hz"}


def test_a_frequency_is_found_higher_by_the_error_of_the_clock() -> None:
    twin = twin_of("clock_ratio", "shaker")
    physics = Quiet(1, MAINS, (twin,))
    physics.put(on_shaker("x"))
    physics.source.clock = 0.0
    physics.set_source(FIRST - 2.0, 400.0, 0.2, True, 0.0, True)
    found = physics.volts(["ldv"], [FIRST + np.arange(3_000) / SCAN])[0]
    turned = found * np.exp(-2j * math.pi * 400.0 * np.arange(3_000) / SCAN)
    first, second = (np.mean(half) for half in np.split(turned, 2))
    error = float(np.angle(second / first)) / (2.0 * math.pi * 400.0 * 1500.0 / SCAN)
    assert error == pytest.approx(twin.stated(BEGUN)["error"], rel=1e-3)  # f_found = f_set·(1 + error)


def test_steps_are_as_far_apart_as_stated() -> None:
    twin = twin_of("quantisation", "shaker")
    physics = Quiet(1, MAINS, (twin,))
    physics.put(on_shaker("x"))
    physics.set_source(FIRST - 2.0, 110.0, 0.2, True, 0.0, True)
    found = np.unique(physics.volts(["unit_a_x"], [FIRST + np.arange(3125) / SCAN])[0])
    assert np.diff(found).min() == pytest.approx(twin.stated(BEGUN)["step"], rel=1e-6)


def test_light_is_lost_for_the_share_of_time_and_to_the_depth_stated() -> None:
    twin = twin_of("ldv_dropout", "shaker")
    said, results = twin.stated(BEGUN), []
    for more in ((twin,), ()):
        physics = Quiet(1, MAINS, more)
        physics.put(on_shaker("x"))
        physics.vibrometer.level, physics.vibrometer.scale = 36.0, 0.005
        physics.set_source(FIRST - 2.0, 110.0, 0.2, True, 0.0, True)
        results.append(physics.volts(["ldv"], [FIRST + np.arange(312_500) / SCAN])[0])
    lost = np.abs(results[1]) > 1e-3
    ratio = results[0][lost] / results[1][lost]
    assert np.mean(ratio < 1.0 - 1e-6) == pytest.approx(said["share"], rel=0.15)
    assert ratio.min() == pytest.approx(1.0 - said["depth"], abs=1e-9)


def test_a_graduation_has_the_rms_stated_at_its_marks() -> None:
    twin, marks = twin_of("encoder_graduation", "turntable"), 2.0 * math.pi * np.arange(0, 1000, 10) / 1000.0
    beside = twin.graduation(marks) - marks
    assert np.sqrt(np.mean(beside**2)) == pytest.approx(twin.stated(BEGUN)["rms"], rel=0.2)  # of 100 marks


def test_lines_are_missed_at_the_share_stated() -> None:
    twin, channel = twin_of("missed_counts", "turntable"), Quiet(1, MAINS, ()).channels["encoder_a"]
    phase = np.arange(300_000) + 0.25
    high = twin.logic(channel, np.ones(len(phase), np.bool_), phase)
    assert 1.0 - np.mean(high) == pytest.approx(twin.stated(BEGUN)["share"], rel=0.2)


@pytest.mark.parametrize(
    ("name", "parameter", "unit"),
    [("white", "density", "(SI)/√Hz"), ("flicker", "level", "SI"), ("random_walk", "coefficient", "SI/√s")],
)
def test_noise_is_stated_by_one_sided_densities(name: str, parameter: str, unit: str) -> None:
    """The world's own densities are measured in its tests; here both say the same of the same numbers."""
    twin, effect = twin_of(name, "shaker"), effect_of(name)
    size, channel = twin.stated(BEGUN)[parameter], Quiet(1, MAINS, ()).channels["unit_a_x"]
    f = np.array([0.1, 1.0, 5.0])
    laws = {
        "white": size**2 + 0.0 * f, "flicker": size**2 / f, "random_walk": 2.0 * size**2 / (2.0 * math.pi * f) ** 2,
    }  # fmt: skip
    assert (effect.parameters[0].name, effect.parameters[0].unit) == (parameter, unit)
    assert "one-sided" in effect.equation
    assert np.asarray(twin.spectrum(channel, f)) / channel.sensitivity**2 == pytest.approx(laws[name], rel=0.06)


@pytest.mark.parametrize("name", SHELF.names)
def test_every_parameter_of_an_effect_is_stated_by_its_twin(name: str) -> None:
    said = twin_of(name, SHELF.kind(name).benches[0]).stated(BEGUN)
    effect = effect_of(name)
    missing = {one.name for one in effect.parameters} - set(said)
    assert not missing
    again: Values = effect.physical(effect.from_physical({one.name: said[one.name] for one in effect.parameters}))
    assert again == pytest.approx({one.name: said[one.name] for one in effect.parameters}, rel=1e-9, abs=1e-12)


def test_every_pair_is_held_together_somewhere_above() -> None:
    held = {*ON_SHAKER, *ON_TURNTABLE, *REFERENCE, *DISK, *LOOKED_AT, "mains_hum"}
    assert held == set(SHELF.names)
