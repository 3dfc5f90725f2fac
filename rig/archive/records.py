"""What the analysis reads of a run: its journal once, its records as samples, its references as numbers.

`Recorded` is all that the analysis asks for; `Records` reads it from the archive. Long records come piece by piece, so
that an hour needs no more memory than a minute.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rig import units
from rig.archive.journal import BlockRef, Entry
from rig.archive.reader import Run, blocks_of, points_of
from rig.archive.runs import Runs
from rig.errors import ArchiveError, BadInput, StandardOverdue
from rig.record import Channel, ClockFit, CubeSamples, Response, Samples, Timing, Wires

OF_THE_RUN = ("header", "settings", "resumed")  # lines of the journal that hold for every step
OF_A_STEP = ("step", "point", "repeated", "prepared")  # lines that name a step by its index
IMPORT = "import"  # the procedure of runs that somebody else measured
PIECE = 1 << 17  # scans handed out at once: 4 MB of sixteen channels


class Recorded(Protocol):
    """A run as the analysis sees it: what was known before (`header`), what happened (`lines`), points by index."""

    @property
    def name(self) -> str: ...
    @property
    def status(self) -> str: ...
    @property
    def header(self) -> Mapping[str, Any]: ...
    @property
    def lines(self) -> Sequence[Entry]: ...
    @property
    def points(self) -> Mapping[int, Mapping[str, Any]]: ...
    def samples(self, name: str) -> Samples:
        """The whole record behind a block name; ArchiveError if there is none."""
        ...

    def pieces(self, name: str) -> Iterator[Samples]:
        """The same in consecutive stretches of bounded size."""
        ...

    def traces(self, name: str) -> Signals:
        """Simultaneous traces of the oscilloscope."""
        ...

    def response(self, name: str) -> Response:
        """What the analyzer measured."""
        ...

    def cube(self, name: str) -> CubeSamples:
        """The Sensor Cube's own frames behind a block name."""
        ...

    def table(self, name: str) -> tuple[NDArray[np.float64], tuple[str, ...]]:
        """Imported rows behind a block name, (n, columns), and the columns' names in their file."""
        ...

    def earlier(self) -> Iterator[Recorded]:
        """The bench's own runs of the same archive that began before it, latest first."""
        ...


def is_imported(records: Recorded) -> bool:
    """Whether somebody else measured a run."""
    return bool(records.header.get("procedure") == IMPORT)


def column_of(name: str, names: Sequence[str]) -> int:
    """Where a channel stands among those of a record. Raises ArchiveError if it is not one of them."""
    if name not in names:
        raise ArchiveError(f"found a record of {', '.join(names) or 'no channel'}, wanted one with '{name}'")
    return list(names).index(name)


class KeptSamples(Samples):
    """A stretch of a record of the archive: a channel that it lacks is the record's fault and not the reader's."""

    def index(self, name: str) -> int:
        """Column of the named channel; ArchiveError if it is not in the record."""
        return column_of(name, [channel.name for channel in self.channels])


class KeptCubeSamples(CubeSamples):
    """Frames of the archive, as `KeptSamples` are."""

    def index(self, name: str) -> int:
        """Column of the named channel; ArchiveError if it is not in the record."""
        return column_of(name, self.names)


@dataclass(frozen=True)
class Signals:
    """Channels of one record: volts, shape (n, channels), at `instants` (n,) + `skew` (channels,), both s.

    `clipped` counts samples at the ends of the range by channel; `step` is the converter's, V. `start` is the bench
    clock's time at which the instants begin to count, s.
    """

    names: tuple[str, ...]
    instants: NDArray[np.float64]
    skew: NDArray[np.float64]
    volts: NDArray[np.float64]
    clipped: Mapping[str, int]
    step: float = 0.0
    start: float = 0.0

    @property
    def rate(self) -> float:
        """Samples per second of one channel, Hz."""
        return (len(self.instants) - 1) / float(self.instants[-1] - self.instants[0])

    def column(self, name: str) -> int:
        """Where a channel stands among the others; ArchiveError if it is not in the record."""
        return column_of(name, self.names)

    def of(self, name: str) -> NDArray[np.float64]:
        """Volts of one channel, shape (n,)."""
        return self.volts[:, self.column(name)]


class Records:
    """A run of the archive, its journal read once."""

    def __init__(self, run: Run) -> None:
        self.run, self.name, self.status, self.header = run, run.name, str(run.status), run.header
        self.lines = list(run.lines())
        self.points, self._blocks = points_of(self.lines), blocks_of(self.lines)

    def samples(self, name: str) -> Samples:
        """The record behind a block name; pieces of a long record are joined. ArchiveError if there is none."""
        parts = self._files(name)
        pieces = [self.run.read(part) for part in parts]
        counts = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
        return _samples(counts, parts[0].meta, int(parts[0].meta["first_scan"]))

    def pieces(self, name: str) -> Iterator[Samples]:
        """The same in consecutive stretches, mapped from the files."""
        parts = self._files(name)
        scan = int(parts[0].meta["first_scan"])
        for part in parts:
            counts = self.run.read(part)
            for begin in range(0, len(counts), PIECE):
                stretch = np.asarray(counts[begin : begin + PIECE])
                yield _samples(stretch, part.meta, scan)
                scan += len(stretch)

    def earlier(self) -> Iterator[Recorded]:
        """The bench's own runs of the same folder that began before it, latest first; damaged ones are left out."""
        others = [(_started(run), run) for run in Runs(self.run.path.parent).list() if run.path != self.run.path]
        for when, run in sorted(others, key=lambda one: -one[0]):
            if when < _started(self.run):
                with contextlib.suppress(ArchiveError):
                    yield Records(run)

    def traces(self, name: str) -> Signals:
        """Simultaneous traces of the oscilloscope."""
        meta = self._files(name)[0].meta
        volts = self._block(name)
        instants = np.asarray(float(meta["start"]) + float(meta["interval"]) * np.arange(volts.shape[1]), np.float64)
        clipped = dict(zip(meta["names"], meta.get("clipped", ()), strict=False))
        return Signals(tuple(meta["names"]), instants, np.zeros(len(volts)), volts.T, clipped)

    def response(self, name: str) -> Response:
        """What the analyzer measured, behind a block name."""
        return response_of(self._block(name), self._files(name)[0].meta)

    def table(self, name: str) -> tuple[NDArray[np.float64], tuple[str, ...]]:
        """Imported rows behind a block name, (n, columns), and the columns' names in their file."""
        return self._block(name), tuple(self._files(name)[0].meta["columns"])

    def _block(self, name: str) -> NDArray[Any]:
        return self.run.joined(name, self._files(name))

    def _files(self, name: str) -> Sequence[BlockRef]:
        if name not in self._blocks:
            raise ArchiveError(f"{self.name}: found no block '{name}', wanted it, as a line of the journal names it")
        return self._blocks[name]

    def cube(self, name: str) -> CubeSamples:
        """The Sensor Cube's own frames behind a block name."""
        return cube_of(self._block(name), self._block(f"{name}-frames"), self._files(name)[0].meta)


def _started(run: Run) -> float:
    """When a run of the bench began, s on its clock; never, if it is damaged or somebody else's."""
    try:
        return math.inf if run.header.get("procedure") == IMPORT else float(run.header["started"])
    except ArchiveError:
        return math.inf


def response_of(columns: NDArray[np.float64], meta: Mapping[str, Any]) -> Response:
    """A response from its block: columns frequency, real, imaginary, coherence (NaN where there was none)."""
    frequency, real, imaginary, coherence = np.asarray(columns, np.float64).T
    known = None if np.isnan(coherence).all() else coherence
    return Response(frequency, real + 1j * imaginary, known, int(meta["averages"]), tuple(meta["overloads"]))


def cube_of(counts: NDArray[np.uint16], frames: NDArray[np.int64], meta: Mapping[str, Any]) -> CubeSamples:
    """The cube's frames from their two blocks; gaps and clock of a stream are those of its first stretch."""
    return KeptCubeSamples(
        names=tuple(meta["names"]),
        counts=counts,
        sequence=frames[:, 0],
        device_us=frames[:, 1],
        flags=frames[:, 2].astype(np.uint16),
        supply=frames[:, 3].astype(np.uint16),
        temperature=frames[:, 4].astype(np.uint16),
        gaps=int(meta["gaps"]),
        bad_frames=int(meta["bad_frames"]),
        rate=float(meta["rate"]),
        start=float(meta["start"]),
        clock=None if meta.get("clock") is None else ClockFit(**meta["clock"]),
    )


def _samples(counts: NDArray[np.uint16], meta: Mapping[str, Any], first: int) -> Samples:
    try:
        channels = tuple(Channel(str(n), int(k), float(low), float(high)) for n, k, low, high in meta["channels"])
        timing = Timing(float(meta["convert_period"]), int(meta["scan_channels"]))
        start, flags = float(meta["start"]), frozenset(meta["flags"])
    except (TypeError, ValueError, OverflowError) as error:
        raise ArchiveError(f"found channels of another make ({error}), wanted name, slot, low and high each") from None
    if not _is_record(counts, channels, timing):
        raise ArchiveError(
            f"found {len(channels)} channels for a record of the shape {counts.shape}, in a scan of {timing.channels} "
            f"every {timing.convert_period:g} s, wanted one for each column, and slots within the scan"
        )
    return KeptSamples(counts=counts, channels=channels, timing=timing, start=start, first_scan=first, flags=flags)


def _is_record(counts: NDArray[np.uint16], channels: Sequence[Channel], timing: Timing) -> bool:
    """Whether the columns are these channels, each with a slot of the scan and a range."""
    return (
        counts.ndim == 2
        and counts.shape[1] == len(channels)
        and 0.0 < timing.convert_period < math.inf
        and all(0 <= one.slot < timing.channels and -math.inf < one.low < one.high < math.inf for one in channels)
    )


def wires_of(records: Recorded) -> Wires:
    """What the run's cables called the bench's own signals."""
    stated: Mapping[str, str] = records.header["bench_file"].get("signals") or {}
    try:
        return Wires(**stated)
    except TypeError as error:
        raise ArchiveError(f"{records.name}: found signals of another make ({error}), wanted their wires") from None


def signals_of(records: Recorded, body: Mapping[str, Any]) -> Signals | None:
    """All channels of one point: the converter's, else the oscilloscope's; None if neither kept a record."""
    if "samples" in body:
        return signals(records.samples(body["samples"]))
    return records.traces(body["traces"]) if "traces" in body else None


def signals(samples: Samples) -> Signals:
    """A record of the converter with each channel's delay in the scan."""
    names = tuple(channel.name for channel in samples.channels)
    slots = np.array([channel.slot for channel in samples.channels])
    low = np.array([channel.low for channel in samples.channels])
    high = np.array([channel.high for channel in samples.channels])
    volts = samples.counts / 65535.0 * (high - low) + low
    ends = np.count_nonzero((samples.counts == 0) | (samples.counts == 65535), axis=0)
    clipped = {name: int(n) for name, n in zip(names, ends, strict=True) if n}
    instants = samples.timing.instants(0, len(samples.counts), samples.first_scan)
    step = float(np.max(high - low)) / 65535.0
    skew = slots * samples.timing.convert_period
    return Signals(names, instants, skew, volts, clipped, step, samples.start)


@dataclass(frozen=True)
class Experiment:
    """One procedure of a run, as if it had been a run of its own: the run's records, its own lines and points."""

    run: Recorded
    lines: Sequence[Entry]
    points: Mapping[int, Mapping[str, Any]]

    @property
    def name(self) -> str:
        return self.run.name

    @property
    def status(self) -> str:
        return self.run.status

    @property
    def header(self) -> Mapping[str, Any]:
        return self.run.header

    def samples(self, name: str) -> Samples:
        return self.run.samples(name)

    def pieces(self, name: str) -> Iterator[Samples]:
        return self.run.pieces(name)

    def traces(self, name: str) -> Signals:
        return self.run.traces(name)

    def response(self, name: str) -> Response:
        return self.run.response(name)

    def cube(self, name: str) -> CubeSamples:
        return self.run.cube(name)

    def table(self, name: str) -> tuple[NDArray[np.float64], tuple[str, ...]]:
        return self.run.table(name)

    def earlier(self) -> Iterator[Recorded]:
        return self.run.earlier()


def experiments(records: Recorded) -> list[Recorded]:
    """The procedures that a run carried out, in order, those that were never begun left out.

    A sequence remounts the cube and changes the cables between its procedures, so nothing that one of them recorded
    may be read with what another one set. A run of one procedure, or of none (an imported one), is its own experiment.
    """
    spans = _spans(records.header)
    if len(spans) < 2:
        return [records]
    lines: dict[range, list[Entry]] = {span: [] for span in spans}
    waiting: list[Entry] = []  # confirmations, blocks and notes stand before the line of the step that they belong to
    for entry in records.lines:
        if entry.kind in OF_THE_RUN:
            for every in lines.values():
                every.append(entry)
            continue
        waiting.append(entry)
        if entry.kind in OF_A_STEP:
            for span in spans:
                if int(entry.body["index"]) in span:
                    lines[span] += waiting
            waiting = []
    return [
        Experiment(records, sorted(own, key=lambda entry: entry.n), {n: b for n, b in records.points.items() if n in s})
        for s, own in lines.items()
        if any(entry.kind in OF_A_STEP for entry in own)
    ]


def _spans(header: Mapping[str, Any]) -> list[range]:
    """Indices of the steps of every procedure of a run."""
    if "experiments" in header:
        return [range(int(one["first"]), int(one["end"])) for one in header["experiments"]]
    # Runs of before say less, but every procedure began by asking for its cable set.
    steps = header.get("steps", ())
    begins = [n for n, step in enumerate(steps) if (step["kind"], step["label"]) == ("Ask", "cables")]
    return [range(first, end) for first, end in itertools.pairwise([*begins, len(steps)])]


def statics(records: Recorded) -> Iterator[Mapping[str, Any]]:
    """Journal bodies of every record at rest that the converter kept."""
    for entry in records.lines:
        if entry.kind in ("point", "step") and "purpose" in entry.body and "samples" in entry.body:
            yield entry.body


def poses_of(records: Recorded) -> list[tuple[tuple[float, float, float], Mapping[str, Any]]]:
    """What was up in the cube's frame (unit vector), and the record, for every pose of a tumble."""
    up, found = None, []
    for entry in records.lines:
        if entry.kind == "confirmed" and entry.body["action"] == "pose":
            s = entry.body["settings"]
            up = (float(s["up_x"]), float(s["up_y"]), float(s["up_z"]))
        elif entry.kind == "point" and entry.body.get("purpose") == "pose" and up is not None:
            found.append((up, entry.body))
    return found


def mounts(records: Recorded) -> Iterator[tuple[Entry, Mapping[str, Any] | None]]:
    """Every line with the settings of the mounting that was in force (None before the first)."""
    mount: Mapping[str, Any] | None = None
    for entry in records.lines:
        if entry.kind == "confirmed" and str(entry.body["action"]).startswith("mount_on_"):
            mount = {"place": entry.body["action"].removeprefix("mount_on_"), **entry.body["settings"]}
        yield entry, mount


@dataclass(frozen=True)
class Reference:
    """A value of a standard: SI value, standard uncertainty, and the certificate that says so."""

    standard: str
    quantity: str
    value: float
    u: float
    certificate: str

    @property
    def source(self) -> str:
        """For a budget's line."""
        return f"certificate {self.certificate}"


def reference(records: Recorded, standard: str, quantity: str) -> Reference:
    """One value of a standard of the run's bench.

    Raises BadInput if the bench had no such standard, StandardOverdue if it was past its due date when the run began
    and nobody ordered otherwise, ArchiveError if the header says of it what no standard can be.
    """
    try:
        for found in records.header["standards"]:
            if found["standard"] == standard and quantity in found["values"]:
                _refuse_overdue(records, found)
                stated = found["values"][quantity]
                value, u = (units.parse(stated[key], stated["kind"]) for key in ("value", "expanded_uncertainty"))
                return Reference(standard, quantity, value, u / stated["coverage_factor"], found["certificate"])
    except (ArithmeticError, KeyError, TypeError, ValueError) as error:
        raise ArchiveError(f"{records.name}: found '{standard}' of another make ({error}), wanted a standard") from None
    raise BadInput(f"{records.name}: found no {quantity} of a standard '{standard}', wanted one in the bench file")


def _refuse_overdue(records: Recorded, standard: Mapping[str, Any]) -> None:
    import datetime as dt

    overridden = records.header["overdue_overridden"]
    day = dt.datetime.fromtimestamp(records.header["started"], dt.UTC).date()
    if day > dt.date.fromisoformat(str(standard["due"])) and standard["standard"] not in overridden:
        raise StandardOverdue(
            f"{records.name}: found standard {standard['standard']} ({standard['certificate']}) due on "
            f"{standard['due']} in a run of {day}, wanted one within its due date"
        )
