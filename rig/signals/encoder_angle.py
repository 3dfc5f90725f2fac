"""Angle, rate and angular acceleration on an even grid, from an encoder's angle as it was logged or from its lines.

A logged angle comes in steps (0.088° is a 12-bit encoder), wraps at a full turn, and its time stamps stand still, jump
or are missing. Rows whose stamp does not increase are dropped and counted in the notes; nothing else is changed. The
angle is unwrapped to less than half a turn between rows, smoothed (`smoother`), and stated with its uncertainty.

Sampled outputs A, B and index (volts) are counted state by state, four to a line, in both directions, so the platter
may stop and turn back. The index ties the angle to the disk: the middle of its first pulse is angle zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.signals.encoder import Directions, Pulses, Trigger, middles
from rig.signals.smoother import Curve, smooth, trusted

Array = NDArray[np.float64]
TURN = 2.0 * math.pi
TOGETHER = 0.02
"""Share of edges of A and B within one sample above which the states cannot be counted one by one."""
NEARBY = 1.0
"""On either side of an instant, s: readings that say how noisy the angle is there."""
SAME = 1e-9
"""rad: what a full turn more or less leaves of equal readings."""
CLEAR = 10.0
"""Times the noise, in power."""
MUCH = 0.01
"""Of the rate's variance."""
SURE = 5.0
"""Standard deviations at which scatter that grows with the rate is no chance."""
STANDING = 0.1
"""Without an edge for longer than this the platter stands or creeps, s."""


@dataclass(frozen=True)
class AngleTrack:
    """Encoder motion on an even grid, all shape (n,).

    `time` s on the log's own clock, every `interval` s; `angle` rad (unwrapped), `rate` rad/s, `acceleration` rad/s²,
    each with its standard uncertainty `u_…` in the same unit; `good` is False in long gaps and near ends. `bandwidth`
    Hz: motion and noise are equal there, and nothing above it is to be trusted; `kept` Hz: to there the smoother keeps
    99 %. `clear` Hz: to there the motion stands ten times above the noise (in power). `density` rad²/Hz: that of the
    angle's noise about each instant. `coarse` rad: standard uncertainty that all readings about an instant have in
    common where the platter stands on one code, 0 elsewhere. `jitter` s: standard deviation of the time stamps, as far
    as readings scatter more while the platter is fast; 0 where they do not. `dropped`: rows whose time stamp did not
    increase. `notes`: what a reader must know, in sentences.
    """

    time: Array
    interval: float
    angle: Array
    rate: Array
    acceleration: Array
    u_angle: Array
    u_rate: Array
    u_acceleration: Array
    good: NDArray[np.bool_]
    bandwidth: float
    kept: float
    clear: float
    density: Array
    coarse: Array
    jitter: float
    dropped: int
    notes: tuple[str, ...]


def encoder_track(
    time: Array,
    angle: Array,
    *,
    interval: float | None = None,
    u_angle: float = 0.0,
    u_time: float = 0.0,
    keep: float | None = None,
    longest: float | None = None,
) -> AngleTrack:
    """Track from an angle (rad, (n,), wrapped or not, NaN where missing) logged at `time` (s, (n,)).

    `interval` (s) of the grid: the median of the stamps without it. `u_angle` (rad) and `u_time` (s): standard
    uncertainty of one reading and of one stamp, a floor for the noise that the data show. `keep` (Hz): keep 99 % up
    to there, instead of what the data suggest. `longest` (s): gaps up to here are bridged, 5 intervals without it.
    Raises BadInput for shapes that differ and for too few rows.
    """
    if time.ndim != 1 or time.shape != angle.shape:
        raise BadInput(f"encoder angle: found time {time.shape} and angle {angle.shape}, wanted one angle per time")
    stamps, values, dropped = _increasing(time, angle)
    step = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    curve = _curve(stamps, np.unwrap(values, period=TURN), u_angle, u_time, keep)
    every = step if interval is None else interval
    grid = stamps[0] + every * np.arange(math.floor((stamps[-1] - stamps[0]) / every + 1e-9) + 1)
    limit = 5.0 * step if longest is None else longest
    notes = (*_row_notes(time, angle, dropped, stamps, limit), *curve.notes)
    turned = np.unwrap(values, period=TURN)
    noise, coarse = _noise(curve, stamps, turned, grid), _standing(stamps, turned, grid)
    return _track(curve, grid, every, trusted(curve, grid, stamps, limit), noise, coarse, dropped, notes)


def _standing(time: Array, angle: Array, grid: Array) -> Array:
    """Standard uncertainty of the angle where it stays on one code for long, rad, at every instant of the grid; else 0.

    Anywhere within the code is as likely as anywhere else, and no average of readings knows better.
    """
    steps = np.abs(np.diff(angle))
    moved = np.concatenate([[0], np.flatnonzero(steps > SAME) + 1, [len(angle) - 1]])
    longer = np.flatnonzero(np.diff(time[moved]) > 2.0 * NEARBY)
    found = np.zeros(len(grid))
    if len(moved) > 2:
        code = float(np.min(steps[steps > SAME]))
        for k in longer.tolist():
            found[(grid >= time[moved[k]]) & (grid < time[moved[k + 1]])] = code / math.sqrt(12.0)
    return found


def _noise(curve: Curve, time: Array, angle: Array, grid: Array) -> tuple[Array, float]:
    """Density of the angle's noise about each instant of the grid, rad²/Hz, and the jitter of the stamps, s.

    Readings are taken to be off independently of each other, as far from the curve as they are about that instant: a
    platter that stands between two codes has no noise. Jitter makes it grow as the square of the rate.
    """
    off = angle - curve.value(time)[:, 0]
    sums = np.concatenate([[0.0], np.cumsum(off**2)])
    first, last = (np.searchsorted(time, grid + side * NEARBY) for side in (-1.0, 1.0))
    here = (sums[last] - sums[first]) / np.maximum(last - first, 1)
    each = float(time[-1] - time[0]) / (len(time) - 1)
    even = np.linspace(0.0, 0.5 / each, 500)
    seen = float(np.mean((1.0 - curve.low_pass.response(even)) ** 2))  # of white noise; the rest is in the curve
    return np.asarray(2.0 * each * here / seen), _jitter(off, curve.value(time, 1)[:, 0]) / math.sqrt(seen)


def _jitter(off: Array, rate: Array) -> float:
    """Standard deviation of time stamps by the growth of (angle off the curve)² with (rate)²; 0 where it is chance."""
    square, speed = off**2, rate**2
    speed = speed - speed.mean()
    weight = float(speed @ speed)
    if not weight > 0.0:
        return 0.0
    slope = float(speed @ square) / weight
    left = square - square.mean() - slope * speed
    u = math.sqrt(float((speed * left) @ (speed * left))) / weight  # White 1980: the scatter grows with the rate too
    return math.sqrt(slope) if slope > SURE * u else 0.0


def _clear(curve: Curve) -> float:
    """To where the spectrum stands so far above its noise that a derivative of it is motion, Hz.

    Sixth octaves from below; past two in a row that do not stand out, one counts only if it carries much of the rate. A
    column made of the reference carries the reference's noise, which what is left of a gyro carries with the other
    sign: a lag would seem to explain it.
    """
    spectrum = curve.spectrum
    edges = spectrum.frequency[0] * 2.0 ** (np.arange(200) / 6.0)
    number, failed, clear = np.digitize(spectrum.frequency, edges), 0, float(spectrum.frequency[0])
    rate = spectrum.frequency**2 * spectrum.motion
    for k in np.unique(number):
        here = number == k
        stands = float(spectrum.power[here].mean()) > (1.0 + CLEAR) * float(spectrum.noise[here].mean())
        much = float(rate[here].sum()) > MUCH * float(rate.sum())
        if stands and (failed < 2 or much):
            failed, clear = 0, float(spectrum.frequency[here][-1])
        elif not stands:
            failed += 1
    return clear


def _track(
    curve: Curve, grid: Array, interval: float, good: NDArray[np.bool_],
    noise: tuple[Array, float], coarse: Array, dropped: int, notes: tuple[str, ...],
) -> AngleTrack:  # fmt: skip
    angle, rate, acceleration = (curve.value(grid, order)[:, 0] for order in range(3))
    u_angle, u_rate, u_acceleration = (np.sqrt(curve.variance(grid, order)) for order in range(3))
    return AngleTrack(
        time=grid,
        interval=interval,
        angle=angle,
        rate=rate,
        acceleration=acceleration,
        u_angle=u_angle,
        u_rate=u_rate,
        u_acceleration=u_acceleration,
        good=good,
        bandwidth=curve.spectrum.bandwidth,
        kept=curve.low_pass.kept,
        clear=_clear(curve),
        density=noise[0],
        coarse=coarse,
        jitter=noise[1],
        dropped=dropped,
        notes=notes,
    )


def _increasing(time: Array, angle: Array) -> tuple[Array, Array, int]:
    """Rows with a number in them and a stamp above all stamps before, and how many had none such."""
    known = np.isfinite(time) & np.isfinite(angle)
    stamps, values = time[known], angle[known]
    highest = np.maximum.accumulate(stamps) if len(stamps) else stamps
    later = np.ones(len(stamps), bool)
    later[1:] = stamps[1:] > highest[:-1]
    return stamps[later], values[later], int(np.count_nonzero(~later))


def _curve(
    time: Array, angle: Array, u_angle: float | Array, u_time: float, keep: float | None, weight: Array | None = None
) -> Curve:
    """Smooth with the noise floor of reading and stamp; a stamp's error counts by the rate at that instant.

    `weight`: see `rig.signals.smoother.smooth`.
    """
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    spans = step if weight is None else weight * float(np.mean(np.diff(time)))
    density = np.broadcast_to(2.0 * spans * np.square(u_angle), time.shape)
    curve = smooth(time, angle[:, None], weight=weight, floor=_over_time(time, density), keep=keep, steepest=0.0)
    if u_time == 0.0:
        return curve
    density = density + 2.0 * spans * (u_time * curve.value(time, 1)[:, 0]) ** 2
    floor = _over_time(time, density)
    return smooth(time, angle[:, None], weight=weight, noise=density, floor=floor, keep=keep, steepest=0.0)


def _over_time(time: Array, values: Array) -> float:
    """Mean over time of values at these times; 0 without a span of time."""
    return float(np.trapezoid(values, time) / (time[-1] - time[0])) if len(time) > 1 else 0.0


def _row_notes(time: Array, angle: Array, dropped: int, stamps: Array, limit: float) -> tuple[str, ...]:
    """What was missing in the log."""
    missing = int(np.count_nonzero(~(np.isfinite(time) & np.isfinite(angle))))
    gaps = np.diff(stamps)[np.diff(stamps) > limit]
    longest = float(gaps.max(initial=0.0))
    notes = []
    if dropped:
        notes.append(f"dropped {dropped} of {len(time)} rows: their time stamp did not increase")
    if missing:
        notes.append(f"left out {missing} of {len(time)} rows: no number in them")
    if len(gaps):
        notes.append(
            f"{len(gaps)} gaps longer than {limit:.3g} s are not to be trusted, the longest is {longest:.3g} s"
        )
    return tuple(notes)


def angle_of_lines(
    time: Array,
    a: Array,
    b: Array,
    index: Array | None = None,
    *,
    lines: int,
    a_leads: Literal[-1, 1] = 1,
    low: float = 1.0,
    high: float = 2.0,
) -> Array:
    """Angle (rad, (n,), unwrapped) at every sample of the outputs, straight from one edge to the next.

    Arguments and errors are those of `quadrature_track`, which knows the uncertainty too.
    """
    edges, angle, _ = _counted((time, a, b, index), lines, a_leads, (low, high))
    return np.interp(time, edges, angle)


def quadrature_track(
    time: Array,
    a: Array,
    b: Array,
    index: Array | None = None,
    *,
    lines: int,
    a_leads: Literal[-1, 1] = 1,
    low: float = 1.0,
    high: float = 2.0,
    interval: float | None = None,
    u_angle: float = 0.0,
    keep: float | None = None,
) -> AngleTrack:
    """Track from outputs A, B and index (V, (n,)) sampled at `time` (s, (n,), increasing), `lines` per revolution.

    `a_leads`: the sense (+1 or −1) of a motion in which A leads B. At or below `low` V an output is low, at or above
    `high` V it is high. `u_angle` (rad): standard uncertainty of a line's place on the disk. An edge is known to
    within half a sample. Raises BadInput if nothing moved, or if A and B change together too often to follow.
    """
    edges, angle, notes = _counted((time, a, b, index), lines, a_leads, (low, high))
    sample = float(np.median(np.diff(time)))
    stamps, filled, added = _filled(edges, angle)
    u_each = np.hypot(u_angle, np.where(added, TURN / (4 * lines) / math.sqrt(12.0), 0.0))
    track = _smoothed(stamps, filled, interval, u_each, sample / math.sqrt(12.0), keep)
    return replace(track, notes=(*notes, *track.notes))


def _counted(
    sampled: tuple[Array, Array, Array, Array | None], lines: int, a_leads: int, levels: tuple[float, float]
) -> tuple[Array, Array, tuple[str, ...]]:
    """Times of the edges (s), the angle there (rad, zero at the first index pulse), and notes."""
    time, a, b, index = sampled
    pulses = Trigger(*levels).feed(a, time), Trigger(*levels).feed(b, time)
    edges, steps, together = _steps(*pulses)
    if together > TOGETHER * len(steps):
        edges, angle = _whole_lines(*pulses, TURN / lines * a_leads)
        note = f"{together} of {len(steps)} edges of A and B came together: lines were counted by one edge of A"
    else:
        # the count changes at an edge, so the edge itself lies between two counts
        angle = TURN / (4 * lines) * a_leads * (np.cumsum(steps) - 0.5 * steps)
        note = f"{together} of {len(steps)} edges of A and B came together: the direction before was kept"
    last = np.append(np.diff(edges) > 0.0, True)
    turned, notes = _zeroed(edges[last], angle[last], index, time, levels, lines)
    return edges[last], turned, (*notes, note) if together else notes


def _whole_lines(a: Pulses, b: Pulses, line: float) -> tuple[Array, Array]:
    """Rising edges of A (s) and the angle there (rad), where a state is too short for the samples: see `encoder`.

    Raises BadInput if the platter does not turn one way: forward and back, a rising edge lies half a line elsewhere.
    """
    sense = float(Directions().feed(a, b).mean())
    if abs(sense) < 0.8:
        raise BadInput(f"encoder: found lines in both directions (mean {sense:+.2f}), wanted faster sampling")
    return a.rising, np.asarray(math.copysign(line, sense) * np.arange(len(a.rising)), np.float64)


def _smoothed(
    time: Array, angle: Array, interval: float | None, u_angle: Array, u_time: float, keep: float | None
) -> AngleTrack:
    """Track of an angle that is continuous already: a fast platter may turn far between two of its points."""
    spans = np.gradient(time)
    curve = _curve(time, angle, u_angle, u_time, keep, spans / spans.mean())
    every = float(np.median(np.diff(time))) if interval is None else interval
    grid = time[0] + every * np.arange(math.floor((time[-1] - time[0]) / every + 1e-9) + 1)
    good = trusted(curve, grid, time, math.inf)
    return _track(curve, grid, every, good, _noise(curve, time, angle, grid), np.zeros(len(grid)), 0, curve.notes)


def _steps(a: Pulses, b: Pulses) -> tuple[Array, Array, int]:
    """Times (s) of all edges of A and B, the step (+1: A leads) at each, and how many edges came at the same time.

    An edge of A is forward if it makes A differ from B, one of B if it makes B equal to A.
    """
    (times_a, rises_a), (times_b, rises_b) = _edges(a), _edges(b)
    if min(len(times_a), len(times_b)) < 2:
        raise BadInput(f"encoder: found {len(times_a)} edges of A and {len(times_b)} of B, wanted a platter that turns")
    step_a = -rises_a * _level(times_b, rises_b, times_a)
    step_b = rises_b * _level(times_a, rises_a, times_b)
    times = np.concatenate([times_a, times_b])
    order = np.argsort(times, kind="stable")
    times, steps = times[order], np.concatenate([step_a, step_b])[order]
    same = np.diff(times) == 0.0
    tied = np.append(same, False) | np.insert(same, 0, False)
    known = np.flatnonzero(~tied)
    if not len(known):
        return times, steps, len(times)
    before = np.clip(np.searchsorted(known, np.arange(len(times)), side="right") - 1, 0, None)
    return times, steps[known[before]], int(np.count_nonzero(tied))


def _edges(pulses: Pulses) -> tuple[Array, Array]:
    """Edges in the order of time (s), and +1 or −1 for up or down."""
    times = np.concatenate([pulses.rising, pulses.falling])
    rises = np.concatenate([np.ones(len(pulses.rising)), -np.ones(len(pulses.falling))])
    order = np.argsort(times, kind="stable")
    return times[order], rises[order]


def _level(times: Array, rises: Array, at: Array) -> Array:
    """Level (+1 high, −1 low) of an output with these edges, at other times (s)."""
    place = np.searchsorted(times, at, side="left")
    return np.concatenate([[-rises[0]], rises])[place]


def _zeroed(
    edges: Array, angle: Array, index: Array | None, time: Array, levels: tuple[float, float], lines: int
) -> tuple[Array, tuple[str, ...]]:
    """The angle (rad) with zero at the first index pulse, and what the other pulses say about lost lines."""
    pulses = Trigger(*levels).feed(index, time) if index is not None else Pulses(np.empty(0), np.empty(0), 0)
    places = np.interp(middles(pulses.rising, pulses.falling), edges, angle)
    if not len(places):
        return angle - angle[0], ("no index pulse: angle zero is the first edge",)
    turns = np.diff(places) / TURN
    off = np.abs(turns - np.round(turns)) * lines
    wrong = int(np.count_nonzero(off > 1.0))
    found = f"{len(places)} index pulses: angle zero is the first"
    if not wrong:
        return angle - places[0], (found,)
    lost = (
        f"from one index pulse to the next {wrong} of {len(off)} are no whole turns, off by up to {off.max():.3g} lines"
    )
    if 2 * wrong > len(off):
        raise BadInput(f"encoder: {lost}; wanted whole turns: another number of lines, or faster sampling")
    return angle - places[0], (found, lost)


def _filled(time: Array, angle: Array, widest: float = STANDING) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Edges with points put in where none passed for long: the platter stood, or crept, between two lines.

    Such a point is known to a quarter of a line; the last array says which they are.
    """
    gaps = np.diff(time)
    wide = np.flatnonzero(gaps > widest)
    more = [np.linspace(time[at], time[at + 1], math.ceil(gaps[at] / widest) + 1)[1:-1] for at in wide]
    times = np.concatenate([time, *more])
    order = np.argsort(times, kind="stable")
    return times[order], np.interp(times[order], time, angle), order >= len(time)
