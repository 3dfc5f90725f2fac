"""What foreign data are, as their owner says it in a YAML file: `rig import MANIFEST.yaml` reads it.

    format: 1
    kind: rotation                      # response, sweep, rotation, motion, poses or static
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
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from rig import units
from rig.errors import ConfigError, Problem
from rig.foreign import meaning
from rig.units import Acceleration, Angle, Frequency, Length, Ratio, Time
from rig.yaml import config
from rig.yaml.document import Document

Kind = Literal["response", "sweep", "rotation", "motion", "poses", "static"]
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
SI_OF = {"acceleration": "m/s²", "rate": "rad/s"}
_PER = re.compile(r"\s*([-+0-9.eE]+)\s*(\S+)\s+per\s+(\S.*?)\s*")


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
    NPY, NPZ, MAT and HDF5: columns are named `variable` or `variable[3]` (from 0).
    """

    format: Literal["csv", "npy", "npz", "mat", "hdf5"] | None = None
    delimiter: str = Field(default=",", min_length=1, max_length=1)
    comment: str = "#"
    header: bool = True
    decimal: Literal[".", ","] = "."


class TimeBase(Strict):
    """When rows were sampled: a column of time stamps (in `unit`), or a constant `rate` or `interval`.

    `jitter`: standard uncertainty of one time stamp.
    """

    column: str | None = None
    unit: str = "s"
    rate: Frequency | None = Field(default=None, gt=0)
    interval: Time | None = Field(default=None, gt=0)
    jitter: Time = Field(default=0.0, ge=0)


class Column(Strict):
    """One column: what it is. `name` is the channel's name (default: the column's own).

    `unit` of the numbers in the file; for `counts`, `sensitivity` says how many of them per SI or other unit, and
    `zero` what stands for nothing. `tolerance` is the data sheet's for the sensitivity, relative; `bandwidth` that of
    its output filter, if it has one. `delay` is how much later than the row's time stamp it was sampled.
    `uncertainty` (with unit) is a standard one of each number; `gain_uncertainty` a relative standard one of a
    reference's sensitivity. `uncertainty_column` names the column with an uncertainty of each row, `coverage` its k.
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
    tolerance: Ratio = Field(default=0.2, gt=0)
    bandwidth: Frequency | None = Field(default=None, gt=0)
    delay: Time = 0.0
    uncertainty: str | None = None
    gain_uncertainty: Ratio | None = Field(default=None, ge=0)
    uncertainty_column: str | None = None
    coverage: float = Field(default=1.0, gt=0)

    @property
    def channel(self) -> str:
        """The channel's name."""
        return self.name or self.column

    @property
    def scale(self) -> float:
        """Numbers of the file per SI unit: value in SI = (number − zero) / scale for what has a plain unit."""
        if self.sensitivity is not None:
            return _per(self.sensitivity, self.quantity)
        kind = UNIT_KINDS[self.quantity]
        if not kind or not self.unit:
            return 1.0
        unit = units.KINDS[kind].units[self.unit]
        return unit.divide / unit.multiply


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
    the share at the end of every record that is held out (unless a file is). Left out: what the data allow."""

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
    if made.kind == "poses":
        turns = " and turns by known angles" if any(one.turn for one in made.segments) else ""
        return f"local gravity, {made.gravity.value:g} m/s², u = {made.gravity.uncertainty:g} m/s²{turns}"
    named = [one for one in made.columns if one.role == "reference" and one.quantity not in ("frequency",)]
    gains = {one.gain_uncertainty for one in made.columns if one.gain_uncertainty}
    known = [f"u of its gain {100.0 * one:g} %" for one in sorted(gains)] or ["no uncertainty of its gain stated"]
    columns = ", ".join(f"{one.channel} ({one.quantity})" for one in named) or "the reference of the table"
    return f"{columns}; {', '.join(known)}"


def load(path: Path) -> Manifest:
    """Read a manifest. Raises ConfigError that names every mistake by file, line, column and key."""
    document = config.read(path)
    made = config.validate(document, Manifest)
    problems = sorted(mistakes(document, made))
    if problems:
        raise ConfigError(problems)
    return made


def _per(text: str, quantity: str) -> float:
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


NEEDED: dict[str, tuple[tuple[Role, str], ...]] = {
    "response": (("reference", "frequency"),),
    "sweep": (),
    "rotation": (),
    "motion": (),
    "poses": (),
    "static": (),
}


def mistakes(document: Document, made: Manifest) -> Iterator[Problem]:
    """What the types cannot say."""
    yield from _of_columns(document, made)
    yield from _of_kind(document, made)
    yield from _of_rotation(document, made)
    yield from _unread(document, made)
    if made.reading.decimal == made.reading.delimiter:
        yield document.problem(
            ("reading",), "found the comma as delimiter and as decimal sign, wanted another delimiter"
        )
    if made.time is not None:
        given = [made.time.column is not None, made.time.rate is not None, made.time.interval is not None]
        if sum(given) != 1:
            yield document.problem(("time",), f"found {sum(given)} of column, rate and interval, wanted one")
        elif made.time.unit not in units.KINDS["time"].units:
            yield document.problem(("time", "unit"), f"found '{made.time.unit}', wanted a unit such as 's' or 'ms'")


def _of_columns(document: Document, made: Manifest) -> Iterator[Problem]:
    names: set[str] = set()
    for number, one in enumerate(made.columns):
        at = ("columns", number)
        if one.channel in names:
            yield document.problem(at, f"found the channel '{one.channel}' twice, wanted another name")
        names.add(one.channel)
        kind = UNIT_KINDS[one.quantity]
        if one.sensitivity is not None:
            try:
                _per(one.sensitivity, one.quantity)
            except ValueError as error:
                yield document.problem((*at, "sensitivity"), str(error))
        elif kind and one.unit not in units.KINDS[kind].units:
            wanted = units.KINDS[kind]
            yield document.problem((*at, "unit"), f"found '{one.unit}', wanted the unit of {wanted.wanted}")
        if one.uncertainty is not None and (said := _wrong(one.uncertainty, kind)):
            yield document.problem((*at, "uncertainty"), said)
        needs_axis = (one.role == "device" and one.quantity in SI_OF) or one.quantity == "position"
        if needs_axis and one.axis is None and made.kind not in ("response", "sweep"):
            yield document.problem((*at, "axis"), "found nothing, wanted x, y or z")
        if one.quantity == "quaternion" and one.component is None:
            yield document.problem((*at, "component"), "found nothing, wanted w, x, y or z")


def _wrong(text: str, kind: str) -> str:
    """What is wrong with a quantity in text, "" if nothing."""
    try:
        units.parse(text, kind or "ratio")
    except units.UnitError as error:
        return str(error)
    return ""


def _of_kind(document: Document, made: Manifest) -> Iterator[Problem]:
    device = made.of("device")
    if not device:
        yield document.problem(("columns",), "found no column of the device, wanted one with role: device")
    for role, quantity in NEEDED[made.kind]:
        if not made.of(role, quantity):
            yield document.problem(("columns",), f"found no {role} column of {quantity}, wanted one for a {made.kind}")
    if made.kind == "response":
        there = {one.quantity for one in device}
        if not ({"magnitude", "phase"} <= there or {"real", "imaginary"} <= there):
            yield document.problem(("columns",), "found no response, wanted magnitude and phase or real and imaginary")
    if made.kind == "rotation":
        if made.rotation is None:
            yield document.problem((), "found no key 'rotation', wanted it to say the axis")
        quantities = {one.quantity for one in made.of("reference")}
        if not ({"angle"} <= quantities or {"line_a"} <= quantities):
            yield document.problem(("columns",), "found no reference of angle, wanted one, or an encoder's line_a")
        elif "angle" not in quantities and made.rotation is not None and made.rotation.lines is None:
            yield document.problem(("rotation", "lines"), "found nothing, wanted the encoder's lines per revolution")
    if made.kind == "motion":
        yield from _of_motion(document, made)
    if made.kind == "sweep" and not made.of("reference"):
        yield document.problem(("columns",), "found no reference, wanted a column with role: reference")
    if made.kind not in ("response",) and made.time is None:
        yield document.problem((), "found no key 'time', wanted a column of time stamps, a rate or an interval")
    if len(made.files) > 1 and made.segments and made.kind in ("poses", "rotation"):
        yield document.problem(("segments",), f"found segments and {len(made.files)} files, wanted one file")
    for number, one in enumerate(made.segments):
        if one.last <= one.first:
            yield document.problem(("segments", number, "last"), f"found {one.last}, wanted more than {one.first}")
        if (one.turn is None) != (one.angle is None):
            yield document.problem(("segments", number), "found turn or angle alone, wanted both")


def _of_rotation(document: Document, made: Manifest) -> Iterator[Problem]:
    """Axes and radius of a rotation that do not go together, and segments that do not lie on its axis."""
    turned = made.rotation
    if made.kind != "rotation" or turned is None:
        return
    for key in ("outward", "radius_uncertainty"):
        if getattr(turned, key) and not turned.radius:
            yield document.problem(("rotation", key), f"found '{getattr(turned, key)}' without a radius, wanted one")
    if turned.outward is not None and turned.outward[1] == turned.axis:
        yield document.problem(
            ("rotation", "outward"), f"found '{turned.outward}', wanted an axis across {turned.axis}"
        )
    if turned.lines is not None and made.of("reference", "angle"):
        yield document.problem(("rotation", "lines"), "found lines beside an angle, wanted one of them")
    for number, one in enumerate(made.segments):
        if one.turn is not None:
            yield document.problem(("segments", number, "turn"), f"found '{one.turn}', wanted nothing in a rotation")
        if one.up is not None and (one.up[1] == turned.axis) != turned.upright:
            wanted = f"+{turned.axis} or -{turned.axis}" if turned.upright else f"an axis across {turned.axis}"
            yield document.problem(("segments", number, "up"), f"found '{one.up}', wanted {wanted}")


def _unread(document: Document, made: Manifest) -> Iterator[Problem]:
    """Keys that would change nothing."""
    inner = {f"gravity.{name}" for name in made.gravity.model_fields_set}
    inner |= {f"compared.{name}" for name in made.compared.model_fields_set}
    for key, wanted in meaning.of_file(made.kind, made.model_fields_set | inner):
        yield document.problem(tuple(key.split(".")), f"found '{key.split('.')[-1]}', {wanted}")
    for number, one in enumerate(made.columns):
        at = ("columns", number)
        for key, wanted in meaning.of_column(made.kind, one.role, one.quantity, one.model_fields_set):
            yield document.problem((*at, key), f"found '{key}', {wanted}")
        if "coverage" in one.model_fields_set and one.uncertainty is None and one.uncertainty_column is None:
            yield document.problem((*at, "coverage"), "found it alone, wanted an uncertainty that it covers")
        if one.uncertainty is not None and one.uncertainty_column is not None:
            yield document.problem((*at, "uncertainty"), "found it beside uncertainty_column, wanted one of them")
    yield from _together(document, made)
    base = made.time
    if base is not None and base.column is None:
        for key in sorted(base.model_fields_set & {"unit", "jitter"}):
            yield document.problem(("time", key), f"found '{key}' without a column of time stamps, wanted one")


def _together(document: Document, made: Manifest) -> Iterator[Problem]:
    """What belongs to a whole reference, of which one column says it and another says otherwise."""
    groups: dict[str, list[tuple[str, ...]]] = {
        "rotation": [("line_a", "line_b", "index_line")],
        "motion": [("position", "quaternion"), ("position",)],
    }
    for quantities in groups.get(made.kind, ()):
        there = [
            (k, one) for k, one in enumerate(made.columns) if one.role == "reference" and one.quantity in quantities
        ]
        for key in ("delay", "gain_uncertainty") if len(quantities) != 2 else ("delay",):
            for number, one in there[1:]:
                if getattr(one, key) != getattr(there[0][1], key):
                    said = f"found another {key} than that of {there[0][1].channel}, wanted one for the whole reference"
                    yield document.problem(("columns", number), said)


def _of_motion(document: Document, made: Manifest) -> Iterator[Problem]:
    """A track needs every component of position and attitude, and how the attitude is to be read."""
    if made.pose is None:
        yield document.problem((), "found no key 'pose', wanted it to say how the quaternion turns and which way is up")
    for quantity, names in (("quaternion", "wxyz"), ("position", "xyz")):
        columns = made.of("reference", quantity)
        there = [one.component if quantity == "quaternion" else one.axis for one in columns]
        lacking = [name for name in names if name not in there]
        if lacking:
            text = f"found no reference column of {quantity} {', '.join(lacking)}, wanted {', '.join(names)}"
            yield document.problem(("columns",), text)


def as_json(made: Manifest) -> dict[str, Any]:
    """The manifest as a run's header keeps it; `from_json` reads it back to the same value."""
    return made.model_dump(mode="json", exclude_none=True)


def from_json(body: Any) -> Manifest:
    """A manifest from a run's header."""
    import json

    return Manifest.model_validate_json(json.dumps(body), strict=True)
