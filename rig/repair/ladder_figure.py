"""The ladder of a model's repair as a figure: the error of every step, fitted and held out, against the noise floor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rig.repair.model_file import Model, Step

FITTED, HELD_OUT, WORST, FLOOR = "#1f5fa8", "#c2571a", "#7a3b8f", "#3c8a4a"


def draw(model: Model, folder: Path) -> list[Path]:
    """Write `ladder.svg` and `ladder.png`; the same history gives the same SVG. Paths; none without a history."""
    from matplotlib import rc_context

    if not model.history:
        return []
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with rc_context({"svg.hashsalt": model.unit}):
        for suffix, metadata in (("svg", {"Date": None}), ("png", {"Software": None})):
            path = folder / f"ladder.{suffix}"
            figure(model).savefig(path, metadata=metadata, dpi=150)
            paths.append(path)
    return paths


def figure(model: Model) -> Figure:
    """Error against noise over the steps."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, NullFormatter

    steps = model.history
    made = Figure(figsize=(max(6.0, 1.3 * len(steps) + 2.5), 4.2), layout="constrained")
    ax = made.subplots()
    at = range(len(steps))
    ax.axhline(1.0, color=FLOOR, linewidth=1.2, label="noise, measured independently")
    ax.plot(at, [step.error for step in steps], "o-", color=FITTED, label="all data, fitted")
    worst = [float("nan") if step.worst is None else step.worst for step in steps]
    ax.plot(at, worst, "^:", color=WORST, label="where it stands out most")
    there = [float("nan") if step.worst_heldout is None else step.worst_heldout for step in steps]
    ax.plot(at, there, "v", color=WORST, fillstyle="none", label="there, held-out data")
    for place, step in zip(at, steps, strict=True):
        if step.worst is not None and step.place.size:
            ax.annotate(step.place.size, (place, step.worst), (8, 2),
                        textcoords="offset points", ha="left", fontsize=7, color=WORST)  # fmt: skip
    heldout = [float("nan") if step.heldout is None else step.heldout for step in steps]
    ax.plot(at, heldout, "s--", color=HELD_OUT, label="held-out data, predicted")
    ax.set_yscale("log")
    for axis_part in (ax.yaxis.set_major_formatter, ax.yaxis.set_minor_formatter):
        axis_part(FuncFormatter(lambda value, _: f"{value:g}"))
    if _range(steps) > 5.0:
        ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_xticks(list(at), [label(step) for step in steps], fontsize=8)
    ax.set_xlim(-0.5, len(steps) - 0.5)
    ax.set(ylabel="error ÷ noise", title=f"{model.unit}: repair of the model")
    ax.grid(True, axis="y", which="both", color="#dddddd", linewidth=0.6)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(fontsize=8, frameon=False)
    if model.simulated:
        made.text(0.005, 0.995, "SIMULATED", ha="left", va="top", color="#b00020", fontsize=9, weight="bold")
    return made


def label(step: Step) -> str:
    """What a step did, on two lines."""
    return f"{step.action}\n{step.effect or ''}".rstrip()


def _range(steps: tuple[Step, ...]) -> float:
    errors = [one for step in steps for one in (step.error, step.worst) if one is not None]
    return max(errors) / min(1.0, *errors)
