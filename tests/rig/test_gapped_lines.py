"""Lines of what counts in a record with gaps are independent again, and as certain as the gaps let them be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct

from rig.signals.gapped_lines import whitening

COUNT, WIDTH = 400, 60


def kept(seed: int, share: float) -> np.ndarray:
    """Instants in stretches of about a tenth of the whole."""
    random = np.random.default_rng(seed)
    return np.repeat(random.random(40) < share, COUNT // 40)


def lines(signals: np.ndarray) -> np.ndarray:
    return np.asarray(dct(signals, type=2, norm="ortho", axis=-1)[..., :WIDTH])


def test_without_a_gap_lines_are_only_scaled() -> None:
    variance = np.linspace(4.0, 1.0, WIDTH)
    matrix, says = whitening(np.ones(COUNT, np.bool_), variance)
    assert says.all()
    assert matrix == pytest.approx(np.diag(1.0 / np.sqrt(variance)), abs=1e-9)


@pytest.mark.parametrize("share", [0.9, 0.5])
def test_noise_with_gaps_gives_rows_of_unit_variance_that_are_independent(share: float) -> None:
    """Noise with the stated variances of all its lines, drawn from them."""
    variance = np.concatenate([np.linspace(9.0, 1.0, WIDTH), np.ones(COUNT - WIDTH)])
    spectrum = np.sqrt(variance) * np.random.default_rng(1).normal(size=(20_000, COUNT))
    noise = dct(spectrum, type=3, norm="ortho", axis=1)  # the inverse of type 2
    here = kept(2, share)
    matrix, says = whitening(here, variance[:WIDTH])
    rows = lines(noise * here) @ matrix.T
    assert 0.5 * share * WIDTH < says.sum() <= WIDTH
    assert not rows[:, ~says].any()
    assert np.cov(rows[:, says].T) == pytest.approx(np.eye(says.sum()), abs=0.06)


def test_a_gain_is_as_certain_as_the_instants_that_count() -> None:
    """Of white noise 1/u² is the square of the signal over all that counts, for a signal within the lines."""
    t = (np.arange(COUNT) + 0.5) / COUNT
    signal = np.cos(np.pi * 4 * t) + 0.5 * np.cos(np.pi * 11 * t)
    here = kept(5, 0.7)
    matrix, _ = whitening(here, np.ones(WIDTH))
    rows = matrix @ lines(signal * here)
    assert rows @ rows == pytest.approx(float(np.sum(signal[here] ** 2)), rel=0.02)
