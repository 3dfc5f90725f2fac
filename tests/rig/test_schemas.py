"""Schemas for editors say what the readers say: they take what is shipped, and refuse wrong keys and types.

Files are spoilt at every place: a key too many, a key too few, a value of another type. What a schema refuses its
reader refuses too; and of keys and types a reader refuses nothing that the schema lets pass.
"""

from __future__ import annotations

import copy
import functools
import json
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pages
import pytest
import yaml
from click.testing import CliRunner
from jsonschema import Draft202012Validator

from fixtures import world_file
from rig.bench import assembly, procedure_file
from rig.bench.benchfile import SensorFile, Standard, describe
from rig.bench.clock import SystemClock
from rig.bench.operators import AnswersOperator
from rig.certificate.issuer import Issuer
from rig.cli import cli
from rig.errors import ConfigError
from rig.foreign import manifest_file
from rig.repair import model_file
from rig.shelf import shelf
from rig.yaml import config

SHIPPED = {
    "bench": "configs/benches", "manifest": "configs/imports", "procedure": "procedures", "sensor": "configs/sensors",
    "laboratory": "configs/laboratories",
    "standard": "configs/standards", "world": "configs/worlds",
}  # fmt: skip
FILES = [(kind, path) for kind, folder in SHIPPED.items() for path in sorted((pages.ROOT / folder).glob("*.yaml"))]
LINE = re.compile(r"# yaml-language-server: \$schema=(\S+)")
TOO_MANY, TOO_FEW, OTHER = "a key too many", "a key too few", "another type"

ANSWERS = """
- {action: cables, who: A. Technician, settings: {set: shaker}}
- {action: align_beam, who: A. Technician, said: 34 bars}
"""
MODEL = """
format: 1
unit: SIM-CUBE-1
runs: [one]
effects:
- {effect: cubic, on: acceleration, coordinates: {coefficient: {value: 1.2e-05, u: 3.0e-07}}}
- {effect: drag, formula: k * omega**2, on: rate, channels: [gyro_yaw], values: {k: 0.001}}
covariance: {order: [cubic (acceleration).coefficient], values: [[9.0e-14]]}
channels:
  unit_a_x: {sensitivity: {value: 0.066, unit: V/(m/s²), u: 0.0003}, pole: {value: 400.0, unit: Hz}, axis: x}
history:
- {action: fit, runs: [one], chi2_dof: 1.0, error: 1.0, worst_at: unit_a_x, when: 1.0}
"""
WORLD = """
start: 2026-11-02T08:00:00Z
mains: 50 Hz
hidden:
- {name: first_order_lag, parameters: {time_constant: 1.0e-04, quantity: rate}}
- {name: cubic}
"""
SEQUENCE = """
title: small
steps:
- prompt: Warm?
- {procedure: noise, length: 3 s}
- wait: 1 s
- repeat: 2
  steps:
  - {procedure: frequency_sweep, axis: z, points: 1, limits: {acceleration: 0.5 g}}
"""
SENSOR = """
sensor: a cube
serial: "1"
channels:
  left: {part: P1, unit: first, quantity: acceleration, axis: x, sensitivity: 660 mV/g, range: 2 g, bandwidth: 400 Hz,
    tolerance: 10 %, ratiometric: 3.3 V, temperature_coefficient: 0.01 %, beside_spot: 5 mm,
    noise: {density: 60 µg/√Hz, tolerance: 50 %, corner: [0.1 Hz, 1 Hz]}}
  turn: {part: P2, quantity: rate, axis: z, sensitivity: 5 mV/(°/s), range: 300 °/s, bandwidth: 80 Hz}
units:
  first: {title: one, colour: "#1f5fa8"}
primary: first
"""
WRITTEN = {"answers": ANSWERS, "model": MODEL, "world": WORLD, "procedure": SEQUENCE, "sensor": SENSOR}
SPOILT = [
    *((kind, text) for kind, text in WRITTEN.items()),
    ("bench", (pages.ROOT / "configs/benches/simulated.yaml").read_text(encoding="utf-8")),
    ("standard", (pages.ROOT / "configs/standards/vibrometer.yaml").read_text(encoding="utf-8")),
    ("laboratory", (pages.ROOT / "configs/laboratories/example.yaml").read_text(encoding="utf-8")),
    *(("manifest", (pages.ROOT / f"configs/imports/{name}.yaml").read_text(encoding="utf-8"))
      for name in ("uiuc-yaw-slow", "ptb-mpu9250", "xsens-multiposition")),
]  # fmt: skip


@functools.cache
def validator(kind: str) -> Draft202012Validator:
    schema = json.loads((pages.ROOT / pages.SCHEMAS / f"{kind}.json").read_text(encoding="utf-8"))
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def as_read(text: str) -> Any:
    """What an editor sees: times and dates are text."""
    return config.read_text(text, "m.yaml").data


# the readers


def _bench(path: Path) -> object:
    return assembly.fittings(describe(path))


def _procedure(path: Path) -> object:
    facts = describe(config.shipped("benches/simulated.yaml")).facts()
    return procedure_file.plan(config.read(path), facts)


def _world(path: Path) -> object:
    return world_file.world_of(path, world_file.read_world(path), 1)


READERS: dict[str, Callable[[Path], object]] = {
    "answers": lambda path: AnswersOperator.load(path, SystemClock()),
    "bench": _bench,
    "manifest": manifest_file.load,
    "model": lambda path: model_file.load(path, shelf()),
    "procedure": _procedure,
    "sensor": lambda path: config.load(path, SensorFile),
    "laboratory": lambda path: config.load(path, Issuer),
    "standard": lambda path: config.load(path, Standard),
    "world": _world,
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A place from which a file finds what it names."""
    shutil.copytree(pages.ROOT / "configs", tmp_path / "configs")
    return tmp_path / "configs" / "benches"


# spoiling


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    rows = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in rows:
        yield from places(part, (*path, key))


def part_of(value: Any, path: tuple[Any, ...]) -> Any:
    return functools.reduce(lambda part, key: part[key], path, value)


def spoilt(data: Any) -> Iterator[tuple[str, str, Any]]:
    """How and where a file is spoilt, and what is in it then."""
    for path in places(data):
        where = ".".join(map(str, path))
        if isinstance(part_of(data, path), dict):
            made = copy.deepcopy(data)
            part_of(made, path)["no_such_key"] = "x"
            yield TOO_MANY, where, made
        if not path:
            continue
        made = copy.deepcopy(data)
        if isinstance(path[-1], str):
            del part_of(made, path[:-1])[path[-1]]
            yield TOO_FEW, where, made
            made = copy.deepcopy(data)
        part_of(made, path[:-1])[path[-1]] = [[[]]]
        yield OTHER, where, made


def refused(kind: str, path: Path, data: Any) -> bool:
    """Whether the reader refuses a file."""
    path.write_text(yaml.safe_dump(data, allow_unicode=True, sort_keys=False), encoding="utf-8")
    try:
        READERS[kind](path)
    except (ConfigError, world_file.WorldError):
        return True
    return False


@pytest.mark.parametrize(("kind", "text"), SPOILT, ids=[f"{k}-{n}" for n, (k, _) in enumerate(SPOILT)])
def test_a_schema_refuses_what_its_reader_refuses_for_its_keys_and_nothing_else(
    kind: str, text: str, folder: Path
) -> None:
    data, schema = as_read(text), validator(kind)
    schema.validate(data)
    assert not refused(kind, folder / "spoilt.yaml", data)
    count = dict.fromkeys((TOO_MANY, TOO_FEW, OTHER), 0)
    for how, where, made in spoilt(data):
        by_schema, by_reader = not schema.is_valid(made), refused(kind, folder / "spoilt.yaml", made)
        assert by_reader or not by_schema, f"{how} at {where}: only the schema refuses it"
        if how != TOO_FEW:  # what a kind of data cannot do without is no matter of types
            assert by_schema or not by_reader, f"{how} at {where}: only the reader refuses it"
        count[how] += by_schema
    assert all(count.values()), count


@pytest.mark.parametrize(("kind", "path"), FILES, ids=lambda one: one if isinstance(one, str) else one.stem)
def test_every_shipped_file_fits_its_schema_and_says_where_that_is(kind: str, path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    found = LINE.match(text)
    assert found
    assert (path.parent / found[1]).resolve() == pages.ROOT / pages.SCHEMAS / f"{kind}.json"
    validator(kind).validate(as_read(text))


def test_files_that_init_copies_say_where_their_schemas_are_now(tmp_path: Path) -> None:
    done = CliRunner().invoke(cli, ["init", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    copies = sorted(tmp_path.rglob("*.yaml"))
    assert len(copies) == len(FILES)
    for path in copies:
        found = LINE.match(path.read_text(encoding="utf-8"))
        assert found
        schema = json.loads((path.parent / found[1]).read_text(encoding="utf-8"))
        Draft202012Validator(schema).validate(as_read(path.read_text(encoding="utf-8")))


def test_import_prints_the_schema_of_manifests() -> None:
    said = CliRunner().invoke(cli, ["import", "--schema"], catch_exceptions=False).stdout
    assert json.loads(said) == validator("manifest").schema


def test_the_answers_that_the_documentation_shows_fit_their_schema() -> None:
    page = (pages.ROOT / "docs/how-to/replace-the-operator.md").read_text(encoding="utf-8")
    (block,) = [one for one in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL) if one.startswith("- ")]
    validator("answers").validate(as_read(block))


def test_the_page_of_schemas_names_every_one() -> None:
    page = (pages.ROOT / "docs/reference/schemas.md").read_text(encoding="utf-8")
    assert {name for name in pages.schemas() if f"(schemas/{name}.json)" in page} == set(pages.schemas())
