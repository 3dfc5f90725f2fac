"""Noise of imported records at rest: in SI by what their manifests state, or by sensitivities that were calibrated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from rig.calibrate.budget import Contribution, half_width
from rig.calibrate.calibration import Result
from rig.calibrate.input_noise import Scale, noise_results, scale_of
from rig.calibrate.resting import Resting, deviation
from rig.foreign.manifest import SI_OF, Column
from rig.foreign.tables import Foreign
from rig.parts.channels import UNSTATED
from rig.parts.reading.rest import AtRest, at_rest
from rig.sensor import Sensor, SensorChannel

STATED = "sensitivity as the manifest states it"


def results(records: Sequence[Foreign], sensor: Sensor, known: Sequence[Result]) -> Iterator[Result]:
    """Deviation, noise density, bias instability and random walk of every channel, from its longest record.

    `known`: results with sensitivities, by which a noise is referred to the input where there is one.
    """
    columns = {one.channel: one for data in records for one in data.manifest.of("device") if one.quantity in SI_OF}
    best: dict[str, Resting] = {}
    missing: dict[str, str] = {}
    for data in records:
        for one in (one for one in at_rest(data) if one.channel in columns):
            resting = _resting(data.run, one)
            if resting is None:
                missing.setdefault(one.channel, f"{data.run}, {one.table}: {one.reason}")
            elif one.channel not in best or resting.seconds > best[one.channel].seconds:
                best[one.channel] = resting
    own = {one.channel: one for one in known if one.measurand == "sensitivity" and one.value is not None}
    scales = {name: _scale(sensor.channel(name), column, own.get(name)) for name, column in columns.items()}
    without = {name: why for name, why in missing.items() if name not in best}
    yield from noise_results(sensor, best, without, scales)


def _resting(run: str, one: AtRest) -> Resting | None:
    if one.spectrum is None:
        return None
    lines, fitted = one.spectrum.lines, one.spectrum.fitted
    value, dof, reason = deviation(lines, fitted, one.spectrum.step)
    steady = one.spectrum.steady
    return Resting(one.channel, run, one.table, lines.seconds, fitted, value, dof, reason, steady, one.unit)


def _scale(channel: SensorChannel, column: Column, own: Result | None) -> Scale:
    """A calibrated ratio, else one: the numbers are in SI by the sensitivity that the manifest states."""
    if own is not None:
        return scale_of(channel, own)
    if column.tolerance >= UNSTATED:
        return Scale(1.0, None, (f"by the {STATED}; its tolerance is not stated and not in the budget",), STATED)
    u = half_width(column.tolerance, "rectangular")
    line = Contribution("sensitivity", "B", "rectangular", u, "1", 1.0, source="manifest")
    return Scale(1.0, line, (f"by the {STATED}",), STATED)


def rows(records: Sequence[Foreign]) -> Mapping[str, Mapping[str, object]]:
    """Channels of records at rest as a sensor file states them, sensitivities of one."""
    found: dict[str, Mapping[str, object]] = {}
    for data in records:
        for one in data.manifest.of("device"):
            if one.quantity in SI_OF and one.axis is not None:
                found[one.channel] = {
                    "part": data.manifest.unit.model, "quantity": one.quantity, "axis": one.axis, "range": "",
                    "unit": "gyros" if one.quantity == "rate" else "accelerometers",
                    "sensitivity": f"1 V/({SI_OF[one.quantity]})", "bandwidth": "1 Hz",
                }  # fmt: skip
    return found
