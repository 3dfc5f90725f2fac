"""Means of a record over intervals at rest, and how noisy they are: what poses and tumbles, own or imported, become.

How noisy a mean is comes from the record's own parts at rest: their spectrum, white noise and flicker fitted to it, and
the covariance that this gives means of such length at such times, about the mean of all of them (the zero output takes
that up). Nothing is taken to be white.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.model import Channels
from rig.motion import Array
from rig.parts.pose_records import PoseRecords
from rig.parts.poses import PARAMETERS
from rig.signals.blocks import THIRD, spread
from rig.signals.noise_at_rest import noises_at_rest

if TYPE_CHECKING:  # readers of other people's files are not loaded for the rig's own
    from rig.foreign.manifest import Signed

ROOM_FOR_FIT = 4  # poses beside the parameters, so that a fit to the rest means something
REPEATED = 0.002  # rad: poses closer than this are one pose, taken twice
FEWEST = 3  # pairs of them from which their scatter is known

Pair = tuple[int, int]


@dataclass(frozen=True)
class Interval:
    """Rows [first, last) of a table: at rest, or one turn by a known `angle` (vector, rad) with its uncertainty."""

    first: int
    last: int
    angle: tuple[float, float, float] = (0.0, 0.0, 0.0)
    u_angle: float = 0.0
    held: bool = False
    rest: bool = False  # of a pose whose beginning is another interval
    up: Signed | None = None
    label: str = ""

    @property
    def words(self) -> str:
        """What it is called."""
        return self.label or f"rows {self.first} to {self.last - 1}"

    @property
    def turns(self) -> bool:
        """Whether it is a turn."""
        return any(self.angle)


def beginning(one: Interval) -> int:
    """What intervals are sorted by."""
    return one.first


def marked(one: Interval, held: bool) -> Interval:
    """An interval that is held out or is not."""
    return replace(one, held=held)


def held_out(intervals: Sequence[Interval], share: float, *, ordered: bool = False) -> tuple[list[Interval], str]:
    """What a model is judged by: poses from all over the record, as many as the `share`, or every third if the rest
    were too few or they come in an `ordered` sequence of faces; else the end of every pose. Turns that were made
    several times are shared out likewise.
    """
    poses = sorted((one for one in intervals if not one.turns), key=beginning)
    turns = sorted((one for one in intervals if one.turns), key=beginning)
    needed, count = PARAMETERS + ROOM_FOR_FIT, len(poses)
    for part in (THIRD,) if ordered else (share, THIRD):
        out = spread([""] * count, part)
        held = int(np.count_nonzero(out))
        if count - held >= needed:
            made = [*zip(poses, out, strict=True), *zip(turns, spread([one.angle for one in turns], part), strict=True)]
            said = (
                f"held out: {held} of {count} poses, from all over the record, and as many of turns made several times"
            )
            return [marked(one, bool(mark)) for one, mark in made], said
    pieces = [piece for one in poses for piece in _cut(one, share)]
    said = (
        f"held out: the last {share:.0%} of the time of each pose, because none of {count} can be spared; "
        "that judges noise and drift, not another attitude"
    )
    return [*pieces, *turns], said


def signed(axis: Signed | None) -> Array:
    """Unit vector of an axis of the case such as "-x", (3,); not a number where nobody says."""
    if axis is None:
        return np.full(3, math.nan)
    return np.asarray((-1.0 if axis[0] == "-" else 1.0) * np.eye(3)["xyz".index(axis[1])], np.float64)


def _cut(one: Interval, share: float) -> list[Interval]:
    middle = one.last - round(share * (one.last - one.first))
    return [replace(one, last=middle), replace(one, first=middle, held=True, rest=True)]


@dataclass(frozen=True)
class Whole:
    """A record with parts at rest: `numbers` of the channels (c, n) V at `time` (n,) s, `rate` of them in a part, Hz,
    and `conditions` by name (n,). `where` it is, for who reads what is wrong with it.

    `together`: between two poses nothing happened but what its noise does. Nobody knows that of data from elsewhere,
    with hands and pauses in between; there every mean has the whole wander by itself.
    """

    where: str
    run: str
    channels: Channels
    numbers: Array
    time: Array
    rate: float
    conditions: Mapping[str, Array]
    zero: Array | None = None  # (c,): zero outputs where a fit begins, V
    together: bool = False

    def posed(
        self, name: str, intervals: Sequence[Interval], gravity: tuple[float, float], notes: Sequence[str]
    ) -> PoseRecords:
        """Means over the intervals and how noisy they are; local gravity with its uncertainty, m/s².

        Raises BadInput for a channel that shows one number throughout.
        """
        channels = self.channels
        rows = [slice(one.first, one.last) for one in intervals]
        observed = np.array([[mean_of(channel[here]) for here in rows] for channel in self.numbers])
        begin = np.array([self.time[one.first] for one in intervals])
        seconds = np.array([(one.last - one.first) / self.rate for one in intervals])
        covariance = self._covariance(_uncut(intervals), begin, seconds)
        variance = _about_the_mean(covariance)
        still = np.array([not one.turns and not one.rest for one in intervals])
        floor, said = _floor(
            channels, observed if self.zero is None else observed - self.zero[:, None], variance, still
        )
        conditions = {k: np.array([mean_of(v[here]) for here in rows]) for k, v in self.conditions.items()}
        gyros = ["Earth's rate is left in the zeros of the gyros"] if len(channels.of("rate")) else []
        return PoseRecords(
            name=name, run=self.run, channels=channels, observed=observed,
            variance=variance + floor,
            covariance=covariance + floor[:, :, None] * np.eye(len(begin)) if self.together else None,
            turn=np.array([one.angle for one in intervals]).T,
            u_turn=np.array([one.u_angle for one in intervals]), seconds=seconds, time=begin + 0.5 * seconds,
            held=np.array([one.held for one in intervals]), gravity=gravity[0], u_gravity=gravity[1],
            zero=self.zero, up=np.stack([signed(one.up) for one in intervals], axis=1),
            notes=(*notes, said, *gyros) if said else (*notes, *gyros),
            temperature=conditions["temperature"], supply=conditions["supply"],
        )  # fmt: skip

    def _covariance(self, rest: Sequence[slice], begin: Array, seconds: Array) -> Array:
        """Of the means of all intervals, from the parts at rest, (c, intervals, intervals)."""
        _refuse_dead(self.where, self.channels, [self.numbers[:, part] for part in rest])
        covariance = np.zeros((len(self.numbers), len(begin), len(begin)))
        since = begin - float(begin.min())
        for here in (one for one in (self.channels.of("acceleration"), self.channels.of("rate")) if len(one)):
            models = noises_at_rest([_told([self.numbers[c][part] for part in rest]) for c in here], self.rate)
            for c, model in zip(here, models, strict=True):
                covariance[c] = model.covariance(since, since + seconds)
        return covariance


def _told(parts: Sequence[Array]) -> list[Array]:
    """Those with a number."""
    return [one for one in parts if np.isfinite(one).any()]


def _refuse_dead(where: str, channels: Channels, parts: Sequence[Array]) -> None:
    """A channel that shows one and the same number throughout has no noise to weigh it with. Raises BadInput."""
    for c, name in enumerate(channels.names):
        seen = np.concatenate([part[c][np.isfinite(part[c])] for part in parts])
        if not len(seen) or not np.ptp(seen) > 0.0:
            what = "no number at rest" if not len(seen) else f"nothing but {seen[0]:g} at rest"
            raise BadInput(f"{where}, {name}: found {what}, wanted a sensor's readings")


def mean_of(values: Array) -> float:
    """Of those that are numbers; NaN where none is."""
    there = values[np.isfinite(values)]
    return float(there.mean()) if len(there) else math.nan


def _uncut(intervals: Sequence[Interval]) -> list[slice]:
    """Rows at rest, those of a pose that was cut together: how noise wanders is seen best over all of it."""
    found: list[slice] = []
    for one in intervals:
        if one.rest and found and found[-1].stop == one.first:
            found[-1] = slice(found[-1].start, one.last)
        elif not one.turns:
            found.append(slice(one.first, one.last))
    return found


def _about_the_mean(covariance: Array) -> Array:
    """Variance of the mean of every interval about the mean of all, unit² of the values, (c, n)."""
    count = covariance.shape[-1]
    centred = np.eye(count) - 1.0 / count
    return np.asarray(np.einsum("ij,cjk,ik->ci", centred, covariance, centred))


def _floor(channels: Channels, observed: Array, variance: Array, still: NDArray[np.bool_]) -> tuple[Array, str]:
    """Variance that poses taken twice show beyond their noise, (c, 1), and what is to be said of it."""
    triad = channels.of("acceleration")
    floor = np.zeros((len(channels.names), 1))
    if len(triad) != 3:
        return floor, ""
    force = (observed / channels.sensitivity[:, None])[triad][:, still]
    size = np.linalg.norm(force, axis=0)
    pairs = _pairs(force / size)
    if len(pairs) < FEWEST:
        return floor, "hardly a pose is repeated: how well it comes back is not known"
    noise = np.sum((variance / channels.sensitivity[:, None] ** 2)[triad][:, still] * (force / size) ** 2, axis=0)
    beyond = [0.5 * (size[i] - size[k]) ** 2 - 0.5 * (noise[i] + noise[k]) for i, k in pairs]
    square = max(float(np.mean(beyond)), 0.0)
    floor[triad] = square * channels.sensitivity[triad][:, None] ** 2
    return floor, f"{len(pairs)} pairs of poses agree to {math.sqrt(square):.2g} m/s² beyond their noise"


def _pairs(direction: Array) -> list[Pair]:
    """Poses that follow each other at any distance in the same attitude, each of them once."""
    found: list[Pair] = []
    taken: set[int] = set()
    near = direction.T @ direction > math.cos(REPEATED)
    for i, k in zip(*np.nonzero(np.triu(near, 1)), strict=True):
        if not {int(i), int(k)} & taken:
            taken |= {int(i), int(k)}
            found.append((int(i), int(k)))
    return found
