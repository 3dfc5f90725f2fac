"""What a record did not log cannot be the cause; what it did log can be, whoever recorded it."""

from __future__ import annotations

from dataclasses import replace

import fast_bench
import numpy as np
import pytest
from imported_sweeps import made as sweep
from imported_worlds import Sensor, Unit, evidence, motion, response, response_table, rotation

from rig.diagnose import search
from rig.diagnose.conclusion import concluded
from rig.diagnose.diagnose import diagnose
from rig.diagnose.unseen import cannot_see
from rig.fit.evidence import Evidence, evidence_of
from rig.foreign.manifest import Column
from rig.foreign.tables import Foreign
from rig.formula import formula_effect
from rig.parts.platter import Platter
from rig.shelf import shelf

COEFFICIENT = 2e-3  # 1/K
OF_TEMPERATURE = {"temperature_bias", "temperature_scale"}


def offered(made: Evidence) -> set[str]:
    return {term.effect.name for term in search.possible(shelf(), made.fitted())}


def warmed(foreign: Foreign, unit: str = "°C") -> Foreign:
    """The same, logged beside a thermometer (with noise) by which the gyro's scale goes."""
    (table,) = foreign.tables
    random = np.random.default_rng(3)
    temperature = np.linspace(20.0, 45.0, len(table.values))
    values = table.values.copy()
    values[:, table.names.index("gyro_z")] *= 1.0 + COEFFICIENT * (temperature - 25.0)
    read = temperature + 0.2 * random.normal(size=len(temperature)) + (273.15 if unit == "K" else 0.0)
    column = Column(column="temp", quantity="temperature", unit=unit, role="condition")
    manifest = foreign.manifest.model_copy(update={"columns": [*foreign.manifest.columns, column]})
    named = replace(table, names=(*table.names, "temp"), values=np.column_stack([values, read]))
    return replace(foreign, manifest=manifest, tables=(named,))


@pytest.mark.parametrize("unit", ["°C", "K"])
def test_a_logged_temperature_is_named_where_the_scale_of_a_turning_gyro_follows_it(unit: str) -> None:
    found = diagnose(evidence(warmed(rotation(Unit(), channels="r"), unit)))
    (step,) = found.steps
    assert step.taken.name == "temperature_scale"
    assert step.taken.term.at["coefficient"] == pytest.approx(COEFFICIENT, abs=4.0 * step.taken.u["coefficient"])


def test_a_temperature_stated_for_a_whole_file_is_that_of_its_rows() -> None:
    data = rotation(Unit(), channels="r", seconds=20.0)
    tables = tuple(replace(one, settings={"temperature": "31 °C", "supply": "4.9 V"}) for one in data.tables)
    (part,) = evidence(replace(data, tables=tables)).parts
    assert part.logged == {"temperature", "supply"}
    assert part.reference.temperature == pytest.approx(31.0)
    assert part.reference.supply == pytest.approx(4.9)


@pytest.mark.parametrize("kind", ["rotation", "motion", "sweep", "response"])
def test_nothing_that_nobody_logged_is_offered(kind: str) -> None:
    data = {
        "rotation": lambda: rotation(Unit(), channels="r", seconds=20.0), "sweep": sweep,
        "motion": lambda: motion(Unit(), seconds=20.0), "response": lambda: response([response_table(Sensor().phasor)]),
    }[kind]()  # fmt: skip
    assert not offered(evidence(data)) & {*OF_TEMPERATURE, "supply_ratio", "drive_feedthrough"}


def test_a_scale_that_went_with_an_unlogged_temperature_is_not_blamed_on_it_and_that_is_said() -> None:
    data = warmed(rotation(Unit(), channels="r"))
    hidden = data.manifest.model_copy(update={"columns": data.manifest.columns[:-1]})
    made = replace(evidence(replace(data, manifest=hidden)), imported=True)
    found = diagnose(made)
    said = concluded(made, found, shelf())
    assert not OF_TEMPERATURE & {one.name for step in found.steps for one in step.others}
    assert any("the temperature is in no record" in one for one in said.cannot_see)


def test_an_own_turntable_run_without_a_thermometer_offers_nothing_of_temperature() -> None:
    run = fast_bench.measure({"procedure": "turntable", "all": True}, fast_bench.world(11, []))
    made = evidence_of([run])
    (part,) = (one for one in made.parts if isinstance(one, Platter))
    assert {*OF_TEMPERATURE, "supply_ratio"} <= offered(made)
    without = Platter(replace(part.data, temperature=np.full_like(part.data.temperature, np.nan)))
    less = replace(made, parts=tuple(without if one is part else one for one in made.parts))
    assert offered(made) - offered(less) == OF_TEMPERATURE
    assert np.isfinite(less.fitted().left).all()
    assert any("the temperature is in no record" in one for one in cannot_see(less, [], shelf()))


def test_a_formula_needs_what_its_signals_need() -> None:
    assert formula_effect("creep", "k * T * u", on="rate").needs == ("temperature",)
    assert formula_effect("creep", "k * omega", on="rate").needs == ()
