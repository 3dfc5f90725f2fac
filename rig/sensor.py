"""The unit under test as a value: its channels in order, which of them belong together, what data sheets say; SI.

    sensor = Sensor.of(run.header)
    sensor.channel("unit_a_x").nominal          V/(m/s²)
    sensor.along("x"), sensor.about("yaw")      accelerometers along x, gyros about y
    sensor.primary.title                        unit A

A channel's name is a label and means nothing: what it senses, along which axis and with which others stands in the
sensor file. Axes are the case's, x y z; a turn about x is roll, about y yaw, about z pitch.

Channels of one `unit` make a triad, or as much of one as there is. A sensor file that names no units (older ones) has
them by its order: a channel begins a new unit where part or quantity change, or where its axis is taken. Such a unit
is called as its channels are up to their last underscore if they agree, and titled by place: unit A, B, … and gyros,
backup gyros, gyros 3, ….
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from rig import units
from rig.errors import BadInput

Quantity = Literal["acceleration", "rate"]

AXES = ("x", "y", "z")
ROTATIONS: Mapping[str, str] = {"roll": "x", "yaw": "y", "pitch": "z"}
"""Axis of the case by the name of a turn about it, in the order x, y, z."""

SI: Mapping[str, str] = {"acceleration": "m/s²", "rate": "rad/s"}
LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
GYROS = ("gyros", "backup gyros")  # titles of the first two triads of gyros
COLOURS: Mapping[str, tuple[str, ...]] = {
    "acceleration": ("#1f5fa8", "#c2571a", "#3c8a4a", "#7a3b8f"),
    "rate": ("#7a3b8f", "#c2571a", "#3c8a4a", "#1f5fa8"),
}
"""Of the triads of a quantity in their order, where the sensor file names none."""


@dataclass(frozen=True)
class SheetNoise:
    """Noise by the data sheet: one-sided `density` of the white part (SI/√Hz), right to a relative `tolerance`.

    Flicker is as strong as the white part at the corner, which lies between `corner[0]` and `corner[1]`, Hz.
    """

    density: float
    tolerance: float
    corner: tuple[float, float]


@dataclass(frozen=True)
class SensorChannel:
    """What the sensor file says of one channel; SI. `triad` is the name of its unit, `axis` x, y or z."""

    name: str
    triad: str
    part: str
    quantity: Quantity
    axis: str
    nominal: float
    range: str
    bandwidth: float
    tolerance: float | None = None
    ratiometric: float | None = None
    drift: float | None = None
    beside_spot: float | None = None
    noise: SheetNoise | None = None
    off_centre: float | None = None
    asymmetry: float | None = None
    nonlinearity: float | None = None

    @property
    def unit(self) -> str:
        """SI unit of what it senses."""
        return SI[self.quantity]

    @property
    def place(self) -> int:
        """0, 1, 2 for x, y, z."""
        return AXES.index(self.axis)

    @property
    def is_rate(self) -> bool:
        return self.quantity == "rate"

    @property
    def word(self) -> str:
        """Its axis as a technician says it: x, y, z, or roll, yaw, pitch."""
        return rotation_about(self.axis) if self.is_rate else self.axis


@dataclass(frozen=True)
class Triad:
    """Channels of one unit, in the order x, y, z as far as there are any. `letter` is empty for gyros."""

    name: str
    title: str
    colour: str
    letter: str
    quantity: Quantity
    channels: tuple[SensorChannel, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.channels)

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(channel.axis for channel in self.channels)

    @property
    def is_whole(self) -> bool:
        """Whether there is a channel along each of x, y, z."""
        return self.axes == AXES

    def along(self, axis: str) -> SensorChannel | None:
        """Its channel along an axis."""
        return next((channel for channel in self.channels if channel.axis == axis), None)


@dataclass(frozen=True)
class Sensor:
    """A unit under test: channels in the order of the file, triads in the order of their first channels."""

    name: str
    serial: str
    channels: tuple[SensorChannel, ...]
    triads: tuple[Triad, ...]
    primary: Triad | None

    @classmethod
    def of(cls, header: Mapping[str, Any]) -> Sensor:
        """As a run's header has it."""
        return cls.stated(header["sensor"])

    @classmethod
    def stated(cls, file: Mapping[str, Any]) -> Sensor:
        """As the sensor file has it. `primary` is the file's, else the first unit of accelerometers, else None."""
        rows: Mapping[str, Mapping[str, Any]] = file.get("channels") or {}
        channels = tuple(
            _channel(name, row, triad) for (name, row), triad in zip(rows.items(), _units(rows), strict=True)
        )
        triads = tuple(_triads(channels, file.get("units") or {}))
        accelerometers = [one for one in triads if one.quantity == "acceleration"]
        wanted = file.get("primary")
        primary = next((one for one in accelerometers if wanted in (None, one.name)), None)
        return cls(str(file.get("sensor", "")), str(file.get("serial", "")), channels, triads, primary)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.channels)

    def __contains__(self, name: object) -> bool:
        return any(channel.name == name for channel in self.channels)

    def channel(self, name: str) -> SensorChannel:
        """One channel; raises BadInput if the sensor has none of that name."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        raise BadInput(f"sensor {self.name}: found no channel '{name}', wanted one of {', '.join(self.names)}")

    def triad(self, name: str) -> Triad:
        """One triad by its unit's name; raises BadInput if there is none."""
        for triad in self.triads:
            if triad.name == name:
                return triad
        known = ", ".join(triad.name for triad in self.triads) or "none"
        raise BadInput(f"sensor {self.name}: found no unit '{name}', wanted one of {known}")

    def triad_of(self, channel: str) -> Triad:
        """The triad that a channel belongs to."""
        return self.triad(self.channel(channel).triad)

    def of_quantity(self, quantity: Quantity) -> tuple[Triad, ...]:
        """Triads of accelerometers or of gyros."""
        return tuple(triad for triad in self.triads if triad.quantity == quantity)

    def along(self, axis: str) -> tuple[SensorChannel, ...]:
        """Accelerometers along an axis."""
        return tuple(c for c in self.channels if c.quantity == "acceleration" and c.axis == axis)

    def about(self, axis: str) -> tuple[SensorChannel, ...]:
        """Gyros about an axis, which may be called x, y, z or roll, yaw, pitch."""
        return tuple(c for c in self.channels if c.is_rate and c.axis == ROTATIONS.get(axis, axis))

    def samples(self, recorded: Iterable[str]) -> tuple[SensorChannel, ...]:
        """Of the recorded channels the first of every kind of part: what a figure shows of many."""
        there, shown = set(recorded), dict[tuple[str, str], SensorChannel]()
        for channel in self.channels:
            if channel.name in there:
                shown.setdefault((channel.quantity, channel.part), channel)
        return tuple(shown.values())


def rotation_about(axis: str) -> str:
    """roll, yaw or pitch for x, y, z."""
    return next(word for word, about in ROTATIONS.items() if about == axis)


def _channel(name: str, row: Mapping[str, Any], triad: str) -> SensorChannel:
    quantity: Quantity = row["quantity"]
    if quantity not in ("acceleration", "rate") or row["axis"] not in AXES:
        wanted = "wanted acceleration or rate along x, y or z"
        raise BadInput(f"sensor file: found {quantity} along {row['axis']} for {name}, {wanted}")
    kind = "sensitivity" if quantity == "acceleration" else "rate_sensitivity"
    return SensorChannel(
        name, triad, str(row["part"]), quantity, str(row["axis"]), units.parse(row["sensitivity"], kind),
        str(row["range"]), units.parse(row["bandwidth"], "frequency"), _optional(row, "tolerance", "ratio"),
        _optional(row, "ratiometric", "voltage"), _optional(row, "temperature_coefficient", "ratio"),
        _optional(row, "beside_spot", "length"), _noise(row.get("noise"), quantity),
        _optional(row, "off_centre", "length"), _optional(row, "asymmetry", "ratio"),
        _optional(row, "nonlinearity", "ratio"),
    )  # fmt: skip


def _optional(row: Mapping[str, Any], key: str, kind: str) -> float | None:
    return None if row.get(key) is None else units.parse(row[key], kind)


def _noise(row: Mapping[str, Any] | None, quantity: Quantity) -> SheetNoise | None:
    if row is None:
        return None
    low, high = (units.parse(one, "frequency") for one in row["corner"])
    density = units.parse(row["density"], f"{quantity}_density")
    return SheetNoise(density, units.parse(row["tolerance"], "ratio"), (low, high))


# units


def _units(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The unit of every channel: as stated, else by the order of the file."""
    numbers = list(_by_order(rows.values()))
    groups: dict[int, list[str]] = {}
    for name, number in zip(rows, numbers, strict=True):
        if not rows[name].get("unit"):
            groups.setdefault(number, []).append(name)
    taken = {str(row["unit"]) for row in rows.values() if row.get("unit")}
    called: dict[int, str] = {}
    places = {"acceleration": 0, "rate": 0}
    for number, names in groups.items():
        quantity = rows[names[0]]["quantity"]
        labels = {name.rpartition("_")[0] for name in names}
        label = labels.pop() if len(labels) == 1 else ""
        if not label or label in taken:
            label = _title(quantity, places[quantity]).replace(" ", "_").lower()
        called[number] = label
        places[quantity] += 1
        taken.add(label)
    return [str(row.get("unit") or called[n]) for row, n in zip(rows.values(), numbers, strict=True)]


def _by_order(rows: Iterable[Mapping[str, Any]]) -> Iterator[int]:
    """Number of the unit of each channel: another one where part or quantity change, or where the axis is taken."""
    number, kind = 0, ("", "")
    axes: set[str] = set()
    for row in rows:
        if (row["part"], row["quantity"]) != kind or row["axis"] in axes:
            number, kind, axes = number + 1, (row["part"], row["quantity"]), set()
        axes.add(row["axis"])
        yield number


def _triads(channels: Iterable[SensorChannel], stated: Mapping[str, Mapping[str, Any]]) -> Iterator[Triad]:
    groups: dict[str, list[SensorChannel]] = {}
    for channel in channels:
        groups.setdefault(channel.triad, []).append(channel)
    count = {"acceleration": 0, "rate": 0}
    for name, group in groups.items():
        quantity = group[0].quantity
        place = count[quantity]
        count[quantity] += 1
        known = stated.get(name) or {}
        colours = COLOURS[quantity]
        yield Triad(
            name, str(known.get("title") or _title(quantity, place)),
            str(known.get("colour") or colours[place % len(colours)]),
            LETTERS[place % len(LETTERS)] if quantity == "acceleration" else "", quantity,
            tuple(sorted(group, key=lambda channel: channel.place)),
        )  # fmt: skip


def _title(quantity: str, place: int) -> str:
    if quantity == "acceleration":
        return f"unit {LETTERS[place % len(LETTERS)]}"
    return GYROS[place] if place < len(GYROS) else f"gyros {place + 1}"
