"""Noise of a sensor at rest: white, flicker and random walk, fitted to the spectrum of a record by maximum likelihood.

One-sided densities in unit²/Hz throughout, where unit is that of the record. The white noise may stand behind a
one-pole output filter. A term is reported only if the record needs it and is long enough to carry it; otherwise the
reason is reported in its place. Nothing is read off an Allan curve.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rig.errors import BadInput
from rig.signals.spectrum import Density, Lines, Periodogram, log_bins

Array = NDArray[np.float64]

PER_DECADE = 50.0
SUBSETS = (("white",), ("white", "flicker"), ("white", "random_walk"), ("white", "flicker", "random_walk"))
UNNEEDED = "not needed by the Bayesian information criterion"
CORNER_PERIODS = 4.0  # flicker: corner frequency times record length
CLUSTERS = 9.0  # random walk: clusters in the record at the averaging time where it takes over
HIGHEST_POLE = 0.4  # of the sampling rate; above it the filter cannot be told from aliased white noise
LARGEST_LOG_U = 0.5  # relative standard uncertainty beyond which a coefficient is not determined
TOLD = 1000.0  # likelihood ratio that tells a random walk from flicker; 150 at most in 1140 short records without one
ALIKE = "random walk and flicker cannot be told apart in this record"
SHOWN = 2.0  # of the log-likelihood: what a term of two standard deviations gains
EULER = 0.5772156649015329


@dataclass(frozen=True)
class NoiseModel:
    """density(f) = (white + flicker/f + random_walk/f²) behind a pole + quantisation, one-sided, unit²/Hz.

    All noise of a sensor arises before its output filter; what rounding adds comes after it. White noise folds at the
    sampling rate, the slow terms do not.
    """

    rate: float  # sampling rate, Hz
    white: float  # density of the white noise at f ≪ pole, unit²/Hz
    pole: float = math.inf  # Hz, one-pole output filter behind which the white noise stands; inf without
    flicker: float = 0.0  # unit²
    random_walk: float = 0.0  # unit²·Hz
    quantisation: float = 0.0  # unit²/Hz, known: step²/12 / (rate/2)
    apart: float = 0.0  # unit²: variance of a constant that every block has of its own, no part of the density
    u_apart: float = 0.0  # relative standard uncertainty of the variance of means, because of `apart`
    names: tuple[str, ...] = ()  # of what was estimated, with the covariance of the logarithms
    covariance_of_logs: tuple[tuple[float, ...], ...] = ()

    def density(self, f: ArrayLike) -> Array:
        """One-sided density at the frequencies `f` > 0 in Hz, as sampled, same shape."""
        frequency = np.asarray(f, dtype=float)
        slow = self.flicker / frequency + self.random_walk / frequency**2
        white = _white_shape(frequency, self.pole, self.rate) * self.white
        return np.asarray(white + _slow_shape(frequency, self.pole) * slow + self.quantisation)

    def u_log(self, f: ArrayLike) -> Array:
        """Relative standard uncertainty of the density at `f` > 0 in Hz, same shape; zero for a model that is given."""
        frequency = np.asarray(f, dtype=float)
        if not self.names:
            return np.zeros_like(frequency)
        log = np.log([max(getattr(self, name), 1e-300) for name in self.names])
        whole, parts = _parts(frequency, self.names, log, self.rate)
        shares = parts / (whole + self.quantisation)
        return np.asarray(np.sqrt(np.einsum("i...,ij,j...->...", shares, np.array(self.covariance_of_logs), shares)))

    def u_of_means(self, span: float) -> float:
        """Relative standard uncertainty of the variance of means that are spread over so many seconds."""
        return math.hypot(float(self.u_log(1.0 / span)), self.u_apart)

    def rms(self, low: float, high: float | None = None) -> float:
        """√∫ density df between `low` and `high` in Hz (Nyquist without), without the quantisation.

        Raises BadInput if `low` is zero although there is flicker or random walk, or if the band is empty.
        """
        top = self.rate / 2 if high is None else high
        if not 0 <= low < top <= self.rate / 2 * (1 + 1e-12):
            raise BadInput(f"rms: found a band from {low} to {top} Hz, wanted one below {self.rate / 2} Hz")
        if low == 0 and (self.flicker or self.random_walk):
            raise BadInput("rms: found a band from zero, wanted one above zero: flicker has no rms otherwise")
        power = self._white_power(top) - self._white_power(low)
        if self.flicker or self.random_walk:
            f = np.geomspace(low, top, 4000)
            slow = self.flicker / f + self.random_walk / f**2
            power += float(np.trapezoid(slow * _slow_shape(f, self.pole), f))
        return math.sqrt(power)

    def covariance(self, begin: ArrayLike, end: ArrayLike) -> Array:
        """Covariance of means over the blocks [begin_i, end_i] in s, shape (n, n), unit².

        The autocovariance is integrated twice over the blocks in closed form; lengths, gaps and overlaps are free.
        The filter's hold on flicker and random walk is left out: blocks are long against its time constant.
        Flicker and random walk count down to a hundredth of the reciprocal of the total span: lower frequencies are
        the same constant in every block. Raises BadInput for an empty block.
        """
        b, e = np.atleast_1d(np.asarray(begin, dtype=float)), np.atleast_1d(np.asarray(end, dtype=float))
        if b.shape != e.shape or b.ndim != 1 or not np.all(e > b):
            raise BadInput("covariance: found blocks that do not end after they begin, wanted begin < end")
        span = float(e.max() - b.min())
        twice = np.zeros((b.size, b.size))
        for sign, one, two in ((1, e, b), (-1, b, b), (-1, e, e), (1, b, e)):
            twice += sign * self._twice_integrated(one[:, None] - two[None, :], span)
        length = e - b
        result = twice / length[:, None] / length[None, :] + self._constant(span) + self.apart * np.eye(b.size)
        return np.asarray((result + result.T) / 2)

    def _white_power(self, f: float) -> float:
        """∫ of the white part from 0 to f, unit²."""
        if math.isinf(self.pole):
            return self.white * f
        rho = math.exp(-2 * math.pi * self.pole / self.rate)
        variance = self.white * self.pole * math.pi / 2
        if f >= self.rate / 2:
            return variance
        return variance * 2 / math.pi * math.atan((1 + rho) / (1 - rho) * math.tan(math.pi * f / self.rate))

    def _constant(self, span: float) -> float:
        """Autocovariance of flicker and random walk at a lag of one span, for a lowest frequency of 1/(100·span).

        ∫cos(2πfτ)/f df ≈ −γ − ln(2πf₀τ) and ∫cos(2πfτ)/f² df ≈ 1/f₀ − π²τ (+2π²f₀τ²) above f₀ ≪ 1/τ.
        """
        return self.flicker * -(EULER + math.log(2 * math.pi / 100)) + self.random_walk * 100 * span

    def _twice_integrated(self, lag: Array, span: float) -> Array:
        """Function of the lag in s whose second derivative is the autocovariance less its constant."""
        tau = np.abs(lag)
        relative = tau / span
        log = np.log(np.where(relative > 0, relative, 1.0))
        flicker = -self.flicker * (tau**2 / 2 * log - 0.75 * tau**2)
        walk = -self.random_walk * math.pi**2 * tau**3 / 6 + self.random_walk * math.pi**2 * tau**4 / (600 * span)
        return flicker + walk + self.quantisation * tau / 4 + self._white_twice(tau)

    def _white_twice(self, tau: Array) -> Array:
        if math.isinf(self.pole):
            return self.white * tau / 4
        a = 2 * math.pi * self.pole
        level = self.white * float(_white_shape(np.asarray(0.0), self.pole, self.rate))
        return level / 4 * (tau + np.expm1(-a * tau) / a)


Beforehand = Mapping[str, tuple[float, float]]
"""Logarithms known by other means, each with its standard uncertainty, by name of the parameter."""
NOTHING: Beforehand = MappingProxyType({})


def by_sheet(density: float, tolerance: float, corner: tuple[float, float] | None) -> Beforehand:
    """What a data sheet says: one-sided `density` of the white noise (unit/√Hz) to a relative `tolerance`, flicker as
    strong as it at a `corner` somewhere within these bounds, Hz: a rectangular distribution of its logarithm.
    """
    white, u = 2.0 * math.log(density), 2.0 * tolerance
    if corner is None or not corner[0] > 0.0:
        return {"white": (white, u)}
    low, high = (math.log(one) for one in corner)
    return {"white": (white, u), "flicker": (white + 0.5 * (low + high), math.hypot(u, (high - low) / math.sqrt(12.0)))}


@dataclass(frozen=True)
class NoiseFit:
    """A noise model with what is known about it."""

    model: NoiseModel
    terms: tuple[str, ...]  # of "white", "flicker", "random_walk"
    u: Mapping[str, float]  # standard uncertainty of white, pole, flicker, random_walk (those chosen), their units
    names: tuple[str, ...]  # of the parameters whose logarithms were fitted
    covariance: Array  # of the logarithms, shape (names, names), from the Fisher information
    refused: Mapping[str, str]  # term → why it is not reported
    chi2_dof: float  # of the binned periodogram about the model, one if the model is right
    seconds: float  # length of the record
    slope: float | None = None  # ramp, unit/s, if asked for and needed
    u_slope: float | None = None  # its standard uncertainty with this noise, unit/s


@dataclass(frozen=True)
class Coefficient:
    """One Allan coefficient: value and standard uncertainty, or neither and the reason."""

    value: float | None
    u: float | None
    reason: str = ""


@dataclass(frozen=True)
class _Trial:
    """One candidate: the logarithms of its parameters and how well it explains the lines."""

    names: tuple[str, ...]
    log: Array
    fisher: Array
    log_likelihood: float
    slope: float | None = None
    u_slope: float | None = None

    @property
    def terms(self) -> tuple[str, ...]:
        return tuple(name for name in self.names if name != "pole")

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.names) + (self.slope is not None)

    def covariance(self) -> Array:
        return np.asarray(np.linalg.pinv(self.fisher, hermitian=True))

    def model(self, rate: float, quantisation: float) -> NoiseModel:
        return with_levels(rate, dict(zip(self.names, _exp(self.log), strict=True)), quantisation)


def with_levels(rate: float, levels: Mapping[str, float], quantisation: float = 0.0) -> NoiseModel:
    """A noise model with these levels by name, none of what is not named."""
    return NoiseModel(
        rate, levels.get("white", 0.0), levels.get("pole", math.inf), levels.get("flicker", 0.0),
        levels.get("random_walk", 0.0), quantisation,
    )  # fmt: skip


def walking(models: Sequence[NoiseModel], levels: Sequence[float]) -> tuple[NoiseModel, ...]:
    """The same with these random walks, unit²·Hz."""
    return tuple(replace(one, random_walk=q) for one, q in zip(models, levels, strict=True))


def fit(values: ArrayLike, rate: float, *, step: float, pole: float | None, ramp: bool = False) -> NoiseFit:
    """Noise of a record `values`, shape (n,), at `rate` Hz, rounded to `step` (0 for unrounded).

    `pole` in Hz is where to look first for an output filter. With `ramp` a slope is estimated too. Raises BadInput for
    a record that is too short, constant or not finite.
    """
    periodogram = Periodogram(rate, PER_DECADE)
    periodogram.feed(values)
    return fit_blocks(periodogram.result(), step=step, pole=pole, ramp=ramp)


def fit_density(
    density: Density, rate: float, *, step: float, pole: float | None, shown: bool = False,
    beforehand: Beforehand | None = None,
) -> NoiseModel:  # fmt: skip
    """White noise and flicker behind one pole from averaged periodograms of many records.

    The pole is adjusted too: `pole` (Hz) is where to look first; None for noise without one. `shown`: flicker only as
    far as the lines show it, by two standard deviations. `beforehand`: what is known of it by other means, a logarithm
    and its standard uncertainty by name. How well the density is known is read off the Fisher information. Raises
    BadInput for no bins.
    """
    if not len(density.frequency):
        raise BadInput("noise: found no line of a spectrum, wanted some")
    filtered = () if pole is None else ("pole",)
    quantisation = step**2 / 6 / rate
    first = 0.3 * rate if pole is None else min(pole, 0.3 * rate)

    def trial(*names: str) -> _Trial:
        return _maximum(density, names, _starting(density, names, first), rate, quantisation, beforehand or {})

    found = trial("white", "flicker", *filtered)
    if shown and found.log_likelihood - (bare := trial("white", *filtered)).log_likelihood < SHOWN:
        found = bare
    covariance = tuple(map(tuple, found.covariance().tolist()))
    return replace(found.model(rate, quantisation), names=found.names, covariance_of_logs=covariance)


def fit_blocks(lines: Lines, *, step: float, pole: float | None, ramp: bool = False) -> NoiseFit:
    """Noise from the lines of a record, which may have been fed piece by piece; otherwise as `fit`.

    Whittle's likelihood (Whittle 1953) on bins of lines, which are gamma distributed; the terms are chosen by the
    Bayesian information criterion (Schwarz 1978) and dropped if the record cannot carry them.
    """
    if not step >= 0 or (pole is not None and not pole > 0):
        raise BadInput(f"noise: found a step of {step} and a pole of {pole} Hz, wanted none below zero")
    quantisation = step**2 / 6 / lines.rate
    start = 0.1 * lines.rate if pole is None else min(pole, 0.3 * lines.rate)
    refused: dict[str, str] = {}
    trials = [
        _trial(lines, (*terms, *filtered), quantisation, start, sloped)
        for terms in SUBSETS
        for filtered in ((), ("pole",))
        for sloped in ((False, True) if ramp else (False,))
    ]
    best = _chosen(trials, lines, quantisation, refused)
    if not ramp:
        refused["ramp"] = "not asked for"
    return _report(best, lines, quantisation, refused)


def coefficients(fitted: NoiseFit) -> dict[str, Coefficient]:
    """Allan coefficients as IEEE Std 952 annex C and IEEE Std 1293 define them, each with its standard uncertainty.

    N (unit/√Hz) random walk of the integral, from the two-sided density N² = white/2; B (unit) bias instability, from
    B²/(πf) one-sided; K (unit·√Hz) random walk, from 2K²/(2πf)² one-sided; R (unit/s) ramp. Q, noise of a rounded
    integral, does not exist in a record whose samples themselves are rounded: that is `rounding`, white, in unit/√Hz.
    """
    model, u = fitted.model, fitted.u
    rounding = Coefficient(math.sqrt(model.quantisation / 2), 0.0)
    found = {
        "N": _root(model.white / 2, u.get("white", 0.0) / 2),
        "B": _root(math.pi * model.flicker, math.pi * u.get("flicker", 0.0)),
        "K": _root(2 * math.pi**2 * model.random_walk, 2 * math.pi**2 * u.get("random_walk", 0.0)),
        "R": Coefficient(fitted.slope, fitted.u_slope),
        "Q": Coefficient(None, None, "the samples are rounded, not their integral: see rounding"),
        "rounding": rounding,
    }
    for name, term in (("N", "white"), ("B", "flicker"), ("K", "random_walk"), ("R", "ramp")):
        if term in fitted.refused:
            found[name] = Coefficient(None, None, fitted.refused[term])
    return found


def _root(square: float, u_square: float) -> Coefficient:
    """√square with the uncertainty that follows from that of the square (GUM 5.1.2)."""
    value = math.sqrt(square)
    return Coefficient(value, u_square / (2 * value) if value else 0.0)


def _white_shape(f: Array, pole: float, rate: float) -> Array:
    """White noise of unit density behind one pole, sampled: a first-order autoregression, ρ = exp(−2π·pole/rate)."""
    if math.isinf(pole):
        return np.ones_like(f)
    rho = math.exp(-2 * math.pi * pole / rate)
    # 1 − 2ρ cos x + ρ² written so that it loses no digits for small x
    distance = (1 - rho) ** 2 + 4 * rho * np.sin(np.pi * f / rate) ** 2
    return np.asarray(math.pi * pole / rate * (1 - rho) * (1 + rho) / distance)


def _slow_shape(f: Array, pole: float) -> Array:
    """Slow noise behind one pole: nothing of it is left above half the sampling rate that could fold."""
    return np.asarray(1.0 / (1.0 + (f / pole) ** 2))


def _exp(log: Array) -> list[float]:
    return [float(value) for value in np.exp(log)]


def _trial(lines: Lines, names: tuple[str, ...], quantisation: float, pole: float, sloped: bool) -> _Trial:
    """Fit one candidate; with a slope, noise and slope in turn until they agree."""
    bins = _bins(lines, 0.0)
    log = _starting(bins, names, pole)
    if not sloped:
        return _maximum(bins, names, log, lines.rate, quantisation)
    slope, u_slope = _slope(lines, None)
    for _ in range(8):
        trial = _maximum(_bins(lines, slope), names, log, lines.rate, quantisation)
        before, log = slope, trial.log
        slope, u_slope = _slope(lines, trial.model(lines.rate, quantisation))
        if abs(slope - before) < 1e-3 * u_slope:
            break
    return replace(trial, slope=slope, u_slope=u_slope)


def _bins(lines: Lines, slope: float) -> Density:
    """All bins of the record with the slope taken away from its lowest lines."""
    low = log_bins(lines.low_frequency, (lines.low - slope * lines.ramp) ** 2, PER_DECADE)
    high = lines.high
    return Density(
        np.concatenate([low.frequency, high.frequency]),
        np.concatenate([low.density, high.density]),
        np.concatenate([low.dof, high.dof]),
    )


def _slope(lines: Lines, model: NoiseModel | None) -> tuple[float, float]:
    """Slope in unit/s and its standard uncertainty by generalised least squares; without a model, for random walk."""
    density = lines.low_frequency**-2.0 if model is None else model.density(lines.low_frequency)
    weight = lines.ramp / density
    information = float(weight @ lines.ramp)
    return float(weight @ lines.low) / information, information**-0.5


def _starting(bins: Density, names: Sequence[str], pole: float) -> Array:
    """Logarithms to start from: the median level below the pole, and the lowest lines for flicker and random walk."""
    f, p = bins.frequency, np.maximum(bins.density, np.finfo(float).tiny)
    level = float(np.exp(np.average(np.log(p), weights=np.minimum(bins.dof, 1000.0))))
    below = (f < pole) & (f > pole / 30) if "pole" in names else f > f[-1] / 30
    start = {
        "white": float(np.median(p[below])) if below.any() else level,
        "pole": pole,
        "flicker": float(np.mean((p * f)[:12])) / 2,
        "random_walk": float(np.mean((p * f**2)[:4])) / 2,
    }
    return np.log([max(start[name], 1e-300) for name in names])


def _parts(f: Array, names: Sequence[str], log: Array, rate: float) -> tuple[Array, Array]:
    """Density without the quantisation, and its derivatives by the logarithms, shape (names, n)."""
    value = dict(zip(names, _exp(log), strict=True))
    pole = value.get("pole", math.inf)
    slow = np.zeros_like(f)
    part = {"white": value["white"] * _white_shape(f, pole, rate)}
    for name, power in (("flicker", 1), ("random_walk", 2)):
        if name in value:
            part[name] = value[name] / f**power * _slow_shape(f, pole)
            slow += value[name] / f**power
    total = np.sum(list(part.values()), axis=0)
    if "pole" in value:
        h = 1e-4
        near = [pole * math.exp(sign * h) for sign in (1, -1)]
        up, down = (value["white"] * _white_shape(f, p, rate) + slow * _slow_shape(f, p) for p in near)
        part["pole"] = (up - down) / (2 * h)
    return total, np.array([part[name] for name in names])


def _likelihood(
    bins: Density, names: Sequence[str], log: Array, rate: float, quantisation: float, beforehand: Beforehand
) -> tuple[float, Array, Array]:
    """Log-likelihood of gamma distributed bins (constants left out), its gradient and the Fisher information.

    What is known beforehand counts as a normal observation of the logarithm.
    """
    slow, parts = _parts(bins.frequency, names, log, rate)
    s = slow + quantisation + np.finfo(float).tiny
    ratio, half = bins.density / s, bins.dof / 2
    relative = parts / s
    known = [beforehand.get(name, (0.0, math.inf)) for name in names]
    weight = np.array([u**-2.0 for _, u in known])
    off = log - np.array([at for at, _ in known])
    return (
        -float(half @ (np.log(s) + ratio)) - 0.5 * float(weight @ off**2),
        relative @ (half * (ratio - 1)) - weight * off,
        (relative * half) @ relative.T + np.diag(weight),
    )


def _maximum(
    bins: Density, names: tuple[str, ...], log: Array, rate: float, quantisation: float,
    beforehand: Beforehand = NOTHING,
) -> _Trial:  # fmt: skip
    """Maximum of the likelihood by Fisher scoring, damped as Levenberg and Marquardt do."""
    value, gradient, fisher = _likelihood(bins, names, log, rate, quantisation, beforehand)
    damping = 1e-2
    for _ in range(120):
        diagonal = np.diag(fisher)
        matrix = fisher + np.diag(damping * diagonal + 1e-12 * diagonal.max())
        step = np.clip(np.linalg.solve(matrix, gradient), -2.0, 2.0)
        trial = _likelihood(bins, names, log + step, rate, quantisation, beforehand)
        if trial[0] >= value:
            gain, log, damping = trial[0] - value, log + step, damping / 5
            value, gradient, fisher = trial
            if gain < 1e-7 and float(np.abs(step).max()) < 0.1:
                break
        else:
            damping *= 6
            if damping > 1e12:
                break
    return _Trial(names, log, fisher, value)


def _chosen(trials: Sequence[_Trial], lines: Lines, quantisation: float, refused: dict[str, str]) -> _Trial:
    """The candidate with the best criterion among those the record can carry; tells why the others fell."""
    count = float(lines.low.size + lines.high.dof.sum())
    ranked = sorted(
        trials, key=lambda t: (len(t.names) + (t.slope is not None)) * math.log(count) - 2 * t.log_likelihood
    )
    reasons: dict[str, str] = {}
    for trial in ranked:
        faults = _faults(trial, lines, quantisation)
        if not faults:
            break
        for name, reason in faults.items():
            reasons.setdefault(name, reason)
    else:
        trial = next(t for t in ranked if t.names == ("white",))
    if _alike(trial, ranked, lines, quantisation):
        refused["random_walk"] = refused["flicker"] = ALIKE
    present = {*trial.names, *(() if trial.slope is None else ("ramp",))}
    for name in ("flicker", "random_walk", "pole", "ramp"):
        if name not in present:
            refused.setdefault(name, reasons.get(name, UNNEEDED))
    return trial


def _alike(trial: _Trial, ranked: Sequence[_Trial], lines: Lines, quantisation: float) -> bool:
    """Whether flicker in place of a random walk explains the lines nearly as well: then neither is stated.

    Few low lines follow 1/f as well as 1/f²: it takes a likelihood ratio that flicker does not reach by chance.
    """
    if "random_walk" not in trial.names or "flicker" in trial.names:
        return False
    flickering = (one for one in ranked if "flicker" in one.names and "random_walk" not in one.names)
    other = next((one for one in flickering if not _faults(one, lines, quantisation)), None)
    return other is not None and trial.log_likelihood - other.log_likelihood < math.log(TOLD)


def _faults(trial: _Trial, lines: Lines, quantisation: float) -> dict[str, str]:
    """Terms of the candidate that the record cannot carry, with the reason."""
    model = trial.model(lines.rate, quantisation)
    u = dict(zip(trial.names, np.sqrt(np.diag(trial.covariance())), strict=True))
    faults = {name: f"not determined: relative uncertainty {u[name]:.2g}" for name in u if u[name] > LARGEST_LOG_U}
    faults.pop("white", None)  # some white noise is always there, if only as a bound
    if model.pole < math.inf and model.pole > HIGHEST_POLE * lines.rate:
        faults["pole"] = f"above {HIGHEST_POLE} of the sampling rate"
    floor = model.white + quantisation
    corner = model.flicker / floor
    if 0 < corner < CORNER_PERIODS / lines.seconds:
        faults["flicker"] = (
            f"record too short: corner at {corner:.3g} Hz, wanted at least {CORNER_PERIODS / lines.seconds:.3g} Hz"
        )
    if model.random_walk > 0:
        time = _takeover(model)
        if lines.seconds < CLUSTERS * time:
            faults["random_walk"] = f"record too short: takes over at {time:.3g} s, needs {CLUSTERS * time:.3g} s"
    return faults


def _takeover(model: NoiseModel) -> float:
    """Averaging time in s from which random walk, K√(τ/3), is above the white N/√τ and the flicker 0.664·B."""
    n, b = math.sqrt((model.white + model.quantisation) / 2), math.sqrt(math.pi * model.flicker)
    k = math.sqrt(2 * math.pi**2 * model.random_walk)
    return max(math.sqrt(3) * n / k, 3 * (math.sqrt(2 * math.log(2) / math.pi) * b / k) ** 2)


def _report(trial: _Trial, lines: Lines, quantisation: float, refused: dict[str, str]) -> NoiseFit:
    covariance = trial.covariance()
    model = trial.model(lines.rate, quantisation)
    u = {name: getattr(model, name) * math.sqrt(covariance[i, i]) for i, name in enumerate(trial.names)}
    bins = _bins(lines, trial.slope or 0.0)
    chi2 = float(bins.dof / 2 @ (bins.density / model.density(bins.frequency) - 1) ** 2)
    return NoiseFit(
        model=model,
        terms=trial.terms,
        u=u,
        names=trial.names,
        covariance=covariance,
        refused=refused,
        chi2_dof=chi2 / max(1, bins.frequency.size - len(trial.names)),
        seconds=lines.seconds,
        slope=trial.slope,
        u_slope=trial.u_slope,
    )
