"""The station: what a step needs while it is carried out. Instruments by role, the room, the run's journal."""

from __future__ import annotations

import re
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from rig.archive.writer import RunWriter
from rig.bench.benchfile import BenchDescription
from rig.bench.roles import Analyzer, Filter, Instrument, Recorder, Scope, Vibrometer
from rig.bench.watched import Heartbeat
from rig.errors import BadInput, InstrumentError
from rig.record import CubeSamples, Samples, Timing
from rig.room import Confirmation, Request, Room

A_PERSON = 3600.0  # s of real time that a person may take for one thing
A_DISK = 30.0  # s of real time that a block may take to get onto the disk

Platter = Literal["untouched", "turning", "standing"]


class Stopwatch:
    """Real time spent on each kind of work, s; work inside work of the same kind is counted once."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._busy: set[str] = set()

    @contextmanager
    def __call__(self, kind: str) -> Iterator[None]:
        if kind in self._busy:
            yield
            return
        self._busy.add(kind)
        begun = time.perf_counter()
        try:
            yield
        finally:
            self._busy.remove(kind)
            self.seconds[kind] += time.perf_counter() - begun


@dataclass
class Drive:
    """What the shaker is being asked for, and what it made of it at each frequency.

    `constants` maps frequency (Hz) to the measured drive constant k, m per programmed volt (paper eq. 3).
    """

    nominal: float
    constants: dict[float, float] = field(default_factory=dict)
    frequency: float = 0.0
    amplitude: float = 0.0
    on: bool = False

    def constant(self, frequency: float) -> float:
        """k measured at the nearest frequency, or the nominal one before anything was measured."""
        if not self.constants:
            return self.nominal
        return self.constants[min(self.constants, key=lambda f: abs(np.log(f / frequency)))]


@dataclass
class Station:
    """Instruments by role, and everything else that carrying out a step needs."""

    description: BenchDescription
    instruments: Mapping[str, Instrument]
    room: Room
    journal: RunWriter
    guard: Heartbeat
    watch: Stopwatch
    progress: Callable[[str], None]
    drive: Drive
    cables: str = "shaker"
    wired: tuple[str, ...] = ()  # channels that the converter was last configured for
    step: str = ""  # number of the step, the first part of its blocks' names
    sensor_range: float = 0.0  # V peak, of the analyzer's input 2
    platter: Platter = "untouched"  # `standing` only where its encoder has shown it

    @property
    def analyzer(self) -> Analyzer:
        return cast(Analyzer, self._role("analyzer"))

    @property
    def vibrometer(self) -> Vibrometer:
        return cast(Vibrometer, self._role("vibrometer"))

    @property
    def recorder(self) -> Recorder:
        return cast(Recorder, self._role("recorder"))

    @property
    def scope(self) -> Scope:
        return cast(Scope, self._role("scope"))

    @property
    def filter(self) -> Filter:
        return cast(Filter, self._role("filter"))

    @property
    def cube(self) -> Any:
        return self._role("cube")

    @property
    def turntable(self) -> Any:
        return self._role("turntable")

    @property
    def encoder(self) -> Any:
        return self._role("encoder")

    def _role(self, role: str) -> Instrument:
        if role not in self.instruments:
            raise BadInput(f"bench {self.description.file.bench}: found no {role}, wanted one for this step")
        return self.instruments[role]

    def keeps(self, recorder: str) -> bool:
        """Whether this instrument keeps data at every point."""
        return recorder in self.description.file.recorders and recorder in self.instruments

    def channels(self) -> tuple[str, ...]:
        """Wiring of the converter with the cable set that is connected now."""
        cables = self.description.file.cables
        return cables["turntable" if self.cables == "turntable" else "shaker"]

    def wire(self) -> Timing:
        """Configure the converter for the cable set that is connected now."""
        self.wired = self.channels()
        return self.recorder.configure(rate=self.description.file.rate, channels=self.wired)

    def ask(self, request: Request) -> Confirmation:
        """Let the operator do one thing, and keep who confirmed what and when."""
        self.guard.expect(A_PERSON)
        confirmation = self.room.operator.ask(request)
        self.journal.note(
            "confirmed",
            action=request.action,
            text=request.text,
            settings=dict(request.settings),
            who=confirmation.who,
            when=confirmation.when,
            said=confirmation.said,
        )
        if request.action == "cables":
            self.cables = str(request.settings["set"])
        return confirmation

    def read(self, scans: int) -> Samples:
        """The recorder's next scans; if the record ends early, what arrived is closed as a block first."""
        try:
            with self.watch("instruments"):
                return self.recorder.read(scans)
        except InstrumentError:
            rest = self.recorder.received()
            if len(rest.counts):
                self.journal.note("partial", samples=self.store(f"{self.step}-partial", rest).name)
            raise

    @contextmanager
    def storing(self) -> Iterator[None]:
        """Time that goes to the disk, which may be slow."""
        self.guard.expect(A_DISK)
        with self.watch("storage"):
            yield
        self.guard.expect()

    def store(self, name: str, samples: Samples) -> Any:
        """Close one stretch of raw counts as a block; returns the block's reference."""
        with self.storing():
            return self.journal.block(name, samples.counts, samples_meta(samples))

    def store_cube(self, name: str, samples: CubeSamples) -> dict[str, Any]:
        """The cube's own frames as two blocks: raw counts, and what came with each frame."""
        with self.storing():
            self.journal.block(f"{name}-cube", samples.counts, cube_meta(samples))
            columns = {"kind": "cube_frames", "columns": list(FRAMES)}
            self.journal.block(f"{name}-cube-frames", frame_columns(samples), columns)
        return {"cube": f"{name}-cube", "cube_gaps": samples.gaps, "cube_bad_frames": samples.bad_frames}

    def block_name(self, label: str) -> str:
        """The name of a step's block: its number and its label in letters, digits, dots and dashes."""
        words = re.sub(r"[^A-Za-z0-9.]+", "-", label.replace("+", "p").replace("-", "m")).strip("-")
        return f"{self.step}-{words}"

    def conditions(self, samples: Samples) -> dict[str, float]:
        """Supply (V) and temperature (°C) while the record was taken, from its own channels."""
        found, wires = {}, self.description.wires
        names = {channel.name for channel in samples.channels}
        if wires.supply in names:
            found["supply"] = float(samples.volts(wires.supply).mean())
        if wires.temperature in names:
            found["temperature"] = float(samples.volts(wires.temperature).mean() / 0.010)
        return found


FRAMES = ("sequence", "device_us", "flags", "supply", "temperature")
"""What came with each frame of the cube beside its counts."""


def frame_columns(samples: CubeSamples) -> NDArray[np.int64]:
    """The same as columns, shape (n, 5)."""
    return np.column_stack([getattr(samples, name) for name in FRAMES]).astype(np.int64)


def cube_meta(samples: CubeSamples) -> dict[str, Any]:
    """What turns a block of the cube's counts back into CubeSamples."""
    meta: dict[str, Any] = {
        "kind": "cube",
        "names": list(samples.names),
        "rate": samples.rate,
        "start": samples.start,
        "gaps": samples.gaps,
        "bad_frames": samples.bad_frames,
    }
    return meta if samples.clock is None else meta | {"clock": asdict(samples.clock)}


def pace_of(samples: Samples) -> dict[str, Any]:
    """For a step's line: how long the record was by the converter's clock and by another one, if that is known."""
    return {} if samples.pace is None else {"pace": list(samples.pace)}


def samples_meta(samples: Samples) -> dict[str, Any]:
    """What turns a block of counts back into Samples."""
    return {
        "kind": "samples",
        "channels": [[c.name, c.slot, c.low, c.high] for c in samples.channels],
        "convert_period": samples.timing.convert_period,
        "scan_channels": samples.timing.channels,
        "start": samples.start,
        "first_scan": samples.first_scan,
        "flags": sorted(samples.flags),
    }
