"""One value to use: what several references say of one sensitivity, combined with their covariance.

    y = Σ w·yᵢ,  w = C⁻¹1 / (1ᵀC⁻¹1),  χ² = (y − yᵢ)ᵀ C⁻¹ (y − yᵢ)

C is their covariance: what comes from one certificate is one error. The vibrometer's value of a channel and gravity's
share nothing, so a χ² that chance does not explain says that one of the references is off (Cox 2002, Metrologia 39,
589; GUM 5.2).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import COMBINED, ROUTES, Result, covariance_of, text
from rig.calibrate.gyros import WHOLE_BUDGET
from rig.calibrate.judging import judged
from rig.sensor import Sensor

UNLIKELY = 0.05  # of a whole calibration without a wrong reference: that one of its channels is said to disagree


def combined(results: Sequence[Result], sensor: Sensor) -> Iterator[Result]:
    """The results, and before those of a channel that more than one reference has determined one row of all of them."""
    groups: dict[str, list[Result]] = {}
    for one in results:
        if one.measurand in ROUTES and one.determined and one.status == "determined" and _whole(one):
            groups.setdefault(one.channel, []).append(one)
    several = {channel: group for channel, group in groups.items() if len(group) > 1 and channel in sensor}
    count = len(several)
    for one in results:
        group = several.pop(one.channel, None)
        if group is not None:
            row, channel = _of(group, UNLIKELY / count), sensor.channel(one.channel)
            yield judged(row, channel.nominal, channel.tolerance)
        yield one


def _whole(one: Result) -> bool:
    """Whether its budget holds all that is known to matter."""
    return one.measurand != "sensitivity_centripetal" or {line.name for line in one.contributions} >= WHOLE_BUDGET


def _of(group: Sequence[Result], unlikely: float) -> Result:
    from scipy.special import chdtrc

    values = np.array([float(one.value or 0.0) for one in group])
    inverse = np.linalg.inv(covariance_of(group))
    weights = inverse.sum(axis=0) / inverse.sum()
    value = float(weights @ values)
    chi2, dof = float((values - value) @ inverse @ (values - value)), len(group) - 1
    probability = float(chdtrc(dof, chi2))
    lines = list(_lines(group, weights))
    said = "; ".join(f"{_by(one)} {text(one)}" for one in group)
    said = f"{said}; χ² = {chi2:.2g} with {dof} degree{'s' if dof > 1 else ''} of freedom"
    apart: tuple[str, ...] = ()
    if probability < unlikely:
        spread = Budget(tuple(lines)).u * math.sqrt(chi2 / dof - 1.0)
        lines.append(Contribution("disagreement of the references", "A", "normal", spread, group[0].unit, 1.0, dof))
        apart = (f"the references disagree (probability {probability:.2g}): one of them is off",)
    return replace(
        group[0], measurand=COMBINED, title="sensitivity, all references combined", value=value,
        budget=Budget(tuple(lines)), method="results by several references, mean weighted with their covariance",
        reference="; ".join(dict.fromkeys(one.reference for one in group)), remarks=(*apart, said),
        status="flagged" if apart else "determined", low=None, high=None, verdict=None, check=None,
    )  # fmt: skip


def _lines(group: Sequence[Result], weights: NDArray[np.float64]) -> Iterator[Contribution]:
    """The budgets' lines by weight: those of one origin together, others under the name of their route."""
    every = [(one, line, float(w)) for one, w in zip(group, weights, strict=True) for line in one.contributions]
    found: dict[tuple[str, str], Contribution] = {}
    for one, line, weight in every:
        origin = (line.name, line.source) if line.kind == "B" and line.source else (one.measurand, line.name)
        before = found.get(origin)
        if before is not None:
            more = weight * line.sensitivity * line.u / before.u if before.u else 0.0
            found[origin] = replace(before, sensitivity=before.sensitivity + more)
        else:
            name = line.name if _alone(line.name, every) else f"{line.name} ({_by(one)})"
            found[origin] = replace(line, name=name, sensitivity=weight * line.sensitivity)
    yield from found.values()


def _by(one: Result) -> str:
    """The reference in a word or two."""
    return one.reference.partition(",")[0]


def _alone(name: str, every: Iterable[tuple[Result, Contribution, float]]) -> bool:
    """Whether all lines of a name are of one origin."""
    lines = [(one.measurand, line) for one, line, _ in every if line.name == name]
    sources = {line.source for _, line in lines}
    return len(lines) == 1 or (len(sources) == 1 and sources != {""} and all(line.kind == "B" for _, line in lines))
