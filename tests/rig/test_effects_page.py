"""The reference page of the shelf says what the shelf says."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.shelf import shelf

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "effects.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", sorted(shelf()))
def test_the_page_has_every_effect_with_its_equation_and_what_is_seen_without_it(name: str) -> None:
    effect = shelf()[name]
    _, found, rest = PAGE.partition(f"### {name}\n")
    assert found
    entry = rest.partition("\n### ")[0]
    assert effect.equation in entry
    assert f"Missing: {effect.missing}." in entry
    assert all(f"| {parameter.name} |" in entry for parameter in effect.parameters)
