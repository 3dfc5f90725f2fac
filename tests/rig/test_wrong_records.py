"""Small wrong records of every kind: what is said names the record and what was wanted; nothing ends in a traceback."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import fast_bench
import imported_worlds as worlds
import numpy as np
import pytest
from imported_worlds import STATED, Sensor, Unit, response, response_table

from rig.errors import BadInput
from rig.fit.evidence import evidence_of
from rig.foreign.manifest import Compared, Manifest
from rig.foreign.tables import Foreign, Table
from rig.motion import Array
from rig.parts.reading.rest import at_rest

Change = Callable[[Array], Array]


def with_table(foreign: Foreign, change: Change) -> Foreign:
    """The same run with its first table changed."""
    first = foreign.tables[0]
    return replace(foreign, tables=(replace(first, values=change(first.values.copy())), *foreign.tables[1:]))


def with_column(name: str, value: Any, row: int | slice = slice(None)) -> Callable[[Foreign], Foreign]:
    def changed(foreign: Foreign) -> Foreign:
        at = foreign.tables[0].names.index(name)

        def put(values: Array) -> Array:
            values[row, at] = value
            return values

        return with_table(foreign, put)

    return changed


def standing_clock(foreign: Foreign) -> Foreign:
    return with_column("t", 0.0)(foreign)


def table() -> Foreign:
    return response([response_table(Sensor().phasor, frequency=np.geomspace(10.0, 200.0, 5))])


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("excitation", 0.0, r"made table 0, row 4, excitation: found 0, wanted more than nought"),
        ("magnitude", 0.0, r"row 4, magnitude: found 0"),
        ("frequency", 0.0, r"row 4, frequency: found 0"),
        ("frequency", -5.0, r"row 4, frequency: found -5"),
        ("magnitude", np.nan, r"found rows that are no numbers, wanted a response in every row"),
        ("phase", np.inf, r"found rows that are no numbers"),
        ("u_magnitude", np.nan, r"found uncertainties that are no numbers, wanted one in every row"),
    ],
)
def test_a_response_without_a_number_is_named_by_its_row(name: str, value: float, said: str) -> None:
    with pytest.raises(BadInput, match=said), np.errstate(all="ignore"):
        worlds.evidence(with_column(name, value, 3)(table()))
    assert name in STATED


def test_rows_that_no_model_can_be_compared_with_are_named_before_a_fit() -> None:
    evidence = worlds.evidence(table())
    part = evidence.parts[0]
    part.target[2] = np.nan
    with pytest.raises(BadInput, match=r"made#0: found 1 of \d+ rows that a model cannot be compared with"):
        evidence.fitted()


def turned(**how: Any) -> Foreign:
    return worlds.rotation(Unit(), seconds=20.0, **how)


def moved(**how: Any) -> Foreign:
    return worlds.motion(Unit(), seconds=10.0, rows=100.0, gaps=0, **how)


@pytest.mark.parametrize("made", [turned, moved])
def test_a_clock_that_stands_still_is_said(made: Callable[[], Foreign]) -> None:
    with pytest.raises(BadInput, match=r"time: found stamps that do not go forward, wanted each later"):
        worlds.evidence(standing_clock(made()))


def test_a_track_that_its_manifest_does_not_explain_is_said() -> None:
    made = moved()
    bare = replace(made, manifest=made.manifest.model_copy(update={"pose": None}))
    with pytest.raises(BadInput, match="found no pose in its manifest, wanted it to say how the quaternion turns"):
        worlds.evidence(bare)
    columns = [one for one in made.manifest.columns if one.component != "w"]
    with pytest.raises(BadInput, match="found no reference column of quaternion w"):
        worlds.evidence(replace(made, manifest=made.manifest.model_copy(update={"columns": columns})))


def test_a_rotation_about_no_axis_is_said() -> None:
    made = turned()
    bare = replace(made, manifest=made.manifest.model_copy(update={"rotation": None}))
    with pytest.raises(BadInput, match="found no rotation in its manifest"):
        worlds.evidence(bare)


def test_stamps_in_another_unit_leave_no_spectrum_and_that_is_said() -> None:
    made = turned()
    at = made.tables[0].names.index("t")

    def slower(values: Array) -> Array:
        values[:, at] *= 1000.0
        return values

    slow = with_table(made, slower)
    slow = replace(slow, manifest=slow.manifest.model_copy(update={"compared": Compared()}))
    said = r"too few for a spectrum, wanted .* the unit of its time stamps put right"
    with pytest.raises(BadInput, match=said), warnings.catch_warnings(action="error"):
        worlds.evidence(slow).fitted()


def test_a_device_without_numbers_is_named() -> None:
    with pytest.raises(BadInput, match=r"gyro_z: found 0 rows with a number and a later stamp, wanted a record"):
        worlds.evidence(with_column("gyro_z", np.nan)(turned()))


# at rest, and poses


def still(columns: dict[str, Array], kind: str = "poses", **more: Any) -> Foreign:
    """A record with a time column; columns are named by what they are: `acc_x`, `gyro_z`."""
    made = [
        {"column": name, "quantity": "rate" if name.startswith("gyro") else "acceleration", "axis": name[-1],
         "unit": "rad/s" if name.startswith("gyro") else "m/s²"}
        for name in columns if name != "t"
    ]  # fmt: skip
    manifest: Manifest = worlds.manifest(kind, made, [{"path": "a.csv"}], time={"column": "t", "unit": "s"}, **more)
    values = np.column_stack(list(columns.values()))
    return Foreign("made", manifest, (Table("a", tuple(columns), values, {}, False),), ())


def faces(**changed: Array | float) -> dict[str, Array]:
    """A triad on twelve faces, 200 rows each, at 100 Hz."""
    random = np.random.default_rng(7)
    up = random.standard_normal((12, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    force = np.repeat(9.80665 * up, 200, axis=0) + 2e-3 * random.standard_normal((2400, 3))
    found = {"t": 0.01 * np.arange(2400.0), **{f"acc_{a}": force[:, k] for k, a in enumerate("xyz")}}
    return {**found, **{name: np.broadcast_to(value, 2400).astype(float) for name, value in changed.items()}}


SEGMENTS = [{"first": 200 * k, "last": 200 * (k + 1)} for k in range(12)]


def test_poses_need_no_gyro() -> None:
    found = worlds.evidence(still(faces(), segments=SEGMENTS)).fitted()
    assert np.isfinite(found.left).all()


@pytest.mark.parametrize(("value", "said"), [(0.0, "found nothing but 0 at rest"), (np.nan, "found no number at rest")])
def test_a_dead_channel_is_named(value: float, said: str) -> None:
    with pytest.raises(BadInput, match=f"acc_y: {said}, wanted a sensor's readings"):
        worlds.evidence(still(faces(acc_y=value), segments=SEGMENTS))


def resting(count: int, time: Array | None = None) -> Foreign:
    random = np.random.default_rng(8)
    t = 0.01 * np.arange(count) if time is None else time
    return still({"t": t, "acc_x": 0.02 * random.standard_normal(count)}, "static")


def test_rows_that_come_in_batches_have_the_rate_that_they_have_together() -> None:
    true = 0.02 * np.sqrt(0.01)  # σ·√interval
    batched = np.repeat(0.04 * np.arange(5000), 4)
    found = next(iter(at_rest(resting(20000, batched)))).coefficients["N"]
    assert found.value is not None
    assert found.u is not None
    assert found.value == pytest.approx(true, abs=4.0 * found.u)


@pytest.mark.parametrize("count", [2, 3, 10])
def test_a_few_rows_at_rest_are_said_to_be_few(count: int) -> None:
    (found,) = at_rest(resting(count))
    assert f"found {count} rows, wanted some hundred" in found.in_words
    assert not found.coefficients


def test_a_record_at_rest_whose_clock_stands_is_said() -> None:
    (found,) = at_rest(resting(400, np.zeros(400)))
    assert "found time stamps that do not go forward" in found.in_words
    assert not found.coefficients


def test_a_run_whose_sensor_file_names_other_channels_is_said() -> None:
    turning = {"procedure": "turntable", "revolutions": 2, "rest": "5 s"}
    records = fast_bench.measure(turning, fast_bench.world(1))
    sensor = dict(records.header["sensor"])
    sensor["channels"] = {f"my_{name}": one for name, one in sensor["channels"].items()}
    records.header = {**records.header, "sensor": sensor}
    with pytest.raises(BadInput, match=r"found none of the sensor's channels .my_unit_a_x, .* among what"):
        evidence_of([records])
