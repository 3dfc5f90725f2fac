"""A turntable run as block means: what the encoder says the platter did, and what every channel put out meanwhile.

Blocks of a hold end where the same line of the disk passes, so their rates are whole-revolution means; blocks of
spin-up, coast-down and touches come from the track through all edges; at rest the rate is zero. The mean of a channel
over a block has no bias from how its samples fall, and hours become a few hundred numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, mounts
from rig.archive.reduced import reduced
from rig.errors import BadInput
from rig.sensor import ROTATIONS, Sensor
from rig.signals import spectrum
from rig.signals.rotation import Edges, Track, Turns, edges_of, encoder_settings, turns

Array = NDArray[np.float64]
Kind = Literal["rest", "hold", "moving"]
REST_BLOCK = 1.5  # s
MOVING_BLOCK = 0.3  # s
SLOWEST = 0.3  # rad/s; below it lines are too far apart for a local rate
MOST_BLOCKS = 120  # of one record
AXES = {word: place for place, word in enumerate(ROTATIONS)}


@dataclass(frozen=True)
class Mount:
    """How the cube stood on the platter: gyro axis on the platter's axis, radius (m), angle (rad)."""

    axis: str
    inverted: bool
    radius: float
    angle: float

    @property
    def sense(self) -> float:
        """+1 if the gyro axis points up."""
        return -1.0 if self.inverted else 1.0

    def force(self, cube_axis: int, radial: Array, tangential: Array, gravity: float) -> Array:
        """Specific force along one axis of the cube (0 x, 1 y, 2 z), m/s², from radial and tangential acceleration.

        With the angle zero the axis after the vertical one (in cyclic order) points outwards, the one after that along
        the tangent (z up × outward) if the cube is upright, against it if it is turned over about the outward axis.
        """
        place = (cube_axis - AXES[self.axis]) % 3
        if place == 0:
            return np.full(np.shape(radial), self.sense * gravity)
        if place == 1:
            return np.asarray(math.cos(self.angle) * radial + math.sin(self.angle) * tangential)
        return np.asarray(self.sense * (math.cos(self.angle) * tangential - math.sin(self.angle) * radial))


@dataclass(frozen=True)
class Blocks:
    """Block means of one record; times are bench-clock s; all arrays have shape (n,).

    `rate`, `square`, `cube` are means of ω, ω², ω³ about the platter's upward axis, `acceleration` that of α.
    `u_bound` (s) is the uncertainty of the instant where a block of a hold ends. `volts` by channel;
    `clipped` samples at the ends of the converter's range, by channel. `record` is the converter's block of samples;
    `u_time` (s) how well the channels' instants are known by its clock.
    """

    run: str
    label: str
    kind: Kind
    mount: Mount
    begin: Array
    end: Array
    rate: Array
    square: Array
    cube: Array
    acceleration: Array
    u_bound: float
    volts: Mapping[str, Array]
    clipped: Mapping[str, int]
    flags: tuple[str, ...] = ()
    record: str = ""
    u_time: float = 0.0


@dataclass(frozen=True)
class Rotation:
    """One turntable run: its blocks, and noise in motion of the gyros on the axis.

    `in_motion` holds the lines of a gyro's output during the longest hold with the fitted motion taken away, V.
    """

    run: str
    blocks: tuple[Blocks, ...]
    in_motion: Mapping[str, spectrum.Lines]
    step: float
    flags: tuple[str, ...] = ()

    def clipped(self, channel: str) -> int:
        """Samples of a channel at the ends of the converter's range, over all blocks."""
        return sum(block.clipped.get(channel, 0) for block in self.blocks)


def rotation_of(records: Recorded, channels: Sequence[str], sensor: Sensor) -> Rotation:
    """Reduce a turntable run; nominal sensitivities of the `sensor` only take the wow out of noise in motion.

    Raises BadInput if the run has no hold, or a hold has no whole revolutions that can be trusted.
    """
    kinds = (Rotation, Blocks, Mount, spectrum.Lines, spectrum.Density)
    return reduced(records, "rotation", kinds, lambda: _reduced(records, channels, sensor), list(channels), sensor)


def _reduced(records: Recorded, channels: Sequence[str], sensor: Sensor) -> Rotation:
    settings = encoder_settings(records.lines)
    found: list[Blocks] = []
    longest: tuple[float, Mapping[str, Any], Mount, Track] | None = None
    for entry, mounted in mounts(records):
        body = entry.body
        if entry.kind != "point" or mounted is None or "samples" not in body:
            continue
        mount = mount_of(mounted)
        if str(body.get("purpose", "")).startswith("rest_"):
            found.append(_rest(records, body, mount, channels))
        elif "phase" in body:
            edges = edges_of(records.pieces(body["samples"]), settings)
            track = Track(edges)
            if body["phase"] == "hold":
                held = turns(edges, -math.inf, float(body["last_index"]) + edges.interval)
                found.append(_held(records, body, mount, channels, track, held))
                if longest is None or track.end - track.begin > longest[0]:
                    longest = (track.end - track.begin, body, mount, track)
            else:
                found.append(_moving(records, body, mount, channels, track))
    if longest is None:
        raise BadInput(f"{records.name}: found no hold at a steady rate, wanted one for a gyro's sensitivity")
    lines, step = _noise_in_motion(records, longest[1], longest[2], longest[3], channels, sensor)
    return Rotation(records.name, tuple(found), lines, step, tuple(f for one in found for f in one.flags))


def mount_of(settings: Mapping[str, Any]) -> Mount:
    """How the cube stood, from the settings that the operator confirmed."""
    return Mount(str(settings["axis"]), bool(settings["inverted"]), float(settings["radius"]), float(settings["angle"]))


def _rest(records: Recorded, body: Mapping[str, Any], mount: Mount, channels: Sequence[str]) -> Blocks:
    seconds = float(body["seconds"])
    count = min(max(int(seconds / REST_BLOCK), 2), MOST_BLOCKS)
    bounds = np.linspace(0.0, seconds, count + 1)
    zero = np.zeros(count)
    return _blocks(records, body, mount, channels, "rest", bounds, (zero, zero, zero, zero))


def _held(
    records: Recorded, body: Mapping[str, Any], mount: Mount, channels: Sequence[str], track: Track, held: Turns
) -> Blocks:
    together = max(1, math.ceil((len(held.bounds) - 1) / MOST_BLOCKS))
    bounds = held.bounds[::together]
    rate = held.sense * 2.0 * math.pi * together / np.diff(bounds)
    square, cube = _powers(track, bounds)
    flags = _index_flags(track.edges, str(body["label"]))
    accelerated = np.diff(track.rate(bounds)) / np.diff(bounds)
    return _blocks(records, body, mount, channels, "hold", bounds, (rate, square, cube, accelerated), flags)


def _index_flags(edges: Edges, label: str) -> tuple[str, ...]:
    flags = []
    if edges.flagged:
        flags.append(f"{label}: {len(edges.flagged)} index intervals without a whole revolution of lines")
    if edges.missed:
        flags.append(f"{label}: {edges.missed} index pulses missed between samples, counted by their lines")
    return tuple(flags)


def _moving(records: Recorded, body: Mapping[str, Any], mount: Mount, channels: Sequence[str], track: Track) -> Blocks:
    grid = np.arange(track.begin, track.end, MOVING_BLOCK)
    fast = np.abs(track.rate(grid)) > SLOWEST
    grid = grid[fast][1:-1] if np.count_nonzero(fast) > 4 else grid[:0]
    grid = grid[:: max(1, math.ceil(len(grid) / MOST_BLOCKS))]
    length = np.diff(grid) if len(grid) > 1 else np.zeros(0)
    rate = np.diff(track.angle(grid)) / length if len(length) else np.zeros(0)
    square, cube = _powers(track, grid)
    accelerated = np.diff(track.rate(grid)) / length if len(length) else np.zeros(0)
    return _blocks(records, body, mount, channels, "moving", grid, (rate, square, cube, accelerated))


def _powers(track: Track, bounds: Array) -> tuple[Array, Array]:
    """Means of ω² and ω³ over each block, by eight-point sums: the rate is smooth over a block's eighth."""
    if len(bounds) < 2:
        return np.zeros(0), np.zeros(0)
    inside = bounds[:-1, None] + np.diff(bounds)[:, None] * ((np.arange(8) + 0.5) / 8.0)
    rate = track.rate(inside.ravel()).reshape(inside.shape)
    return np.asarray((rate**2).mean(axis=1)), np.asarray((rate**3).mean(axis=1))


def _blocks(
    records: Recorded,
    body: Mapping[str, Any],
    mount: Mount,
    channels: Sequence[str],
    kind: Kind,
    bounds: Array,
    motion: tuple[Array, Array, Array, Array],
    flags: tuple[str, ...] = (),
) -> Blocks:
    volts, start, interval, clipped = block_means(records, str(body["samples"]), channels, bounds)
    flags = (*flags, *(f"{body['label']}: {name} clipped ({n} samples)" for name, n in clipped.items()))
    u_bound = interval / math.sqrt(12.0) if kind == "hold" else 0.0
    return Blocks(
        records.name, str(body["label"]), kind, mount, start + bounds[:-1], start + bounds[1:],
        *motion, u_bound, volts, clipped, flags, str(body["samples"]),
    )  # fmt: skip


def block_means(
    records: Recorded, name: str, channels: Sequence[str], bounds: Array
) -> tuple[dict[str, Array], float, float, dict[str, int]]:
    """Mean volts of each channel between bounds (s since the record's first conversion), shape (n,) each.

    A sample belongs to the block in which its own instant falls. Also the record's start (bench clock, s), the interval
    between scans (s), and samples at the ends of the converter's range by channel. Sums are of whole numbers: exact.
    """
    sums: dict[str, NDArray[np.int64]] = {c: np.zeros(max(len(bounds) - 1, 0), np.int64) for c in channels}
    counts = {c: np.zeros(max(len(bounds) - 1, 0), np.int64) for c in channels}
    clipped: dict[str, int] = {}
    scale: dict[str, tuple[float, float]] = {}
    start = interval = 0.0
    for piece in records.pieces(name):
        start, interval = piece.start, piece.timing.scan_period
        for c in channels:
            column = piece.index(c)
            channel = piece.channels[column]
            scale[c] = (channel.low, (channel.high - channel.low) / 65535.0)
            raw = piece.counts[:, column]
            first = np.ceil((bounds - channel.slot * piece.timing.convert_period) / interval - 1e-9).astype(np.int64)
            inside = np.clip(first - piece.first_scan, 0, len(raw))
            total = np.concatenate([[0], np.cumsum(raw, dtype=np.int64)])
            sums[c] += np.diff(total[inside])
            counts[c] += np.diff(inside)
            ends = int(np.count_nonzero((raw == 0) | (raw == 65535)))
            if ends:
                clipped[c] = clipped.get(c, 0) + ends
    means = {
        c: np.asarray(scale[c][0] + scale[c][1] * sums[c] / np.maximum(counts[c], 1), np.float64) for c in channels
    }
    return means, start, interval, clipped


def _noise_in_motion(
    records: Recorded,
    body: Mapping[str, Any],
    mount: Mount,
    track: Track,
    channels: Sequence[str],
    sensor: Sensor,
) -> tuple[dict[str, spectrum.Lines], float]:
    """Lines of the output of the gyros on the axis during a hold, the encoder's rate times S taken off."""
    nominal = {gyro.name: gyro.nominal for gyro in sensor.about(mount.axis) if gyro.name in channels}
    fed: dict[str, spectrum.Periodogram] = {}
    step = 0.0
    for piece in records.pieces(str(body["samples"])):
        for name in nominal:
            channel = piece.channels[piece.index(name)]
            step = (channel.high - channel.low) / 65535.0
            instants = piece.instants(name)
            inside = (instants >= track.begin) & (instants <= track.end)
            moved = track.rate(instants[inside]) * mount.sense * nominal[name]
            fed.setdefault(name, spectrum.Periodogram(piece.timing.scan_rate)).feed(piece.volts(name)[inside] - moved)
    return {name: periodogram.result() for name, periodogram in fed.items()}, step
