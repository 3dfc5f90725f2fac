"""What a budget has to allow for and no run measures: sizes that the bench file states, the converter's gain.

Each is a line of the budgets that it concerns. What is not stated is no line, and the calibration says that its values
are relative to it (GUM 3.4.1, F.2.4).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Literal, TypeVar

from rig import units
from rig.archive.records import Recorded, Reference, reference
from rig.calibrate.budget import Budget, Contribution, half_width
from rig.calibrate.calibration import AnalyzerPoint, ResponsePoint, Result
from rig.calibrate.cube_route import Recorder
from rig.errors import BadInput

Route = Literal["sweep", "analyzer", "turntable", "tumble"]
Point = TypeVar("Point", ResponsePoint, AnalyzerPoint)
CONCERNS: Mapping[str, tuple[Route, ...]] = {
    "vibrometer_response": ("sweep", "analyzer"), "transverse_motion": ("sweep", "analyzer"),
    "laser_spot": ("sweep", "analyzer"), "base_strain": ("sweep", "analyzer"),
    "converter_linearity": ("sweep", "turntable", "tumble"), "settling": ("sweep", "turntable"),
    "supply": ("sweep", "analyzer", "turntable", "tumble"),
}  # fmt: skip
IN_VOLTS: tuple[Route, ...] = ("turntable", "tumble")  # by references that no channel of the converter shows


class Influences:
    """What the bench files of all runs state, the widest of each; what they leave out is nowhere."""

    def __init__(self, runs: Sequence[Recorded], recorder: Recorder) -> None:
        self._runs, self._recorder = runs, recorder
        stated = [
            (run.header["bench_file"].get("influences") or {}, run.header["bench_file"].get("bench")) for run in runs
        ]
        self._sizes: dict[str, tuple[float, str]] = {}
        for name in CONCERNS:
            if stated and all(name in one for one, _ in stated):
                self._sizes[name] = max(
                    (units.parse(one[name]["half_width"], "ratio"), f"{one[name]['source']}, bench {bench}")
                    for one, bench in stated
                )

    @cached_property
    def _gain(self) -> Reference | None:
        """Of the converter, where it is certified to be one; BadInput where it is not within its uncertainty."""
        if not self._certified:
            return None
        worst = max((reference(run, "converter", "gain") for run in self._runs), key=lambda one: one.u)
        if worst.u < abs(worst.value - 1.0) / 2.0:
            raise BadInput(f"{self._runs[0].name}: found a converter of gain {worst.value:.6g} ({worst.source}), "
                           "wanted 1 within its uncertainty: adjust it")  # fmt: skip
        return worst

    @property
    def _certified(self) -> bool:
        """The cube has a converter of its own, which nobody certifies."""
        known = all(any(one["standard"] == "converter" for one in run.header["standards"]) for run in self._runs)
        return known and self._recorder != "cube"

    def _in_volts(self, one: Result) -> bool:
        """Whether the gain of what recorded it does not cancel: the cube's never does."""
        route = route_of(one)
        return one.measurand == "offset" or route in IN_VOLTS or (route == "sweep" and self._recorder == "cube")

    def added(self, results: Iterable[Result]) -> Iterator[Result]:
        """The results with a line for everything that concerns them. Raises BadInput for a converter that is off."""
        for one in results:
            lines = () if one.budget is None else tuple(self._lines(one))
            if lines and one.budget is not None:
                one = replace(one, budget=Budget((*one.contributions, *lines), one.budget.correlation))
            yield one

    def _lines(self, one: Result) -> Iterator[Contribution]:
        value = float(one.value or 0.0)
        for name, u, source in self._relative(route_of(one)):
            yield Contribution(name, "B", "rectangular", u, "1", value, source=source)
        if self._in_volts(one) and self._gain is not None:
            yield Contribution("converter gain", "B", "normal", self._gain.u, "1", value, source=self._gain.source)

    def _relative(self, route: Route | None) -> Iterator[tuple[str, float, str]]:
        """Name, relative standard uncertainty and source of what concerns a route."""
        for name, (size, source) in self._sizes.items():
            if size > 0.0 and route in CONCERNS[name]:
                yield name.replace("_", " "), half_width(size, "rectangular"), source

    def widened(self, responses: Mapping[str, tuple[Point, ...]], route: Route) -> dict[str, tuple[Point, ...]]:
        """Responses with what concerns their magnitudes."""
        u = math.hypot(*(one for _, one, _ in self._relative(route)))
        return {
            name: tuple(replace(p, uc_magnitude=math.hypot(p.uc_magnitude, u * p.magnitude)) for p in points)
            for name, points in responses.items()
        }

    def flags(self, results: Sequence[Result]) -> Iterator[str]:
        """What the values are relative to, as nobody states its size."""
        routes = {route for one in results if one.determined and (route := route_of(one)) is not None}
        left = [n.replace("_", " ") for n, of in CONCERNS.items() if n not in self._sizes and set(of) & routes]
        if left:
            yield f"not in the budgets, as the bench file states no size (`influences`): {', '.join(left)}"
        if not self._certified and any(one.determined and self._in_volts(one) for one in results):
            gyros = "sensitivities of gyros and from gravity, and zero outputs,"
            whose, what = ("cube", "all values") if self._recorder == "cube" else ("converter", gyros)
            yield f"{what} are in volts of the {whose}, whose gain no standard of the bench file states"


def route_of(result: Result) -> Route | None:
    """How a sensitivity was measured; None for what is none."""
    match result.measurand:
        case "sensitivity":
            return "turntable" if "rad" in result.unit else "sweep"
        case "sensitivity_analyzer":
            return "analyzer"
        case "sensitivity_centripetal":
            return "turntable"
        case "sensitivity_gravity":
            return "tumble"
        case _:
            return None
