"""Whether what is left looks like noise: tests of a sequence, each with the probability that noise does as much.

- runs: signs of neighbours (Wald and Wolfowitz 1940, Ann. Math. Statist. 11, 147);
- Ljung and Box: correlations at several lags together (1978, Biometrika 65, 297);
- Fisher's g: one line that stands out of a periodogram (1929, Proc. R. Soc. A 125, 54).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rig.errors import BadInput
from rig.motion import Array

FEWEST = 8


@dataclass(frozen=True)
class Whiteness:
    """One test: what was tested, its statistic, and the probability of that much or more from noise alone."""

    test: str
    where: str
    statistic: float
    probability: float

    @property
    def in_words(self) -> str:
        """One sentence."""
        chance = f"probability {self.probability:.2g}" if self.probability > 1e-12 else "no chance"
        return f"{self.where}: {self.test} {self.statistic:.3g}, {chance}"


def runs(values: Array, where: str = "") -> Whiteness:
    """Number of runs of equal sign of a sequence (n,), as a normal deviate; negative for too few.

    With n₊ and n₋ of each sign: expected 1 + 2n₊n₋/n, variance 2n₊n₋(2n₊n₋ − n)/(n²(n − 1)). Two-sided.
    """
    up = _enough(values)[values != 0.0] > 0.0
    n, plus = len(up), int(np.count_nonzero(up))
    pairs = 2.0 * plus * (n - plus)
    if pairs <= n:  # all but one of one sign
        return Whiteness("runs", where, -math.sqrt(n), 2.0 ** (2.0 - n))
    count = 1 + int(np.count_nonzero(up[1:] != up[:-1]))
    z = (count - 1.0 - pairs / n) / math.sqrt(pairs * (pairs - n) / (n**2 * (n - 1.0)))
    return Whiteness("runs", where, z, math.erfc(abs(z) / math.sqrt(2.0)))


def ljung_box(values: Array, lags: int = 8, where: str = "") -> Whiteness:
    """Q = n(n + 2)·Σ r_k²/(n − k), a χ² with as many degrees as lags for white noise; values (n,)."""
    from scipy.special import chdtrc

    left = _enough(values) - values.mean()
    n, most = len(left), min(lags, len(left) // 3)
    square = float(left @ left)
    if square == 0.0:
        return Whiteness("Ljung–Box", where, 0.0, 1.0)
    r = np.array([float(left[k:] @ left[:-k]) / square for k in range(1, most + 1)])
    q = n * (n + 2.0) * float(np.sum(r**2 / (n - np.arange(1, most + 1))))
    return Whiteness("Ljung–Box", where, q, float(chdtrc(most, q)))


def fisher_g(powers: Array, where: str = "") -> Whiteness:
    """g = largest ÷ sum of m powers, each of two degrees of freedom; P(g) = Σ (−1)^(k−1)·C(m, k)·(1 − kg)^(m−1)."""
    m, total = len(_enough(powers)), float(powers.sum())
    g = float(powers.max()) / total if total > 0.0 else 0.0
    first = math.log(m) + (m - 1.0) * math.log1p(-g) if g < 1.0 else -math.inf
    if first < math.log(1e-3):  # further terms are smaller by as much again
        return Whiteness("Fisher's g", where, g, math.exp(first))
    if g <= 4.0 / m:  # terms that cancel: the largest of m exponential deviates, which P is close to
        return Whiteness("Fisher's g", where, g, -math.expm1(m * math.log1p(-math.exp(-g * m))))
    terms = [
        (-1.0) ** (k - 1) * math.exp(_log_choose(m, k) + (m - 1.0) * math.log1p(-k * g))
        for k in range(1, min(m, math.ceil(1.0 / g) - 1) + 1)
    ]
    return Whiteness("Fisher's g", where, g, min(max(math.fsum(terms), 0.0), 1.0))


def _log_choose(m: int, k: int) -> float:
    return math.lgamma(m + 1.0) - math.lgamma(k + 1.0) - math.lgamma(m - k + 1.0)


def _enough(values: Array) -> Array:
    if len(values) < FEWEST:
        raise BadInput(f"whiteness: found {len(values)} values, wanted at least {FEWEST}")
    return values
