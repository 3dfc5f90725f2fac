"""MAT-file, version 5: one structure `calibration`, nested by channel and measurand, for MATLAB and Octave.

    c = load('name.mat').calibration;  c.channels.unit_a_x.sensitivity.value
    loglog(c.responses.unit_a_x.frequency, c.responses.unit_a_x.magnitude)

Everything is SI; NaN stands where there is no value. `covariance.sensitivity` belongs to `covariance.keys`.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.calibrate.calibration import Calibration, ResponsePoint, Result
from rig.errors import BadInput
from rig.export.selection import Choice, is_simulated, one_line

FORMAT = 1
LONGEST_NAME = 63  # MATLAB's namelengthmax
HEADER = 116  # bytes of text at the start of a version 5 file


def files(calibration: Calibration, choice: Choice) -> dict[str, bytes]:
    """The file by suffix: every result of every channel, whatever the choice of unit."""
    from scipy.io import savemat

    page = io.BytesIO()
    structure = {"calibration": _calibration(calibration)}
    savemat(page, structure, format="5", long_field_names=True, oned_as="column")  # type: ignore[arg-type]
    return {".mat": _header(calibration) + page.getvalue()[HEADER:]}


def _header(calibration: Calibration) -> bytes:
    """Text at the start of the file: without the time of writing, so that one calibration gives one file."""
    name = one_line(calibration.name).encode("ascii", "replace").decode()
    simulated = ", SIMULATED" if calibration.simulated else ""
    return f"MATLAB 5.0 MAT-file, written by rig{simulated}, calibration {name}".ljust(HEADER)[:HEADER].encode("ascii")


def _calibration(calibration: Calibration) -> dict[str, Any]:
    by_channel = {
        channel: _struct((r.measurand, _result(r)) for r in calibration.results if r.channel == channel)
        for channel in calibration.channels()
    }
    return {
        "format": FORMAT,
        "name": calibration.name,
        "sensor": calibration.sensor,
        "serial": calibration.serial,
        "made": calibration.made,
        "simulated": calibration.simulated,
        "notice": is_simulated(calibration),
        "flags": _cell(calibration.flags),
        "overdue": _cell(calibration.overdue),
        "sources": _cell(f"{source.run} {source.digest}".strip() for source in calibration.sources),
        "conditions": _struct((name, np.array(three)) for name, three in calibration.conditions.items()),
        "channels": _struct(by_channel.items()),
        "responses": _struct((channel, _response(points)) for channel, points in calibration.responses.items()),
        "covariance": _covariance(calibration),
    }


def _result(result: Result) -> dict[str, Any]:
    return {
        "value": _number(result.value),
        "u": result.u,
        "dof": result.dof,
        "k": result.coverage_factor,
        "expanded": result.expanded,
        "unit": result.unit,
        "title": result.title,
        "method": result.method,
        "reference": result.reference,
        "status": result.status,
        "remarks": "; ".join(result.remarks),
        "low": _number(result.low),
        "high": _number(result.high),
        "verdict": result.verdict or "",
        "budget": _cell(asdict(one) | {"contribution": one.contribution} for one in result.contributions),
    }


def _response(points: tuple[ResponsePoint, ...]) -> dict[str, Any]:
    """One column a field: numbers as arrays of shape (n, 1), texts as cells."""
    columns: dict[str, Any] = {}
    for field in fields(ResponsePoint):
        values = [getattr(point, field.name) for point in points]
        if field.name == "flags":
            columns[field.name] = _cell("; ".join(flags) for flags in values)
        elif field.name in ("level", "run"):
            columns[field.name] = _cell(values)
        else:
            columns[field.name] = np.array(values, np.float64)
    return columns


def _covariance(calibration: Calibration) -> dict[str, Any]:
    keys = [result.key for result in calibration.used("sensitivity")]
    matrix = calibration.covariance(keys) if keys else np.zeros((0, 0))
    return {"keys": _cell(keys), "sensitivity": matrix}


def _struct(entries: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """A structure with legal field names; raises BadInput if two names become one."""
    named: dict[str, Any] = {}
    for name, value in entries:
        legal = field_name(name)
        if legal in named:
            raise BadInput(f"export to mat: found two fields that MATLAB would call '{legal}', wanted different names")
        named[legal] = value
    return named


def field_name(name: str) -> str:
    """A legal MATLAB field name: a letter, then letters, digits and underscores; raises BadInput if it is too long."""
    legal = re.sub(r"[^A-Za-z0-9_]", "_", name)
    legal = legal if legal[:1].isalpha() else f"x{legal}"
    if len(legal) > LONGEST_NAME:
        raise BadInput(f"export to mat: found the name '{name}', wanted one of at most {LONGEST_NAME} characters")
    return legal


def _cell(values: Iterable[str | Mapping[str, Any]]) -> NDArray[np.object_]:
    """A cell array, shape (n,): a plain list of texts would become a block of characters padded with blanks."""
    found = list(values)
    cell = np.empty(len(found), dtype=object)
    for index, value in enumerate(found):
        cell[index] = value
    return cell


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
