"""Which numbers of a calibration go into a robot's file, where they came from, and what if one is missing.

Axes of the cube: x forward, y against gravity on the shaker table, z to the side, right-handed. Gyros: roll about x,
yaw about y, pitch about z; a triad is always named in the order x, y, z.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from rig.calibrate.calibration import Calibration, Result, text
from rig.errors import BadInput

AXES = ("x", "y", "z")
ROTATIONS = ("roll", "yaw", "pitch")  # about x, y, z
UNITS = ("unit_a", "unit_b", "unit_c")
GYROS = ("gyro", "backup")

# What a technician runs to determine a measurand that is missing.
SOURCES: Mapping[str, str] = {
    "sensitivity": "a run of its axis: `rig sweep --axis x` (accelerometer), `rig turntable --axis yaw` (gyro)",
    "offset": "a static record (`rig noise`)",
    "deviation": "a static record (`rig noise`)",
    "noise_density": "a static record (`rig noise`)",
    "random_walk": "a long static record (`rig noise --length 1 h`)",
}


@dataclass(frozen=True)
class Choice:
    """What the file is for: one accelerometer unit, one set of gyros, and what a robot's file needs besides.

    `rate` is the rate of the messages on `topic`, Hz. `assumed` gives values (SI) for what was not determined, by the
    name that they have in the file; the file marks them as assumed.
    """

    unit: str = "unit_a"
    gyros: str = "gyro"
    rate: float | None = None
    topic: str = "/imu0"
    assumed: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _one_of("unit", self.unit, UNITS)
        _one_of("gyro", self.gyros, GYROS)
        if self.rate is not None and not (math.isfinite(self.rate) and self.rate > 0.0):
            raise BadInput(f"export: found the rate {self.rate} Hz, wanted a finite number above 0")
        for name, value in self.assumed.items():
            if not (math.isfinite(value) and value > 0.0):
                raise BadInput(f"export: found {value} assumed for {name}, wanted a finite number above 0")

    @property
    def accelerometers(self) -> tuple[str, ...]:
        """Channels of the unit along x, y, z."""
        return channels_of(self.unit)

    @property
    def rotations(self) -> tuple[str, ...]:
        """Channels of the gyros about x, y, z."""
        return channels_of(self.gyros)


def channels_of(triad: str) -> tuple[str, ...]:
    """The three channels of `unit_a` … `unit_c`, `gyro` or `backup`, in the order x, y, z."""
    return tuple(f"{triad}_{axis}" for axis in (ROTATIONS if triad in GYROS else AXES))


def needed(calibration: Calibration, channel: str, measurand: str) -> Result:
    """A determined result; raises BadInput with the reason it is missing, and the record that would determine it."""
    key = f"{channel}.{measurand}"
    found = calibration.find(key)
    if found is None:
        raise BadInput(
            f"calibration {calibration.name}: found no {key} ({why_missing(calibration, key)}), "
            f"wanted it from {SOURCES.get(measurand, 'a record that determines it')}"
        )
    if found.value is None or not math.isfinite(found.value):
        raise BadInput(f"calibration {calibration.name}: found {key} = {found.value}, wanted a finite number")
    if found.budget is None:
        raise BadInput(f"calibration {calibration.name}: found {key} without a budget, wanted its uncertainty too")
    return found


def value_of(calibration: Calibration, channel: str, measurand: str) -> float:
    """Value of a determined result, SI; raises BadInput as `needed` does."""
    value = needed(calibration, channel, measurand).value
    return float(value) if value is not None else math.nan


def why_missing(calibration: Calibration, key: str) -> str:
    """Why there is no value, in the calibration's own words."""
    listed = next((r for r in calibration.results if r.key == key), None)
    return "; ".join(listed.remarks) if listed is not None and listed.remarks else "not measured"


def worst(calibration: Calibration, channels: Sequence[str], measurand: str) -> Result:
    """The largest of a triad's three results; raises BadInput if one of them is missing."""
    return max((needed(calibration, channel, measurand) for channel in channels), key=lambda r: abs(r.value or 0.0))


def cross_axis(calibration: Calibration, triad: str) -> list[list[float]] | None:
    """Matrix C, shape (3, 3), of reading = C·motion once zero output and sensitivity are taken out; diagonal 1.

    None unless all six entries beside the diagonal were determined. IEEE Std 1293, misalignment and cross-axis terms.
    """
    names, word = (ROTATIONS, "cross_coupling") if triad in GYROS else (AXES, "cross_axis")
    matrix = []
    for channel, own in zip(channels_of(triad), names, strict=True):
        found = [calibration.find(f"{channel}.{word}_{other}") for other in names]
        row = [
            1.0 if other == own else result.value if result is not None else None
            for other, result in zip(names, found, strict=True)
        ]
        whole = [value for value in row if value is not None and math.isfinite(value)]
        if len(whole) < 3:
            return None
        matrix.append(whole)
    return matrix


def is_simulated(calibration: Calibration) -> str:
    """A line for files made from a simulated bench, empty otherwise."""
    return "SIMULATED: made on the simulated bench; says nothing about any real unit." if calibration.simulated else ""


def provenance(calibration: Calibration) -> list[str]:
    """Where the numbers come from, as lines without line breaks or control characters."""
    made = datetime.fromtimestamp(calibration.made, UTC).isoformat(timespec="seconds")
    lines = [
        is_simulated(calibration),
        f"Calibration {calibration.name} of {calibration.sensor}, serial {calibration.serial}, records up to {made}.",
        *(
            f"From run {source.run} ({source.procedure}), seal {source.digest or 'none'}."
            for source in calibration.sources
        ),
        *(
            f"{name}: mean {mean:.6g}, {low:.6g} to {high:.6g} {_CONDITIONS.get(name, '')}"
            for name, (mean, low, high) in calibration.conditions.items()
        ),
        *(f"OVERDUE standard used by explicit order: {name}." for name in calibration.overdue),
        *(f"Note: {flag}" for flag in calibration.flags),
        "Uncertainties are expanded, for a coverage probability of 95 %.",
    ]
    return [one_line(line) for line in lines if line]


_CONDITIONS: Mapping[str, str] = {"temperature": "°C", "supply": "V"}


def stated(result: Result) -> str:
    """One result as a comment: its key, the value with U in a laboratory's units, and what was remarked."""
    flagged = f" [{result.status}: {'; '.join(result.remarks)}]" if result.status == "flagged" else ""
    return one_line(f"{result.key}: {text(result)}{flagged}")


def one_line(line: str) -> str:
    """Text that cannot leave the comment or docstring it stands in."""
    return " ".join("".join(c if c.isprintable() else " " for c in line).split())


def yaml_float(value: float) -> str:
    """A float that every YAML reader takes for one: YAML 1.1 reads `1e-05` as text, `1.0e-05` as a number."""
    if not math.isfinite(value):
        raise BadInput(f"export: found {value}, wanted a finite number")
    number = repr(float(value))
    return number.replace("e", ".0e") if "e" in number and "." not in number else number


def _one_of(what: str, found: str, wanted: Sequence[str]) -> None:
    if found not in wanted:
        raise BadInput(f"export --{what}: found '{found}', wanted one of {', '.join(wanted)}")
