"""Foreign files as numbers: CSV, NPY, NPZ, MAT v5 and HDF5; bytes in, named columns out.

    columns(raw, "csv", ("t_s", "gyro_z"), Csv(delimiter=";"))      # float64, (n, 2), rows as they stand in the file

CSV columns have the names of their header line, or "1", "2", … without one. In an array file a column is `variable` if
that is one row or one column of numbers, `variable[3]` for column 3 (from 0) of a table, `variable[3,:]` for its row 3.
An NPY file's only variable is called `array`. Fields of structures and groups are `group/dataset` (HDF5) and
`structure.field` (MAT). An empty cell of a CSV is not a number (NaN), and so is whatever calls itself NaN there.
"""

from __future__ import annotations

import csv
import difflib
import io
import itertools
import json
import re
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

Array = NDArray[np.float64]
Format = Literal["csv", "npy", "npz", "mat", "hdf5"]
FORMATS: Mapping[str, Format] = {
    ".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv", ".lvm": "csv", ".npy": "npy", ".npz": "npz",
    ".mat": "mat", ".h5": "hdf5", ".hdf5": "hdf5", ".hdf": "hdf5",
}  # fmt: skip
NOT_A_NUMBER = frozenset(("", "nan", "na", "n/a", "null", "none"))
_PICK = re.compile(r"(.*)\[(?:(\d+)|:,\s*(\d+)|(\d+),\s*:)\]")


@dataclass(frozen=True)
class Csv:
    """How a text file is written. A `delimiter` of one blank means any run of blanks and tabs."""

    delimiter: str = ","
    comment: str = "#"
    header: bool = True
    decimal: str = "."


PLAIN = Csv()


def format_of(name: str) -> Format:
    """The format that a file's name ends in; BadInput for another ending."""
    ending = "." + name.rpartition(".")[2].lower()
    if ending not in FORMATS:
        known = ", ".join(FORMATS)
        raise BadInput(f"found the ending '{ending}', wanted one of {known}, or `reading: {{format: …}}`")
    return FORMATS[ending]


def names(raw: bytes, form: Format, how: Csv = PLAIN) -> tuple[str, ...]:
    """Every column that the file has. BadInput if it cannot be read."""
    if form == "csv":
        return _Lines(raw, how).names
    return tuple(name for name, array in _arrays(raw, form).items() for name in _columns_of(name, array))


def columns(raw: bytes, form: Format, wanted: Sequence[str], how: Csv = PLAIN) -> Array:
    """The wanted columns, (n, len(wanted)). BadInput: unreadable, no such column, unequal lengths, not numbers."""
    if form == "csv":
        return _csv_columns(_Lines(raw, how), wanted)
    arrays = _arrays(raw, form)
    picked = [_pick(arrays, name) for name in wanted]
    lengths = {name: len(column) for name, column in zip(wanted, picked, strict=True)}
    if len(set(lengths.values())) > 1:
        said = ", ".join(f"{name} with {n}" for name, n in lengths.items())
        raise BadInput(f"found columns of unequal length ({said}), wanted one length")
    return np.column_stack(picked)


class _Lines:
    """The lines of a text file: where its data begin, and what its columns are called."""

    def __init__(self, raw: bytes, how: Csv) -> None:
        self.how, self.text = how, _decoded(raw)
        self.lines = self.text.splitlines()
        self.first, self.names = self._begin()

    def rows(self, skip: int) -> Iterator[tuple[int, list[str]]]:
        """Cells of every line that is neither empty nor a comment, from line `skip` on, with the line's number."""
        for number, line in enumerate(itertools.islice(self.lines, skip, None), skip + 1):
            if line.strip() and not (self.how.comment and line.lstrip().startswith(self.how.comment)):
                yield number, self._cells(line)

    def _cells(self, line: str) -> list[str]:
        if self.how.delimiter == " ":
            return line.split()
        return [cell.strip() for cell in next(csv.reader([line], delimiter=self.how.delimiter))]

    def _begin(self) -> tuple[int, tuple[str, ...]]:
        """Lines before the first row of data, and the columns' names."""
        number, cells = next(self.rows(0), (0, []))
        if not cells:
            raise BadInput("found no line of data, wanted some")
        if self.how.header:
            return number, tuple(cells)
        return number - 1, tuple(str(k) for k in range(1, len(cells) + 1))


def _decoded(raw: bytes) -> str:
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" in raw:
            raise BadInput("found bytes that are no text, wanted a CSV file") from None
        return raw.decode("latin-1")


def _csv_columns(lines: _Lines, wanted: Sequence[str]) -> Array:
    places = [_place(lines.names, name) for name in wanted]
    fast = _fast(lines, places)
    return fast if fast is not None else _careful(lines, places, wanted)


def _place(there: Sequence[str], name: str) -> int:
    if there.count(name) > 1:
        raise BadInput(f"found {there.count(name)} columns named '{name}', wanted one")
    if name not in there:
        raise BadInput(no_column(name, there))
    return there.index(name)


def no_column(name: str, there: Sequence[str]) -> str:
    """What to say of a column that is not there."""
    near = difflib.get_close_matches(name, there, n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    listed = ", ".join(repr(one) for one in there[:12]) + (", …" if len(there) > 12 else "")
    if len(there) == 1 and (sign := next((one for one in ";\t|," if one in there[0]), "")):
        hint = f"; the file looks as if `reading: {{delimiter: {json.dumps(sign)}}}` would cut it"
    return f"found no column '{name}', wanted one of {listed}{hint}"


def _fast(lines: _Lines, places: Sequence[int]) -> Array | None:
    """The numbers as numpy reads them; None where a cell is empty or odd, which needs a closer look."""
    how = lines.how
    if how.decimal != "." or next(lines.rows(lines.first), None) is None:
        return None
    try:
        values = np.loadtxt(
            lines.lines, np.float64, delimiter=None if how.delimiter == " " else how.delimiter,
            comments=how.comment or None, skiprows=lines.first, usecols=places, ndmin=2, quotechar='"',
        )  # fmt: skip
    except ValueError:
        return None
    return values


def _careful(lines: _Lines, places: Sequence[int], wanted: Sequence[str]) -> Array:
    """Cell by cell, with the line of what is no number."""
    rows = [
        [_number(cells, place, name, number, lines.how) for place, name in zip(places, wanted, strict=True)]
        for number, cells in lines.rows(lines.first)
    ]
    if not rows:
        raise BadInput("found a header and no row of data, wanted some")
    return np.array(rows, np.float64)


def _number(cells: list[str], place: int, name: str, line: int, how: Csv) -> float:
    if place >= len(cells):
        raise BadInput(f"line {line}: found {len(cells)} cells, wanted at least {place + 1} (for '{name}')")
    text = cells[place]
    if text.lower() in NOT_A_NUMBER:
        return float("nan")
    try:
        if "_" in text:  # Python's own spelling of thousands
            raise ValueError
        return float(text.replace(how.decimal, ".") if how.decimal != "." else text)
    except ValueError:
        hint = '; for a decimal comma say `reading: {decimal: ","}`' if re.fullmatch(r"[-+]?\d+,\d+", text) else ""
        raise BadInput(f"line {line}: found '{text}' in column '{name}', wanted a number{hint}") from None


def _arrays(raw: bytes, form: str) -> dict[str, NDArray[Any]]:
    """Every array of numbers in a file, by name."""
    readers = {"npy": _npy, "npz": _npz, "mat": _mat, "hdf5": _hdf5}
    found = {name: array for name, array in readers[form](raw) if array.dtype.kind in "biuf" and 0 < array.ndim < 3}
    if not found:
        raise BadInput("found no array of numbers with one or two dimensions, wanted some")
    return found


def _npy(raw: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    try:
        yield from _fields("array", np.load(io.BytesIO(raw), allow_pickle=False))
    except (ValueError, EOFError, OSError) as error:
        raise BadInput(f"found no NPY file of plain numbers ({error})") from error


def _npz(raw: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    try:
        with np.load(io.BytesIO(raw), allow_pickle=False) as archive:
            for name in archive.files:
                yield from _fields(name, archive[name])
    except (ValueError, EOFError, OSError, AttributeError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        raise BadInput(f"found no NPZ file of plain numbers ({error})") from error


def _fields(name: str, array: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """A structured array as its fields, any other as it is."""
    if array.dtype.names is None:
        yield name, array
    else:
        yield from ((f"{name}.{field}", array[field]) for field in array.dtype.names)


def _mat(raw: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        found = loadmat(cast(Any, io.BytesIO(raw)), simplify_cells=True)  # its stubs know paths only
    except NotImplementedError as error:
        wanted = "wanted `reading: {format: hdf5}`, with columns such as `gyro[2,:]`"
        raise BadInput(f"found MAT version 7.3, which is HDF5, {wanted}") from error
    except (MatReadError, ValueError, TypeError, KeyError, IndexError, OSError, EOFError, zlib.error) as error:
        raise BadInput(f"found no MAT file of version 5 ({error})") from error
    yield from _nested("", {name: value for name, value in found.items() if not name.startswith("__")})


def _nested(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _nested(f"{name}.{key}" if name else str(key), part)
    elif isinstance(value, np.ndarray):
        yield name, value


def _hdf5(raw: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    import h5py

    found: dict[str, NDArray[Any]] = {}

    def keep(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.shape:
            found.update(_fields(name, np.asarray(item[()])))

    try:
        with h5py.File(io.BytesIO(raw), "r") as file:
            file.visititems(keep)
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise BadInput(f"found no HDF5 file that can be read ({error})") from error
    yield from found.items()


def _columns_of(name: str, array: NDArray[Any]) -> list[str]:
    if array.ndim == 1 or 1 in array.shape:
        return [name]
    rows, width = array.shape
    if rows < width:  # written with samples side by side, as MATLAB's users and HDF5 exports of it do
        return [f"{name}[{k},:]" for k in range(rows)]
    return [f"{name}[{k}]" for k in range(width)]


def _pick(arrays: Mapping[str, NDArray[Any]], name: str) -> Array:
    if name in arrays:
        array = arrays[name]
        if array.ndim == 2 and 1 not in array.shape:
            rows, width = array.shape
            raise BadInput(f"found '{name}' with {rows} rows and {width} columns, wanted one such as '{name}[0]'")
        return np.asarray(array, np.float64).reshape(-1)
    parts = _PICK.fullmatch(name)
    if parts is None or parts[1] not in arrays:
        raise BadInput(no_column(name, [n for key, array in arrays.items() for n in _columns_of(key, array)]))
    array, across = arrays[parts[1]], parts[4] is not None
    table = np.asarray(array if array.ndim == 2 else array.reshape(-1, 1), np.float64)
    table = table.T if across else table
    number = int(parts[2] or parts[3] or parts[4] or 0)
    if number >= table.shape[1]:
        raise BadInput(f"found {table.shape[1]} of them in '{parts[1]}', wanted '{name}' (they are counted from 0)")
    return table[:, number]
