"""A calibration such as the bench makes, built by hand: nine accelerometers and six gyros, with budgets."""

from __future__ import annotations

import math

from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import Calibration, PaperRow, ResponsePoint, Result, Source, not_determined
from rig.calibrate.verdict import verdict
from rig.printed import DEGREE, G

ACCELEROMETERS = tuple(f"unit_{unit}_{axis}" for unit in "abc" for axis in "xyz")
GYROS = ("gyro_pitch", "gyro_roll", "gyro_yaw", "backup_pitch", "backup_roll", "backup_yaw")
NEAR = {"unit_a": 0.650, "unit_b": 0.652, "unit_c": 0.097}
RATES = dict(zip(GYROS, (3.61e-3, 3.67e-3, 3.71e-3, 5.19e-3, 5.18e-3, 5.21e-3), strict=True))


def example() -> Calibration:
    """The Sensor Cube on the simulated bench: all kinds of results, one flagged, one not determined."""
    accelerometers = [r for place, channel in enumerate(ACCELEROMETERS) for r in _accelerometer(channel, place)]
    gyros = [r for place, channel in enumerate(GYROS) for r in _gyro(channel, place)]
    return Calibration(
        name="cube-2026-11",
        sensor="Sensor Cube",
        serial="SIM-CUBE-1",
        made=1_795_000_000.0,
        simulated=True,
        sources=(
            Source("20261118-sweep-x", "frequency_sweep", "completed", "ab" * 32, 1_794_990_000.0),
            Source("20261118-turntable", "turntable", "completed", "cd" * 32, 1_794_995_000.0),
        ),
        standards=_standards(),
        conditions={"temperature": (23.2, 22.1, 25.0), "supply": (5.0021, 4.9987, 5.0046)},
        results=tuple(accelerometers + gyros),
        responses={"unit_a_x": _responses()},
        paper=(
            PaperRow("I", "2g Unit", "unit_a_x", "eq. 8", 0.6475 / G, "V/(m/s²)", 0.66 / G, "unit_a_x.sensitivity"),
            PaperRow(
                "II",
                "Pitch",
                "gyro_pitch",
                "eq. 13",
                3.63e-3 / DEGREE,
                "V/(rad/s)",
                3.49e-3 / DEGREE,
                "gyro_pitch.sensitivity",
            ),
        ),
        flags=("The sweeps cover one mounting only; the scatter between mountings is taken from earlier work.",),
        program={"name": "rig", "version": "0.1.0", "python": "3.11"},
    )


def _budget(value: float, unit: str, relative: float, source: str) -> Budget:
    size = abs(value)
    return Budget((
        Contribution("reference gain", "B", "normal", 0.5 * relative, "1", value, source=source),
        Contribution("alignment", "B", "rectangular", 0.2 * relative, "1", value, source="mounting"),
        Contribution("supply", "B", "rectangular", 0.002, "V", 0.02 * relative * value, source="converter"),
        Contribution("repeatability", "A", "t", size * 0.1 * relative, unit, 1.0, dof=9, source="20261118-sweep-x"),
    ))  # fmt: skip


def _result(channel: str, measurand: str, title: str, value: float, unit: str, relative: float, method: str) -> Result:
    source = "EX-LDV-2026-014" if channel.startswith("unit") else "EX-ENC-2026-007"
    return Result(channel, measurand, title, value, unit, _budget(value, unit, relative, source), method, source)


def _accelerometer(channel: str, place: int) -> list[Result]:
    unit, axis = channel[:6], channel[-1]
    sensitivity = NEAR[unit] / G * (1 + 0.002 * (place - 4))
    noise = (0.0015 if unit != "unit_c" else 0.020) * G
    sweep, static = "sine approximation against the vibrometer", "static record"
    found = [
        _judged(_result(channel, "sensitivity", "sensitivity", sensitivity, "V/(m/s²)", 0.01, sweep), place),
        _result(channel, "offset", "offset", 2.5 + 0.003 * place, "V", 0.0002, static),
        _result(channel, "deviation", "deviation", noise, "m/s²", 0.02, static),
        _result(channel, "noise_density", "noise density", noise / math.sqrt(628.0), "(m/s²)/√Hz", 0.03, static),
        _result(channel, "noise_bandwidth", "noise bandwidth", 628.0 + place, "Hz", 0.03, static),
        _result(channel, "nonlinearity", "nonlinearity", 4e-5 * (place + 1), "1/(m/s²)", 0.5, sweep),
    ]
    others = [other for other in "xyz" if other != axis]
    found += [
        _result(channel, f"cross_axis_{other}", f"cross-axis {other}", 0.003 + 0.001 * place, "1", 0.2, "three axes")
        for other in others
    ]
    if channel == "unit_b_z":
        why = "the static record is shorter than ten periods of the longest averaging time"
        found.append(not_determined(channel, "bias_instability", "bias instability", "m/s²", why))
    return found


def _judged(result: Result, place: int) -> Result:
    from dataclasses import replace

    assert result.value is not None
    low, high = result.value * (0.97 if place % 4 else 0.998), result.value * 1.03
    judged = replace(result, low=low, high=high, verdict=verdict(result.value, result.expanded, low, high))
    if place == 2:
        return replace(
            judged, status="flagged", remarks=("coherence below 0.99 at 3 of 48 points; these were left out",)
        )
    return judged


def _gyro(channel: str, place: int) -> list[Result]:
    table, static = "whole revolutions against the encoder", "static record"
    noise = (1.5 - 0.1 * place) * DEGREE
    sensitivity = RATES[channel] / DEGREE * (-1 if channel.endswith("roll") else 1)
    return [
        _result(channel, "sensitivity", "sensitivity", sensitivity, "V/(rad/s)", 0.003, table),
        _result(channel, "offset", "offset", 2.5 - 0.002 * place, "V", 0.0002, static),
        _result(channel, "deviation", "deviation", noise, "rad/s", 0.02, static),
        _result(channel, "noise_density", "noise density", noise / math.sqrt(86.0), "(rad/s)/√Hz", 0.03, static),
        _result(channel, "noise_bandwidth", "noise bandwidth", 86.0 + place, "Hz", 0.03, static),
        _result(channel, "nonlinearity", "nonlinearity", 2e-4, "1/(rad/s)", 0.5, table),
    ]


def _responses() -> tuple[ResponsePoint, ...]:
    points = []
    for level, peak in (("full", 4.9), ("quarter", 1.225)):
        for index in range(24):
            frequency = 20.0 * 25.0 ** (index / 23)
            pole = 1 / complex(1, frequency / 400.0)
            size, phase = NEAR["unit_a"] / G * abs(pole), math.atan2(pole.imag, pole.real)
            u, uc = 2e-4 * size, 5e-3 * size
            points.append(
                ResponsePoint(frequency, level, peak, size, phase, u, 2e-4, uc, 2e-3, 0.002, "20261118-sweep-x")
            )
    return tuple(points)


def _standards() -> tuple[dict[str, object], ...]:
    lab = "Example Calibration Laboratory"
    return (
        {
            "standard": "vibrometer", "instrument": "Polytec OFV-3001 with OVD-01", "serial": "SIM-OFV-1",
            "laboratory": lab, "certificate": "EX-LDV-2026-014", "calibrated": "2026-03-02", "due": "2027-03-02",
            "values": {"gain": {"kind": "ratio", "value": "1", "expanded_uncertainty": "1 %", "coverage_factor": 2.0}},
        },
        {
            "standard": "encoder", "instrument": "US Digital 2-inch disk, 1000 lines, with HEDS-9040",
            "serial": "SIM-ENC-1", "laboratory": lab, "certificate": "EX-ENC-2026-007",
            "calibrated": "2026-01-19", "due": "2028-01-19",
            "values": {
                "graduation": {
                    "kind": "angle", "value": "0 arcsec", "expanded_uncertainty": "20 arcsec", "coverage_factor": 2.0,
                }
            },
        },
    )  # fmt: skip
