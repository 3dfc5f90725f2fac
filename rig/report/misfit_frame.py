"""What figures of a misfit have in common: empty axes, the worst condition as a title, legends clear of the data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.model import Channels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rig.diagnose.misfit import Condition

BAND = "#e6e6e6"  # of the noise
APART = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#56b4e9",
    "#e69f00",
)  # Okabe and Ito, for colour-blind people
NUMBERS = [f * 10.0**k for k in range(-6, 6) for f in (1.0, 2.0, 5.0)]  # as a person ticks a logarithmic axis


def new(rows: int, columns: int, size: tuple[float, float], title: str, **shared: Any) -> tuple[Figure, Any]:
    """A figure of `size` inches with empty axes (rows, columns)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, **shared)
    figure.suptitle(title, fontsize=10)
    for ax in axes.flat:
        ax.grid(True, which="major", color="#dddddd", linewidth=0.6)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def title(name: str, worst: Sequence[Condition]) -> str:
    """The worst condition in words, in lines that fit; without one that stands out, that nothing does."""
    import textwrap

    said = worst[0].in_words if worst and worst[0].stands_out else "nothing stands out of the noise"
    ratio = f" ({worst[0].ratio:.3g} times {worst[0].against})" if worst and worst[0].stands_out else ""
    ratio = ratio[:1] + ratio[1:].replace(" ", "\u00a0")  # together on a line
    return "\n".join([f"{name}: what the model leaves over", *textwrap.wrap(said + ratio, 108)])


def colour(channels: Channels, rows: Sequence[int], row: int) -> Any:
    """That of the unit; of several channels of a unit, the later ones lighter."""
    from matplotlib.colors import to_rgb

    before = [one for one in rows if channels.titles[one] == channels.titles[row]].index(row)
    base = np.array(to_rgb(channels.colours[row] or APART[row % len(APART)]))
    return tuple((base + (1.0 - base) * 0.3 * before).clip(0.0, 1.0).tolist())


def legend(ax: Any, columns: int) -> None:
    """Above the axes, clear of the data; every label once."""
    handles, labels = ax.get_legend_handles_labels()
    first = dict(zip(reversed(labels), reversed(handles), strict=True))
    names = list(dict.fromkeys(labels))
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 0.98), "borderaxespad": 0.0, "ncols": columns}
    look = {"fontsize": 8, "frameon": False, "handlelength": 1.6, "columnspacing": 1.2}
    ax.legend([first[name] for name in names], names, **place, **look)


def plain(axis: Any) -> None:
    """Numbers as a person writes them, on a logarithmic axis."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    low, high = axis.get_view_interval()
    wide = high > 300.0 * low
    axis.set_major_locator(FixedLocator([f for f in NUMBERS if not wide or round(math.log10(f), 6) % 1 == 0.0]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
