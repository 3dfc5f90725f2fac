"""How a text file is written, told from its first lines: delimiter, decimal sign, comments, names and their units."""

from __future__ import annotations

import re
from collections.abc import Sequence

from rig.foreign.text_files import MARKS, NOT_A_NUMBER, Csv, preamble

DELIMITERS = (",", ";", "\t", "|", " ")
LOOKED_AT = 60  # lines
BEFORE = 20  # lines that may stand before the names
ROWS = 6  # lines that show a table
TABLE = 3  # what `_splits` says first of lines that are alike, the names among them
MOSTLY = 0.5  # of a row's cells are numbers


def comments(raw: bytes, how: Csv) -> tuple[str, ...]:
    """What a text file says in comments before its numbers; often the sampling interval."""
    if not how.comment:
        return ()
    lines = raw[:4000].decode("utf-8-sig", "replace").splitlines()[:10]
    return tuple(line.strip()[:160] for line in lines if line.lstrip().startswith(how.comment))


def written(raw: bytes) -> Csv:
    """How a text file is written, from its first lines."""
    text = raw[:20_000].decode("utf-8-sig", "replace").splitlines()
    own = preamble(text)
    text = text[own : own + LOOKED_AT]
    comment = next((sign for sign in ("#", "%") if text and text[0].lstrip().startswith(sign)), "#")
    rows = [(n, line) for n, line in enumerate(text) if line.strip() and not line.lstrip().startswith(comment)]
    rows = rows[:-1] if len(rows) > 2 else rows or list(enumerate(text))  # the last one may be cut
    begin = _table(rows)
    skip, lines = (own + rows[begin][0] if begin else 0), [line for _, line in rows[begin:]]
    best = max(DELIMITERS, key=lambda sign: _splits(lines, sign))
    cells = [cell for line in lines[1:] for cell in _cut(line, best)]
    commas = best != "," and sum(bool(re.fullmatch(r"[-+]?\d+,\d+", cell)) for cell in cells) > 0.2 * len(cells)
    decimal = "," if commas else "."
    if not begin and _names_in_comment(text, lines, comment, best, commas):
        return Csv(best, "", True, decimal)
    header = any(cell and not _is_number(cell, commas) for cell in _cut(lines[0], best))
    return Csv(best, comment, header, decimal, skip, header and _units_below(lines, best, commas))


def _table(rows: Sequence[tuple[int, str]]) -> int:
    """Which of these lines is the first of a table: its rows have as many cells; 0 if none shows one."""
    for begin in range(min(BEFORE, max(len(rows) - ROWS, 0)) + 1):
        lines = [line for _, line in rows[begin:]]
        if max(_splits(lines, sign) for sign in DELIMITERS)[0] == TABLE:
            return begin
    return 0


def _cut(line: str, sign: str) -> list[str]:
    return [cell.strip().strip('"') for cell in line.split(sign if sign != " " else None)]


def _names_in_comment(text: Sequence[str], lines: Sequence[str], comment: str, sign: str, commas: bool) -> bool:
    """Whether the only comment is a header: as many cells as the rows below it, which are numbers for the most part."""
    alone = sum(line.lstrip().startswith(comment) for line in text) == 1 and text[0].lstrip().startswith(comment)
    named, row = _cut(text[0], sign), _cut(lines[0], sign)
    numbers = sum(_is_number(cell, commas) for cell in row) > MOSTLY * len(row)
    words = not any(cell and _is_number(cell, commas) for cell in named)
    return alone and numbers and words and sign != " " and len(named) == len(row) > 1


def _splits(lines: Sequence[str], sign: str) -> tuple[int, float, int]:
    """How well a delimiter cuts lines: everywhere into the same number of cells, into numbers, into many."""
    cut = [_cut(line, sign) for line in lines]
    rows = cut[1:] or cut
    alike = len({len(row) for row in rows}) == 1 and len(rows[0]) > 1
    same = alike and len(cut[0]) == len(rows[0])  # a decimal comma cuts rows, but not the header
    cells = [cell for row in rows for cell in row]
    numbers = sum(_is_number(cell, sign != ",") for cell in cells) / len(cells)
    return 2 * same + alike, round(numbers, 1), len(rows[0]) if sign != " " else 1


def _is_number(cell: str, commas: bool) -> bool:
    try:
        float(cell.replace(",", ".") if commas else cell)
    except ValueError:
        return cell.lower() in NOT_A_NUMBER | MARKS
    return True


def _units_below(lines: Sequence[str], sign: str, commas: bool) -> bool:
    """Whether the line below the names holds units: no number, and as many cells as the rows below it, which have."""
    if len(lines) < 3:
        return False
    names, units, first = (_cut(line, sign) for line in lines[:3])
    words = [cell for cell in units if cell]
    wordy = bool(words) and not any(_is_number(word, commas) for word in words)
    return wordy and len(names) == len(units) and any(cell and _is_number(cell, commas) for cell in first)
