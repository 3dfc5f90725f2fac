"""Figures of what a model leaves over of imported data: a table of responses, a followed motion, poses and turns."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from rig.diagnose.misfit import Condition
from rig.fit.fit import Fit
from rig.motion import Array
from rig.parts.poses import GRAVITY, Poses
from rig.parts.remainder import Mask
from rig.parts.response import ResponseTable
from rig.parts.track import TrackedMotion
from rig.report.misfit_frame import APART, BAND, legend, new, plain, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKERS = "os^Dv*"
COVERAGE = 2.0  # standard deviations, of bands and bars
NOISE = f"±{COVERAGE:g} σ of the noise"
WIDE = 50  # characters, that fit above one of two axes beside each other
CYCLES = 6.0  # of the motion, in the stretch of time that is shown
SHORTEST, LONGEST = 2.0, 10.0  # s, of that stretch
NOWHERE = 0.1  # of the noise: motion that is not drawn
PER_DECADE = 10.0  # bins of a spectrum
HELD: dict[str, Any] = {
    "facecolor": "none",
    "edgecolor": "#999999",
    "hatch": "///",
    "linewidth": 0.0,
    "alpha": 0.5,
    "zorder": 0,
}
LEFT_OUT: dict[str, Any] = {"color": "#b00020", "alpha": 0.3, "linewidth": 0.0, "zorder": 0}
FAINT = {"color": "#888888", "linewidth": 0.7}


def _left(fit: Fit, number: int) -> Array:
    """What is left over of a part, in standard deviations, (rows,)."""
    return fit.left[fit.offsets()[number] :][: fit.parts[number].rows]


# tables of frequency responses


@dataclass(frozen=True)
class Response:
    """A table's mean response at f frequencies (Hz): `size` and `phase` (rad, unwrapped) as measured, (f,); `left` of
    the logarithm over the model, real and imaginary (2, f), with standard uncertainties `u` (2, f). Single repeats are
    `apart` (2, p) from their mean, at the frequencies number `place` (p,).
    """

    frequency: Array
    size: Array
    phase: Array
    left: Array
    u: Array
    apart: Array
    place: np.ndarray[tuple[int], np.dtype[np.intp]]


def response_of(part: ResponseTable, left: Array) -> Response:
    """The means of a table from what is left over of its rows in standard deviations, (rows,)."""
    data, kinds = part.data, part.domains()
    first = np.flatnonzero(kinds["magnitude"][0::2])
    count = np.diff([*first, len(data.frequency)])
    place = np.repeat(np.arange(len(first)), count)
    ratio = data.ratio * np.sign(part.channels.sensitivity[0])
    mean = np.add.reduceat(ratio, first) / count
    rows = np.stack([np.flatnonzero(kinds[name]) for name in ("magnitude", "phase")])
    u = np.sqrt(part.noise()[0][rows] / count) / np.abs(mean)
    size = np.exp(np.add.reduceat(np.log(np.abs(ratio)), first) / count)
    apart = np.stack([np.log(np.abs(ratio) / size[place]), np.angle(ratio * np.conj(mean[place]))])
    return Response(data.frequency[first], size, np.unwrap(np.angle(mean)), left[rows] * u, u, apart, place)


def response(fit: Fit, numbers: Sequence[int], worst: Sequence[Condition]) -> Figure:
    """Every table of frequency responses in one figure: magnitude and phase, and below what the model leaves over."""
    parts = [cast(ResponseTable, fit.parts[number]) for number in numbers]
    figure, axes = new(2, 2, (10.0, 6.6), title("Frequency response", worst), sharex=True)
    labels = _labels(parts)
    for k, (label, part, number) in enumerate(zip(labels, parts, numbers, strict=True)):
        shown = response_of(part, _left(fit, number))
        style = {"color": APART[k % len(APART)], "marker": MARKERS[k % len(MARKERS)], "markersize": 3.5}
        _measured(axes[0], shown, label, style)
        _left_over(axes[1], shown, style)
    axes[0, 0].plot([], [], color="#555555", linewidth=1.0, label="model")
    legend(axes[0, 0], 3 if sum(len(one) for one in labels) < WIDE else 1)
    _dress_response(axes)
    return figure


def _labels(parts: Sequence[ResponseTable]) -> list[str]:
    """The run, the channel where they differ, and the number of the table where that is still not enough."""
    several = len({part.channels.names[0] for part in parts}) > 1
    said = [f"{part.run}, {part.channels.names[0]}" if several else part.run for part in parts]
    return [f"{one} ({said[:k].count(one) + 1})" if said.count(one) > 1 else one for k, one in enumerate(said)]


def _measured(axes: Any, shown: Response, label: str, style: dict[str, Any]) -> None:
    """Measured means with their uncertainty, and the model as a line."""
    sizes = (shown.size, COVERAGE * shown.u[0] * shown.size, shown.size / np.exp(shown.left[0]))
    phases = [np.degrees(v) for v in (shown.phase, COVERAGE * shown.u[1], shown.phase - shown.left[1])]
    for ax, (values, bars, model) in zip(axes, (sizes, phases), strict=True):
        ax.plot(shown.frequency, model, color=style["color"], linewidth=1.0)
        bar = {"linestyle": "none", "elinewidth": 0.9, "capsize": 2.0, "fillstyle": "none"}
        ax.errorbar(shown.frequency, values, yerr=bars, label=label, **bar, **style)


def _left_over(axes: Any, shown: Response, style: dict[str, Any]) -> None:
    """Means less the model in % and °, single repeats as dots, and the band of the noise."""
    single = shown.left[:, shown.place] + shown.apart
    values = (100.0 * np.expm1(shown.left[0]), np.degrees(shown.left[1]))
    dots = (100.0 * np.expm1(single[0]), np.degrees(single[1]))
    bands = (100.0 * COVERAGE * shown.u[0], np.degrees(COVERAGE * shown.u[1]))
    for ax, value, dot, band in zip(axes, values, dots, bands, strict=True):
        shade = {"color": style["color"], "alpha": 0.18, "linewidth": 0.0, "zorder": 0}
        ax.fill_between(shown.frequency, -band, band, label=NOISE, **shade)
        if len(shown.place) > len(shown.frequency):
            faint = {"color": style["color"], "markersize": 2.0, "alpha": 0.4, "label": "repeats"}
            ax.plot(shown.frequency[shown.place], dot, ".", **faint)
        ax.plot(shown.frequency, value, linewidth=0.8, fillstyle="none", **style)


def _dress_response(axes: Any) -> None:
    axes[0, 0].set_ylabel("magnitude: output ÷ reference")
    axes[0, 1].set_ylabel("phase / °")
    axes[1, 0].set_ylabel("measured ÷ model − 1 / %")
    axes[1, 1].set_ylabel("phase, measured − model / °")
    for ax in axes[1]:
        ax.axhline(0.0, **FAINT)
        ax.set(xscale="log", xlabel="frequency / Hz")
        plain(ax.xaxis)
    legend(axes[1, 0], 4)


# motion that a reference followed


@dataclass(frozen=True)
class Followed:
    """Lines of k channels of one quantity within the band, SI: `measured`, `model`, `motion`, and the `variance` of
    the noise, all (k, width); the channels' `names`; `inside` (width,) the lines that are compared.
    """

    names: tuple[str, ...]
    axis: tuple[int, ...]
    measured: Array
    model: Array
    motion: Array
    variance: Array
    inside: Mask

    @property
    def error(self) -> Array:
        return np.asarray(self.measured - self.model)


def followed_of(fit: Fit, number: int, part: TrackedMotion, *, rates: bool) -> Followed | None:
    """The gyros or the accelerometers of a part; None if there are none."""
    rows = np.flatnonzero(part.channels.rates == rates)
    if not len(rows):
        return None
    local, channels = fit.state.local(part, number), part.channels
    inside = part.counted.reshape(len(channels.names), -1)[rows[0]]
    zero, sensitivity = local.zero[rows, None], local.sensitivity[rows, None]
    volts = part.raw(local, fit.state.terms)[rows]
    moved = part.moved(fit.state.terms)
    own = (moved.rate if rates else moved.force)[channels.axis[rows]]
    signals = [(part.data.observed[rows] - zero) / sensitivity, (volts - zero) / sensitivity, own]
    if part.data.kept is not None:  # where nothing counts there is no error either
        signals[0] = np.where(part.data.kept[rows], signals[0], signals[1])
    measured, model, motion = (part.lines(one) * inside for one in signals)
    names, axis = tuple(channels.names[row] for row in rows), tuple(channels.axis[rows].tolist())
    return Followed(names, axis, measured, model, motion, part.variance[rows] / sensitivity**2, inside)


def following(fit: Fit, number: int, part: TrackedMotion, worst: Sequence[Condition]) -> Figure:
    """Gyros and accelerometers, a column each: a stretch of time of the worst axis, what is left over, and spectra."""
    found = [(rates, followed_of(fit, number, part, rates=rates)) for rates in (True, False)]
    there = [(rates, one) for rates, one in found if one is not None]
    figure, axes = new(3, len(there), (10.0, 9.0), title(part.run, worst))
    for column, (rates, one) in zip(axes.T, there, strict=True):
        _over_time(column[:2], part, one, rates=rates)
        _spectra(column[2], part, one, rates=rates)
    return figure


def _unit(rates: bool) -> tuple[float, str]:
    """Numbers per SI unit, and the unit."""
    return (180.0 / math.pi, "°/s") if rates else (1.0, "m/s²")


def _over_time(axes: Any, part: TrackedMotion, one: Followed, *, rates: bool) -> None:
    """The channel with the largest error while its motion is strongest, within the compared band."""
    row = int(np.argmax(np.sum(one.error**2, axis=1)))
    scale, unit = _unit(rates)
    some = _strongest(part, one.measured[row])
    instants = np.concatenate([part.data.time[b:e] for b, e in part.data.stretches])[some]
    measured, model = (scale * _signal(part, lines[row])[some] for lines in (one.measured, one.model))
    spans = list(_left_out(part, one.names[row], some))
    for since, until in spans:  # what lies there is made up
        measured[(instants >= since) & (instants <= until)] = math.nan
    colour = _of_axis(one, row)
    top, below = axes
    top.plot(instants, measured, color=colour, linewidth=2.2, alpha=0.45, label=f"{one.names[row]}: measured")
    top.plot(instants, model, color="#222222", linewidth=0.9, label="model")
    count = sum(end - begin for begin, end in part.data.stretches)
    band = COVERAGE * scale * math.sqrt(float(np.sum(one.variance[row, one.inside])) / count)
    below.axhspan(-band, band, color=BAND, zorder=0, label=NOISE)
    below.axhline(0.0, **FAINT)
    below.plot(instants, measured - model, color=colour, linewidth=1.0)
    _marked(axes, part, some, spans)
    limit = part.data.bands[0 if rates else 1]
    top.set(ylabel=f"{one.names[row]} / ({unit})")
    below.set(ylabel=f"measured − model / ({unit})", xlabel=f"time in the file / s (up to {limit:.3g} Hz)")
    below.sharex(top)
    below.locator_params(axis="x", nbins=7)
    legend(top, 2)
    legend(below, 1)


def _marked(axes: Any, part: TrackedMotion, some: slice, spans: Sequence[tuple[float, float]]) -> None:
    """Among the instants that are shown: pieces held out, and what was left out."""
    data, (top, below) = part.data, axes
    place, first, last = _shown(part, some)
    for begin, end in (data.stretches[k] for k in np.flatnonzero(data.held).tolist()):
        if begin <= place[-1] and end > place[0]:
            span = max(float(data.time[begin]), first), min(float(data.time[end - 1]), last)
            below.axvspan(*span, label="held out", **HELD)
    for since, until in spans:
        top.axvspan(since, until, label="left out", **LEFT_OUT)


def _shown(part: TrackedMotion, some: slice) -> tuple[Array, float, float]:
    """Instants that are shown by number, and the time of the first and of the last, s."""
    place = np.concatenate([np.arange(begin, end) for begin, end in part.data.stretches])[some]
    return place, float(part.data.time[place[0]]), float(part.data.time[place[-1]])


def _left_out(part: TrackedMotion, channel: str, some: slice) -> Iterator[tuple[float, float]]:
    """From when to when rows of the channel or the reference were left out among the instants that are shown, s."""
    data, (place, first, last) = part.data, _shown(part, some)
    record = int(np.searchsorted([end for _, end in data.records], place[0], side="right"))
    for finding in part.faults:
        other = finding.channel != channel and finding.channel in part.channels.names
        if finding.where in data.files[record : record + 1] and not other:
            for since, until in finding.times:
                if since <= last and until >= first:
                    yield since - data.interval, until + data.interval


def _of_axis(one: Followed, row: int) -> str:
    """The axis' colour; of a second channel along it, another."""
    before = one.axis[:row].count(one.axis[row])
    return APART[(one.axis[row] + 3 * before) % len(APART)]


def _signal(part: TrackedMotion, lines: Array) -> Array:
    """The signal that has these lines, stretch after stretch, (n,)."""
    from scipy.fft import idct

    found = []
    for k, (begin, end) in enumerate(part.data.stretches):
        found.append(idct(lines[part.stretch_of == k], type=2, norm="ortho", n=end - begin))
    return np.concatenate(found)


def _strongest(part: TrackedMotion, lines: Array) -> slice:
    """Some seconds among the stretches' instants, without a gap, in which the signal of these lines varies most."""
    f = part.frequency_of
    square = lines**2 * (f > 0.0)
    typical = math.sqrt(float(np.sum(square * f**2)) / max(float(np.sum(square)), 1e-30))
    seconds = float(np.clip(CYCLES / max(typical, 1e-9), SHORTEST, LONGEST))
    size = min(round(seconds / part.data.interval), max(end - begin for begin, end in part.data.stretches))
    place = np.concatenate([np.arange(begin, end) for begin, end in part.data.stretches])
    total = np.concatenate([[0.0], np.cumsum(_signal(part, lines * (f > 0.0)) ** 2)])
    power = total[size:] - total[:-size]
    power[place[size - 1 :] - place[: len(place) - size + 1] != size - 1] = -1.0
    begin = int(np.argmax(power))
    return slice(begin, begin + size)


def _spectra(ax: Any, part: TrackedMotion, one: Followed, *, rates: bool) -> None:
    """Amplitude spectral densities of every channel: error, motion, and noise as a band as wide as it is uncertain."""
    scale, unit = _unit(rates)
    spread = np.sqrt(1.0 + COVERAGE * part.allowance * np.array([[-1.0], [1.0]]))
    lowest = math.inf
    for row, name in enumerate(one.names):
        colour, power = _of_axis(one, row), np.stack([one.error[row] ** 2, one.motion[row] ** 2, one.variance[row]])
        f, (error, motion, noise) = _density(part, one.inside, scale**2 * power)
        ax.fill_between(f, *(noise * spread), color=colour, alpha=0.25, linewidth=0.0, zorder=0)
        ax.plot(f, error, color=colour, linewidth=1.2, marker=MARKERS[row % 3], markersize=2.5, label=name)
        if motion.max() > NOWHERE * noise.min():
            ax.plot(f, np.where(motion > 0.0, motion, np.nan), ":", color=colour, linewidth=1.0)
        lowest = min(lowest, float(noise.min()), float(error.min()))
    ax.fill_between([], [], color="#bbbbbb", linewidth=0.0, label="noise")
    ax.plot([], [], ":", color="#555555", label="motion")
    ax.set(xscale="log", yscale="log", xlabel="frequency / Hz", ylabel=f"density / ({unit}/√Hz)")
    ax.set_ylim(bottom=0.5 * lowest)
    plain(ax.xaxis)
    plain(ax.yaxis)
    legend(ax, 5)


def _density(part: TrackedMotion, inside: Mask, power: Array) -> tuple[Array, Array]:
    """Frequency of bins, Hz, (bins,), and amplitude spectral densities, one-sided, unit/√Hz, (k, bins).

    `power` (k, width) of cosine lines, which is density ÷ 2·interval (orthonormal transform).
    """
    moving = inside & (part.frequency_of > 0.0)
    f = part.frequency_of[moving]
    _, place = np.unique(np.floor(np.log10(f) * PER_DECADE), return_inverse=True)
    count = np.bincount(place)
    mean = np.array([np.bincount(place, one[moving]) for one in power]) / count
    return 10.0 ** (np.bincount(place, np.log10(f)) / count), np.sqrt(2.0 * part.data.interval * mean)


# poses and turns


@dataclass(frozen=True)
class Stood:
    """What is left over of n poses and turns, SI: `gravity` m/s² and its noise `u`, (n,), empty without a triad; `rate`
    rad/s of k gyros with `u_rate`, (k, n); NaN where nothing is compared. `gyros` are their rows among the channels.
    """

    gravity: Array
    u: Array
    rate: Array
    u_rate: Array
    gyros: tuple[int, ...]
    turned: Mask


def stood_of(fit: Fit, number: int, part: Poses) -> Stood:
    """The same rows in units that a person reads."""
    counted = part.counted.reshape(len(part.row_names), -1)
    left = np.where(counted, part.residual(_left(fit, number)), np.nan)
    u = np.sqrt(part.noise())
    turned = np.any(part.data.turn != 0.0, axis=0)
    triad = GRAVITY in part.row_names
    g = part.data.gravity
    above = g * np.expm1(left[0] / g) if triad else np.zeros(0)
    gyros = tuple(part.channels.of("rate").tolist())
    given = part.channels.sensitivity[list(gyros)]
    used = fit.state.local(part, number).sensitivity[list(gyros)]
    size = u[len(u) - len(gyros) :] * np.abs(given / used)[:, None]
    rate = left[len(u) - len(gyros) :] / used[:, None]
    return Stood(above, u[0] if triad else np.zeros(0), rate, size, gyros, turned)


def poses(fit: Fit, number: int, part: Poses, worst: Sequence[Condition]) -> Figure:
    """Magnitude of gravity and rates at rest over the poses, and the angles that known turns are off."""
    shown = stood_of(fit, number, part)
    still = ~shown.turned
    panels = [
        *([_gravities] if len(shown.gravity) and still.any() else []),
        *([_rests] if shown.gyros and still.any() else []),
        *([_turns] if shown.gyros and shown.turned.any() else []),
    ]
    figure, axes = new(len(panels), 1, (10.0, 0.6 + 2.9 * len(panels)), title(part.run, worst))
    for ax, panel in zip(axes[:, 0], panels, strict=True):
        panel(ax, part, shown)
        ax.axhline(0.0, **FAINT)
    return figure


def _gravities(ax: Any, part: Poses, shown: Stood) -> None:
    """|a| − g over the poses, by the axis that is upright."""
    still = np.flatnonzero(~shown.turned)
    pose = np.arange(1.0, len(still) + 1.0)
    _band(ax, pose, shown.u[still])
    ax.plot(pose, shown.gravity[still], linewidth=0.7, color="#bbbbbb", zorder=1)
    for cut in part.cuts():
        mine = cut.mask[still]
        if cut.kind == "attitude" and mine.any():
            style = _attitude(cut.words)
            ax.plot(pose[mine], shown.gravity[still][mine], linestyle="none", markersize=5.0, label=cut.words, **style)
    ax.set(ylabel="magnitude − g / (m/s²)", xlabel="pose")
    _counted(ax, len(still))
    legend(ax, 8)


def _attitude(words: str) -> dict[str, str]:
    """Colour by the axis, marker by which end of it is up."""
    for k, axis in enumerate("xyz"):
        if words.startswith((f"+{axis}", f"−{axis}")):
            return {"color": APART[k], "marker": "^" if words[0] == "+" else "v"}
    return {"color": "#555555", "marker": "o", "fillstyle": "none"}


def _band(ax: Any, pose: Array, u: Array) -> None:
    edges = np.concatenate([[pose[0] - 0.5], pose + 0.5])
    height = COVERAGE * np.concatenate([u, u[-1:]])
    ax.fill_between(edges, -height, height, step="post", color=BAND, linewidth=0.0, zorder=0, label=NOISE)


def _counted(ax: Any, count: int) -> None:
    from matplotlib.ticker import MaxNLocator

    ax.set_xlim(0.5, count + 0.5)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=20, integer=True))


def _rests(ax: Any, part: Poses, shown: Stood) -> None:
    """What the gyros show at rest, less their zeros."""
    still = np.flatnonzero(~shown.turned)
    pose = np.arange(1.0, len(still) + 1.0)
    _band(ax, pose, np.degrees(shown.u_rate[:, still].max(axis=0)))
    for k, row in enumerate(shown.gyros):
        style = {"color": APART[int(part.channels.axis[row])], "marker": MARKERS[k % 3], "fillstyle": "none"}
        ax.plot(pose, np.degrees(shown.rate[k, still]), linewidth=0.7, markersize=4.0, label=part.channels.names[row],
                **style)  # fmt: skip
    ax.set(ylabel="rate at rest / (°/s)", xlabel="pose")
    _counted(ax, len(still))
    legend(ax, 4)


def _turns(ax: Any, part: Poses, shown: Stood) -> None:
    """What every gyro integrates to over a turn about its own axis, less the known angle."""
    turns = np.flatnonzero(shown.turned)
    about = np.abs(part.data.turn[:, turns]).argmax(axis=0)
    for k, row in enumerate(shown.gyros):
        axis = int(part.channels.axis[row])
        mine = np.flatnonzero(about == axis)
        if len(mine):
            seconds = part.data.seconds[turns[mine]]
            off, bar = (np.degrees(one[k, turns[mine]] * seconds) for one in (shown.rate, shown.u_rate))
            style = {"color": APART[axis], "marker": MARKERS[k % 3], "fillstyle": "none", "linestyle": "none"}
            ax.errorbar(mine, off, yerr=COVERAGE * bar, capsize=3.0, markersize=5.0, label=part.channels.names[row],
                        **style)  # fmt: skip
    angles = [math.degrees(part.data.turn[a, k]) for a, k in zip(about, turns, strict=True)]
    named = [f"{'xyz'[a]}, {one:+.4g}°".replace("-", "−") for a, one in zip(about, angles, strict=True)]
    ax.set(ylabel="shown − known angle / °", xlabel=f"turn (bars: ±{COVERAGE:g} σ of noise, angle and axis)")
    ax.set_xticks(range(len(turns)), named)
    ax.set_xlim(-0.5, len(turns) - 0.5)
    legend(ax, 4)
