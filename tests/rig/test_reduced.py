"""What is kept of a reduction is what it made, for that very run, and nothing that is damaged is believed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.archive.records import Records
from rig.archive.reduced import CACHE, pack, reduced, unpack
from rig.archive.runs import Run, Runs


@dataclass(frozen=True)
class Found:
    """Something made of records, with every form of value in it."""

    name: str
    values: np.ndarray[Any, Any]
    inner: tuple[Any, ...]
    by: dict[Any, Any]


def found(run: Records) -> Found:
    volts = np.array(run.run.block("volts"), float)
    return Found(
        run.name, volts, (1, math.nan, None, [True, "µ"]), {("a", 1): volts[:1] * 1j, "none": np.empty((0, 3))}
    )


class Counting:
    """How often something was made."""

    def __init__(self) -> None:
        self.made = 0

    def of(self, run: Records, *given: object) -> Found:
        def make() -> Found:
            self.made += 1
            return found(run)

        return reduced(run, "found", (Found,), make, *given)


@pytest.fixture
def taken(tmp_path: Path) -> Run:
    runs = Runs(tmp_path / "runs", now=lambda: 1e6)
    with runs.create("noise", {"simulated": True, "points_total": 0}) as writer:
        writer.block("volts", np.arange(6, dtype=np.uint16).reshape(2, 3), {})
        writer.seal("completed")
        return Run(writer.path)


def kept(run: Run) -> list[Path]:
    return sorted((run.path.parent / CACHE / run.name).glob("*"))


def test_a_value_comes_back_as_it_was() -> None:
    value = Found("x", np.array([[1.5, -0.0], [math.inf, 2.0]]).T, (np.float64(0.1), np.intp(3)), {"c": np.array(2j)})
    back = unpack(pack(value), (Found,))
    assert type(back) is Found
    np.testing.assert_array_equal(back.values, value.values)
    assert (back.inner, back.by, back.name) == (value.inner, value.by, value.name)
    with pytest.raises(TypeError, match="found object"):
        pack(object())


def test_a_sealed_run_is_reduced_once_and_both_times_alike(taken: Run) -> None:
    counting = Counting()
    first, second = (counting.of(Records(taken)) for _ in range(2))
    assert counting.made == 1
    assert repr(first) == repr(second) == repr(found(Records(taken)))
    assert taken.verify() == []
    assert [run.name for run in Runs(taken.path.parent).list()] == [taken.name]


def test_what_else_it_depends_on_makes_another_and_takes_the_place_of_the_first(taken: Run) -> None:
    counting = Counting()
    counting.of(Records(taken), {"pole": 3.0})
    counting.of(Records(taken), {"pole": 4.0})
    assert counting.made == 2
    assert len(kept(taken)) == 1


def test_a_run_that_is_not_sealed_keeps_nothing(tmp_path: Path) -> None:
    with Runs(tmp_path).create("noise", {}) as writer:
        writer.block("volts", np.arange(3, dtype=np.uint16), {})
        Counting().of(Records(Run(writer.path)))
        assert kept(Run(writer.path)) == []


def flipped(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)


def halved(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def emptied(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("damage", [flipped, halved, emptied, Path.unlink])
def test_a_damaged_file_is_made_again(taken: Run, damage: Callable[[Path], object]) -> None:
    counting = Counting()
    first = counting.of(Records(taken))
    damage(kept(taken)[0])
    assert repr(counting.of(Records(taken))) == repr(first)
    assert counting.made == 2
    assert repr(counting.of(Records(taken))) == repr(first)
    assert counting.made == 2


def test_a_record_that_was_changed_is_reduced_as_it_is_now(taken: Run) -> None:
    counting = Counting()
    counting.of(Records(taken))
    (block,) = (taken.path / "blocks").iterdir()
    flipped(block)
    assert not np.array_equal(counting.of(Records(taken)).values, np.arange(6).reshape(2, 3))


def test_a_folder_that_takes_no_files_only_costs_time(taken: Run) -> None:
    (taken.path.parent / CACHE).write_text("in the way")
    counting = Counting()
    counting.of(Records(taken)), counting.of(Records(taken))
    assert counting.made == 2
