"""The bench file: which instruments there are, where they are, and what the bench may do."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from rig import units
from rig.bench.steps import BenchFacts, Limits
from rig.errors import StandardOverdue
from rig.units import Acceleration, Angle, Frequency, Length, PeakVoltage, Ratio, Velocity, Voltage
from rig.yaml import config

Role = Literal["analyzer", "scope", "recorder", "vibrometer", "cube", "filter", "encoder", "turntable"]


class Strict(BaseModel):
    """Settings that refuse what they do not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Simulated(Strict):
    """The world that stands in for the hardware; the bench starts by itself."""

    world: str
    seed: int = Field(default=1, ge=0)


class ShakerFile(Strict):
    """`displacement_per_volt`: peak, per programmed source volt (peak, into 50 Ω)."""

    displacement_per_volt: Length = Field(gt=0)
    full_stroke: Length = Field(gt=0)
    full_acceleration: Acceleration = Field(gt=0)


class LimitFile(Strict):
    """What the bench may do, whatever its instruments can."""

    acceleration: Acceleration = Field(gt=0)
    stroke: Length = Field(gt=0)
    velocity: Velocity = Field(gt=0)
    source: PeakVoltage = Field(gt=0)


class AlignmentFile(Strict):
    """Limits of what is aligned by eye or by gauge: true values lie anywhere within ± these.

    `beam` between laser beam and motion, `mount` between the cube's faces and drive, plumb line or platter axis,
    `radius` of the cube's centre from the platter's axis.
    """

    beam: Angle = Field(ge=0)
    mount: Angle = Field(ge=0)
    radius: Length = Field(ge=0)


class StandardValue(Strict):
    """A value with its expanded uncertainty, as the certificate states them, with units."""

    kind: Literal["ratio", "time", "angle", "acceleration"]
    value: str
    expanded_uncertainty: str
    coverage_factor: float = Field(default=2.0, gt=0)

    @field_validator("value", "expanded_uncertainty")
    @classmethod
    def _readable(cls, text: str, info: Any) -> str:
        if "kind" in info.data:  # else the kind itself is the mistake
            units.parse(text, info.data["kind"])
        return text


class Standard(Strict):
    """A reference standard and its certificate."""

    standard: str
    instrument: str
    serial: str
    laboratory: str
    certificate: str
    calibrated: dt.date
    due: dt.date
    values: dict[str, StandardValue]


class SensorChannel(Strict):
    """What the data sheet says of one channel."""

    part: str
    quantity: Literal["acceleration", "rate"]
    axis: Literal["x", "y", "z"]
    sensitivity: str
    range: str
    bandwidth: Frequency
    tolerance: Ratio | None = Field(default=None, description="of the sensitivity, either way: the limits of a verdict")
    ratiometric: Voltage | None = Field(default=None, description="nominal supply, if the output follows the supply")
    temperature_coefficient: Ratio | None = Field(default=None, description="of the sensitivity, per kelvin")
    beside_spot: Length | None = Field(default=None, description="to the side of the vibrometer's spot on the shaker")

    @field_validator("range")
    @classmethod
    def _readable(cls, text: str, info: Any) -> str:
        if "quantity" in info.data:  # else the quantity itself is the mistake
            units.parse(text, info.data["quantity"])
        return text

    @property
    def sensitivity_si(self) -> float:
        """V/(m/s²) or V/(rad/s)."""
        return units.parse(self.sensitivity, "sensitivity" if self.quantity == "acceleration" else "rate_sensitivity")


class SensorFile(Strict):
    """The unit under test."""

    sensor: str
    serial: str
    channels: dict[str, SensorChannel]


class BenchFile(Strict):
    """A bench as its YAML file describes it; quantities are SI."""

    bench: str = Field(min_length=1)
    simulated: Simulated | None = None
    clock: Literal["system", "bench"]
    operator: str = Field(description="terminal, bench, or the path of an answers file")
    mains: Frequency = Field(gt=0)
    rate: Frequency = Field(gt=0)
    sensors: str
    standards: tuple[str, ...]
    recorders: tuple[Literal["recorder", "analyzer", "scope", "cube"], ...] = Field(min_length=1)
    shaker: ShakerFile
    limits: LimitFile
    filter_cutoff: Frequency = Field(default=5000.0, gt=0)
    alignment: AlignmentFile | None = Field(default=None, description="limits that a calibration's budget uses")
    instruments: dict[Role, dict[str, str | float | int | bool | dict[str, str]]]
    cables: dict[Literal["shaker", "turntable"], tuple[str, ...]]


@dataclass(frozen=True)
class BenchDescription:
    """A bench file with everything that it names."""

    path: Path
    file: BenchFile
    standards: tuple[Standard, ...]
    sensor: SensorFile

    @property
    def simulated(self) -> bool:
        return self.file.simulated is not None

    def beside(self, relative: str) -> Path:
        """A path written in the bench file, relative to the file."""
        return (self.path.parent / relative).resolve()

    def facts(self) -> BenchFacts:
        """What procedures may know before anything is connected."""
        limits, shaker = self.file.limits, self.file.shaker
        return BenchFacts(
            limits=Limits(limits.acceleration, limits.stroke, limits.velocity, limits.source),
            drive_constant=shaker.displacement_per_volt,
            scan_rate=self.file.rate,
            mains=self.file.mains,
            full_stroke=shaker.full_stroke,
            full_acceleration=shaker.full_acceleration,
            filter_cutoff=self.file.filter_cutoff,
            has=frozenset(self.file.instruments),
        )

    def overdue(self, now: float) -> list[Standard]:
        """Standards past their due date at bench-clock time `now` (s since 1970 UTC)."""
        today = dt.datetime.fromtimestamp(now, dt.UTC).date()
        return [standard for standard in self.standards if standard.due < today]

    def refuse_overdue(self, now: float, override: bool) -> list[str]:
        """Names of overdue standards that were overridden; raises StandardOverdue without the override."""
        late = self.overdue(now)
        if late and not override:
            rows = [f"{s.standard} ({s.instrument}, certificate {s.certificate}): found due {s.due}" for s in late]
            raise StandardOverdue(
                "; ".join(rows) + "; wanted a standard in date, or --allow-overdue (it will be on record)"
            )
        return [standard.standard for standard in late]


def describe(path: Path) -> BenchDescription:
    """Read a bench file and the files that it names; raises ConfigError with every mistake of the file at fault."""
    file = config.load(path, BenchFile)
    near = path.parent
    standards = tuple(config.load(near / name, Standard) for name in file.standards)
    return BenchDescription(path, file, standards, config.load(near / file.sensors, SensorFile))


def filled(value: Any, addresses: Mapping[str, object]) -> Any:
    """`${gpib}` and the like replaced by what the served bench announced; other text is left as it is."""
    if isinstance(value, str):
        for name, address in addresses.items():
            value = value.replace("${" + name + "}", str(address))
        return value
    if isinstance(value, Mapping):
        return {key: filled(item, addresses) for key, item in value.items()}
    return value
