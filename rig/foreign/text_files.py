"""Text files of numbers: bytes in, named columns out, and what is to be said of the lines that hold them.

Columns have the names of the header line, or "1", "2", … without one. An empty cell is not a number (NaN), and so is
what calls itself NaN there or stands for a missing number (`--`, `#N/A`). A last line with fewer cells than the others
is cut: it is left out, because nobody knows how many digits its last number had. Both are said.
"""

from __future__ import annotations

import csv
import difflib
import itertools
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

Array = NDArray[np.float64]
NOT_A_NUMBER = frozenset(("", "nan", "na", "n/a", "null", "none"))
MARKS = frozenset(
    ("-", "--", "---", "#n/a", "#na", "#nan", "#num!", "#value!", "#div/0!", "n.a.", "nil", "missing", "?", "*", "***",
     "nan(ind)", "-nan(ind)", "1.#qnan", "1.#ind", "-1.#ind", "1.#inf", "-1.#inf")
)  # fmt: skip
SHOWN = 3  # marks that are named
LABVIEW, END = "LabVIEW Measurement", "***End_of_Header***"  # how an LVM file begins, and how each of its headers ends


@dataclass(frozen=True)
class Csv:
    """How a text file is written. A `delimiter` of one blank means any run of blanks and tabs.

    `skip` lines stand before the one that names the columns (an LVM file's own header needs no number), and with
    `units` a line of units after it.
    """

    delimiter: str = ","
    comment: str = "#"
    header: bool = True
    decimal: str = "."
    skip: int = 0
    units: bool = False


@dataclass(frozen=True)
class Columns:
    """Columns (n, wanted), and sentences on lines that held something else."""

    values: Array
    said: tuple[str, ...] = ()


def preamble(lines: Sequence[str]) -> int:
    """Lines before the table of an LVM file: one header is the file's, one the table's. 0 for other files."""
    if not lines or not lines[0].startswith(LABVIEW):
        return 0
    ends = [number for number, line in enumerate(lines) if line.startswith(END)][:2]
    return ends[-1] + 1 if ends else 0


def names(raw: bytes, how: Csv) -> tuple[str, ...]:
    """Every column that the file has. BadInput if it cannot be read."""
    return _Lines(raw, how).names


def units(raw: bytes, how: Csv) -> tuple[str, ...]:
    """The unit of every column as a line after the names, or an LVM header, states it; () where none does."""
    return _Lines(raw, how).units


def columns(raw: bytes, wanted: Sequence[str], how: Csv) -> Columns:
    """The wanted columns. BadInput: unreadable, no such column, not numbers."""
    lines = _Lines(raw, how)
    places = [_place(lines.names, name) for name in wanted]
    fast = _fast(lines, places)
    return fast if fast is not None else _careful(lines, places, wanted)


class _Lines:
    """The lines of a text file: where its data begin, and what its columns are called."""

    def __init__(self, raw: bytes, how: Csv) -> None:
        self.how = how
        self.lines = re.split(r"\r\n|\r|\n", _decoded(raw))  # what else splits a text is a sign of some encoding here
        self.first, self.names, self.units = self._begin()

    def rows(self, skip: int) -> Iterator[tuple[int, list[str]]]:
        """Cells of every line that is neither empty nor a comment, from line `skip` on, with the line's number."""
        yield from self._rows(skip, None)

    def _rows(self, begin: int, end: int | None) -> Iterator[tuple[int, list[str]]]:
        for number, line in enumerate(itertools.islice(self.lines, begin, end), begin + 1):
            if line.strip() and not (self.how.comment and line.lstrip().startswith(self.how.comment)):
                yield number, self._cells(line)

    def cut(self) -> tuple[int, int, int] | None:
        """Number of the last line, its cells and those of the first row, if it has fewer; None if it is whole."""
        first = next(self.rows(self.first), None)
        for number in range(len(self.lines), self.first, -1):
            last = next(self._rows(number - 1, number), None)
            if last is not None and first is not None:
                short = len(last[1]) < len(first[1]) and last[0] != first[0]
                return (number, len(last[1]), len(first[1])) if short else None
        return None

    def _cells(self, line: str) -> list[str]:
        if self.how.delimiter == " ":
            return line.split()
        return [cell.strip() for cell in next(csv.reader([line], delimiter=self.how.delimiter))]

    def _begin(self) -> tuple[int, tuple[str, ...], tuple[str, ...]]:
        """Lines before the first row of data, the columns' names and their units."""
        skip = self.how.skip or preamble(self.lines)
        rows = self.rows(skip)
        number, cells = next(rows, (0, []))
        if not cells:
            raise BadInput("found no line of data, wanted some")
        said = () if self.how.skip else self._of_preamble(skip)
        if self.how.units and self.how.header:
            number, below = next(rows, (number, []))
            said = tuple(below)
        if self.how.header:
            return number, tuple(cells), said
        return number - 1, tuple(str(k) for k in range(1, len(cells) + 1)), said

    def _of_preamble(self, skip: int) -> tuple[str, ...]:
        """Units that an LVM header states; the first column is X."""
        stated = {cells[0]: cells[1:] for line in self.lines[:skip] if (cells := self._cells(line))}
        seconds = "s" if stated.get("X_Dimension", [""])[:1] == ["Time"] else ""
        return (seconds, *stated["Y_Unit_Label"]) if "Y_Unit_Label" in stated else ()


def _decoded(raw: bytes) -> str:
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" in raw:
            raise BadInput("found bytes that are no text, wanted a CSV file") from None
        return raw.decode("latin-1")


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


def _fast(lines: _Lines, places: Sequence[int]) -> Columns | None:
    """The numbers as numpy reads them; None where a cell is empty or odd, which needs a closer look."""
    how = lines.how
    if how.decimal != "." or next(lines.rows(lines.first), None) is None or lines.cut() is not None:
        return None
    try:
        values = np.loadtxt(
            lines.lines, np.float64, delimiter=None if how.delimiter == " " else how.delimiter,
            comments=how.comment or None, skiprows=lines.first, usecols=places, ndmin=2, quotechar='"',
        )  # fmt: skip
    except ValueError:
        return None
    return Columns(values)


def _careful(lines: _Lines, places: Sequence[int], wanted: Sequence[str]) -> Columns:
    """Cell by cell, with the line of what is no number."""
    marks: dict[str, list[int]] = {}
    cut = lines.cut()
    rows = [
        [_number(cells, place, name, number, lines.how, marks) for place, name in zip(places, wanted, strict=True)]
        for number, cells in lines.rows(lines.first)
        if cut is None or number != cut[0]
    ]
    if not rows:
        raise BadInput("found a header and no row of data, wanted some")
    said = [] if cut is None else [f"line {cut[0]}, the last one, is cut after {cut[1]} of {cut[2]} cells: left out"]
    return Columns(np.array(rows, np.float64), (*said, *_of_marks(marks)))


def _of_marks(marks: dict[str, list[int]]) -> Iterator[str]:
    for mark, numbers in list(marks.items())[:SHOWN]:
        where = f"line {numbers[0]}" if len(numbers) == 1 else f"{len(numbers)} cells, the first in line {numbers[0]},"
        yield f"{where} {'holds' if len(numbers) == 1 else 'hold'} '{mark}', which is taken as no number"


def _number(cells: list[str], place: int, name: str, line: int, how: Csv, marks: dict[str, list[int]]) -> float:
    if place >= len(cells):
        raise BadInput(f"line {line}: found {len(cells)} cells, wanted at least {place + 1} (for '{name}')")
    text = cells[place]
    if text.lower() in NOT_A_NUMBER:
        return float("nan")
    if text.lower() in MARKS:
        marks.setdefault(text, []).append(line)
        return float("nan")
    try:
        if "_" in text or (how.decimal != "." and "." in text):  # Python's spelling of thousands, and other people's
            raise ValueError
        return float(text.replace(how.decimal, ".") if how.decimal != "." else text)
    except ValueError:
        raise BadInput(f"line {line}: found '{text}' in column '{name}', wanted a number{_hint(text, how)}") from None


def _hint(text: str, how: Csv) -> str:
    if how.decimal == "." and re.fullmatch(r"[-+]?\d+,\d+", text):
        return '; for a decimal comma say `reading: {decimal: ","}`'
    if how.decimal != "." and "." in text:
        return f" with '{how.decimal}' before its decimals; points that mark thousands have to be taken out of the file"
    return ""
