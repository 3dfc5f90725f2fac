"""The shelf can be read: from the command line, and on a reference page that is what the code makes."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from rig.cli import cli
from rig.cli.effects import reference_page
from rig.errors import BadInput
from rig.shelf import shelf

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reference" / "effects.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
COUNTED = re.compile(
    r"\b(\d+|(?:twen|thir|for|fif|six)ty[- ]?\w*) (?:physical |shipped )?effects\b|\bshelf (?:of|has) (\d+)", re.I
)
OWN = '''"""An effect of one's own."""

from rig.model import Coordinate, Effect, Parameter


class Drag(Effect):
    stage = "transducer"
    title = "drag of the cable"
    equation = "u + drag·u"
    quantities = ("rate",)
    coordinates = (Coordinate("drag", 1e-5),)
    parameters = (Parameter("drag", "SI", (-1.0, float("inf")), (1e-4, 1e-2)),)
    missing = "it pulls"
    separate_by = "a shorter cable"
    source = "our own bench"
'''


@pytest.fixture(autouse=True)
def _no_effects_of_ones_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RIG_EFFECTS", raising=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "my effects"
    made.mkdir()
    (made / "cable_drag.py").write_text(OWN, encoding="utf-8")
    return made


def said(*words: object) -> str:
    command = ["effects", *map(str, words)]
    return CliRunner().invoke(cli, command, catch_exceptions=False, standalone_mode=False).stdout


def test_the_committed_page_is_what_the_code_makes() -> None:
    assert reference_page(shelf()) == PAGE, "make pages"
    assert said("--markdown") == PAGE


@pytest.mark.parametrize("name", sorted(shelf()))
def test_the_page_has_every_effect_with_its_equation_and_what_is_seen_without_it(name: str) -> None:
    effect = shelf()[name]
    _, found, rest = PAGE.partition(f"### {name}\n")
    assert found
    entry = rest.partition("\n### ")[0]
    for part in (effect.equation, effect.separate_by, effect.source, *effect.confused_with):
        assert part in entry
    assert f"Missing: {effect.missing}." in entry
    assert all(f"| {parameter.name} |" in entry for parameter in effect.parameters)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_a_page_that_counts_the_effects_counts_them_all(page: Path) -> None:
    for found in COUNTED.finditer(page.read_text(encoding="utf-8")):
        assert (found[1] or found[2]) == str(len(shelf())), f"{page.name}: {found[0]}"


def test_the_count_is_stated_where_it_is_looked_for() -> None:
    assert COUNTED.search(PAGES[0].read_text(encoding="utf-8"))
    assert f"{len(shelf())} in all" in PAGE


def test_the_list_has_every_effect_once_under_its_stage() -> None:
    stage, found = "", {}
    for line in said().splitlines()[1:]:
        if line and not line.startswith(" "):
            stage = line
        elif line:
            found[line.split()[0]] = stage
    assert found == {name: effect.stage for name, effect in shelf().items()}


@pytest.mark.parametrize("name", sorted(shelf()))
def test_an_effects_page_says_all_that_its_file_says(name: str) -> None:
    text, effect = said(name), shelf()[name]
    for part in (effect.title, effect.equation, effect.missing, effect.separate_by, effect.source):
        assert part in text
    for parameter in effect.parameters:
        assert f"  {parameter.name}: usually {parameter.typical[0]:.6g} … {parameter.typical[1]:.6g}, possible" in text
    assert all(other in text for other in effect.confused_with)


def test_effects_of_ones_own_are_listed_and_marked(folder: Path) -> None:
    text = said("--effects", folder)
    assert f"the shelf: {len(shelf()) + 1} effects, 1 of your own" in text
    assert "cable_drag" in text
    assert "(own) drag of the cable: u + drag·u" in text
    assert "drag: usually 0.0001 … 0.01, possible -1 … ∞ rad/s" in said("cable_drag", "--effects", folder)


def test_json_gives_the_same_with_open_ends_as_null(folder: Path) -> None:
    rows = json.loads(said("--json", "--effects", folder))
    assert {row["effect"] for row in rows} == {*shelf(), "cable_drag"}
    assert [row["effect"] for row in rows if row["own"]] == ["cable_drag"]
    one = json.loads(said("cable_drag", "--json", "--effects", folder))
    assert one in rows
    assert one["parameters"] == [
        {"name": "drag", "unit": "rad/s", "bounds": [-1.0, None], "typical": [1e-4, 1e-2]},
    ]


def test_an_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(BadInput, match="found 'cubik', wanted one of the shelf such as cubic") as error:
        said("cubik")
    assert error.value.exit_code == 2
