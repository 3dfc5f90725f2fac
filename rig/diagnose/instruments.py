"""Tests of the instruments and of the metadata, before any physics of the sensor is blamed.

Each looks at something that the fit itself does not see: lines counted between index pulses, samples of the vibrometer
that stand out of their record, the driven frequency by the converter's clock, values that no data sheet allows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.model import Effect, Term
from rig.parts.sine_lines import drive_clock
from rig.parts.sines import SineRecords

CLOCK = 20e-6  # what generator and converter state of their clocks together, relative
IMPLAUSIBLE = 6.0  # tolerances of a data sheet


@dataclass(frozen=True)
class Finding:
    """An effect that a test of its own sees: with its coordinates, u, the strength of the evidence as χ², and why."""

    term: Term
    u: Mapping[str, float]
    evidence: float
    because: str


def findings(evidence: Evidence, shelf: Mapping[str, Effect], there: set[str]) -> list[Finding]:
    """What the instruments' own tests find that is not in the model, strongest first."""
    tests = (_closure, _dropouts, _clock)
    found = [one for test in tests for one in test(evidence, shelf) if one.term.effect.name not in there]
    return sorted(found, key=lambda one: -one.evidence)


def _closure(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[Finding]:
    lost = sum(part.data.lost for part in evidence.turnings)
    lines = sum(part.data.lines for part in evidence.turnings)
    if lost and "missed_counts" in shelf:
        share = lost / lines
        because = f"{lost} of {lines} lines are missing between index pulses, each where an interval is twice as long"
        # a line that is missing is no matter of noise
        yield Finding(Term(shelf["missed_counts"], None, {"share": share}), {"share": math.sqrt(lost) / lines},
                      1000.0 * lost, because)  # fmt: skip


def _dropouts(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[Finding]:
    rows = [part.data.outliers[part.data.index >= 0] for part in evidence.sines]
    if not rows or "ldv_dropout" not in shelf:
        return
    outliers = np.concatenate(rows)
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
    yield Finding(Term(shelf["ldv_dropout"], None, at), u, 36.0 * len(hit), because)


def _clock(evidence: Evidence, shelf: Mapping[str, Effect]) -> Iterator[Finding]:
    ratios = [
        part.data.frequency[driven] / part.data.nominal[driven] - 1.0
        for part in evidence.sines
        if (driven := part.data.nominal > 0.0).any() and not drive_off(part.data)
    ]
    if not ratios or "clock_ratio" not in shelf:
        return
    error = -float(np.median(np.concatenate(ratios)))
    because = (
        f"every driven frequency is {error * 1e6:+.0f} ppm off by the converter's clock, stated ± {CLOCK * 1e6:.0f}"
    )
    yield Finding(Term(shelf["clock_ratio"], None, {"error": error}), {"error": CLOCK}, (error / CLOCK) ** 2, because)


def drive_off(data: SineRecords) -> bool:
    """Whether the drive is off and not the converter's clock: mains lines then come out at the mains frequency."""
    return drive_clock(data.frequency, data.nominal, data.leftovers, data.mains) is not None


def implausible(found: Fit) -> list[str]:
    """Gains and poles that no data sheet allows: a wrong range, a wrong unit, a reversed sign; in words."""
    said = []
    tolerance = {n: float(t) for p in found.parts for n, t in zip(p.channels.names, p.channels.tolerance, strict=True)}
    for name, gain in found.state.gain.items():
        if gain < -1.0:
            said.append(f"{name}: sensitivity has the wrong sign ({1.0 + gain:+.3g} of the data sheet's)")
        elif abs(gain) > IMPLAUSIBLE * tolerance[name]:
            said.append(f"{name}: sensitivity is {1.0 + gain:.3g} of the data sheet's: a range or a unit is wrong")
    return said
