"""The paper's figures 4, 5, 7, 8 and 9 drawn from runs, and what a calibration shows beside them.

Each function gives a `Drawing`, or None if the runs do not hold what it shows.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, Signals, signals_of, wires_of
from rig.calibrate import paper_method
from rig.calibrate.calibration import AnalyzerPoint, Calibration, Result, text
from rig.calibrate.paper_method import (
    AVERAGED,
    CROSS_AXIS,
    NOMINAL_ZERO,
    axis_sign,
    held,
    volts_about_zero,
)
from rig.printed import DEGREE
from rig.record import Samples
from rig.sensor import Sensor, SensorChannel
from rig.signals.rotation import Edges, Track, edges_of, encoder_settings, graduation_map

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
MILLI = 1e3 * DEGREE  # V/(rad/s) to mV/(°/s)
INK, GREY, OURS, PAPERS = "#1c2b3a", "#9aa5b1", "#1f5fa8", "#c2571a"
AXES = {"x": "#1f5fa8", "y": "#c2571a", "z": "#3c8a4a"}
DOTS = 1500  # drawn of a long record, so that the page stays small
CYCLES = 4.0
ARCSECOND = math.pi / 648_000.0  # rad
LONGEST = 300.0  # s of one record that is drawn
STYLE: Any = {
    "svg.hashsalt": "rig",
    "svg.fonttype": "path",
    "font.size": 9,
    "axes.edgecolor": "#7b8794",
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8,
}


@dataclass(frozen=True)
class Drawing:
    """A figure and what it shows: `caption` names the run and the record."""

    figure: Figure
    caption: str


def svg(figure: Figure, simulated: bool) -> str:
    """The figure as SVG to stand in a page, the same for the same figure; marked if its data were simulated."""
    import matplotlib as mpl

    if simulated:
        figure.text(0.5, 0.5, "SIMULATED", ha="center", va="center", color="#b00020", alpha=0.09, fontsize=44,
                    rotation=18, weight="bold")  # fmt: skip
    drawn = io.StringIO()
    with mpl.rc_context(STYLE):
        figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None})
    whole = drawn.getvalue()
    # ids that nothing refers to would occur once per figure in one page
    return re.sub(r' id="[A-Za-z0-9_.]+_\d+"', "", whole[whole.index("<svg") :])


def _new(rows: int = 1, height: float = 3.4, shared: bool = True) -> tuple[Figure, Any]:
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.6, height), layout="constrained")
        axes = figure.subplots(rows, 1, sharex=shared, squeeze=False)[:, 0]
        for ax in axes:
            ax.grid(True, color="#e3e8ee", linewidth=0.7)
            ax.set_axisbelow(True)
            ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _legend(ax: Any, **how: Any) -> None:
    """Beside the data, above the axes: never over them."""
    how = {"ncols": 3, "frameon": False, "fontsize": 8, "borderaxespad": 0.2, **how}
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), **how)


# ---------------------------------------------------------------- the shaker


@dataclass(frozen=True)
class _Sine:
    run: Recorded
    body: Mapping[str, Any]
    signals: Signals

    @property
    def where(self) -> str:
        return f"run {self.run.name}, record “{self.body.get('label', self.body.get('samples', ''))}”"

    def cycles(self, name: str) -> tuple[Array, Array]:
        """The first few cycles: milliseconds and volts."""
        count = max(8, math.ceil(CYCLES / float(self.body["frequency"]) * self.signals.rate))
        skew = float(self.signals.skew[self.signals.column(name)])
        times = self.signals.instants[:count] + skew - self.signals.instants[0]
        return times * 1e3, self.signals.of(name)[:count]


def _nearest_sine(runs: Sequence[Recorded]) -> _Sine | None:
    """The strongest record with the vibrometer nearest to 67 Hz."""
    points = [(run, body) for run in runs for body in run.points.values() if "frequency" in body]
    points.sort(key=lambda p: (abs(float(p[1]["frequency"]) - CROSS_AXIS), -float(p[1]["source"])))
    for run, body in points:
        found = signals_of(run, body)
        if found is not None and wires_of(run).reference in found.names:
            return _Sine(run, body, found)
    return None


def figure_4(runs: Sequence[Recorded]) -> Drawing | None:
    """Velocity from the vibrometer over a few cycles."""
    sine = _nearest_sine(runs)
    if sine is None:
        return None
    times, volts = sine.cycles(wires_of(sine.run).reference)
    figure, (ax,) = _new(height=2.9)
    ax.plot(times, volts * float(sine.body["scale"]) * 1e3, "o-", color=OURS, linewidth=1.3, markersize=2.5)
    ax.set(xlabel="time / ms", ylabel="velocity / (mm/s)")
    ax.margins(x=0.01)
    return Drawing(
        figure,
        f"Output of the reference: velocity from the vibrometer at {float(sine.body['frequency']):.2f} Hz along "
        f"{sine.body['axis']}, {CYCLES:g} cycles, by its nominal scale ({sine.where}).",
    )


def figure_5(runs: Sequence[Recorded]) -> Drawing | None:
    """Volts of the axes of the first unit of accelerometers in the same record, not calibrated."""
    sine = _nearest_sine(runs)
    unit = Sensor.of(sine.run.header).primary if sine is not None else None
    if sine is None or unit is None or any(name not in sine.signals.names for name in unit.names):
        return None
    figure, axes = _new(len(unit.channels), 4.8)
    for ax, channel in zip(axes, unit.channels, strict=True):
        times, volts = sine.cycles(channel.name)
        role = " (driven)" if channel.axis == sine.body["axis"] else ""
        ax.plot(times, volts, "o-", linewidth=1.2, markersize=2.2, color=AXES[channel.axis])
        ax.set_ylabel(f"{channel.axis}{role} / V")
        ax.margins(x=0.01, y=0.15)
    axes[-1].set_xlabel("time / ms")
    figure.align_ylabels(axes)
    return Drawing(
        figure,
        f"Uncalibrated output of the accelerometers of {unit.title} while {sine.body['axis']} was driven at "
        f"{float(sine.body['frequency']):.2f} Hz: the side axes, each on its own scale, show "
        f"cross-coupling where there is any, their offset and the steps of the converter ({sine.where}).",
    )


# ---------------------------------------------------------------- the turntable


@dataclass(frozen=True)
class _Turning:
    """One record of a turning platter: a gyro's volts about zero and the reference at its samples."""

    run: Recorded
    body: Mapping[str, Any]
    gyro: SensorChannel
    samples: Samples
    edges: Edges

    @property
    def name(self) -> str:
        return self.gyro.name

    @property
    def where(self) -> str:
        return f"run {self.run.name}, record “{self.body['label']}”"

    def reference(self, count: int) -> tuple[Array, Array, Array]:
        """Instants (s), volts about zero (V) and the held rate (rad/s) where there is one."""
        instants = self.samples.instants(self.name)
        inside, rate = held(self.edges, count, axis_sign(self.body)).at(instants)
        return instants[inside], volts_about_zero(self.samples, self.gyro, wires_of(self.run).supply)[inside], rate


def _turning(run: Recorded, body: Mapping[str, Any], gyro: SensorChannel) -> _Turning:
    pieces = []
    for samples in run.pieces(body["samples"]):
        pieces.append(samples)
        if sum(len(p.counts) for p in pieces) * samples.timing.scan_period > LONGEST:
            break
    counts = pieces[0].counts if len(pieces) == 1 else np.concatenate([p.counts for p in pieces])
    first = pieces[0]
    joined = Samples(counts, first.channels, first.timing, first.start, first.first_scan, first.flags)
    return _Turning(run, body, gyro, joined, edges_of([joined], encoder_settings(run.lines)))


def _bodies(runs: Sequence[Recorded], *phases: str) -> Iterator[tuple[Recorded, Mapping[str, Any], SensorChannel]]:
    """Records of the first gyro that any run turned; the roll gyro as in the paper if there is a choice."""
    found = [
        (run, body, gyro)
        for run in runs
        for body in run.points.values()
        if body.get("phase") in phases
        for gyro in _wired(run, body["gyro_axis"])[:1]
    ]
    gyros = [gyro for _, _, gyro in found]
    chosen = next((gyro for gyro in gyros if gyro.word == "roll"), next(iter(gyros), None))
    return ((run, body, gyro) for run, body, gyro in found if gyro == chosen)


def _wired(run: Recorded, axis: str) -> list[SensorChannel]:
    cables = run.header["bench_file"]["cables"]["turntable"]
    return [gyro for gyro in Sensor.of(run.header).about(axis) if gyro.name in cables]


def _thin(*columns: Array, most: int = DOTS) -> list[Array]:
    """Every n-th value; n is odd, lest the picture beat with the samples."""
    step = max(1, len(columns[0]) // most) | 1
    return [column[::step] for column in columns]


def _block_means(times: Array, values: Array, count: int) -> tuple[Array, Array]:
    whole = len(values) // count * count
    return times[:whole].reshape(-1, count).mean(axis=1), values[:whole].reshape(-1, count).mean(axis=1)


def figure_7(calibration: Calibration, runs: Sequence[Recorded]) -> Drawing | None:
    """Sensitivity by eq. 13 sample by sample, its mean, and ours with its uncertainty."""
    for run, body, gyro in _bodies(runs, "hold"):
        turning, name = _turning(run, body, gyro), gyro.name
        figure, (ax,) = _new(height=4.0)
        _ratios(ax, turning)
        _band(ax, calibration.find(f"{name}.sensitivity"))
        ax.set(xlabel="time / s", ylabel="sensitivity / (mV/(°/s))")
        ax.margins(x=0.01)
        _legend(ax, ncols=2, markerscale=5)
        return Drawing(
            figure,
            f"Sensitivity of {name} by equation 13: V_R over the rate from the last complete line interval. Intervals "
            "are whole numbers of samples, so the ratio takes few values; their mean (dashed) carries that bias. "
            "Positive means that the output rises for a turn about the gyro's own axis by the right-hand rule "
            f"({turning.where}).",
        )
    return None


def _ratios(ax: Any, turning: _Turning) -> None:
    """Eq. 13 at every sample, with the moving average, and its mean."""
    times, volts, rate = turning.reference(1)
    ratio = volts / rate * MILLI
    drawn_times, drawn = _thin(times, ratio)
    ax.plot(drawn_times, drawn, ".", color=GREY, markersize=1.8, alpha=0.6, label="eq. 13, raw intervals")
    times, volts, rate = turning.reference(AVERAGED)
    smooth = _block_means(times, volts / rate * MILLI, max(1, len(times) // 400))
    ax.plot(*smooth, color=PAPERS, linewidth=0.9, label=f"moving average of {AVERAGED} lines")
    mean = float(ratio.mean())
    ax.axhline(mean, color=INK, linestyle="--", linewidth=1.1, label=f"mean of the raw ratio {mean:.3f} mV/(°/s)")
    low, high = np.quantile(ratio, [0.02, 0.98])
    room = 0.25 * float(high - low)
    ax.set_ylim(float(low) - room, float(high) + room)


def _band(ax: Any, result: Result | None) -> None:
    if result is None or result.value is None:
        return
    value, half = result.value * MILLI, result.expanded * MILLI
    ax.axhspan(value - half, value + half, color=OURS, alpha=0.25, linewidth=0)
    ax.axhline(value, color=OURS, linewidth=1.2, label=f"this calibration {text(result)}")


def figure_8(calibration: Calibration, runs: Sequence[Recorded]) -> Drawing | None:
    """V_R over the rate with the least-squares line of eq. 12."""
    name, names, columns = "", [], []
    for found in _bodies(runs, *paper_method.TURNING):
        turning = _whole(found)
        if turning is not None:
            name = turning.name
            names.append(turning.run.name)
            columns.append(turning.reference(AVERAGED)[1:])  # without the record, which may be long
    if not columns:
        return None
    volts, rate = (np.concatenate([column[place] for column in columns]) for place in (0, 1))
    if np.ptp(rate) < 0.05 * float(np.abs(rate).max()):
        return None
    ours = calibration.find(f"{name}.sensitivity")
    beside = f"; this calibration gives {text(ours)}" if ours else ""
    return Drawing(
        _line(volts, rate, [_thin(*column, most=DOTS // len(columns)) for column in columns]),
        f"Least-squares sensitivity of {name} by equation 12 over everything that turned, spin-up and coast-down "
        f"included, with rates averaged over {AVERAGED} lines{beside} "
        f"(run {', '.join(dict.fromkeys(names))}, {len(columns)} records).",
    )


def _line(volts: Array, rate: Array, drawn: Sequence[Sequence[Array]]) -> Figure:
    """Some samples of every record (V, rad/s) and the line of eq. 12 through all of them."""
    slope, intercept = paper_method.least_squares_sensitivity(volts, rate)
    figure, (ax,) = _new(height=4.0)
    drawn_volts, drawn_rate = (np.concatenate([column[place] for column in drawn]) for place in (0, 1))
    ax.plot(drawn_rate / DEGREE, drawn_volts, ".", color=OURS, markersize=2.4, alpha=0.45, label="samples (thinned)")
    ends = np.array([rate.min(), rate.max()])
    label = f"eq. 12: {slope * MILLI:.3f} mV/(°/s), intercept {intercept * 1e3:+.1f} mV"
    ax.plot(ends / DEGREE, slope * ends + intercept, color=PAPERS, linewidth=1.4, label=label)
    ax.set(xlabel="reference rate / (°/s)", ylabel="$V_R$ / V")
    _legend(ax, markerscale=4)
    return figure


def _whole(found: tuple[Recorded, Mapping[str, Any], SensorChannel]) -> _Turning | None:
    """A record with its edges; None if the platter hardly moved in it."""
    from rig.errors import BadInput

    try:
        return _turning(*found)
    except BadInput:
        return None


def figure_9(calibration: Calibration, runs: Sequence[Recorded]) -> Drawing | None:
    """The rate that the calibrated gyro measures over the reference, and what the default sensitivity would say."""
    for run, body, gyro in _bodies(runs, "coast_down", "spin_up"):
        name = gyro.name
        turning, ours = _whole((run, body, gyro)), calibration.find(f"{name}.sensitivity")
        if turning is None or ours is None or ours.value is None:
            continue
        offset = calibration.find(f"{name}.offset")
        zero = offset.value - NOMINAL_ZERO if offset is not None and offset.value is not None else 0.0
        times, volts, _ = turning.reference(AVERAGED)
        track = Track(turning.edges)
        rate = track.rate(times) * axis_sign(body)
        count = max(25, len(times) // 1200)
        means = [_block_means(times, column, count)[1] for column in (times, volts - zero, rate)]
        return _overlay(turning, count, means[0], means[1], means[2], ours.value)
    return None


def _overlay(turning: _Turning, count: int, seconds: Array, volts: Array, rate: Array, ours: float) -> Drawing:
    nominal = math.copysign(turning.gyro.nominal, ours)
    figure, (ax, left) = _new(2, 4.8)
    ax.plot(seconds, volts / nominal / DEGREE, color=PAPERS, linewidth=1.1, label="default sensitivity")
    ax.plot(seconds, volts / ours / DEGREE, color=OURS, linewidth=1.3, label="calibrated")
    ax.plot(seconds, rate / DEGREE, color=INK, linewidth=1.1, linestyle=(0, (5, 3)), label="reference")
    ax.set_ylabel("rate / (°/s)")
    _legend(ax)
    left.plot(seconds, (volts / nominal - rate) / DEGREE, color=PAPERS, linewidth=0.9)
    left.plot(seconds, (volts / ours - rate) / DEGREE, color=OURS, linewidth=0.9)
    left.axhline(0.0, color=INK, linewidth=0.8, linestyle=(0, (5, 3)))
    left.set(xlabel="time / s", ylabel="less reference / (°/s)")
    left.margins(x=0.01)
    return Drawing(
        figure,
        f"Measurement of {turning.name} with the calibrated and with the default sensitivity "
        f"({abs(nominal) * MILLI:.3g} mV/(°/s)) over the reference from the encoder, means of {count} samples; "
        f"below, what is left after subtracting the reference ({turning.where}).",
    )


# ---------------------------------------------------------------- beside the paper


def response(calibration: Calibration) -> Drawing | None:
    """Magnitude and phase of every channel that has a response, with expanded uncertainty."""
    if not calibration.responses:
        return None
    figure, (magnitude, phase) = _new(2, 5.2)
    unit = calibration.under_test
    for channel, points in calibration.responses.items():
        full = sorted((p for p in points if p.level == points[0].level), key=lambda p: p.frequency)
        ours = calibration.find(f"{channel}.sensitivity")
        size = abs(ours.value) if ours is not None and ours.value else full[0].magnitude
        f = np.array([p.frequency for p in full])
        marker = _MARKERS[unit.channel(channel).axis]
        style = {"color": unit.triad_of(channel).colour, "marker": marker, "markersize": 3, "linewidth": 0.8,
                 "elinewidth": 0.9, "capsize": 1.5}  # fmt: skip
        magnitude.errorbar(f, [p.magnitude / size for p in full], [2 * p.uc_magnitude / size for p in full],
                           label=channel, **style)  # fmt: skip
        turned = np.unwrap([p.phase for p in full]) / DEGREE
        phase.errorbar(f, turned, [2 * p.uc_phase / DEGREE for p in full], **style)
        _analyzer_beside((magnitude, phase), calibration.analyzer.get(channel, ()), full[0].level, size, turned)
    magnitude.set(xscale="log", ylabel="magnitude ÷ sensitivity")
    phase.set(xscale="log", ylabel="phase / °", xlabel="frequency / Hz")
    _plain_ticks(phase)
    _legend(magnitude)
    runs = ", ".join(sorted({p.run for points in calibration.responses.values() for p in points}))
    return Drawing(
        figure,
        f"Response against the vibrometer at the first level, relative to the sensitivity of each channel; "
        f"bars are k = 2 (run {runs})."
        + (" Open squares: the same by the analyzer, at the bench." if calibration.analyzer else ""),
    )


def _analyzer_beside(axes: Any, points: Sequence[AnalyzerPoint], level: str, size: float, turned: Array) -> None:
    """The analyzer's points of one level as open squares; phases on the branch that the records' phases begin on."""
    mine = [point for point in points if point.level == level and not point.flags]
    if not mine:
        return
    style = {"linestyle": "none", "marker": "s", "markersize": 6, "markerfacecolor": "none", "color": INK}
    f = [point.frequency for point in mine]
    axes[0].plot(f, [point.magnitude / size for point in mine], markeredgewidth=0.7, **style)
    angles = np.unwrap([point.phase for point in mine]) / DEGREE
    angles += 360.0 * np.round((turned[0] - angles[0]) / 360.0)
    axes[1].plot(f, angles, markeredgewidth=0.7, **style)


_MARKERS = {"x": "o", "y": "s", "z": "^"}


def _plain_ticks(ax: Any) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    ax.xaxis.set_major_locator(FixedLocator([10, 20, 50, 100, 200, 500, 1000]))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


def allan_deviation(runs: Sequence[Recorded]) -> Drawing | None:
    """Overlapping Allan deviation of one sensor of each kind at rest."""
    from rig.signals import allan

    found = [(run, e.body) for run in runs for e in run.lines
             if e.kind == "point" and e.body.get("purpose") == "noise" and "samples" in e.body]  # fmt: skip
    if not found:
        return None
    run, body = max(found, key=lambda one: float(one[1]["seconds"]))
    figure, axes = _new(2, 5.4)
    samples, sensor = run.samples(body["samples"]), Sensor.of(run.header)
    shown = sensor.samples(channel.name for channel in samples.channels)
    for ax, quantity, unit in zip(axes, ("acceleration", "rate"), ("m/s²", "°/s"), strict=True):
        for channel in (one for one in shown if one.quantity == quantity):
            size = channel.nominal * (DEGREE if unit == "°/s" else 1.0)
            one = allan.overlapping(samples.volts(channel.name) / size, samples.timing.scan_rate)
            colour = sensor.triad_of(channel.name).colour
            ax.loglog(one.tau, one.deviation, color=colour, linewidth=1.2, label=channel.name)
            ax.fill_between(one.tau, one.low, one.high, color=colour, alpha=0.2, linewidth=0)
        ax.set_ylabel(f"Allan deviation / ({unit})" if "/" in unit else f"Allan deviation / {unit}")
        _legend(ax)
    axes[-1].set_xlabel("averaging time / s")
    return Drawing(
        figure,
        "Overlapping Allan deviation at rest by the default sensitivity; the shade is the confidence interval from the "
        f"degrees of freedom (run {run.name}, {float(body['seconds']):g} s).",
    )


def graduation(runs: Sequence[Recorded]) -> Drawing | None:
    """What the track leaves over line by line around the encoder's disk, in the longest hold."""
    found = [(run, b) for run in runs for b in run.points.values() if b.get("phase") == "hold" and "samples" in b]
    if not found:
        return None
    run, body = max(found, key=lambda one: float(one[1]["seconds"]))
    disk = graduation_map(Track(edges_of(run.pieces(body["samples"]), encoder_settings(run.lines))))
    figure, (ax,) = _new()
    ax.plot(np.arange(len(disk.lines)), disk.lines / ARCSECOND, color=OURS, linewidth=0.6)
    ax.axhspan(-disk.u_line / ARCSECOND, disk.u_line / ARCSECOND, color=GREY, alpha=0.25, linewidth=0)
    ax.set(xlabel="line after the index", ylabel="residual / arcsec")
    return Drawing(
        figure,
        f"Mean residual of every line of the disk over {disk.revolutions} revolutions; the band is the standard "
        "uncertainty of one line. Slow errors around the turn are not in it: one reading head cannot tell them from "
        "true wow of the platter. Whole revolutions feel none of it "
        f"(run {run.name}, record “{body['label']}”).",
    )


@dataclass(frozen=True)
class Plan:
    """One figure of the report: its title, how it is drawn, and the command that gives the data if they are missing."""

    title: str
    draw: Callable[[Calibration, Sequence[Recorded]], Drawing | None]
    command: str


PLANS = (
    Plan("Figure 4: reference velocity", lambda _, runs: figure_4(runs), "rig sweep --axis x"),
    Plan("Figure 5: uncalibrated accelerometers", lambda _, runs: figure_5(runs), "rig sweep --axis x"),
    Plan("Figure 7: sensitivity by equation 13", figure_7, "rig turntable"),
    Plan("Figure 8: sensitivity by equation 12", figure_8, "rig turntable"),
    Plan("Figure 9: calibrated measurement over the reference", figure_9, "rig turntable"),
    Plan("Frequency response", lambda calibration, _: response(calibration), "rig sweep --axis x"),
    Plan("Graduation of the encoder", lambda _, runs: graduation(runs), "rig turntable"),
    Plan("Allan deviation", lambda _, runs: allan_deviation(runs), "rig noise"),
)
