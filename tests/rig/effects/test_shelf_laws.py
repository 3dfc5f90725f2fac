"""What every effect of the shelf keeps to: described in full, its numbers agree, and at nothing it does nothing."""

from __future__ import annotations

import importlib
import itertools
import pkgutil
from dataclasses import replace

import numpy as np
import pytest

from rig import effects
from rig.model import Channels, Effect, Local, Memory, Motion, Periods, Quantity, Stretches, Term, volts

NAMES = sorted(module.name for module in pkgutil.iter_modules(effects.__path__))
WHOLE_SHELF = 45  # from so many files on, every name that an effect mentions has its file


def effect_of(name: str) -> Effect:
    """The one effect that a file defines, with the file's name."""
    module = importlib.import_module(f"rig.effects.{name}")
    found = [
        one
        for one in vars(module).values()
        if isinstance(one, type) and issubclass(one, Effect) and one.__module__ == module.__name__
    ]
    assert len(found) == 1, f"rig/effects/{name}.py: found {len(found)} effects, wanted one"
    effect = found[0]()
    type(effect).name = name
    return effect


def nothing(effect: Effect) -> dict[str, float]:
    """Coordinates at zero; those that cannot be zero, at their first start."""
    return {c.name: 0.0 if 0.0 in c.starts else c.starts[0] for c in effect.coordinates}


def shaken() -> Motion:
    """Three sines along x in two ranges of the vibrometer, up along z, while room and supply change."""
    grid = Periods(np.array([20.0, 110.0, 480.0]))
    along = np.zeros((3, 6), np.complex128)
    along[:, 1], along[:, 2] = [3.0 + 1.0j, 9.0, -2.0j], 0.02
    x, z = np.eye(3)[0][:, None], np.eye(3)[2][:, None]
    force = x[:, :, None] * grid.waveform(along) + 9.81 * z[:, :, None]
    still = np.zeros_like(force)
    return Motion(
        grid, "shaker", force, still, still.copy(), np.repeat(z, 3, 1), 9.81, np.array([24.0, 27.0, 30.0]),
        np.array([4.9, 5.0, 5.1]), np.array([0.0, 40.0, 80.0]), along=along, drive=np.repeat(x, 3, 1),
        side=np.repeat(np.eye(3)[1][:, None], 3, 1), source=np.array([0.1, 0.4, 0.9]),
        scale=np.array([0.125, 0.125, 0.025]),
    )  # fmt: skip


def turned() -> Motion:
    """Two records of 100 instants each, up along y; the platter gains speed, then keeps it."""
    grid, t = Stretches(0.01, ((0, 100), (100, 200))), np.linspace(0.0, 1.99, 200)
    up, rate = np.repeat(np.eye(3)[1][:, None], 200, 1), np.minimum(3.0 * t, 3.0)
    angle = 0.01 * np.cumsum(rate)
    outward, tangent = np.repeat(np.eye(3)[2][:, None], 200, 1), np.repeat(np.eye(3)[0][:, None], 200, 1)
    turning = np.where(t < 1.0, 3.0, 0.0)
    force = 9.81 * up - 0.1 * rate**2 * outward + 0.1 * turning * tangent
    return Motion(
        grid, "turntable", force, rate * up, turning * up, up, 9.81, 25.0 + t, 5.0 + 0.01 * t, t,
        angle=angle, motor=(t < 1.5).astype(np.float64), outward=outward, tangent=tangent,
    )  # fmt: skip


def rotated() -> Motion:
    """The same turn on somebody else's rotation stage."""
    return replace(turned(), place="rotation")


def moved() -> Motion:
    """The same motion without a platter."""
    nothing, nowhere = np.zeros(0), np.zeros((3, 0))
    return replace(turned(), place="free", angle=nothing, motor=nothing, outward=nowhere, tangent=nowhere)


def posed() -> Motion:
    """Six faces up, one after the other."""
    up = np.concatenate([np.eye(3), -np.eye(3)], axis=1)
    still, t = np.zeros((3, 6)), 20.0 * np.arange(6)
    grid = Stretches(20.0, ((0, 6),))
    return Motion(grid, "poses", 9.81 * up, still, still.copy(), up, 9.81, 25.0 + t / 60.0, 5.0 + 1e-3 * t, t)


MOTIONS = {"shaker": shaken, "turntable": turned, "rotation": rotated, "free": moved, "poses": posed}


def recorder() -> tuple[Channels, Local]:
    """Three accelerometers and three gyros of one unit on six slots; where the last gyro sits is not stated."""
    rates, axis = np.repeat([False, True], 3), np.tile(np.arange(3), 2)
    sensitivity, side = np.where(rates, 0.2, 0.07), np.array([0.01, 0.0, -0.01, 0.02, 0.0, np.nan])
    channels = Channels(
        ("ax", "ay", "az", "gx", "gy", "gz"), rates, axis, np.arange(6), side,
        sensitivity, np.full(6, 0.1), np.where(rates, 150.0, 1600.0), ("unit",) * 6,
    )  # fmt: skip
    return channels, Local(1.02 * sensitivity, np.where(rates, 150.0, 1600.0), np.full(6, 2.5))


def admissible(effect: Effect, seed: int) -> dict[str, float]:
    """Parameters drawn from their usual sizes."""
    draw = np.random.default_rng(seed)
    return {p.name: float(draw.uniform(*p.typical)) for p in effect.parameters}


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_says_what_it_is(name: str) -> None:
    effect = effect_of(name)
    assert type(effect).__name__ == "".join(word.capitalize() for word in name.split("_"))
    for word in ("stage", "title", "equation", "missing", "separate_by", "source"):
        assert getattr(effect, word).strip(), f"rig/effects/{name}.py: found no {word}"
    assert importlib.import_module(type(effect).__module__).__doc__
    assert effect.places
    assert set(effect.places) <= set(MOTIONS)


@pytest.mark.parametrize("name", NAMES)
def test_steps_are_above_zero_and_usual_sizes_lie_within_ordered_limits(name: str) -> None:
    effect = effect_of(name)
    assert all(c.step > 0.0 and c.starts for c in effect.coordinates)
    for p in effect.parameters:
        (low, high), (least, most) = p.bounds, p.typical
        assert low < high, f"{name}.{p.name}: found limits {p.bounds}"
        assert low <= least <= most <= high, f"{name}.{p.name}: found usual {p.typical} outside {p.bounds}"
    for names in ([c.name for c in effect.coordinates], [p.name for p in effect.parameters]):
        assert len(set(names)) == len(names)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", NAMES)
def test_parameters_and_coordinates_are_two_ways_to_say_one_thing(name: str, seed: int) -> None:
    effect = effect_of(name)
    at = effect.from_physical(admissible(effect, seed))
    assert set(at) == {c.name for c in effect.coordinates}
    values = effect.physical(at)
    assert set(values) == {p.name for p in effect.parameters}
    assert effect.from_physical(values) == pytest.approx(at, rel=1e-9, abs=1e-12)
    assert len(effect.units(effect.quantities[0] if effect.quantities else None)) == len(effect.parameters)


@pytest.mark.parametrize("name", NAMES)
def test_a_fit_starts_with_every_coordinate_named(name: str) -> None:
    effect = effect_of(name)
    for place in effect.places:
        starts = effect.starts(MOTIONS[place](), next(iter(effect.quantities), None))
        assert starts or name in ("saturation", "one_sided_saturation")  # nothing swings to saturate there
        assert all(set(start) == {c.name for c in effect.coordinates} for start in starts)


@pytest.mark.parametrize("name", NAMES)
def test_effects_confused_with_it_are_on_the_shelf(name: str) -> None:
    if len(NAMES) < WHOLE_SHELF:
        pytest.skip(f"the shelf has {len(NAMES)} files of at least {WHOLE_SHELF}")
    others = effect_of(name).confused_with
    assert [other for other in others if other not in NAMES or other == name] == []


@pytest.mark.parametrize(
    ("name", "place", "on"),
    [(n, place, on) for n in NAMES for place in effect_of(n).places for on in effect_of(n).quantities or (None,)],
)
def test_at_nothing_an_effect_changes_no_volts(name: str, place: str, on: Quantity | None) -> None:
    effect, motion, (channels, local) = effect_of(name), MOTIONS[place](), recorder()
    without = volts(motion, channels, local, [])
    before = np.roll(without, 1, axis=0)
    found = volts(motion, channels, local, [Term(effect, on, nothing(effect))], before)
    np.testing.assert_allclose(found, without, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_signals_that_are_remembered_are_those_that_would_be_made(name: str) -> None:
    """One memory for models that differ in one thing after the other; what it keeps may depend on nothing else."""
    effect, (channels, local) = effect_of(name), recorder()
    at = effect.from_physical(admissible(effect, 1))
    other = replace(local, pole=0.5 * local.pole), replace(local, sensitivity=2.0 * local.sensitivity)
    for place, on in itertools.product(effect.places, effect.quantities or (None,)):
        motion, memory = MOTIONS[place](), Memory()
        one = channels.names[channels.of(on)[0]]
        made = [Term(effect, on, at), Term(effect, on, nothing(effect)), Term(effect, on, at, only=(one,))]
        for terms in ([], *([term] for term in made), made[:1]):
            for here in (local, *other):
                fresh = volts(motion, channels, here, terms, np.zeros_like(volts(motion, channels, here, [])))
                kept = volts(motion, channels, here, terms, np.zeros_like(fresh), memory)
                np.testing.assert_array_equal(kept, fresh)


@pytest.mark.parametrize("name", NAMES)
def test_at_nothing_an_effect_leaves_reference_response_and_mains_alone(name: str) -> None:
    effect, motion = effect_of(name), shaken()
    at, frequency = nothing(effect), motion.grid.harmonics if isinstance(motion.grid, Periods) else np.zeros((0, 6))
    true = effect.shaken(motion.along, frequency, motion.scale, at)
    np.testing.assert_allclose(true, motion.along, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(effect.turned(np.linspace(0.0, 12.0, 50), at), np.zeros((3, 50)), atol=1e-12)
    np.testing.assert_allclose(effect.response(frequency, at), np.ones_like(frequency), rtol=1e-9)
    mains = [effect.at_mains(order, np.arange(4.0), at) for order in (1, 2, 3)]
    assert all(phasors is None or not np.any(phasors) for phasors in mains)


def test_the_shelf_has_no_two_effects_of_one_title() -> None:
    titles = [effect_of(name).title for name in NAMES]
    assert len(set(titles)) == len(titles)
