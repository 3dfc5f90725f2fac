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

from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import COMBINED, ROUTES, Result, covariance_of, text
from rig.calibrate.gyros import WHOLE_BUDGET
from rig.calibrate.judging import judged
from rig.sensor import Sensor

UNLIKELY = 0.025  # with sound references: that a calibration's are said to disagree, and that a channel's of it are


def combined(results: Sequence[Result], sensor: Sensor) -> Iterator[Result]:
    """The results, and before those of a channel that more than one reference has determined one row of all of them,
    which alone is judged: of the others only what fails remains. A channel with a value that is not believed has none.
    """
    results = [one for one in results if one.measurand != COMBINED]
    groups: dict[str, list[Result]] = {}
    for one in results:
        if one.measurand in ROUTES and one.determined and one.status == "determined" and _whole(one):
            groups.setdefault(one.channel, []).append(one)
    doubted = {one.channel for one in results if one.measurand in ROUTES and one.rejected}
    several = {c: group for c, group in groups.items() if len(group) > 1 and c in sensor and c not in doubted}
    apart, made = _apart(several.values()), set[str]()
    for one in results:
        if one.channel in several and one.channel not in made:
            made.add(one.channel)
            row, channel = _of(several[one.channel], UNLIKELY / len(several), apart), sensor.channel(one.channel)
            yield judged(row, channel.nominal, channel.tolerance)
        kept = one.channel not in several or one.measurand not in ROUTES or one.verdict == "fail"
        yield one if kept else replace(one, low=None, high=None, verdict=None)


def _whole(one: Result) -> bool:
    """Whether its budget holds all that is known to matter."""
    return one.measurand != "sensitivity_centripetal" or {line.name for line in one.contributions} >= WHOLE_BUDGET


def _apart(groups: Iterable[Sequence[Result]]) -> tuple[str, ...]:
    """What is said if vibrometer and gravity differ by one factor in all channels by more than chance: the differences
    share the vibrometer's gain, so their best mean tells more than each of them.
    """
    pairs = [pair for group in groups if len(pair := [one for one in group if one.measurand in ROUTES[:2]]) == 2]
    pairs = [pair for pair in pairs if (pair[0].value or 0.0) * (pair[1].value or 0.0) > 0.0]  # a sign is no factor
    if not pairs:
        return ()
    every = [one for pair in pairs for one in pair]
    values = np.array([float(one.value or 1.0) for one in every])
    relative = covariance_of(every) / np.outer(values, values)
    signs = np.kron(np.eye(len(pairs)), np.array([1.0, -1.0]))
    ratios = np.log(values[::2] / values[1::2])
    inverse = np.linalg.pinv(signs @ relative @ signs.T, hermitian=True)
    mean, u = float((inverse @ ratios).sum() / inverse.sum()), float(inverse.sum()) ** -0.5
    if math.erfc(abs(mean) / u / math.sqrt(2.0)) >= UNLIKELY:
        return ()
    return (f"the references disagree: by the {_by(pairs[0][0])} sensitivities are {1.0 + mean:.5g} times those by "
            f"{_by(pairs[0][1])}, {abs(mean) / u:.2g} standard uncertainties: one of them is off",)  # fmt: skip


def _of(group: Sequence[Result], unlikely: float, apart: tuple[str, ...]) -> Result:
    from scipy.special import chdtrc

    values = np.array([float(one.value or 0.0) for one in group])
    inverse = np.linalg.pinv(covariance_of(group), hermitian=True)
    weights = inverse.sum(axis=0) / inverse.sum()
    value = float(weights @ values)
    chi2, dof = float((values - value) @ inverse @ (values - value)), len(group) - 1
    probability = float(chdtrc(dof, chi2))
    parts = [(label, one, float(weight)) for label, one, weight in zip(_labels(group), group, weights, strict=True)]
    lines = list(weighted(parts))
    if probability < unlikely:
        apart = (*apart, f"the references disagree here (probability {probability:.2g}): one of them is off")
    if apart and chi2 > dof:
        size = Budget(tuple(lines)).u * math.sqrt(chi2 / dof - 1.0)
        lines.append(Contribution("disagreement of the references", "B", "normal", size, group[0].unit, 1.0,
                                  source=group[0].channel))  # fmt: skip
    said = "; ".join(f"{label} {text(one)}" for label, one, _ in parts)
    said = f"{said}; χ² = {chi2:.2g} with {dof} degree{'s' if dof > 1 else ''} of freedom"
    others = tuple(dict.fromkeys(remark for one in group for remark in one.remarks))
    return replace(
        group[0], measurand=COMBINED, title="sensitivity, all references combined", value=value,
        budget=Budget(tuple(lines)), method="results by several references, mean weighted with their covariance",
        reference="; ".join(dict.fromkeys(one.reference for one in group)), remarks=(*apart, said, *others),
        status="flagged" if apart else "determined", low=None, high=None, verdict=None, check=None,
    )  # fmt: skip


def weighted(parts: Sequence[tuple[str, Result, float]]) -> Iterator[Contribution]:
    """Lines of a sum of results, each with a label of its own and a weight: what has one origin is one line, what has a
    name in common with others is told by its label.
    """
    every = [(label, line, weight) for label, one, weight in parts for line in one.contributions]
    found: dict[tuple[str, str], Contribution] = {}
    for label, line, weight in every:
        origin = (line.name, line.source) if line.kind == "B" and line.source else (label, line.name)
        name = line.name if _alone(line.name, every) else f"{line.name} ({label})"
        mine = replace(line, name=name, sensitivity=weight * line.sensitivity)
        before = found.get(origin)
        if before is None or not before.u:
            found[origin] = mine
        elif mine.u:
            more = mine.sensitivity * mine.u / before.u
            found[origin] = replace(before, sensitivity=before.sensitivity + more)
    yield from found.values()


def _labels(group: Sequence[Result]) -> list[str]:
    """The references in a word or two, each told from the others."""
    words = [_by(one) for one in group]
    return [f"{w}, {one.measurand}" if words.count(w) > 1 else w for w, one in zip(words, group, strict=True)]


def _by(one: Result) -> str:
    """The reference in a word or two."""
    return one.reference.partition(",")[0]


def _alone(name: str, every: Iterable[tuple[str, Contribution, float]]) -> bool:
    """Whether all lines of a name are of one origin."""
    lines = [line for _, line, _ in every if line.name == name]
    sources = {line.source for line in lines}
    return len(lines) == 1 or (len(sources) == 1 and sources != {""} and all(line.kind == "B" for line in lines))
