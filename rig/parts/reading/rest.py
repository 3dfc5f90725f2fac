"""An imported record at rest: mean, scatter and the noise coefficients of every channel, SI."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.foreign.faults import GAP, faults
from rig.foreign.finding import runs
from rig.foreign.manifest import SI_OF, Column
from rig.foreign.tables import Foreign, Table
from rig.motion import Array
from rig.signals import noise
from rig.signals.noise import Coefficient, NoiseFit
from rig.signals.noise_at_rest import step_of
from rig.signals.spectrum import Lines, Periodogram
from rig.signals.steady_lines import SteadyLine, without_lines

LEAST_STEPS = 0.5  # standard deviation of noise in steps: from there rounding adds its twelfth to within some per cent
MOST = 0.5  # of the rows in one stretch without a gap: then it is the record
SLOW = ("B", "K", "R")  # where rows stand apart that follow one another here, these come out as if time had stood still
FEWEST = 16  # rows, below which there is no noise to speak of


@dataclass(frozen=True)
class Spectrum:
    """Lines of a record, the noise model fitted to them, what its numbers are rounded to, and what is steady, SI."""

    lines: Lines
    fitted: NoiseFit
    step: float
    steady: tuple[SteadyLine, ...] = ()


@dataclass(frozen=True)
class AtRest:
    """One channel at rest: mean and standard deviation (SI), coefficients N (SI/√Hz), B (SI) and K (SI·√Hz).

    `spectrum` is what the noise was found from. `reason` says why there is nothing of that.
    """

    table: str
    channel: str
    unit: str
    mean: float
    deviation: float
    coefficients: dict[str, Coefficient]
    spectrum: Spectrum | None = field(default=None, repr=False)
    reason: str = ""

    @property
    def in_words(self) -> str:
        """One line."""
        if self.reason:
            return f"{self.table}, {self.channel}: no noise, {self.reason}"
        units = {"N": f"{self.unit}/√Hz", "B": self.unit, "K": f"{self.unit}·√Hz", "R": f"{self.unit}/s (a ramp)"}
        known = [
            f"{name} = {one.value:.4g} ± {2.0 * (one.u or 0.0):.2g} {units[name]}"
            for name, one in self.coefficients.items()
            if name in units and one.value is not None
        ]
        mean = (
            f"{self.table}, {self.channel}: mean {self.mean:.6g} {self.unit}, standard deviation {self.deviation:.3g}"
        )
        steady = () if self.spectrum is None else self.spectrum.steady
        lines = [f"a steady line at {one.frequency:.4g} Hz of {one.rms:.3g} {self.unit} rms" for one in steady]
        return "; ".join([mean, *known, *lines])


def at_rest(foreign: Foreign) -> Iterator[AtRest]:
    """Every channel of the device in every file."""
    for table in foreign.tables:
        for column in foreign.manifest.of("device"):
            yield _channel(foreign, table, column)


def _channel(foreign: Foreign, table: Table, column: Column) -> AtRest:
    unit = SI_OF.get(column.quantity, "")
    try:
        return _known(foreign, table, column, unit)
    except BadInput as error:
        return AtRest(table.label, column.channel, unit, math.nan, math.nan, {}, reason=str(error))


def _known(foreign: Foreign, table: Table, column: Column, unit: str) -> AtRest:
    """Raises BadInput for a record that says nothing of its noise."""
    values, time = foreign.si(table, column), foreign.time(table)
    if lacking := int(np.count_nonzero(~np.isfinite(values))):
        raise BadInput(f"found {lacking} rows without a number, wanted a whole record at rest")
    if wrong := faults(foreign, table, column):
        raise BadInput(f"found samples that are no measurement, wanted a whole record at rest: {wrong[0].text}")
    if len(values) < FEWEST:
        raise BadInput(f"found {len(values)} rows, wanted some hundred")
    _refuse_few_codes(values, step := step_of(values), unit)
    rate = 1.0 / _interval(time)
    together = _longest(time)
    glued = together == slice(None) and bool(_apart(time).any())
    found = _spectrum(values[together], rate, step, glued)
    mean, deviation = float(values.mean()), float(values.std(ddof=1))
    known = dict(noise.coefficients(found.fitted))
    if glued:
        known = {name: one for name, one in known.items() if name not in SLOW}
    return AtRest(table.label, column.channel, unit, mean, deviation, known, found)


def _refuse_few_codes(values: Array, step: float, unit: str) -> None:
    """Raises BadInput where noise hardly reaches from one number to the next: what rounding adds then goes with the
    signal, and step²/12 is not its variance.
    """
    if not step > 0.0:
        return
    scatter = min(float(values.std()), float(np.diff(values).std()) / math.sqrt(2.0))
    if scatter < math.hypot(LEAST_STEPS, 1.0 / math.sqrt(12.0)) * step:
        wanted = f"wanted half a step of its numbers ({step:.3g} {unit}) or more: finer numbers, or a louder range"
        raise BadInput(f"found a scatter of {scatter / step:.2g} steps, rounding among it, {wanted}")


def _spectrum(values: Array, rate: float, step: float, glued: bool) -> Spectrum:
    """Steady lines are looked for where time goes on evenly: rows glued over gaps make many of one."""
    heard = Periodogram(rate)
    heard.feed(values)
    lines, steady = (heard.result(), ()) if glued else without_lines(heard, lambda: [values])
    return Spectrum(lines, noise.fit_blocks(lines, step=step, pole=None, ramp=True), step, steady)


def _apart(time: Array) -> NDArray[np.bool_]:
    """Whether something is missing between a row and the next, (n − 1,)."""
    steps = np.diff(time)
    usual = float(np.median(steps))
    return np.asarray((steps > GAP * usual) & (usual > 0.0))  # rows in batches share one stamp


def _longest(time: Array) -> slice:
    """The longest stretch without a gap if it holds most rows; else all of them, one after the other as they stand."""
    first, count = max(runs(np.append(~_apart(time), True)), key=lambda one: one[1])
    count = min(count + 1, len(time) - first)
    return slice(first, first + count) if MOST * len(time) < count < len(time) else slice(None)


def _interval(time: Array) -> float:
    """Usual time between two rows, s; the mean if rows come in batches that share one stamp."""
    usual = float(np.median(np.diff(time)))
    whole = float(time[-1] - time[0]) / (len(time) - 1)
    if not (math.isfinite(whole) and whole > 0.0 and usual >= 0.0):
        raise BadInput("found time stamps that do not go forward, wanted each later than the one before")
    return usual if usual > 0.0 else whole
