"""The paper's own estimators, equations 6 to 13, kept as they were printed beside the unbiased ones.

They are here to be compared with. What is known of their bias, for a disk of 1000 lines sampled at 3125 Hz:

- a rate from one reciprocal line interval (eq. 9) takes few values, because an interval is a whole number of samples:
  281.25 or 225.00 °/s for a platter that turns at 270 °/s;
- its mean is too high by the scatter squared (Jensen's inequality): +0.694 % at 45 rpm, +0.781 % at 33 1/3 rpm, and a
  moving average of rates has the same mean;
- as the abscissa of a least-squares line (eq. 12) it has noise of its own, so the slope comes out small: 0.75 of the
  sensitivity for two speeds line by line (0.76 sample by sample, where long intervals count for more), 0.994 with an
  average over 20 lines (errors in variables);
- the mean of V_R/rate (eq. 13) at 45 rpm is 0.69 % too low with averaged rates, 0.16 % too low with the last raw one
  (a long interval is followed by short ones), and a zero offset V_0 moves it by V_0·mean(1/rate) besides.

None of these numbers claims an uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, signals_of, wires_of
from rig.archive.reduced import reduced
from rig.calibrate.calibration import PaperRow
from rig.errors import BadInput
from rig.parts.reading.vibration import SinePoint
from rig.record import Samples
from rig.sensor import Sensor, SensorChannel
from rig.signals import tone
from rig.signals.encoder import LINES
from rig.signals.rotation import Edges, edges_of, encoder_settings

Array = NDArray[np.float64]
AVERAGED = 20  # lines in the moving average
NOMINAL_ZERO = 2.5  # V, what a part with a fixed reference gives at rest
CROSS_AXIS = 67.0  # Hz of the paper's figures 4 and 5
TURNING = ("spin_up", "hold", "perturbed", "coast_down")


def reciprocal_rates(edges: Array, lines: int = LINES) -> Array:
    """Rate from each line interval, 2π/(C·t_e), rad/s, shape (n−1,) from edges (s), shape (n,); paper eq. 9.

    Raises BadInput for fewer than two edges, or edges that do not ascend.
    """
    interval = np.diff(np.asarray(edges, np.float64))
    if not len(interval) or not np.all(interval > 0.0):
        raise BadInput(f"encoder: found {len(edges)} edges, wanted at least two, each later than the last")
    return np.asarray(2.0 * math.pi / (lines * interval))


def moving_average(rates: Array, count: int = AVERAGED) -> Array:
    """Mean of every `count` neighbouring rates, shape (n−count+1,); the paper's remedy against the scatter.

    Raises BadInput if there are fewer rates than are averaged.
    """
    if not 1 <= count <= len(rates):
        raise BadInput(f"moving average: found {len(rates)} rates, wanted at least the {count} that are averaged")
    total = np.cumsum(np.concatenate([[0.0], rates]))
    return np.asarray((total[count:] - total[:-count]) / count)


def v_r(v_out: Array, v_supply: Array | float) -> Array:
    """Output of a ratiometric gyro as a voltage about zero, 2.5·(2V_o − V_s)/V_s, V, shape of `v_out`; paper eq. 11."""
    return np.asarray(2.5 * (2.0 * v_out - v_supply) / v_supply)


def mean_sensitivity(v_r: Array, rate: Array) -> float:
    """Mean of V_R/rate over all samples, V/(rad/s); paper eq. 13. Raises BadInput if a rate is zero."""
    if not len(rate) or np.any(rate == 0.0):
        raise BadInput("eq. 13: found no rate, or a rate of zero, wanted a platter that turns")
    return float(np.mean(v_r / rate))


def least_squares_sensitivity(v_r: Array, rate: Array) -> tuple[float, float]:
    """Slope (V/(rad/s)) and intercept (V) of V_R over the reference rate by least squares; paper eq. 12.

    Raises BadInput if all rates are one and the same.
    """
    sums = _Sums()
    sums.add(v_r, rate)
    return sums.line()


def least_squares(volts: Array, frequency: Array, velocity: Array) -> tuple[float, float]:
    """S1 ((m/s²)/V) and S0 (m/s²) of S1·V + S0 = 2πf·v by least squares over the points of a sweep; paper eq. 8.

    `volts` are amplitudes of the sensor (V), `frequency` Hz, `velocity` amplitudes of the vibrometer (m/s), all (n,).
    S0 belongs to amplitudes and is not the zero offset of the sensor. Raises BadInput if all volts are the same.
    """
    sums = _Sums()
    sums.add(2.0 * math.pi * np.asarray(frequency) * np.asarray(velocity), np.asarray(volts, np.float64))
    return sums.line()


def integrated_amplitude(instants: Array, volts: Array, frequency: float) -> complex:
    """Amplitude of the integral over time of a sensor's record, V·s, complex; paper eq. 6 by integration.

    The record less its mean is integrated by the trapezoidal rule and fitted at `frequency` (Hz) with a drift. The rule
    makes the amplitude too small by πfT·cot(πfT) ≈ 1 − (πfT)²/3 with the sampling interval T: −0.15 % at 67 Hz and
    −8.6 % at 500 Hz for 3125 samples per second. It is left in. `instants` (s, evenly spaced) and `volts` are (n,).
    Raises BadInput as the sine fit does.
    """
    level = np.asarray(volts, np.float64) - float(np.mean(volts))
    steps = 0.5 * (level[1:] + level[:-1]) * np.diff(instants)
    integral = np.concatenate([[0.0], np.cumsum(steps)])
    return tone.fit_three(np.asarray(instants, np.float64), integral, frequency, drift=True).amplitude


@dataclass(frozen=True)
class Held:
    """The reference as the paper samples it: at every sample the last complete rate (`rates`, rad/s, `since`, s)."""

    since: Array
    rates: Array
    end: float

    def at(self, instants: Array) -> tuple[NDArray[np.bool_], Array]:
        """Which instants (s) have a rate, shape (n,), and those rates, rad/s, shape (count of them,)."""
        inside = (instants >= self.since[0]) & (instants <= self.end)
        return inside, self.rates[np.searchsorted(self.since, instants[inside], side="right") - 1]


def held(edges: Edges, count: int, sign: float = 1.0) -> Held:
    """Rates about the gyro's axis from reciprocal intervals of one record, averaged over `count` lines, and held."""
    rates = moving_average(reciprocal_rates(edges.times), count) * edges.sense * sign
    return Held(edges.times[count:], rates, float(edges.times[-1]))


def volts_about_zero(samples: Samples, gyro: SensorChannel, supply: str) -> Array:
    """Output of a gyro about its nominal zero, V, shape (n,): V_R of eq. 11 for a ratiometric part.

    `supply` is what the cables call it.
    """
    if gyro.ratiometric:
        return v_r(samples.volts(gyro.name), samples.volts(supply))
    return samples.volts(gyro.name) - NOMINAL_ZERO


def axis_sign(body: Mapping[str, Any]) -> float:
    """−1 for a cube upside down: its axis then sees the platter turn the other way."""
    return -1.0 if body["inverted"] else 1.0


def gyro_rows(records: Recorded, sensor: Sensor) -> list[PaperRow]:
    """The paper's estimates for the gyros on the platter's axis in one turntable run; none if nothing was held.

    Eq. 13 over the holds, eq. 12 over everything that turned, each with raw line intervals and with the moving
    average. Raises BadInput if the encoder gave no rate in a hold.
    """
    return reduced(records, "paper", (PaperRow,), lambda: _gyro_rows(records, sensor), sensor)


def _gyro_rows(records: Recorded, sensor: Sensor) -> list[PaperRow]:
    found: dict[tuple[str, int], _Estimates] = {}
    for body in records.points.values():
        if body.get("phase") not in TURNING:
            continue
        edges = _edges(records, body)
        if edges is None:
            continue
        gyros = sensor.about(body["gyro_axis"])
        references = {count: held(edges, count, axis_sign(body)) for count in (1, AVERAGED)}
        for samples in records.pieces(body["samples"]):
            recorded = {channel.name for channel in samples.channels}
            wired = [gyro for gyro in gyros if gyro.name in recorded]
            _gather(found, samples, wired, references, wires_of(records).supply, body["phase"] == "hold")
    return [row for (name, count), one in found.items() for row in _rows(name, count, one, sensor)]


def _edges(records: Recorded, body: Mapping[str, Any]) -> Edges | None:
    """Edges of a record; None for a spin-up or coast-down with too few of them."""
    try:
        return edges_of(records.pieces(body["samples"]), encoder_settings(records.lines))
    except BadInput:
        if body["phase"] == "hold":
            raise
        return None


class _Sums:
    """Sums of a straight line y over x, gathered piece by piece."""

    def __init__(self) -> None:
        self.count = 0
        self._x0 = self._y0 = 0.0
        self._x = self._y = self._xx = self._xy = 0.0

    def add(self, y: Array, x: Array) -> None:
        if not self.count and len(x):
            self._x0, self._y0 = float(x[0]), float(y[0])  # sums about a value of the data lose no digits
        dx, dy = x - self._x0, y - self._y0
        self.count += len(x)
        self._x, self._y = self._x + float(dx.sum()), self._y + float(dy.sum())
        self._xx, self._xy = self._xx + float(dx @ dx), self._xy + float(dx @ dy)

    def line(self) -> tuple[float, float]:
        """Slope and intercept; raises BadInput if x never changes."""
        spread = self._xx - self._x**2 / max(self.count, 1)
        if self.count < 2 or not spread > 1e-20 * (self._xx + self._x0**2):
            raise BadInput(f"least squares: found {self.count} points without any spread, wanted two different ones")
        slope = (self._xy - self._x * self._y / self.count) / spread
        mean_x, mean_y = self._x0 + self._x / self.count, self._y0 + self._y / self.count
        return slope, mean_y - slope * mean_x


class _Estimates:
    """What eq. 12 and eq. 13 need of one channel with one reference."""

    def __init__(self) -> None:
        self.line = _Sums()
        self.ratios, self.held = 0.0, 0


def _gather(
    found: dict[tuple[str, int], _Estimates],
    samples: Samples,
    gyros: Iterable[SensorChannel],
    references: Mapping[int, Held],
    supply: str,
    hold: bool,
) -> None:
    """Add one stretch of a record to the estimates of every channel and reference."""
    for gyro in gyros:
        instants, volts = samples.instants(gyro.name), volts_about_zero(samples, gyro, supply)
        for count, reference in references.items():
            inside, rate = reference.at(instants)
            if not len(rate):
                continue
            one = found.setdefault((gyro.name, count), _Estimates())
            one.line.add(volts[inside], rate)
            if hold:
                one.ratios += mean_sensitivity(volts[inside], rate) * len(rate)
                one.held += len(rate)


def _rows(name: str, count: int, one: _Estimates, sensor: Sensor) -> Iterable[PaperRow]:
    mean = "raw intervals" if count == 1 else f"moving average of {count} lines"
    squares = "raw" if count == 1 else mean
    gyro, triad = sensor.channel(name), sensor.triad_of(name)
    first = sensor.of_quantity("rate")[0] == triad
    row = gyro.word.capitalize() if first else triad.title.title()  # the paper's Table II has one row for all others
    nominal, unit = gyro.nominal, "V/(rad/s)"
    if one.held:
        value = one.ratios / one.held
        yield PaperRow("II", row, name, f"eq. 13, mean, {mean}", value, unit, nominal, f"{name}.sensitivity")
    slope, _ = one.line.line()
    yield PaperRow("II", row, name, f"eq. 12, least squares, {squares}", slope, unit, nominal, f"{name}.sensitivity")


def accelerometer_rows(points: Sequence[SinePoint], sensor: Sensor, runs: Sequence[Recorded] = ()) -> list[PaperRow]:
    """The paper's estimates for every accelerometer on the axis that was driven.

    Eq. 8 by least squares over all points and over those below a quarter of the part's bandwidth (a sensor with an
    output filter is no straight line further up), and eq. 6 by integrating the record nearest to 67 Hz if its run is
    among `runs`. Channels with fewer than three points get none.
    """
    rows: list[PaperRow] = []
    for channel in sensor.channels:
        mine = [p for p in points if not channel.is_rate and p.axis == channel.axis and channel.name in p.lines]
        if len(mine) >= 3:
            rows += [_accelerometer_row(channel, *found) for found in _estimates(channel, mine, runs)]
    return rows


def _estimates(
    channel: SensorChannel, points: Sequence[SinePoint], runs: Sequence[Recorded]
) -> Iterable[tuple[str, float]]:
    name, quarter = channel.name, 0.25 * channel.bandwidth
    low = [p for p in points if p.frequency <= quarter]
    yield "eq. 8, least squares, all frequencies", _line_sensitivity(name, points)
    if 3 <= len(low) < len(points):
        yield f"eq. 8, least squares, up to {quarter:g} Hz", _line_sensitivity(name, low)
    nearest = min(points, key=lambda p: (abs(p.frequency - CROSS_AXIS), -p.peak))
    for records in runs:
        if records.name == nearest.run and nearest.index in records.points:
            value = _integrated_sensitivity(name, nearest, records)
            yield f"eq. 6, record integrated, {nearest.frequency:.0f} Hz", value


def _line_sensitivity(name: str, points: Sequence[SinePoint]) -> float:
    """1/S1 of eq. 8, V/(m/s²)."""
    frequency = np.array([p.frequency for p in points])
    velocity = np.array([p.peak for p in points]) / (2.0 * math.pi * frequency)
    volts = np.array([abs(complex(p.lines[name].amplitudes[0])) for p in points])
    return 1.0 / least_squares(volts, frequency, velocity)[0]


def _integrated_sensitivity(name: str, point: SinePoint, records: Recorded) -> float:
    """Integral of the sensor's record over the vibrometer's velocity, V/(m/s²)."""
    found = signals_of(records, records.points[point.index])
    if found is None:
        raise BadInput(f"{records.name}, point {point.index}: found no record, wanted the one that was fitted")
    integral = integrated_amplitude(found.instants, found.of(name), point.frequency)
    return abs(integral) * 2.0 * math.pi * point.frequency / point.peak


def _accelerometer_row(channel: SensorChannel, estimate: str, value: float) -> PaperRow:
    row, ours = f"{channel.range.replace(' ', '')} Unit", f"{channel.name}.sensitivity"
    return PaperRow("I", row, channel.name, estimate, value, "V/(m/s²)", channel.nominal, ours)
