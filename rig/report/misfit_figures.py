"""Figures of where a model fails: what is left over, in units of the noise, over each condition."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.diagnose.misfit import Condition, conditions
from rig.diagnose.misfit_cells import STEADY, tables, turned
from rig.fit.adequacy import domains
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.model import Channels, Local
from rig.motion import Array
from rig.parts.following import Following
from rig.parts.part import Mask
from rig.parts.poses import Posed
from rig.parts.response import Responding
from rig.parts.sines import Sines, split
from rig.parts.turning import Turning
from rig.report import imported_figures
from rig.report.misfit_frame import APART, BAND, legend, new, plain, title
from rig.units import STANDARD_GRAVITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKERS = "ox+s"
SECONDS = 4.0  # of the running mean over time
BINS = 36  # of a revolution
ORDERS = 6.0  # of the spectrum
ORDER_BIN = 0.1
MOST = 4  # channels in a turntable figure
NOISY = 4.0  # times the noise of the best channel


def draw(evidence: Evidence, fit: Fit, folder: Path) -> list[Path]:
    """One figure for every part of a fit, all tables of responses in one, SVG and PNG; the paths, in `folder`."""
    worst = conditions(fit, tables(fit))
    figures: dict[str, Figure] = {}
    for number, part in enumerate(fit.parts):
        mine = [one for one in worst if one.experiment == part.place]
        if isinstance(part, Sines) and np.any(part.data.index >= 0):
            figures[_named("misfit_shaker", figures)] = shaker(fit, number, part, mine)
        elif isinstance(part, Turning):
            figures[_named("misfit_turntable", figures)] = turntable(fit, number, part, mine)
        elif isinstance(part, Following):
            stem = "misfit_rotation" if part.place == "rotation" else "misfit_motion"
            figures[_named(stem, figures)] = imported_figures.following(fit, number, part, mine)
        elif isinstance(part, Posed):
            figures[_named("misfit_poses", figures)] = imported_figures.poses(fit, number, part, mine)
    tables_ = [k for k, part in enumerate(fit.parts) if isinstance(part, Responding)]
    if tables_:
        there = {fit.parts[k].place for k in tables_}
        mine = [one for one in worst if one.experiment in there]
        figures["misfit_response"] = imported_figures.response(fit, tables_, mine)
    return _saved(figures, folder, evidence.simulated)


def _named(stem: str, there: dict[str, Figure]) -> str:
    count = sum(name.startswith(stem) for name in there)
    return f"{stem}_{count + 1}" if count else stem


def _laid_out(figure: Figure) -> None:
    """Once for both files: most of the time of a drawing is its layout."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
    figure.set_layout_engine("none")


def _saved(figures: dict[str, Figure], folder: Path, simulated: bool) -> list[Path]:
    from matplotlib import rc_context

    paths = []
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        _laid_out(figure)
        if simulated:
            figure.text(0.995, 0.005, "SIMULATED", ha="right", va="bottom", color="#b00020", fontsize=9, weight="bold")
        for kind in ("svg", "png"):
            path = folder / f"{name}.{kind}"
            with rc_context({"svg.hashsalt": name}):
                figure.savefig(path, dpi=120, metadata={"Date": None} if kind == "svg" else None)
            paths.append(path)
    return paths


# the shaker


def shaker(fit: Fit, number: int, part: Sines, worst: Sequence[Condition]) -> Figure:
    """Magnitude and phase of the driven line, and the worst of the other lines, over frequency.

    Left in units of the noise, right in per cent, degrees and mm/s². Channels along the drive; others in the last row
    if they stand out there.
    """
    heading = title(f"{part.name.split('#')[0]}, {part.data.axis} driven", worst)
    figure, axes = new(3, 2, (10.0, 8.4), heading, sharex=True)
    left = fit.left[fit.offsets()[number] :][: part.rows]
    driven = turned(fit, part, number, left)[..., 0]
    physical = _relative(fit, number, part)
    along = [
        row
        for row, axis in enumerate(part.channels.axis)
        if part.data.directions[axis, 0] != 0.0 and not part.channels.rates[row]
    ]
    pairs = ((driven.real, 100.0 * physical.real), (driven.imag, np.degrees(physical.imag)))
    precise = _precise(part, along, worst)
    for (a, b), (noise, unit) in zip(axes[:2], pairs, strict=True):
        _points(a, part, noise, along)
        _points(b, part, unit, precise)
    _other(fit, number, part, left, worst, axes[2], along)
    _dressed(axes, part, [part.channels.names[row] for row in along if row not in precise])
    return figure


def _precise(part: Sines, rows: Sequence[int], worst: Sequence[Condition]) -> list[int]:
    """Without channels whose noise would hide the others in physical units, unless they stand out."""
    driven = part.data.index >= 0
    noise = np.sqrt(part.data.variance[:, driven, 1]) / np.abs(part.channels.sensitivity[:, None])
    size = {row: float(np.median(noise[row])) for row in rows}
    loud = {n for one in worst if one.stands_out for n in one.channels}
    least = min(size.values(), default=0.0)
    return [row for row in rows if size[row] <= NOISY * least or part.channels.names[row] in loud]


def _relative(fit: Fit, number: int, part: Sines) -> Any:
    """Driven line, observed ÷ predicted − 1, complex, (c, p): relative magnitude, and phase in rad."""
    wanted = part.raw(_local(fit, number), fit.state.terms)[..., 1]
    with np.errstate(all="ignore"):
        return part.data.observed[..., 1] / wanted - 1.0


def _local(fit: Fit, number: int) -> Local:
    return fit.state.local(fit.parts[number], number)


def _other(
    fit: Fit, number: int, part: Sines, left: Array, worst: Sequence[Condition], axes: Any, along: Sequence[int]
) -> None:
    """The worst component beside the driven line: the mean, a harmonic or hum."""
    known = domains()
    found = next((one for one in worst if one.component in known and one.component != "1f"), None)
    component = found.component if found is not None else "2f"
    rows = [part.channels.names.index(n) for n in found.channels] if found is not None and found.stands_out else along
    place = known.index(component)
    c, p = part.data.usable.shape
    means, lines = split(left, c, p)
    wanted = part.raw(_local(fit, number), fit.state.terms)[..., place]
    unit = np.where(part.channels.rates, 180.0 / math.pi, 1e3) / _local(fit, number).sensitivity
    physical = (part.data.observed[..., place] - wanted) * unit[:, None]
    signed = place == 0
    noise = means if signed else np.abs(lines[..., place - 1]) / math.sqrt(2.0)
    _points(axes[0], part, np.where(np.isfinite(physical), noise, np.nan), rows, signed=signed)
    shown = _precise(part, rows, [found] if found is not None else [])
    _points(axes[1], part, physical.real if signed else np.abs(physical), shown, signed=signed)
    rates = {bool(part.channels.rates[row]) for row in rows}
    units = "°/s" if rates == {True} else "mm/s²" if rates == {False} else "mm/s² or °/s"
    name = {"mean": "mean output"}.get(component, component)
    axes[0].set_ylabel(f"{name} ÷ noise" if signed else f"size of {name} ÷ noise")
    axes[1].set_ylabel(f"{name} / ({units})" if signed else f"size of {name} / ({units})")
    if list(rows) != list(along):
        legend(axes[0], 3)


def _of_level(part: Sines) -> bool:
    """Whether what differs between the records is the level and not the frequency."""
    f = part.data.frequency[part.data.index >= 0]
    return bool(np.ptp(f) < STEADY * f.max() and len(f) > 2)


def _series(part: Sines) -> list[tuple[str, Mask, Array]]:
    """Points that a line joins: the level's name, which records, and where they stand along the axis, (p,)."""
    if _of_level(part):
        return [("", part.data.index >= 0, np.abs(part.data.shown[:, 1]))]
    levels = np.array(part.data.level)
    return [(level, levels == level, part.data.frequency) for level in _levels(part)]


def _levels(part: Sines) -> list[str]:
    """Levels of the drive, the highest first."""
    size = {level: 0.0 for level in part.data.level if level != "rest"}
    for level, shown in zip(part.data.level, np.abs(part.data.shown[:, 1]), strict=True):
        if level in size:
            size[level] = max(size[level], float(shown))
    return sorted(size, key=lambda level: -size[level])


def _points(ax: Any, part: Sines, values: Array, rows: Sequence[int], *, signed: bool = True) -> None:
    for row in rows:
        name = part.channels.names[row]
        for k, (_, some, at) in enumerate(_series(part)):
            mine = some & part.data.usable[row]
            order = np.argsort(at[mine], kind="stable")
            style = {"color": _colour(part.channels, rows, row), "linewidth": 0.7, "alpha": 0.9}
            style |= {"marker": MARKERS[k % len(MARKERS)], "markersize": 4.5, "linestyle": "-" if k == 0 else ":"}
            label = name if k == 0 else None
            ax.plot(at[mine][order], values[row][mine][order], label=label, fillstyle="none", **style)
    if signed:
        ax.axhline(0.0, color="#888888", linewidth=0.7)


def _colour(channels: Channels, rows: Sequence[int], row: int) -> Any:
    """That of the unit; of several channels of a unit, the later ones lighter."""
    from matplotlib.colors import to_rgb

    before = [one for one in rows if channels.titles[one] == channels.titles[row]].index(row)
    base = np.array(to_rgb(channels.colours[row] or APART[row % len(APART)]))
    return tuple((base + (1.0 - base) * 0.3 * before).clip(0.0, 1.0).tolist())


def _dressed(axes: Any, part: Sines, noisy: Sequence[str]) -> None:
    for ax in axes[:, 0]:
        ax.axhspan(-2.0 if ax.get_ylim()[0] < -0.5 else 0.0, 2.0, color=BAND, zorder=0)
    axes[0, 0].set_ylabel("magnitude ÷ noise")
    axes[1, 0].set_ylabel("phase ÷ noise")
    axes[0, 1].set_ylabel("magnitude / %")
    axes[1, 1].set_ylabel("phase / °")
    for ax in axes[2]:
        _along_axis(ax, part)
    legend(axes[0, 0], 4)
    for line in axes[0, 1].get_lines():
        line.set_label(None)
    for k, level in enumerate([] if _of_level(part) else _levels(part)):
        style = {"marker": MARKERS[k % len(MARKERS)], "linestyle": "-" if k == 0 else ":", "color": "#555555"}
        axes[0, 1].plot([], [], fillstyle="none", markersize=4.5, linewidth=0.7, label=f"{level} level", **style)
    if noisy:
        axes[0, 1].plot([], [], " ", label=f"not shown: {', '.join(noisy)} (noisier)")
    if axes[0, 1].get_legend_handles_labels()[0]:
        legend(axes[0, 1], 4)


def _along_axis(ax: Any, part: Sines) -> None:
    if _of_level(part):
        f = float(np.median(part.data.frequency[part.data.index >= 0]))
        ax.set(xlabel=f"amplitude of the reference at {f:.3g} Hz / (m/s²)", xlim=(0.0, None))
    else:
        ax.set(xscale="log", xlabel="frequency / Hz")
        plain(ax.xaxis)


# the turntable


def turntable(fit: Fit, number: int, part: Turning, worst: Sequence[Condition]) -> Figure:
    """Gyros on the axis, and what stands out, over time, over a revolution, and by order per revolution."""
    figure, axes = new(3, 1, (10.0, 9.0), title(part.name.split("#")[0], worst))
    time, angle, orders = axes[:, 0]
    local = _local(fit, number)
    left = (part.data.observed - part.raw(local, fit.state.terms)) / local.sensitivity[:, None]
    whitened = fit.left[fit.offsets()[number] :][: part.rows].reshape(len(part.channels.names), -1)
    rows = _shown(part, worst)
    for row in rows:
        colour = _colour(part.channels, rows, row)
        _over_time(time, part, row, left[row], float(local.sensitivity[row]), colour)
        _over_angle(angle, part, row, left[row], float(local.sensitivity[row]), colour)
        _by_order(orders, part, whitened[row] ** 2, part.counted.reshape(whitened.shape)[row], colour)
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


def _shown(part: Turning, worst: Sequence[Condition]) -> list[int]:
    """Rows of the gyros on the axis and of channels that stand out, four at most."""
    axis = int(np.argmax(np.abs(part.data.up).mean(axis=1)))
    channels = part.channels
    rows = [k for k in range(len(channels.names)) if channels.rates[k] and channels.axis[k] == axis]
    more = [channels.names.index(n) for one in worst if one.stands_out for n in one.channels if n in channels.names]
    return [k for k in dict.fromkeys([*more[: MOST - len(rows)], *rows, *more]) if part.data.usable[k]][:MOST]


def _deviation(part: Turning, row: int, seconds: float) -> float:
    """Standard deviation of a mean over so many seconds, V."""
    variance = part.data.noise[row].covariance(np.zeros(1), np.full(1, seconds))
    return math.sqrt(float(variance[0, 0]))


def _over_time(ax: Any, part: Turning, row: int, left: Array, sensitivity: float, colour: Any) -> None:
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


def _physical(part: Turning, row: int, value: float) -> str:
    if part.channels.rates[row]:
        return f"{math.degrees(value):.2g} °/s"
    return f"{value / STANDARD_GRAVITY * 1e3:.2g} mg"


def _runs(part: Turning) -> list[tuple[int, int]]:
    """Neighbouring stretches joined, so that a line is drawn through them."""
    joined: list[tuple[int, int]] = []
    for begin, end in part.data.stretches:
        if joined and joined[-1][1] == begin:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((begin, end))
    return joined


def _holds(part: Turning) -> list[tuple[int, int]]:
    """Stretches at a steady speed."""
    shown = [(hold, part.data.counted.rate[slice(*hold)]) for hold in part.data.stretches]
    return [hold for hold, rate in shown if rate.any() and np.std(rate) < STEADY * abs(rate.mean())]


def _over_angle(ax: Any, part: Turning, row: int, left: Array, sensitivity: float, colour: Any) -> None:
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


def _bin_deviation(part: Turning, row: int, rate: float, count: float) -> float:
    """Standard deviation of a bin's mean, V: noise around the rate's frequency averaged over its windows."""
    f = np.arange(1, 65) / 128.0 / part.data.interval
    f = f[f >= 0.5 * rate / (2.0 * math.pi)]
    density = float(np.mean(part.data.noise[row].density(f)))
    return math.sqrt(density / (2.0 * part.data.interval) / count)


def _by_order(ax: Any, part: Turning, squares: Array, used: Any, colour: Any) -> None:
    """Mean square of what is left, in units of the noise's, in bins of order, over stretches at a steady speed."""
    steady = {part.data.stretches.index(hold) for hold in _holds(part)}
    rate = np.array([abs(float(part.data.counted.rate[b:e].mean())) for b, e in part.data.stretches]) / (2.0 * math.pi)
    inside = used & np.isin(part.stretch_of, list(steady)) & (part.frequency_of > 0.0)
    order = part.frequency_of[inside] / rate[part.stretch_of[inside]]
    bins = round(ORDERS / ORDER_BIN)
    place = np.round(order / ORDER_BIN).astype(int)
    near = place <= bins
    count = np.bincount(place[near], minlength=bins + 1)
    total = np.bincount(place[near], squares[inside][near], bins + 1)
    there = count > 0
    ax.plot(np.flatnonzero(there) * ORDER_BIN, total[there] / count[there], linewidth=0.9, color=colour)
