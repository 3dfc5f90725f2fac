"""A sound journal whose lines say something else than a record can be: refused with what was found and wanted."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rig.archive import journal
from rig.archive.journal import BrokenLineError
from rig.archive.reader import Run
from rig.archive.records import Records
from rig.archive.runs import Runs
from rig.errors import ArchiveError

Meta = dict[str, Any]
CHANNELS = [["unit_a_x", 0, -10.0, 10.0], ["unit_a_y", 1, -10.0, 10.0]]
META: Meta = {
    "channels": CHANNELS, "convert_period": 2e-5, "scan_channels": 2, "start": 0.0, "first_scan": 0, "flags": [],
}  # fmt: skip


def kept(folder: Path, meta: Meta) -> Records:
    with Runs(folder).create("noise", {"procedure": "noise"}) as writer:
        writer.block("static", np.zeros((4, 2), np.uint16), meta)
    return Records(Runs(folder).open("last"))


def test_a_channel_that_a_record_does_not_have_is_named_with_those_that_it_has(tmp_path: Path) -> None:
    found = kept(tmp_path, META).samples("static")
    assert found.index("unit_a_y") == 1
    with pytest.raises(ArchiveError, match=r"found a record of unit_a_x, unit_a_y, wanted one with 'unit_b_z'"):
        found.volts("unit_b_z")


@pytest.mark.parametrize(
    "changed",
    [
        {"channels": CHANNELS[:1]},
        {"channels": [CHANNELS[0], ["unit_a_y", 2, -10.0, 10.0]]},
        {"channels": [CHANNELS[0], ["unit_a_y", 10**30, -10.0, 10.0]]},
        {"channels": [CHANNELS[0], ["unit_a_y", 1, 10.0, -10.0]]},
        {"channels": [CHANNELS[0], ["unit_a_y", 1, "low", 10.0]]},
        {"convert_period": 0.0},
        {"start": []},
    ],
)
def test_a_record_that_no_converter_makes_is_refused(changed: Meta, tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match=r"found .*, wanted"):
        kept(tmp_path, META | changed).samples("static")


def with_dtype(dtype: str) -> Callable[[Meta], Meta]:
    return lambda body: body | {"dtype": dtype}


@pytest.mark.parametrize(
    "change", [with_dtype("Q?2"), with_dtype("O"), with_dtype("<M8[s]"), lambda body: body | {"shape": [-4, -2]}]
)
def test_a_block_of_anything_but_numbers_is_refused(change: Callable[[Meta], Meta], tmp_path: Path) -> None:
    path = kept(tmp_path, META).run.path / "journal.jsonl"
    chain, lines = journal.GENESIS, []
    for n, text in enumerate(path.read_bytes().splitlines()):
        one = json.loads(text)
        body = change(one["body"]) if one["kind"] == "block" else one["body"]
        line, chain = journal.line(n, one["t"], one["wall"], one["kind"], body, chain)
        lines.append(line)
    path.write_bytes(b"".join(lines))
    with pytest.raises(ArchiveError, match=r"block static: found numbers of the kind .*, wanted"):
        Records(Run(path.parent)).samples("static")


@pytest.mark.parametrize(("t", "body"), [(None, {}), ("1", {}), (True, {}), (1.0, [])])
def test_a_line_without_a_time_or_names_is_broken(t: Any, body: Any) -> None:
    raw, _ = journal.line(0, t, 1.0, "point", body, journal.GENESIS)
    with pytest.raises(BrokenLineError, match=r"wanted times in seconds and a body of names and values"):
        journal.read_line(raw, journal.GENESIS, 0)
