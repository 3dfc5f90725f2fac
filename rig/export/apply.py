"""Turns raw counts and volts of a calibrated unit into m/s² and rad/s; the tail of every exported Python module.

`rig export --to python` copies this file, with the numbers of one calibration in place of the empty ones below. It
needs the standard library only (Python 3.10 or later), and takes floats, lists, and arrays that know arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

# numbers: begin
PROVENANCE: Mapping[str, Any] = {}
CHANNELS: Mapping[str, Mapping[str, Any]] = {}
TRIADS: Mapping[str, Sequence[str]] = {}
CROSS_AXIS: Mapping[str, Sequence[Sequence[float]] | None] = {}
UNCERTAINTY: Mapping[str, Mapping[str, Mapping[str, Any]]] = {}
NOT_DETERMINED: Mapping[str, str] = {}
# numbers: end


def counts_to_volts(counts: Any, low: float = -10.0, high: float = 10.0) -> Any:
    """Volts of raw 16-bit offset-binary counts: 0 is `low`, 65535 is `high`."""
    if isinstance(counts, (list, tuple)):
        return [counts_to_volts(count, low, high) for count in counts]
    return counts / 65535.0 * (high - low) + low


def apply(channel: str, volts: Any, *, supply: Any = None) -> Any:
    """Acceleration (specific force, m/s²) or rate (rad/s) of one channel: (volts − offset) / sensitivity.

    `supply`, in volts, takes out how the output follows the supply: V = (S·u + V0)·(1 + share·(Vs/Vs_ref − 1)).
    Without it the supply is taken to be that of the calibration. The output filter's lag is not taken out.
    Raises ValueError for a channel that is not in the calibration, and for a supply whose influence is not.
    """
    numbers = _numbers(channel)
    if isinstance(volts, (list, tuple)):
        supplies = supply if isinstance(supply, (list, tuple)) else [supply] * len(volts)
        return [apply(channel, volt, supply=its) for volt, its in zip(volts, supplies, strict=True)]
    if supply is not None:
        volts = volts / _supply_gain(channel, supply)
    return (volts - numbers["offset"]) / numbers["sensitivity"]


def apply_triad(triad: str, volts: Sequence[Any], *, supply: Any = None) -> list[Any]:
    """Acceleration or rate about x, y, z from the three channels of TRIADS[triad], in that order.

    The cross-axis matrix is taken out where CROSS_AXIS[triad] has one; where it is None, each axis is applied alone.
    """
    if triad not in TRIADS:
        raise ValueError(f"found the triad {triad!r}, wanted one of {', '.join(TRIADS) or 'none'}")
    readings = [apply(channel, its, supply=supply) for channel, its in zip(TRIADS[triad], volts, strict=True)]
    matrix = CROSS_AXIS[triad]
    return readings if matrix is None else [_weighted(row, readings) for row in inverse(matrix)]


def inverse(matrix: Sequence[Sequence[float]]) -> list[list[float]]:
    """Inverse of a 3 × 3 matrix by cofactors; raises ValueError if it has none."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if determinant == 0.0:
        raise ValueError("found a cross-axis matrix without an inverse, wanted one near the unit matrix")
    cofactors = [
        [e * i - f * h, c * h - b * i, b * f - c * e],
        [f * g - d * i, a * i - c * g, c * d - a * f],
        [d * h - e * g, b * g - a * h, a * e - b * d],
    ]
    return [[value / determinant for value in row] for row in cofactors]


def _weighted(weights: Sequence[float], parts: Sequence[Any]) -> Any:
    if isinstance(parts[0], (list, tuple)):
        return [_weighted(weights, sample) for sample in zip(*parts, strict=True)]
    return weights[0] * parts[0] + weights[1] * parts[1] + weights[2] * parts[2]


def _numbers(channel: str) -> Mapping[str, Any]:
    if channel in NOT_DETERMINED:
        raise ValueError(f"{channel}: found no calibration ({NOT_DETERMINED[channel]}), wanted another channel")
    if channel not in CHANNELS:
        raise ValueError(f"found the channel {channel!r}, wanted one of {', '.join(CHANNELS) or 'none'}")
    return CHANNELS[channel]


def _supply_gain(channel: str, supply: Any) -> Any:
    share, reference = CHANNELS[channel]["supply_share"], CHANNELS[channel]["supply_reference"]
    if share is None or reference is None:
        raise ValueError(f"{channel}: found a supply, but its influence was not determined, wanted supply=None")
    return 1.0 + share * (supply / reference - 1.0)
