"""A smooth curve through noisy samples of a motion, with its first and second derivative and how far to trust them.

The curve is a quintic spline with evenly spaced knots, c its coefficients; it minimises

    Σ w_i (y_i − x(t_i))² + λ Σ (Δᵐ c)²                    (penalised spline: Eilers & Marx 1996; m = 3, 4 or 5)

Samples may be unevenly spaced and may be missing. On even samples this is a low pass without delay, whose response is

    H(f) = 1 / (1 + (f / f_half)²ᵐ)                          (Wahba 1990; Butterworth squared, twice forward and back)

λ is not set by taste. The noise is what the spectrum of the samples shows above the motion: from the top of the
spectrum downwards as long as it follows one straight line (white noise is a level one; a camera's track that was
interpolated falls). Where the spectrum rises to twice that line is the `bandwidth`: motion and noise are equal here.
m and f_half are then those with the least expected error of both derivatives,

    risk_k = ∫ (2πf)²ᵏ [ H² S_noise + (1 − H)² S_motion ] df       (noise let through, motion lost)

and this risk is also the variance that is stated. Noise that looks like motion, below that frequency, cannot be seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput

Array = NDArray[np.float64]
DEGREE = 5
ORDERS = (3, 4, 5)
KEPT = 0.99
"""Response that still counts as kept."""
FINEST = 20
"""The knots are set closer than 1 / (FINEST · f_half) only if the samples are."""
FEWEST = 64
"""Samples that a spectrum needs."""
RISE = 1.5
"""Sixth octaves this much above the line of the noise hold motion."""
STEEPEST = 4.0
"""Noise falls by this power of frequency at most (in power); what is steeper is motion."""
LINE = 1e-3
"""A single line above the noise is motion if it carries this share of the rate's variance."""


@dataclass(frozen=True)
class Spectrum:
    """Power of the samples over frequency (Hz), summed over their components: `power`, `noise`, `motion` (unit²/Hz).

    `bandwidth` (Hz): motion and noise are equal here. `seen`: False where no noise could be told from motion.
    """

    frequency: Array
    power: Array
    noise: Array
    bandwidth: float
    seen: bool

    @property
    def motion(self) -> Array:
        """What of the power is motion, unit²/Hz: nothing above the bandwidth."""
        return np.where(self.frequency <= 1.15 * self.bandwidth, np.maximum(self.power - self.noise, 0.0), 0.0)


@dataclass(frozen=True)
class LowPass:
    """What the smoother does on even samples: H = 1/(1 + (f/half)^(2·order))."""

    order: int
    half: float

    def response(self, frequency: Array) -> Array:
        """Response at these frequencies (Hz), 0 to 1."""
        return np.asarray(1.0 / (1.0 + (frequency / self.half) ** (2 * self.order)), np.float64)

    @property
    def kept(self) -> float:
        """Up to here (Hz) the response is 0.99 or more."""
        return float(self.half * (1.0 / KEPT - 1.0) ** (0.5 / self.order))

    @staticmethod
    def keeping(frequency: float, order: int = ORDERS[-1]) -> LowPass:
        """The one that keeps 0.99 at this frequency (Hz)."""
        return LowPass(order, frequency * (1.0 / KEPT - 1.0) ** (-0.5 / order))


def spectrum_of(time: Array, values: Array, floor: float = 0.0, steepest: float = STEEPEST) -> Spectrum:
    """Spectrum of samples at `time` (s, (n,), increasing), values (n, d); `floor`: noise known beforehand, unit²/Hz.

    The floor is for the sum of the components. Raises BadInput for too few samples.
    """
    from scipy.signal import detrend, welch

    if len(time) < FEWEST:
        raise BadInput(f"smoother: found {len(time)} samples, wanted {FEWEST} or more")
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1], step)
    levelled = _interpolated(time, values, even)
    segment = min(len(even), max(256, min(4096, len(even) // 6)))

    def straightened(piece: Array) -> Array:
        return np.asarray(detrend(piece), np.float64)

    frequency, power = welch(levelled.T, 1.0 / step, window=("kaiser", 16.0), nperseg=segment, detrend=straightened)
    total = np.maximum(power.sum(axis=0)[1:], np.finfo(float).tiny)
    noise, bandwidth, seen = _noise_line(frequency[1:], total, floor, steepest)
    return Spectrum(frequency[1:], total, noise, bandwidth, seen)


def _interpolated(time: Array, values: Array, even: Array) -> Array:
    """Cubic interpolation: a straight line would take a part of the motion for itself."""
    from scipy.interpolate import Akima1DInterpolator

    return np.asarray(Akima1DInterpolator(time, values)(even), np.float64)


def _noise_line(frequency: Array, power: Array, floor: float, steepest: float) -> tuple[Array, float, bool]:
    """Noise (unit²/Hz), the frequency (Hz) at which the motion rises to it, and whether a noise line was seen."""
    bands = _bands(frequency, power)
    logs, heights = np.log(bands.middle), np.log(np.maximum(bands.median, floor))
    first = max(len(logs) - 8, 1)
    seen = bool(np.polyfit(logs[first:], heights[first:], 1)[0] > -steepest - 2.0)
    while True:
        slope, height = _line(logs[first:], heights[first:], steepest)
        over = bands.mean[:first] > RISE * np.maximum(np.exp(height + slope * logs[:first]), floor)
        if over[-1] and (over[-2:].all() or bands.share[first - 1] > LINE):
            break
        first -= 1
        if first == 0:
            return _extended(frequency, slope, height, 0.0, floor), float(frequency[0]), seen
    clear = min(first + 2, len(logs) - 3)  # the lowest two bands of the line may hold some of the motion
    slope, height = _line(logs[clear:], heights[clear:], steepest)
    noise = _extended(frequency, slope, height, float(bands.middle[first]), floor)
    above = np.flatnonzero((power > 2.0 * noise) & (frequency <= bands.end[first - 1]))
    return noise, float(frequency[above[-1]] if len(above) else bands.end[first - 1]), seen


def _extended(frequency: Array, slope: float, height: float, begin: float, floor: float) -> Array:
    """The noise line, level below the frequency at which the motion begins (what it does there is hidden), unit²/Hz."""
    return np.maximum(np.exp(height + slope * np.log(np.maximum(frequency, begin))), floor)


@dataclass(frozen=True)
class Bands:
    """Sixth octaves: middle and end (Hz), median and mean power (unit²/Hz), share of the rate's variance."""

    middle: Array
    end: Array
    median: Array
    mean: Array
    share: Array


def _bands(frequency: Array, power: Array) -> Bands:
    """The spectrum in sixth octaves; a line of one frequency lifts their mean and not their median."""
    number = np.floor(6.0 * np.log2(frequency / frequency[-1]) + 1e-9).astype(int)
    starts = np.flatnonzero(np.diff(number, prepend=number[0] - 1))
    ends = np.append(starts[1:], len(frequency)) - 1
    rate = frequency**2 * power
    return Bands(
        np.sqrt(frequency[starts] * frequency[ends]),
        frequency[ends],
        np.array([np.median(power[one : last + 1]) for one, last in zip(starts, ends, strict=True)]),
        np.add.reduceat(power, starts) / (ends - starts + 1),
        np.add.reduceat(rate, starts) / rate.sum(),
    )


def _line(x: Array, y: Array, steepest: float) -> tuple[float, float]:
    """Slope and height of a line through points, by medians (Theil–Sen); it falls, by this power at most."""
    run, rise = x[:, None] - x[None, :], y[:, None] - y[None, :]
    slope = float(np.median(rise[run > 0] / run[run > 0])) if len(x) > 1 else 0.0
    slope = min(0.0, max(-steepest, slope))
    return slope, float(np.median(y - slope * x))


def risk(spectrum: Spectrum, low_pass: LowPass, derivative: int) -> tuple[float, float]:
    """Expected square of the error of a derivative, summed over the components, (unit/s^k)²: noise, motion lost."""
    passed = low_pass.response(spectrum.frequency)
    power = (2.0 * np.pi * spectrum.frequency) ** (2 * derivative)
    noise = float(np.trapezoid(power * passed**2 * spectrum.noise, spectrum.frequency))
    return noise, float(np.trapezoid(power * (1.0 - passed) ** 2 * spectrum.motion, spectrum.frequency))


def best_low_pass(spectrum: Spectrum) -> LowPass:
    """The one with the least error of the first and the second derivative (of the product of both risks)."""
    top = 0.45 * float(spectrum.frequency[-1])
    halves = np.geomspace(min(3.0 * float(spectrum.frequency[0]), 0.5 * top), top, 80)
    choices = [LowPass(order, float(half)) for order in ORDERS for half in halves]
    return min(choices, key=lambda one: sum(risk(spectrum, one, 1)) * sum(risk(spectrum, one, 2)))


def _basis() -> Array:
    """Pieces of the uniform B-spline: [a, b] is the factor of u^b in the a-th of the six that meet in an interval."""
    from scipy.interpolate import BSpline, PPoly

    pieces = PPoly.from_spline(BSpline.basis_element(np.arange(DEGREE + 2.0), extrapolate=False).tck)
    factors = np.asarray(pieces.c, np.float64)[::-1, DEGREE : DEGREE + DEGREE + 1]
    return np.asarray(factors[:, ::-1].T, np.float64)


@dataclass(frozen=True)
class Curve:
    """The fitted spline: `coefficients` (c, d), knots every `spacing` s from `begin`.

    `covariance` is the band of the inverse of the normal matrix, [j, i] for coefficients i and i + j. `scale[k]` turns
    it into the variance of the k-th derivative by noise and by motion lost, summed over the components. `local`: times
    (s), and the noise there relative to its mean over time.
    """

    begin: float
    spacing: float
    coefficients: Array
    covariance: Array
    scale: tuple[tuple[float, float], ...]
    low_pass: LowPass
    spectrum: Spectrum
    local: tuple[Array, Array] | None = None

    def value(self, time: Array, derivative: int = 0) -> Array:
        """The curve or a derivative of it at these times (s, (n,)), shape (n, d)."""
        place, weights = _weights(time, self.begin, self.spacing, len(self.coefficients), derivative)
        total = np.zeros((len(time), self.coefficients.shape[1]))
        for number in range(DEGREE + 1):
            total += weights[:, number, None] * self.coefficients[place + number]
        return total

    def variance(self, time: Array, derivative: int = 0) -> Array:
        """Variance of it, summed over the components, (n,)."""
        noise, lost = self.scale[derivative]
        here = 1.0 if self.local is None else np.interp(time, *self.local)
        return np.asarray(_spread(self, time, derivative) * (noise * here + lost), np.float64)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the smoother found and did, in sentences."""
        found = (
            f"motion and noise are equal at {self.spectrum.bandwidth:.3g} Hz",
            f"smoothed without delay: 99 % kept to {self.low_pass.kept:.3g} Hz, half at {self.low_pass.half:.3g} Hz",
        )
        unseen = "no noise is seen below the motion: the uncertainty rests on the top of the spectrum"
        return found if self.spectrum.seen else (*found, unseen)


def _weights(time: Array, begin: float, spacing: float, count: int, derivative: int) -> tuple[NDArray[np.int64], Array]:
    """First of the six coefficients that matter at each time, and their weights (n, 6)."""
    at = (np.asarray(time, np.float64) - begin) / spacing
    place = np.clip(np.floor(at).astype(np.int64), 0, count - DEGREE - 1)
    within = at - place
    factors = _basis()
    for _ in range(derivative):
        factors = factors[:, 1:] * np.arange(1, factors.shape[1])
    powers = within[:, None] ** np.arange(factors.shape[1])
    return place, powers @ factors.T / spacing**derivative


def _spread(curve: Curve, time: Array, derivative: int) -> Array:
    """bᵀ A⁻¹ b at each time, (n,)."""
    place, weights = _weights(time, curve.begin, curve.spacing, len(curve.coefficients), derivative)
    total = np.zeros(len(time))
    for apart in range(DEGREE + 1):
        twice = 1.0 if apart == 0 else 2.0
        for number in range(DEGREE + 1 - apart):
            both = weights[:, number] * weights[:, number + apart]
            total += twice * both * curve.covariance[apart, place + number]
    return np.maximum(total, 0.0)


def smooth(
    time: Array,
    values: Array,
    *,
    weight: Array | None = None,
    noise: Array | None = None,
    floor: float = 0.0,
    keep: float | None = None,
    steepest: float = STEEPEST,
) -> Curve:
    """The smooth curve through `values` (n, d) at `time` (s, (n,), increasing).

    `weight` (n,): time that each sample stands for, mean 1; with it the response is the same everywhere although the
    samples are closer here than there. `noise` (n,): power density of each sample's noise in any unit, where it varies.
    `floor`: noise known beforehand, unit²/Hz over the components. `keep`: frequency (Hz) up to which the response must
    be 0.99; without it the data decide. `steepest`: the noise falls by this power of frequency at most; 0: it is
    white. Raises BadInput.
    """
    spectrum = spectrum_of(time, values, floor, steepest)
    highest = 0.8 * float(spectrum.frequency[-1])
    if keep is not None and not 0.0 < keep < highest:
        raise BadInput(f"smoother: found {keep:g} Hz to keep, wanted a frequency up to {highest:.3g} Hz")
    low_pass = best_low_pass(spectrum) if keep is None else LowPass.keeping(keep)
    step = float(np.median(np.diff(time)) if weight is None else np.mean(np.diff(time)))
    spacing = max(step, 1.0 / (FINEST * low_pass.half))
    count = math.ceil((time[-1] - time[0]) / spacing) + DEGREE + 1
    begin = float(time[0])
    trend = np.polynomial.polynomial.polyfit(time - begin, values, 1)  # taken off and put back: fewer digits are lost
    levelled = values - np.outer(np.ones_like(time), trend[0]) - np.outer(time - begin, trend[1])
    normal, right = _normal(time - begin, levelled, weight, spacing, count)
    strength = (spacing / step) * (2.0 * np.pi * low_pass.half * spacing) ** (-2 * low_pass.order)
    matrix = normal + strength * _penalty(count, low_pass.order)
    coefficients, covariance = _solved(matrix, right)
    # the coefficients of a straight line are its values at the middles of the basis functions
    coefficients = coefficients + trend[0] + np.outer(spacing * (np.arange(count) - 0.5 * (DEGREE - 1)), trend[1])
    bare = Curve(begin, spacing, coefficients, covariance, (), low_pass, spectrum)
    local = None if noise is None else _local(time, noise, 1.0 / low_pass.half)
    return replace(bare, scale=_scales(bare, time), local=local)


def _local(time: Array, noise: Array, span: float) -> tuple[Array, Array]:
    """Noise over time, averaged over `span` (s) and relative to its mean over time."""
    from scipy.ndimage import uniform_filter1d

    count = min(max(math.ceil(10.0 * (time[-1] - time[0]) / span), 2), 1_000_000)
    even = np.linspace(time[0], time[-1], count)
    sums = np.concatenate([[0.0], np.cumsum(0.5 * (noise[1:] + noise[:-1]) * np.diff(time))])
    steps = np.diff(np.interp(even, time, sums)) / (even[1] - even[0])
    averaged = uniform_filter1d(steps, min(10, len(steps)), mode="nearest")
    return 0.5 * (even[1:] + even[:-1]), np.asarray(averaged / steps.mean(), np.float64)


def _scales(curve: Curve, time: Array) -> tuple[tuple[float, float], ...]:
    """Factors from the inverse normal matrix to the risk: the typical instant has the risk that the spectrum tells."""
    instants = np.linspace(time[0], time[-1], 2000)
    typical = [float(np.median(_spread(curve, instants, derivative))) for derivative in range(3)]
    risks = [risk(curve.spectrum, curve.low_pass, derivative) for derivative in range(3)]
    return tuple((noise / usual, lost / usual) for (noise, lost), usual in zip(risks, typical, strict=True))


def _normal(time: Array, values: Array, weight: Array | None, spacing: float, count: int) -> tuple[Array, Array]:
    """BᵀWB as a lower band (6, c), and BᵀWy (c, d)."""
    place, basis = _weights(time, 0.0, spacing, count, 0)
    weighted = basis if weight is None else basis * weight[:, None]
    band, right = np.zeros((DEGREE + 1, count)), np.zeros((count, values.shape[1]))
    for number in range(DEGREE + 1):
        for column in range(values.shape[1]):
            right[:, column] += np.bincount(place + number, weighted[:, number] * values[:, column], count)
        for apart in range(DEGREE + 1 - number):
            both = weighted[:, number] * basis[:, number + apart]
            band[apart] += np.bincount(place + number, both, count)
    return band, right


def _penalty(count: int, order: int) -> Array:
    """ΔᵀΔ for differences of this order, as a lower band (6, c)."""
    signs = np.array([(-1.0) ** j * math.comb(order, j) for j in range(order + 1)])
    band = np.zeros((DEGREE + 1, count))
    for first in range(order + 1):
        for second in range(first, order + 1):
            band[second - first, first : count - order + first] += signs[first] * signs[second]
    return band


def _solved(band: Array, right: Array) -> tuple[Array, Array]:
    """Solution (c, d) and the band (6, c) of the inverse, for a positive definite lower band (6, c)."""
    from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

    try:
        factor = cholesky_banded(band, lower=True)
    except LinAlgError:
        raise BadInput("smoother: found gaps too long to bridge, wanted a record without them") from None
    return np.asarray(cho_solve_banded((factor, True), right), np.float64), inverse_band(factor)


def inverse_band(factor: Array, size: int = 32) -> Array:
    """Band of (L Lᵀ)⁻¹ from the lower band L (w+1, c), without the rest of it: block by block from the end.

    With L_i the block on the diagonal and M_i the one below it (Takahashi's equations in blocks):
    Σ_ii = L_i⁻ᵀ (1 + M_iᵀ Σ_(i+1)(i+1) M_i) L_i⁻¹,  Σ_(i+1)i = −Σ_(i+1)(i+1) M_i L_i⁻¹.
    """
    width, count = factor.shape[0] - 1, factor.shape[1]
    blocks = -(-count // size)
    padded = np.zeros((width + 1, blocks * size))
    padded[0], padded[:, :count] = 1.0, factor
    for apart in range(1, width + 1):
        padded[apart, count - apart :] = 0.0  # these places of the band lie outside the matrix
    on, below = _blocks(padded, blocks, size)
    inverse = np.linalg.inv(on)
    middle = below @ inverse
    outer = np.swapaxes(inverse, 1, 2) @ inverse
    wide = np.zeros((blocks, 2 * size, size))
    wide[-1, :size] = outer[-1]
    for at in range(blocks - 2, -1, -1):
        side = -wide[at + 1, :size] @ middle[at]
        wide[at, size:] = side
        wide[at, :size] = outer[at] - middle[at].T @ side
    columns = np.arange(size)
    found = np.stack([wide[:, columns + apart, columns].reshape(-1) for apart in range(width + 1)])
    return np.asarray(found[:, :count], np.float64)


def _blocks(band: Array, blocks: int, size: int) -> tuple[Array, Array]:
    """Blocks on and below the diagonal of a lower band matrix, each (blocks, size, size)."""
    both = np.zeros((blocks, 2 * size, size))
    columns = np.arange(size)
    for apart in range(band.shape[0]):
        both[:, columns + apart, columns] = band[apart].reshape(blocks, size)
    return both[:, :size], both[:, size:]


def gaps(time: Array, kept: Array) -> NDArray[np.bool_]:
    """True at each of `time` (s) that lies within one of the stretches `kept` (g, 2), ends included."""
    inside = np.zeros(len(time), bool)
    for begin, end in kept:
        inside |= (time >= begin) & (time <= end)
    return inside


def trusted(curve: Curve, time: Array, sampled: Array, longest: float) -> NDArray[np.bool_]:
    """Where to trust the curve: True outside gaps of the samples longer than `longest` (s), and away from their ends
    and from those of the record, as far as the uncertainty of the second derivative is above 1.5 times the usual."""
    spread = _spread(curve, time, 2)
    wide = np.flatnonzero(np.diff(sampled) > longest)
    holes = np.stack([sampled[wide], sampled[wide + 1]], axis=1)
    within = (time >= sampled[0]) & (time <= sampled[-1])
    return np.asarray(within & ~gaps(time, holes) & (spread <= 1.5**2 * np.median(spread)), bool)
