"""A slice of `make fuzz`: what once found a defect, and a few hundred new inputs for every reader."""

from __future__ import annotations

import fuzz
import pytest


@pytest.mark.parametrize("reader", fuzz.READERS, ids=lambda one: one.name)
def test_a_reader_reads_or_refuses_what_is_nearly_right(reader: fuzz.Reader) -> None:
    for seed in reader.seeds():
        reader.read(seed)
    count = 0 if reader.name.endswith("run") else int(500 * reader.weight)  # measured, and by each processor otherwise
    assert [one.said for one in fuzz.fed(reader, count).values()] == []


def test_a_reader_that_raises_what_it_may_not_is_found() -> None:
    def read(raw: bytes) -> None:
        if raw.count(b"a") > 1:
            raise KeyError("a defect")

    found = fuzz.fed(fuzz.Reader("one", read, lambda: [b"a quick brown fox"], (ValueError,)), 300)
    assert [place.startswith("KeyError in test_fuzz.py") for place in found] == [True]


def test_changes_make_inputs_that_are_new_and_nearly_right() -> None:
    reader = fuzz.Reader("one", bytes, lambda: [b"procedure: noise\nlength: 5 s\n"], words=(b"{",))
    found = set(fuzz.changed(reader, 200))
    assert len(found) > 100
    assert sum(one.startswith(b"procedure:") for one in found) > 50
