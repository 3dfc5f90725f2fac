"""What sweeps tell beside their fit: tests of vibrometer and clock, what they lack, and responses for the ripple."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rig.parts.remainder import Sign
from rig.parts.ripple import said
from rig.parts.sweep_lines import drive_clock
from rig.parts.sweep_records import SweepRecords

CLOCK = 20e-6  # what generator and converter state of their clocks together, relative


def signs(sweeps: Sequence[SweepRecords]) -> Iterator[Sign]:
    """Samples of the vibrometer that stand out of their record, and the driven frequency by the converter's clock."""
    yield from _dropouts(sweeps)
    yield from _clock(sweeps)


def _dropouts(sweeps: Sequence[SweepRecords]) -> Iterator[Sign]:
    outliers = np.concatenate([data.outliers[data.driven] for data in sweeps])
    hit = outliers[outliers[:, 0] > 0.0]
    if len(hit) < 2:
        return
    share, depth = float(outliers[:, 0].mean()), float(np.median(hit[:, 1]))
    if not 0.0 < depth <= 1.05:
        return
    scatter = 1.4826 * float(np.median(np.abs(hit[:, 1] - depth))) / math.sqrt(len(hit))
    because = (
        f"{share:.2%} of the vibrometer's samples, in bursts, are {depth:.3g} of the signal too small "
        f"in {len(hit)} of {len(outliers)} records"
    )
    at = {"share": share, "depth": min(depth, 1.0)}
    u = {"share": share / math.sqrt(len(hit)), "depth": max(scatter, 1e-4)}
    yield Sign("ldv_dropout", at, u, 36.0 * len(hit), because)


def _clock(sweeps: Sequence[SweepRecords]) -> Iterator[Sign]:
    ratios = [
        data.frequency[driven] / data.nominal[driven] - 1.0
        for data in sweeps
        if (driven := data.nominal > 0.0).any() and not drive_off(data)
    ]
    if not ratios:
        return
    error = -float(np.median(np.concatenate(ratios)))
    because = (
        f"every driven frequency is {error * 1e6:+.0f} ppm off by the converter's clock, stated ± {CLOCK * 1e6:.0f}"
    )
    yield Sign("clock_ratio", {"error": error}, {"error": CLOCK}, (error / CLOCK) ** 2, because)


def drive_off(data: SweepRecords) -> bool:
    """Whether the drive is off and not the converter's clock: mains lines then come out at the mains frequency."""
    return data.drive_off or drive_clock(data.frequency, data.nominal, data.leftovers, data.mains) is not None


def _levels(sweeps: Sequence[SweepRecords]) -> set[str]:
    return {level for data in sweeps for level in data.level if level != "rest"}


def _axes(sweeps: Sequence[SweepRecords]) -> list[str]:
    return sorted({data.axis for data in sweeps})


def lacks(sweeps: Sequence[SweepRecords]) -> Iterator[str]:
    """What these sweeps cannot show."""
    if not sweeps:
        yield "no sweep: the dynamics of the accelerometers, their nonlinearity and cross-axis sensitivity"
        return
    if len(_levels(sweeps)) == 1:
        yield (
            "one drive level only: gain that depends on level cannot be told from gain that depends on frequency; "
            "repeat with --levels full,quarter"
        )
    if not any("rest" in data.level for data in sweeps):
        yield "no static record: zero output, its drift and slow noise at rest on the shaker; add a record at rest"
    axes = _axes(sweeps)
    if len(axes) < 3:
        yield f"driven along {', '.join(axes)} only: accelerometers across it feel no drive but gravity"


def unmeasured(sweeps: Sequence[SweepRecords], blind: Sequence[str]) -> Iterator[tuple[str, str]]:
    """What a sweep could still measure, and the command."""
    if not sweeps:
        yield "no sweep: dynamics of the accelerometers, nonlinearity, cross-axis", "rig sweep --axis x"
        return
    axes = _axes(sweeps)
    if len(_levels(sweeps)) == 1:
        command = f"rig sweep --axis {axes[0]} --levels full,quarter"
        yield "one drive level: level and frequency cannot be told apart", command
    if said(None) in blind:
        yield "the bench's own ripple is not known", "rig run remounts.yaml && rig floor last"
    for axis in "xyz":
        if axis not in axes:
            yield f"not driven along {axis}", f"rig sweep --axis {axis}"


def responses(data: SweepRecords) -> Mapping[tuple[str, float, str], tuple[complex, float]]:
    """Response and relative variance of each part by channel, nominal frequency and level, for the driven axis."""
    found = {}
    for c in data.along:
        for p in np.flatnonzero(data.driven & data.usable[c]):
            shown = complex(data.shown[p, 1])
            relative = data.variance[c, p, 1] / abs(complex(data.observed[c, p, 1])) ** 2
            relative += data.reference_variance[p, 1] / abs(shown) ** 2
            key = (data.channels.names[c], float(data.nominal[p]), data.level[p])
            found[key] = (complex(data.observed[c, p, 1]) / shown, float(relative))
    return found
