"""A case on an arm that turns: accelerometers feel the radius, gravity lies as stated, stamps are where they belong."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import imported_worlds as worlds
import numpy as np
import pytest
from imported_worlds import G, Unit, evidence, motion, rotation, with_lines

from rig.fit import adequacy
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.foreign.tables import Foreign, Table
from rig.parts.track import TrackedMotion
from rig.shelf import effect_of, nothing_of

RADIUS, GAIN = 0.3, 1.02
NAMES = ("t", "angle", "gyro_z", "acc_x", "acc_y", "acc_z")
Array = worlds.Array


def swung(
    toward: float = 0.0, *, axis: str = "z", upright: bool = True, lies: float = 0.4, down: Array | None = None,
    held: bool = False, segments: tuple[dict[str, Any], ...] = (), seed: int = 1, **stated: Any,
) -> Foreign:  # fmt: skip
    """120 s of a case at RADIUS from the axis, `toward` (rad) the direction outward in the plane across the axis; x
    reads GAIN too much. `down` (n,) says where it stood on its head; `held` at rest for the first 20 s.
    """  # fmt: skip
    random, k = np.random.default_rng(seed), "xyz".index(axis)
    t = np.arange(0.0, 120.0, 0.01)
    since = np.clip(t - 20.0, 0.0, None) if held else t
    angle = 1.1 * since + 1.5 * np.sin(0.9 * since) - 1.5 * 0.9 * since * held
    rate = (1.1 + 1.35 * np.cos(0.9 * since) - 1.35 * held) * (since > 0.0)
    turning = -1.215 * np.sin(0.9 * since)
    beside = RADIUS * (-(rate**2) + 1j * turning) * np.exp(1j * toward)
    if not upright:
        beside = beside + G * np.exp(-1j * (angle - lies))
    force = np.zeros((3, len(t)))
    force[(k + 1) % 3], force[(k + 2) % 3] = beside.real, beside.imag
    force[k] = G * upright * np.where(np.zeros(len(t), bool) if down is None else down, -1.0, 1.0)
    noise = random.normal(size=(5, len(t)))
    shown = force * np.array([[GAIN], [1.0], [1.0]]) + 0.02 * noise[:3]
    columns = [
        {"column": "angle", "quantity": "angle", "unit": "rad", "role": "reference"},
        {"column": f"gyro_{axis}", "name": "gyro_z", "quantity": "rate", "unit": "rad/s", "axis": axis},
        *({"column": f"acc_{a}", "quantity": "acceleration", "unit": "m/s²", "axis": a} for a in "xyz"),
    ]
    made = worlds.manifest(
        "rotation", columns, [{"path": "log.csv"}], time={"column": "t", "unit": "s"}, segments=list(segments),
        rotation={"axis": axis, "upright": upright, "sense": 1, **stated},
        compared={"rate_band": "2 Hz", "force_band": "2 Hz"},
    )  # fmt: skip
    values = np.column_stack([t, angle + 1e-4 * noise[3], rate + 2e-3 * noise[4], *shown])
    return Foreign("made", made, (Table("log", (*NAMES[:2], f"gyro_{axis}", *NAMES[3:]), values, {}, False),), ())


def part_of(made: Evidence) -> TrackedMotion:
    (part,) = made.parts
    assert isinstance(part, TrackedMotion)
    return part


def gain(found: Fit, channel: str = "acc_x") -> tuple[float, float]:
    place = found.layout.gains[channel]
    return 1.0 + found.state.gain[channel], float(np.sqrt(found.covariance[place, place]))


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize(("toward", "outward"), [(0.0, "+x"), (-math.pi / 2.0, "-y"), (2.2, None)])
def test_accelerometers_beside_the_axis_are_calibrated_by_radius_and_rate(
    toward: float, outward: str | None, upright: bool
) -> None:
    stated = {"radius": "300 mm", **({"outward": outward} if outward else {})}
    made = evidence(swung(toward, upright=upright, **stated))
    found = made.fitted()
    assert adequacy.adequate(found)
    value, u = gain(found)
    assert abs(value - GAIN) < max(4.0 * u, 2e-3)
    assert any("outward is 126°" in note for note in made.notes) == (outward is None)


def test_without_a_radius_they_show_that_one_is_missing() -> None:
    made = evidence(swung())
    assert not adequacy.adequate(made.fitted())
    assert adequacy.adequate(made.fitted([nothing_of(effect_of("lever_arm"), "acceleration")]))


def test_a_sensitivity_goes_with_the_radius_and_is_as_uncertain() -> None:
    right = gain(evidence(swung(radius="300 mm", outward="+x")).fitted())
    short = gain(evidence(swung(radius="291 mm", outward="+x")).fitted())
    unsure = gain(evidence(swung(radius="300 mm", outward="+x", radius_uncertainty="6 mm")).fitted())
    assert short[0] / right[0] == pytest.approx(300.0 / 291.0, rel=2e-3)
    assert right[1] < 2e-3
    assert unsure[1] == pytest.approx(0.02, rel=0.1)


def test_a_wrong_statement_of_the_direction_does_not_fit() -> None:
    assert not adequacy.adequate(evidence(swung(0.0, radius="300 mm", outward="-y")).fitted())


def test_a_case_that_stood_on_its_head_for_some_rows_feels_gravity_so() -> None:
    head = np.arange(12000) >= 6000
    said = ({"first": 0, "last": 6000, "up": "+z"}, {"first": 6000, "last": 12000, "up": "-z"})
    data = swung(radius="300 mm", outward="+x", down=head, segments=said)
    part = part_of(evidence(data))
    late = part.data.time > 61.0
    assert (part.reference.force[2, late] == -G).all()
    assert (part.reference.force[2, part.data.time < 59.0] == G).all()
    assert not any("up" in note for note in evidence(data).notes)
    wrong = evidence(swung(radius="300 mm", outward="+x", segments=({"first": 0, "last": 12000, "up": "-z"},)))
    assert any("acc_z shows 9.81 m/s² while the manifest has -z up" in note for note in wrong.notes)


def test_gyros_alone_are_told_by_the_statement_how_gravity_lies() -> None:
    def upright(*said: dict[str, Any]) -> Array:
        data = swung(segments=said)
        gyros = [one for one in data.manifest.columns if one.quantity != "acceleration"]
        return part_of(
            evidence(replace(data, manifest=data.manifest.model_copy(update={"columns": gyros})))
        ).data.upright

    assert (upright() == 1.0).all()
    assert (upright({"first": 0, "last": 12000, "up": "-z"}) == -1.0).all()


@pytest.mark.parametrize(("up", "lies"), [("+x", 0.0), ("-x", math.pi), ("+y", math.pi / 2.0)])
def test_the_axis_that_is_up_while_a_level_shaft_rests_says_where_gravity_lies(up: str, lies: float) -> None:
    data = swung(upright=False, held=True, lies=lies, segments=({"first": 100, "last": 1900, "up": up},))
    gyros = [one for one in data.manifest.columns if one.quantity != "acceleration"]
    for columns in (data.manifest.columns, gyros):
        part = part_of(evidence(replace(data, manifest=data.manifest.model_copy(update={"columns": columns}))))
        assert abs(math.remainder(part.data.phase - lies, 2.0 * math.pi)) < 0.01


def delayed(foreign: Foreign, quantities: tuple[str, ...], delay: float) -> Foreign:
    columns = [
        one.model_copy(update={"delay": delay}) if one.quantity in quantities else one
        for one in foreign.manifest.columns
    ]
    return replace(foreign, manifest=foreign.manifest.model_copy(update={"columns": columns}))


def late(foreign: Foreign) -> float:
    found = evidence(foreign).fitted([nothing_of(effect_of("delay"), "rate")])
    return found.state.terms[-1].at["time"]


@pytest.mark.parametrize("kind", ["angle", "lines", "cameras"])
def test_a_reference_that_was_sampled_later_than_its_rows_say_is_moved(kind: str) -> None:
    unit = Unit(rate_delay=8e-3)
    data, quantities = {
        "angle": lambda: (rotation(unit, channels="r", seconds=40.0), ("angle",)),
        "lines": lambda: (with_lines(rotation(unit, channels="r", steps=0.0, jitter=0.0, doubled=0.0, rows=2000.0,
                                              seconds=20.0), 256), ("line_a", "line_b", "index_line")),
        "cameras": lambda: (motion(unit, channels="r", seconds=20.0), ("position", "quaternion")),
    }[kind]()  # fmt: skip
    assert late(delayed(data, quantities, 3e-3)) - late(data) == pytest.approx(-3e-3, abs=3e-4)
