"""From imported rotations and free motion to records that a model follows: one grid, gravity, the parts that count."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.foreign import faults
from rig.foreign.faults import without_faults
from rig.foreign.manifest import Column, Rotation
from rig.foreign.tables import CONDITIONS, Foreign, Table
from rig.model import Array, Channels
from rig.parts.conditions import smoothed
from rig.parts.reading.above_motion import above_motion
from rig.parts.reading.intervals import signed
from rig.parts.reading.track_noise import device_noise
from rig.parts.reference_motion import Shown
from rig.parts.track import TrackRecords, spun_force, spun_up
from rig.signals.blocks import spread
from rig.signals.encoder_angle import AngleTrack, encoder_track, quadrature_track
from rig.signals.pose_track import PoseTrack, pose_track
from rig.signals.shared_lines import shared_lines

PIECE, SHORTEST_PIECE = 10.0, 3.0  # s of a stretch, at most and, of a short record, at least
PIECES = 6  # of a short record
SAMPLES = 4.0  # per period of the highest frequency compared
TAPS = 24  # of the low-pass before thinning, per instant kept
BEYOND = 1.5  # of a stated band: a reference that keeps 99 % there bends by less than 1e-3 within
SHORTEST = 4.0  # s of a record between gaps that is worth comparing
LOW_PASS = 1.45  # of the band, half amplitude: flat within it, and nothing left at half the new rate
EDGE = 2.0  # periods of the highest frequency at either end of a record that are not compared
MOSTLY = 0.8  # of the instants: where gaps of the device cost more, what is between them is compared as it stands
SLOW = 0.02  # of the fastest rate: a piece at rest
STEADY = 0.1  # of its rate that a steady one varies
LITTLE = 0.1  # of the motion of a record is no motion
SHOWN = 3  # sentences on faults of a record of which nothing is left
SURE = 0.5  # correlation of a gyro with the reference's rate that tells the sense
AXES = "xyz"
SPLINE = 4  # rows that a spline of third degree needs
LONGEST_STEP = 5.0  # intervals from row to row that a spline bridges


@dataclass(frozen=True)
class _Piece:
    """One table on the reference's grid: observed (c, n), motion, which instants count, (n,), and of those which count
    in each channel, `kept` (c, n)."""

    table: Table
    time: Array
    observed: Array
    good: NDArray[np.bool_]
    kept: NDArray[np.bool_]
    interval: float
    track: AngleTrack | PoseTrack
    conditions: Mapping[str, Array]
    step: int = 1
    taps: Array | None = None

    def of_track(self, name: str, begin: int, end: int) -> Array:
        """Values of the track at some instants of the grid, low-passed as the device is."""
        values: Array = getattr(self.track, name)
        if self.taps is not None:
            values = _low_passed(values, self.taps)
        return values[..., :: self.step][..., begin:end]


def rotations(foreign: Foreign) -> TrackRecords:
    """Every file of a run of kind "rotation" together. Raises BadInput where nothing can be compared."""
    made = foreign.manifest.rotation
    if made is None:
        raise BadInput(f"{foreign.run}: found no rotation in its manifest, wanted it to say the axis")
    grids = [_on_grid(foreign, table, _turned(foreign, table)) for table in foreign.tables]
    pieces = _compared(foreign, grids)
    data = _joined(foreign, pieces, made)
    whole = max(float(np.sqrt(np.mean(piece.track.rate[piece.track.good] ** 2))) for piece in pieces)
    seen = data.rate if data.kept is None else data.rate * data.kept.any(axis=0)
    if float(np.sqrt(np.mean(seen**2) * 3.0)) < LITTLE * whole:
        raise BadInput(
            f"{foreign.run}: found nothing but rest between its gaps, wanted some motion{_of_faults(foreign)}"
        )
    noise = device_noise(data, [one.noise for one in _device(foreign)])
    data = replace(data, noise=noise)
    if all(one is None for one in noise) and data.kept is None:
        data = _above(foreign, data, grids)
    return replace(data, notes=(*data.notes, *_shaken(foreign, made.axis, data.bands[0])))


def _above(foreign: Foreign, data: TrackRecords, grids: Sequence[_Piece]) -> TrackRecords:
    """The records with the noise that stands above their motion, before they are thinned."""
    whole = [replace(one, good=one.good & one.kept.all(axis=0)) for one in grids]
    rows = [one.observed[:, begin:end] for one in whole for begin, end in _whole(one, one.interval)]
    numbers = [np.concatenate([foreign.si(t, one) for t in foreign.tables]) for one in _device(foreign)]
    codes = [float(np.min(np.diff(np.unique(one[np.isfinite(one)])), initial=math.inf)) for one in numbers]
    ends = max(float(np.max(piece.track.bandwidth)) for piece in grids)
    return above_motion(data, rows, codes, grids[0].interval, ends)


def _of_faults(foreign: Foreign) -> str:
    """What may have made the gaps of a record, to go on a sentence with."""
    words = [one.in_words for one in faults.left_out(foreign)]
    return "".join(f"; {one}" for one in words[:SHOWN])


def motions(foreign: Foreign) -> TrackRecords:
    """Every file of a run of kind "motion" together. Raises BadInput where nothing can be compared."""
    pieces = [_on_grid(foreign, table, _posed(foreign, table)) for table in foreign.tables]
    return _joined(foreign, _compared(foreign, pieces), None)


def _turned(foreign: Foreign, table: Table) -> AngleTrack:
    made = foreign.manifest
    columns = made.of("reference", "angle")
    if not columns:
        return _counted(foreign, table)
    u = foreign.u(table, columns[0])
    return encoder_track(  # jitter of stamps is among the noise of the rows: weights for it would bend the response
        foreign.time(table) + columns[0].delay, without_faults(foreign, table, columns[0]),
        u_angle=0.0 if u is None else math.sqrt(float(np.nanmean(u**2))), keep=_keep(foreign),
    )  # fmt: skip


def _counted(foreign: Foreign, table: Table) -> AngleTrack:
    """From the sampled lines of an encoder."""
    made, signals, delay = foreign.manifest, {}, 0.0
    for quantity in ("line_a", "line_b", "index_line"):
        found = made.of("reference", quantity)
        if found:
            signals[quantity], delay = foreign.si(table, found[0]), found[0].delay
    if made.rotation is None or made.rotation.lines is None or "line_b" not in signals:
        raise BadInput(f"{foreign.run}: found no line_b or no lines per revolution, wanted both for a sampled encoder")
    return quadrature_track(
        foreign.time(table) + delay, signals["line_a"], signals["line_b"], signals.get("index_line"),
        lines=made.rotation.lines, keep=_keep(foreign),
    )  # fmt: skip


def _posed(foreign: Foreign, table: Table) -> PoseTrack:
    made = foreign.manifest
    if made.pose is None:
        raise BadInput(f"{foreign.run}: found no pose in its manifest, wanted it to say how the quaternion turns")
    position: dict[str | None, Array] = {
        one.axis: without_faults(foreign, table, one) for one in made.of("reference", "position")
    }
    quaternion: dict[str | None, Array] = {
        one.component: foreign.si(table, one) for one in made.of("reference", "quaternion")
    }
    lacking = [f"position {a}" for a in AXES if a not in position] + [
        f"quaternion {c}" for c in "wxyz" if c not in quaternion
    ]
    if lacking:
        raise BadInput(f"{foreign.run}: found no reference column of {', '.join(lacking)}, wanted all components")
    delay = made.of("reference", "position")[0].delay  # the same for all that the cameras say
    return pose_track(
        foreign.time(table) + delay, np.stack([position[a] for a in AXES], axis=1),
        np.stack([quaternion[c] for c in "wxyz"], axis=1), convention=made.pose.quaternion, up=made.pose.up,
        gravity=made.gravity.value, keep=_keep(foreign),
    )  # fmt: skip


def _on_grid(foreign: Foreign, table: Table, track: AngleTrack | PoseTrack) -> _Piece:
    """The device's channels at the instants of the reference's grid; splines through what was sampled."""
    found, kept, good = [], [], track.good.copy()
    for column in _device(foreign):
        stamps = foreign.time(table) + column.delay
        values = without_faults(foreign, table, column)
        known = np.isfinite(stamps) & np.isfinite(values)
        later = np.flatnonzero(known)
        later = later[np.diff(np.maximum.accumulate(stamps[later]), prepend=-math.inf) > 0.0]
        if len(later) < SPLINE:
            where = f"{foreign.run} {table.label}, {column.channel}"
            raise BadInput(f"{where}: found {len(later)} rows with a number and a later stamp, wanted a record")
        signal, near = _splined(stamps[later], values[later], track.time)
        found.append(signal)
        kept.append(near)
        good &= (track.time >= stamps[later][0]) & (track.time <= stamps[later][-1])
    conditions = _conditions(foreign, table, track.time)
    return _Piece(table, track.time, np.array(found), good, np.array(kept), track.interval, track, conditions)


def _splined(stamps: Array, values: Array, at: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Values at other instants by a cubic spline, and whether rows are close enough there; else by a straight line.

    Beside a gap the spline leans on what is beyond it.
    """
    from scipy.interpolate import CubicSpline

    close = np.diff(stamps) < LONGEST_STEP * float(at[1] - at[0])
    padded = np.pad(close, 1, constant_values=True)
    clear = padded[:-2] & close & padded[2:]
    near = clear[np.searchsorted(stamps, at).clip(1, len(stamps) - 1) - 1]
    return np.where(near, CubicSpline(stamps, values)(at), np.interp(at, stamps, values)), near


def _compared(foreign: Foreign, pieces: Sequence[_Piece]) -> list[_Piece]:
    """Pieces as they are compared: thinned, and cut where a channel has a gap; where that would leave too little, as
    they stand, with what counts in each channel by itself.

    A low-pass spreads a gap over all that it reaches, so pieces with many gaps are not thinned.
    """
    band = min(max(_bands(foreign, piece.track)) for piece in pieces)
    cut = [_thinned(replace(one, good=one.good & one.kept.all(axis=0), kept=one.kept | True), band) for one in pieces]
    whole = [_thinned(replace(one, kept=one.kept | True), band) for one in pieces]
    left, there = (sum(e - b for one in some for b, e in _whole(one, one.interval)) for some in (cut, whole))
    return cut if left >= MOSTLY * there else list(pieces)


def _conditions(foreign: Foreign, table: Table, at: Array) -> dict[str, Array]:
    """Temperature and supply at the instants of the grid, without the noise of their readings; NaN where not logged."""
    time, found = foreign.time(table), {}
    for name in CONDITIONS:
        values = foreign.condition(table, name)
        known = np.flatnonzero(np.isfinite(time) & np.isfinite(values))
        known = known[np.diff(np.maximum.accumulate(time[known]), prepend=-math.inf) > 0.0]
        there = np.interp(at, time[known], smoothed(time[known], values[known])) if len(known) else math.nan
        found[name] = np.broadcast_to(there, at.shape)
    return found


def _thinned(piece: _Piece, band: float) -> _Piece:
    """Every few instants, as many as the band needs: device and reference alike low-passed without delay.

    The noise of a reference rises with frequency: thinned as it stands, what is above the grid would fold into it.
    """
    from scipy.signal import firwin

    step = math.floor(1.0 / (SAMPLES * band * piece.interval))
    if step < 2:
        return piece
    taps = firwin(TAPS * step + 1, LOW_PASS * band, window=("kaiser", 8.0), fs=1.0 / piece.interval)
    smooth = _low_passed(piece.observed, taps)[:, ::step]
    margin = np.ones(TAPS * step + 1)
    good = (np.convolve(piece.good, margin, mode="same") > len(margin) - 0.5)[::step]
    return replace(
        piece,
        time=piece.time[::step],
        observed=smooth,
        good=good,
        kept=piece.kept[:, ::step],
        interval=step * piece.interval,
        conditions={name: values[::step] for name, values in piece.conditions.items()},
        step=step,
        taps=taps,
    )


def _low_passed(values: Array, taps: Array) -> Array:
    from scipy.ndimage import convolve1d

    return np.asarray(convolve1d(values, taps, axis=-1, mode="nearest"))


def _device(foreign: Foreign) -> list[Column]:
    return [one for one in foreign.manifest.of("device") if one.quantity in ("acceleration", "rate")]


def channels_of(columns: Sequence[Column]) -> Channels:
    """Channels of imported columns: SI in, SI out, or counts with their sensitivity taken off on reading."""
    for one in columns:
        if one.axis is None:
            raise BadInput(f"{one.channel}: found no axis, wanted x, y or z")
    return Channels(
        names=tuple(one.channel for one in columns),
        rates=np.array([one.quantity == "rate" for one in columns]),
        axis=np.array([AXES.index(one.axis or "x") for one in columns]),
        slot=np.zeros(len(columns), np.intp),
        side=np.full(len(columns), math.nan),
        sensitivity=np.ones(len(columns)),
        tolerance=np.array([one.tolerance for one in columns]),
        pole=np.array([one.bandwidth or math.inf for one in columns]),
        unit=("unit",) * len(columns),
    )


def _joined(foreign: Foreign, pieces: Sequence[_Piece], rotation: Rotation | None) -> TrackRecords:
    """Pieces one after the other, cut where nothing counts."""
    made = foreign.manifest
    interval = float(np.median([piece.interval for piece in pieces]))
    bands = tuple(np.min([_bands(foreign, piece.track) for piece in pieces], axis=0).tolist())
    runs = [(piece, begin, end) for piece in pieces for begin, end in _whole(piece, interval)]
    if not runs:
        wanted = f"wanted some to compare{_of_faults(foreign)}"
        raise BadInput(f"{foreign.run}: found no {SHORTEST:g} s without a gap, {wanted}")
    cut = [slice(begin, end) for _, begin, end in runs]
    bounds = np.cumsum([0, *(s.stop - s.start for s in cut)]).tolist()
    records = tuple(itertools.pairwise(bounds))
    edge = round(EDGE / (max(bands) * interval))
    stretches, held = _stretches(foreign, runs, records, interval, edge)
    observed = np.concatenate([piece.observed[:, s] for (piece, _, _), s in zip(runs, cut, strict=True)], axis=1)
    kept = np.concatenate([piece.kept[:, s] for (piece, _, _), s in zip(runs, cut, strict=True)], axis=1)
    time = np.concatenate([piece.time[s] for (piece, _, _), s in zip(runs, cut, strict=True)])
    temperature, supply = (
        np.concatenate([piece.conditions[name][s] for (piece, _, _), s in zip(runs, cut, strict=True)])
        for name in ("temperature", "supply")
    )
    notes = [note for piece in pieces for note in piece.track.notes]
    data = TrackRecords(
        name=f"{foreign.run}#{made.kind}", run=foreign.run, place="free" if rotation is None else "rotation",
        channels=channels_of(_device(foreign)), observed=observed, interval=interval, time=time, shown=None, axis=0,
        upright=np.zeros(len(time)), phase=0.0, radius=0.0, outward=np.zeros(3), rate=np.zeros((3, len(time))),
        turning=np.zeros((3, len(time))), force=np.zeros((3, len(time))), up=np.zeros((3, len(time))),
        gravity=made.gravity.value, records=records, stretches=stretches, held=held, bands=bands, notes=tuple(notes),
        blind=_BLIND, temperature=temperature, supply=supply, kept=None if kept.all() else kept,
        files=tuple(piece.table.label for piece, _, _ in runs),
    )  # fmt: skip
    if rotation is None:
        rate, turning, force, up = (
            np.concatenate([piece.of_track(name, b, e) for piece, b, e in runs], axis=1)
            for name in ("rate", "turning", "force", "up")
        )
        return replace(data, rate=rate, turning=turning, force=force, up=up)
    return _with_encoder(data, runs, rotation, _stated_up(foreign, runs))


_BLIND = (
    "a delay that all channels share and an offset of the reference's time stamps are one and the same here: which of "
    "the two it is, only one clock for both or an event that both see would tell",
)


Stated = tuple[NDArray[np.bool_], Array]  # instants (n,), and what is up then, in the case (3,)


def _stated_up(foreign: Foreign, runs: Sequence[tuple[_Piece, int, int]]) -> list[Stated]:
    """Segments that say which axis of the case is up."""
    found = []
    for one in foreign.manifest.segments:
        if one.up is not None:
            masks = []
            for piece, begin, end in runs:
                stamps, time = foreign.time(piece.table)[one.first : one.last], piece.time[begin:end]
                stamps = stamps[np.isfinite(stamps)]
                first, last = stamps.min(initial=math.inf), stamps.max(initial=-math.inf)
                masks.append((time >= first) & (time <= last))
            found.append((np.concatenate(masks), signed(one.up)))
    return found


def _with_encoder(
    data: TrackRecords, runs: Sequence[tuple[_Piece, int, int]], rotation: Rotation, stated: Sequence[Stated]
) -> TrackRecords:
    """The encoder's motion about the case's axis; its sense and how gravity lies are found if nobody states them."""
    *arrays, density, coarse = [np.concatenate([piece.of_track(name, b, e) for piece, b, e in runs])
                                for name in ("angle", "rate", "acceleration", "density", "coarse")]  # fmt: skip
    axis = AXES.index(rotation.axis)
    found, said = _sense(data, axis, arrays[1])
    sense = float(rotation.sense or found or 1)
    notes = [*data.notes, *([said] if said and rotation.sense is None else [])]
    shown = Shown(*(sense * one for one in arrays))
    rate, turning = np.zeros_like(data.rate), np.zeros_like(data.rate)
    rate[axis], turning[axis] = shown.rate, shown.acceleration
    felt = _across(data, axis, shown, rotation)
    outward, more = _outward(felt, axis, rotation)
    upright, phase = _upright(data, axis, stated), _phase(felt, axis, shown.angle, stated)
    if not rotation.upright:
        upright = np.zeros_like(upright)
    made = replace(
        data, shown=shown, axis=axis, upright=upright, phase=phase, radius=rotation.radius, outward=outward, rate=rate,
        turning=turning, density=density, coarse=coarse,
        jitter=max(piece.track.jitter for piece, _, _ in runs if isinstance(piece.track, AngleTrack)),
        sampled=runs[0][0].track.interval, notes=(*notes, *more, *_against(data, stated)),
    )  # fmt: skip
    up = spun_up(made, shown.angle)
    return replace(made, up=up, force=spun_force(made, up, shown))


def _across(data: TrackRecords, axis: int, shown: Shown, rotation: Rotation) -> dict[str, complex]:
    """What the accelerometers across the axis feel in proportion to gravity that goes round and to the motion of a case
    beside the axis, each as a complex number: along the first axis across it, and the second. {} if they tell nothing.
    """
    parts = {} if rotation.upright else {"gravity": np.exp(-1j * shown.angle)}
    if rotation.radius:
        parts["outward"] = -(shown.rate**2) + 1j * shown.acceleration
    rows, columns = [], []
    for row in np.flatnonzero(~data.channels.rates):
        k = (int(data.channels.axis[row]) - axis) % 3 - 1
        if k >= 0:
            zeros = [np.full(len(data.time), float(k == n)) for n in range(2)]
            each = [(one.real, -one.imag) if k == 0 else (one.imag, one.real) for one in parts.values()]
            counts = np.ones(len(data.time)) if data.kept is None else data.kept[row]
            columns.append(np.stack([*zeros, *(column for pair in each for column in pair)], axis=1) * counts[:, None])
            rows.append(data.observed[row] * counts)
    if not rows or not parts:
        return {}
    solved = np.linalg.lstsq(np.concatenate(columns), np.concatenate(rows), rcond=None)[0][2:]
    return {name: complex(solved[2 * k], solved[2 * k + 1]) for k, name in enumerate(parts)}


def _outward(felt: Mapping[str, complex], axis: int, rotation: Rotation) -> tuple[Array, list[str]]:
    """The direction of the radius in the case, as stated, or as the accelerometers tell it, and what is to be said."""
    if not rotation.radius:
        return np.zeros(3), []
    if rotation.outward is not None:
        return signed(rotation.outward), []
    if not felt.get("outward"):
        return np.zeros(3), []
    direction, found = felt["outward"] / abs(felt["outward"]), np.zeros(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    found[first], found[second] = direction.real, direction.imag
    angle = math.degrees(math.atan2(direction.imag, direction.real))
    return found, [
        f"radius: nobody states which way the case sits; by its accelerometers outward is {angle:.0f}° from "
        f"{AXES[first]} towards {AXES[second]}"
    ]


def _shaken(foreign: Foreign, axis: str, band: float) -> list[str]:
    """Lines above the compared band that the gyro about the axis and the encoder's angle share, file by file."""
    angles = foreign.manifest.of("reference", "angle")
    gyros = [one for one in _device(foreign) if one.quantity == "rate" and one.axis == axis]
    said = []
    for table in foreign.tables if angles and gyros else ():
        time, angle, gyro = foreign.time(table), foreign.si(table, angles[0]), foreign.si(table, gyros[0])
        known = np.flatnonzero(np.isfinite(time) & np.isfinite(angle) & np.isfinite(gyro))
        known = known[np.diff(np.maximum.accumulate(time[known]), prepend=-math.inf) > 0.0]
        step = float(np.median(np.diff(time[known])))
        even = np.arange(time[known[0]], time[known[-1]], step)
        angle[known] = np.unwrap(angle[known])
        turned, felt = (np.interp(even, time[known], one[known]) for one in (angle, gyro))
        if found := shared_lines(turned, felt, step, band):
            lines = "; ".join(one.in_words for one in found)
            said.append(f"{table.label}: real motion above the band, in gyro and encoder alike: lines at {lines}")
    return said


def _sense(data: TrackRecords, axis: int, rate: Array) -> tuple[int, str]:
    """Sign of the gyro along the axis against the reference, and a sentence if they are against each other."""
    for row, name in enumerate(data.channels.names):
        if data.channels.rates[row] and data.channels.axis[row] == axis:
            with np.errstate(invalid="ignore"):  # what stands still goes neither with the reference nor against it
                r = float(np.corrcoef(data.observed[row], rate)[0, 1])
            if r < -SURE:
                return -1, (
                    f"sign: {name} counts against the encoder's angle (correlation {r:.3f}); which of them is right "
                    "nobody states, so the encoder is taken to count against a right-hand turn about "
                    f"{AXES[axis]}"
                )
            if r > SURE:
                return 1, ""
    return 0, ""


def _upright(data: TrackRecords, axis: int, stated: Sequence[Stated]) -> Array:
    """Which way up an upright axis stands, (n,): as stated, elsewhere by the accelerometer along it, else up."""
    found = np.zeros(len(data.time))
    for mask, up in stated:
        found[mask] = np.sign(up[axis])
    rest = found == 0.0
    along = np.flatnonzero(~data.channels.rates & (data.channels.axis == axis))
    if rest.any():
        down = len(along) and float(data.observed[along[-1], rest].mean()) < 0.0
        found[rest] = -1.0 if down else 1.0 if len(along) or not stated else np.sign(stated[0][1][axis]) or 1.0
    return found


def _phase(felt: Mapping[str, complex], axis: int, angle: Array, stated: Sequence[Stated]) -> float:
    """The angle at which gravity's side of a level axis lies: as stated, else by the accelerometers across it."""
    for mask, up in stated:
        side = complex(up[(axis + 1) % 3], up[(axis + 2) % 3])
        if side and mask.any():
            return float(np.angle(side * np.mean(np.exp(1j * angle[mask]))))
    return float(np.angle(felt.get("gravity", 0.0)))


def _against(data: TrackRecords, stated: Sequence[Stated]) -> list[str]:
    """Statements of what is up that the accelerometers contradict."""
    said = []
    for mask, up in stated:
        axis = int(np.abs(up).argmax())
        for row in np.flatnonzero(~data.channels.rates & (data.channels.axis == axis)):
            mean = float(data.observed[row, mask].mean()) if mask.any() else 0.0
            if mean * float(up[axis]) < -0.5 * data.gravity:
                name, which = data.channels.names[row], "+" if up[axis] > 0.0 else "-"
                said.append(f"{name} shows {mean:.3g} m/s² while the manifest has {which}{AXES[axis]} up")
    return said


def _bands(foreign: Foreign, track: AngleTrack | PoseTrack) -> tuple[float, float]:
    """Of rates and of forces, Hz: as stated, else to where the track keeps the motion, and it is no noise."""
    stated = foreign.manifest.compared
    own = min(track.kept, track.clear) if isinstance(track, AngleTrack) else track.kept
    kept = own if isinstance(own, tuple) else (own, own)
    return stated.rate_band or kept[0], stated.force_band or kept[1]


def _keep(foreign: Foreign) -> float | None:
    """To where the reference must keep the motion, Hz: well above a stated band, within which it must not bend."""
    stated = [b for b in (foreign.manifest.compared.rate_band, foreign.manifest.compared.force_band) if b is not None]
    return BEYOND * max(stated) if stated else None


def _whole(piece: _Piece, interval: float) -> Iterator[tuple[int, int]]:
    """Bounds of runs of instants that count."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], piece.good, [False]]).astype(np.int8)))
    for begin, end in zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True):
        if (end - begin) * interval >= SHORTEST:
            yield begin, end


def _stretches(
    foreign: Foreign, runs: Sequence[tuple[_Piece, int, int]], records: Sequence[tuple[int, int]], interval: float,
    edge: int,
) -> tuple[tuple[tuple[int, int], ...], NDArray[np.bool_]]:  # fmt: skip
    """Pieces of about equal length, and whether each is held out: of a file so marked, else evenly over every file and
    over what it does there.

    What creeps or steps in the course of a record shows only in pieces that are held out from all over it. The ends of
    a record, `edge` instants, are left out: what a model does to a motion is not known there, because what was before
    is not.
    """
    found, states, marked = [], [], []
    for (piece, begin, end), (first, _) in zip(runs, records, strict=True):
        begin, end, first = begin + edge, end - edge, first + edge
        seconds = (end - begin) * interval
        count = max(1, round(seconds / min(PIECE, max(seconds / PIECES, SHORTEST_PIECE))))
        length = (end - begin) // count
        rate = np.atleast_2d(piece.of_track("rate", begin, end))
        for k in range(count):
            found.append((first + k * length, first + (k + 1) * length))
            states.append((piece.table.label, _state(rate[:, k * length : (k + 1) * length], rate)))
            marked.append(piece.table.held_out)
    if any(table.held_out for table in foreign.tables):
        return tuple(found), np.array(marked)
    return tuple(found), spread(states, foreign.manifest.compared.held_out)


def _state(rate: Array, whole: Array) -> str:
    """Rest, a steady rate (to a tenth of its logarithm), or what is neither, of some of the instants of `whole`."""
    if not rate.size:
        return "rest"
    size, mean = float(np.sqrt(np.mean(np.sum(rate**2, axis=0)))), float(np.linalg.norm(rate.mean(axis=1)))
    if size < SLOW * float(np.sqrt(np.max(np.sum(whole**2, axis=0), initial=0.0))):
        return "rest"
    steady = size**2 - mean**2 < (STEADY * size) ** 2
    return f"{rate.mean(axis=1).sum() > 0.0} {10.0 * math.log(mean):.0f}" if steady else "moving"
