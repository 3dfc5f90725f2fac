"""A record of motion that somebody else's reference followed: a rotation with its encoder, or free motion with poses.

Sensor and reference are compared on one even grid, in a band in which both are trustworthy. Every stretch of some
seconds is turned by a cosine transform, whose lines are nearly independent with the density as variance (Whittle).
Noise of a device that stood still for some seconds, or whose data sheet is stated, is known whatever the model; what
the reference's own noise adds while the case moves is told by its readings. The band above a rotation's motion may tell
it too. Where none of these is there, rows are weighed by
the part of each channel that no linear filter of the reference's motion explains (its incoherent part): good enough to
tell one effect from another, and no ground to call a model adequate, because what is missing lies in it too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.model import Channels, Local, Memory, Term, volts
from rig.motion import Array, Complexes, Motion, Stretches
from rig.parts.conditions import filled, logged
from rig.parts.part import Origin, Part
from rig.parts.reference_motion import REMEMBERED, Shown, reference_key, true_motion, turns
from rig.parts.remainder import Cut, Mask
from rig.signals.blocks import unmixed
from rig.signals.gapped_lines import whitening
from rig.signals.incoherent import by_rising, incoherent
from rig.signals.noise import NoiseModel

DERIVATIVES = 5  # of the reference's motion, the motion itself among them, that a linear filter may follow
LOUDEST = 16.0  # times the mean power that noise may have just when an effect shows
ALLOWANCE = 0.2
KNOWN_ALLOWANCE = 0.06  # of a density that was found elsewhere than in the misfit, beside what its fit left open
WIDER = 1.5  # of the band: what the reference lets through of its noise
NEAR = 5  # instants that a filter ties to each other
STANDS = 0.1  # of a channel's rms: less is no motion
TELLS = 10.0  # standard deviations of a motion in a channel, of whose change something could be told
STEPS = 12  # instants at which a step is tried: one between two of them is seen with nine tenths of its size
APART = 3600.0  # s between two files, of which nobody knows the order


@dataclass(frozen=True)
class DeviceNoise:
    """Noise of one channel, unit of its numbers, and where it is known from."""

    model: NoiseModel
    origin: Origin


@dataclass(frozen=True)
class TrackRecords:
    """n even instants of c channels and the reference's motion at them; records one after the other.

    `observed` (c, n) V or SI as the manifest has it. `shown`: angle, rate and acceleration about `axis` (rotation), or
    none. `rate`, `turning`, `force`, `up` in the case frame (3, n): as the reference shows them. `upright` and `phase`
    say how gravity lies for a rotation. `records` and `stretches` bounds among the instants; `held` (stretches,).
    `bands` Hz for rates and for forces. `time` s within each record's
    file. `temperature` °C and `supply` V at the instants, NaN where not logged.
    """

    name: str
    run: str
    place: Literal["rotation", "free"]
    channels: Channels
    observed: Array
    interval: float
    time: Array
    shown: Shown | None
    axis: int
    upright: Array  # (n,): ±1 with the axis up or down; 0 where it lies level
    phase: float
    radius: float  # m, of the case from the axis
    outward: Array  # unit vector in the case, (3,); nothing if nobody knows
    rate: Array
    turning: Array
    force: Array
    up: Array
    gravity: float
    records: tuple[tuple[int, int], ...]
    stretches: tuple[tuple[int, int], ...]
    held: Mask
    bands: tuple[float, float]
    temperature: Array
    supply: Array
    density: Array | None = None  # of the noise of a rotation's angle about each instant, rad²/Hz, (n,)
    coarse: Array | None = (
        None  # standard uncertainty of the angle that a platter has which stands on a code, rad, (n,)
    )
    jitter: float = 0.0  # standard deviation of the time stamps, as the reference shows it, s
    sampled: float = 0.0  # interval at which it was, s
    noise: tuple[DeviceNoise | None, ...] = ()  # of every channel, if it is known whatever the model
    files: tuple[str, ...] = ()  # that every record is of, by their labels
    kept: Mask | None = None  # instants of each channel that count, (c, n); all without
    notes: tuple[str, ...] = ()
    blind: tuple[str, ...] = ()


def spun_up(data: TrackRecords, angle: Array) -> Array:
    """What is up, in the case at these angles, (3, n): u(θ) = R(axis, −θ)·u(0)."""
    found = np.zeros((3, len(angle)))
    found[data.axis] = data.upright
    lies = data.upright == 0.0
    found[(data.axis + 1) % 3] = np.where(lies, np.cos(angle - data.phase), 0.0)
    found[(data.axis + 2) % 3] = np.where(lies, -np.sin(angle - data.phase), 0.0)
    return found


def spun_force(data: TrackRecords, up: Array, shown: Shown) -> Array:
    """Specific force of gravity and of going round beside the axis, g·up + r·(−ω²·outward + α·tangent), (3, n)."""
    beside = -np.outer(data.outward, shown.rate**2) + np.outer(tangent_of(data), shown.acceleration)
    return np.asarray(data.gravity * up + data.radius * beside)


def tangent_of(data: TrackRecords) -> Array:
    """Axis × outward, in the case, (3,)."""
    return np.cross(np.eye(3)[data.axis], data.outward)


def _cosines(values: Array) -> Array:
    """Orthonormal cosine transform of values (n,)."""
    from scipy.fft import dct

    return np.asarray(dct(values, type=2, norm="ortho"))


class TrackedMotion(Part):
    """Such records as a part of a fit. Raises BadInput for too few instants, or a case that did not move."""

    def __init__(self, data: TrackRecords) -> None:
        self.data = data
        if not data.stretches or any(end <= begin for begin, end in data.stretches):
            seconds = data.interval * len(data.time)
            raise BadInput(
                f"{data.name}: found {len(data.time)} usable instants in {seconds:.3g} s, too few for a spectrum, "
                "wanted a longer record, or the unit of its time stamps put right"
            )
        width = sum(len(f) for f in self._frequencies)
        super().__init__(data.name, data.run, data.channels, width, notes=data.notes, blind=data.blind)
        self.bands = data.bands
        self.logged = logged(temperature=data.temperature, supply=data.supply)
        self.grid = Stretches(data.interval, data.records)
        self._moved: dict[tuple[object, ...], Motion] = {}
        self._memory = Memory()
        self.target = self.whitened(data.observed)  # refuses at once what cannot be compared

    @property
    def experiment(self) -> str:
        return self.data.place

    @property
    def drawing(self) -> str:
        return {"rotation": "rotation", "free": "motion"}[self.data.place]

    @property
    def observed(self) -> Array:
        return self.data.observed

    @cached_property
    def _frequencies(self) -> list[Array]:
        """Frequencies of the lines of every stretch that are within either band, Hz."""
        found = []
        for begin, end in self.data.stretches:
            step = 1.0 / (2.0 * (end - begin) * self.data.interval)
            count = min(end - begin, math.floor(max(self.data.bands) / step) + 1)
            found.append(np.asarray(np.arange(count) * step, np.float64))
        return found

    @cached_property
    def frequency_of(self) -> Array:
        """Frequency of a row of one channel, Hz, (width,)."""
        return np.concatenate(self._frequencies)

    @cached_property
    def stretch_of(self) -> NDArray[np.intp]:
        """Which stretch a row of one channel belongs to, (width,)."""
        return np.repeat(np.arange(len(self._frequencies)), [len(f) for f in self._frequencies])

    @cached_property
    def reference(self) -> Motion:
        return self.moved(())

    def moved(self, terms: Sequence[Term]) -> Motion:
        """The true motion, once what is wrong with the reference is taken off what it shows."""
        key = reference_key(terms)
        if key not in self._moved:
            if len(self._moved) > REMEMBERED:
                self._moved.clear()
            motion = self._read([t for t in terms if turns(t)])
            for term in (t for t in terms if t.effect.stage == "reference"):
                motion = term.effect.motion(motion, term.at)
            self._moved[key] = motion
        return self._moved[key]

    def _read(self, terms: Sequence[Term]) -> Motion:
        data = self.data
        rate, turning, force, up, angle = data.rate, data.turning, data.force, data.up, np.zeros(len(data.time))
        if data.shown is not None:
            angle, about, faster = true_motion(data.shown, terms)
            rate, turning = np.zeros_like(rate), np.zeros_like(rate)
            rate[data.axis], turning[data.axis] = about, faster
            up = spun_up(data, angle)
            force = spun_force(data, up, Shown(angle, about, faster))
        count = len(data.time)
        outward, tangent = (np.repeat(one[:, None], count, axis=1) for one in (data.outward, tangent_of(data)))
        return Motion(
            grid=self.grid, place=self.experiment, force=force, rate=rate, turning=turning, up=up, gravity=data.gravity,
            temperature=filled("temperature", data.temperature), supply=filled("supply", data.supply),
            elapsed=data.time - float(data.time[0]), angle=angle, motor=np.zeros(count), outward=outward,
            tangent=tangent,
        )  # fmt: skip

    def raw(self, local: Local, terms: Sequence[Term], only: NDArray[np.intp] | None = None) -> Array:
        """Predicted outputs of every channel (or of some), (c, n)."""
        terms = self.here(terms)
        channels = self.channels
        if only is not None:
            channels, local = channels.only(only), local.only(only)
        own = [term for term in terms if term.effect.stage != "reference"]  # those are in the motion already
        return np.asarray(volts(self.moved(terms), channels, local, own, memory=self._memory), np.float64)

    def lines(self, values: Array) -> Array:
        """Cosine lines of signals (k, n) within the bands, stretch after stretch, (k, width)."""
        from scipy.fft import dct

        found = np.empty((len(values), self.width))
        for stretches, rows in self._equally_long:
            together = np.stack([values[:, begin:end] for begin, end in stretches], axis=1)
            lines = dct(together, type=2, norm="ortho", axis=-1)[..., : rows.shape[1]]
            found[:, rows] = lines
        return found

    @cached_property
    def _equally_long(self) -> list[tuple[list[tuple[int, int]], NDArray[np.intp]]]:
        """Stretches of one length, which are transformed at once, and the rows of each, (stretches, lines)."""
        alike: dict[int, list[int]] = {}
        for k, length in enumerate(self._lengths):
            alike.setdefault(int(length), []).append(k)
        return [
            ([self.data.stretches[k] for k in some], np.array([np.flatnonzero(self.stretch_of == k) for k in some]))
            for some in alike.values()
        ]

    @cached_property
    def _inside(self) -> Mask:
        """Rows within each channel's band that say something, (c, width)."""
        band = np.where(self.channels.rates, *self.data.bands)
        inside = np.asarray(self.frequency_of <= band[:, None])
        for row, here, _, says in self._gapped:
            inside[row, here] &= says
        return inside

    def counting(self, values: Array) -> Array:
        """Signals of all channels (c, n), zero where they do not count."""
        return values if self.data.kept is None else np.asarray(values * self.data.kept)

    @cached_property
    def _gapped(self) -> list[tuple[int, slice, Array, Mask]]:
        """For a channel in a stretch with instants that do not count: its rows, the matrix that makes its lines
        independent again, (k, k), and which of them say something, (k,).
        """
        found: list[tuple[int, slice, Array, Mask]] = []
        if self.data.kept is None:
            return found
        ends = np.cumsum([len(f) for f in self._frequencies]).tolist()
        for (begin, end), last, f in zip(self.data.stretches, ends, self._frequencies, strict=True):
            here = slice(last - len(f), last)
            for row in range(len(self.channels.names)):
                kept = self.data.kept[row, begin:end]
                if not kept.all():
                    found.append((row, here, *whitening(kept, self.variance[row, here])))
        return found

    @cached_property
    def variance(self) -> Array:
        """Of every channel's lines, V², (c, width): of known noise, else the smooth density of the incoherent part."""
        return np.array([found[0] if found is not None else self._by_known(c) for c, found in enumerate(self._noises)])

    def known(self, row: int) -> DeviceNoise | None:
        """Noise of a channel that is known whatever the model."""
        return self.data.noise[row] if self.data.noise else None

    def _by_known(self, row: int) -> Array:
        """Variance of the lines of a channel by its own noise and what the reference's adds, (width,).

        Of a mean: what it would be alone; `whitened` ties the means of all stretches together.
        """
        known = self.known(row)
        assert known is not None
        found, means = [], np.diag(self._covariance(row, known.model))
        for k, f in enumerate(self._frequencies):
            at = np.maximum(f, 0.5 / (self._lengths[k] * self.data.interval))
            both = known.model.density(at) + self._of_reference(row, k, at)
            lines = both / (2.0 * self.data.interval) + self._of_code(row, k)
            lines[f == 0.0] = means[k] * self._lengths[k]
            found.append(lines)
        return np.concatenate(found)

    @cached_property
    def _lengths(self) -> NDArray[np.intp]:
        """Instants of every stretch."""
        return np.array([end - begin for begin, end in self.data.stretches])

    def _of_reference(self, row: int, stretch: int, f: Array, ends: float = 8.0) -> Array:
        """Density that the noise of the reference's angle puts into a channel's lines, (f,).

        A gyro about the axis is compared with the angle's first derivative; an accelerometer with gravity
        that goes round a level axis, and beside the axis with the rate's square and the second derivative. A derivative
        over a stretch of length T has besides the ends of the stretch in all its lines: noise of density S within a
        band B adds 8·B·S/T, half of that to the mean.
        """
        data, channels = self.data, self.channels
        here, seconds = slice(*data.stretches[stretch]), self._lengths[stretch] * data.interval
        omega, width = 2.0 * math.pi * f, WIDER * max(data.bands)
        first = omega**2 + ends * width / seconds
        second = omega**4 + ends * (2.0 * math.pi) ** 2 * width**3 / (3.0 * seconds)
        along = data.shown is not None and int(channels.axis[row]) == data.axis
        if data.density is None or data.shown is None or along != bool(channels.rates[row]):
            felt = np.zeros_like(f)
        elif along:
            felt = float(data.density[here].mean()) * first
        else:
            rate = float(np.mean(data.shown.rate[here] ** 2))
            lying = data.gravity**2 * float(np.mean(data.upright[here] == 0.0))
            felt = float(data.density[here].mean()) * (lying + data.radius**2 * (second + 4.0 * rate * first))
        return np.asarray(channels.sensitivity[row] ** 2 * (felt + self._of_jitter(row, here)))

    def _of_jitter(self, row: int, here: slice) -> float:
        """Density that uncertain time stamps put into a channel's lines: slope times jitter, white at every sample."""
        data = self.data
        if not data.jitter:
            return 0.0
        axis = int(self.channels.axis[row])
        slope = (
            data.turning[axis, here] if self.channels.rates[row] else np.gradient(data.force[axis, here], data.interval)
        )
        return float(np.mean(slope**2)) * data.jitter**2 * 2.0 * data.sampled

    def _codes(self, row: int) -> Iterator[Array]:
        """What an accelerometer would show more in each rest on a code, if the angle were a standard uncertainty more,
        (n,): gravity goes round with a level axis.
        """
        data = self.data
        if data.coarse is None or data.shown is None or self.channels.rates[row] or data.upright.all():
            return
        axis, half = int(self.channels.axis[row]), 1e-4  # rad
        ahead, behind = (spun_up(data, data.shown.angle + way * half)[axis] for way in (1.0, -1.0))
        more = self.channels.sensitivity[row] * data.gravity * (ahead - behind) / (2.0 * half) * data.coarse
        stands = data.coarse > 0.5 * float(data.coarse.max())  # low-passed, with ends that ring
        edges = np.flatnonzero(np.diff(np.concatenate([[False], stands, [False]]).astype(np.int8)))
        for begin, end in zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True):
            yield np.where((np.arange(len(more)) >= begin) & (np.arange(len(more)) < end), more, 0.0)

    def _of_code(self, row: int, stretch: int) -> Array:
        """Variance that rests on a code put into the lines of a stretch, V², (lines,)."""
        here, count = slice(*self.data.stretches[stretch]), len(self._frequencies[stretch])
        return np.asarray(sum((_cosines(one[here])[:count] ** 2 for one in self._codes(row)), np.zeros(count)))

    def _covariance(self, row: int, model: NoiseModel) -> Array:
        """Of a channel's means over all stretches, (s, s); files are taken to lie far apart in time."""
        data = self.data
        begin = np.array([data.time[b] for b, _ in data.stretches]) - 0.5 * data.interval
        end = np.array([data.time[e - 1] for _, e in data.stretches]) + 0.5 * data.interval
        back = np.concatenate([[0.0], np.maximum(end[:-1] - begin[1:], 0.0)])
        later = np.cumsum(np.where(back > 0.0, back + APART, 0.0)) - begin[0]
        of_reference = [float(self._of_reference(row, k, np.zeros(1), 4.0)[0]) for k in range(len(begin))]
        found = model.covariance(begin + later, end + later) + np.diag(np.array(of_reference) / (2.0 * (end - begin)))
        for one in self._codes(row):
            means = np.array([one[b:e].mean() for b, e in data.stretches])
            found = found + np.outer(means, means)
        return found

    @cached_property
    def _means(self) -> dict[int, tuple[NDArray[np.intp], Array]]:
        """For channels with known noise the rows of the stretches' means, and the inverse Cholesky factor of their
        correlations, those held out last.
        """
        found = {}
        of_means = np.flatnonzero(self.frequency_of == 0.0)
        for row in range(len(self.channels.names)):
            if (known := self.known(row)) is not None:
                says = np.flatnonzero(self._inside[row, of_means])
                covariance = self._covariance(row, known.model)[np.ix_(says, says)]
                scale = np.sqrt(np.diag(covariance))
                found[row] = of_means[says], unmixed(covariance, self.data.held[says]) * scale
        return found

    @cached_property
    def _noises(self) -> list[tuple[Array, Array] | None]:
        """Incoherent part of every channel whose noise is not known otherwise, and the freedom it left."""
        lines = self.lines(self.counting(self.data.observed))
        return [None if self.known(c) is not None else self._incoherent(lines[c], c) for c in range(len(lines))]

    def _incoherent(self, target: Array, row: int) -> tuple[Array, Array]:
        """Variance of the lines of one channel that no linear filter of the reference explains, and the freedom that
        the filter left to each line; both (width,).
        """
        f, of_rate = self.frequency_of, bool(self.channels.rates[row])
        here = (f <= self.data.bands[0 if of_rate else 1]) & (f > 0.0)
        kept = None if self.data.kept is None or self.data.kept[row].all() else self.data.kept[row]
        filters = self._filters(of_rate) if kept is None else self._gapped_filters(of_rate, kept)
        share = np.ones(len(f)) if kept is None else self._share(kept)
        here &= share > 0.0
        if not len(filters) or not here.any():
            what = "no line within the compared band" if len(filters) else "no motion"
            raise BadInput(f"{self.name}: found {what}, wanted a case that moves, in a record that is long enough")
        freedom = np.zeros(len(f))
        weight = 1.0 / np.sqrt(share[here])
        density, freedom[here] = incoherent(f[here], target[here] * weight, (filters[:, here] * weight).T)
        found = np.interp(f, *by_rising(f[here], density))
        return np.asarray(np.where(f > 0.0, found, found.max())), freedom

    def _share(self, kept: Mask) -> Array:
        """Share of the instants of every row's stretch that count, (width,)."""
        return np.array([kept[begin:end].mean() for begin, end in self.data.stretches])[self.stretch_of]

    @cached_property
    def _rates_filters(self) -> Array:
        return self._derivatives(self._filtered(True))

    @cached_property
    def _force_filters(self) -> Array:
        return self._derivatives(self._filtered(False))

    def _filters(self, of_rate: bool) -> Array:
        return self._rates_filters if of_rate else self._force_filters

    def _gapped_filters(self, of_rate: bool, kept: Mask) -> Array:
        """The same of what counts of them; a zero output with gaps has lines of all frequencies."""
        level = self.lines(kept[None].astype(np.float64))
        return np.concatenate([level / np.linalg.norm(level), self._derivatives(self._filtered(of_rate), kept)])

    def _filtered(self, of_rate: bool) -> Array:
        """What a filter of the motion may follow, (k, n)."""
        motion = self.reference
        if of_rate:
            return _varying(motion.rate)
        spins = [motion.rate[i] * motion.rate[j] for i in range(3) for j in range(i, 3)]
        return _varying(np.stack([*motion.force, *motion.turning, *spins]))

    def _derivatives(self, signals: Array, kept: Mask | None = None) -> Array:
        """Lines of signals and of their derivatives where they count, each scaled to one, (k, width)."""
        scale = 2.0 * math.pi * max(self.data.bands)
        found = []
        for order in range(DERIVATIVES):
            moved = np.asarray(self.grid.observed(signals, partial(_power, order=order, scale=scale)), np.float64)
            lines = self.lines(moved if kept is None else moved * kept)
            found.append(lines / np.linalg.norm(lines, axis=1, keepdims=True))
        return np.concatenate(found)

    def whitened(self, raw: NDArray[np.inexact]) -> Array:
        signals = self.counting(np.asarray(raw, np.float64))
        found = np.zeros((len(signals), self.width))
        some = np.flatnonzero(signals.any(axis=1))  # most effects change some channels and leave the others alone
        for row, lines in zip(some.tolist(), self.lines(signals[some]), strict=True):
            found[row] = self._whitened(row, lines[None])[0]
        return found.reshape(-1)

    def _whitened(self, row: int, lines: Array) -> Array:
        """Rows of one channel from lines of signals of it, (k, width)."""
        found = lines / np.sqrt(self.variance[row])
        for gapped, here, matrix, _ in self._gapped:
            if gapped == row:
                found[:, here] = lines[:, here] @ matrix.T
        found *= self._inside[row]
        if row in self._means:
            of_means, factor = self._means[row]
            found[:, of_means] = found[:, of_means] @ factor.T
        return np.asarray(found)

    @property
    def held_out(self) -> Mask:
        return np.tile(self.data.held[self.stretch_of], len(self.row_names))

    @property
    def counted(self) -> Mask:
        return self._inside.reshape(-1)

    def domains(self) -> Mapping[str, Mask]:
        f, top = self.frequency_of, max(self.data.bands)
        bounds = [0.0, 0.1 * top, 0.4 * top, top]
        found = {"mean": f == 0.0}
        for low, high in itertools.pairwise(bounds):
            found[f"{low:.2g}–{high:.2g} Hz"] = (f > low) & (f <= high)
        return found

    def cuts(self) -> Sequence[Cut]:
        data = self.data
        begin = np.array([data.time[b] for b, _ in data.stretches])
        speed = np.array([math.sqrt(float(np.mean(np.sum(data.rate[:, b:e] ** 2, 0)))) for b, e in data.stretches])
        found = []
        for kind, values, words in (
            ("time", begin, ("early", "half-way", "late")),
            ("rate", speed, ("while slow", "at middling rates", "while fast")),
        ):
            for said, some in zip(words, np.array_split(np.argsort(values), 3), strict=True):
                mask = np.zeros(len(values), np.bool_)
                mask[some] = True
                found.append(Cut(kind, said, mask[self.stretch_of]))
        return found

    @property
    def allowance(self) -> float:
        """The density of a few lines is not known better."""
        return ALLOWANCE

    def allowance_of(self, name: str, mask: Mask) -> float:
        """As the noise is known; an incoherent part is known worse where the filter left little freedom to it."""
        row = self.row_names.index(name)
        left, known = self._noises[row], self.known(row)
        if left is None:
            assert known is not None
            if not mask.any():
                return KNOWN_ALLOWANCE
            lowest = 1.0 / (self.data.interval * len(self.data.time))
            u = known.model.u_log(np.maximum(self.frequency_of[mask], lowest))
            return math.hypot(KNOWN_ALLOWANCE, float(np.sqrt(np.mean(u**2))))
        freedom = float(left[1][mask].sum())
        return math.hypot(ALLOWANCE, math.sqrt(2.0 / max(freedom, 1.0)))

    def unevenness(self, change: Array, left: Array) -> float:
        """Of noise that is louder while the motion is: Σd²l² over instants against Σd² times the mean of l² (the
        covariance that White 1980 takes, Econometrica 48, 817), with d and l brought back to time. What is left at a
        few instants that alone show the effect says little, as it has followed them: l counts there as all the others
        would leave it (MacKinnon & White 1985, J. Econometrics 29, 305); but there is a limit to doubt.
        """
        moved, rest = self._in_time(change), self._in_time(left)
        mean = np.mean(rest**2, axis=1, keepdims=True)
        even = float(np.sum(moved**2 * mean))
        rest = rest / np.maximum(1.0 - _leverage(moved), 1.0 / LOUDEST)
        return min(max(1.0, float(np.sum(moved**2 * rest**2)) / even), LOUDEST) if even > 0.0 else 1.0

    def _in_time(self, rows: Array) -> Array:
        """Rows as signals, (c, n), each stretch from its own lines."""
        from scipy.fft import idct

        table, found, at = rows.reshape(len(self.row_names), -1), [], 0
        for (begin, end), f in zip(self.data.stretches, self._frequencies, strict=True):
            found.append(idct(table[:, at : at + len(f)], type=2, n=end - begin, norm="ortho", axis=1))
            at += len(f)
        return np.concatenate(found, axis=1)

    @property
    def to_know(self) -> str:
        if self.data.place == "free":  # what cameras add while a body moves fast is not known from its rest
            return "compare with a reference whose noise is far below the device's"
        return "record 30 s at rest, or state the density (`noise` of the device's columns in the manifest)"

    def origin(self, name: str) -> Origin:
        known = self.known(self.row_names.index(name))
        return "misfit" if known is None else known.origin

    def noise(self) -> Array:
        return np.asarray(self.variance / self.channels.sensitivity[:, None] ** 2)

    def numbers_in(self, mask: Mask) -> float:
        """A mean stands for all instants of its stretch."""
        lengths = np.array([end - begin for begin, end in self.data.stretches])
        return float(np.sum(np.where(self.frequency_of > 0.0, 1, lengths[self.stretch_of])[mask]))

    def numbers(self) -> Array:
        inside = np.concatenate([np.arange(begin, end) for begin, end in self.data.stretches])
        kept = self.data.kept
        return np.full(len(self.row_names), float(len(inside))) if kept is None else kept[:, inside].sum(1, np.float64)

    def changes(self) -> Iterator[tuple[str, str, Array]]:
        """Of every channel's answer to each axis of the motion what a step of it does at many instants, and a trend.

        A step of unknown time takes one parameter where a gain of its own in every stretch takes many, so that weaker
        ones show; what creeps looks like a step half-way, and more like a trend.
        """
        motion, channels = self.reference, self.channels
        for row, name in enumerate(channels.names):
            along = motion.rate if channels.rates[row] else motion.force
            for axis in range(3):
                answer = along[axis] * channels.sensitivity[row]
                moving = self._throughout(answer)[self.stretch_of] & (self.frequency_of > 0.0)  # a zero is no gain
                columns = self._changed(row, answer, moving)
                own = axis == int(channels.axis[row])
                words = "gain" if own else f"answer to axis {'xyz'[axis]}"
                always = columns[:, 0]
                if (size := float(np.linalg.norm(always))) > TELLS:
                    columns -= np.outer(always, always @ columns) / size**2  # what is always there is no change
                    yield name, f"its {words} in the course of time", columns[:, 1:-1]
                    yield name, "a trend" if own else f"a trend of its {words}", columns[:, -1:]

    def _changed(self, row: int, answer: Array, where: Mask) -> Array:
        """An answer (n,) of a channel, begun at each of some instants, and with a trend: all rows, nothing of it but
        `where` (width,), (rows, k); first that at all instants.
        """
        kept = answer if self.data.kept is None else answer * self.data.kept[row]
        always, trend = self.lines(np.array([kept, kept * np.linspace(0.0, 1.0, len(kept))]))
        lines = np.array([always, *(self._begun(kept, always, first) for first in self._steps), trend])
        found = np.zeros((len(self.channels.names), self.width, len(lines)))
        found[row] = (self._whitened(row, lines) * where).T
        return found.reshape(self.rows, -1)

    @cached_property
    def _steps(self) -> list[int]:
        """Instants spread over all stretches."""
        inside = np.concatenate([np.arange(begin, end) for begin, end in self.data.stretches])
        return [int(inside[one]) for one in np.linspace(0, len(inside) - 1, STEPS + 2)[1:-1].astype(np.intp)]

    def _begun(self, values: Array, always: Array, first: int) -> Array:
        """Lines of a signal (n,) from an instant on, (width,): in all stretches but one they are known or nought."""
        from scipy.fft import dct

        begins, ends = np.array(self.data.stretches).T
        found = np.where(begins[self.stretch_of] >= first, always, 0.0)
        for k in np.flatnonzero((begins < first) & (first < ends)).tolist():
            rest = values[begins[k] : ends[k]] * (np.arange(begins[k], ends[k]) >= first)
            found[self.stretch_of == k] = dct(rest, type=2, norm="ortho")[: len(self._frequencies[k])]
        return found

    def _throughout(self, own: Array) -> Mask:
        """Stretches that move most of the time: where motion begins, what the reference smooths looks like a gain."""
        usual = STANDS * float(np.sqrt(np.mean(own**2)))
        return np.array([np.median(np.abs(own[first:last])) > usual for first, last in self.data.stretches])

    def shapes(self, component: str) -> Mapping[str, Array]:
        """The motion along each axis, its rate of change, that of the other axes, and squares, each scaled to one."""
        motion, c = self.reference, self.channels
        own = np.where(c.rates[:, None], motion.rate[c.axis], motion.force[c.axis])
        laws = {
            "in proportion to the motion": own,
            "in proportion to its rate of change, as of something late": self.grid.rise(own),
            "in proportion to the turning of the case": self.grid.plain(motion.turning[(c.axis + 1) % 3]),
            "as the square of the rate": np.repeat(np.sum(motion.rate**2, axis=0)[None], len(c.names), axis=0),
        }  # fmt: skip
        for step in (1, 2):
            other = (c.axis + step) % 3
            laws[f"in proportion to the {'next' if step == 1 else 'previous'} axis"] = np.where(
                c.rates[:, None], motion.rate[other], motion.force[other]
            )
        found = {words: self.lines(np.asarray(values, np.float64)) for words, values in laws.items()}
        return {words: lines for words, lines in found.items() if np.any(lines[:, self.frequency_of > 0.0])}


def _power(frequency: Array, *, order: int, scale: float) -> Complexes:
    return np.asarray((2j * math.pi * frequency / scale) ** order)


def _varying(signals: Array) -> Array:
    """Signals that are not constant."""
    return np.asarray(signals[np.ptp(signals, axis=1) > 1e-9 * (1.0 + np.abs(signals).max())])


def _leverage(moved: Array) -> Array:
    """Share of a change (c, n) that each instant and those near it have, (n,)."""
    power = np.sum(moved**2, axis=0)
    near = np.convolve(power, np.ones(NEAR), mode="same") if len(power) > NEAR else power
    return np.asarray(near / max(float(power.sum()), 1e-300))
