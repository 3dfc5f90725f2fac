"""What a budget has to allow for and no run measures: sizes that the bench file states, the converter's gain.

Each is a line of the budgets that it concerns. What is not stated is no line, and the calibration says that its values
are relative to it (GUM 3.4.1, F.2.4).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Literal

from rig import units
from rig.archive.records import Recorded, Reference, reference
from rig.calibrate.allowances import in_runs
from rig.calibrate.budget import Budget, Contribution, half_width
from rig.calibrate.calibration import Result
from rig.calibrate.cube_route import Recorder
from rig.errors import BadInput

Route = Literal["sweep", "turntable", "tumble"]
CONCERNS: Mapping[str, tuple[Route, ...]] = {
    "vibrometer_response": ("sweep",), "transverse_motion": ("sweep",), "laser_spot": ("sweep",),
    "base_strain": ("sweep",), "converter_linearity": ("sweep", "turntable", "tumble"),
    "settling": ("sweep", "turntable"), "supply": ("sweep", "turntable", "tumble"),
}  # fmt: skip
IN_VOLTS: tuple[Route, ...] = ("turntable", "tumble")  # by references that no channel of the converter shows


class Influences:
    """What the bench files of all runs state, the widest of each."""

    def __init__(self, runs: Sequence[Recorded], recorder: Recorder) -> None:
        """Raises BadInput for a converter whose gain is not one within its uncertainty."""
        self._names, self._recorder = [run.name for run in runs], recorder
        stated = [run.header["bench_file"].get("influences") or {} for run in runs]
        self._sizes: dict[str, tuple[float, str]] = {}
        for name in CONCERNS:
            if stated and all(name in one for one in stated):
                sizes = [(units.parse(one[name]["half_width"], "ratio"), str(one[name]["source"])) for one in stated]
                self._sizes[name] = max(sizes)
        self._gain = self._certified(runs) if recorder == "converter" else None

    def _certified(self, runs: Sequence[Recorded]) -> Reference | None:
        if not all(any(one["standard"] == "converter" for one in run.header["standards"]) for run in runs):
            return None
        found = [reference(run, "converter", "gain") for run in runs]
        if (worst := max(found, key=lambda one: one.u)).u < abs(worst.value - 1.0) / 2.0:
            raise BadInput(f"{runs[0].name}: found a converter of gain {worst.value:.6g} ({worst.source}), wanted 1 "
                           "within its uncertainty: adjust it")  # fmt: skip
        return worst

    def added(self, results: Iterable[Result]) -> Iterator[Result]:
        """The results with a line for everything that concerns them."""
        for one in results:
            lines = tuple(self._lines(one))
            if lines and one.budget is not None:
                one = replace(one, budget=Budget((*one.contributions, *lines), one.budget.correlation))
            yield one

    def _lines(self, one: Result) -> Iterator[Contribution]:
        route = route_of(one)
        for name, (size, source) in self._sizes.items():
            if size > 0.0 and route in CONCERNS[name]:
                u = half_width(size, "rectangular")
                yield Contribution(name.replace("_", " "), "B", "rectangular", u, "1", float(one.value or 0.0),
                                   source=in_runs(source, self._names))  # fmt: skip
        if self._gain is not None and (route in IN_VOLTS or one.measurand == "offset"):
            yield Contribution("converter gain", "B", "normal", self._gain.u, "1", float(one.value or 0.0),
                               source=self._gain.source)  # fmt: skip

    def flags(self, results: Sequence[Result]) -> Iterator[str]:
        """What the values are relative to, as nobody states its size."""
        routes = [route for one in results if one.determined and (route := route_of(one)) is not None]
        left = [n.replace("_", " ") for n, of in CONCERNS.items() if n not in self._sizes and set(of) & set(routes)]
        if left:
            yield f"not in the budgets, as the bench file states no size (`influences`): {', '.join(left)}"
        if self._gain is None and set(routes) & set(IN_VOLTS):
            yield (
                f"sensitivities of gyros and from gravity, and zero outputs, are in volts of the {self._recorder}, "
                "whose gain no standard of the bench file states"
            )


def route_of(result: Result) -> Route | None:
    """How a sensitivity was measured; None for what is none."""
    match result.measurand:
        case "sensitivity" | "sensitivity_analyzer":
            return "turntable" if "rad" in result.unit else "sweep"
        case "sensitivity_centripetal":
            return "turntable"
        case "sensitivity_gravity":
            return "tumble"
        case _:
            return None
