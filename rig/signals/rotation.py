"""Motion on the turntable as the encoder saw it: angle, rate and acceleration with their variance, and whole turns.

A line's edge is known to within half a sample either way, so its time has the standard uncertainty Δt/√12 with the
sampling interval Δt. Three estimators, from the strongest to the most local:

- the mean rate over whole revolutions, index to index: ω = 2π·m/(t_m − t_0). Graduation, eccentricity and pulse width
  cancel, because both ends are the same line (design of the reference; no certificate of the disk is needed);
- a cubic spline θ(t) through all edges by least squares, a knot every few lines: local rate and acceleration;
- the map of what the spline leaves over, line by line around the disk. Once-per-turn errors of the graduation and true
  wow of the platter cannot be told apart by one reading head; the map says so of its first orders.

Angles and rates are about the upward axis: negative for a platter that turns clockwise seen from above.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.record import Samples
from rig.signals.encoder import LINES, WHOLE, Decoder, Settings

Array = NDArray[np.float64]
KNOT = 32  # lines between knots: 43 ms at 45 rpm, short against wow and the motor's flutter
DEGREE = 3
WINDOW = 12  # knots on either side that matter at a point: an edge's influence fades by a factor of four a knot
STRETCH, OVERLAP = 256, 20  # knots fitted at once, and on either side beyond them


@dataclass(frozen=True)
class Edges:
    """Rising edges of one record: `times` (s since its first conversion), numbered in the order seen.

    `sense` is +1 or −1 about up. `index` are times of index pulses, `index_line` the line before each; `flagged` counts
    from one to the next that are no whole revolutions, `missed` pulses that fell between samples; `interval` (s)
    between two samples of a channel.
    """

    times: Array
    sense: int
    index: Array
    index_line: NDArray[np.int64]
    flagged: tuple[int, ...]
    missed: int
    interval: float

    @property
    def u_time(self) -> float:
        """Standard uncertainty of one edge's time, s."""
        return self.interval / math.sqrt(12.0)


def edges_of(pieces: Iterable[Samples], settings: Settings) -> Edges:
    """Decode one record, piece by piece. Raises BadInput if no line passed, or the direction is not clear."""
    decoder, found, interval = Decoder(settings), [], 0.0
    for samples in pieces:
        interval = samples.timing.scan_period
        found.append(decoder.feed(samples))
    times = np.concatenate([one.edges for one in found]) if found else np.empty(0)
    directions = np.concatenate([one.direction for one in found]) if found else np.empty(0)
    if len(times) < 2 * KNOT:
        raise BadInput(f"encoder: found {len(times)} lines, wanted at least {2 * KNOT} for a rate")
    mean = float(directions.mean())
    if abs(mean) < 0.8:
        raise BadInput(f"encoder: found lines in both directions (mean {mean:+.2f}), wanted a platter turning one way")
    return Edges(
        times=times,
        sense=int(math.copysign(1, mean)),
        index=np.concatenate([one.index for one in found]),
        index_line=np.concatenate([one.index_line for one in found]),
        flagged=tuple(count for one in found for count in one.flagged),
        missed=sum(one.missed for one in found),
        interval=interval,
    )


@dataclass(frozen=True)
class Turns:
    """Whole revolutions: bounds (s, shape (m+1,)) where the same line passed; `rate` of each (rad/s, shape (m,))."""

    bounds: Array
    sense: int
    u_time: float

    @property
    def rate(self) -> Array:
        """Mean rate of every revolution, rad/s, shape (m,)."""
        return np.asarray(self.sense * 2.0 * math.pi / np.diff(self.bounds), np.float64)

    @property
    def mean_rate(self) -> float:
        """Mean rate over all of them, rad/s: whole angle over whole time."""
        return float(self.sense * 2.0 * math.pi * (len(self.bounds) - 1) / (self.bounds[-1] - self.bounds[0]))

    @property
    def u_mean_rate(self) -> float:
        """Standard uncertainty of the mean rate from the two edges at its ends, rad/s."""
        return abs(self.mean_rate) * math.sqrt(2.0) * self.u_time / float(self.bounds[-1] - self.bounds[0])


def turns(edges: Edges, begin: float = -math.inf, end: float = math.inf) -> Turns:
    """The longest stretch of whole revolutions between two instants (s), by the line after each index pulse.

    Raises BadInput if there is none, or if lines were lost within it.
    """
    lines = edges.index_line + 1
    lines = lines[(lines >= 0) & (lines < len(edges.times))]
    inside = lines[(edges.times[lines] >= begin) & (edges.times[lines] < end)]
    if len(inside) < 2:
        raise BadInput(f"encoder: found {len(inside)} index pulses between {begin:g} and {end:g} s, wanted two or more")
    wrong = [int(count) for count in np.diff(inside) if count not in WHOLE]
    if wrong:
        raise BadInput(f"encoder: found {wrong} lines between index pulses, wanted {LINES} each: lines were lost")
    whole = np.arange(inside[0], inside[-1] + 1, LINES)  # an index that was missed between is a revolution all the same
    return Turns(edges.times[whole], edges.sense, edges.u_time)


class Track:
    """Angle over time: a cubic spline by least squares through the edges, knots every `lines_per_knot` lines.

    Weighted for an equal uncertainty of all times: σ_θ = |ω|·σ_t. A long record is fitted stretch by stretch with an
    overlap that no edge's influence crosses, so that the cost grows with the length and no faster.
    """

    def __init__(self, edges: Edges, lines_per_knot: int = KNOT) -> None:
        self.edges = edges
        t = edges.times
        angle = np.asarray(edges.sense * (2.0 * math.pi / LINES) * np.arange(len(t)), np.float64)
        inner = t[lines_per_knot : -lines_per_knot or None : lines_per_knot]
        inner = inner[(inner > t[DEGREE]) & (inner < t[-DEGREE - 1])]
        self.knots = np.concatenate([np.full(DEGREE + 1, t[0]), inner, np.full(DEGREE + 1, t[-1])])
        speed = np.abs(np.gradient(angle, t))
        smooth = np.convolve(np.pad(speed, 8, mode="edge"), np.ones(17) / 17.0, "valid")
        self._weights = 1.0 / (smooth * edges.u_time)
        stretch = STRETCH * lines_per_knot
        self._starts = t[: max(len(t) - stretch // 2, 1) : stretch]
        self._splines = [self._fitted(t, angle, n * stretch, stretch, lines_per_knot) for n in range(len(self._starts))]

    def _fitted(self, t: Array, angle: Array, first: int, stretch: int, per_knot: int) -> tuple[Any, Any, Any]:
        """The spline of one stretch with its overlap on both sides, and its two derivatives."""
        from scipy.interpolate import make_lsq_spline

        last = first + stretch if first + stretch < len(t) - stretch // 2 else len(t)
        begin, end = max(first - OVERLAP * per_knot, 0), min(last + OVERLAP * per_knot, len(t))
        here = slice(begin, end)
        inner = self.knots[(self.knots > t[begin + DEGREE]) & (self.knots < t[end - DEGREE - 1])]
        knots = np.concatenate([np.full(DEGREE + 1, t[begin]), inner, np.full(DEGREE + 1, t[end - 1])])
        spline = make_lsq_spline(t[here], angle[here], knots, DEGREE, w=self._weights[here], method="norm-eq")
        return spline, spline.derivative(1), spline.derivative(2)

    def _evaluated(self, times: Array, derivative: int) -> Array:
        times = np.asarray(times, np.float64)
        which = np.clip(np.searchsorted(self._starts, times, side="right") - 1, 0, None)
        found = np.empty(times.shape)
        for n in np.unique(which):
            here = which == n
            found[here] = self._splines[int(n)][derivative](times[here])
        return found

    @property
    def begin(self) -> float:
        """First instant that the track covers, s."""
        return float(self.edges.times[0])

    @property
    def end(self) -> float:
        """Last instant that the track covers, s."""
        return float(self.edges.times[-1])

    def angle(self, times: Array) -> Array:
        """Angle from the first edge, rad, shape of `times` (s)."""
        return self._evaluated(times, 0)

    def rate(self, times: Array) -> Array:
        """Angular rate, rad/s."""
        return self._evaluated(times, 1)

    def acceleration(self, times: Array) -> Array:
        """Angular acceleration, rad/s²."""
        return self._evaluated(times, 2)

    @cached_property
    def residual(self) -> Array:
        """What the spline leaves over at every edge, rad, shape (edges,)."""
        angle = self.edges.sense * (2.0 * math.pi / LINES) * np.arange(len(self.edges.times))
        return np.asarray(angle - self.angle(self.edges.times), np.float64)

    def variance(self, times: Array) -> Array:
        """Variance of angle (rad²), rate and acceleration at each instant from the edges' timing, shape (3, n).

        From the normal equations of the edges within twelve knots: further ones have no say.
        """
        return np.array([self._variance_at(float(t)) for t in times], np.float64).reshape(-1, 3).T

    def _variance_at(self, time: float) -> list[float]:
        from scipy.interpolate import BSpline

        last = len(self.knots) - DEGREE - 2
        place = int(np.clip(np.searchsorted(self.knots, time, side="right") - 1, DEGREE, last))
        first, stop = max(place - WINDOW, DEGREE), min(place + WINDOW, last)
        knots = self.knots[first - DEGREE : stop + DEGREE + 2]
        t = self.edges.times
        inside = slice(*np.searchsorted(t, [self.knots[first], self.knots[stop + 1]]).tolist())
        basis = BSpline.design_matrix(t[inside], knots, DEGREE).toarray() * self._weights[inside, None]
        inverse = np.linalg.pinv(basis.T @ basis, hermitian=True)
        rows = []
        for order in range(3):
            units = BSpline(knots, np.eye(len(knots) - DEGREE - 1), DEGREE)
            rows.append((units.derivative(order) if order else units)(time))
        return [float(row @ inverse @ row) for row in rows]


@dataclass(frozen=True)
class GraduationMap:
    """What the track leaves over around the disk: mean residual of each line, rad, shape (1000,), and of each order.

    `orders` n, `amplitude` (rad, complex: Re Σ A_n·exp(j·n·angle)) and its standard uncertainty of each part. What a
    spline follows (the first orders, as true wow) is not in it; `revolutions` were averaged.
    """

    lines: Array
    u_line: float
    orders: NDArray[np.int64]
    amplitude: NDArray[np.complex128]
    u_amplitude: float
    revolutions: int


def graduation_map(track: Track, orders: int = 8) -> GraduationMap:
    """Average residual line by line from index to index; raises BadInput with fewer than two whole revolutions."""
    edges = track.edges
    closed = turns(edges)
    first = int(np.searchsorted(edges.times, closed.bounds[0]))
    count = len(closed.bounds) - 1
    if count < 2:
        raise BadInput(f"encoder: found {count} whole revolution, wanted at least two for a map of its lines")
    table = track.residual[first : first + count * LINES].reshape(count, LINES)
    mean = table.mean(axis=0)
    u_line = float(table.std(axis=0, ddof=1).mean()) / math.sqrt(count)
    order = np.arange(1, orders + 1)
    around = 2.0 * math.pi * np.arange(LINES) / LINES
    amplitude = 2.0 / LINES * np.exp(-1j * order[:, None] * around) @ mean
    return GraduationMap(mean, u_line, order, amplitude, u_line * math.sqrt(2.0 / LINES), count)


def encoder_settings(lines: Iterable[Any]) -> Settings:
    """The encoder's channels and thresholds as its driver wrote them down at the beginning of the run."""
    for entry in lines:
        if entry.kind == "settings" and entry.body["role"] == "encoder":
            known = {name: entry.body["settings"][name] for name in ("a", "b", "index", "a_leads")}
            volts = {name: f"{entry.body['settings'][name]} V" for name in ("low", "high")}
            return Settings(**known, **volts)
    return Settings()
