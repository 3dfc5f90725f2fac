"""HDF5: every result with its unit, uncertainty and budget, the frequency responses, and the covariance.

    /channels/<channel>/<measurand>   value (SI, NaN if not determined); attributes unit, u, dof, k, expanded, …
    /budgets/<channel>/<measurand>    table: one contribution a row
    /responses/<channel>              table: one point a row; attribute units, one a column
    /covariance/sensitivity           matrix of all sensitivities; attributes keys, units: one a row
    /conditions/<name>                mean, lowest, highest
    /sources, /paper                  tables: the runs, the paper's own values

The calibration itself is in the attributes of the root. Written for readers back to HDF5 1.10.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.calibrate.budget import Contribution
from rig.calibrate.calibration import Calibration, PaperRow, ResponsePoint, Result, Source
from rig.export.selection import Choice, is_simulated

if TYPE_CHECKING:
    import h5py

FORMAT = 1
RESPONSE_UNITS: Mapping[str, str] = {
    "frequency": "Hz", "acceleration": "m/s²", "phase": "rad", "u_phase": "rad", "uc_phase": "rad", "distortion": "1",
}  # fmt: skip
IN_MAGNITUDE = ("magnitude", "u_magnitude", "uc_magnitude")
CONDITION_UNITS: Mapping[str, str] = {"temperature": "°C", "supply": "V"}


def files(calibration: Calibration, choice: Choice) -> dict[str, bytes]:
    """The file by suffix: every result of every channel, whatever the choice of unit."""
    import h5py

    page = io.BytesIO()
    with h5py.File(page, "w", libver=("earliest", "v110")) as file:
        _attributes(file, _about(calibration))
        for result in calibration.results:
            _write_result(file, result)
        _write_tables(file, calibration)
        _write_covariance(file, calibration)
    return {".h5": page.getvalue()}


def _about(calibration: Calibration) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "name": calibration.name,
        "sensor": calibration.sensor,
        "serial": calibration.serial,
        "made": calibration.made,
        "simulated": calibration.simulated,
        "notice": is_simulated(calibration),
        "flags": list(calibration.flags),
        "overdue": list(calibration.overdue),
        "standards": json.dumps([dict(one) for one in calibration.standards], ensure_ascii=False, default=str),
        "program": json.dumps(dict(calibration.program), ensure_ascii=False),
    }


def _write_result(file: h5py.File, result: Result) -> None:
    place = f"{result.channel}/{result.measurand}"
    value = file.create_dataset(f"channels/{place}", data=math.nan if result.value is None else result.value)
    _attributes(value, _stated(result))
    if result.budget is not None:
        file.create_dataset(f"budgets/{place}", data=_table(Contribution, result.contributions))


def _stated(result: Result) -> dict[str, Any]:
    """Attributes of a value: what does not exist is left out."""
    known: dict[str, Any] = {}
    if result.budget is not None:
        known = {"u": result.u, "dof": result.dof, "k": result.coverage_factor, "expanded": result.expanded}
    limits = {"low": result.low, "high": result.high, "verdict": result.verdict}
    return {
        "unit": result.unit,
        "title": result.title,
        "method": result.method,
        "reference": result.reference,
        "status": result.status,
        "remarks": list(result.remarks),
        **known,
        **{name: limit for name, limit in limits.items() if limit is not None},
    }


def _write_tables(file: h5py.File, calibration: Calibration) -> None:
    for channel, points in calibration.responses.items():
        found = file.create_dataset(f"responses/{channel}", data=_table(ResponsePoint, points))
        _attributes(found, {"units": _response_units(calibration, channel)})
    for name, three in calibration.conditions.items():
        found = file.create_dataset(f"conditions/{name}", data=np.array(three, np.float64))
        _attributes(found, {"unit": CONDITION_UNITS.get(name, ""), "meaning": ["mean", "lowest", "highest"]})
    file.create_dataset("sources", data=_table(Source, calibration.sources))
    file.create_dataset("paper", data=_table(PaperRow, calibration.paper))


def _response_units(calibration: Calibration, channel: str) -> list[str]:
    sensitivity = calibration.find(f"{channel}.sensitivity")
    own = sensitivity.unit if sensitivity else "V/(m/s²)"
    return [own if f.name in IN_MAGNITUDE else RESPONSE_UNITS.get(f.name, "") for f in fields(ResponsePoint)]


def _write_covariance(file: h5py.File, calibration: Calibration) -> None:
    found = list(calibration.used("sensitivity"))
    if not found:
        return
    matrix = file.create_dataset("covariance/sensitivity", data=calibration.covariance([r.key for r in found]))
    _attributes(matrix, {"keys": [r.key for r in found], "units": [r.unit for r in found]})


def _table(kind: type, rows: Sequence[Any]) -> NDArray[np.void]:
    """A table with a column for each field of a dataclass: floats, or texts; lists of texts are joined by `; `."""
    import h5py

    numbers = [f.name for f in fields(kind) if str(f.type).startswith("float")]
    layout = np.dtype([(f.name, "<f8" if f.name in numbers else h5py.string_dtype()) for f in fields(kind)])
    table = np.empty(len(rows), layout)
    for f in fields(kind):
        cells = [getattr(row, f.name) for row in rows]
        table[f.name] = [_number(c) for c in cells] if f.name in numbers else [_text(c) for c in cells]
    return table


def _number(cell: float | None) -> float:
    return math.nan if cell is None else float(cell)


def _text(cell: str | Iterable[str]) -> str:
    return cell if isinstance(cell, str) else "; ".join(cell)


def _attributes(thing: h5py.Group | h5py.Dataset, values: Mapping[str, Any]) -> None:
    """Attributes in UTF-8; lists of texts as arrays of texts, which may be empty."""
    import h5py

    for name, value in values.items():
        texts = isinstance(value, list)
        thing.attrs[name] = np.array(value, dtype=h5py.string_dtype()) if texts else value
