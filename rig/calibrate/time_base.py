"""The converter's clock against that of the machine which takes its conversions: another crystal.

What was converted for T by the machine's clock lasts T·(1 + error) by the converter's, and is taken a little later, for
it comes in lumps. A certificate says more than this can; a crystal that is not the certified one, or a wrong divider,
shows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, reference
from rig.calibrate.calibration import Result
from rig.errors import ArchiveError, BadInput

LINE = "time base"  # of the budgets that stand on the converter's clock
LATE, U_LATE = 0.03, 0.05  # s: how late conversions are taken, as far as is known without looking
SCATTER = 5e-3  # s, at least, from record to record
CLEARLY = 3.0  # standard uncertainties


@dataclass(frozen=True)
class Clock:
    """By which share the converter's clock is fast in a run, `stated` what its certificate allows (95 %)."""

    run: str
    error: float
    u: float
    stated: float

    @property
    def off(self) -> bool:
        return abs(self.error) > CLEARLY * self.u + self.stated

    @property
    def in_words(self) -> str:
        way = "fast" if self.error > 0.0 else "slow"
        return (
            f"{self.run}: the converter's clock is {abs(self.error):.2%} ± {2.0 * self.u:.2%} {way} by that of its "
            f"machine, its certificate allows {self.stated * 1e6:.3g} ppm: another crystal, or a wrong divider?"
        )


def clock_of(run: Recorded) -> Clock | None:
    """The clock of one run's converter, from the pace of all its records; None if none is known.

    A line through how late conversions were taken; how late in the mean is known beforehand to its uncertainty.
    """
    paces = [entry.body["pace"] for entry in run.lines if "pace" in entry.body]
    if not paces:
        return None
    converted, elapsed = _seconds(paces, run.name)
    design = np.column_stack([np.ones_like(elapsed), -elapsed])
    rows = np.vstack([design / SCATTER, [1.0 / U_LATE, 0.0]])
    right = np.append((elapsed - converted) / SCATTER, LATE / U_LATE)
    covariance = np.linalg.inv(rows.T @ rows)
    solution = covariance @ rows.T @ right
    left = right - rows @ solution
    scatter = math.sqrt(max(float(left @ left) / max(len(paces) - 1, 1), 1.0))
    return Clock(run.name, float(solution[1]), scatter * math.sqrt(float(covariance[1, 1])), _stated(run))


def _seconds(paces: Sequence[object], run: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How long every record was, s by the converter and s by its machine. Raises ArchiveError for anything else."""
    try:
        converted, elapsed = np.array(paces, np.float64).T
    except (TypeError, ValueError) as error:
        raise ArchiveError(f"{run}: found another pace ({error}), wanted two times in seconds") from None
    return converted, elapsed


def flagged(results: Iterable[Result], clocks: Sequence[Clock]) -> Iterator[Result]:
    """The results; those that stand on a clock that is off are flagged."""
    said = tuple(one.in_words for one in clocks if one.off)
    for result in results:
        stands = result.determined and any(line.name == LINE for line in result.contributions)
        yield replace(result, status="flagged", remarks=(*result.remarks, *said)) if said and stands else result


def _stated(run: Recorded) -> float:
    try:
        return 2.0 * reference(run, LINE.replace(" ", "_"), "rate").u
    except BadInput:
        return 0.0
