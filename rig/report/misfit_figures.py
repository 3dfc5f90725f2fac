"""Figures of where a model fails: what is left over, in units of the noise, over each condition."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.diagnose.misfit import Condition, conditions
from rig.diagnose.misfit_cells import tables
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.parts.part import Part
from rig.report import imported_figures
from rig.report.noise_figure import noises
from rig.report.platter_figure import turntable
from rig.report.sweep_figure import shaker

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAID, WIDEST = 3, 150  # of what is said below a figure, and characters of a line
Drawing = Callable[[Fit, Sequence[int], Sequence[Condition]], "Iterator[tuple[str, Figure]]"]


def _each(stem: str, figure: Callable[[Fit, int, Any, Sequence[Condition]], Figure]) -> Drawing:
    """One figure for each of these parts."""

    def drawn(fit: Fit, numbers: Sequence[int], worst: Sequence[Condition]) -> Iterator[tuple[str, Figure]]:
        for number in numbers:
            part = fit.parts[number]
            yield stem, figure(fit, number, part, [one for one in worst if part.within(one.experiment)])

    return drawn


def _responses(fit: Fit, numbers: Sequence[int], worst: Sequence[Condition]) -> Iterator[tuple[str, Figure]]:
    """All tables in one figure."""
    mine = [one for one in worst if any(fit.parts[k].within(one.experiment) for k in numbers)]
    yield "misfit_response", imported_figures.response(fit, numbers, mine)


DRAWINGS: Mapping[str, Drawing] = {
    "sweep": _each("misfit_shaker", shaker),
    "platter": _each("misfit_turntable", turntable),
    "rotation": _each("misfit_rotation", imported_figures.following),
    "motion": _each("misfit_motion", imported_figures.following),
    "poses": _each("misfit_poses", imported_figures.poses),
    "response": _responses,
    "noise": noises,
}
"""By the noun that a part gives; what has no drawing is drawn nowhere."""


def draw(evidence: Evidence, fit: Fit, folder: Path, kinds: Sequence[str] = ("svg",)) -> list[Path]:
    """The figures of every part of a fit, each as SVG or PNG or both; the paths, in `folder`."""
    worst = conditions(fit, tables(fit))
    numbers: dict[str, list[int]] = {}
    for number, part in enumerate(fit.parts):
        numbers.setdefault(part.drawing, []).append(number)
    figures: dict[str, Figure] = {}
    for noun in (one for one in DRAWINGS if one in numbers):
        for stem, figure in DRAWINGS[noun](fit, numbers[noun], worst):
            _say_left_out(figure, [fit.parts[number] for number in numbers[noun]])
            figures[_named(stem, figures)] = figure
    return _saved(figures, folder, evidence.simulated, kinds)


def _say_left_out(figure: Figure, parts: Sequence[Part]) -> None:
    """Below: what looks wrong with the records, whole, or how many more there are."""
    found = list(dict.fromkeys(one.in_words for part in parts for one in part.faults))
    more = [f"and {len(found) - SAID} more: see findings"] if len(found) > SAID else []
    if said := [textwrap.fill(one, WIDEST, subsequent_indent="    ") for one in found[:SAID]] + more:
        figure.supxlabel("\n".join(said), x=0.01, ha="left", color="#b00020", fontsize=7)


def _named(stem: str, there: dict[str, Figure]) -> str:
    count = sum(name.startswith(stem) for name in there)
    return f"{stem}_{count + 1}" if count else stem


def _laid_out(figure: Figure) -> None:
    """Once for all files: most of the time of a drawing is its layout."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
    figure.set_layout_engine("none")


def _saved(figures: dict[str, Figure], folder: Path, simulated: bool, kinds: Sequence[str]) -> list[Path]:
    from matplotlib import rc_context

    paths = []
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in figures.items():
        _laid_out(figure)
        if simulated:
            figure.text(0.995, 0.005, "SIMULATED", ha="right", va="bottom", color="#b00020", fontsize=9, weight="bold")
        for kind in kinds:
            path = folder / f"{name}.{kind}"
            with rc_context({"svg.hashsalt": name}):
                figure.savefig(path, dpi=120, metadata={"Date": None} if kind == "svg" else None)
            paths.append(path)
    return paths
