"""The bench file: which instruments there are, where they are, and what the bench may do."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from rig import units
from rig.bench.steps import BenchFacts, Limits, Plug
from rig.errors import ConfigError, StandardOverdue
from rig.record import Wires
from rig.sensor import AXES, Sensor
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
    `radius` of the cube's centre from the platter's axis, `platen` between the platter's axis and the plumb line.
    """

    beam: Angle = Field(ge=0)
    mount: Angle = Field(ge=0)
    radius: Length = Field(ge=0)
    platen: Angle | None = Field(default=None, ge=0)


class InfluenceFile(Strict):
    """What a budget has to allow for and no run measures: within ± `half_width` of a sensitivity, by whose word."""

    half_width: Ratio = Field(ge=0)
    source: str = Field(min_length=1)


Influence = Literal[
    "vibrometer_response", "transverse_motion", "laser_spot", "base_strain", "converter_linearity", "settling", "supply"
]


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


class NoiseFile(Strict):
    """Noise by the data sheet, between limits that every part of the kind keeps."""

    density: str = Field(description="of the white part, one-sided, such as 60 µg/√Hz or 0.1 (°/s)/√Hz")
    tolerance: Ratio = Field(gt=0, description="of the density, either way")
    corner: tuple[Frequency, Frequency] = Field(description="lowest and highest, flicker exceeds white below")

    @field_validator("corner")
    @classmethod
    def _ascending(cls, corner: tuple[float, float]) -> tuple[float, float]:
        if not 0.0 <= corner[0] <= corner[1]:
            raise ValueError(f"found {corner[0]:g} Hz to {corner[1]:g} Hz, wanted the lower one first")
        return corner


class ChannelFile(Strict):
    """What the data sheet says of one channel, and which others it belongs to."""

    part: str
    unit: str | None = Field(default=None, min_length=1, description="channels of one unit make a triad")
    quantity: Literal["acceleration", "rate"]
    axis: Literal["x", "y", "z"]
    sensitivity: str
    range: str
    bandwidth: Frequency
    tolerance: Ratio | None = Field(default=None, description="of the sensitivity, either way: the limits of a verdict")
    ratiometric: Voltage | None = Field(default=None, description="nominal supply, if the output follows the supply")
    temperature_coefficient: Ratio | None = Field(default=None, description="of the sensitivity, per kelvin")
    beside_spot: Length | None = Field(default=None, description="to the side of the vibrometer's spot on the shaker")
    off_centre: Length | None = Field(default=None, ge=0, description="at most, from the point that a radius is of")
    asymmetry: Ratio | None = Field(default=None, ge=0, description="at most, of the sensitivity between senses, half")
    nonlinearity: Ratio | None = Field(default=None, ge=0, description="at most, of the output at any rate")
    noise: NoiseFile | None = Field(default=None, description="by the data sheet; the calibration compares with it")

    @field_validator("range")
    @classmethod
    def _readable(cls, text: str, info: Any) -> str:
        if "quantity" in info.data:  # else the quantity itself is the mistake
            units.parse(text, info.data["quantity"])
        return text

    @field_validator("sensitivity")
    @classmethod
    def _of_its_quantity(cls, text: str, info: Any) -> str:
        if "quantity" in info.data:  # else the quantity itself is the mistake
            units.parse(text, "sensitivity" if info.data["quantity"] == "acceleration" else "rate_sensitivity")
        return text

    @field_validator("noise")
    @classmethod
    def _density_of_its_quantity(cls, noise: NoiseFile | None, info: Any) -> NoiseFile | None:
        if noise is not None and "quantity" in info.data:
            units.parse(noise.density, f"{info.data['quantity']}_density")
        return noise


class UnitFile(Strict):
    """How a unit of channels is called and drawn."""

    title: str | None = Field(default=None, min_length=1)
    colour: str | None = Field(default=None, pattern="^#[0-9A-Fa-f]{6}$")


class SensorFile(Strict):
    """The unit under test."""

    sensor: str
    serial: str
    channels: dict[str, ChannelFile] = Field(min_length=1)
    units: dict[str, UnitFile] = Field(default={}, description="by the name that channels give as their unit")
    primary: str | None = Field(default=None, description="the unit that the analyzer's input 2 is plugged to")

    @field_validator("channels")
    @classmethod
    def _axes_once(cls, channels: dict[str, ChannelFile]) -> dict[str, ChannelFile]:
        axes: dict[str, dict[str, str]] = {}
        quantities: dict[str, str] = {}
        for name, channel in channels.items():
            if channel.unit is None:
                continue
            if quantities.setdefault(channel.unit, channel.quantity) != channel.quantity:
                raise ValueError(f"found accelerometers and gyros in {channel.unit}, wanted a unit of one quantity")
            other = axes.setdefault(channel.unit, {}).setdefault(channel.axis, name)
            if other != name:
                raise ValueError(f"found {other} and {name} along {channel.axis} in {channel.unit}, wanted one of them")
        return channels

    @field_validator("units")
    @classmethod
    def _units_known(cls, found: dict[str, UnitFile], info: Any) -> dict[str, UnitFile]:
        known = {channel.unit for channel in info.data.get("channels", {}).values()}
        for name in found if known else ():
            if name not in known:
                raise ValueError(f"found {name}, wanted a unit that a channel names")
        return found

    @field_validator("primary")
    @classmethod
    def _primary_known(cls, name: str | None, info: Any) -> str | None:
        known = {c.unit for c in info.data.get("channels", {}).values() if c.quantity == "acceleration"}
        if name is not None and known and name not in known:
            raise ValueError(f"found {name}, wanted a unit of accelerometers that a channel names")
        return name


class SignalFile(Strict):
    """What the cables call the bench's own signals; the tag and the encoder's are settings of their drivers."""

    reference: str = Field(default=Wires.reference, min_length=1, description="the vibrometer's velocity")
    supply: str = Field(default=Wires.supply, min_length=1, description="supply of the unit, V")
    temperature: str = Field(default=Wires.temperature, min_length=1, description="at the unit, 10 mV/K from 0 °C")


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
    influences: dict[Influence, InfluenceFile] = Field(default_factory=dict)
    instruments: dict[Role, dict[str, str | float | int | bool | tuple[str, ...] | dict[str, str]]]
    cables: dict[Literal["shaker", "turntable"], tuple[str, ...]]
    signals: SignalFile = SignalFile()


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

    @property
    def unit(self) -> Sensor:
        """The unit under test as a value."""
        return Sensor.stated(self.sensor.model_dump(mode="json"))

    def beside(self, relative: str) -> Path:
        """A path written in the bench file, relative to the file."""
        return (self.path.parent / relative).resolve()

    @property
    def wires(self) -> Wires:
        """What the cables call the bench's own signals."""
        return Wires(**self.file.signals.model_dump())

    def inputs(self, role: str) -> tuple[str, ...] | None:
        """Names of a recorder's inputs where its entry gives none; None for a recorder on the cables, or unknown.

        The oscilloscope sees the reference and the primary unit's x, y, z; the cube's own frames carry as many values
        as the sensor file has channels, in its order, or they are not known.
        """
        unit = self.unit
        if role == "cube":
            return unit.names
        if role == "scope" and unit.primary is not None:
            axes = {axis: unit.primary.along(axis) for axis in AXES}
            return (self.wires.reference, *(f"spare {axis}" if one is None else one.name for axis, one in axes.items()))
        return None

    def plugs(self) -> dict[str, Plug]:
        """Where the analyzer's input 2 goes for each driven axis: to a channel of the shaker cables, primary first."""
        cables, unit = self.file.cables.get("shaker", ()), self.unit
        found: dict[str, Plug] = {}
        for axis in AXES:
            channels = [one for one in unit.along(axis) if one.name in cables]
            channels.sort(key=lambda one: unit.primary is None or one.triad != unit.primary.name)
            if channels:
                title = f"{unit.triad_of(channels[0].name).title} {axis}"
                found[axis] = Plug(channels[0].name, title, cables.index(channels[0].name))
        return found

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
            plugs=self.plugs(),
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
    sensor = config.load(near / file.sensors, SensorFile)
    _refuse_unwired(path, file, sensor)
    return BenchDescription(path, file, standards, sensor)


def _refuse_unwired(path: Path, file: BenchFile, sensor: SensorFile) -> None:
    """A sensor of which no cable carries a channel gives records that nothing can be made of. Raises ConfigError."""
    wired = {name for cables in file.cables.values() for name in cables}
    if not wired & sensor.channels.keys():
        text = (
            f"found none of the channels of {file.sensors} ({', '.join(sensor.channels)}), "
            "wanted at least one of them, by the name that it has there"
        )
        raise ConfigError([config.read(path).problem(("cables",), text)])


def filled(value: Any, addresses: Mapping[str, object]) -> Any:
    """`${gpib}` and the like replaced by what the served bench announced; other text is left as it is."""
    if isinstance(value, str):
        for name, address in addresses.items():
            value = value.replace("${" + name + "}", str(address))
        return value
    if isinstance(value, Mapping):
        return {key: filled(item, addresses) for key, item in value.items()}
    return value
