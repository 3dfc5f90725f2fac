"""Figure of what a model leaves over of a sweep: over frequency, or over the level where only that differs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.diagnose.misfit import Condition
from rig.fit.fit import Fit
from rig.motion import Array
from rig.parts.remainder import Mask
from rig.parts.sweep import Sweep
from rig.parts.sweep_cuts import turned
from rig.parts.sweep_records import domains, split
from rig.report.misfit_frame import BAND, colour, legend, new, plain, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKERS = "ox+s"
NOISY = 4.0  # times the noise of the best channel
STEADY = 0.02  # of the frequency


def shaker(fit: Fit, number: int, part: Sweep, worst: Sequence[Condition]) -> Figure:
    """Magnitude and phase of the driven line, and the worst of the other lines, over frequency.

    Left in units of the noise, right in per cent, degrees and mm/s². Channels along the drive; others in the last row
    if they stand out there.
    """
    heading = title(f"{part.name.split('#')[0]}, {part.data.axis} driven", worst)
    figure, axes = new(3, 2, (10.0, 8.4), heading, sharex=True)
    left = fit.left[fit.offsets()[number] :][: part.rows]
    driven = turned(part.data, fit.rest(number))[..., 0]
    physical = _relative(fit, number, part)
    along = part.data.along.tolist()
    pairs = ((driven.real, 100.0 * physical.real), (driven.imag, np.degrees(physical.imag)))
    precise = _precise(part, along, worst)
    for (a, b), (noise, unit) in zip(axes[:2], pairs, strict=True):
        _points(a, part, noise, along)
        _points(b, part, unit, precise)
    _other(fit, number, part, left, worst, axes[2], along)
    _dressed(axes, part, [part.channels.names[row] for row in along if row not in precise])
    return figure


def _precise(part: Sweep, rows: Sequence[int], worst: Sequence[Condition]) -> list[int]:
    """Without channels whose noise would hide the others in physical units, unless they stand out."""
    driven = part.data.index >= 0
    noise = np.sqrt(part.data.variance[:, driven, 1]) / np.abs(part.channels.sensitivity[:, None])
    size = {row: float(np.median(noise[row])) for row in rows}
    loud = {n for one in worst if one.stands_out for n in one.channels}
    least = min(size.values(), default=0.0)
    return [row for row in rows if size[row] <= NOISY * least or part.channels.names[row] in loud]


def _relative(fit: Fit, number: int, part: Sweep) -> Any:
    """Driven line, observed ÷ predicted − 1, complex, (c, p): relative magnitude, and phase in rad."""
    wanted = part.raw(fit.state.local(part, number), fit.state.terms)[..., 1]
    with np.errstate(all="ignore"):
        return part.data.observed[..., 1] / wanted - 1.0


def _other(
    fit: Fit, number: int, part: Sweep, left: Array, worst: Sequence[Condition], axes: Any, along: Sequence[int]
) -> None:
    """The worst component beside the driven line: the mean, a harmonic or hum."""
    known = domains()
    found = next((one for one in worst if one.component in known and one.component != "1f"), None)
    component = found.component if found is not None else "2f"
    rows = [part.channels.names.index(n) for n in found.channels] if found is not None and found.stands_out else along
    place = known.index(component)
    c, p = part.data.usable.shape
    means, lines = split(left, c, p)
    wanted = part.raw(fit.state.local(part, number), fit.state.terms)[..., place]
    unit = np.where(part.channels.rates, 180.0 / math.pi, 1e3) / fit.state.local(part, number).sensitivity
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


def _of_level(part: Sweep) -> bool:
    """Whether what differs between the records is the level and not the frequency."""
    f = part.data.frequency[part.data.index >= 0]
    return bool(np.ptp(f) < STEADY * f.max() and len(f) > 2)


def _series(part: Sweep) -> list[tuple[str, Mask, Array]]:
    """Points that a line joins: the level's name, which records, and where they stand along the axis, (p,)."""
    if _of_level(part):
        return [("", part.data.index >= 0, np.abs(part.data.shown[:, 1]))]
    levels = np.array(part.data.level)
    return [(level, levels == level, part.data.frequency) for level in _levels(part)]


def _levels(part: Sweep) -> list[str]:
    """Levels of the drive, the highest first."""
    size = {level: 0.0 for level in part.data.level if level != "rest"}
    for level, shown in zip(part.data.level, np.abs(part.data.shown[:, 1]), strict=True):
        if level in size:
            size[level] = max(size[level], float(shown))
    return sorted(size, key=lambda level: -size[level])


def _points(ax: Any, part: Sweep, values: Array, rows: Sequence[int], *, signed: bool = True) -> None:
    for row in rows:
        name = part.channels.names[row]
        for k, (_, some, at) in enumerate(_series(part)):
            mine = some & part.data.usable[row]
            order = np.argsort(at[mine], kind="stable")
            style = {"color": colour(part.channels, rows, row), "linewidth": 0.7, "alpha": 0.9}
            style |= {"marker": MARKERS[k % len(MARKERS)], "markersize": 4.5, "linestyle": "-" if k == 0 else ":"}
            label = name if k == 0 else None
            ax.plot(at[mine][order], values[row][mine][order], label=label, fillstyle="none", **style)
    if signed:
        ax.axhline(0.0, color="#888888", linewidth=0.7)


def _dressed(axes: Any, part: Sweep, noisy: Sequence[str]) -> None:
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


def _along_axis(ax: Any, part: Sweep) -> None:
    if _of_level(part):
        f = float(np.median(part.data.frequency[part.data.index >= 0]))
        ax.set(xlabel=f"amplitude of the reference at {f:.3g} Hz / (m/s²)", xlim=(0.0, None))
    else:
        ax.set(xscale="log", xlabel="frequency / Hz")
        plain(ax.xaxis)
