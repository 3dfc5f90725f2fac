"""A correction as the plain numbers that a module and a header hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rig.correction.chain import Chain
from rig.correction.correction import Correction
from rig.correction.inverse import SI, Bend, Drift, Half
from rig.errors import BadInput
from rig.export.identifiers import identifiers
from rig.export.selection import one_line

ONE = (1.0,)  # taps of a channel that nothing filters
SIMULATED = "SIMULATED: made on the simulated bench; says nothing about any real unit."


@dataclass(frozen=True)
class Numbers:
    """One channel: SI; `taps` and `ahead` (samples) of its filters' inverse, `lag` s without it; the words on it."""

    name: str
    quantity: str
    unit: str
    sensitivity: float
    zero: float
    u_sensitivity: float | None
    u_zero: float | None
    lag: float
    drifts: tuple[Drift, ...]
    bends: tuple[Bend, ...]
    ahead: int
    taps: tuple[float, ...]


def numbers_of(correction: Correction, rate: float | None) -> list[Numbers]:
    """Every channel's. Raises BadInput for a channel without sensitivity and for a rate that is none."""
    if rate is not None and not (math.isfinite(rate) and rate > 0.0):
        raise BadInput(f"export --rate: found {rate}, wanted samples per second above 0")
    if not correction.channels:
        raise BadInput("export --model: found no channel, wanted at least one")
    return [_numbers(chain, rate) for chain in correction.chains]


def _numbers(chain: Chain, rate: float | None) -> Numbers:
    channel = chain.channel
    if not channel.sensitivity or not math.isfinite(channel.sensitivity):
        raise BadInput(f"export --model: found a sensitivity of {channel.sensitivity} of {channel.name}, wanted one")
    found = chain.taps(rate) if chain.filtered and rate is not None else None
    return Numbers(
        channel.name, channel.quantity, SI[channel.quantity], channel.sensitivity, channel.zero,
        channel.u_sensitivity, channel.u_zero, chain.lag if chain.filtered else 0.0,
        chain.drifts, chain.bends, found.ahead if found else 0,
        tuple(float(tap) for tap in found.taps) if found else ONE,
    )  # fmt: skip


def rows_apart(correction: Correction) -> list[list[tuple[int, float]]]:
    """A⁻¹ without its zeros: (column, share) of every row."""
    return [[(k, float(share)) for k, share in enumerate(row) if share] for row in correction.coupling.inverse]


def half(of: Half) -> tuple[float, float, float, float, float]:
    """first, second, third, top (inf: none) and least slope of one side of a characteristic."""
    return of.first, of.second, of.third, of.top, of.least


def stays(correction: Correction, rate: float | None) -> list[str]:
    """What a robot's numbers keep, and how far filters are undone; a sentence each."""
    said = [*correction.said(), *correction.said_of(rate, ("temperature", "supply", "time"))]
    return [one_line(one) for one in said]


def heading(correction: Correction) -> list[str]:
    """Where the numbers come from, as lines."""
    return [one_line(one) for one in ([SIMULATED] if correction.simulated else []) + list(correction.provenance)]


def stem(correction: Correction) -> str:
    """A file name that is an identifier."""
    plain = identifiers([correction.unit])[correction.unit].lower()
    return f"c_{plain}" if plain[:1].isdigit() else plain


def words_of(channel: Numbers) -> str:
    """One channel in a line."""
    u = "" if channel.u_sensitivity is None else f" ± {channel.u_sensitivity:.2g}"
    zero = "" if channel.u_zero is None else f" ± {channel.u_zero:.2g}"
    sensitivity = f"{channel.sensitivity:.6g}{u} V/({channel.unit})"
    late = f", {channel.lag * 1e3:.4g} ms late" if channel.lag else ""
    return one_line(f"{channel.name}: {sensitivity}, zero {channel.zero:.6g}{zero} V (standard uncertainties){late}")


def filtered(channels: Sequence[Numbers]) -> bool:
    """Whether there is any filter to undo at the rate that was asked for."""
    return any(one.taps != ONE or one.ahead for one in channels)
