"""A result that stands on the fitted model, with the direct estimate beside it.

The direct estimator has laid out the budget: its lines for alignment, time base and temperature stay. The value, the
noise's share and what each prior contributes become those of the fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from rig.calibrate import agreement
from rig.calibrate.agreement import DirectEstimate
from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import MISSING, Result
from rig.calibrate.fitted import Assumed, Estimate, Experiment, Pull
from rig.fit import adequacy
from rig.fit.parameters import covariance_of, estimates

NOISE = ("noise of the records", "noise and wandering", "noise, wandering and poses")  # the direct estimators' lines
GRAVITY = "local gravity"
SEEN = ("wandering common to all poses",)  # lines for what the fit has among its noise
LINES: Mapping[str, str] = {
    "vibrometer_gain": "vibrometer gain", "ldv_delay": "decoder delay", "filter_cutoff": "low-pass cut-off",
    "output_filter": "output filter", "recorder_clock": "clock between the recorders",
}  # fmt: skip
"""Lines of the direct estimators' budgets for what the fit has as priors."""
FEW = 3  # sentences on faults of records that a remark holds
NEGLIGIBLE = 1e-3  # of u: a prior with a smaller share has no line of its own
RELATIVE = ("1", "m")  # units of inputs whose coefficient goes with the value: relative ones, and a radius
LEVEL = 0.1  # of gravity along an axis that lies level


def joined(result: Result, direct: DirectEstimate, fits: Mapping[str, Experiment], assumed: Assumed) -> Result:
    """The result as the fit has it; as it was where the fit does not determine it."""
    experiment = fits.get(direct.experiment)
    estimate = None if experiment is None else _estimate(experiment, result)
    if experiment is None or estimate is None or result.budget is None:
        return result
    factor = max([1.0, *(one.ratio for one in experiment.missed if _concerns(experiment, one, result.channel))])
    lines = tuple(_lines(result, estimate, factor))
    check = agreement.check(experiment, result.channel, estimate, direct, result.method)
    said = [] if experiment.worst is None else [inadequate(experiment, factor)]
    if not check.agrees:
        said.append(
            f"the direct estimate lies {abs(check.delta) / check.u_delta:.1f} standard uncertainties of the difference "
            "away, wanted 2 at most"
        )
    kept = [one for one in result.remarks if MISSING not in one]  # that was the direct estimator's
    return replace(
        result, value=estimate.value, budget=Budget(lines), check=check, remarks=(*said, *kept),
        method=f"model fitted to all records of the {experiment.name} ({assumed.words}); beside it: {result.method}",
        status="flagged" if said else "determined",
    )  # fmt: skip


def _estimate(experiment: Experiment, result: Result) -> Estimate | None:
    match result.measurand:
        case "sensitivity" | "sensitivity_centripetal":
            return experiment.sensitivity(result.channel)
        case "sensitivity_gravity":
            found = experiment.own_axis(result.channel)  # of the magnitude of gravity, which has no sign
            return found.turned if found is not None and (result.value or 0.0) < 0.0 else found
        case "bandwidth":
            return experiment.bandwidth(result.channel)
        case "offset":
            return experiment.offset(result.channel, list(_level(experiment, result.channel)))
        case _:
            return None


def _level(experiment: Experiment, channel: str) -> Iterator[int]:
    """Parts in which gravity does not lie along a channel, or both ways; all of them for a gyro."""
    for number, part in enumerate(experiment.fit.parts):
        if channel in part.channels.names:
            row = part.channels.names.index(channel)
            along = part.reference.up[part.channels.axis[row]]
            both = float(along.min()) < -LEVEL and float(along.max()) > LEVEL
            if part.channels.rates[row] or both or float(np.abs(along).max()) < LEVEL:
                yield number


def _concerns(experiment: Experiment, missed: adequacy.Group, channel: str) -> bool:
    """Whether a group of rows is of a channel, or of several of which it is one."""
    single = {name for part in experiment.fit.parts for name in part.channels.names}
    return missed.channel == channel or missed.channel not in single


def inadequate(experiment: Experiment, factor: float) -> str:
    """What the model misses most of an experiment, and by how much noise was widened for it."""
    one = experiment.worst
    assert one is not None
    widened = f"; u of the noise is widened by {factor:.2g}" if factor > 1.0 else ""
    return (
        f"the model leaves more than noise on the {experiment.name} ({one.channel}, {one.domain}: {one.ratio:.2g} "
        f"times): {MISSING}{widened}"
    )


def _lines(result: Result, estimate: Estimate, factor: float) -> Iterator[Contribution]:
    """The budget of the direct estimate with the fit's shares."""
    assert result.budget is not None
    assert result.value is not None
    pulls: dict[str, Pull] = {}
    for one in estimate.pulls:
        name = _line_of(one)
        pulls[name] = _with(pulls[name], one) if name in pulls else one
    scale = estimate.value / result.value
    for line in result.budget.contributions:
        if line.name in NOISE:
            name = line.name.replace(", wandering and poses", " and wandering")  # however the cube stood
            yield replace(line, name=name, u=estimate.u_noise * factor, unit=result.unit, sensitivity=1.0)
        elif line.name in SEEN:
            continue
        elif line.name == GRAVITY:
            pull = pulls.pop(GRAVITY, Pull(GRAVITY, 1.0, 0.0))  # of one standard uncertainty
            yield replace(line, sensitivity=math.copysign(pull.coefficient / line.u, line.sensitivity))
        elif line.name in LINES.values():
            pull = pulls.pop(line.name, Pull(line.name, line.u, 0.0))
            yield replace(line, u=pull.u, sensitivity=pull.coefficient)
        else:
            yield replace(line, sensitivity=line.sensitivity * (scale if line.unit in RELATIVE else 1.0))
    for name, pull in pulls.items():
        if abs(pull.coefficient * pull.u) > NEGLIGIBLE * estimate.u:
            yield Contribution(name.replace("_", " "), "B", "normal", pull.u, "1", pull.coefficient, source="stated")


def _line_of(pull: Pull) -> str:
    """What the direct estimators call it."""
    if pull.name.startswith(f"{GRAVITY} of "):
        return GRAVITY
    return LINES["recorder_clock"] if pull.name.startswith("recorder_clock") else LINES.get(pull.name, pull.name)


def _with(one: Pull, other: Pull) -> Pull:
    """Two priors of one kind together: every record's own instant."""
    return Pull(one.name, one.u, math.hypot(one.coefficient, other.coefficient * other.u / one.u))


def spoilt(experiment: Experiment) -> tuple[str, ...]:
    """What is to be said of samples that are no measurement: what made them may have changed others too."""
    faults = (one for part in experiment.fit.parts for one in part.faults if not one.accepted)
    found = tuple(dict.fromkeys(one.in_words for one in faults))
    return (f"samples that are no measurement: {'; '.join(found[:FEW])}",) if found else ()


def doubts(experiment: Experiment) -> tuple[str, ...]:
    """Why a value that stands on an experiment is flagged; nothing if it is not."""
    return (() if experiment.worst is None else (inadequate(experiment, 1.0),)) + spoilt(experiment)


def of_model(fits: Mapping[str, Experiment], assumed: Assumed) -> Iterator[Result]:
    """Parameters of the model's own effects, from every experiment in which they act."""
    for experiment in fits.values():
        for number, term in enumerate(experiment.fit.state.terms):
            if term.prior or not any(term.effect is one.effect for one in assumed.terms):
                continue
            for name, one in estimates(term, covariance_of(experiment.fit, number)).items():
                if one.u is not None and one.u > 0.0 and np.isfinite(one.value):
                    line = Contribution("fit of the model", "A", "normal", one.u, one.unit, 1.0)
                    yield Result(
                        term.where or term.effect.stage, f"{term.effect.name}_{name}", f"{term.effect.title}: {name}",
                        one.value, one.unit, Budget((line,)), f"model fitted to all records of the {experiment.name}",
                        "the references of those records",
                        status="flagged" if (said := doubts(experiment)) else "determined", remarks=said,
                    )  # fmt: skip
