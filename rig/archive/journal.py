"""The journal's format, as pure values: JSON lines, each with a digest chained to the line before.

    {"n":3,"t":1793606400.5,"wall":1793606400.7,"kind":"point","body":{…},"chain":"<64 hex digits>"}

`n` counts lines from 0, `t` is the bench's clock and `wall` the machine's (s since 1970 UTC). `chain` is the SHA-256 of
the previous line's chain followed by this line's bytes up to `,"chain"` and a closing brace, so a changed byte shows in
its own line, and a line removed or put in shows in the next. The seal is one more such line, in a file of its own.
"""

from __future__ import annotations

import dataclasses
import datetime as dt
import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any

from rig.errors import ArchiveError

GENESIS = "0" * 64  # what the first line is chained to
_OPENS, _CLOSES = b',"chain":"', b'"}\n'
_NO_JSON = {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}
_SUFFIX = len(_OPENS) + 64 + len(_CLOSES)


class BrokenLineError(ValueError):
    """A line that is not as it was written; the message is `found …, wanted …`."""


class Content(dict[str, Any]):
    """An object of a line. A key that is not there is the record's fault and not the reader's."""

    def __missing__(self, key: str) -> Any:
        """Raises ArchiveError."""
        there = ", ".join(list(self)[:6]) + (", …" if len(self) > 6 else "")
        raise ArchiveError(f"found no '{key}' in a line of the journal that has {there or 'nothing'}, wanted it")


@dataclasses.dataclass(frozen=True)
class Entry:
    """One line of a journal."""

    n: int
    t: float
    wall: float
    kind: str
    body: Mapping[str, Any]
    chain: str


@dataclasses.dataclass(frozen=True)
class BlockRef:
    """A closed file of raw little-endian numbers, as the journal acknowledges it.

    `file` is relative to the run's folder, `dtype` numpy's name such as '<u2', `piece` counts the files of a stream.
    """

    name: str
    file: str
    dtype: str
    shape: tuple[int, ...]
    sha256: str
    meta: Mapping[str, Any]
    piece: int = 0

    @classmethod
    def of(cls, entry: Entry) -> BlockRef:
        """The block that a line of kind `block` acknowledges. Raises ArchiveError if it says something else."""
        try:
            return cls(**{**entry.body, "shape": tuple(map(int, entry.body["shape"]))})
        except (TypeError, ValueError) as error:
            raise ArchiveError(
                f"line {entry.n}: found another block ({error}), wanted name, file, dtype, shape, sha256 and meta"
            ) from None


def line(n: int, t: float, wall: float, kind: str, body: Mapping[str, Any], previous: str) -> tuple[bytes, str]:
    """The bytes of one line, and its chain digest. Numbers that JSON lacks become 'NaN', 'Infinity', '-Infinity'."""
    content = _json({"n": n, "t": t, "wall": wall, "kind": kind, "body": body})
    chain = _digest(previous, content)
    return content[:-1] + _OPENS + chain.encode() + _CLOSES, chain


def read_line(raw: bytes, previous: str, n: int) -> Entry:
    """The line's entry; raises BrokenLineError if it is not exactly what was written as line `n` after `previous`."""
    content, chain = raw[:-_SUFFIX] + b"}", raw[-_SUFFIX + len(_OPENS) : -len(_CLOSES)].decode("latin-1")
    if not (raw.endswith(_CLOSES) and raw[-_SUFFIX:].startswith(_OPENS)):
        raise BrokenLineError("found no digest at the end of the line, wanted one")
    if _digest(previous, content) != chain:
        raise BrokenLineError("found contents that do not match the digest, wanted the line as it was written")
    try:
        entry = Entry(chain=chain, **json.loads(content, object_hook=Content))
    except (ValueError, TypeError) as error:
        raise BrokenLineError(f"found a line of another make ({error}), wanted n, t, wall, kind and body") from None
    if not (_is_time(entry.t) and _is_time(entry.wall) and isinstance(entry.body, Mapping)):
        raise BrokenLineError("found a line of another make, wanted times in seconds and a body of names and values")
    if entry.n != n:
        raise BrokenLineError(f"found line number {entry.n}, wanted {n}")
    return entry


def _is_time(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def claimed_chain(raw: bytes) -> str:
    """The digest that a line carries, right or wrong, so that reading can go on behind a broken line."""
    return raw[-_SUFFIX + len(_OPENS) : -len(_CLOSES)].decode("latin-1")


def split(raw: bytes) -> tuple[list[bytes], bytes]:
    """Complete lines, and the torn rest behind the last line end (empty in a whole journal)."""
    *complete, torn = raw.split(b"\n")
    return [part + b"\n" for part in complete], torn


def entries(raw: bytes) -> Iterator[Entry]:
    """Entries of the complete lines; raises BrokenLineError at the first that is not as it was written."""
    chain = GENESIS
    for n, text in enumerate(split(raw)[0]):
        entry = read_line(text, chain, n)
        chain = entry.chain
        yield entry


def _digest(previous: str, content: bytes) -> str:
    return hashlib.sha256(previous.encode() + content).hexdigest()


def _json(value: Mapping[str, Any]) -> bytes:
    try:
        text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False, default=_plain)
        return text.encode()
    except ValueError:  # a number that JSON lacks, or half a character from a garbled reply
        return json.dumps(_finite(value), separators=(",", ":"), default=_plain).encode()


def _plain(value: Any) -> Any:
    """What JSON has no word for."""
    if isinstance(value, complex):
        return _finite({"re": value.real, "im": value.imag})
    if isinstance(value, bytes):
        return value.decode("latin-1")
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, dt.date):
        return value.isoformat()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, set | frozenset):
        return sorted(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if hasattr(value, "tolist"):  # numpy's scalars and arrays
        return value.tolist()
    raise TypeError(f"a journal line cannot hold a {type(value).__name__}")


def _finite(value: Any) -> Any:
    """The same, with numbers that JSON lacks as text."""
    if isinstance(value, float):
        return value if math.isfinite(value) else _NO_JSON[repr(float(value))]
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value if isinstance(value, str | int | None) else _finite(_plain(value))
