"""Where an accelerometer stood still, found in its record: one still pose after another, with the mean of each.

The spread in a sliding window (variance of the three axes, summed) is small at rest and large in motion (Tedaldi,
Pretto & Menegatti 2014, section IV). It is compared with a multiple of the spread in the quietest stretch. The
multiple is not set by taste: over a range of them the number of still poses does not change, and the middle of the
longest such range is taken.

With a gyro as well, its deviation from its reading in that quietest stretch must be small too: a turn at constant speed
about the vertical leaves the accelerometer still.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

Array = NDArray[np.float64]
WINDOW = 0.5
"""Sliding window, s."""
QUIET = 4.0
"""Length of the quietest stretch, s."""
MOVING = 30.0
"""A spread this many times the quiet one is surely motion."""
APART = math.radians(5.0)
"""Poses closer than this are one and the same."""
BLOCKS = 10
"""Blocks whose means tell the uncertainty of the mean."""


@dataclass(frozen=True)
class StillPose:
    """One stretch at rest: samples `first` to `last`, both included.

    `mean` and its standard uncertainty `u_mean` are in the record's own unit, (3,); slow noise is in the uncertainty,
    because it is taken from the means of blocks. `place`: number of the pose among those more than 5 degrees apart;
    `distinct`: no earlier stretch has this place. `multiple`: threshold used, in multiples of the quiet spread.
    """

    first: int
    last: int
    mean: Array
    u_mean: Array
    place: int
    distinct: bool
    multiple: float


def still_poses(
    acceleration: Array, rate: float, *, gyro: Array | None = None, shortest: float = 1.0
) -> tuple[StillPose, ...]:
    """Stretches at rest of at least `shortest` s, in a record (n, 3) in any unit, sampled at `rate` (Hz).

    `gyro`: a record of the same length, in any unit. Raises BadInput for other shapes, numbers that are missing, a
    record too short, and if nothing stands still.
    """
    _checked(acceleration, rate, gyro)
    width = max(5, round(WINDOW * rate))
    spread = _spread(acceleration, width)
    quiet = _quietest(spread, max(width, round(QUIET * rate)))
    if float(spread[quiet].mean()) == 0.0:
        raise BadInput("still poses: found a stretch without any noise, wanted a record that is not filled up")
    ratio = spread / float(spread[quiet].mean())
    if gyro is not None:
        ratio = np.maximum(ratio, _turning(gyro, quiet, width))
    multiple = _multiple(ratio, round(shortest * rate))
    stretches = _stretches(ratio < multiple, round(shortest * rate))
    if not stretches:
        raise BadInput(f"still poses: found none of {shortest:g} s or longer, wanted at least one")
    return _poses(acceleration, stretches, multiple)


def _checked(acceleration: Array, rate: float, gyro: Array | None) -> None:
    for name, record in (("acceleration", acceleration), ("gyro", gyro)):
        if record is None:
            continue
        if record.shape != (len(acceleration), 3):
            raise BadInput(f"still poses: found {name} of shape {record.shape}, wanted ({len(acceleration)}, 3)")
        if not np.isfinite(record).all():
            raise BadInput(f"still poses: found {name} with missing numbers, wanted a record without gaps")
    if len(acceleration) < 2 * QUIET * rate:
        raise BadInput(f"still poses: found {len(acceleration) / rate:.3g} s, wanted {2 * QUIET:g} s or more")


def _sliding(values: Array, width: int) -> Array:
    """Mean of `width` samples around each of them, over the first axis; at the ends that of the last full window."""
    sums = np.cumsum(np.concatenate([np.zeros((1, *values.shape[1:])), values]), axis=0)
    means = (sums[width:] - sums[:-width]) / width
    before = (width - 1) // 2
    return np.concatenate([means[:1].repeat(before, 0), means, means[-1:].repeat(width - 1 - before, 0)])


def _spread(record: Array, width: int) -> Array:
    """Variance in the sliding window, summed over the axes, (n,)."""
    levelled = record - np.median(record, axis=0)
    variance = _sliding(levelled**2, width) - _sliding(levelled, width) ** 2
    return np.asarray(np.maximum(variance, 0.0).sum(axis=1), np.float64)


def _quietest(spread: Array, length: int) -> slice:
    """The stretch of this length with the least spread."""
    sums = np.cumsum(np.concatenate([[0.0], spread]))
    first = int(np.argmin(sums[length:] - sums[:-length]))
    return slice(first, first + length)


def _turning(gyro: Array, quiet: slice, width: int) -> Array:
    """Mean square deviation of the gyro from its reading at rest, as a multiple of that at rest, (n,)."""
    square = _sliding((gyro - gyro[quiet].mean(axis=0)) ** 2, width).sum(axis=1)
    return np.asarray(square / max(float(square[quiet].mean()), np.finfo(float).tiny), np.float64)


def _multiple(ratio: Array, shortest: int) -> float:
    """Middle of the longest range of thresholds that find the same number of stretches."""
    moving = ratio[ratio > MOVING]
    if not len(moving):
        return MOVING
    multiples = np.geomspace(2.0, max(float(np.median(moving)), 2.0 * MOVING), 60)
    counts = np.array([len(_stretches(ratio < one, shortest)) for one in multiples])
    edges = np.flatnonzero(np.diff(counts, prepend=-1, append=-1))
    lengths = np.where(counts[edges[:-1]] > 0, np.diff(edges), 0)
    best = int(np.argmax(lengths))
    return float(math.sqrt(multiples[edges[best]] * multiples[edges[best + 1] - 1]))


def _stretches(still: NDArray[np.bool_], shortest: int) -> list[tuple[int, int]]:
    """First and last sample of every run that is long enough."""
    steps = np.diff(still.astype(np.int8), prepend=0, append=0)
    firsts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    both = zip(firsts.tolist(), ends.tolist(), strict=True)
    return [(first, end - 1) for first, end in both if end - first >= max(shortest, 2 * BLOCKS)]


def _poses(record: Array, stretches: list[tuple[int, int]], multiple: float) -> tuple[StillPose, ...]:
    means = np.array([record[first : last + 1].mean(axis=0) for first, last in stretches])
    places = _places(means)
    return tuple(
        StillPose(
            first=first,
            last=last,
            mean=means[number],
            u_mean=u_mean(record[first : last + 1]),
            place=places[number],
            distinct=places[number] not in places[:number],
            multiple=multiple,
        )
        for number, (first, last) in enumerate(stretches)
    )


def u_mean(record: Array) -> Array:
    """Standard uncertainty of the mean of a record (n, 3) whose noise may be slow, (3,).

    The larger of s/√n, as for white noise, and that of the means of ten blocks (Flyvbjerg & Petersen 1989).
    """
    count = len(record)
    white = record.std(axis=0, ddof=1) / math.sqrt(count)
    length = count // BLOCKS
    blocks = record[: BLOCKS * length].reshape(BLOCKS, length, -1).mean(axis=1)
    return np.asarray(np.maximum(white, blocks.std(axis=0, ddof=1) / math.sqrt(BLOCKS)), np.float64)


def _places(means: Array) -> list[int]:
    """Number of the place of every mean: the first one within 5 degrees, or a new one."""
    radius = _radius(means)
    seen: list[Array] = []
    places = []
    for mean in means:
        chords = [float(np.linalg.norm(mean - other)) / (2.0 * radius) for other in seen]
        near = [number for number, chord in enumerate(chords) if 2.0 * math.asin(min(chord, 1.0)) <= APART]
        places.append(near[0] if near else len(seen))
        if not near:
            seen.append(mean)
    return places


def _radius(means: Array) -> float:
    """Length of gravity in the record's unit: of the sphere through the means, which may be far from zero (counts).

    Where they are too few for a sphere, or all on one circle, the median length.
    """
    plain = max(float(np.median(np.linalg.norm(means, axis=1))), np.finfo(float).tiny)
    middle = means.mean(axis=0)
    around = means - middle
    if len(means) < 6 or float(np.linalg.svd(around, compute_uv=False)[-1]) < 0.05 * float(np.linalg.norm(around)):
        return plain
    terms = np.column_stack([2.0 * around, np.ones(len(around))])
    centre = np.linalg.lstsq(terms, (around**2).sum(axis=1), rcond=None)[0]
    return math.sqrt(max(float(centre[3] + centre[:3] @ centre[:3]), 0.0)) or plain
