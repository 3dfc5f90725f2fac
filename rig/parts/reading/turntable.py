"""From a turntable run to `PlatterRecords`: window means, the encoder's motion over the same windows, noise at rest."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, experiments, is_imported, mounts, reference, wires_of
from rig.archive.reduced import reduced
from rig.errors import BadInput
from rig.model import Channels
from rig.parts.channels import channels_of
from rig.parts.conditions import smoothed
from rig.parts.platter import HIGHEST_RATE, Platter
from rig.parts.platter_records import PlatterRecords, stretches_of
from rig.parts.ranges import beyond_range
from rig.parts.reading import nuisances
from rig.parts.reading.reading import Reading
from rig.parts.reading.revolutions import SLOWEST, mount_of
from rig.parts.reading.sessions import begun
from rig.parts.reference_motion import Shown
from rig.sensor import Sensor
from rig.signals import noise
from rig.signals.encoder import LINES
from rig.signals.graduation import graduation, line_errors
from rig.signals.rotation import Edges, Track, edges_of, encoder_settings
from rig.signals.spectrum import Density, log_bins

Array = NDArray[np.float64]
WINDOW = 100  # scans in one mean: 32 ms, short against wow, long against a line
PIECE = 12.0  # s of a stretch
PER_DECADE = 12.0
OUTSTANDING = 9.0  # times the density of the timing noise: three standard deviations
SMOOTH = 2.5  # Hz; a platter that starts or stops has no faster acceleration than this
WOW = 1.8  # Hz; a platter at a steady speed has lines only above this, twice per turn of the faster speed
SLOW = 0.3  # Hz; slower motion is kept whole
NEIGHBOURS = 40  # lines of a transform on either side
KNOT = 48  # lines between knots of the track: wow passes, the patterns that sampled edges leave do not
END = 16  # windows at either end of a record whose parabola tells how the rate changes there: half a second
AT_ONCE = 1 << 14  # intervals between lines looked at together: 4 MB with their neighbours
LOCAL = 15  # lines on either side whose median interval says how long one should take


@dataclass(frozen=True)
class _Record:
    """One record as windows."""

    label: str
    kind: str
    names: tuple[str, ...]
    start: float  # bench clock at the first window of the record, s
    first: int  # window
    means: Array  # (channels, n)
    counted: Shown
    closed: Shown
    lost: int
    lines: int
    mount: Mapping[str, Any]
    ends: tuple[float, float]  # angle before the first and after the last line, NaN if unknown
    clipped: Mapping[str, int]
    notes: tuple[str, ...] = ()
    pattern: tuple[float, NDArray[np.complex128]] | None = None


def read(runs: Sequence[Recorded]) -> Reading:
    """Every turntable run of the rig's own."""
    own = [run for run in runs if not is_imported(run)]
    since = begun(runs)
    parts = [(run, Platter(replace(data, since=since.get(run.name)))) for run in own for data in spun(run)]
    for run, part in parts:
        part.notes = (*part.notes, *beyond_range(run, part))
    done = [one for run in own for one in experiments(run)]
    turned = [one for one in done if any("phase" in body for body in one.points.values())]
    return Reading(tuple(part for _, part in parts), tuple(nuisances.of_turntable(turned)) if parts else ())


def spun(records: Recorded) -> list[PlatterRecords]:
    """Every turntable experiment of a run, its records together; [] for a run that has none.

    Raises BadInput if the encoder cannot be read.
    """
    kinds = (PlatterRecords, Channels, Shown, noise.NoiseModel)

    def wired() -> Channels:
        return channels_of(records, list(records.header["bench_file"]["cables"]["turntable"]))

    return reduced(records, "turntable", kinds, lambda: spun_from(records, _by_converter, wired))


@dataclass(frozen=True)
class Windows:
    """Means of channels over the windows of one record, (names, n), V, which begin at `start` on the bench's clock, s,
    `later` than the converter's record, s; `interval` of its scans, s; samples `clipped` by name.
    """

    names: tuple[str, ...]
    means: Array
    start: float
    interval: float
    later: float
    clipped: Mapping[str, int]


Read = Callable[[Recorded, Mapping[str, Any]], Iterable[Windows]]
"""Windows of a record of the journal as a recorder of the sensor has them, a stretch without gaps after the other."""


def spun_from(records: Recorded, read: Read, channels: Callable[[], Channels]) -> list[PlatterRecords]:
    """The same with the sensor's channels as `read` gives them."""
    made: list[PlatterRecords] = []
    for one in experiments(records):
        found = list(_records(one, read))
        if any(record.kind != "rest" for record in found):
            name = f"{records.name}#turntable{len(made) + 1 if made else ''}"
            made.append(_joined(one, name, channels(), _at_rest(found)))
    return made


def _records(records: Recorded, read: Read) -> Iterator[_Record]:
    settings = encoder_settings(records.lines)
    moved = False
    for entry, mount in mounts(records):
        body = entry.body
        moved |= entry.kind == "prepared"  # brought to rest when the run went on: not where the record before was made
        if entry.kind != "point" or mount is None or mount["place"] != "turntable" or "samples" not in body:
            continue
        for found in read(records, body):
            if str(body.get("purpose", "")).startswith("rest_"):
                still = np.zeros(found.means.shape[1])
                shown = Shown(np.full(len(still), math.nan), still, still)
                yield _Record(str(body["label"]), "rest", found.names, found.start, 0, found.means, shown, shown, 0, 0,
                              mount, (math.nan, math.nan), found.clipped)  # fmt: skip
            elif "phase" in body:
                edges = edges_of(records.pieces(body["samples"]), settings)
                one = _moving(body, found, edges, mount)
                yield replace(one, ends=(math.nan, one.ends[1])) if moved else one
                moved = False


def _by_converter(records: Recorded, body: Mapping[str, Any]) -> Iterator[Windows]:
    """Sensors among the cables, supply and temperature."""
    cables = list(records.header["bench_file"]["cables"]["turntable"])
    sensor, wires = Sensor.of(records.header), wires_of(records)
    names = [name for name in cables if name in sensor or name in (wires.supply, wires.temperature)]
    sums: list[Array] = []
    start = interval = skew = 0.0
    clipped: dict[str, int] = {}
    rest: NDArray[np.uint16] | None = None
    columns: list[int] = []
    scale = np.zeros((2, len(names)))
    for piece in records.pieces(str(body["samples"])):
        if not columns:
            columns = [piece.index(n) for n in names]
            low = np.array([piece.channels[c].low for c in columns])
            high = np.array([piece.channels[c].high for c in columns])
            scale = np.array([low, (high - low) / 65535.0])
            start, interval = piece.start, piece.timing.scan_period
            skew = float(np.mean([piece.channels[c].slot for c in columns])) * piece.timing.convert_period
        counts = piece.counts[:, columns]
        _count_clipped(counts, names, clipped)
        counts = counts if rest is None else np.concatenate([rest, counts])
        whole = len(counts) // WINDOW
        sums.append(counts[: whole * WINDOW].reshape(whole, WINDOW, -1).mean(axis=1))
        rest = counts[whole * WINDOW :].copy()
    means = scale[0][:, None] + scale[1][:, None] * np.concatenate(sums).T
    yield Windows(tuple(names), means, start, interval, skew, clipped)


def _count_clipped(counts: NDArray[np.uint16], names: Sequence[str], clipped: dict[str, int]) -> None:
    ends = np.count_nonzero((counts == 0) | (counts == 65535), axis=0)
    for name, n in zip(names, ends.tolist(), strict=True):
        if n:
            clipped[name] = clipped.get(name, 0) + n


def _moving(body: Mapping[str, Any], found: Windows, edges: Edges, mount: Mapping[str, Any]) -> _Record:
    times, missing = _restored(edges)
    whole = replace(edges, times=times, index_line=_shifted(edges.index_line, missing))
    bounds = (np.arange(found.means.shape[1] + 1) * WINDOW - 0.5) * found.interval + found.later
    tracks = (edges, whole) if missing.any() else (whole,)
    shown = [_shown(one, bounds, body["phase"] == "hold") for one in tracks]
    inside = shown[-1][1]
    kept = [Shown(s.angle[inside], s.rate[inside], s.acceleration[inside]) for s, _ in shown]
    anchor = _anchor(whole)
    last = anchor + whole.sense * 2.0 * math.pi * (len(times) - 1) / LINES
    notes = tuple(f"{body['label']}: {count} lines between index pulses" for count in edges.flagged)
    return _Record(
        str(body["label"]), str(body["phase"]), found.names, found.start, int(inside.start), found.means[:, inside],
        kept[0], kept[-1], int(missing.sum()), len(times), mount, (anchor, last), found.clipped, notes,
        line_errors(edges) if body["phase"] == "hold" else None,
    )  # fmt: skip


def _restored(edges: Edges) -> tuple[Array, NDArray[np.intp]]:
    """Times of all lines, and how many were put back after each: where a gap is twice the local interval."""
    gaps = np.diff(edges.times)
    local = _local_median(gaps)
    missing = np.maximum(np.round(gaps / local - 0.15).astype(np.intp) - 1, 0)
    # a platter that starts or stops changes its pace within a few lines
    slow = gaps > 4.0 * float(np.median(gaps))
    missing[slow] = 0
    if not missing.any():
        return edges.times, missing
    more = [edges.times[k] + gaps[k] * (j + 1.0) / (missing[k] + 1.0)
            for k in np.flatnonzero(missing) for j in range(int(missing[k]))]  # fmt: skip
    return np.sort(np.concatenate([edges.times, np.array(more)])), missing


def _local_median(gaps: Array) -> Array:
    """The median of every interval and its neighbours, a stretch at a time, (n,)."""
    padded = np.pad(gaps, LOCAL, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * LOCAL + 1)
    return np.concatenate([np.median(windows[k : k + AT_ONCE], axis=1) for k in range(0, len(windows), AT_ONCE)])


def _shifted(index_line: NDArray[np.int64], missing: NDArray[np.intp]) -> NDArray[np.int64]:
    before = np.concatenate([[0], np.cumsum(missing)])
    return np.asarray(index_line + before[np.clip(index_line, 0, len(before) - 1)], np.int64)


def _anchor(edges: Edges) -> float:
    """Angle of the first line, rad: the line after an index pulse is at zero; NaN without a pulse."""
    if not len(edges.index_line):
        return math.nan
    first = -(int(edges.index_line[0]) + 1) * 2.0 * math.pi / LINES
    return edges.sense * first


def _shown(edges: Edges, bounds: Array, steady: bool) -> tuple[Shown, slice]:
    """Angle, rate and acceleration over windows, and the windows during which the platter surely turned."""
    track = Track(edges, KNOT)
    inside = (bounds[:-1] > track.begin) & (bounds[1:] < track.end)
    first, stop = _longest(inside)
    here = bounds[first : stop + 1]
    angle = track.angle(here)
    speed = np.abs(np.diff(angle)) / np.diff(here)
    a, b = _longest(speed > SLOWEST)
    first, stop = first + a, first + b
    here, angle = here[a : b + 1], angle[a : b + 1]
    width = float(here[1] - here[0])
    found = [np.full(len(bounds) - 1, math.nan) for _ in range(3)]
    found[0][first:stop] = _anchor(edges) + 0.5 * (angle[1:] + angle[:-1])
    found[1][first:stop], found[2][first:stop] = _cleared(
        np.diff(angle) / width, np.diff(track.rate(here)) / width, width, edges.u_time, WOW if steady else SMOOTH
    )
    return Shown(*found), slice(first, stop)


def _cleared(rate: Array, acceleration: Array, width: float, u_time: float, smooth: float) -> tuple[Array, Array]:
    """Rate and acceleration without what is only the timing noise of the lines.

    Noise in what a model takes as given makes every fitted sensitivity too small (errors in variables). The lines of a
    cosine transform that do not stand out from that noise are therefore left out: what is left is close to the
    expectation of the true motion, which has no such bias. The rate's own bend is put aside meanwhile.
    """
    from scipy.fft import dct, idct

    f, bend = np.arange(len(rate)) / (2.0 * len(rate) * width), _bend(rate)
    speed = float(np.median(np.abs(rate)))
    whole, lines, slopes = (dct(one, type=2, norm="ortho") for one in (rate, rate - bend, acceleration))
    known = _outstanding(lines, f, width, speed, u_time, smooth) & (f < HIGHEST_RATE)
    steep = _outstanding(whole, f, width, speed, u_time, smooth) & (f < SMOOTH)
    rate, acceleration = (
        idct(np.where(kept, one, 0.0), type=2, norm="ortho") for kept, one in ((known, lines), (steep, slopes))
    )
    return rate + bend, acceleration


def _outstanding(lines: Array, f: Array, width: float, speed: float, u_time: float, smooth: float) -> NDArray[np.bool_]:
    """Lines of a rate, at `f` Hz, that stand out from timing noise.

    One edge is uncertain by ω·u_time, so the rate's density is (2πf)²·2·(ω·u_time)² ÷ lines per second; above `smooth`
    (Hz), where true motion has lines only, it is whatever lies around them, because sampled edges leave patterns.
    """
    floor = (2.0 * math.pi * f) ** 2 * 2.0 * (speed * u_time) ** 2 / (speed * LINES / (2.0 * math.pi))
    density = lines**2 * 2.0 * width
    return np.asarray((density > OUTSTANDING * np.where(f > smooth, _around(density), floor)) | (f < SLOW))


def _bend(values: Array) -> Array:
    """A parabola that rises or falls at both ends as the values do, (n,).

    To a cosine transform the ends are mirrors, and a platter that speeds up has a kink there: its lines fall with 1/f²
    only and stand above a good gyro's noise beyond `SMOOTH`, where those around them are as high and none stands out.
    """
    if len(values) < 2 * END:
        return np.zeros(len(values))
    at, u = np.arange(END) + 0.5, np.arange(len(values)) + 0.5
    first, last = (float(np.polyfit(at, one[:END], 2)[1]) for one in (values, values[::-1]))
    return first * u - (last + first) * u**2 / (2.0 * len(values))


def _around(density: Array) -> Array:
    """Level of the neighbourhood, lines that stand out left aside: running median ÷ that of χ² with one degree."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(density, 2 * NEIGHBOURS + 1, mode="reflect") / 0.455)


def _longest(good: NDArray[np.bool_]) -> tuple[int, int]:
    """Bounds of the longest stretch of trues; raises BadInput if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    if not len(edges):
        raise BadInput("encoder: found no window during which the platter turned, wanted some")
    begins, ends = edges[0::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest])


def _at_rest(found: Sequence[_Record]) -> list[_Record]:
    """Records at rest with the angle at which the platter stood: where a neighbour started or came to rest."""
    result = []
    for place, one in enumerate(found):
        if one.kind == "rest":
            angle = math.nan
            if place + 1 < len(found) and found[place + 1].kind == "spin_up":
                angle = found[place + 1].ends[0]
            elif place and found[place - 1].kind == "coast_down":
                angle = found[place - 1].ends[1]
            shown = replace(one.counted, angle=np.full(one.means.shape[1], angle))
            one = replace(one, counted=shown, closed=shown)
        result.append(one)
    return result


def _joined(records: Recorded, name: str, channels: Channels, found: Sequence[_Record]) -> PlatterRecords:
    names, wires = list(found[0].names), wires_of(records)
    interval = WINDOW * _scan_period(records)
    lengths = [one.means.shape[1] for one in found]
    bounds = np.concatenate([[0], np.cumsum(lengths)]).tolist()
    slices = tuple(itertools.pairwise(bounds))
    means = np.concatenate([one.means for one in found], axis=1)
    sensors, sheet = np.array([names.index(n) for n in channels.names]), _flicker_by_sheet(records, channels)
    counted, closed = (_together([getattr(one, which) for one in found]) for which in ("counted", "closed"))
    frames = np.concatenate(
        [np.repeat(_frame(one.mount)[:, :, None], n, axis=2) for one, n in zip(found, lengths, strict=True)], axis=2
    )
    pairs = list(zip(found, lengths, strict=True))
    time = np.concatenate([one.start + (one.first + np.arange(n) + 0.5) * interval for one, n in pairs])
    clipped = {name for one in found for name in one.clipped}
    return PlatterRecords(
        name=name,
        run=records.name,
        channels=channels,
        observed=means[sensors],
        counted=counted,
        closed=closed,
        lost=sum(one.lost for one in found),
        lines=sum(one.lines for one in found),
        noise=tuple(_noise(found, int(row), interval, said) for row, said in zip(sensors, sheet, strict=True)),
        interval=interval,
        time=time,
        records=slices,
        labels=tuple(one.label for one in found),
        stretches=stretches_of(slices, interval, PIECE, counted.rate),
        motor=np.repeat([one.kind in ("spin_up", "hold", "perturbed") for one in found], lengths),
        outward=frames[:, 0],
        tangent=frames[:, 1],
        up=frames[:, 2],
        radius=np.repeat([float(one.mount["radius"]) for one in found], lengths),
        temperature=smoothed(time, _logged(means, names, wires.temperature, 100.0)),
        supply=smoothed(time, _logged(means, names, wires.supply, 1.0)),
        gravity=reference(records, "gravity", "gravity").value,
        usable=np.array([n not in clipped for n in channels.names]),
        resting=interval * sum(n for one, n in pairs if one.kind == "rest"),
        graduation=_graduation(found),
        notes=tuple(note for one in found for note in one.notes),
    )


def _graduation(found: Sequence[_Record]) -> tuple[float, float, float]:
    shown = graduation([one.pattern for one in found if one.pattern is not None])
    return (0.0, 0.0, 0.0) if shown is None else (shown.rms, shown.u, shown.evidence)


def _scan_period(records: Recorded) -> float:
    for entry in records.lines:
        if entry.kind == "point" and "samples" in entry.body:
            return next(iter(records.pieces(str(entry.body["samples"])))).timing.scan_period
    raise BadInput(f"{records.name}: found no record of the converter, wanted one")


def _together(shown: Sequence[Shown]) -> Shown:
    return Shown(*(np.concatenate([getattr(s, n) for s in shown]) for n in ("angle", "rate", "acceleration")))


def _frame(mount: Mapping[str, Any]) -> Array:
    """Outward, tangent and up in the case frame, as columns, (3, 3): what each axis feels of a unit along them."""
    made, one, none = mount_of(mount), np.ones(()), np.zeros(())
    felt = [[made.force(k, one, none, 0.0), made.force(k, none, one, 0.0), made.force(k, none, none, 1.0)]
            for k in range(3)]  # fmt: skip
    return np.array(felt, np.float64)


def _logged(means: Array, names: Sequence[str], name: str, factor: float) -> Array:
    return means[names.index(name)] * factor if name in names else np.full(means.shape[1], math.nan)


def _flicker_by_sheet(records: Recorded, channels: Channels) -> list[noise.Beforehand]:
    """What the sensor file says of the flicker of every channel, V². White noise any rest shows, louder than stated or
    not.
    """
    sensor, found = Sensor.of(records.header), list[noise.Beforehand]()
    for name, scale in zip(channels.names, np.abs(channels.sensitivity).tolist(), strict=True):
        said = sensor.channel(name).noise if name in sensor else None
        known = noise.NOTHING if said is None else noise.by_sheet(said.density * scale, said.tolerance, said.corner)
        found.append({one: at for one, at in known.items() if one == "flicker"})
    return found


def _noise(found: Sequence[_Record], row: int, interval: float, sheet: noise.Beforehand) -> noise.NoiseModel:
    """White noise and flicker of the window means from the records at rest, of all records without any, and from what
    the data sheet says: a short rest hardly shows the flicker that means of minutes have.
    """
    from scipy.fft import dct

    resting = [one for one in found if one.kind == "rest"] or list(found)
    lines: list[tuple[Array, Array]] = []
    for one in resting:
        values = one.means[row]
        count = len(values)
        turned = dct(values - values.mean(), type=2, norm="ortho")[1:]
        lines.append((np.arange(1, count) / (2.0 * count * interval), turned**2 * (2.0 * interval)))
    f, power = (np.concatenate([one[k] for one in lines]) for k in (0, 1))
    order = np.argsort(f, kind="stable")
    density: Density = log_bins(f[order] * (1.0 + 1e-12 * np.arange(len(f))), power[order], PER_DECADE, 1.0)
    # without a step: a mean over a window has no alias of it
    return noise.fit_density(density, 1.0 / interval, step=0.0, pole=None, beforehand=sheet)
