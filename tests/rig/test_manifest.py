"""A manifest says what foreign data are; a mistake in it is named where it stands."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from foreign_data import turning_manifest
from pydantic import BaseModel

from rig.errors import ConfigError
from rig.foreign import manifest
from rig.foreign.manifest import Column, Manifest, from_json
from rig.foreign.manifest_file import load

ROOT = Path(__file__).parents[2]
SHIPPED = sorted((ROOT / "configs" / "imports").glob("*.yaml"))
PAGE = (ROOT / "docs" / "reference" / "manifest.md").read_text(encoding="utf-8")


def refused(tmp_path: Path, text: str) -> list[str]:
    path = tmp_path / "m.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load(path)
    return [str(one).removeprefix(f"{path}:") for one in caught.value.problems]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_manifest_is_one_and_comes_back_from_a_header(path: Path) -> None:
    made = load(path)
    assert from_json(manifest.as_json(made)) == made


def test_a_mistake_is_named_by_line_column_and_key(tmp_path: Path) -> None:
    said = refused(tmp_path, turning_manifest("a.csv").replace("unit: °/s, axis: x", "unit: volts, axis: x"))
    assert said == ["11:46 columns[1].unit: found 'volts', wanted the unit of an angular rate such as '45 rpm'"]


def test_all_mistakes_are_named_at_once(tmp_path: Path) -> None:
    text = turning_manifest("a.csv", time="{column: t_s, rate: 100 Hz}").replace("quantity: rate", "quantity: speed", 1)
    assert len(refused(tmp_path, text)) == 1  # types first
    text = turning_manifest("a.csv", time="{column: t_s, rate: 100 Hz}").replace(", axis: x", "", 1)
    said = refused(tmp_path, text)
    assert len(said) == 2
    assert "found 2 of column, rate and interval, wanted one" in said[0]
    assert "found nothing, wanted x, y or z" in said[1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("kind: rotation", "kind: motion"), "found no reference column of quaternion"),
        (("rotation: {axis: z, upright: true}\n", ""), "found no key 'rotation', wanted it to say the axis"),
        (("time: {column: t_s, unit: s}\n", ""), "found no key 'time'"),
        (("unit: s}", "unit: fortnights}"), "found 'fortnights', wanted a unit such as 's' or 'ms'"),
        (("unit: °/s, axis: x", "sensitivity: 170 counts, axis: x"), "found '170 counts', wanted text such as"),
        (("{column: gyro_x_dps,", "{column: gyro_x_dps, name: gyro_z_dps,"), "found the channel 'gyro_z_dps' twice"),
        (("time:", "reading: {decimal: \",\"}\ntime:"), "wanted another delimiter"),
        (("unit: {serial: A1}", "unit: {serial: ''}"), "unit.serial"),
    ],
)  # fmt: skip
def test_what_no_type_can_say_is_said(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    text = turning_manifest("a.csv")
    assert change[0] in text
    assert any(said in one for one in refused(tmp_path, text.replace(*change, 1)))


def test_counts_become_si_by_sensitivity_and_zero() -> None:
    counts = Column(column="a", quantity="acceleration", axis="x", sensitivity="16384 counts per g")
    assert counts.scale == pytest.approx(16384 / 9.80665, rel=1e-15)
    assert Column(column="w", quantity="rate", unit="°/s").scale == pytest.approx(180 / 3.141592653589793, rel=1e-15)


def parts(model: type[BaseModel]) -> Iterator[tuple[str, str]]:
    """Every field of a model and of the models in it, with the name of its owner."""
    for name, said in model.model_fields.items():
        yield model.__name__, name
        for inner in re.findall(r"rig\.manifest\.(\w+)", str(said.annotation)):
            found: Any = getattr(manifest, inner, None)
            if isinstance(found, type) and issubclass(found, BaseModel):
                yield from parts(found)


@pytest.mark.parametrize(("owner", "name"), sorted(set(parts(Manifest))))
def test_every_key_is_on_its_page(owner: str, name: str) -> None:
    section = re.search(rf"^## .*<!-- {owner} -->\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert section, f"found no section of {owner}"
    assert f"| `{name}` |" in section[1]


@pytest.mark.parametrize("quantity", sorted(manifest.UNIT_KINDS))
def test_every_quantity_is_on_its_page(quantity: str) -> None:
    assert f"`{quantity}`" in PAGE


def test_the_pages_own_manifest_is_one(tmp_path: Path) -> None:
    example = re.search(r"```yaml\n(format: 1\n.*?)```", PAGE, re.DOTALL)
    assert example
    path = tmp_path / "m.yaml"
    path.write_text(example[1], encoding="utf-8")
    assert load(path).kind == "rotation"
