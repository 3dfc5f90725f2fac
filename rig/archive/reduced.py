"""What was reduced from sealed runs, kept beside them in `.cache/`: it can be made again, and may be deleted.

A sealed run never changes, so neither does what is made of its records. A file is named by a digest of everything that
it depends on: the run's seal and journal (with sensor file, bench file and standards in its header), its blocks as they
lie there, the program and its numerical libraries. It holds its own digest, one JSON text and plain arrays; one that
is damaged is made again.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from rig.archive.reader import Run
from rig.archive.records import Experiment, Recorded, Records
from rig.archive.writer import BLOCKS, JOURNAL, SEAL

T = TypeVar("T")
CACHE = ".cache"
PROGRAM = Path(__file__).parents[1]
DIGEST = 64  # hexadecimal digits before the arrays of a file


def reduced(records: Recorded, what: str, kinds: Sequence[type], make: Callable[[], T], *given: object) -> T:
    """What `make` makes of a run's records, made once if the run is sealed.

    `kinds` are the data classes that it may consist of, besides plain values, sequences, mappings and arrays; `given`
    is what else it depends on.
    """
    run = _sealed(records)
    if run is None:
        return make()
    key = _key(run, what, _part(records), *map(repr, given))
    path = run.path.parent / CACHE / run.name / f"{what}-{key}.npz"
    packed = _read(path)
    if packed is None:
        packed = pack(make())
        _write(path, packed)
    found: T = unpack(packed, kinds)  # of what was just made too, so that both ways give the very same
    return found


def _sealed(records: Recorded) -> Run | None:
    """The run of the archive behind records, if it is sealed."""
    whole = records.run if isinstance(records, Experiment) else records
    return whole.run if isinstance(whole, Records) and whole.run.seal is not None else None


def _part(records: Recorded) -> str:
    """Which lines of its run an experiment has."""
    return repr([entry.n for entry in records.lines]) if isinstance(records, Experiment) else ""


def _key(run: Run, *told: str) -> str:
    digest = hashlib.sha256("\0".join((_program(), run.name, *told)).encode())
    for name in (JOURNAL, SEAL):
        digest.update(hashlib.sha256((run.path / name).read_bytes()).digest())
    for item in sorted(os.scandir(run.path / BLOCKS), key=lambda item: item.name):
        status = item.stat()
        digest.update(f"{item.name} {status.st_size} {status.st_mtime_ns}\n".encode())
    return digest.hexdigest()[:32]


@functools.cache
def _program() -> str:
    """Digest of the program's own text and of the libraries that it reckons with."""
    import scipy

    digest = hashlib.sha256(f"{np.__version__} {scipy.__version__}".encode())
    for path in sorted(PROGRAM.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _read(path: Path) -> Mapping[str, NDArray[Any]] | None:
    """The arrays of a file; None without one, or if it is not as it was written."""
    try:
        raw = path.read_bytes()
    except OSError:
        return None
    if hashlib.sha256(raw[DIGEST:]).hexdigest().encode() != raw[:DIGEST]:
        return None
    with np.load(io.BytesIO(raw[DIGEST:]), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _write(path: Path, packed: Mapping[str, NDArray[Any]]) -> None:
    """Put a file in place as a whole, in the place of older ones; a folder that cannot be written to has none."""
    held = io.BytesIO()
    np.savez(held, **packed)  # type: ignore[arg-type]
    raw = held.getvalue()
    part = path.with_name(f".{path.name}.{os.getpid()}")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(hashlib.sha256(raw).hexdigest().encode() + raw)
        os.replace(part, path)
        for old in _older(path):
            old.unlink(missing_ok=True)


def _older(path: Path) -> Iterator[Path]:
    """Files of the same run and name that nothing asks for any more."""
    what = path.name.rpartition("-")[0]
    return (one for one in path.parent.glob(f"{what}-*.npz") if one != path and one.name.rpartition("-")[0] == what)


# values as one JSON text and a flat array for each type of number


def pack(value: Any) -> dict[str, NDArray[Any]]:
    """A value as arrays that `unpack` makes it of again."""
    flat = _Flat({}, {})
    text = json.dumps(_told(value, flat)).encode()
    return {"value": np.frombuffer(text, np.uint8)} | {
        kind: np.concatenate(arrays) for kind, arrays in flat.arrays.items()
    }


@dataclass(frozen=True)
class _Flat:
    """Arrays that will stand one behind the other, by type, and how long they are together."""

    arrays: dict[str, list[NDArray[Any]]]
    lengths: dict[str, int]

    def took(self, array: NDArray[Any]) -> list[Any]:
        """Where an array stands: type, first number, shape."""
        kind = array.dtype.str
        begin = self.lengths.get(kind, 0)
        self.arrays.setdefault(kind, []).append(array.ravel())
        self.lengths[kind] = begin + array.size
        return [kind, begin, list(array.shape)]


def _told(value: Any, flat: _Flat) -> Any:
    """As JSON; arrays go to the flat ones of their type. Raises TypeError for what has no form here."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        return {"array": flat.took(value)}
    if isinstance(value, tuple | list):
        return {type(value).__name__: [_told(one, flat) for one in value]}
    if isinstance(value, Mapping):
        return {"mapping": [[_told(key, flat), _told(one, flat)] for key, one in value.items()]}
    if is_dataclass(value):
        held = {field.name: _told(getattr(value, field.name), flat) for field in fields(value)}
        return {"kind": type(value).__name__, "held": held}
    if isinstance(value, np.generic):
        return {"number": _told(np.asarray(value), flat)}
    raise TypeError(f"found {type(value).__name__}, wanted plain values, arrays and data classes")


def unpack(packed: Mapping[str, NDArray[Any]], kinds: Sequence[type] = ()) -> Any:
    """The value; data classes of these kinds are made as they are everywhere."""
    return _made(json.loads(packed["value"].tobytes()), packed, {kind.__name__: kind for kind in kinds})


def _made(told: Any, packed: Mapping[str, NDArray[Any]], kinds: Mapping[str, type]) -> Any:
    if not isinstance(told, dict):
        return told
    if "kind" in told:
        return kinds[told["kind"]](**{name: _made(one, packed, kinds) for name, one in told["held"].items()})
    ((form, inner),) = told.items()
    match form:
        case "array":
            kind, begin, shape = inner
            return packed[kind][begin : begin + int(np.prod(shape, dtype=np.int64))].reshape(shape)
        case "mapping":
            return {_made(key, packed, kinds): _made(one, packed, kinds) for key, one in inner}
        case "number":
            return _made(inner, packed, kinds)[()]
    values = [_made(one, packed, kinds) for one in inner]
    return tuple(values) if form == "tuple" else values
