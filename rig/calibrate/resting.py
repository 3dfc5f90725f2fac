"""Noise of every channel from records at rest: the spectrum's model, and the deviation that a data sheet would state.

The deviation is the standard deviation of the output between 1/30 Hz and half the sampling rate with the converter's
rounding and steady lines taken away; "at rest" alone would not define it, because flicker grows with the length of the
record, and hum is the bench's.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.archive.records import Recorded, statics
from rig.archive.reduced import reduced
from rig.errors import BadInput
from rig.signals import noise, spectrum, steady_lines

LOWEST = 1.0 / 30.0  # Hz
FEW = 3  # channels that are said by name
SHORTEST = 4.0  # s; a shorter record says nothing of a deviation down to 1/30 Hz


@dataclass(frozen=True)
class Resting:
    """Noise of one channel, in volts.

    `deviation` (V rms) with its degrees of freedom, or None with the reason; `fit` is the spectrum's model. `lines`,
    which stand in neither, are in `unit`.
    """

    channel: str
    run: str
    record: str
    seconds: float
    fit: noise.NoiseFit
    deviation: float | None
    dof: float
    reason: str = ""
    lines: tuple[steady_lines.SteadyLine, ...] = ()
    unit: str = "V"

    @property
    def slow(self) -> noise.NoiseModel:
        """The model for means over seconds: flicker that the record did not show is counted at the most it could hide.

        A corner below a few periods of the record cannot be told from white noise there.
        """
        model = self.fit.model
        if model.flicker > 0.0 or model.random_walk > 0.0:
            return model
        return replace(model, flicker=(model.white + model.quantisation) * noise.CORNER_PERIODS / self.seconds)


def noise_of(
    runs: Sequence[Recorded], channels: Iterable[str], poles: Mapping[str, float]
) -> tuple[dict[str, Resting], dict[str, str]]:
    """Noise of each channel from the longest record at rest that has it; `poles` (Hz): where to look for a filter.

    The second mapping says why a channel has none: its record was clipped, constant or too short.
    """
    best: dict[str, tuple[float, Recorded, str]] = {}
    wanted = set(channels)
    for records in runs:
        for body in statics(records):
            cables = records.header["bench_file"]["cables"][body["cables"]]
            for name in wanted.intersection(cables):
                if float(body["seconds"]) > best.get(name, (0.0,))[0]:
                    best[name] = (float(body["seconds"]), records, str(body["samples"]))
    groups: dict[tuple[int, str], list[str]] = {}
    for name, (_, records, block) in best.items():
        groups.setdefault((id(records), block), []).append(name)
    found: dict[str, Resting] = {}
    missing: dict[str, str] = {}
    for (_, block), names in groups.items():
        records = best[names[0]][1]
        for name, one in _of_record(records, block, names, poles).items():
            if isinstance(one, str):
                missing[name] = f"{records.name}, record at rest: {one}"
            else:
                found[name] = one
    return found, missing


def _of_record(
    records: Recorded, block: str, names: Sequence[str], poles: Mapping[str, float]
) -> dict[str, Resting | str]:
    """Noise of channels of one record, or why there is none."""
    kinds = (Resting, noise.NoiseFit, noise.NoiseModel, steady_lines.SteadyLine)
    looked_for = {name: poles.get(name) for name in sorted(names)}
    return reduced(
        records, f"rest-{block}", kinds, lambda: _looked_at(records, block, list(looked_for), poles), looked_for
    )  # fmt: skip


def _looked_at(
    records: Recorded, block: str, names: Sequence[str], poles: Mapping[str, float]
) -> dict[str, Resting | str]:
    fed: dict[str, spectrum.Periodogram] = {}
    clipped = dict.fromkeys(names, 0)
    step = 0.0
    for piece in records.pieces(block):
        for name in names:
            channel = piece.channels[piece.index(name)]
            step = (channel.high - channel.low) / 65535.0
            fed.setdefault(name, spectrum.Periodogram(piece.timing.scan_rate)).feed(piece.volts(name))
            clipped[name] += piece.clipped(name)
    found: dict[str, Resting | str] = {}
    for name, periodogram in fed.items():
        if clipped[name]:
            found[name] = f"clipped ({clipped[name]} samples)"
            continue
        try:
            lines, steady = steady_lines.without_lines(periodogram, functools.partial(_volts, records, block, name))
        except BadInput as error:
            found[name] = str(error)
            continue
        fitted = noise.fit_blocks(lines, step=step, pole=poles.get(name))
        value, dof, reason = deviation(lines, fitted, step)
        found[name] = Resting(name, records.name, block, lines.seconds, fitted, value, dof, reason, steady)
    return found


def _volts(records: Recorded, block: str, name: str) -> Iterator[NDArray[np.float64]]:
    """A channel's record piece by piece."""
    return (piece.volts(name) for piece in records.pieces(block))


def deviation(lines: spectrum.Lines, fitted: noise.NoiseFit, step: float) -> tuple[float | None, float, str]:
    """Standard deviation above 1/30 Hz, V, with effective degrees of freedom; None and why for a short record.

    Every line of a cosine transform is normal with the density as variance, lines 1/(2T) apart, so the variance of
    their sum is ∫S² df / T, here with the fitted density.
    """
    if lines.seconds < SHORTEST:
        return None, 0.0, f"record of {lines.seconds:.3g} s, wanted at least {SHORTEST:g} s"
    apart = 0.5 / lines.seconds
    below = lines.low_frequency < LOWEST * (1.0 - 1e-9)
    power = lines.variance - float(np.sum(lines.low[below] ** 2)) * apart - step**2 / 12.0
    if power <= 0.0:
        return None, 0.0, "found no noise above the converter's rounding, wanted a smaller range"
    return math.sqrt(power), 2.0 * power**2 / _variance(fitted.model, lines.seconds), ""


def _variance(model: noise.NoiseModel, seconds: float) -> float:
    """∫S² df / T above 1/30 Hz or the record's lowest line, V⁴."""
    f: NDArray[np.float64] = np.geomspace(max(LOWEST, 0.5 / seconds), model.rate / 2.0, 2000)
    return float(np.trapezoid(model.density(f) ** 2, f)) / seconds


def lines_said(noise_: Mapping[str, Resting]) -> Iterator[str]:
    """Steady lines that were taken out of records at rest, with the channels that have them, in one sentence."""
    every = sorted((line.frequency, name) for name, one in noise_.items() for line in one.lines)
    starts = [n for n, (f, _) in enumerate(every) if not n or f - every[n - 1][0] > steady_lines.REACH]
    said = []
    for first, stop in itertools.pairwise([*starts, len(every)]):
        names = sorted({name for _, name in every[first:stop]})
        shown = ", ".join(names[:FEW]) + (f" and {len(names) - FEW} more" if len(names) > FEW else "")
        mean = sum(f for f, _ in every[first:stop]) / (stop - first)
        said.append(f"{mean:.4g} Hz ({shown})")
    if said:
        yield f"steady lines are not counted as noise: {'; '.join(said)}"


def conditions_of(runs: Sequence[Recorded]) -> dict[str, tuple[float, float, float]]:
    """Mean, lowest and highest temperature (°C) and supply (V) over all points and records."""
    found: dict[str, list[float]] = {"temperature": [], "supply": []}
    for records in runs:
        for entry in records.lines:
            noted: Mapping[str, Any] = entry.body.get("conditions", {}) if entry.kind in ("point", "step") else {}
            for name, values in found.items():
                if name in noted and math.isfinite(float(noted[name])):
                    values.append(float(noted[name]))
    return {name: (float(np.mean(v)), min(v), max(v)) for name, v in found.items() if v}
