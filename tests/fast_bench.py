"""The simulated bench in one process and one thread, for studies over hundreds of seeds: no sockets, no files.

`measure` expands a procedure as the program does and has the program's own runner carry it out, with instruments that
look at the world directly instead of through their links. What the analysis reads of a run (header, journal lines,
points, records) is therefore what the program would have written; only blocks have no file and no digest. Records of
the converter are exact (16 channels one after the other, every conversion at its own instant, offset binary,
clipped). The other two recorders of a sweep are simpler than the bench's: the analyzer has no anti-alias filter, and
the oscilloscope keeps 1024 points. Latencies of the instruments are those of the simulated bench, rounded.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from drivers import ofv3001, sensor_cube
from fixtures import sensor_cube as sensor_cube_twin
from fixtures import spectra
from fixtures.das16jr_board import RANGES
from fixtures.world import Refused, World
from rig.archive import journal
from rig.archive.journal import BlockRef, Entry
from rig.archive.records import Signals, cube_of, response_of
from rig.archive.runs import Runs
from rig.bench import procedure_file, runner
from rig.bench.assembly import Bench, Fitting, fittings
from rig.bench.benchfile import BenchDescription, describe
from rig.errors import ConfigError, OperatorRefused, SettingRefused
from rig.record import Channel, CubeSamples, Identity, Response, Samples, Timing, Traces
from rig.room import Confirmation, Request, Room
from rig.yaml import document as documents

BENCH = Path(__file__).parents[1] / "configs" / "benches" / "simulated.yaml"
WORLD = Path(__file__).parents[1] / "configs" / "worlds" / "clean.yaml"

CONVERT_PERIOD = 20e-6  # s; what the board makes of 3125 scans of 16 channels per second
AHEAD, ENDLESS_AHEAD = 8.0, 4.0  # s of a record worked out at once; of one whose end is not known
LUMP = 0.05  # s until a conversion is handed over
SERIAL, GPIB, BOARD = 0.020, 0.020, 0.005  # s of an exchange with the vibrometer, on the bus, with the service
DECODER_SETTLES = 2.2  # s after a change of the vibrometer's range
SCOPE_POINTS = 1024
HIGHEST_RANGE = 28.0  # dBm, of the analyzer's inputs


class WorldClock:
    """The world's time is the bench's."""

    def __init__(self, world: World) -> None:
        self._world = world

    def now(self) -> float:
        return self._world.epoch + self._world.now

    def sleep(self, seconds: float) -> None:
        self._world.advance(seconds)


class Hands:
    """The simulated operator. What the converter has worked out ahead no longer holds when a knob is turned."""

    def __init__(self, world: World, recorder: Converter) -> None:
        self._world, self._recorder = world, recorder

    def check(self, requests: object) -> None:
        """Always there."""

    def ask(self, request: Request) -> Confirmation:
        self._recorder.forget()
        try:
            said = self._world.perform(request.action, dict(request.settings), request.text)
        except Refused as refused:
            raise OperatorRefused(f"operator, asked to {request.action}: {refused}") from refused
        return Confirmation(request, "simulated operator", self._world.epoch + self._world.now, said)


class Converter:
    """The scanning converter: see `rig.bench.roles.Recorder`."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._channels: tuple[Channel, ...] = ()
        self._begun, self._handed = 0.0, 0
        self._scans: int | None = None
        self._ahead = np.empty((0, 0), np.uint16)
        self._timing = Timing(CONVERT_PERIOD, 16)

    def identify(self) -> Identity:
        return Identity("Measurement Computing", "PC104-DAS16JR/16", "SIM-DAS-1", "1.0")

    def settings(self) -> dict[str, str | float | int | bool]:
        self._world.advance(BOARD)
        last = len(self._channels) - 1
        return {"first": 0, "last": last, "gain": 0, "convert_period": CONVERT_PERIOD, "tag_voltage": 2.5}

    def configure(self, *, rate: float, channels: Sequence[str]) -> Timing:
        """Raises ValueError for any other rate than that of 16 channels every 320 µs."""
        self._timing = Timing(CONVERT_PERIOD, len(channels))
        if abs(rate * self._timing.scan_period - 1.0) > 1e-9:
            raise ValueError(f"found {rate} scans of {len(channels)} channels per second, wanted 3125 of 16")
        low, high = RANGES[0]
        self._channels = tuple(Channel(name, slot, low, high) for slot, name in enumerate(channels))
        self._world.advance(BOARD)
        return self._timing

    def start(self, scans: int | None) -> None:
        self.forget()
        self._world.advance(BOARD)
        self._begun, self._handed, self._scans = self._world.now, 0, scans

    def read(self, scans: int) -> Samples:
        """The next scans, after the world's time has come to their end."""
        first, end = self._handed, self._begun + (self._handed + scans) * self._timing.scan_period
        last = self._scans is not None and first + scans >= self._scans
        self._world.advance(max(end + (LUMP if last else 0.0) - self._world.now, 0.0))
        if len(self._ahead) < scans:
            self._work_ahead(scans)
        counts, self._ahead = self._ahead[:scans], self._ahead[scans:]
        self._handed += scans
        return self._samples(counts, first, frozenset({"last"} if last else ()))

    def received(self) -> Samples:
        return self._samples(np.empty((0, len(self._channels)), np.uint16), self._handed, frozenset())

    def stop(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Throw away what has not been handed out; it is converted again when it is asked for."""
        self._ahead = np.empty((0, len(self._channels)), np.uint16)

    def close(self) -> None:
        """Nothing to close."""

    def _samples(self, counts: NDArray[np.uint16], first: int, flags: frozenset[str]) -> Samples:
        taken = self._handed * self._timing.scan_period
        start = self._world.epoch + self._begun
        return Samples(counts, self._channels, self._timing, start, first, flags, (taken, taken))

    def _work_ahead(self, scans: int) -> None:
        """Convert what comes after the scans that wait, at most some seconds of it, and at least what is needed."""
        first = self._handed + len(self._ahead)
        wanted = round((ENDLESS_AHEAD if self._scans is None else AHEAD) * self._timing.scan_rate)
        count = max(wanted, scans - len(self._ahead))
        if self._scans is not None:
            count = min(count, self._scans - first)
        self._ahead = np.concatenate([self._ahead, self._converted(first, count)])

    def _converted(self, first: int, count: int) -> NDArray[np.uint16]:
        """Codes of `count` scans from scan `first` on, shape (count, channels)."""
        width = len(self._channels)
        instants = self._begun + np.arange(first * width, (first + count) * width) * self._timing.convert_period
        of_slot = np.ascontiguousarray(instants.reshape(count, width).T)
        inputs = [self._world.cables[slot] for slot in range(width)]
        low, high = RANGES[0]
        codes = np.empty((count, width), np.uint16)
        for slot, volts in enumerate(self._world.volts(inputs, list(of_slot))):
            steps = np.rint((volts - low) / (high - low) * 65535.0)
            codes[:, slot] = np.clip(steps, 0.0, 65535.0)
        return codes


class Laser:
    """The vibrometer's controller: see `rig.bench.roles.Vibrometer`."""

    def __init__(self, world: World, settings: ofv3001.Settings) -> None:
        self._world, self._settings = world, settings

    def identify(self) -> Identity:
        self._world.advance(3 * SERIAL)
        return Identity("Polytec", "OFV-3001", self._settings.serial, "no identity query; known by its language")

    def settings(self) -> dict[str, str | float | int | bool]:
        self._world.advance(2 * SERIAL)
        scale = self._world.vibrometer.scale
        number = self._number()
        decoder = self._settings.decoder or "own table"
        found = {"decoder": decoder, "range": number, "scale": scale, "full_scale": ofv3001.FULL_SCALE}
        return {**found, "remote": 0, "echo": False}

    def set_range_for(self, velocity_peak: float) -> float:
        """Raises ValueError if no range is wide enough."""
        self._world.advance(SERIAL)
        fitting = (s for s in self._settings.table.values() if velocity_peak <= ofv3001.HEADROOM * 10.0 * s)
        scale = min(fitting, default=0.0)
        if not scale:
            raise ValueError(f"found {velocity_peak:g} m/s, wanted less")
        if scale != self._world.vibrometer.scale:
            self._world.vibrometer.scale = scale
            self._world.advance(DECODER_SETTLES)
            self._world.vibrometer.take_overrange()
        return scale

    def level(self) -> int:
        self._world.advance(SERIAL)
        return int(self._world.vibrometer.level)

    def check(self, *, require: bool = False) -> ofv3001.Check:
        """Raises ValueError if a record made now cannot be trusted and that is required."""
        self._world.advance(3 * SERIAL)
        optics = self._world.vibrometer
        found = ofv3001.Check(int(optics.level), optics.take_overrange(), self._number(), optics.scale)
        if require and (found.overrange or found.level < self._settings.minimum_level):
            raise ValueError(f"found {found}, wanted a signal that can be trusted")
        return found

    def close(self) -> None:
        """Nothing to close."""

    def _number(self) -> int:
        return next(number for number, s in self._settings.table.items() if s == self._world.vibrometer.scale)


class Analyzer:
    """Sine source and two-channel analyzer without anti-alias filters: see `rig.bench.roles.Analyzer`."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._span, self._points, self._averages = 1000.0, 401, 2
        self._ranges = {1: 0.0, 2: 0.0}  # dBm
        self._begun = 0.0

    def identify(self) -> Identity:
        self._world.advance(2 * GPIB)
        return Identity("HEWLETT-PACKARD", "89410A", "3416A01211", "A.09.01")

    def settings(self) -> dict[str, str | float | int | bool]:
        self._world.advance(GPIB)
        source = self._world.source
        return {
            "mode": "VECT", "start": 0.0, "stop": self._span, "points": self._points, "window": "FLAT",
            "averaging": "RMS", "averages": self._averages, "input_1_coupling": "DC", "input_2_coupling": "DC",
            "input_1_range_dbm": self._ranges[1], "input_2_range_dbm": self._ranges[2], "source_shape": "SIN",
            "source_frequency": source.frequency, "source_level": source.level, "source_level_unit": "VPK",
            "output": source.on, "calibration_auto": False,
        }  # fmt: skip

    def preset(self) -> None:
        self._ranges = {1: 0.0, 2: 0.0}
        self._world.set_source(frequency=1e6, level=0.1, on=False)
        self._world.advance(2 * GPIB)

    def configure(self, *, span: float, points: int, averages: int) -> None:
        self._span, self._points, self._averages = span, points, averages
        self._world.advance(GPIB)

    def set_range(self, channel: int, volts: float) -> float:
        """Raises SettingRefused if no range holds it."""
        dbm = max(-30.0, 2.0 * math.ceil(5.0 * math.log10(volts**2 / 0.1) - 1e-9))
        if dbm > HIGHEST_RANGE:
            raise SettingRefused("analyzer", "in memory", wanted=f"at most {HIGHEST_RANGE:g} dBm, found {dbm:g}")
        self._ranges[channel] = dbm
        return self._full(channel)

    def _full(self, channel: int) -> float:
        """Range of an input, V peak."""
        return math.sqrt(0.1 * 10.0 ** (self._ranges[channel] / 10.0))

    def set_sine(self, frequency: float, amplitude: float) -> None:
        self._world.advance(GPIB)
        self._world.set_source(frequency=round(frequency / 25e-6) * 25e-6, level=amplitude)

    def output(self, on: bool) -> None:
        self._world.advance(GPIB)
        self._world.set_source(on=on)

    def start_measurement(self) -> None:
        self._world.advance(GPIB)
        self._begun = self._world.now

    def finish_measurement(self) -> Response:
        """Averaged cross spectrum over the power of input 1, flat-top window."""
        count = round(2.56 * (self._points - 1))
        rate, record = 2.56 * self._span, (self._points - 1) / self._span
        end = self._begun + self._averages * record
        self._world.advance(max(end - self._world.now, 0.0) + GPIB)
        instants = np.asarray(self._begun + np.arange(self._averages * count) / rate, np.float64)
        volts = self._world.volts(self._world.analyzer_inputs, [instants, instants])
        found = spectra.Averages(spectra.window("FLAT", count), count, rate, "RMS")
        found.add(np.array(volts).reshape(2, self._averages, count).transpose(1, 0, 2))
        lines = np.linspace(0.0, self._span, self._points)
        ratio, coherence = found.response()[: self._points], found.coherence()[: self._points].real
        over = [f"input {k}" for k, one in enumerate(volts, 1) if float(np.abs(one).max()) > self._full(k)]
        return Response(lines, ratio, coherence, self._averages, tuple(over))

    def overloads(self) -> tuple[str, ...]:
        return ()

    def errors(self) -> list[str]:
        return []

    def make_safe(self) -> None:
        self.output(False)

    def close(self) -> None:
        """Nothing to close."""


class Scope:
    """Four channels at the same instants, coarser than the bench's: see `rig.bench.roles.Scope`."""

    def __init__(self, world: World, names: tuple[str, ...]) -> None:
        self._world, self._names = world, names
        self._duration, self._ranges = 0.5, [(40.0, 0.0)] * 4

    def identify(self) -> Identity:
        self._world.advance(GPIB)
        return Identity("HEWLETT-PACKARD", "54542A", "0", "02.00")

    def settings(self) -> dict[str, str | float | int | bool]:
        self._world.advance(GPIB)
        found: dict[str, str | float | int | bool] = {"duration": self._duration, "points": SCOPE_POINTS}
        for number, (name, (full, offset)) in enumerate(zip(self._names, self._ranges, strict=True), 1):
            found |= {f"channel_{number}": name, f"range_{number}": full, f"offset_{number}": offset}
        return found

    def configure(self, *, duration: float, ranges: Sequence[tuple[float, float]]) -> None:
        self._duration, self._ranges = duration, list(ranges)
        self._world.advance(GPIB)

    def capture(self) -> Traces:
        self._world.advance(GPIB)
        interval = self._duration / SCOPE_POINTS
        instants = np.asarray(self._world.now + np.arange(SCOPE_POINTS) * interval, np.float64)
        self._world.advance(self._duration)
        volts = np.array(self._world.volts(self._world.scope_inputs, [instants] * len(self._names)))
        for row, (full, offset) in zip(volts, self._ranges, strict=True):
            np.clip(row, offset - 0.5 * full, offset + 0.5 * full, out=row)
        return Traces(self._names, volts, 0.0, interval, (0,) * len(self._names))

    def close(self) -> None:
        """Nothing to close."""


class CubeLine:
    """The serial line of the Sensor Cube's twin, for its own driver: see `drivers.links.SerialLink`."""

    instrument, address = "cube", "in memory"

    def __init__(self, world: World) -> None:
        self.lock = threading.RLock()
        self._twin, self._waiting = sensor_cube_twin.SensorCube(world), bytearray()

    def write(self, data: bytes) -> None:
        self._waiting += self._twin.receive(data)

    def read_available(self, timeout: float) -> bytes:
        """What has arrived; world time stands still meanwhile, so that there is nothing to wait for."""
        found = bytes(self._waiting) + bytes(self._twin.outbox)
        self._waiting.clear()
        self._twin.outbox.clear()
        return found

    def close(self) -> None:
        """Nothing to close."""


class NoGuard:
    """There is no other process that could have to switch anything off."""

    def arm(self, charges: object, within: float, log: Path, armed: object) -> None:
        """Nothing to arm."""

    def beat(self, within: float) -> None:
        """Nobody listens."""

    def expect(self, within: float = 0.0) -> None:
        """Nobody listens."""

    def leave(self) -> None:
        """Nobody listens."""

    def disarm(self) -> None:
        """Nothing to disarm."""


@dataclass
class MemoryRecords:
    """A run in memory with what the analysis reads of a run: see `rig.archive.records.Recorded`.

    `lines` are journal entries as they would be read back from a file; `points` the bodies of points done, by index.
    """

    name: str
    header: Mapping[str, Any]
    lines: list[Entry] = field(default_factory=list)
    points: dict[int, Mapping[str, Any]] = field(default_factory=dict)
    arrays: dict[str, list[NDArray[Any]]] = field(default_factory=dict)
    metas: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    status: str = "completed"

    def block(self, name: str) -> NDArray[Any]:
        """The numbers behind a block's name; pieces of a long record are joined. KeyError if there are none."""
        parts = self.arrays[name]
        if len(parts) > 1:
            self.arrays[name] = parts = [np.concatenate(parts)]
        return parts[0]

    def samples(self, name: str) -> Samples:
        """The record behind a block's name. KeyError if there is none."""
        counts, meta = self.block(name), self.metas[name]
        channels = tuple(Channel(str(n), int(k), float(low), float(high)) for n, k, low, high in meta["channels"])
        timing = Timing(float(meta["convert_period"]), int(meta["scan_channels"]))
        return Samples(
            counts, channels, timing, float(meta["start"]), int(meta["first_scan"]), frozenset(meta["flags"])
        )

    def pieces(self, name: str) -> Iterator[Samples]:
        """The record in order; here in one piece."""
        yield self.samples(name)

    def traces(self, name: str) -> Signals:
        """Simultaneous traces of the oscilloscope. KeyError if there are none."""
        volts, meta = self.block(name), self.metas[name]
        instants = np.asarray(float(meta["start"]) + float(meta["interval"]) * np.arange(volts.shape[1]), np.float64)
        clipped = dict(zip(meta["names"], meta["clipped"], strict=True))
        return Signals(tuple(meta["names"]), instants, np.zeros(len(volts)), volts.T, clipped)

    def response(self, name: str) -> Response:
        """What the analyzer measured. KeyError if there is nothing."""
        return response_of(self.block(name), self.metas[name])

    def cube(self, name: str) -> CubeSamples:
        """The Sensor Cube's own frames. KeyError if there are none."""
        return cube_of(self.block(name), self.block(f"{name}-frames"), self.metas[name])

    def table(self, name: str) -> tuple[NDArray[np.float64], tuple[str, ...]]:
        """Imported rows behind a block's name and their columns. KeyError if there are none, as on this bench."""
        return self.block(name), tuple(self.metas[name]["columns"])

    def earlier(self) -> Iterator[MemoryRecords]:
        """There is no archive."""
        return iter(())

    def close(self) -> None:
        """Drop the arrays; header, lines and points stay."""
        self.arrays.clear()


class MemoryWriter:
    """The writing side of a run: see `rig.archive.writer.RunWriter`."""

    path = Path("memory")  # where a run on the disk would be; nothing is written

    def __init__(self, clock: WorldClock, name: str, header: Mapping[str, Any]) -> None:
        self._clock, self._chain = clock, journal.GENESIS
        self.name = name
        self.records = MemoryRecords(name, {})
        self.records.header = self._append("header", header).body

    def note(self, kind: str, **body: Any) -> int:
        return self._append(kind, body).n

    def point_done(self, index: int, body: Mapping[str, Any]) -> int:
        entry = self._append("point", {**body, "index": index})
        self.records.points[index] = entry.body
        return entry.n

    def block(self, name: str, counts: ArrayLike, meta: Mapping[str, Any]) -> BlockRef:
        return self._keep(name, [np.asarray(counts)], meta)

    def block_stream(self, name: str, meta: Mapping[str, Any]) -> MemoryStream:
        return MemoryStream(self, name, meta)

    def keep_stream(self, name: str, parts: list[NDArray[Any]], meta: Mapping[str, Any]) -> None:
        """The whole of a long record, and the line that ends it."""
        self._keep(name, parts, meta)
        self.note("stream", name=name, rows=sum(map(len, parts)), pieces=1)

    def seal(self, status: str, reason: str = "") -> None:
        """A run in memory ends with the program."""

    def _keep(self, name: str, parts: list[NDArray[Any]], meta: Mapping[str, Any]) -> BlockRef:
        shape, dtype = (sum(map(len, parts)), *parts[0].shape[1:]), parts[0].dtype.newbyteorder("<").str
        reference = BlockRef(name, f"blocks/{name}.{dtype[1:]}", dtype, shape, "", meta, 0)
        self.records.arrays[name] = parts
        self.records.metas[name] = self._append("block", vars(reference)).body["meta"]
        return reference

    def _append(self, kind: str, body: Mapping[str, Any]) -> Entry:
        """As a file would give it back: lists for tuples, mappings for values."""
        now, previous = self._clock.now(), self._chain
        number = len(self.records.lines)
        raw, self._chain = journal.line(number, now, now, kind, body, previous)
        entry = journal.read_line(raw, previous, number)
        self.records.lines.append(entry)
        return entry


class MemoryStream:
    """A long record that comes in stretches."""

    def __init__(self, writer: MemoryWriter, name: str, meta: Mapping[str, Any]) -> None:
        self._writer, self._name, self._meta = writer, name, meta
        self._parts: list[NDArray[Any]] = []

    def append(self, rows: NDArray[Any]) -> None:
        self._parts.append(rows)

    def close(self) -> None:
        self._writer.keep_stream(self._name, self._parts, self._meta)


@lru_cache(maxsize=8)
def _described(bench: Path) -> tuple[BenchDescription, dict[str, Fitting]]:
    description = describe(bench)
    return description, fittings(description)


@lru_cache(maxsize=64)
def _ordered(text: str, bench: Path) -> runner.Order:
    """What the program would make of this procedure on this bench."""
    description, _ = _described(bench)
    document = documents.read_text(text, "(in memory)")
    plan = procedure_file.plan(document, description.facts())
    return runner.Order(plan, document.data, description, Path("memory"), plan.procedure)


def world(seed: int, hidden: Sequence[Mapping[str, Any]] = ()) -> World:
    """A world like the clean one of the configurations, with what is hidden in it."""
    return World({**_clean(), "hidden": [dict(one) for one in hidden]}, seed)


@lru_cache(maxsize=1)
def _clean() -> Mapping[str, Any]:
    return dict(yaml.safe_load(WORLD.read_text(encoding="utf-8")))


def measure(document: Mapping[str, Any] | str, world: World, *, bench: Path = BENCH) -> MemoryRecords:
    """Carry a procedure (or sequence) out in this world, which goes on where it is; YAML text or what it says.

    Raises ConfigError for mistakes in the procedure, and what the steps raise, VerdictNotMet among them.
    """
    if not isinstance(document, str):
        document = _text(document)
    order = _ordered(document, bench)
    made = _bench(order, world)
    name, procedure = f"seed-{world.seed}-{order.plan.procedure}", order.plan.procedure
    header = {**runner._header(order, made, []), "run": name, "procedure": procedure, "sequence": 1}
    writer = MemoryWriter(WorldClock(world), name, header)
    carrying = runner._Carrying(order, made, NoGuard(), writer)  # type: ignore[arg-type]
    carrying.carry_out(done=frozenset())
    return writer.records


def keep(document: Mapping[str, Any], world: World, runs: Path, *, bench: Path = BENCH) -> str:
    """The same into an archive; the name of the run, which is the procedure's but for the date."""
    order = _ordered(_text(document), bench)
    made = _bench(order, world)
    archive = Runs(runs, now=WorldClock(world).now)
    with archive.create(order.plan.procedure, runner._header(order, made, [])) as writer:
        done = runner._Carrying(order, made, NoGuard(), writer).carry_out(done=frozenset())  # type: ignore[arg-type]
    return done.name


def accepts(document: Mapping[str, Any], *, bench: Path = BENCH) -> bool:
    """Whether the bench would carry this procedure out: its plan keeps all limits."""
    try:
        _ordered(_text(document), bench)
    except ConfigError:
        return False
    return True


def _text(document: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(document), allow_unicode=True, sort_keys=False)


def _bench(order: runner.Order, world: World) -> Bench:
    """The instruments that the plan needs; those without a link are the program's own."""
    fitted, needed = _described(order.description.path)[1], runner._needed(order)
    recorder = Converter(world)
    room = Room(WorldClock(world), Hands(world, recorder))
    made = Bench(order.description, room, None)
    for role, fitting in fitted.items():
        if needed(role):
            made.instruments[role] = _instrument(role, fitting, world, room, recorder)
    return made


def _instrument(role: str, fitting: Fitting, world: World, room: Room, recorder: Converter) -> Any:
    match role:
        case "recorder":
            return recorder
        case "vibrometer":
            return Laser(world, fitting.settings)
        case "analyzer":
            return Analyzer(world)
        case "scope":
            return Scope(world, fitting.settings.names)
        case "cube":
            return sensor_cube.SensorCube(CubeLine(world), fitting.settings, room)  # type: ignore[arg-type]
        case "filter" | "encoder" | "turntable":
            return fitting.module.connect(role, fitting.settings, room)
    raise ValueError(f"found a bench with a {role}, wanted one without")
