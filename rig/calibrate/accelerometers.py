"""Accelerometers on the shaker: sensitivity, frequency response, cross-axis, nonlinearity and zero output.

Model of one channel, the reference's remaining errors beside it:

    H(f) = S / (1 + jf/f_c) · exp(jωδτ) · (1 + q(f)·δ_c)

S is the sensitivity at low frequency and f_c the output filter. The decoder's delay and the low-pass filter's cut-off
are adjusted with their stated uncertainty as prior knowledge; the vibrometer's gain multiplies S and cannot be adjusted
(effects "ldv gain" and "sensitivity" are one), so it enters the budget as it is. Observations are complex responses of
every point at every level with the variance of their own noise (coloured, from the lines around each frequency).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.calibrate.adjustment import Adjustment, Prior, adjust
from rig.calibrate.allowances import Misfit, cosine, misfit, of_sheet, temperature
from rig.calibrate.budget import Budget, Contribution
from rig.calibrate.calibration import ResponsePoint, Result, not_determined
from rig.errors import BadInput
from rig.parts.reading.vibration import HARMONICS, Chain, SinePoint

Array = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Referred = Callable[[str, str, str, float, float, str], Result]  # measurand, title, unit, V, u, method: to the input
SENSITIVITY = "V/(m/s²)"
CREST = 8.0  # of what a fit leaves over, in standard deviations: noise reaches 6.5 in 10¹⁰ samples
VERIFICATION = "verification of the filter"
POLE_PRIOR = 0.5  # of the logarithm: the data sheet's bandwidth within a factor of about two


@dataclass(frozen=True)
class Setup:
    """What the budget needs beside the points: one chain of reference for all runs, and what was declared.

    `beam` and `mount` are limits of the angles (rad) between beam, drive and case; `temperature` is mean, lowest and
    highest, °C.
    """

    chain: Chain
    beam: float
    mount: float
    temperature: tuple[float, float, float] | None


@dataclass(frozen=True)
class Observed:
    """Complex responses of one channel, V/(m/s²), with relative standard uncertainty of each part; all shape (n,).

    `run` and `index` say which point of which run each is.
    `noise_dof`: degrees of freedom of those uncertainties.
    `u_time` (s): with channel and reference in two records the phases say nothing, and magnitudes alone are fitted.
    """

    frequency: Array
    response: Complexes
    u_relative: Array
    peak: Array
    run: tuple[str, ...]
    index: tuple[int, ...] = ()
    u_time: float = 0.0
    noise_dof: float = math.inf


def observed(points: Iterable[SinePoint], channel: str) -> Observed:
    """Responses of the points that can be trusted; raises BadInput if there are fewer than two."""
    good = [p for p in points if channel in p.lines and not p.flags and not p.lines[channel].flags]
    if len(good) < 2:
        raise BadInput(f"{channel}: found {len(good)} usable points, wanted at least two")
    response = np.array([p.response(channel) for p in good])
    u = np.array([p.u_response(channel) for p in good])
    return Observed(
        frequency=np.array([p.frequency for p in good]),
        response=response,
        u_relative=u / np.abs(response),
        peak=np.array([p.peak for p in good]),
        run=tuple(p.run for p in good),
        index=tuple(p.index for p in good),
        u_time=max(p.u_time for p in good),
    )


@dataclass(frozen=True)
class ChannelFit:
    """One channel's fit: sign of the sensitivity; adjustment of log S, log f_c, delay, cut-off (and curvature)."""

    channel: str
    sign: float
    adjustment: Adjustment
    seen: Observed

    @property
    def sensitivity(self) -> float:
        """V/(m/s²), with its sign."""
        return self.sign * math.exp(self.adjustment.value("log_sensitivity"))

    @property
    def pole(self) -> float:
        """Output filter's corner, Hz."""
        return math.exp(self.adjustment.value("log_pole"))

    def response(self, frequency: Array) -> Complexes:
        """Modelled response of the sensor alone, V/(m/s²)."""
        return np.asarray(self.sensitivity / (1.0 + 1j * frequency / self.pole))

    @property
    def misfit(self) -> Misfit:
        """Whether one pole describes the points."""
        what = "one-pole response misses the points"
        return misfit(self.adjustment.chi2, self.adjustment.dof, what, self.seen.noise_dof)


def fit_channel(
    seen: Observed, channel: str, chain: Chain, nominal_pole: float, reference_peak: float | None = None
) -> ChannelFit:
    """Adjust one channel; with `reference_peak` (m/s²) also the relative gain change at that peak, growing as A²."""
    turned = seen.response * (1.0 + 1j * seen.frequency / nominal_pole)
    sign = _sign(turned, seen)
    start = {
        "log_sensitivity": math.log(float(np.median(np.abs(turned)))),
        "log_pole": math.log(nominal_pole),
        "delay": 0.0,
        "cutoff": 0.0,
    }
    priors = {
        "log_pole": Prior(math.log(nominal_pole), POLE_PRIOR),
        "delay": Prior(0.0, chain.delay.u),
        "cutoff": Prior(0.0, max(chain.u_cutoff, 1e-12)),
    }
    if reference_peak is not None:
        start["curvature"] = 0.0
    slope = chain.phase_per_cutoff(seen.frequency)

    def residuals(p: Array) -> Array:
        modelled = sign * np.exp(p[0]) / (1.0 + 1j * seen.frequency * np.exp(-p[1]))
        modelled = modelled * np.exp(2j * math.pi * seen.frequency * p[2]) * (1.0 + slope * p[3])
        if reference_peak is not None:
            modelled = modelled * (1.0 + p[4] * (seen.peak / reference_peak) ** 2)
        if seen.u_time:
            return np.asarray(np.log(np.abs(seen.response / modelled)) / seen.u_relative, np.float64)
        left = (seen.response / modelled - 1.0) / seen.u_relative
        return np.asarray(np.concatenate([left.real, left.imag]), np.float64)

    return ChannelFit(channel, sign, adjust(residuals, start, priors), seen)


def _sign(turned: Complexes, seen: Observed) -> float:
    """Of the in-phase part; where clocks are not one, of the lowest frequency, whose phase they disturb least."""
    chosen = turned[np.argmin(seen.frequency)] if seen.u_time else np.median(turned.real)
    return 1.0 if float(np.real(chosen)) >= 0.0 else -1.0


def sensitivity_result(fit: ChannelFit, setup: Setup, remount: Contribution | None, drift: float | None) -> Result:
    """Sensitivity at low frequency with its budget; flagged if the one-pole model does not describe the points.

    `drift` is the declared temperature coefficient of the sensitivity, 1/K; None if nothing is declared.
    """
    s, adjustment, chain = fit.sensitivity, fit.adjustment, setup.chain
    u_noise = adjustment.u_noise("log_sensitivity") * fit.misfit.factor
    runs = fit.seen.run
    drifting, remarks = temperature(s, drift, setup.temperature, runs)
    lines = [
        Contribution("noise of the records", "A", "normal", u_noise, "1", s, _dof(fit), "lines beside each frequency"),
        Contribution(
            "vibrometer gain", "B", "normal", chain.gain.u / chain.gain.value, "1", s, source=chain.gain.source
        ),
        Contribution("vibrometer range", "B", "normal", 0.0, "1", s, source="certificate: one gain for all ranges"),
        _prior(fit, "decoder delay", "delay", chain.delay.u, "s", chain.delay.source),
        _prior(fit, "low-pass cut-off", "cutoff", chain.u_cutoff, "1", VERIFICATION),
        _prior(fit, "output filter", "log_pole", POLE_PRIOR, "1", of_sheet(fit.channel)),
        Contribution("time base", "B", "normal", chain.time_base.u, "1", s, source=chain.time_base.source),
        cosine("beam to motion", setup.beam, s, runs),
        cosine("mounting angle", setup.mount, s, runs),
        *drifting,
        *_clock(fit.seen),
    ]
    if remount is None:
        remarks = ("repeatability across remounts not measured: one mounting", *remarks)
    else:
        lines.append(Contribution(remount.name, "A", "normal", remount.u, "1", s, remount.dof, remount.source))
    return Result(
        channel=fit.channel,
        measurand="sensitivity",
        title="sensitivity at low frequency",
        value=s,
        unit=SENSITIVITY,
        budget=Budget(tuple(lines)),
        method="sine approximation (IEEE 1057, ISO 16063-11), one-pole response, weighted least squares",
        reference=f"vibrometer, {chain.gain.source}",
        status=fit.misfit.status,
        remarks=(*fit.misfit.remarks, *remarks),
    )


def _clock(seen: Observed) -> tuple[Contribution, ...]:
    """What the clocks of two recorders do to a magnitude: nothing, and that is why phases are left out."""
    if not seen.u_time:
        return ()
    return (
        Contribution(
            "clock between the recorders",
            "B",
            "normal",
            seen.u_time,
            "s",
            0.0,
            source="phases against the reference are left open",
        ),
    )


def _dof(fit: ChannelFit) -> float:
    parts = 1 if fit.seen.u_time else 2
    return min(float(max(parts * len(fit.seen.frequency) - 2, 1)), fit.seen.noise_dof)


def _prior(fit: ChannelFit, name: str, prior: str, u: float, unit: str, source: str) -> Contribution:
    coefficient = fit.sensitivity * fit.adjustment.coefficient("log_sensitivity", prior)
    return Contribution(name, "B", "normal", u, unit, coefficient, source=source)


def motion_noise_result(
    points: Sequence[SinePoint], channel: str, unit: str, refer: Referred, found: ChannelFit
) -> Result:
    """Noise while the sensor moves: what the fits of all sines leave over, above the reciprocal of a record.

    Flagged where not all of it need be noise: a sample stands out, or the points do not follow the model `found`.
    """
    usable = [p for p in points if channel in p.lines and not p.flags and not p.lines[channel].flags]
    good = [p.lines[channel] for p in usable]
    squares = np.array([line.residual_rms**2 - line.step**2 / 12.0 for line in good])
    value = math.sqrt(max(float(squares.mean()), 0.0))
    u = float(squares.std(ddof=1)) / math.sqrt(len(good)) / (2.0 * value) if value > 0.0 else 0.0
    title = "deviation in motion: output less the fitted sines, above the reciprocal of a record"
    result = refer("deviation_in_motion", title, unit, value, u, f"residuals of {len(good)} sine fits")
    said = list(result.remarks)
    if found.misfit.status == "flagged":
        said.append("the points do not follow a one-pole response: what the sines leave over need not all be noise")
    worst = max(usable, key=lambda p: p.lines[channel].crest, default=None)
    if worst is not None and (crest := worst.lines[channel].crest) > CREST:
        said.append(
            f"{worst.frequency:.4g} Hz ({worst.run}): a sample is {crest:.0f} standard deviations off: no noise"
        )
    return replace(result, status="flagged", remarks=tuple(said)) if len(said) > len(result.remarks) else result


def remount_of(fits: Mapping[str, Sequence[ChannelFit]]) -> Contribution | None:
    """Scatter of the sensitivity between mountings beyond the records' noise, pooled over channels; None for one each.

    Variance between minus variance within, not below zero; the mean of n mountings has the nth part of it.
    """
    between, within, dof, mountings = 0.0, 0.0, 0, 0
    for several in fits.values():
        if len(several) > 1:
            logs = np.array([fit.adjustment.value("log_sensitivity") for fit in several])
            between += float(np.sum((logs - logs.mean()) ** 2))
            within += float(np.mean([fit.adjustment.u_noise("log_sensitivity") ** 2 for fit in several])) * (
                len(logs) - 1
            )
            dof, mountings = dof + len(logs) - 1, max(mountings, len(logs))
    if not dof:
        return None
    excess = max(between - within, 0.0) / dof
    return Contribution(
        "repeatability across remounts", "A", "normal", math.sqrt(excess / mountings), "1", 1.0, float(dof),
        f"{mountings} mountings",
    )  # fmt: skip


def pole_result(fit: ChannelFit, chain: Chain) -> Result:
    """Corner frequency of the output filter."""
    adjustment, pole = fit.adjustment, fit.pole
    names = {
        "delay": ("decoder delay", "s", chain.delay.source), "cutoff": ("low-pass cut-off", "1", VERIFICATION),
        "log_pole": ("output filter", "1", of_sheet(fit.channel)),
    }  # fmt: skip
    lines = [
        Contribution(
            "noise of the records",
            "A",
            "normal",
            adjustment.u_noise("log_pole") * fit.misfit.factor,
            "1",
            pole,
            _dof(fit),
        ),
        *(
            Contribution(name, "B", "normal", adjustment.priors[prior].u, unit, pole * c, source=source)
            for prior, (name, unit, source) in names.items()
            if (c := adjustment.coefficient("log_pole", prior))
        ),
    ]
    return Result(
        fit.channel, "bandwidth", "output filter, −3 dB", pole, "Hz", Budget(tuple(lines)),
        method="one-pole response fitted to magnitude and phase", reference="vibrometer",
        status=fit.misfit.status, remarks=fit.misfit.remarks,
    )  # fmt: skip


def curvature_result(seen: Observed, channel: str, chain: Chain, nominal_pole: float) -> Result:
    """Relative change of the gain at the highest peak against small motion, from the levels."""
    title = "nonlinearity: change of gain at the highest level, growing as the square of the motion"
    highest = float(seen.peak.max())
    if not _two_levels(seen):
        why = "one level at every frequency: amplitude and frequency cannot be told apart; wanted two levels"
        return not_determined(channel, "nonlinearity", title, "1", why)
    try:
        fit = fit_channel(seen, channel, chain, nominal_pole, highest)
    except BadInput as error:
        return not_determined(channel, "nonlinearity", title, "1", str(error))
    u = fit.adjustment.u("curvature") * fit.misfit.factor
    line = Contribution("noise of the records", "A", "normal", u, "1", 1.0, _dof(fit))
    return Result(
        channel, "nonlinearity", title, fit.adjustment.value("curvature"), "1", Budget((line,)),
        method=f"levels compared, at {highest:.3g} m/s² peak", reference="vibrometer (linearity within one range)",
        status=fit.misfit.status, remarks=fit.misfit.remarks,
    )  # fmt: skip


def _two_levels(seen: Observed) -> bool:
    """Whether some frequency was driven at two levels that differ by half as much again."""
    order = np.argsort(seen.frequency)
    f, a = seen.frequency[order], seen.peak[order]
    near = np.abs(np.diff(f)) < 0.5
    return bool(np.any(near & (np.abs(np.diff(np.log(a))) > math.log(1.5))))


def cross_axis_result(points: Sequence[SinePoint], channel: str, driven: str, own: ChannelFit) -> Result:
    """Share of the driven axis that a side channel shows, by its own sensitivity: mean of the in-phase part."""
    good = [p for p in points if channel in p.lines and not p.flags and not p.lines[channel].flags]
    title = f"cross-axis from {driven}"
    if not good:
        return not_determined(channel, f"cross_axis_{driven}", title, "1", "no usable point: clipped or flagged")
    if any(p.u_time for p in good):
        return not_determined(channel, f"cross_axis_{driven}", title, "1", "its sign needs the reference's clock")
    f = np.array([p.frequency for p in good])
    ratio = np.array([p.response(channel) for p in good]) / own.response(f)
    u = np.array([math.sqrt(float(p.lines[channel].variance[0])) / p.peak for p in good]) / np.abs(own.response(f))
    weights = u**-2
    value = float(np.sum(weights * ratio.real) / weights.sum())
    dof = max(len(good) - 1, 1)
    chi2 = float(np.sum(weights * (ratio.real - value) ** 2)) / dof
    spread = math.sqrt(max(chi2, 1.0))
    remarks = (f"varies over frequency by {spread:.1f} times its noise",) if spread > 2.0 else ()
    line = Contribution("noise of the records", "A", "normal", float(weights.sum()) ** -0.5 * spread, "1", 1.0, dof)
    return Result(
        channel, f"cross_axis_{driven}", title, value, "1", Budget((line,)),
        method="in-phase part, weighted mean over all points", reference="vibrometer",
        status="flagged" if remarks else "determined", remarks=remarks,
    )  # fmt: skip


def response_table(points: Sequence[SinePoint], fit: ChannelFit, chain: Chain) -> tuple[ResponsePoint, ...]:
    """Every point as it was measured, with uncertainty, lowest frequency first."""
    seen = [p for p in points if fit.channel in p.lines]
    return tuple(_response_point(p, fit, chain) for p in sorted(seen, key=lambda p: (p.frequency, -p.peak)))


def _response_point(point: SinePoint, fit: ChannelFit, chain: Chain) -> ResponsePoint:
    response, u = point.response(fit.channel), point.u_response(fit.channel)
    at = np.array([point.frequency])
    slope = complex(chain.phase_per_cutoff(at)[0]) * chain.u_cutoff
    u_phase = u / abs(response)
    reference = (
        math.hypot(chain.gain.u / chain.gain.value, slope.real, chain.time_base.u),
        math.hypot(2.0 * math.pi * point.frequency * math.hypot(chain.delay.u, point.u_time), slope.imag),
    )
    return ResponsePoint(
        frequency=point.frequency,
        level=point.level,
        acceleration=point.peak,
        magnitude=abs(response),
        phase=math.atan2(response.imag, response.real),
        u_magnitude=u,
        u_phase=u_phase,
        uc_magnitude=math.hypot(u, reference[0] * abs(response)),
        uc_phase=math.hypot(u_phase, reference[1]),
        distortion=_distortion(point, fit),
        run=point.run,
        flags=(*point.flags, *point.lines[fit.channel].flags),
    )


def _distortion(point: SinePoint, fit: ChannelFit) -> float:
    """Harmonics of the output that the motion's own harmonics do not explain, relative to the fundamental."""
    line = point.lines[fit.channel]
    orders = np.arange(2, HARMONICS + 1)
    at = np.asarray(orders * point.frequency, np.float64)
    explained = np.multiply(fit.response(at), point.acceleration[1:])
    left = np.subtract(line.amplitudes[1:], explained)
    if point.u_time:
        left = np.subtract(np.abs(line.amplitudes[1:]), np.abs(explained))
    seen = np.isfinite(left)
    return float(np.linalg.norm(left[seen]) / abs(complex(line.amplitudes[0])))
