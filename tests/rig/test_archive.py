"""Runs on disk: nothing acknowledged is lost, nothing changed goes unseen, and the state is what it says."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from rig.archive import journal
from rig.archive.runs import Run, Runs, RunWriter
from rig.archive.writer import PIECE_BYTES, _Line
from rig.errors import ArchiveError, BadInput, BenchUnreachable

HEADER = {"simulated": True, "points_total": 2}


@pytest.fixture
def runs(tmp_path: Path) -> Runs:
    return Runs(tmp_path / "runs", now=lambda: 1_000_000.0)


@pytest.fixture
def writer(runs: Runs) -> Iterator[RunWriter]:
    with runs.create("frequency_sweep", HEADER, label="sweep x") as writer:
        yield writer


def filled(runs: Runs) -> Run:
    """A completed run with one of everything."""
    with runs.create("frequency_sweep", HEADER) as writer:
        writer.block("static", np.arange(6, dtype=np.uint16).reshape(2, 3), {"unit": "V"})
        writer.point_done(0, {"frequency": 20.0})
        stream = writer.block_stream("record")
        stream.append(np.ones((4, 2), np.uint16))
        stream.close()
        writer.point_done(1, {"frequency": 40.0})
        writer.note("confirmed", who="a person", text="80 µm, °/s")
        writer.seal("completed")
        return Run(writer.path)


# what is written is what is read


def test_a_run_is_named_after_time_and_label_and_a_taken_name_gets_a_suffix(runs: Runs) -> None:
    names = [runs.create("noise", {}, label="Sweep X!").name for _ in range(3)]
    assert len(set(names)) == 3
    assert all(name[10] == "T" and "-sweep-x" in name for name in names)
    assert [run.name for run in runs.list()] == names


def test_lines_carry_number_bench_time_kind_and_body(runs: Runs, writer: RunWriter) -> None:
    assert writer.note("approach", attempt=1, reached=0.97) == 1
    header, line = runs.open("last").lines()
    assert (header.n, header.t, header.kind) == (0, 1_000_000.0, "header")
    assert header.body["procedure"] == "frequency_sweep"
    assert header.body["run"] == writer.name
    assert (line.n, line.kind, line.body) == (1, "approach", {"attempt": 1, "reached": 0.97})
    assert abs(line.wall - header.wall) < 60


@pytest.mark.parametrize("dtype", ["<u2", ">u2", "i1", "u1", "<i4", "<f4", "<f8", ">f8", "<c16", "?"])
@pytest.mark.parametrize("shape", [(), (0,), (5,), (4, 3), (2, 3, 4), (0, 16)])
def test_a_block_reads_back_bit_for_bit_little_endian(writer: RunWriter, dtype: str, shape: tuple[int, ...]) -> None:
    array = (np.random.default_rng(3).uniform(0, 100, shape)).astype(dtype)
    reference = writer.block("counts", array, {"unit": "V"})
    found = Run(writer.path).block("counts")
    assert found.shape == shape
    np.testing.assert_array_equal(found, array)
    raw = (writer.path / reference.file).read_bytes()
    assert raw == array.astype(array.dtype.newbyteorder("<")).tobytes()
    assert hashlib.sha256(raw).hexdigest() == reference.sha256
    assert Run(writer.path).blocks()["counts"][0].meta == {"unit": "V"}


def test_a_block_s_numbers_cannot_be_written_to(writer: RunWriter) -> None:
    writer.block("a", np.arange(3))
    with pytest.raises(ValueError, match="read-only"):
        Run(writer.path).block("a")[0] = 1


def test_a_strided_view_is_kept_as_it_looks(writer: RunWriter) -> None:
    array = np.arange(24, dtype=np.uint16).reshape(4, 6)[::2, 1::2]
    writer.block("a", array)
    np.testing.assert_array_equal(Run(writer.path).block("a"), array)


def test_a_name_used_twice_keeps_both_files_and_reads_the_later(writer: RunWriter) -> None:
    first, second = writer.block("a", np.zeros(3)), writer.block("a", np.ones(3))
    assert first.file != second.file
    np.testing.assert_array_equal(Run(writer.path).block("a"), np.ones(3))
    np.testing.assert_array_equal(Run(writer.path).read(first), np.zeros(3))


def test_a_long_record_is_kept_in_closed_pieces_of_at_most_eight_mebibytes(writer: RunWriter) -> None:
    rows = np.random.default_rng(1).integers(0, 65535, (300_000, 16), dtype=np.uint16)
    stream = writer.block_stream("record", {"rate": 3125})
    for part in np.array_split(rows, 7):
        stream.append(part)
    stream.close()
    pieces = Run(writer.path).blocks()["record"]
    assert [piece.piece for piece in pieces] == [0, 1]
    assert all((writer.path / piece.file).stat().st_size <= PIECE_BYTES for piece in pieces)
    np.testing.assert_array_equal(Run(writer.path).block("record"), rows)
    assert list(Run(writer.path).lines())[-1].body == {"name": "record", "rows": 300_000, "pieces": 2}


def test_rows_of_another_form_are_refused(writer: RunWriter) -> None:
    stream = writer.block_stream("record")
    stream.append(np.ones((4, 2), np.uint16))
    for wrong in (np.ones((4, 3), np.uint16), np.ones((4, 2), np.int16), np.uint16(1)):
        with pytest.raises(BadInput, match="as before"):
            stream.append(wrong)
    stream.append(np.ones((4, 2), np.uint16))
    stream.close()
    assert len(Run(writer.path).block("record")) == 8


@pytest.mark.parametrize("name", ["", "a/b", "../a", ".hidden", "a b", "x" * 101, "a\0"])
def test_a_block_name_that_is_no_file_name_is_refused(writer: RunWriter, name: str) -> None:
    with pytest.raises(BadInput, match="block name"):
        writer.block(name, np.zeros(3))


def test_only_numbers_are_kept_as_blocks(writer: RunWriter) -> None:
    for wrong in (["a", "b"], [None], [object()]):
        with pytest.raises(BadInput, match="wanted numbers"):
            writer.block("a", wrong)  # type: ignore[arg-type]


def test_numbers_that_json_lacks_and_garbled_replies_are_kept_too(writer: RunWriter) -> None:
    writer.note("odd", nan=float("nan"), inf=np.float64("inf"), z=1 - 2j, array=np.array([1.0, np.nan]), path=Path("a"))
    writer.note("odd", reply="\ud800", raw=b"\xff", names={"b", "a"})
    *_, first, second = Run(writer.path).lines()
    assert first.body == {"nan": "NaN", "inf": "Infinity", "z": {"re": 1, "im": -2}, "array": [1, "NaN"], "path": "a"}
    assert second.body == {"reply": "\ud800", "raw": "\xff", "names": ["a", "b"]}
    assert Run(writer.path).verify() == []


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.lists(st.dictionaries(st.text(), JSON, max_size=3), min_size=1, max_size=4))
def test_any_json_body_reads_back_the_same(bodies: list[dict[str, Any]]) -> None:
    raw, chain = b"", journal.GENESIS
    for n, body in enumerate(bodies):
        data, chain = journal.line(n, 1.5, 2.5, "kind", body, chain)
        raw += data
    assert raw.count(b"\n") == len(bodies)
    assert [entry.body for entry in journal.entries(raw)] == bodies


@given(st.binary(max_size=300))
def test_no_bytes_make_the_journal_reader_raise_anything_but_a_broken_line(raw: bytes) -> None:
    lines, torn = journal.split(raw)
    assert b"".join(lines) + torn == raw
    try:
        assert list(journal.entries(raw)) == []
    except journal.BrokenLineError:
        assert lines


# states


def test_the_states_of_a_run(runs: Runs, writer: RunWriter) -> None:
    run = runs.open("last")
    assert run.status == "running"
    writer.close()
    assert run.status == "interrupted"
    with runs.reopen(run.name) as again:
        assert run.status == "running"
        again.seal("aborted", "the operator's wish")
        assert run.status == "aborted"
    assert run.seal is not None
    assert run.seal.body["reason"] == "the operator's wish"


def test_only_a_run_with_all_its_points_is_completed(runs: Runs, writer: RunWriter) -> None:
    writer.point_done(0, {})
    writer.point_done(0, {})
    with pytest.raises(ArchiveError, match="found 1 of 2 points, wanted all of them"):
        writer.seal("completed")
    writer.point_done(1, {})
    writer.seal("completed")
    assert runs.open("last").summary() == {
        "run": writer.name,
        "procedure": "frequency_sweep",
        "status": "completed",
        "points_done": 2,
        "points_total": 2,
        "simulated": True,
        "path": str(writer.path),
        "not_safe": None,
        "unmet": [],
    }


def test_a_sealed_or_closed_run_takes_nothing_more(runs: Runs, writer: RunWriter) -> None:
    writer.seal("failed", "no answer")
    for write in (lambda: writer.note("x"), lambda: writer.block("a", [1]), lambda: writer.seal("aborted")):
        with pytest.raises(ArchiveError, match="found it sealed, wanted an open run"):
            write()
    with pytest.raises(BadInput, match="found it failed, wanted an interrupted run"):
        runs.reopen(writer.name)
    assert Run(writer.path).status == "failed"


def test_a_status_that_is_none_is_refused(writer: RunWriter) -> None:
    with pytest.raises(BadInput, match="found the status 'fine'"):
        writer.seal("fine")  # type: ignore[arg-type]


def test_without_any_run_last_is_bad_input(runs: Runs) -> None:
    with pytest.raises(BadInput, match="found no run, wanted one"):
        runs.open("last")
    assert list(runs.list()) == []


def test_an_unknown_run_is_bad_input_and_the_nearest_name_is_told(runs: Runs, writer: RunWriter) -> None:
    for name in (writer.name[:-1], "../runs", "", "a\0b"):
        with pytest.raises(BadInput, match=f"found no run .*such as {writer.name}"):
            runs.open(name)


def test_what_is_no_run_is_not_listed(runs: Runs, writer: RunWriter) -> None:
    for other in ("models", ".bench", "reports"):
        (runs.root / other).mkdir()
    (runs.root / "calibrations").write_text("a file")
    (runs.root / "died-before-its-header").mkdir()
    (runs.root / "died-before-its-header" / "journal.jsonl").touch()
    assert [run.name for run in runs.list()] == [writer.name]


def test_last_is_the_newest_also_after_the_clock_went_back(runs: Runs, monkeypatch: pytest.MonkeyPatch) -> None:
    with runs.create("noise", HEADER) as first:
        assert runs.open("last").name == first.name
    monkeypatch.setattr("time.time", lambda: 1_000_000_000.0)
    with runs.create("noise", HEADER, label="years ago") as second:
        assert runs.open("last").name == second.name
    assert [run.header["sequence"] for run in runs.list()] == [1, 2]


def test_a_run_whose_header_is_damaged_keeps_its_place(runs: Runs) -> None:
    names = []
    for k in range(3):
        with runs.create("noise", HEADER, label=f"run {k}") as writer:
            names.append(writer.name)
    journal_file = runs.root / names[-1] / "journal.jsonl"
    journal_file.write_bytes(journal_file.read_bytes().replace(b"noise", b"nojse"))
    assert [run.name for run in runs.list()] == names
    assert runs.open("last").status == "damaged"


def test_runs_that_begin_together_are_told_apart(tmp_path: Path) -> None:
    program = """
        import sys
        from pathlib import Path
        from rig.archive.runs import Runs
        for k in range(5):
            Runs(Path(sys.argv[1])).create("noise", {}, label=f"{sys.argv[2]} {k}").close()
    """
    command = [sys.executable, "-c", textwrap.dedent(program), str(tmp_path)]
    together = [subprocess.Popen([*command, str(k)]) for k in range(3)]
    assert [one.wait() for one in together] == [0, 0, 0]
    assert [run.header["sequence"] for run in Runs(tmp_path).list()] == list(range(1, 16))


def test_last_is_the_newest_whatever_its_name(runs: Runs, writer: RunWriter) -> None:
    newer = runs.create("noise", {})
    os.rename(newer.path, runs.root / "0000-renamed")
    assert runs.open("last").name == "0000-renamed"


def test_a_running_run_cannot_be_resumed(runs: Runs, writer: RunWriter) -> None:
    with pytest.raises(BadInput, match="found it running, wanted an interrupted run"):
        runs.reopen(writer.name)


def test_resuming_continues_the_chain_and_knows_what_is_done(runs: Runs, writer: RunWriter) -> None:
    writer.block("a", np.zeros(3))
    writer.point_done(1, {"x": 1})
    writer.close()
    with runs.reopen("last") as again:
        assert again.points_done == {1}
        again.point_done(1, {"x": 2})
        again.block("a", np.ones(3))
        again.point_done(0, {})
        again.seal("completed")
    run = runs.open("last")
    assert run.verify() == []
    assert [entry.kind for entry in run.lines()] == ["header", "block", "point", "resumed", "point", "block", "point"]
    assert run.points()[1]["x"] == 2
    assert sorted(path.name for path in (run.path / "blocks").iterdir()) == ["a-2.f8", "a.f8"]


def test_half_a_line_is_set_aside_and_nothing_else_is_lost(runs: Runs, writer: RunWriter) -> None:
    writer.point_done(0, {})
    writer.close()
    for half in (b'{"n":2,"t":1', b"\0" * 100):
        before = (writer.path / "journal.jsonl").read_bytes()
        with open(writer.path / "journal.jsonl", "ab") as file:
            file.write(half)
        assert runs.open("last").verify() == []
        assert set(runs.open("last").points()) == {0}
        runs.reopen("last").close()
        assert (writer.path / "journal.jsonl").read_bytes().startswith(before)
        assert runs.open("last").verify() == []
    assert (writer.path / "journal.torn").read_bytes() == b'{"n":2,"t":1'
    assert (writer.path / "journal.torn-2").read_bytes() == b"\0" * 100
    (writer.path / "journal.torn").write_bytes(b"changed")
    assert runs.open("last").verify() == ["journal.torn: found it missing or changed, wanted the torn line as it was"]


def test_a_damaged_run_is_not_resumed(runs: Runs, writer: RunWriter) -> None:
    reference = writer.block("a", np.zeros(3))
    writer.close()
    (writer.path / reference.file).unlink()
    with pytest.raises(ArchiveError, match=r"found damage, wanted a sound run\nblocks/a\.f8: found No such file"):
        runs.reopen("last")
    assert runs.open("last").status == "interrupted"


def test_a_lost_bench_clock_does_not_keep_the_end_off_the_record(tmp_path: Path) -> None:
    times = iter([5.0, 5.0, 6.0])  # for its name, its first line and the next

    def now() -> float:
        for time in times:
            return time
        raise BenchUnreachable("gone")

    with Runs(tmp_path, now).create("noise", {}) as writer:
        writer.note("a")
        writer.note("failure", error="the bench is gone")
        writer.seal("failed", "the bench is gone")
    assert [entry.t for entry in Run(writer.path).lines()] == [5.0, 6.0, 6.0]


def test_threads_may_share_a_writer(writer: RunWriter) -> None:
    def work(name: str) -> None:
        for i in range(20):
            writer.note(name, i=i)
        writer.block(name, np.full(10, 7))

    threads = [threading.Thread(target=work, args=(f"t{k}",)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    writer.seal("aborted")
    assert Run(writer.path).verify() == []
    assert sum(1 for _ in Run(writer.path).lines()) == 1 + 4 * 21


# what is changed is seen


def test_a_sound_run_has_no_problems(runs: Runs) -> None:
    assert filled(runs).verify() == []


def test_any_flipped_byte_is_found(runs: Runs) -> None:
    run = filled(runs)
    rng = random.Random(4)
    for path in sorted(p for p in run.path.rglob("*") if p.is_file() and p.stat().st_size):
        whole = path.read_bytes()
        places = (
            range(len(whole)) if len(whole) < 100 else sorted({0, len(whole) - 1, *rng.sample(range(len(whole)), 150)})
        )
        for place in places:
            path.write_bytes(whole[:place] + bytes([whole[place] ^ rng.randint(1, 255)]) + whole[place + 1 :])
            assert run.verify(), (path, place)
        path.write_bytes(whole)
    assert run.verify() == []


def test_any_flipped_byte_of_a_run_without_a_seal_is_found(runs: Runs) -> None:
    run = filled(runs)
    (run.path / "seal.json").unlink()
    path = run.path / "journal.jsonl"
    whole = path.read_bytes()
    for place in [*range(0, len(whole), 7), len(whole) - 1]:
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x15]) + whole[place + 1 :])
        assert run.verify(), place


def test_lines_removed_put_in_or_moved_are_found(runs: Runs) -> None:
    run = filled(runs)
    (run.path / "seal.json").unlink()
    path = run.path / "journal.jsonl"
    lines, sound = path.read_bytes().splitlines(keepends=True), list(run.lines())
    for changed in (
        lines[:2] + lines[3:],
        [*lines[:2], lines[1], *lines[2:]],
        [lines[0], lines[2], lines[1], *lines[3:]],
        lines[1:],
    ):
        path.write_bytes(b"".join(changed))
        assert run.verify()
        assert run.status == "damaged"
        assert Run(run.path).summary()["status"] == "damaged"
        if changed[0] == lines[0]:  # what stands before the damage is read, and nothing behind it
            assert [entry.kind for entry in run.lines()] == [entry.kind for entry in sound[: len(list(run.lines()))]]
            assert 0 < len(list(run.lines())) < len(sound)
        else:
            with pytest.raises(ArchiveError, match=r"journal\.jsonl: line 1: found"):
                next(Run(run.path).lines())


def test_lines_cut_off_the_end_of_a_sealed_run_are_found(runs: Runs) -> None:
    run = filled(runs)
    path = run.path / "journal.jsonl"
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:-1]))
    assert any("another journal than the sealed one" in problem for problem in run.verify())


def test_every_missing_or_changed_block_is_named(runs: Runs) -> None:
    run = filled(runs)
    (run.path / "blocks" / "static.u2").unlink()
    (run.path / "blocks" / "record-0000.u2").write_bytes(b"short")
    assert run.verify() == [
        "blocks/static.u2: found No such file or directory, wanted the block of line 2",
        "blocks/record-0000.u2: found contents that do not match line 4, wanted them as written",
    ]
    with pytest.raises(ArchiveError, match="found no file, wanted 12 bytes"):
        run.block("static")
    with pytest.raises(ArchiveError, match="found 5 bytes, wanted 16 bytes"):
        run.block("record")
    with pytest.raises(BadInput, match="found no block 'none'"):
        run.block("none")


def test_a_changed_line_of_a_sealed_run_costs_what_stands_behind_it(runs: Runs) -> None:
    run = filled(runs)
    path = run.path / "journal.jsonl"
    whole = path.read_bytes()
    at = whole.index(b'"frequency":40.0')
    path.write_bytes(whole[:at] + b'"frequency":41.0' + whole[at + 16 :])
    assert (run.status, run.summary()["points_done"], set(run.points())) == ("damaged", 1, {0})
    begins = whole.rindex(b"\n", 0, at) + 1
    assert any(f"line {whole[:at].count(10) + 1}, from byte {begins}: found" in problem for problem in run.verify())
    assert [one.name for one in runs.list()] == [run.name]


def test_a_seal_from_another_run_is_found(runs: Runs) -> None:
    one, other = filled(runs), filled(runs)
    shutil.copy(other.path / "seal.json", one.path / "seal.json")
    assert any("another journal" in problem for problem in one.verify())


def test_a_damaged_run_is_listed_as_damaged(runs: Runs) -> None:
    run, other = filled(runs), filled(runs)
    (run.path / "seal.json").write_text("{}")
    (other.path / "journal.jsonl").write_text("garbage\n")
    assert run.status == "damaged"
    summary = other.summary()
    assert (summary["status"], summary["points_done"], summary["procedure"]) == ("damaged", None, None)
    assert {r.name for r in runs.list()} == {run.name, other.name}
    assert "seal.json: found no digest at the end of the line, wanted one" in run.verify()


def test_what_was_not_met_is_kept_beside_the_sealed_run_and_damage_to_that_costs_nothing_else(runs: Runs) -> None:
    run = filled(runs)
    run.keep_unmet(["expect a: found 2, wanted 1"])
    assert (run.summary()["unmet"], run.verify()) == (["expect a: found 2, wanted 1"], [])
    (run.path / "unmet.json").write_text("{")
    assert (run.status, run.unmet) == ("completed", ())


# what is promised of the disk


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the system is asked to do with files, as it goes on."""
    done: list[str] = []

    def watched(name: str) -> None:
        real = getattr(os, name)

        def call(first: Any, *rest: Any) -> Any:
            path = first if isinstance(first, Path) else Path(os.readlink(f"/proc/self/fd/{first}"))
            done.append(f"{name} {path.name}")
            return real(first, *rest)

        monkeypatch.setattr(os, name, call)

    for name in ("write", "fsync", "rename"):
        watched(name)
    return done


def test_a_block_is_on_the_disk_before_the_journal_names_it(writer: RunWriter, asked: list[str]) -> None:
    writer.block("a", np.zeros(3, np.uint16))
    assert asked == [
        "write .a.u2.part", "fsync .a.u2.part", "rename .a.u2.part", "fsync blocks", "write journal.jsonl"
    ]  # fmt: skip


def test_the_journal_is_on_the_disk_before_the_seal(writer: RunWriter, asked: list[str]) -> None:
    writer.note("a line")
    writer.seal("aborted")
    assert asked[:3] == ["write journal.jsonl", "fsync journal.jsonl", "write .seal.json.part"]


def test_a_line_of_the_journal_is_put_on_the_disk_without_being_asked(
    writer: RunWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, synced = os.fdatasync, threading.Event()

    def watched(descriptor: int) -> None:
        real(descriptor)
        if Path(os.readlink(f"/proc/self/fd/{descriptor}")) == writer.path / "journal.jsonl":
            synced.set()

    monkeypatch.setattr(os, "fdatasync", watched)
    writer.note("a line", text="that a power cut must not cost")
    assert synced.wait(20.0)  # half a second, on a machine that has time


# when things go wrong

VICTIM = """
    import sys, numpy as np
    from pathlib import Path
    from rig.archive.runs import Runs
    writer = Runs(Path(sys.argv[1])).create("noise", {"points_total": 1000000, "simulated": True})
    stream = writer.block_stream("stream")
    for i in range(1_000_000):
        reference = writer.block(f"b{i}", np.full((500, 16), i, np.uint16))
        print("block", reference.file, reference.sha256, flush=True)
        print("line", writer.point_done(i, {"value": i}), flush=True)
        stream.append(np.full((20_000, 16), i, np.uint16))
"""


def at_once(runs: Runs) -> bool:
    return True


def while_a_block_is_written(runs: Runs) -> bool:
    return any(
        name.endswith(".part") and name.startswith(".b") for name in os.listdir(runs.open("last").path / "blocks")
    )


def while_a_long_record_is_written(runs: Runs) -> bool:
    return any(path.stat().st_size > 0 for path in (runs.open("last").path / "blocks").glob(".stream*"))


def killed(runs: Runs, acknowledgements: int, moment: Callable[[Runs], bool]) -> list[list[str]]:
    """Start a writer and kill it at a moment after so many acknowledgements; returns what it had acknowledged."""
    command = [sys.executable, "-c", textwrap.dedent(VICTIM), str(runs.root)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as victim:
        assert victim.stdout is not None
        said = [victim.stdout.readline() for _ in range(acknowledgements)]
        while victim.poll() is None and not moment(runs):
            said.append(victim.stdout.readline())
        victim.kill()
        said += victim.stdout.readlines()
    assert victim.returncode == -signal.SIGKILL
    return [line.split() for line in said if line.endswith("\n")]


@pytest.mark.parametrize("moment", [at_once, while_a_block_is_written, while_a_long_record_is_written])
def test_a_writer_killed_at_any_moment_loses_nothing_it_acknowledged(
    tmp_path: Path, moment: Callable[[Runs], bool]
) -> None:
    for attempt in range(4):
        runs = Runs(tmp_path / str(attempt))
        said = killed(runs, 1 + 7 * attempt, moment)
        run = runs.open("last")
        assert run.status == "interrupted"
        assert run.verify() == []
        digests = {reference.file: reference.sha256 for pieces in run.blocks().values() for reference in pieces}
        assert all(digests[words[1]] == words[2] for words in said if words[0] == "block")
        numbers = {entry.n for entry in run.lines()}
        assert all(int(words[1]) in numbers for words in said if words[0] == "line")
        for index in run.points():
            np.testing.assert_array_equal(run.block(f"b{index}"), np.full((500, 16), index, np.uint16))
        with runs.reopen("last") as again:
            again.point_done(10**6, {})
            again.seal("aborted")
        assert run.verify() == []


FULL = """
    import resource, sys, numpy as np
    from pathlib import Path
    from rig.archive.runs import Runs
    from rig.errors import ArchiveError
    with Runs(Path(sys.argv[1])).create("noise", {"simulated": True}) as writer:
        writer.block("before", np.arange(1000.0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
        stream = writer.block_stream("record")
        for write in (lambda: writer.block("large", np.zeros(10_000)), lambda: stream.append(np.zeros((10_000, 2)))):
            try:
                write()
            except ArchiveError as error:
                print(error)
        stream.close()
        try:
            while True:
                writer.note("filler", text="x" * 700)
        except ArchiveError as error:
            print(error)
        writer.note("small")
        writer.seal("failed", "the disk is full")
"""


def test_a_file_that_may_not_grow_ends_the_run_in_order_with_all_that_was_closed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", textwrap.dedent(FULL), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    large, record, line = done.stdout.splitlines()
    assert "blocks/large.f8: found a full disk" in large
    assert "blocks/record-0000.f8: found a full disk" in record
    assert "journal.jsonl: found a full disk" in line
    run = Runs(tmp_path).open("last")
    assert run.status == "failed"
    assert run.verify() == []
    assert list(run.lines())[-1].kind == "small"
    np.testing.assert_array_equal(run.block("before"), np.arange(1000.0))
    assert [path.name for path in (run.path / "blocks").iterdir()] == ["before.f8"]


def test_a_full_disk_is_an_archive_error_and_the_run_goes_on(writer: RunWriter) -> None:
    """The kernel's own full device stands in for the file."""
    (writer.path / "blocks" / ".a.f8.part").symlink_to("/dev/full")
    with pytest.raises(ArchiveError, match=r"blocks/a\.f8: found a full disk \(No space left on device\), wanted room"):
        writer.block("a", np.zeros(100_000))
    (writer.path / ".seal.json.part").symlink_to("/dev/full")
    with pytest.raises(ArchiveError, match=r"seal\.json: found a full disk"):
        writer.seal("failed")
    writer.note("still here")
    writer.seal("failed")
    assert Run(writer.path).verify() == []


def test_a_folder_that_vanishes_is_an_archive_error(writer: RunWriter) -> None:
    shutil.rmtree(writer.path)
    with pytest.raises(ArchiveError, match="found no such folder"):
        writer.note("a")
    with pytest.raises(ArchiveError, match="found no such folder"):
        writer.block("a", np.zeros(3))
    with pytest.raises(ArchiveError, match="found no such folder"):
        writer.seal("failed")


def test_a_journal_that_somebody_else_writes_to_is_an_archive_error(writer: RunWriter) -> None:
    with open(writer.path / "journal.jsonl", "ab") as file:
        file.write(b"hello\n")
    with pytest.raises(ArchiveError, match="changed by somebody else"):
        writer.note("a")


def test_a_place_where_no_folder_can_be_made_is_an_archive_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for root in (tmp_path / "file" / "runs", tmp_path / "file", Path("/proc/runs")):
        with pytest.raises(ArchiveError, match="wanted"):
            Runs(root).create("noise", {})


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_an_archive_error(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ArchiveError, match="cannot be written"):
        Runs(tmp_path).create("noise", {})


def test_ctrl_c_between_writing_and_counting_does_not_break_the_chain(writer: RunWriter) -> None:
    """The line is in the file, and the interrupt came before it was counted."""
    counted = writer._written
    writer.point_done(0, {"x": 1})
    pending = writer._written
    writer._written, writer._pending = counted, _Line("point", {"x": 1, "index": 0}, pending)
    writer.point_done(1, {})
    writer.seal("completed")
    assert Run(writer.path).verify() == []


def test_no_file_descriptor_is_left_behind(runs: Runs) -> None:
    def count() -> int:
        return len(os.listdir("/proc/self/fd"))

    before = count()
    for _ in range(3):
        filled(runs).verify()
        runs.create("noise", {}).close()
        runs.reopen("last").close()
        with pytest.raises(BadInput):
            runs.reopen(runs.list()[0].name)
    assert count() == before


def test_a_limit_on_descriptors_is_an_archive_error(runs: Runs, writer: RunWriter) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir("/proc/self/fd")) - 1, hard))
    try:
        with pytest.raises(ArchiveError, match=os.strerror(errno.EMFILE)):
            writer.block("a", np.zeros(3))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    writer.block("a", np.zeros(3))


# the state machine


class RunStates(RuleBasedStateMachine):
    """A run written, interrupted, torn, resumed and sealed in any order keeps all that was acknowledged."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None)
        self.runs = Runs(Path(self.folder.name))
        self.writer: RunWriter | None = self.runs.create("noise", {"points_total": 3})
        self.path = self.writer.path
        self.kinds = ["header"]
        self.points: dict[int, int] = {}
        self.blocks: dict[str, np.ndarray] = {}
        self.sealed: str | None = None

    @precondition(lambda self: self.writer)
    @rule(kind=st.sampled_from(["asked", "confirmed"]), text=st.text(max_size=5))
    def note(self, kind: str, text: str) -> None:
        assert self.writer is not None
        self.writer.note(kind, text=text)
        self.kinds.append(kind)

    @precondition(lambda self: self.writer)
    @rule(index=st.integers(0, 2), value=st.integers())
    def point(self, index: int, value: int) -> None:
        assert self.writer is not None
        self.writer.point_done(index, {"value": value})
        self.kinds.append("point")
        self.points[index] = value

    @precondition(lambda self: self.writer)
    @rule(name=st.sampled_from(["a", "b"]), rows=st.integers(0, 5), value=st.integers(0, 65535))
    def block(self, name: str, rows: int, value: int) -> None:
        assert self.writer is not None
        self.blocks[name] = np.full((rows, 2), value, np.uint16)
        self.writer.block(name, self.blocks[name])
        self.kinds.append("block")

    @precondition(lambda self: self.writer)
    @rule()
    def interrupt(self) -> None:
        assert self.writer is not None
        self.writer.close()
        self.writer = None

    @precondition(lambda self: self.writer is None and self.sealed is None)
    @rule(torn=st.sampled_from([b"", b"{", b'{"n":1,"kind":"point"', b"\0\0\0", b"\r"]))
    def resume(self, torn: bytes) -> None:
        with open(self.path / "journal.jsonl", "ab") as file:
            file.write(torn)
        self.writer = self.runs.reopen("last")
        self.kinds.append("resumed")
        assert self.writer.points_done == set(self.points)

    @precondition(lambda self: self.sealed is not None)
    @rule()
    def refuse_to_resume(self) -> None:
        with pytest.raises(BadInput):
            self.runs.reopen("last")

    @precondition(lambda self: self.writer)
    @rule(status=st.sampled_from(["completed", "failed", "aborted"]))
    def seal(self, status: Any) -> None:
        assert self.writer is not None
        if status == "completed" and len(self.points) < 3:
            with pytest.raises(ArchiveError):
                self.writer.seal(status)
            return
        self.writer.seal(status)
        self.writer, self.sealed = None, status

    @invariant()
    def everything_acknowledged_reads_back(self) -> None:
        run = self.runs.open("last")
        assert run.status == (self.sealed or ("running" if self.writer else "interrupted"))
        assert run.verify() == []
        assert [entry.kind for entry in run.lines()] == self.kinds
        assert {index: body["value"] for index, body in run.points().items()} == self.points
        assert run.summary()["points_done"] == len(self.points)
        for name, array in self.blocks.items():
            np.testing.assert_array_equal(run.block(name), array)

    def teardown(self) -> None:
        if self.writer is not None:
            self.writer.close()
        self.folder.cleanup()


RunStates.TestCase.settings = settings(max_examples=30, stateful_step_count=20, deadline=None)
TestRunStates = RunStates.TestCase


def test_the_summary_is_json(runs: Runs) -> None:
    run = filled(runs)
    assert json.loads(json.dumps(run.summary())) == run.summary()
