"""How unusual χ² is, as a normal deviate: the exact tail of F, because variances that weigh rows are estimated too.

χ²/n of n rows follows F(n, ν) if their variance was found with ν degrees of freedom, which make it uncertain by
√(2/ν). Few rows are far from normal: of four, χ²/n exceeds 4.5 (five "standard deviations") in one case of a thousand.
"""

from __future__ import annotations

import math

import numpy as np

TINY = 1e-200  # a probability below is worked out by its series
TERMS = 4000
LEAST = -8.0  # a deviate further below is no less unusual: nobody asks


def deviate(chi2: float, count: int, allowance: float) -> float:
    """χ² of so many rows as a normal deviate of the same tail, variances known to within the allowance, relative."""
    from scipy.special import ndtri_exp

    return max(-float(ndtri_exp(log_tail(chi2 / count, count, allowance))), LEAST)


def limit(risk: float, among: int) -> float:
    """The deviate that the largest of so many exceeds by chance with this probability (Bonferroni)."""
    from scipy.special import ndtri

    return -float(ndtri(risk / max(among, 1)))


def log_tail(ratio: float, count: int, allowance: float) -> float:
    """Logarithm of P(F(n, ν) > χ²/n) with ν = 2/allowance²; of χ² alone without an allowance."""
    from scipy.special import chdtrc, fdtrc

    if allowance > 0.0:
        freedom = 2.0 / allowance**2
        chance = float(fdtrc(count, freedom, ratio))
        return math.log(chance) if chance > TINY else _far(ratio, count, freedom)
    chance = float(chdtrc(count, ratio * count))
    # log Q(a, x) for x far above a: x^(a−1)·e^(−x)/Γ(a)
    a, x = 0.5 * count, 0.5 * count * ratio
    return math.log(chance) if chance > TINY else (a - 1.0) * math.log(x) - x - math.lgamma(a)


def _far(ratio: float, count: int, freedom: float) -> float:
    """The same far out: I_w(p, q) = w^p·(1 − w)^q/(p·B(p, q))·₂F₁(p + q, 1; p + 1; w), DLMF 8.17.8, p = ν/2, q = n/2,
    w = ν/(ν + n·ratio).
    """
    p, q = 0.5 * freedom, 0.5 * count
    w = freedom / (freedom + count * ratio)
    k = np.arange(TERMS)
    series = 1.0 + float(np.sum(np.cumprod((p + q + k) / (p + 1.0 + k) * w)))
    beta = math.lgamma(p) + math.lgamma(q) - math.lgamma(p + q)
    return p * math.log(w) + q * math.log1p(-w) - math.log(p) - beta + math.log(series)
