"""Sensitivities against what is declared of them: first the sign, then the size within the stated tolerance.

A sign is a declared property: what answers with the other one fails, however well its size fits.
"""

from __future__ import annotations

from dataclasses import replace

from rig.calibrate.calibration import SIGN_REVERSED, Result, text
from rig.calibrate.verdict import verdict
from rig.printed import SHOWN

SENSITIVITIES = ("sensitivity", "sensitivity_analyzer", "sensitivity_gravity", "sensitivity_centripetal")


def judged(result: Result, nominal: float, tolerance: float | None) -> Result:
    """A sensitivity with its verdict against the declared one, guard band U; other results as they are.

    `nominal` in the result's unit, with its sign; `tolerance` relative, None if none is stated. The sensitivity proper
    is always judged, other routes to it (gravity, ω²r, the analyzer) only speak up where they fail.
    """
    if result.measurand not in SENSITIVITIES or result.value is None:
        return result
    if result.value * nominal < 0.0 and abs(result.value) > result.expanded:
        return replace(result, verdict="fail", remarks=(_reversed(result, nominal), *result.remarks))
    if tolerance is None:
        return result
    low, high = sorted(nominal * (1.0 + sign * tolerance) for sign in (-1.0, 1.0))
    said = verdict(result.value, result.expanded, low, high)
    if result.status == "flagged":
        said = "inconclusive"  # a model that leaves something over says nothing about limits
    if result.measurand != "sensitivity" and said != "fail":
        return result
    return replace(result, low=low, high=high, verdict=said)


def _reversed(result: Result, nominal: float) -> str:
    unit, factor = SHOWN.get(result.unit, (result.unit, 1.0))
    declared = f"{nominal * factor:.4g}" + (f" {unit}" if unit != "1" else "")
    return f"{SIGN_REVERSED}: found {text(result)}, declared is {declared}"
