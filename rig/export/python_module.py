"""A Python module without dependencies that applies the calibration: the source of `apply`, with the numbers in it.

    import cube_2026_calibration as cube
    cube.apply("unit_a_x", cube.counts_to_volts(samples))

The numbers stand in the file as plain literals; nothing is evaluated or read when it is imported.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any

from rig.calibrate.calibration import Calibration, Result
from rig.errors import BadInput
from rig.export.selection import (
    Choice,
    cross_axis,
    is_simulated,
    needed,
    one_line,
    provenance,
    stated,
    value_of,
)

BEGIN, END = "# numbers: begin\n", "# numbers: end\n"
MEASURANDS = ("sensitivity", "offset")  # without either, a channel cannot be applied
SUPPLY_SHARE = "supply_ratio"


def module_stem(name: str) -> str:
    """A legal module name but for its suffix."""
    legal = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"c_{legal}" if legal[:1].isdigit() else legal


def files(calibration: Calibration, choice: Choice) -> dict[str, bytes]:
    """The module by suffix: all channels with sensitivity and offset; raises BadInput if there is none."""
    numbers = _numbers(calibration)
    if not numbers["CHANNELS"]:
        raise BadInput(
            f"calibration {calibration.name}: found no channel with both sensitivity and offset, "
            "wanted one (the offset comes from a static record, `rig noise`)"
        )
    before, annotated, after = _template()
    body = "\n".join(f"{head} = {literal(numbers[name])}" for name, head in annotated.items())
    return {"_calibration.py": f"{_docstring(calibration)}{before}{body}\n{after}".encode()}


def _template() -> tuple[str, dict[str, str], str]:
    """`apply` without its docstring: what stands before the numbers, their names with type, what stands after."""
    source = resources.files("rig.export").joinpath("apply.py").read_text("utf-8")
    before, rest = source.split('"""', 2)[2].split(BEGIN)
    numbers, after = rest.split(END)
    heads = [line.partition(" = ")[0] for line in numbers.splitlines()]
    return before, {head.partition(":")[0]: head for head in heads}, after


def _numbers(calibration: Calibration) -> dict[str, Any]:
    reasons = {channel: _why_not(calibration, channel) for channel in calibration.channels()}
    usable = [channel for channel, why in reasons.items() if not why]
    sensor = calibration.under_test
    triads = [one for one in sensor.triads if one.is_whole and all(name in usable for name in one.names)]
    return {
        "PROVENANCE": _provenance(calibration),
        "CHANNELS": {channel: _channel(calibration, channel) for channel in usable},
        "TRIADS": {triad.name: list(triad.names) for triad in triads},
        "CROSS_AXIS": {triad.name: cross_axis(calibration, triad) for triad in triads},
        "UNCERTAINTY": {channel: _uncertainties(calibration, channel) for channel in usable},
        "NOT_DETERMINED": {channel: why for channel, why in reasons.items() if why},
    }


def _why_not(calibration: Calibration, channel: str) -> str:
    """Why a channel cannot be applied; empty if it can."""
    for measurand in MEASURANDS:
        try:
            found = value_of(calibration, channel, measurand)
        except BadInput as error:
            return one_line(str(error))
        if measurand == "sensitivity" and found == 0.0:
            return "its sensitivity is 0"
    return ""


def _channel(calibration: Calibration, channel: str) -> dict[str, Any]:
    sensitivity = needed(calibration, channel, "sensitivity")
    share = calibration.find(f"{channel}.{SUPPLY_SHARE}")
    supply = calibration.conditions.get("supply")
    return {
        "sensitivity": sensitivity.value,
        "offset": value_of(calibration, channel, "offset"),
        "unit": sensitivity.unit.removeprefix("V/(").removesuffix(")"),
        "supply_share": share.value if share else None,
        "supply_reference": supply[0] if supply else None,
    }


def _uncertainties(calibration: Calibration, channel: str) -> dict[str, Any]:
    return {m: _uncertainty(needed(calibration, channel, m)) for m in MEASURANDS}


def _uncertainty(result: Result) -> dict[str, Any]:
    """`dof` is None where there is no limit to it."""
    return {
        "u": result.u,
        "dof": result.dof if math.isfinite(result.dof) else None,
        "k": result.coverage_factor,
        "expanded": result.expanded,
        "unit": result.unit,
        "status": result.status,
    }


def _provenance(calibration: Calibration) -> dict[str, Any]:
    return {
        "name": calibration.name,
        "sensor": calibration.sensor,
        "serial": calibration.serial,
        "made": calibration.made,
        "simulated": calibration.simulated,
        "notice": is_simulated(calibration),
        "sources": {source.run: source.digest for source in calibration.sources},
        "flags": list(calibration.flags),
        "overdue": list(calibration.overdue),
    }


def _docstring(calibration: Calibration) -> str:
    found = [r for m in MEASURANDS for r in calibration.used(m)]
    lines = [
        "Applies a calibration to raw samples: counts_to_volts, apply, apply_triad, UNCERTAINTY.",
        "",
        *provenance(calibration),
        "",
        "Cube frame: x forward, y against gravity on the shaker table, z to the side; roll about x, yaw about y, pitch",
        "about z. TRIADS gives the channels of a triad in the order x, y, z. Standard library only, Python 3.10 or",
        "later.",
        "",
        *(stated(result) for result in found),
    ]
    return quoted(lines)


def quoted(lines: Sequence[str]) -> str:
    """A docstring that its text cannot leave."""
    text = "\n".join(lines).replace("\\", "\\\\").replace('"', '\\"')
    return f'"""{text}\n"""'


def literal(value: Mapping[str, Any]) -> str:
    """A dictionary with one entry a line."""
    entries = "".join(f"    {key!r}: {inner!r},\n" for key, inner in _plain(value).items())
    return f"{{\n{entries}}}"


def _plain(value: Any) -> Any:
    """Mappings, lists, texts, and numbers of Python's own types."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_plain(inner) for inner in value]
    if isinstance(value, tuple):
        return tuple(_plain(inner) for inner in value)
    return float(value) if isinstance(value, float) else value
