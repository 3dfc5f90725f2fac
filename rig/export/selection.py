"""Which numbers of a calibration go into a robot's file, where they came from, and what if one is missing.

Axes of the cube: x forward, y against gravity on the shaker table, z to the side, right-handed. Gyros: roll about x,
yaw about y, pitch about z; a triad is always named in the order x, y, z.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from rig.calibrate.calibration import Calibration, Result, text
from rig.errors import BadInput
from rig.sensor import Quantity, Triad

# What a technician runs to determine a measurand that is missing.
SOURCES: Mapping[str, str] = {
    "sensitivity": "a run of its axis: `rig sweep --axis x` (accelerometer), `rig turntable --axis yaw` (gyro)",
    "offset": "a static record (`rig noise`)",
    "deviation": "a static record (`rig noise`)",
    "noise_density": "a static record (`rig noise`)",
    "random_walk": "a long static record (`rig noise --length 1 h`)",
}


NOUNS: Mapping[Quantity, str] = {"acceleration": "accelerometers", "rate": "gyros"}
OPTIONS: Mapping[Quantity, str] = {"acceleration": "unit", "rate": "gyro"}  # of `rig export`


@dataclass(frozen=True)
class Choice:
    """What the file is for: one accelerometer unit, one set of gyros, and what a robot's file needs besides.

    Either is None for a sensor without such parts. `rate` is the rate of the messages on `topic`, Hz. `assumed` gives
    values (SI) for what was not determined, by the name that they have in the file; the file marks them as assumed.
    """

    unit: Triad | None = None
    gyros: Triad | None = None
    rate: float | None = None
    topic: str = "/imu0"
    assumed: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.rate is not None and not (math.isfinite(self.rate) and self.rate > 0.0):
            raise BadInput(f"export: found the rate {self.rate} Hz, wanted a finite number above 0")
        for name, value in self.assumed.items():
            if not (math.isfinite(value) and value > 0.0):
                raise BadInput(f"export: found {value} assumed for {name}, wanted a finite number above 0")


def chosen(calibration: Calibration, quantity: Quantity, name: str | None) -> Triad | None:
    """The unit of that name; without one the primary accelerometers, or the first gyros, or None if there are none.

    Raises BadInput for a name that no unit of that quantity has.
    """
    sensor = calibration.under_test
    known = sensor.of_quantity(quantity)
    if name is None:
        return sensor.primary if quantity == "acceleration" else next(iter(known), None)
    for triad in known:
        if triad.name == name:
            return triad
    wanted = f"one of {', '.join(triad.name for triad in known)}" if known else f"none: there are no {NOUNS[quantity]}"
    raise BadInput(f"export --{OPTIONS[quantity]}: found '{name}', wanted {wanted}")


def whole(calibration: Calibration, triad: Triad | None, quantity: Quantity) -> Triad:
    """A triad with an axis along each of x, y, z; raises BadInput with what there is instead."""
    if triad is None:
        raise BadInput(f"calibration {calibration.name}: found no {NOUNS[quantity]}, wanted a triad of them; {ALONE}")
    if not triad.is_whole:
        raise BadInput(
            f"calibration {calibration.name}: found {triad.name} along {', '.join(triad.axes)} alone, wanted a triad: "
            f"channels along x, y and z; {ALONE}"
        )
    return triad


IMPORT = "import"  # the procedure of a run that was imported
_COMMAND = re.compile(r":? \(?`.*")  # a command of the bench, which no imported record was made by
ALONE = "single channels go into csv, mat, hdf5 and python"


def imported(calibration: Calibration) -> bool:
    """Whether somebody else's records are all that it was made from."""
    return bool(calibration.sources) and all(source.procedure == IMPORT for source in calibration.sources)


def needed(calibration: Calibration, channel: str, measurand: str) -> Result:
    """The determined result to use, of a sensitivity that of all references together; raises BadInput with the reason
    it is missing, and the record that would determine it.
    """
    key = f"{channel}.{measurand}"
    found = calibration.to_use(channel, measurand)
    if found is None:
        source = SOURCES.get(measurand, "a record that determines it")
        source = _COMMAND.sub("", source) if imported(calibration) else source
        raise BadInput(
            f"calibration {calibration.name}: found no {key} ({why_missing(calibration, key)}), wanted it from {source}"
        )
    if found.value is None or not math.isfinite(found.value):
        raise BadInput(f"calibration {calibration.name}: found {found.key} = {found.value}, wanted a finite number")
    if found.budget is None:
        raise BadInput(
            f"calibration {calibration.name}: found {found.key} without a budget, wanted its uncertainty too"
        )
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


def cross_axis(calibration: Calibration, triad: Triad) -> list[list[float]] | None:
    """Matrix C, shape (3, 3), of reading = C·motion once zero output and sensitivity are taken out; diagonal 1.

    None unless all six entries beside the diagonal were determined. IEEE Std 1293, misalignment and cross-axis terms.
    """
    word = "cross_coupling" if triad.quantity == "rate" else "cross_axis"
    names = [channel.word for channel in triad.channels]
    matrix = []
    for channel, own in zip(triad.names, names, strict=True):
        found = [calibration.find(f"{channel}.{word}_{other}") for other in names]
        row = [
            1.0 if other == own else result.value if result is not None else None
            for other, result in zip(names, found, strict=True)
        ]
        known = [value for value in row if value is not None and math.isfinite(value)]
        if len(known) < 3:
            return None
        matrix.append(known)
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
