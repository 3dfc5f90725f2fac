"""Every fault that `make mutants` plants still has its place in the program, and tests that could notice it."""

from __future__ import annotations

import mutants
import pytest


@pytest.mark.parametrize("one", mutants.MUTANTS, ids=lambda one: one.promise)
def test_a_planted_fault_has_its_place(one: mutants.Mutant) -> None:
    text = (mutants.ROOT / one.file).read_text(encoding="utf-8")
    compile(mutants.planted(one, text), one.file, "exec")
    assert (mutants.ROOT / one.module).is_file()


def test_a_place_that_is_gone_is_said() -> None:
    with pytest.raises(ValueError, match="found 'no such line' 0 times, wanted it once"):
        mutants.planted(mutants.Mutant("a promise", "rig/model.py", "no such line", "", "", ""), "text")
