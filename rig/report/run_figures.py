"""Figures of a run, as SVG files that a person would rather look at than the table."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.archive.records import Recorded, Records, experiments, poses_of, signals
from rig.sensor import Sensor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rig.calibrate.calibration import Calibration, ResponsePoint


def draw(records: Records, made: Calibration | None, folder: Path) -> list[Path]:
    """Every figure that the run's records, and what they were calibrated to, allow; the paths, in `folder`."""
    drawn = [one for name, make in _FIGURES.items() for one in _of_every_experiment(records, name, make)]
    if made is not None and made.responses:
        drawn.insert(0, ("response", response(made, f"{records.header['title']}: response")))
    if drawn:
        folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in drawn:
        if records.header["simulated"]:
            figure.text(0.995, 0.005, "SIMULATED", ha="right", va="bottom", color="#b00020", fontsize=9, weight="bold")
        path = folder / f"{name}.svg"
        figure.savefig(path, metadata={"Date": None})
        paths.append(path)
    return paths


def _of_every_experiment(
    records: Records, name: str, make: Callable[[Recorded], Figure | None]
) -> Iterator[tuple[str, Figure]]:
    """One kind of figure for each experiment of a run that allows it; the second of a kind is `rotation-2`."""
    figures = [figure for one in experiments(records) if (figure := make(one)) is not None]
    for number, figure in enumerate(figures, start=1):
        yield (name if number == 1 else f"{name}-{number}"), figure


def _new(rows: int, height: float, title: str) -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, height), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    figure.suptitle(title, fontsize=11)
    for ax in axes:
        ax.grid(True, which="both", color="#dddddd", linewidth=0.6)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def response(made: Calibration, title: str) -> Figure:
    """Magnitude (relative to the lowest) and phase of every driven channel against the vibrometer, over frequency.

    Bars are expanded uncertainties (k = 2) without the vibrometer's gain, which all points share.
    """
    figure, (magnitude, phase) = _new(2, 6.0, title)
    for channel, points in made.responses.items():
        for number, level in enumerate(dict.fromkeys(point.level for point in points)):
            mine = [point for point in points if point.level == level and not point.flags]
            if mine:
                _response_line((magnitude, phase), (channel, made.under_test.triad_of(channel).colour), mine, number)
    magnitude.set(xscale="log", ylabel="sensitivity ÷ that at the lowest")
    phase.set(xscale="log", ylabel="phase / °", xlabel="frequency / Hz (circles: first level, crosses: second)")
    _plain_ticks(phase)
    magnitude.legend(fontsize=8, ncols=3, frameon=False)
    return figure


def _response_line(axes: Any, drawn: tuple[str, str], points: list[ResponsePoint], number: int) -> None:
    """One level of a channel; `drawn` is its name and colour."""
    channel, colour = drawn
    f = [point.frequency for point in points]
    lowest = float(np.mean([point.magnitude for point in points[:3]]))
    style = {"color": colour, "fmt": "ox+s"[number % 4] + "-", "markersize": 4, "linewidth": 0.9}
    style |= {"elinewidth": 0.8, "capsize": 1.5}
    values, bars = [p.magnitude / lowest for p in points], [2.0 * p.u_magnitude / lowest for p in points]
    axes[0].errorbar(f, values, yerr=bars, label=channel if number == 0 else None, **style)
    angles = np.degrees(np.unwrap([p.phase for p in points]))
    axes[1].errorbar(f, angles, yerr=[np.degrees(2.0 * p.u_phase) for p in points], **style)


def svg_of_response(made: Calibration) -> dict[str, bytes]:
    """The response figure as SVG, by name; none without responses."""
    import io

    from matplotlib import rc_context

    if not made.responses:
        return {}
    figure, file = response(made, "Response against the vibrometer"), io.BytesIO()
    with rc_context({"svg.hashsalt": made.name}):
        figure.savefig(file, format="svg", metadata={"Date": None})
    return {"response": file.getvalue()}


def _plain_ticks(ax: Any) -> None:
    """Frequencies as a person writes them."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    ax.xaxis.set_major_locator(FixedLocator([10, 20, 50, 100, 200, 500, 1000]))
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.xaxis.set_minor_formatter(NullFormatter())


def rotation(records: Recorded) -> Figure | None:
    """Volts of the gyros on the platter's axis over a turntable run, phase by phase."""
    bodies = [body for body in records.points.values() if "phase" in body]
    if not bodies:
        return None
    sensor, samples = Sensor.of(records.header), [records.samples(body["samples"]) for body in bodies]
    recorded = {channel.name for channel in samples[0].channels}
    gyros = [gyro for gyro in sensor.about(bodies[0]["gyro_axis"]) if gyro.name in recorded]
    if not gyros:
        return None
    title = f"{records.header['title']}: raw output of the {bodies[0]['gyro_axis']} gyros"
    figure, axes = _new(len(gyros), 1.0 + 2.25 * len(gyros), title)
    for ax, gyro in zip(axes, gyros, strict=True):
        for one in samples:
            seconds, volts = _thinned(one.instants(gyro.name) + one.start, one.volts(gyro.name))
            colour = sensor.triad_of(gyro.name).colour
            ax.plot((seconds - records.header["started"]), volts, linewidth=0.7, color=colour)
        ax.set_ylabel(f"{gyro.name} / V")
    axes[-1].set_xlabel("bench time since the run began / s")
    return figure


def density(records: Recorded) -> Figure | None:
    """Noise density of the sensors at rest; none where the converter kept nothing."""
    bodies = [e.body for e in records.lines if e.kind == "point" and e.body.get("purpose") == "noise"]
    bodies = [body for body in bodies if "samples" in body]
    if not bodies:
        return None
    from scipy.signal import welch

    figure, (ax,) = _new(1, 4.5, f"{records.header['title']}: noise density at the converter")
    samples = records.samples(bodies[0]["samples"])
    rate = samples.timing.scan_rate
    sensor = Sensor.of(records.header)
    for one in sensor.samples(channel.name for channel in samples.channels):
        frequency, power = welch(samples.volts(one.name), rate, nperseg=min(len(samples.counts), 1 << 14))
        colour = sensor.triad_of(one.name).colour
        ax.loglog(*_log_bins(frequency[1:], power[1:]), linewidth=1.0, label=one.name, color=colour)
    ax.set(xlabel="frequency / Hz", ylabel="density / (µV/√Hz)")
    ax.legend(fontsize=8, frameon=False)
    return figure


def _log_bins(frequency: Any, power: Any, bins: int = 150) -> tuple[Any, Any]:
    """Mean power in logarithmic bins, as a density in µV/√Hz: the eye averages logarithms, which is biased."""
    edges = np.geomspace(frequency[0], frequency[-1] * 1.0001, bins + 1)
    place = np.digitize(frequency, edges)
    used = [k for k in range(1, bins + 1) if np.any(place == k)]
    centre = [float(frequency[place == k].mean()) for k in used]
    return centre, [float(np.sqrt(power[place == k].mean())) * 1e6 for k in used]


def poses(records: Recorded) -> Figure | None:
    """What is left of every accelerometer's mean output when the straight line against gravity is taken out.

    None where the converter kept nothing.
    """
    found = [one for one in poses_of(records) if "samples" in one[1]]
    if len(found) < 6:
        return None
    figure, (ax,) = _new(1, 4.5, f"{records.header['title']}: residual of the straight line against gravity")
    means = [signals(records.samples(body["samples"])) for _, body in found]
    for unit in Sensor.of(records.header).of_quantity("acceleration"):
        label = f"{unit.title} {' '.join(unit.axes)}"
        for channel in (one for one in unit.channels if one.name in means[0].names):
            component = np.array([up[channel.place] for up, _ in found])
            volts = np.array([one.of(channel.name).mean() for one in means])
            slope, offset = np.polyfit(component, volts, 1)
            left = (volts - slope * component - offset) / slope * 1e3
            style = {"markersize": 3, "linewidth": 0.6, "color": unit.colour, "label": label}
            ax.plot(range(1, len(left) + 1), left, "o-", **style)
            label = "_"  # the legend names a unit once
    ax.set(xlabel="pose", ylabel="residual / mg")
    ax.legend(fontsize=8, frameon=False)
    return figure


def _thinned(x: Any, y: Any, most: int = 4000) -> tuple[Any, Any]:
    """Block means, so that a long record draws as what it is and the file stays small."""
    step = max(1, len(x) // most)
    whole = len(x) // step * step
    return x[:whole].reshape(-1, step).mean(axis=1), y[:whole].reshape(-1, step).mean(axis=1)


_FIGURES: dict[str, Callable[[Recorded], Figure | None]] = {
    "rotation": rotation,
    "noise": density,
    "poses": poses,
}
