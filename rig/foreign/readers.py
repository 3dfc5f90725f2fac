"""Foreign files as numbers: CSV, NPY, NPZ, MAT v5 and HDF5; bytes in, named columns out.

    columns(raw, "csv", ("t_s", "gyro_z"), Csv(delimiter=";"))      # float64, (n, 2), rows as they stand in the file

CSV columns have the names of their header line, or "1", "2", … without one. In an array file a column is `variable` if
that is one row or one column of numbers, `variable[3]` for column 3 (from 0) of a table, `variable[3,:]` for its row 3.
An NPY file's only variable is called `array`. Fields of structures and groups are `group/dataset` (HDF5) and
`structure.field` (MAT). An empty cell of a CSV is not a number (NaN), and so is whatever calls itself NaN there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.foreign import enclosed, text_files
from rig.foreign.text_files import Columns, Csv, no_column

__all__ = ["Columns", "Csv", "Format", "columns", "format_of", "names", "no_column", "read"]

Array = NDArray[np.float64]
Format = Literal["csv", "npy", "npz", "mat", "hdf5"]
FORMATS: Mapping[str, Format] = {
    ".csv": "csv", ".txt": "csv", ".tsv": "csv", ".dat": "csv", ".lvm": "csv", ".npy": "npy", ".npz": "npz",
    ".mat": "mat", ".h5": "hdf5", ".hdf5": "hdf5", ".hdf": "hdf5",
}  # fmt: skip
PLAIN = Csv()
_PICK = re.compile(r"(.*)\[(?:(\d+)|:,\s*(\d+)|(\d+),\s*:)\]")


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
        return text_files.names(raw, how)
    return tuple(name for name, array in _arrays(raw, form).items() for name in _columns_of(name, array))


def columns(raw: bytes, form: Format, wanted: Sequence[str], how: Csv = PLAIN) -> Array:
    """The wanted columns, (n, len(wanted)). BadInput: unreadable, no such column, unequal lengths, not numbers."""
    return read(raw, form, wanted, how).values


def read(raw: bytes, form: Format, wanted: Sequence[str], how: Csv = PLAIN) -> Columns:
    """The same with what is to be said of a text file's lines."""
    if form == "csv":
        return text_files.columns(raw, wanted, how)
    arrays = _arrays(raw, form)
    picked = [_pick(arrays, name) for name in wanted]
    lengths = {name: len(column) for name, column in zip(wanted, picked, strict=True)}
    if len(set(lengths.values())) > 1:
        said = ", ".join(f"{name} with {n}" for name, n in lengths.items())
        raise BadInput(f"found columns of unequal length ({said}), wanted one length")
    return Columns(np.column_stack(picked))


def _arrays(raw: bytes, form: str) -> dict[str, NDArray[Any]]:
    """Every array of numbers in a file, by name."""
    found = {name: array for name, array in enclosed.arrays(raw, form) if 0 < array.ndim < 3}
    if not found:
        raise BadInput("found no array of numbers with one or two dimensions, wanted some")
    return found


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
