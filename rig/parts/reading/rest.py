"""An imported record at rest: mean, scatter and the noise coefficients of every channel, SI."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from rig.errors import BadInput
from rig.foreign.faults import faults
from rig.foreign.manifest import SI_OF, Column
from rig.foreign.tables import Foreign, Table
from rig.motion import Array
from rig.signals import noise
from rig.signals.noise import Coefficient, NoiseFit
from rig.signals.noise_at_rest import step_of
from rig.signals.spectrum import Lines, Periodogram

FEWEST = 16  # rows, below which there is no noise to speak of


@dataclass(frozen=True)
class Spectrum:
    """Lines of a record, the noise model fitted to them, and what its numbers are rounded to, SI."""

    lines: Lines
    fitted: NoiseFit
    step: float


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
        units = {"N": f"{self.unit}/√Hz", "B": self.unit, "K": f"{self.unit}·√Hz"}
        known = [
            f"{name} = {one.value:.4g} ± {2.0 * (one.u or 0.0):.2g} {units[name]}"
            for name, one in self.coefficients.items()
            if name in units and one.value is not None
        ]
        mean = (
            f"{self.table}, {self.channel}: mean {self.mean:.6g} {self.unit}, standard deviation {self.deviation:.3g}"
        )
        return "; ".join([mean, *known])


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
    rate = 1.0 / _interval(time)
    found = _spectrum(values, rate, step_of(values))
    mean, deviation = float(values.mean()), float(values.std(ddof=1))
    known = dict(noise.coefficients(found.fitted))
    return AtRest(table.label, column.channel, unit, mean, deviation, known, found)


def _spectrum(values: Array, rate: float, step: float) -> Spectrum:
    periodogram = Periodogram(rate)
    periodogram.feed(values)
    lines = periodogram.result()
    return Spectrum(lines, noise.fit_blocks(lines, step=step, pole=None), step)


def _interval(time: Array) -> float:
    """Usual time between two rows, s; the mean if rows come in batches that share one stamp."""
    usual = float(np.median(np.diff(time)))
    whole = float(time[-1] - time[0]) / (len(time) - 1)
    if not (math.isfinite(whole) and whole > 0.0 and usual >= 0.0):
        raise BadInput("found time stamps that do not go forward, wanted each later than the one before")
    return usual if usual > 0.0 else whole
