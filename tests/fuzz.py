"""Every reader of what comes from outside, given inputs that are nearly right: it reads them, or refuses deliberately.

`make fuzz` (N=…, ONLY=…) feeds every reader of the program with changed copies of what it reads in earnest. What a
reader may raise is named with it; anything else, more than two seconds for one input, or more than 500 MB is a defect.
The inputs that found one are kept in `tests/corpus`, a folder for each reader, and are read in every test run.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import itertools
import json
import os
import random
import resource
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import IO, Any

import pages

from drivers import das16jr, hp54542a, links, ofv3001, sensor_cube
from fixtures import prologix, scpi
from rig.archive import journal
from rig.archive.reader import Run
from rig.archive.runs import Runs
from rig.errors import RigError, SettingRefused

ROOT = Path(__file__).parents[1]
CORPUS = Path(__file__).parent / "corpus"
SLOWEST = 2.0  # s for one input
OF_A_FIT = 20.0  # s, where a sound input takes four
MEMORY = 500_000_000  # bytes beyond what the process has when it begins
LONGEST = 6  # changes to one input
FRAMES = 20  # in one stream
FOLDERS = {
    "bench": "configs/benches",
    "sensor": "configs/sensors",
    "standard": "configs/standards",
    "manifest": "configs/imports",
}


@dataclass(frozen=True)
class Reader:
    """`read` takes bytes; it may raise `refuses`. `seeds` are right inputs; `weight` is its share of the inputs."""

    name: str
    read: Callable[[bytes], object]
    seeds: Callable[[], Sequence[bytes]]
    refuses: tuple[type[Exception], ...] = ()
    weight: float = 1.0
    words: Sequence[bytes] = field(default=())  # that change meaning more often than random bytes do
    slowest: float = SLOWEST


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "surrogateescape")


@cache
def _facts() -> Any:
    from rig.bench.benchfile import describe
    from rig.yaml.config import shipped

    return describe(shipped("benches/simulated.yaml")).facts()


def _procedure(raw: bytes) -> None:
    from rig.bench import procedure_file
    from rig.yaml import document

    procedure_file.plan(document.read_text(_text(raw), "fuzz.yaml"), _facts())


def _config(raw: bytes) -> None:
    """A file of the kind that its first line names."""
    from rig.foreign import manifest_file
    from rig.foreign.manifest import Manifest
    from rig.yaml import config, document

    kind, _, text = raw.partition(b"\n")
    if kind.decode("latin-1") in FOLDERS:
        read = document.read_text(_text(text), "fuzz.yaml")
        made = config.validate(read, pages.MODELS[kind.decode("latin-1")]())
        if isinstance(made, Manifest):
            list(manifest_file.mistakes(read, made))


def _journal(raw: bytes) -> None:
    list(journal.entries(raw))


def _frames(raw: bytes) -> None:
    """In pieces, as they come."""
    parser = das16jr.FrameParser()
    for at in range(0, len(raw), 97):
        for frame in parser.feed(raw[at : at + 97]):
            assert frame.codes.dtype.itemsize == 2 or frame.kind != das16jr.SAMPLES


def _cube(raw: bytes) -> None:
    parser = sensor_cube.FrameParser()
    for at in range(0, len(raw), 13):
        parser.feed(raw[at : at + 13])
    assert parser.bad >= 0


def _cobs(raw: bytes) -> None:
    decoded = sensor_cube.cobs_decode(raw)
    assert sensor_cube.cobs_decode(sensor_cube.cobs_encode(decoded)) == decoded


def _block(raw: bytes) -> None:
    span = links.block_span(raw)
    assert span is None or 2 <= span[0] <= span[1]


def _preamble(raw: bytes) -> None:
    said = raw.decode("latin-1")
    hp54542a.to_volts(bytes(64), hp54542a.parse_preamble(said))


def _vibrometer(raw: bytes) -> None:
    for query in ofv3001.LIMITS:
        with contextlib.suppress(ValueError):
            ofv3001.parse_reply(query, raw)


def _gateway(raw: bytes) -> None:
    lines = prologix.Lines()
    for at in range(0, len(raw), 7):
        lines.feed(raw[at : at + 7])


def _scpi(raw: bytes) -> None:
    for part in scpi.split_message(raw):
        scpi.parse_unit(part)


def _csv(raw: bytes) -> None:
    from rig.foreign import text_files

    for how in (
        text_files.Csv(),
        text_files.Csv(delimiter=";", decimal=",", units=True),
        text_files.Csv(delimiter=" "),
    ):
        with contextlib.suppress(RigError):
            text_files.columns(raw, text_files.names(raw, how)[:4], how)


def _formula(raw: bytes) -> None:
    from rig.formula import formula_effect, meets, own_term

    text, _, starts = raw.decode("latin-1").partition("|")
    term = own_term(text, [one for one in starts.split("|") if one])
    meets(term.text)
    formula_effect("tried", term.text, on="rate", starts=term.starts, units=term.units)


def _quantity(raw: bytes) -> None:
    from rig import units

    said = _text(raw)
    for kind in units.KINDS:
        with contextlib.suppress(ValueError):
            units.parse(said, kind)


def _service(raw: bytes) -> None:
    """Commands of the converter's service, line by line; each has one answer."""
    service, asker = _board_service()
    for line in raw.decode("latin-1").split("\n")[:50]:
        answer = service.answer(line, asker)
        assert answer.startswith(("OK", "ERR ")), answer
        assert "\n" not in answer


def _board_service() -> tuple[Any, Any]:
    from drivers import daq_service

    class Board:
        name, serial, driver = "pc104-das16jr-16", "1", "fuzz"

        def range(self, gain: int) -> tuple[float, float]:
            if gain not in (0, 1, 2, 3):
                raise SettingRefused("board", "fuzz", sent=str(gain), wanted="0 to 3")
            return -10.0 / 2**gain, 10.0 / 2**gain

        def set_up(self, first: int, last: int, gain: int, scan_ns: int) -> int:
            return max(round(scan_ns / (last - first + 1)), 10_000)

    class Asker:
        peer, hung_up = ("127.0.0.1", 1), False

    return daq_service.Service(Board()), Asker()  # type: ignore[arg-type]


@dataclass
class _Shelf:
    """A run on the disk whose lines are changed and chained anew."""

    folder: Path
    lines: list[dict[str, Any]]


@cache
def _shelf() -> _Shelf:
    import fast_bench

    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    fast_bench.keep({"procedure": "frequency_sweep", "axis": "x", "points": 2}, fast_bench.world(1), folder)
    run = Runs(folder).open("last")
    return _Shelf(run.path, [{"kind": one.kind, "body": one.body, "t": one.t} for one in run.lines()])


def _run(raw: bytes) -> None:
    """A valid chain with odd contents: what shows a run reads it, or says what is wrong with it."""
    from rig.cli import outcome

    run = _odd_run(raw)
    run.summary()
    run.verify()
    outcome.run_as_text(run)


def _modelled(raw: bytes) -> None:
    """The same, for what fits a model to a run's records."""
    from rig.archive.records import Records
    from rig.calibrate.calibrate import calibrate

    calibrate([Records(_odd_run(raw))], "fuzz")


def _odd_run(raw: bytes) -> Run:
    """A run whose journal has these lines, each chained to the one before."""
    shelf, chain, written = _shelf(), journal.GENESIS, b""
    for number, line in enumerate(raw.split(b"\n")):
        try:
            body = json.loads(line)
        except ValueError:
            continue
        if not isinstance(body, dict) or not isinstance(body.get("body"), dict):
            continue
        try:
            data, chain = journal.line(number, body.get("t"), body.get("t"), str(body.get("kind")), body["body"], chain)
        except (TypeError, ValueError, RecursionError):
            continue
        written += data
    (shelf.folder / "journal.jsonl").write_bytes(written)
    (shelf.folder / "seal.json").unlink(missing_ok=True)
    return Run(shelf.folder)


def _enclosed(form: str) -> Callable[[bytes], None]:
    """A reader of binary files in a process of its own: a copy of this one, which is there sooner than a new one."""
    from rig.foreign import enclosed

    def read_there(raw: bytes) -> None:
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile("w+") as said:
            child = os.fork()
            if child == 0:
                _answer_and_end(form, raw, out, said)
            _, status, usage = os.wait4(child, 0)
            took, code = usage.ru_utime + usage.ru_stime, os.waitstatus_to_exitcode(status)
            out.seek(0)
            said.seek(0)
            words = said.read()
            assert code != 1, words.strip().splitlines()[-1]  # what its readers may not raise
            assert took < SLOWEST, f"{form}: {took:.1f} s in the process"
            assert usage.ru_maxrss * 1024 < _resident() + MEMORY, f"{form}: {usage.ru_maxrss} kB in the process"
            for _, array in enclosed.given(form, code, out.read(), words.encode()):
                assert array.dtype.kind in "biuf"

    return read_there


def _answer_and_end(form: str, raw: bytes, out: IO[bytes], said: IO[str]) -> None:
    from rig.foreign import enclosed

    code = 1
    try:
        enclosed.confine(len(raw))
        code = enclosed.answer(form, raw, out, said)
        out.flush()
    except BaseException as error:  # noqa: BLE001 - told to the parent, as the interpreter would
        print(f"{type(error).__name__}: {error}", file=said)
    finally:
        said.flush()
        os._exit(code)


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize()


def _binary_files(form: str) -> Callable[[], list[bytes]]:
    import numpy as np

    from rig.foreign import enclosed

    counts, table = np.arange(40, dtype=np.int16), np.arange(120.0).reshape(3, 40)
    fields = np.zeros(20, [("t", "<f8"), ("gyro", "<i4", (2,))])

    def made() -> list[bytes]:
        enclosed.load(form)
        writers = {"npy": _npy_files, "npz": _npz_files, "mat": _mat_files, "hdf5": _hdf5_files}
        return [file.getvalue() for file in writers[form](counts, table, fields)]

    return made


def _npy_files(*arrays: Any) -> Iterator[io.BytesIO]:
    import numpy as np

    for array in (*arrays, arrays[1].T):
        np.save(file := io.BytesIO(), array)
        yield file


def _npz_files(counts: Any, table: Any, fields: Any) -> Iterator[io.BytesIO]:
    import numpy as np

    for save in (np.savez, np.savez_compressed):
        save(file := io.BytesIO(), counts=counts, table=table, fields=fields)
        yield file


def _mat_files(counts: Any, table: Any, fields: Any) -> Iterator[io.BytesIO]:
    from scipy.io import savemat

    for compressed in (False, True):
        whole = {"t": table, "imu": {"counts": counts, "more": fields, "said": "by hand"}, "cells": [counts, table]}
        savemat(file := io.BytesIO(), whole, do_compression=compressed)
        yield file


def _hdf5_files(counts: Any, table: Any, fields: Any) -> Iterator[io.BytesIO]:
    import h5py

    for more in ({}, {"compression": "gzip", "shuffle": True}, {"chunks": True, "fletcher32": True}):
        with h5py.File(file := io.BytesIO(), "w") as kept:
            kept.create_dataset("imu/gyro", data=table, **more)
            kept.create_dataset("imu/counts", data=counts, **more)
            kept["fields"] = fields
            kept["imu"].attrs["said"] = "by hand"
        yield file


def _seeds_of(pattern: str, prefix: bytes = b"") -> Callable[[], list[bytes]]:
    return lambda: [prefix + path.read_bytes() for path in sorted(ROOT.glob(pattern))]


def _configs() -> list[bytes]:
    return [one for kind, folder in FOLDERS.items() for one in _seeds_of(f"{folder}/*.yaml", f"{kind}\n".encode())()]


def _lines_of_a_journal() -> list[bytes]:
    chain, found = journal.GENESIS, b""
    for number in range(4):
        raw, chain = journal.line(number, 1.0, 2.0, "point", {"index": number, "a": [1.5, "µ", None]}, chain)
        found += raw
    return [found]


def _lines_of_a_run() -> list[bytes]:
    return [b"\n".join(json.dumps(one).encode() for one in _shelf().lines)]


def _stream_of_frames() -> list[bytes]:
    import zlib

    def frame(kind: int, index: int, payload: bytes) -> bytes:
        head = das16jr.HEADER.pack(
            das16jr.MAGIC, das16jr.VERSION, kind, 3, index, 10**9, 20_000, 16, 0, len(payload), 0
        )[:-4]
        return head + zlib.crc32(payload, zlib.crc32(head + bytes(4))).to_bytes(4, "little") + payload

    samples = b"".join(frame(das16jr.SAMPLES, 16 * n, bytes(range(32))) for n in range(FRAMES))
    return [frame(das16jr.METADATA, 0, b"{}") + samples, samples + frame(das16jr.HEARTBEAT, 0, b"")]


def _stream_of_cube() -> list[bytes]:
    said = b"".join(sensor_cube.command(kind, kind) for kind in (1, 2, 3, 4, 5, 6))
    return [said * 3, b"".join(sensor_cube.encode_frame(bytes(range(n, n + 30))) + b"\0" for n in range(FRAMES))]


def _of(*texts: str) -> Callable[[], list[bytes]]:
    return lambda: [one.encode() for one in texts]


def _words(text: str) -> tuple[bytes, ...]:
    return tuple(one.encode("utf-8", "surrogatepass") for one in text.split(" "))


YAML_WORDS = (
    *_words("- : { } [ ] &a *a !!python/object null 1e999 -1 nan inf ~ | ' \" <<: \t \n steps µm \ud7ff \0"),
    b"\n  ",
)
JSON_WORDS = _words('null -1 1e999 "NaN" [] {} "" 0 true 1e-300 "\\ud800"')
FORMULAS = ("k*V**2", "k1*sin(3*theta) + k2*cos(3*theta)|k1=0.1|k2=1", "k*exp(-t/tau)|tau=10 s", "k*u**3*f")
TABLES = ("t,a,b\n0,1,2\n1,2,3\n", "t;a\ns;V\n0,5;1,5\n", "# c\n0 1 2\n3 4 5\n", "LabVIEW Measurement\n")
SERVED = "*IDN?\nCONF:CHAN 0,15\nCONF:RANG 0\nCONF:RATE 3125\nCONF?\nSTAT?\nSYST:ERR?\nABOR"
ASKED = ("OUTP OFF;:OUTP?", "SOUR:FREQ 1 kHz;VOLT 2.5E-1 VPK", "DISP:TEXT 'a;b',#12ab", "INP1:RANG -10 DBM")
POINTS = ("1,2,64,1,1e-5,0,0,4e-3,0,128", "+2,1,32,1,+1.0E-05,0,0,2E-4,1.5,32768")
READERS = (
    Reader("procedure", _procedure, _seeds_of("procedures/*.yaml"), (RigError,), 0.2, YAML_WORDS),
    Reader("config", _config, _configs, (RigError,), 0.2, YAML_WORDS),
    Reader("journal", _journal, _lines_of_a_journal, (journal.BrokenLineError,), 1.0, JSON_WORDS),
    Reader("run", _run, _lines_of_a_run, (RigError,), 0.02, JSON_WORDS),
    Reader("modelled run", _modelled, _lines_of_a_run, (RigError,), 0.004, JSON_WORDS, OF_A_FIT),
    Reader("converter frames", _frames, _stream_of_frames),
    Reader("cube frames", _cube, _stream_of_cube),
    Reader("cobs", _cobs, _of("\x01\x01", "\x03ab\x02c", "\x04abc"), (sensor_cube.FrameError,)),
    Reader("block", _block, _of("#15hello", "#3012xxx", "#9000000001x"), (ValueError,), 1.0, _words("# #0 #9")),
    Reader("preamble", _preamble, _of(*POINTS), (ValueError,), 1.0, _words("nan inf 1e999 - ,")),
    Reader("vibrometer", _vibrometer, _of("5", "VELO5", "VELO 3\r", "LEV12")),
    Reader("gateway", _gateway, _of("++addr 19\n", "*IDN?\n", "OUTP OFF\r\n", "\x1b+\x1b\n")),
    Reader("scpi", _scpi, _of(*ASKED), (scpi.ScpiError,), 1.0, _words("#H # ; : ' \" 1e999")),
    Reader("csv", _csv, _of(*TABLES), (), 0.5, _words('" nan \r 1e999 \ufeff ***End_of_Header*** \0 ,,')),
    Reader("formula", _formula, _of(*FORMULAS), (RigError,), 0.5,
           (*_words("** ( ) lambda:0 __import__ [0] .real if 'a' 1e999 ~"), b"9" * 40)),
    Reader("quantity", _quantity, _of("500 Hz", "33 1/3 rpm", "1e-3 m/s²"), (), 0.5, _words("/ ² e 999 % nan")),
    Reader("converter service", _service, _of(SERVED), (), 0.5,
           _words("-1 1e999 nan 0x10 99999999999999999999 , INIT DATA?")),
    *(Reader(form, _enclosed(form), _binary_files(form), (RigError,), 0.02, (b"\xff" * 4, b"\xff\xff\xff\x7f"))
      for form in ("npy", "npz", "mat", "hdf5")),
)  # fmt: skip


def changed(reader: Reader, count: int, seed: int = 0) -> Iterator[bytes]:
    """Copies of its seeds with a few changes: bytes and words put in, taken out, doubled, exchanged, cut off."""
    chance, seeds = random.Random(f"{reader.name} {seed}"), reader.seeds()
    for _ in range(count):
        raw = bytearray(chance.choice(seeds) if chance.random() < 0.97 else chance.randbytes(40))
        for _ in range(chance.randint(1, LONGEST)):
            _change(raw, chance, reader.words)
        yield bytes(raw)


def _change(raw: bytearray, chance: random.Random, words: Sequence[bytes]) -> None:
    at = chance.randint(0, len(raw))
    end = min(at + chance.choice((1, 1, 2, 4, 16, 200)), len(raw))
    match chance.randrange(6 if words else 5):
        case 0:
            raw[at:end] = b""
        case 1:
            raw[at:end] = chance.randbytes(end - at)
        case 2:
            raw[at:at] = raw[at:end] * chance.choice((1, 2, 50))
        case 3:
            del raw[at:]
        case 4 if at < len(raw):
            raw[at] ^= 1 << chance.randrange(8)
        case _ if words:
            raw[at : chance.choice((at, end))] = chance.choice(words)


def read(reader: Reader, raw: bytes) -> None:
    """One input. Raises AssertionError if it took too long, and whatever the reader may not raise."""
    began = time.process_time()
    with contextlib.suppress(*reader.refuses):
        reader.read(raw)
    took = time.process_time() - began
    assert took < reader.slowest, f"{reader.name}: {took:.1f} s for {raw[:80]!r}"


def kept(reader: Reader) -> list[bytes]:
    """Inputs that once found a defect."""
    return [path.read_bytes() for path in sorted(_corpus(reader).glob("*"))]


def _corpus(reader: Reader) -> Path:
    return CORPUS / reader.name.replace(" ", "-")


@dataclass(frozen=True)
class Defect:
    """What an input did that no input may do; `place` is where, the same for inputs of one defect."""

    place: str
    said: str
    raw: bytes


def fed(reader: Reader, count: int, seed: int = 0) -> dict[str, Defect]:
    """The defects that what is kept, and so many new inputs, find: the shortest input of each, by place."""
    found: dict[str, Defect] = {}
    for raw in itertools.chain(kept(reader), changed(reader, count, seed)):
        try:
            read(reader, raw)
        except Exception as error:  # noqa: BLE001 - which ones there are is what is asked
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{type(error).__name__} in {Path(last.filename).name}, {last.name}"
            if place not in found or len(raw) < len(found[place].raw):
                found[place] = Defect(place, f"{place}: {last.line}: {str(error)[:200]}", raw)
    return found


def _wanted(only: str | None) -> Iterator[Reader]:
    return (one for one in READERS if only in (None, one.name))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000, help="for each reader, times its weight")
    parser.add_argument("--seed", type=int, default=0, help="other inputs")
    parser.add_argument("--only", choices=[one.name for one in READERS])
    asked = parser.parse_args()
    for reader in _wanted(asked.only):
        reader.seeds()
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, -1))
    failed = 0
    for reader in _wanted(asked.only):
        count, began = max(int(asked.inputs * reader.weight), 1), time.monotonic()
        found = fed(reader, count, asked.seed)
        for one in found.values():
            print(f"{one.said}\n    kept in {_keep(reader, one)}")
        print(f"{count:>8} inputs  {time.monotonic() - began:7.1f} s  {len(found)} defects  {reader.name}", flush=True)
        failed += bool(found)
    return 1 if failed else 0


def _keep(reader: Reader, one: Defect) -> Path:
    """The input as a file of the corpus, for every test run from now on."""
    folder = _corpus(reader)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / hashlib.sha256(one.raw).hexdigest()[:12]
    path.write_bytes(one.raw)
    return path


if __name__ == "__main__":
    sys.exit(main())
