"""What foreign data are, as their owner says it in a YAML file: `rig import MANIFEST.yaml` reads it.

    format: 1
    kind: rotation                      # one of KINDS
    unit: {serial: MPU6050-moving, model: MPU-6050}
    provenance: {source: "https://…", licence: MIT, citation: …, note: …}
    files: [{path: yaw_medium_120s.csv, label: yaw medium}]
    time: {column: t_s, unit: s}        # or {rate: 100 Hz}, or {interval: 10 ms}
    rotation: {axis: z, upright: true}
    columns:
    - {column: encoder_deg, quantity: angle, unit: °, role: reference, uncertainty: 0.05 °}
    - {column: moving_gyro_z_dps, name: gyro_z, quantity: rate, unit: °/s, axis: z, tolerance: 3 %}

Every column that is named is kept as it stands in the file; nothing is rescaled, mended or left out on the way in.
A device's column is in a physical unit, or in counts with a sensitivity ("170 counts per m/s²") and a zero.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from rig import units
from rig.units import Acceleration, Angle, Frequency, Length, Ratio, Time

Role = Literal["device", "reference", "drive", "condition"]
Axis = Literal["x", "y", "z"]
Signed = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Quantity = Literal[
    "acceleration", "rate", "angle", "position", "quaternion", "temperature", "voltage", "unstated",
    "frequency", "magnitude", "phase", "real", "imaginary", "excitation", "line_a", "line_b", "index_line",
]  # fmt: skip
# the kind of unit (rig.units) that a quantity is written in; "" is a plain number
UNIT_KINDS: dict[str, str] = {
    "acceleration": "acceleration", "rate": "rate", "angle": "angle", "position": "length", "quaternion": "",
    "temperature": "temperature", "voltage": "voltage", "unstated": "", "frequency": "frequency", "magnitude": "",
    "phase": "angle", "real": "", "imaginary": "", "excitation": "acceleration", "line_a": "voltage",
    "line_b": "voltage", "index_line": "voltage",
}  # fmt: skip
RATIOS = ("magnitude", "real", "imaginary")  # of a response: plain, or in units of a sensitivity
SI_OF = {"acceleration": "m/s²", "rate": "rad/s"}
_PER = re.compile(r"\s*([-+0-9.eE]+)\s*(\S+)\s+per\s+(\S.*?)\s*")


# kinds of data


@dataclass(frozen=True)
class Read:
    """Columns of which a key says something: of a role, and of these quantities; all where none are named."""

    role: Role
    quantities: frozenset[str] = frozenset()

    def holds(self, role: str, quantity: str) -> bool:
        """Whether such a column is among them."""
        return self.role == role and (not self.quantities or quantity in self.quantities)


@dataclass(frozen=True)
class DataKind:
    """A kind of foreign data, and all that a manifest says of it alone.

    `title` in words, what was `done` and what it `needs`, for a reader; columns that are `wanted`, by role and
    quantity ("" for any). `timed`: rows are samples in time. `axes`: a device's channels must say theirs. `keys` of
    the file, and of its `columns`, that say something: what no code would read is refused, with what is right
    `instead`.
    """

    title: str
    done: str
    needs: str
    wanted: tuple[tuple[Role, str], ...] = ()
    timed: bool = True
    axes: bool = True
    keys: frozenset[str] = frozenset()
    columns: Mapping[str, tuple[Read, ...]] = field(default_factory=dict)
    instead: Mapping[str, str] = field(default_factory=dict)


def _at(role: Role, *quantities: str) -> Read:
    return Read(role, frozenset(quantities))


RATIO = ("magnitude", "real")
FELT = ("acceleration", "rate", "unstated", "voltage")
LINES = ("line_a", "line_b", "index_line")
UNCERTAIN = ("uncertainty", "uncertainty_column", "coverage")
TOLERANCE = {"tolerance": (_at("device", *FELT, *RATIO),)}
ACCEPTED = {"findings": (_at("device", *FELT), _at("reference", *FELT, "angle", "position"))}
SAMPLED = {**TOLERANCE, **ACCEPTED, "bandwidth": (_at("device", *FELT),)}
BANDS = {"compared", "compared.rate_band", "compared.force_band", "compared.held_out"}
KINDS: Mapping[str, DataKind] = {
    "response": DataKind(
        "frequency response", "a table over frequency: magnitude and phase, or real and imaginary part",
        "a reference `frequency`", wanted=(("reference", "frequency"),), timed=False, axes=False,
        keys=frozenset({"gravity", "standard"}),
        columns={
            **TOLERANCE, **dict.fromkeys(UNCERTAIN, (_at("device"),)), "bandwidth": (_at("device", *RATIO),),
            "gain_uncertainty": (_at("reference", "excitation"), _at("device", *RATIO)),
        },
        instead={
            "delay": ": a response's phase has it already",
            "gain_uncertainty": ": it belongs to the excitation, or to the magnitude",
            "compared": ": `held_out: true` marks a file, else every third frequency is held out",
        },
    ),
    "sweep": DataKind(
        "shaker sweep", "a shaker, with a second accelerometer as reference", "a reference; time",
        wanted=(("reference", ""),), axes=False, keys=frozenset({"time", "mains", "gravity", "standard"}),
        columns={
            **SAMPLED, "delay": (_at("device"), _at("reference")),
            "gain_uncertainty": (_at("reference", "acceleration", "unstated", "voltage"),),
        },
        instead={"compared": ": `held_out: true` marks a file, else every third point is held out"},
    ),
    "rotation": DataKind(
        "rotation", "turned about one axis, with an encoder",
        "a reference `angle`, or `line_a` and `rotation.lines`; time",
        keys=frozenset({"time", "rotation", "segments", "gravity", "standard", *BANDS}),
        columns={
            **SAMPLED, **dict.fromkeys(UNCERTAIN, (_at("reference", "angle"),)),
            "delay": (_at("device"), _at("reference", "angle", *LINES)),
            "gain_uncertainty": (_at("reference", "angle"),), "noise": (_at("device", "acceleration", "rate"),),
        },
        instead={"gain_uncertainty": ": it belongs to the reference's angle; an encoder's lines close in a turn"},
    ),
    "motion": DataKind(
        "free motion", "moved freely before cameras", "a reference `quaternion` and `position`; time",
        keys=frozenset({"time", "pose", "gravity", "standard", *BANDS}),
        columns={
            **SAMPLED, "component": (_at("reference", "quaternion"),),
            "delay": (_at("device"), _at("reference", "position", "quaternion")),
            "gain_uncertainty": (_at("reference", "position"),),
        },
        instead={"gain_uncertainty": ": it belongs to the positions"},
    ),
    "poses": DataKind(
        "still poses", "held still in many attitudes; perhaps turned by known angles between them", "time",
        keys=frozenset(
            {"time", "segments", "gravity", "gravity.uncertainty", "standard", "compared", "compared.held_out"}
        ),
        columns={**TOLERANCE, **ACCEPTED},
        instead={
            "gain_uncertainty": ": gravity is the reference, and gravity.uncertainty says how well it is known",
        },
    ),
    "static": DataKind("record at rest", "at rest", "time", keys=frozenset({"time"}), columns=TOLERANCE),
}  # fmt: skip
if TYPE_CHECKING:
    Kind = str
else:
    Kind = Literal[tuple(KINDS)]


# keys


class Strict(BaseModel):
    """A part of the file that refuses what it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class UnitUnderTest(Strict):
    """The device: `serial` names its model file, so runs of one device share it."""

    serial: str = Field(min_length=1)
    model: str = ""
    maker: str = ""


class Provenance(Strict):
    """Where the data come from, so that anybody can fetch them, and under which licence."""

    source: str = Field(min_length=1)
    licence: str = Field(min_length=1)
    citation: str = ""
    note: str = ""


class Source(Strict):
    """One file: a record of its own. `settings` are free; `frequency` (what was commanded, a text with a unit) and
    `level` (a name) have a meaning for sweeps. `held_out`: models are judged by it and not fitted to it."""

    path: str = Field(min_length=1)
    label: str = ""
    settings: dict[str, str | float] = Field(default_factory=dict)
    held_out: bool = False


class Reading(Strict):
    """How the files are to be read; left out, it is told from their names' endings.

    CSV: `delimiter`, lines beginning with `comment` are skipped, `header` false if no line names the columns (they are
    then "1", "2", …); a `delimiter` of one blank means any run of blanks. `decimal` is the sign before the decimals.
    `skip` lines stand before the one that names the columns; an LVM file's own header needs no number. `units`: a line
    of units follows the names; what they are is said in `columns`.
    NPY, NPZ, MAT and HDF5: columns are named `variable` or `variable[3]` (from 0).
    """

    format: Literal["csv", "npy", "npz", "mat", "hdf5"] | None = None
    delimiter: str = Field(default=",", min_length=1, max_length=1)
    comment: str = "#"
    header: bool = True
    decimal: Literal[".", ","] = "."
    skip: int = Field(default=0, ge=0)
    units: bool = False


class TimeBase(Strict):
    """When rows were sampled: a column of time stamps (in `unit`), or a constant `rate` or `interval`.

    `jitter`: standard uncertainty of one time stamp.
    """

    column: str | None = None
    unit: str = "s"
    rate: Frequency | None = Field(default=None, gt=0)
    interval: Time | None = Field(default=None, gt=0)
    jitter: Time = Field(default=0.0, ge=0)


class SheetNoise(Strict):
    """Noise by a data sheet: one-sided `density` of its white part, with unit, right to a relative `tolerance`.

    Flicker is as strong as the white part at a corner somewhere between the two of `corner`; none without.
    """

    density: str
    tolerance: Ratio = Field(default=0.2, gt=0)
    corner: tuple[Frequency, Frequency] | None = None

    def density_si(self, of_rate: bool) -> float:
        """(rad/s)/√Hz or (m/s²)/√Hz. Raises ValueError for no such quantity."""
        return units.parse(self.density, "rate_density" if of_rate else "acceleration_density")


class Column(Strict):
    """One column: what it is. `name` is the channel's name (default: the column's own).

    `unit` of the numbers in the file; for `counts`, `sensitivity` says how many of them per SI or other unit, and
    `zero` what stands for nothing; `missing` is the number that stands for no number, such as −999. `tolerance` is the
    data sheet's for the sensitivity, relative; `bandwidth` that of its output filter, if it has one. `delay` is how
    much later than the row's time stamp it was sampled.
    `uncertainty` (with unit) is a standard one of each number; `gain_uncertainty` a relative standard one of a
    reference's sensitivity. `uncertainty_column` names the column with an uncertainty of each row, `coverage` its k.
    `noise` is the device's by its data sheet. `findings: accepted` says that somebody has looked at the samples that
    import found to be no measurement: they are left out, and a model may be adequate all the same.
    """

    column: str = Field(min_length=1)
    name: str = ""
    quantity: Quantity
    unit: str = ""
    axis: Axis | None = None
    component: Literal["w", "x", "y", "z"] | None = None
    role: Role = "device"
    sensitivity: str | None = None
    zero: float = 0.0
    missing: float | None = None
    tolerance: Ratio = Field(default=0.2, gt=0)
    bandwidth: Frequency | None = Field(default=None, gt=0)
    delay: Time = 0.0
    uncertainty: str | None = None
    gain_uncertainty: Ratio | None = Field(default=None, ge=0)
    uncertainty_column: str | None = None
    coverage: float = Field(default=1.0, gt=0)
    noise: SheetNoise | None = None
    findings: Literal["accepted"] | None = None

    @property
    def channel(self) -> str:
        """The channel's name."""
        return self.name or self.column

    @property
    def scale(self) -> float:
        """Numbers of the file per SI unit: value in SI = (number − zero) / scale for what has a plain unit."""
        if self.sensitivity is not None:
            return per(self.sensitivity, self.quantity)
        kind = self.unit_kind
        if not kind or not self.unit:
            return 1.0
        unit = units.KINDS[kind].units[self.unit]
        return unit.divide / unit.multiply

    @property
    def unit_kind(self) -> str:
        """The kind of unit (rig.units) of its numbers, "" for plain ones; a response may be stated in V per m/s²."""
        return UNIT_KINDS[self.quantity] or ("sensitivity" if self.quantity in RATIOS and self.unit else "")

    @property
    def volts(self) -> float | None:
        """V per SI unit of what is sensed, as stated; 1 for a voltage, of which nobody says; None for other numbers."""
        if self.quantity == "voltage" or (self.quantity in RATIOS and self.unit):
            return 1.0
        factor = self._volts_per_number
        return None if factor is None else self.scale * factor

    @property
    def zero_volts(self) -> float:
        """`zero` in V, of numbers that are volts."""
        return self.zero / self.scale if self.quantity == "voltage" else self.zero * (self._volts_per_number or 0.0)

    @property
    def _volts_per_number(self) -> float | None:
        found = _PER.fullmatch(self.sensitivity or "")
        return None if found is None else {"V": 1.0, "mV": 1e-3}.get(found[2])


class Rotation(Strict):
    """Turned about one axis of the case: `axis`, `upright` if it stands along the plumb line (else it lies level).

    `sense`: +1 if the reference's angle counts as a right-hand turn about the axis, −1 if against, left out if nobody
    says: it is then found and reported. `lines` of an encoder per revolution, for sampled lines. `radius` of the case
    from the axis, with its standard uncertainty; `outward` is the case's axis that points away from the axis of
    rotation, left out if nobody says: it is then found from the accelerometers and reported.
    """

    axis: Axis
    upright: bool
    sense: Literal[1, -1] | None = None
    lines: int | None = Field(default=None, gt=0)
    radius: Length = Field(default=0.0, ge=0)
    radius_uncertainty: Length = Field(default=0.0, ge=0)
    outward: Signed | None = None


class Pose(Strict):
    """A track of position and attitude: `quaternion` says which way it turns vectors, `up` which world axis is up."""

    quaternion: Literal["body_to_world", "world_to_body"] = "body_to_world"
    up: Axis = "z"


class Segment(Strict):
    """Rows of a record with a known state. Of poses: at rest, or one turn by a known `angle` about an axis, with its
    standard uncertainty. Of a rotation: how the case stood on the axis. `up`: which case axis points up, e.g. "+x", if
    known."""

    label: str = ""
    first: int = Field(ge=0)
    last: int = Field(gt=0)
    up: Signed | None = None
    turn: Axis | None = None
    angle: Angle | None = None
    angle_uncertainty: Angle = Field(default=0.0, ge=0)


class Gravity(Strict):
    """Local gravity and its standard uncertainty."""

    value: Acceleration = Field(default=units.STANDARD_GRAVITY, gt=9.0, lt=10.0)
    uncertainty: Acceleration = Field(default=0.02, gt=0)


class Standard(Strict):
    """What the reference was calibrated against: the chain of traceability goes on with its certificate.

    `name` of the reference standard, the number of its `certificate`, and the `laboratory` that gave it; `instrument`
    and `serial` of the standard, `due` (a date) where they are known.
    """

    name: str = Field(min_length=1)
    certificate: str = Field(min_length=1)
    laboratory: str = Field(min_length=1)
    instrument: str = ""
    serial: str = ""
    due: str = Field(default="", pattern=r"^(\d{4}-\d{2}-\d{2})?$")


class Compared(Strict):
    """What a model is compared with: frequencies up to `rate_band` for gyros and `force_band` for accelerometers, and
    the share of every record that is held out, all over it (unless a file is). Left out: what the data allow."""

    rate_band: Frequency | None = Field(default=None, gt=0)
    force_band: Frequency | None = Field(default=None, gt=0)
    held_out: Ratio = Field(default=0.4, gt=0, lt=0.9)


class Manifest(Strict):
    """Foreign data, described."""

    format: Literal[1]
    kind: Kind
    label: str = Field(default="import", pattern="^[A-Za-z0-9][A-Za-z0-9 _-]{0,60}$")
    unit: UnitUnderTest
    provenance: Provenance
    files: Annotated[list[Source], Field(min_length=1)]
    reading: Reading = Reading()
    time: TimeBase | None = None
    columns: Annotated[list[Column], Field(min_length=1)]
    rotation: Rotation | None = None
    pose: Pose | None = None
    segments: list[Segment] = Field(default_factory=list)
    gravity: Gravity = Gravity()
    mains: Frequency | None = Field(default=None, gt=0)
    compared: Compared = Compared()
    standard: Standard | None = None

    def of(self, role: Role, quantity: str | None = None) -> list[Column]:
        """Columns of a role, and of a quantity if one is named."""
        return [one for one in self.columns if one.role == role and quantity in (None, one.quantity)]


def referred_to(made: Manifest) -> str:
    """What the device was compared with, in words, as the manifest describes it."""
    if "gravity.uncertainty" in KINDS[made.kind].keys:
        turns = " and turns by known angles" if any(one.turn for one in made.segments) else ""
        return f"local gravity, {made.gravity.value:g} m/s², u = {made.gravity.uncertainty:g} m/s²{turns}"
    named = [one for one in made.columns if one.role == "reference" and one.quantity not in ("frequency",)]
    gains = {one.gain_uncertainty for one in made.columns if one.gain_uncertainty}
    known = [f"u of its gain {100.0 * one:g} %" for one in sorted(gains)] or ["no uncertainty of its gain stated"]
    columns = ", ".join(f"{one.channel} ({one.quantity})" for one in named) or "the reference of the table"
    return f"{columns}; {', '.join(known)}"


def per(text: str, quantity: str) -> float:
    """Numbers per SI unit from "170 counts per m/s²"; raises ValueError with what was wanted."""
    wanted = f"found '{text}', wanted text such as '170 counts per {SI_OF.get(quantity, 'V')}'"
    found, kind = _PER.fullmatch(text), UNIT_KINDS.get(quantity, "")
    if found is None or not kind or found[3] not in units.KINDS[kind].units:
        raise ValueError(wanted)
    unit = units.KINDS[kind].units[found[3]]
    try:
        number = float(found[1])
    except ValueError:
        raise ValueError(wanted) from None
    if number == 0.0:
        raise ValueError(wanted)
    return number * unit.divide / unit.multiply


def as_json(made: Manifest) -> dict[str, Any]:
    """The manifest as a run's header keeps it; `from_json` reads it back to the same value."""
    return made.model_dump(mode="json", exclude_none=True)


def from_json(body: Any) -> Manifest:
    """A manifest from a run's header."""
    import json

    return Manifest.model_validate_json(json.dumps(body), strict=True)
