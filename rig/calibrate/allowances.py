"""What every result allows for beside its own fit: a model that misses the data, temperature, declared limits."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass

from rig.calibrate.budget import Contribution, half_width
from rig.calibrate.calibration import MISSING, Status

UNLIKELY = 1e-4  # probability of a misfit below which the model is called in question


@dataclass(frozen=True)
class Misfit:
    """How a fit stands to the noise of its data: `factor` widens the noise's share, 1 unless in question."""

    factor: float
    remarks: tuple[str, ...] = ()

    @property
    def status(self) -> Status:
        return "flagged" if self.remarks else "determined"


def misfit(chi2: float, dof: int, what: str, noise_dof: float = math.inf) -> Misfit:
    """Widened by √(χ²/dof) if the data miss `what` by more than chance allows.

    With noise that is itself an estimate of `noise_dof` degrees of freedom, χ²/dof has the F distribution.
    """
    from scipy.special import chdtrc, fdtrc

    by_chance = chdtrc(dof, chi2) if math.isinf(noise_dof) else fdtrc(dof, noise_dof, chi2 / dof)
    if float(by_chance) >= UNLIKELY:
        return Misfit(1.0)
    factor = math.sqrt(chi2 / dof)
    return Misfit(
        factor,
        (f"{what} by {factor:.1f} times their noise: {MISSING}; u of the noise is widened by that factor",),
    )


SHEET = "data sheet"


def of_sheet(channel: str) -> str:
    """The source of an error that is this sensor's own within what its data sheet allows."""
    return f"{SHEET} of {channel}"


def in_runs(words: str, runs: Iterable[str]) -> str:
    """The source of an error that is these runs' own (how things were mounted, the day's temperature): what two results
    from the same runs share, and no two calibrations from different ones (GUM 5.2.4, F.1.2.3).
    """
    names = sorted(set(runs))
    rest = hashlib.sha256("\n".join(names).encode()).hexdigest()[:6]
    more = f" and {len(names) - 2} more ({rest})" if len(names) > 2 else ""
    return f"{words}, {', '.join(names[:2])}{more}"


def cosine(name: str, limit: float, value: float, runs: Iterable[str]) -> Contribution:
    """A misalignment of at most `limit` (rad) takes up to 1 − cos of it; half of that interval either way."""
    size = half_width(1.0 - math.cos(limit), "rectangular")
    source = in_runs(f"declared limit {math.degrees(limit):.3g}°", runs)
    return Contribution(name, "B", "rectangular", size, "1", value, source=source)


def temperature(
    value: float, drift: float | None, span: tuple[float, float, float] | None, runs: Iterable[str]
) -> tuple[tuple[Contribution, ...], tuple[str, ...]]:
    """Budget lines and remarks: `drift` is the declared coefficient, 1/K; `span` mean, lowest and highest, °C."""
    if drift is None:
        return (), ("temperature coefficient not declared: value holds at the temperature of the records",)
    if span is None:
        return (), ("temperature was not recorded: it is not in the budget",)
    u = half_width(abs(drift) * 0.5 * (span[2] - span[1]), "rectangular")
    source = in_runs("declared coefficient times half the span", runs)
    return (Contribution("temperature", "B", "rectangular", u, "1", value, source=source),), ()
