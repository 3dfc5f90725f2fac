"""CSV tables for spreadsheets: one row a result, and in a second file one row a point of the frequency responses.

RFC 4180: comma, CRLF, a header, UTF-8. Floats are written so that they read back as the same floats; an empty field
means that there is no such value, `inf` degrees of freedom that there is no limit to them.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import fields

from rig.calibrate.calibration import Calibration, ResponsePoint, Result, shown
from rig.export.selection import Choice

Cell = str | float | bool | None

RESULTS = (
    "calibration", "serial", "simulated", "key", "channel", "measurand", "title", "value", "unit", "u", "dof", "k",
    "U", "shown_value", "shown_U", "shown_unit", "method", "reference", "status", "remarks", "low", "high", "verdict",
)  # fmt: skip
POINT = tuple(f.name for f in fields(ResponsePoint))
RESPONSES = ("calibration", "serial", "simulated", "channel", *POINT)


def files(calibration: Calibration, choice: Choice) -> dict[str, bytes]:
    """Both tables by suffix; every result of every channel, whatever the choice of unit."""
    own = (calibration.name, calibration.serial, calibration.simulated)
    results = ([*own, *_row(result)] for result in calibration.results)
    points = ([*own, channel, *_point(point)] for channel, points in calibration.responses.items() for point in points)
    return {".results.csv": _csv(RESULTS, results), ".responses.csv": _csv(RESPONSES, points)}


def _row(result: Result) -> list[Cell]:
    return [
        result.key, result.channel, result.measurand, result.title, result.value, result.unit, *_uncertainty(result),
        result.method, result.reference, result.status, "; ".join(result.remarks),
        result.low, result.high, result.verdict,
    ]  # fmt: skip


def _uncertainty(result: Result) -> list[Cell]:
    """u, dof, k, U, and value, U and unit as shown; empty where there is no value."""
    value, expanded, unit = shown(result)
    if result.budget is None:
        return [None, None, None, None, None if result.value is None else value, None, unit]
    return [result.u, result.dof, result.coverage_factor, result.expanded, value, expanded, unit]


def _point(point: ResponsePoint) -> list[Cell]:
    return ["; ".join(point.flags) if name == "flags" else getattr(point, name) for name in POINT]


def _csv(header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> bytes:
    page = io.StringIO(newline="")
    writer = csv.writer(page)
    writer.writerow(header)
    writer.writerows([_text(cell) for cell in row] for row in rows)
    return page.getvalue().encode()


def _text(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "true" if cell else "false"
    return cell if isinstance(cell, str) else repr(float(cell))
