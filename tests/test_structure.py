"""The house stays as orderly as it is: ceilings on what `tests/structure.py` counts, to be lowered and never raised."""

from __future__ import annotations

from pathlib import Path

import pytest
import structure
from structure import House

ROOMS, ARROWS, SHARE = 34, 135, 0.20
UNLISTED, UPWARD, CIRCLES = 0, 0, 0
BRANCHES = 0
LONG, P90, TYPED = 0, 18, 1.0


@pytest.fixture(scope="module")
def house() -> House:
    return House.of(structure.RIG)


def test_there_are_no_more_rooms_and_arrows_and_no_room_outgrows_the_others(house: House) -> None:
    assert len(house.rooms) <= ROOMS
    assert len(house.arrows) <= ARROWS
    assert house.biggest <= SHARE


def test_imports_lead_down_and_never_back(house: House) -> None:
    assert len(house.unlisted) <= UNLISTED, house.unlisted
    assert len(house.upward) <= UPWARD, house.upward
    assert len(house.circles) + len(house.module_circles) <= CIRCLES, (house.circles, house.module_circles)


def test_nothing_outside_the_parts_asks_for_a_part_s_type_kind_or_place(house: House) -> None:
    assert len(house.branches) <= BRANCHES, house.branches


def test_functions_are_short_and_say_their_types(house: House) -> None:
    assert len(house.long) <= LONG, house.long
    assert house.p90 <= P90
    assert house.typed >= TYPED, house.untyped


def _house(folder: Path, **files: str) -> House:
    for name, text in files.items():
        path = folder / f"{name.replace('__', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return House.of(folder)


def test_an_import_counts_wherever_it_stands_and_a_pair_of_rooms_once(tmp_path: Path) -> None:
    house = _house(
        tmp_path,
        units="import rig.errors\n",
        errors="X = 1\n",
        fit__one="from rig.units import a\n\ndef f() -> None:\n    from rig import units\n",
        fit__two="from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from rig.errors import X\n",
    )
    assert house.arrows == {("units", "errors"), ("fit", "units"), ("fit", "errors")}
    assert set(house.rooms) == {"units", "errors", "fit"}
    assert not house.upward


def test_an_arrow_that_leads_up_and_a_circle_are_found(tmp_path: Path) -> None:
    house = _house(
        tmp_path,
        units="from rig.fit import x\n",
        fit="import rig.units\n",
        foreign__guessing="import rig.cli\n",
        cli="",
    )
    assert house.upward == ["foreign.guessing → cli", "units → fit"]
    assert house.circles == [["fit", "units"]]


def test_two_that_stand_side_by_side_may_not_know_each_other(tmp_path: Path) -> None:
    assert _house(tmp_path, bench="import rig.foreign.tables\n", foreign="").upward == ["bench → foreign"]


def test_a_branch_on_a_part_is_found_in_each_of_its_guises(tmp_path: Path) -> None:
    part = "class Sines:\n    def whitened(self): ...\nclass Late(Sines): ...\n"
    asks = """
def f(part, manifest, entry):
    if isinstance(part, (int, Late)) or type(part) is Sines or part.place == "shaker" or manifest.kind == "sweep":
        return entry.kind == "point" or isinstance(part, str)
    match part:
        case Sines():
            return 1
"""
    house = _house(tmp_path, parts__sines=part + asks, fit=asks)
    assert [line.partition(" ")[0] for line in house.branches] == ["fit:3"] * 4 + ["fit:6"]


def test_a_function_s_length_and_types_are_counted(tmp_path: Path) -> None:
    long = "def f(a: int, *rest: int) -> None:\n" + "    a += 1\n" * 50 + "\nclass A:\n    def g(self, b): ...\n"
    house = _house(tmp_path, fit=long)
    assert house.long == ["fit:1 f, 51 lines"]
    assert house.untyped == ["fit:54 g"]
    assert house.typed == 0.5
