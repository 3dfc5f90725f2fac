"""Noise models against theory, and fits against noise made another way: their errors are as large as they say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from rig.errors import BadInput
from rig.signals import noise, spectrum


def white(rng: np.random.Generator, n: int, rate: float, density: float, pole: float = math.inf) -> np.ndarray:
    if math.isinf(pole):
        return rng.standard_normal(n) * math.sqrt(density * rate / 2)
    rho, variance = math.exp(-2 * math.pi * pole / rate), density * pole * math.pi / 2
    steps = rng.standard_normal(n + 1000) * math.sqrt(variance * (1 - rho**2))
    return np.asarray(lfilter([1.0], [1.0, -rho], steps)[1000:])


def flicker(rng: np.random.Generator, n: int, rate: float, level: float) -> np.ndarray:
    """A piece of a four times longer record shaped in frequency, so that its ends do not meet."""
    long = 4 * n
    f = np.fft.rfftfreq(long, 1 / rate)[1:]
    normal = rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)
    return np.fft.irfft(np.concatenate([[0], normal * np.sqrt(level / f * rate * long / 4)]), long)[:n]


def walk(rng: np.random.Generator, n: int, rate: float, level: float) -> np.ndarray:
    return np.cumsum(rng.standard_normal(n)) * math.sqrt(2 * math.pi**2 * level / rate)


def errors(fits: list[noise.NoiseFit], name: str, truth: float) -> float:
    """Root mean square of the error in units of the stated uncertainty, in logarithms."""
    ratios = [math.log(getattr(f.model, name) / truth) * getattr(f.model, name) / f.u[name] for f in fits]
    return math.sqrt(float(np.mean(np.square(ratios))))


def test_flicker_is_found_with_the_error_that_is_stated() -> None:
    fits = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        fits.append(
            noise.fit(white(rng, 20_000, 100.0, 1.0) + flicker(rng, 20_000, 100.0, 1.0), 100.0, step=0, pole=None)
        )
    assert {f.terms for f in fits} == {("white", "flicker")}
    assert 0.75 < errors(fits, "white", 1.0) < 1.3
    assert 0.75 < errors(fits, "flicker", 1.0) < 1.3
    assert np.mean([f.chi2_dof for f in fits]) == pytest.approx(1.0, abs=0.1)


def behind_a_pole(values: np.ndarray, rate: float, pole: float) -> np.ndarray:
    """The sampled one-pole filter whose density at f ≪ pole is that of its input, up to the aliased share."""
    from scipy.signal import lfilter

    rho = math.exp(-2 * math.pi * pole / rate)
    gain = math.sqrt(math.pi * pole / rate * (1 - rho) * (1 + rho))
    return np.asarray(lfilter([gain], [1, -rho], values))


def test_a_filter_pole_is_found_with_the_error_that_is_stated() -> None:
    fits = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        before = white(rng, 20_000, 1000.0, 1.0) + flicker(rng, 20_000, 1000.0, 3.0)
        record = behind_a_pole(before, 1000.0, 100.0)
        fits.append(noise.fit(record, 1000.0, step=0, pole=80.0))
    assert {f.names for f in fits} == {("white", "flicker", "pole")}
    for name, truth in (("white", 1.0), ("pole", 100.0), ("flicker", 3.0)):
        assert 0.7 < errors(fits, name, truth) < 1.35, name


def test_flicker_does_not_fold_at_a_rate_that_is_low_for_the_filter() -> None:
    """White noise behind 400 Hz is 1.4 times as dense when it is sampled at 1000 Hz; slow noise is what it was."""
    from scipy.fft import dct

    count, rate, found = 20_000, 1000.0, []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        record = white(rng, count, rate, 1.0, 400.0) + flicker(rng, count, rate, 20.0)
        power = np.asarray(dct(record, type=2, norm="ortho")[1:]) ** 2 * 2.0 / rate
        bins = spectrum.log_bins(np.arange(1, count) * rate / (2.0 * count), power, 20.0)
        found.append(noise.fit_density(bins, rate, step=0.0, pole=400.0))
    assert np.mean([one.flicker for one in found]) == pytest.approx(20.0, rel=0.08)
    assert np.mean([one.white for one in found]) == pytest.approx(1.0, rel=0.08)


def test_random_walk_is_found_with_the_error_that_is_stated() -> None:
    fits = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        record = white(rng, 20_000, 100.0, 1.0) + walk(rng, 20_000, 100.0, 0.02)
        fits.append(noise.fit(record, 100.0, step=0, pole=None))
    assert {f.terms for f in fits} == {("white", "random_walk")}
    assert 0.7 < errors(fits, "random_walk", 0.02) < 1.35


def test_flicker_in_a_short_record_is_no_random_walk() -> None:
    named = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        record = white(rng, 3000, 1000.0, 1.0, 100.0) + flicker(rng, 3000, 1000.0, 5.0)
        found = noise.fit(record, 1000.0, step=0, pole=100.0)
        named.append(noise.coefficients(found)["K"].value is not None)
    assert not any(named)


def test_a_random_walk_that_flicker_might_be_leaves_both_unsaid_and_keeps_the_likelier_for_means() -> None:
    unsaid = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        found = noise.fit(white(rng, 20_000, 100.0, 1.0) + walk(rng, 20_000, 100.0, 2e-3), 100.0, step=0, pole=None)
        known = noise.coefficients(found)
        if "random_walk" in found.terms and known["K"].value is None and known["B"].reason == noise.ALIKE:
            unsaid += 1
            assert found.model.random_walk > 0.0
    assert unsaid > 3


def test_pure_white_noise_has_no_bias_instability_and_no_random_walk() -> None:
    for seed in range(40):
        found = noise.fit(white(np.random.default_rng(seed), 20_000, 100.0, 2.0), 100.0, step=0, pole=20.0)
        assert found.names == ("white",)
        table = noise.coefficients(found)
        assert table["B"].value is None
        assert table["K"].value is None
        assert "not needed" in table["B"].reason
        assert table["N"].value == pytest.approx(1.0, abs=5 * (table["N"].u or 0))


def test_the_coefficients_follow_the_standard() -> None:
    model = noise.NoiseModel(100.0, white=2.0, flicker=3.0, random_walk=0.5)
    u = {"white": 0.2, "flicker": 0.3, "random_walk": 0.1}
    fitted = noise.NoiseFit(model, tuple(u), u, tuple(u), np.eye(3), {}, 1.0, 1e4, 0.1, 0.01)
    table = noise.coefficients(fitted)
    assert table["N"].value == pytest.approx(1.0)
    assert table["N"].u == pytest.approx(0.05)
    assert (table["B"].value or 0) ** 2 / math.pi == pytest.approx(3.0)
    assert 2 * (table["K"].value or 0) ** 2 / (2 * math.pi) ** 2 == pytest.approx(0.5)
    assert table["R"].value == 0.1


def test_a_ramp_is_told_from_noise_by_generalised_least_squares() -> None:
    ratios = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        record = white(rng, 20_000, 100.0, 1.0) + flicker(rng, 20_000, 100.0, 0.5) + 0.1 * np.arange(20_000) / 100.0
        found = noise.fit(record, 100.0, step=0, pole=None, ramp=True)
        assert found.slope is not None
        assert found.u_slope is not None
        ratios.append((found.slope - 0.1) / found.u_slope)
    assert 0.65 < math.sqrt(float(np.mean(np.square(ratios)))) < 1.4
    rng = np.random.default_rng(1)
    without = noise.fit(white(rng, 20_000, 100.0, 1.0), 100.0, step=0, pole=None, ramp=True)
    assert without.slope is None
    assert noise.coefficients(without)["R"].value is None


def test_rounding_is_not_taken_for_noise_of_the_sensor() -> None:
    rng = np.random.default_rng(5)
    step = 10.0
    record = np.round(white(rng, 50_000, 100.0, 1.0) / step) * step
    found = noise.fit(record, 100.0, step=step, pole=None)
    assert found.model.quantisation == pytest.approx(step**2 / 12 / 50.0)
    assert found.model.white == pytest.approx(1.0, abs=5 * found.u["white"] + 0.02)


def test_a_random_walk_seen_at_the_end_of_the_record_only_is_refused_as_too_short() -> None:
    reasons = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        found = noise.fit(white(rng, 5000, 100.0, 1.0) + walk(rng, 5000, 100.0, 0.002), 100.0, step=0, pole=None)
        assert "random_walk" not in found.terms or _clusters(found) >= noise.CLUSTERS
        reasons.append(found.refused.get("random_walk", ""))
    assert any("record too short" in reason for reason in reasons)


def _clusters(found: noise.NoiseFit) -> float:
    n, k = math.sqrt(found.model.white / 2), math.sqrt(2 * math.pi**2 * found.model.random_walk)
    return found.seconds * k / (math.sqrt(3) * n)


def test_a_record_fed_in_pieces_gives_the_noise_that_is_in_it() -> None:
    rng = np.random.default_rng(8)
    n, rate = 1_200_000, 1000.0
    record = white(rng, n, rate, 1.0) + flicker(rng, n, rate, 2.0)
    periodogram = spectrum.Periodogram(rate)
    for piece in np.array_split(record, 13):
        periodogram.feed(piece)
    streamed = noise.fit_blocks(periodogram.result(), step=0, pole=None)
    assert streamed.terms == ("white", "flicker")
    assert abs(streamed.model.white - 1.0) < 4 * streamed.u["white"]
    assert abs(streamed.model.flicker - 2.0) < 4 * streamed.u["flicker"]


def test_the_sampled_density_holds_the_variance_of_the_filtered_noise() -> None:
    model = noise.NoiseModel(1000.0, white=2.0, pole=150.0)
    f = np.linspace(0.005, 500 - 0.005, 50_000)
    assert float(model.density(f).mean() * 500) == pytest.approx(2.0 * 150 * math.pi / 2, rel=1e-6)
    assert model.rms(0) ** 2 == pytest.approx(2.0 * 150 * math.pi / 2)


def test_the_rms_is_the_integral_of_the_density() -> None:
    model = noise.NoiseModel(1000.0, white=2.0, pole=50.0, flicker=3.0, random_walk=4.0)
    f = np.geomspace(0.1, 200, 200_000)
    assert model.rms(0.1, 200) ** 2 == pytest.approx(float(np.trapezoid(model.density(f), f)), rel=1e-6)
    with pytest.raises(BadInput, match="above zero"):
        model.rms(0)


def test_block_means_of_white_noise_have_half_the_density_over_their_length() -> None:
    begin, length = np.array([0.0, 2.0, 10.0]), np.array([1.0, 5.0, 0.5])
    for pole in (math.inf, 1e5):
        covariance = noise.NoiseModel(1e9, white=3.0, pole=pole).covariance(begin, begin + length)
        assert np.diag(covariance) == pytest.approx(1.5 / length, rel=1e-3)
        assert np.abs(covariance - np.diag(np.diag(covariance))).max() < 1e-9


@pytest.mark.parametrize("kind", ["flicker", "random_walk"])
def test_differences_of_block_means_vary_as_the_covariance_says(kind: str) -> None:
    rate, n, runs = 20.0, 4000, 600
    begin = np.array([0.0, 10.0, 35.0, 60.0, 100.0, 170.0])
    end = begin + np.array([10.0, 20.0, 20.0, 5.0, 50.0, 30.0])
    rng = np.random.default_rng(3)
    make = flicker if kind == "flicker" else walk
    means = np.array([_means(make(rng, n, rate, 1.0), rate, begin, end) for _ in range(runs)])
    contrast = np.eye(6)[1:] - np.eye(6)[:-1]
    wanted = contrast @ noise.NoiseModel(rate, 0.0, **{kind: 1.0}).covariance(begin, end) @ contrast.T
    found = np.cov((means @ contrast.T).T)
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    assert np.abs((found - wanted) / scale).max() < 4.5 * math.sqrt(2 / runs)


def _means(values: np.ndarray, rate: float, begin: np.ndarray, end: np.ndarray) -> list[float]:
    return [float(values[round(b * rate) : round(e * rate)].mean()) for b, e in zip(begin, end, strict=True)]


def test_the_covariance_of_many_unequal_blocks_is_positive_definite() -> None:
    rng = np.random.default_rng(4)
    begin = np.cumsum(rng.uniform(1.0, 20.0, 600))
    model = noise.NoiseModel(1000.0, white=1.0, pole=80.0, flicker=2.0, random_walk=0.1, quantisation=0.01)
    assert np.linalg.eigvalsh(model.covariance(begin, begin + rng.uniform(0.1, 1.0, 600))).min() > 0


def test_records_that_cannot_be_used_are_refused() -> None:
    with pytest.raises(BadInput, match="at least 64"):
        noise.fit(np.ones(5), 1.0, step=0, pole=None)
    with pytest.raises(BadInput, match="wanted begin < end"):
        noise.NoiseModel(1.0, 1.0).covariance([0.0], [0.0])


def test_how_well_the_noise_of_means_is_known_covers_what_records_say_of_it() -> None:
    rate, rng = 100.0, np.random.default_rng(8)
    found = []
    for _ in range(60):
        values = white(rng, 3000, rate, 1e-4) + flicker(rng, 3000, rate, 2e-4)
        bins = _bins(values, rate)
        found.append(noise.fit_density(bins, rate, step=0.0, pole=None))
    slow = np.log([float(one.density(0.01)) for one in found])
    u = float(np.mean([one.u_log(0.01) for one in found]))
    assert 0.05 < u < 0.3
    assert float(np.std(slow)) == pytest.approx(u, rel=0.25)


def _bins(values: np.ndarray, rate: float) -> spectrum.Density:
    lines = np.abs(np.fft.rfft(values))[1:-1] ** 2 * 2.0 / (rate * len(values))
    return spectrum.log_bins(np.arange(1, len(lines) + 1) * rate / len(values), lines, 20.0, 2.0)


def test_what_a_data_sheet_says_counts_as_much_as_it_is_sure() -> None:
    rate, rng = 100.0, np.random.default_rng(9)
    bins = _bins(white(rng, 500, rate, 1e-4), rate)
    free = noise.fit_density(bins, rate, step=0.0, pole=None)
    sure = {"white": (math.log(4e-4), 1e-3)}
    unsure = {"white": (math.log(4e-4), 10.0)}
    bound = noise.fit_density(bins, rate, step=0.0, pole=None, beforehand=sure)
    loose = noise.fit_density(bins, rate, step=0.0, pole=None, beforehand=unsure)
    assert bound.white == pytest.approx(4e-4, rel=0.01)
    assert loose.white == pytest.approx(free.white, rel=0.01)
    assert float(bound.u_log(10.0)) < 0.01 < float(free.u_log(10.0))
