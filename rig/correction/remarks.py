"""What a correction leaves in the values, and where what it undoes ends: a sentence each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rig.correction import expression
from rig.correction.chain import Chain, Channel, Undone
from rig.correction.coupling import SIGNALS, Coupling
from rig.correction.dynamics import Taps
from rig.correction.inverse import AXES, SI, UNITS, Bend, Late, Lost, Nothing, Shares


def always(coupling: Coupling) -> Iterator[str]:
    """What is not undone whatever is given, and where what is undone ends."""
    for one in coupling.undone:
        yield from _of_effect(one, [channel for channel in coupling.channels if one.of(channel)])
    yield from _of_neighbours(coupling)
    for channel in coupling.channels:
        if channel.u_zero is None:
            yield f"{channel.name}: {channel.zero:g} V is taken off as zero output, whose uncertainty is not known"


def _of_effect(one: Undone, here: Sequence[Channel]) -> Iterator[str]:
    """Of one effect on the channels it acts on."""
    match one.inverse:
        case Nothing(why=why):
            yield f"{one.name}: nothing to undo, {why}"
        case Lost(why=why) if here:
            yield f"{one.name}: not undone, {why}"
        case Bend() as bend if here:
            yield from _range(one.name, bend, SI[here[0].quantity])
        case Late() if here:
            unknown = [channel.name for channel in here if channel.slot is None]
            if unknown:
                yield f"{one.name}: not undone for {', '.join(unknown)}, found no slot of the scan in the model"
        case Shares() if here:
            unknown = [channel.name for channel in here if channel.axis is None]
            if unknown:
                yield f"{one.name}: not undone for {', '.join(unknown)}, found no axis in the model"


def _range(name: str, bend: Bend, unit: str) -> Iterator[str]:
    low, high = bend.range
    if math.isfinite(low) or math.isfinite(high):
        yield f"{name}: undone between {low:.4g} and {high:.4g} {unit}, beyond which the output does not tell the input"


def _of_neighbours(coupling: Coupling) -> Iterator[str]:
    """Of what is felt of axes along which there is no channel."""
    channels = coupling.channels
    for c, axis, shares, name in coupling.shares():
        missing = list(_missing(coupling, c, axis, shares))
        if missing:
            yield f"{name}: not undone for {channels[c].name}, found no channel of {' and '.join(missing)}"
    for c, tree, name in coupling.added():
        lacking = [one for one in expression.names(tree) if one in SIGNALS and coupling.stands_for(c, one) is None]
        if lacking:
            yield f"{name}: not undone for {channels[c].name}, found no channel that tells {lacking[0]}"


def _missing(coupling: Coupling, c: int, axis: int, shares: Shares) -> Iterator[str]:
    own = coupling.channels[c].quantity
    felt = [*shares.straight(own), *shares.rises(own)]
    wanted = {(quantity, j) for quantity, matrix in felt for j in np.flatnonzero(matrix[axis]).tolist()}
    wanted |= {("rate", j) for j in np.flatnonzero(shares.spin[axis].any(axis=0)).tolist()}
    for quantity, j in sorted(wanted):
        if coupling.source(c, quantity, j) is None:
            yield f"{quantity} along {AXES[j]}"


def of_rate(chains: Sequence[Chain], coupling: Coupling, rate: float | None) -> Iterator[str]:
    """What is not undone without a rate; with one, how far filters are."""
    filtered = [one for one in chains if one.filtered]
    if rate is not None:
        words = {one.channel.name: _filter_words(one.taps(rate)) for one in filtered}
        yield from (f"filters and delays of {', '.join(names)}: {text}" for text, names in _grouped(words))
        return
    if filtered:
        worst = max(filtered, key=lambda one: abs(one.lag))
        yield f"filters and delays: not undone without a rate; {worst.channel.name} is {worst.lag * 1e3:.4g} ms late"
    if any(one.second is None for one in coupling.felt):
        yield "angular acceleration and changes of force: what they add is not undone without a rate"


def of_conditions(chains: Sequence[Chain], coupling: Coupling, given: Sequence[str]) -> Iterator[str]:
    """What is not undone, or assumed, because a condition was not given."""
    lacking = dict.fromkeys(of for one in coupling.written for of in one.conditions if of not in given)
    yield from (f"{of}: not given, what follows it by a formula is not undone" for of in lacking)
    for of in ("temperature", "supply", "time"):
        usual = {drift.usual for one in chains for drift in one.drifts if drift.of == of}
        if usual and of not in given:
            at = " or ".join(f"{one:g} {UNITS[of]}" for one in sorted(usual))
            yield f"{of}: not given, {'long after the start' if math.inf in usual else at} assumed"


def _filter_words(found: Taps) -> str:
    return (
        f"undone up to {found.band:.3g} Hz within {found.error:.1e}, fading out above; white noise × {found.noise:.2f}"
    )


def _grouped(words: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    found: dict[str, list[str]] = {}
    for name, text in words.items():
        found.setdefault(text, []).append(name)
    return list(found.items())
