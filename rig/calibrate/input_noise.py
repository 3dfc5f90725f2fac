"""Noise referred to the input: what turns volts at rest or in motion into the sensed quantity, and its line."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

from rig import units
from rig.calibrate.allowances import of_sheet
from rig.calibrate.budget import Budget, Contribution, half_width
from rig.calibrate.calibration import Result, not_determined
from rig.calibrate.resting import Resting
from rig.sensor import Sensor, SensorChannel, SheetNoise
from rig.signals.noise import coefficients

DEVIATION = "deviation at rest, 1/30 Hz to half the sampling rate"
FEW = 4  # lines that are said one by one
RANDOM_WALK = {"acceleration": "(m/s²)·√Hz", "rate": "(rad/s)·√Hz"}


@dataclass(frozen=True)
class Scale:
    """What turns volts of noise into the sensed quantity: sensitivity (SI) and its line in the budget, per unit."""

    sensitivity: float
    line: Contribution | None
    remarks: tuple[str, ...]
    reference: str

    def result(
        self, sensor: SensorChannel, measurand: str, title: str, unit: str, volts: float, u: float, how: str
    ) -> Result:
        """A noise quantity in V (or V/√Hz …) with standard uncertainty `u`, referred to the input."""
        value = volts / abs(self.sensitivity)
        lines = [Contribution("estimate of the spectrum", "A", "normal", u / abs(self.sensitivity), unit, 1.0)]
        if self.line is not None:
            lines.append(replace(self.line, sensitivity=value))
        return Result(
            sensor.name, measurand, title, value, unit, Budget(tuple(lines)), how, self.reference, remarks=self.remarks
        )


def scale_of(sensor: SensorChannel, own: Result | None) -> Scale:
    """The channel's own sensitivity if these runs determine it, else the data sheet's within its tolerance."""
    if own is not None and own.value is not None:
        known = Contribution(
            "sensitivity", "B", "normal", own.u / abs(own.value), "1", 1.0, source=f"own, {own.value:.9g}"
        )
        return Scale(own.value, known, (), "own sensitivity")
    remarks = ["by the data sheet's sensitivity"]
    line: Contribution | None = None
    if sensor.tolerance is None:
        remarks.append("its tolerance is not declared and not in the budget")
    else:
        line = Contribution("sensitivity", "B", "rectangular", half_width(sensor.tolerance, "rectangular"), "1", 1.0,
                            source=of_sheet(sensor.name))  # fmt: skip
    return Scale(sensor.nominal, line, tuple(remarks), "data sheet's sensitivity")


def noise_results(
    sensor: Sensor, noise: Mapping[str, Resting], missing: Mapping[str, str], scales: Mapping[str, Scale]
) -> Iterator[Result]:
    """Of every channel with a record at rest, by its scale, or the data sheet's where it has none; why others have no
    value is in `missing`.
    """
    for name, one in noise.items():
        channel = sensor.channel(name)
        yield from _noise_of(channel, one, scales.get(name) or scale_of(channel, None))
    for name, why in missing.items():
        yield not_determined(name, "deviation", DEVIATION, sensor.channel(name).unit, why)


def scales_of(sensor: Sensor, sensitivities: Iterable[Result]) -> dict[str, Scale]:
    """By every channel's own sensitivity, of those that have one among these results."""
    own = {r.channel: r for r in sensitivities if r.measurand == "sensitivity" and r.value is not None}
    return {name: scale_of(sensor.channel(name), result) for name, result in own.items()}


def _noise_of(sensor: SensorChannel, noise: Resting, by: Scale) -> Iterator[Result]:
    how = f"record of {noise.seconds:.4g} s at rest ({noise.run})"
    title, lines = DEVIATION, tuple(_lines_of(noise))
    if noise.deviation is None:
        yield not_determined(sensor.name, "deviation", title, sensor.unit, noise.reason)
    else:
        u = u_deviation(noise.deviation, noise.dof)
        found = by.result(sensor, "deviation", title, sensor.unit, noise.deviation, u, how)
        yield replace(found, remarks=(*found.remarks, *lines))
    known = coefficients(noise.fit)
    for measurand, key, title, unit in (
        ("noise_density", "N", "noise density at low frequency, N (two-sided root)", f"({sensor.unit})/√Hz"),
        ("bias_instability", "B", "bias instability, B", sensor.unit),
        ("random_walk", "K", "random walk of the output, K", RANDOM_WALK[sensor.quantity]),
    ):
        one = known[key]
        if one.value is None or one.u is None:
            yield not_determined(sensor.name, measurand, title, unit, one.reason)
        else:
            result = by.result(sensor, measurand, title, unit, one.value, one.u, how)
            if key == "N":
                result = _beside_sheet(result, sensor.noise)
                result = result if noise.deviation else replace(result, remarks=(*result.remarks, *lines))
            yield result
    yield _bandwidth(sensor, noise, how)


def _lines_of(noise: Resting) -> Iterator[str]:
    """What is said of steady lines that are no part of the noise, the strongest first, as large as they are recorded:
    hum on a wire is nothing that the sensor feels.
    """
    strongest = sorted(noise.lines, key=lambda line: -line.rms)
    said = [f"{one.frequency:.4g} Hz ({_size(one.rms, noise.unit)} rms)" for one in strongest]
    if said:
        more = f" and {len(said) - FEW} more" if len(said) > FEW else ""
        yield f"without the steady {'line' if len(said) == 1 else 'lines'} at {', '.join(said[:FEW])}{more}"


def _size(rms: float, unit: str) -> str:
    return units.format_quantity(rms, "voltage", 3) if unit == "V" else f"{rms:.3g} {unit}"


def _beside_sheet(result: Result, sheet: SheetNoise | None) -> Result:
    """A measured N with what the data sheet says of it; a sheet's density is one-sided, √2·N."""
    if sheet is None or result.value is None:
        return result
    kind = f"{'rate' if 'rad' in result.unit else 'acceleration'}_density"
    ratio = math.sqrt(2.0) * result.value / sheet.density
    inside = abs(ratio - 1.0) <= sheet.tolerance + math.sqrt(2.0) * result.expanded / sheet.density
    said = (
        f"√2·N is {ratio:.3g} of the data sheet's {units.format_quantity(sheet.density, kind)}: "
        f"{'within' if inside else 'outside'} its ± {units.format_quantity(sheet.tolerance, 'ratio', unit='%')}"
    )
    return replace(result, remarks=(*result.remarks, said))


def u_deviation(value: float, dof: float) -> float:
    """Standard uncertainty of a standard deviation from the degrees of freedom of its square."""
    return value / math.sqrt(2.0 * max(dof, 1.0))


def _bandwidth(sensor: SensorChannel, noise: Resting, how: str) -> Result:
    title = "noise bandwidth of the white noise, π/2 of the corner"
    if "pole" in noise.fit.refused or not math.isfinite(noise.fit.model.pole):
        why = noise.fit.refused.get("pole", "no corner in the spectrum")
        return not_determined(sensor.name, "noise_bandwidth", title, "Hz", why)
    factor = math.pi / 2.0
    line = Contribution("estimate of the spectrum", "A", "normal", noise.fit.u["pole"], "Hz", factor)
    value = factor * noise.fit.model.pole
    return Result(sensor.name, "noise_bandwidth", title, value, "Hz", Budget((line,)), how, "time base")
