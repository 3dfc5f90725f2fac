"""A triad whose axes are permuted or mirrored is said to be so, and no physical effect is blamed for it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import imported_worlds as worlds
import numpy as np
import pytest
from imported_worlds import Unit, clean, evidence, manifest, motion, rotation
from numpy.typing import NDArray

from rig.cli.repair import verdict_text
from rig.diagnose.conclusion import conclude
from rig.diagnose.diagnose import diagnose
from rig.foreign.checks import findings
from rig.foreign.finding import Finding
from rig.foreign.frames import findings as frames_of
from rig.foreign.frames import mended, other_reading, seen_in, triads
from rig.foreign.tables import Foreign, Table
from rig.parts.reading.imported import parts_of
from rig.shelf import shelf

Array = NDArray[np.float64]
TRIADS = {"rate": ("gyro_x", "gyro_y", "gyro_z"), "acceleration": ("acc_x", "acc_y", "acc_z")}
WAYS = [
    np.diag(signs)[:, list(order)]
    for order in itertools.permutations(range(3)) for signs in itertools.product((1.0, -1.0), repeat=3)
]  # fmt: skip
MIRRORED, CYCLED = np.diag([1.0, -1.0, 1.0]), np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def mounted(made: Foreign, quantity: str, way: Array) -> Foreign:
    """The same with a triad of which channel k shows what `way` (3, 3) makes of what it should."""
    (table,) = made.tables
    values, at = table.values.copy(), [table.names.index(name) for name in TRIADS[quantity]]
    values[:, at] = values[:, at] @ way.T
    return replace(made, tables=(replace(table, values=values),))


def frames(made: Foreign) -> list[Finding]:
    (table,) = made.tables
    return list(frames_of(made, table))


def restated(made: Foreign, quantity: Any, way: Array) -> Foreign:
    """With what a finding advises written into the manifest."""
    (triad,) = triads(made.manifest, quantity)
    advice = (said.removesuffix("`").split(" `") for said in mended(triad, way).split("; ") if said)
    changed = {name: dict(key.split(": ") for key in keys.split(", ")) for name, keys in advice}
    columns = [one.model_copy(update=changed.get(one.channel, {})) for one in made.manifest.columns]
    return replace(made, manifest=made.manifest.model_copy(update={"columns": columns}))


@pytest.fixture(scope="module")
def track() -> Foreign:
    return motion(clean(4), 4, seconds=12.0, rows=100.0)


def told(made: Foreign, quantity: str) -> list[Array]:
    """Of all signed permutations those that are found, if the triad has that."""
    (table,) = made.tables
    (seen,) = (one for one in seen_in(made, table) if one.triad[0].quantity == quantity)
    return [way for way in WAYS if other_reading(replace(seen, shown=seen.shown @ way.T)) is not None]


@pytest.mark.parametrize("quantity", TRIADS)
def test_every_signed_permutation_of_free_motion_is_found(track: Foreign, quantity: str) -> None:
    assert len(told(track, quantity)) == len(WAYS) - 1


@pytest.mark.parametrize(("quantity", "way"), [("rate", MIRRORED), ("rate", CYCLED), ("acceleration", WAYS[30])])
def test_what_is_advised_mends_it(track: Foreign, quantity: str, way: Array) -> None:
    wrong = mounted(track, quantity, way)
    (found,) = frames(wrong)
    assert ("left-handed" in found.text) == (np.linalg.det(way) < 0.0)
    assert frames(restated(wrong, quantity, way)) == []


@pytest.mark.parametrize(
    ("stated", "upright", "quantity", "count"),
    [
        (None, True, "rate", 32),  # the axis that turns; its sign is the encoder's
        (1, True, "rate", 40),
        (1, True, "acceleration", 32),  # the axis that is plumb, either way up
        (1, False, "acceleration", 40),  # all but how gravity lies at angle zero, four ways along and two of the axis
    ],
)
def test_of_a_rotation_all_is_found_that_its_motion_can_tell(
    stated: int | None, upright: bool, quantity: str, count: int
) -> None:
    made = rotation(clean(5), 5, seconds=15.0, stated=stated, upright=upright)
    assert len(told(made, quantity)) == count


def test_words_say_which_channel_shows_what_how_much_better_that_is_and_what_to_write(track: Foreign) -> None:
    (found,) = frames(mounted(track, "rate", CYCLED))
    assert "gyro_x shows +z, gyro_y shows −x, gyro_z shows +y (a left-handed triad); so read 0.0" in found.text
    assert "times as much; in the manifest: gyro_x `axis: z`" in found.text
    assert "gyro_y `axis: x, sensitivity: -1 rad/s per rad/s`; gyro_z `axis: y`" in found.text
    assert (found.channel, found.misread) == ("gyro_x", True)


def far_off(seed: int) -> Unit:
    """A right device at its worst: 20° askew, a tenth off, with large zeros, much noise and 0.1 s behind."""
    random = np.random.default_rng(seed)
    tilt = random.normal(size=3)
    gains, zeros = 1.0 + 0.1 * random.normal(size=(2, 3)), random.normal(size=(2, 3))
    return Unit(
        rate_gain=gains[0].tolist(), force_gain=gains[1].tolist(), rate_zero=(0.3 * zeros[0]).tolist(),
        force_zero=(0.8 * zeros[1]).tolist(), rate_delay=0.1, force_delay=0.06,
        tilt=(math.radians(20.0) * tilt / np.linalg.norm(tilt)).tolist(), rate_noise=0.2, force_noise=1.0,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "made",
    [
        lambda unit, seed: motion(unit, seed, seconds=12.0, rows=100.0),
        lambda unit, seed: rotation(unit, seed, seconds=12.0, stated=1),
        lambda unit, seed: rotation(unit, seed, seconds=12.0, upright=False, axis="xyz"[seed % 3]),
    ],
)
def test_a_frame_that_is_askew_is_no_other_frame(made: Callable[[Unit, int], Foreign], seed: int) -> None:
    assert frames(made(far_off(seed), seed)) == []


def test_where_a_body_hardly_turns_the_track_s_up_may_be_wrong_as_well(track: Foreign) -> None:
    (table,) = track.tables
    values, random = table.values.copy(), np.random.default_rng(2)
    for name, level in {"qw": 1.0, "acc_z": 9.81}.items():
        values[:, table.names.index(name)] = level
    for name in ("qx", "qy", "qz", "px", "py", "pz", "acc_x", "acc_y"):
        values[:, table.names.index(name)] = 0.0
    force = [table.names.index(name) for name in TRIADS["acceleration"]]
    values[:, force] += 0.02 * random.normal(size=(len(values), 3))
    assert track.manifest.pose is not None
    wrong = track.manifest.model_copy(update={"pose": track.manifest.pose.model_copy(update={"up": "x"})})
    (found,) = frames(replace(track, manifest=wrong, tables=(replace(table, values=values),)))
    assert "acc_x shows +z" not in found.text.split("in the manifest")[1]
    assert "acc_z shows +x" in found.text
    assert "`pose: {up: z}` would do as well" in found.text
    assert "`pose: {up: y}`" not in found.text


def test_poses_that_say_what_is_up_and_turns_by_known_angles_tell_axes() -> None:
    made = faces()
    assert frames(made) == []
    for quantity, way in (("acceleration", MIRRORED), ("acceleration", CYCLED), ("rate", CYCLED)):
        (found,) = frames(mounted(made, quantity, way))
        assert found.channel in TRIADS[quantity]


def faces() -> Foreign:
    """Six faces up, a second each, and three turns by a right angle in a second."""
    random, columns = np.random.default_rng(3), worlds.device_columns()
    values, segments = random.normal(size=(900, 6)) * ([2e-3] * 3 + [0.02] * 3), []
    for k, (axis, sign) in enumerate(itertools.product(range(3), "+-")):
        values[100 * k : 100 * (k + 1), 3 + axis] += float(f"{sign}9.81")
        segments.append({"first": 100 * k, "last": 100 * (k + 1), "up": f"{sign}{'xyz'[axis]}"})
    for axis in range(3):
        first = 600 + 100 * axis
        values[first : first + 100, axis] += math.pi / 2.0
        segments.append({"first": first, "last": first + 100, "turn": "xyz"[axis], "angle": "90 °"})
    made = manifest("poses", columns, [{"path": "p.csv"}], time={"rate": "100 Hz"}, segments=segments)
    return Foreign("made", made, (Table("poses", worlds.SHOWN, values, {}, False),), ())


@pytest.mark.parametrize(
    ("quantity", "upright", "blamed"), [("rate", True, "cross_axis_matrix"), ("acceleration", False, "cross_axis")]
)
def test_no_effect_is_blamed_for_axes_that_are_others(quantity: str, upright: bool, blamed: str) -> None:
    wrong = mounted(rotation(clean(5), 5, seconds=40.0, stated=1, rest=8.0, upright=upright), quantity, CYCLED)
    assert diagnose(evidence(wrong)).named == (blamed,)  # what happens to who is not told
    told = replace(wrong, found=tuple(findings(wrong)))
    assert "frame" in [one.kind for one in told.found]
    said = conclude(evidence(told), (), shelf())
    assert (said.verdict, said.candidates) == ("undecided", ())
    assert "axes are not those of the manifest, so no effect was looked for" in verdict_text(said)


def test_who_has_looked_at_the_axes_and_stands_by_them_gets_a_diagnosis(track: Foreign) -> None:
    wrong = mounted(track, "rate", MIRRORED)
    columns = [
        one.model_copy(update={"findings": "accepted"}) if one.column == "gyro_y" else one
        for one in track.manifest.columns
    ]
    accepted = replace(wrong, manifest=wrong.manifest.model_copy(update={"columns": columns}))
    (found,) = frames(accepted)
    parts, _ = parts_of(replace(accepted, found=(found,)))
    assert not any(one.misread for part in parts for one in part.faults)
