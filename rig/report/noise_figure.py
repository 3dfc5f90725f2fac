"""Figure of records at rest: what density each band has, what the model and the data sheets say, and what is left."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.diagnose.misfit import Condition
from rig.fit.fit import Fit
from rig.motion import Array
from rig.parts.noise_spectrum import NoiseSpectrum
from rig.parts.remainder import Indices
from rig.report.misfit_frame import BAND, colour, legend, new, plain, title

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST = 3  # channels whose densities are shown


def noises(fit: Fit, numbers: Sequence[int], worst: Sequence[Condition]) -> Iterator[tuple[str, Figure]]:
    """A figure for each place at rest where noise stands out or is in the model: else there is nothing to see."""
    for number in numbers:
        part: Any = fit.parts[number]
        mine = [one for one in worst if one.stands_out and part.within(one.experiment) and _of(part, one)]
        if mine or part.here(fit.state.terms):
            yield "misfit_noise", _figure(fit, number, part, mine)


def _of(part: NoiseSpectrum, one: Condition) -> bool:
    return one.component in part.components()


def _figure(fit: Fit, number: int, part: NoiseSpectrum, worst: Sequence[Condition]) -> Figure:
    """A row of axes for each quantity: densities on the left, deviations of the bands on the right."""
    kinds = [rows for rows in (np.flatnonzero(part.channels.rates == rate) for rate in (False, True)) if len(rows)]
    heading = title(f"{part.name.split('#')[0]}, at rest with the cables of the {part.experiment}", worst)
    figure, axes = new(len(kinds), 2, (10.0, 1.2 + 3.2 * len(kinds)), heading, sharex=True)
    left = fit.left[fit.offsets()[number] :][: part.rows].reshape(len(part.channels.names), -1)
    for (density, deviation), rows in zip(axes, kinds, strict=True):
        shown = _loudest(left, rows, worst, part)
        _densities(density, part, shown, *part.densities(fit.state.local(part, number), fit.state.terms))
        _deviations(deviation, part, rows, shown, left)
    for ax in axes[-1]:
        ax.set_xlabel("frequency / Hz")
    for ax in axes.flat:
        ax.set_xscale("log")
        plain(ax.xaxis)
    return figure


def _loudest(left: Array, rows: Indices, worst: Sequence[Condition], part: NoiseSpectrum) -> list[int]:
    """Those that stand out, then those of which most is left, in the order of the channels."""
    named = {name for one in worst for name in one.channels}
    order = sorted(
        rows.tolist(), key=lambda row: (part.channels.names[row] not in named, -float(left[row] @ left[row]))
    )
    return sorted(order[:MOST])


def _densities(ax: Any, part: NoiseSpectrum, shown: Sequence[int], seen: Array, said: Array, sheet: Array) -> None:
    """Points as recorded (hollow: held out), a line as the model, a dashed one as the data sheet has it."""
    f, held = part.bands_at, part.bands_held
    order = np.argsort(f)
    for row in shown:
        shade = colour(part.channels, shown, row)
        ax.plot(f[~held], seen[row][~held], "o", color=shade, markersize=3.5, label=part.channels.names[row])
        ax.plot(f[held], seen[row][held], "o", color=shade, markersize=3.5, fillstyle="none")
        ax.plot(f[order], said[row][order], color=shade, linewidth=1.0)
        ax.plot(f[order], sheet[row][order], "--", color=shade, linewidth=0.8, alpha=0.8)
    unit = part.unit_of_density(part.channels.names[shown[0]])
    ax.set(yscale="log", ylabel=f"density / ({unit})\nline: model, dashed: data sheet")
    plain(ax.yaxis)
    legend(ax, MOST)


def _deviations(ax: Any, part: NoiseSpectrum, rows: Indices, shown: Sequence[int], left: Array) -> None:
    """How far every band is above the model, all channels; those of the left in their colours, hollow: held out."""
    f, held = part.bands_at, part.bands_held
    for row in rows.tolist():
        style: dict[str, Any] = {"color": "#999999", "linewidth": 0.5}
        if row in shown:
            style = {"color": colour(part.channels, shown, row), "linewidth": 1.0}
            ax.plot(f[held], left[row][: len(f)][held], "o", markersize=3.5, fillstyle="none", color=style["color"])
        ax.plot(f[~held], left[row][: len(f)][~held], **style)
    ax.axhspan(-2.0, 2.0, color=BAND, zorder=0)
    ax.axhline(0.0, color="#888888", linewidth=0.7)
    ax.set_ylabel("above the model ÷ standard deviation")
