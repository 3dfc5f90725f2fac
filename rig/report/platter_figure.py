"""Figure of what a model leaves over of a turntable run: over time, over a revolution, by order per revolution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.diagnose.misfit import Condition
from rig.fit.fit import Fit
from rig.motion import Array
from rig.parts.platter import Platter
from rig.parts.platter_cuts import STEADY
from rig.report.misfit_frame import BAND, colour, legend, new, title
from rig.units import STANDARD_GRAVITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SECONDS = 4.0  # of the running mean over time
BINS = 36  # of a revolution
ORDERS = 6.0  # of the spectrum
ORDER_BIN = 0.1
MOST = 4  # channels in a turntable figure


def turntable(fit: Fit, number: int, part: Platter, worst: Sequence[Condition]) -> Figure:
    """Gyros on the axis, and what stands out, over time, over a revolution, and by order per revolution."""
    figure, axes = new(3, 1, (10.0, 9.0), title(part.name.split("#")[0], worst))
    time, angle, orders = axes[:, 0]
    local = fit.state.local(part, number)
    left = (part.data.observed - part.raw(local, fit.state.terms)) / local.sensitivity[:, None]
    whitened = fit.left[fit.offsets()[number] :][: part.rows].reshape(len(part.channels.names), -1)
    rows = _shown(part, worst)
    for row in rows:
        shade = colour(part.channels, rows, row)
        _over_time(time, part, row, left[row], float(local.sensitivity[row]), shade)
        _over_angle(angle, part, row, left[row], float(local.sensitivity[row]), shade)
        _by_order(orders, part, whitened[row] ** 2, part.counted.reshape(whitened.shape)[row], shade)
    for ax in (time, angle):
        ax.axhspan(-2.0, 2.0, color=BAND, zorder=0)
        ax.axhline(0.0, color="#888888", linewidth=0.7)
    time.set(ylabel=f"mean of {SECONDS:g} s ÷ noise", xlabel="time since the run began / s")
    legend(time, 4)
    angle.set(
        ylabel=f"mean of {360 // BINS}° ÷ noise",
        xlabel="platter angle from the index / ° (solid: upright, dashed: inverted)",
    )
    angle.set(xlim=(0.0, 360.0), xticks=range(0, 361, 45))
    orders.axhline(1.0, color="#888888", linewidth=0.7)
    orders.set(yscale="log", xlim=(0.0, ORDERS), ylabel="power ÷ noise", xlabel="order per revolution")
    _plain_powers(orders)
    return figure


def _plain_powers(ax: Any) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    low, high = ax.get_ylim()
    ax.set_ylim(min(low, 0.3), max(high, 5.0))
    ax.yaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 1000, 10000]))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())


def _shown(part: Platter, worst: Sequence[Condition]) -> list[int]:
    """Rows of the gyros on the axis and of channels that stand out, four at most."""
    axis = int(np.argmax(np.abs(part.data.up).mean(axis=1)))
    channels = part.channels
    rows = [k for k in range(len(channels.names)) if channels.rates[k] and channels.axis[k] == axis]
    more = [channels.names.index(n) for one in worst if one.stands_out for n in one.channels if n in channels.names]
    return [k for k in dict.fromkeys([*more[: MOST - len(rows)], *rows, *more]) if part.data.usable[k]][:MOST]


def _deviation(part: Platter, row: int, seconds: float) -> float:
    """Standard deviation of a mean over so many seconds, V."""
    variance = part.data.noise[row].covariance(np.zeros(1), np.full(1, seconds))
    return math.sqrt(float(variance[0, 0]))


def _over_time(ax: Any, part: Platter, row: int, left: Array, sensitivity: float, colour: Any) -> None:
    size = max(1, round(SECONDS / part.data.interval))
    sigma = _deviation(part, row, size * part.data.interval) / abs(sensitivity)
    start, name = float(part.data.time[0]), part.channels.names[row]
    label: str | None = f"{name} (noise {_physical(part, row, sigma)})"
    for begin, end in _runs(part):
        whole = (end - begin) // size * size
        if whole:
            t = part.data.time[begin : begin + whole].reshape(-1, size).mean(axis=1) - start
            y = left[begin : begin + whole].reshape(-1, size).mean(axis=1) / sigma
            ax.plot(t, y, linewidth=0.8, marker=".", markersize=2.5, color=colour, label=label)
            label = None


def _physical(part: Platter, row: int, value: float) -> str:
    if part.channels.rates[row]:
        return f"{math.degrees(value):.2g} °/s"
    return f"{value / STANDARD_GRAVITY * 1e3:.2g} mg"


def _runs(part: Platter) -> list[tuple[int, int]]:
    """Neighbouring stretches joined, so that a line is drawn through them."""
    joined: list[tuple[int, int]] = []
    for begin, end in part.data.stretches:
        if joined and joined[-1][1] == begin:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((begin, end))
    return joined


def _holds(part: Platter) -> list[tuple[int, int]]:
    """Stretches at a steady speed."""
    shown = [(hold, part.data.counted.rate[slice(*hold)]) for hold in part.data.stretches]
    return [hold for hold, rate in shown if rate.any() and np.std(rate) < STEADY * abs(rate.mean())]


def _over_angle(ax: Any, part: Platter, row: int, left: Array, sensitivity: float, colour: Any) -> None:
    """Means in bins of the platter's angle, each stretch less its own mean."""
    up = part.data.up[int(np.argmax(np.abs(part.data.up).mean(axis=1)))]
    for sense, style in ((1.0, "-"), (-1.0, "--")):
        holds = [(b, e) for b, e in _holds(part) if np.sign(up[b]) == sense]
        if not holds:
            continue
        values = np.concatenate([left[b:e] - left[b:e].mean() for b, e in holds])
        angle = np.concatenate([part.data.counted.angle[b:e] for b, e in holds]) % (2.0 * math.pi)
        known = np.isfinite(angle)
        place = (angle[known] / (2.0 * math.pi) * BINS).astype(int) % BINS
        count = np.bincount(place, minlength=BINS)
        if not count.all():
            continue
        mean = np.bincount(place, values[known], BINS) / count
        rate = float(np.mean([abs(part.data.counted.rate[b:e].mean()) for b, e in holds]))
        sigma = _bin_deviation(part, row, rate, float(count.mean())) / abs(sensitivity)
        ax.plot((np.arange(BINS) + 0.5) * 360.0 / BINS, mean / sigma, style, linewidth=1.0, color=colour)


def _bin_deviation(part: Platter, row: int, rate: float, count: float) -> float:
    """Standard deviation of a bin's mean, V: noise around the rate's frequency averaged over its windows."""
    f = np.arange(1, 65) / 128.0 / part.data.interval
    f = f[f >= 0.5 * rate / (2.0 * math.pi)]
    density = float(np.mean(part.data.noise[row].density(f)))
    return math.sqrt(density / (2.0 * part.data.interval) / count)


def _by_order(ax: Any, part: Platter, squares: Array, used: Any, colour: Any) -> None:
    """Mean square of what is left, in units of the noise's, in bins of order, over stretches at a steady speed."""
    steady = {part.data.stretches.index(hold) for hold in _holds(part)}
    rate = np.array([abs(float(part.data.counted.rate[b:e].mean())) for b, e in part.data.stretches]) / (2.0 * math.pi)
    inside = used & np.isin(part.of.stretch_of, list(steady)) & (part.of.frequency_of > 0.0)
    order = part.of.frequency_of[inside] / rate[part.of.stretch_of[inside]]
    bins = round(ORDERS / ORDER_BIN)
    place = np.round(order / ORDER_BIN).astype(int)
    near = place <= bins
    count = np.bincount(place[near], minlength=bins + 1)
    total = np.bincount(place[near], squares[inside][near], bins + 1)
    there = count > 0
    ax.plot(np.flatnonzero(there) * ORDER_BIN, total[there] / count[there], linewidth=0.9, color=colour)
