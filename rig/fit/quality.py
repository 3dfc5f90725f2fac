"""How well a fitted model does: its error against the noise, on what was fitted and on what was held out.

The one definition of an error: √(χ²/n) of some rows, every row weighed by its own noise, so that one is noise and
nothing else; in SI that times the rms of the noise of the rows. Held-out rows (every third point or stretch) are
predicted by a fit that has not seen them, so an effect that only follows chance does not lower their error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from rig.fit import adequacy
from rig.fit import fit as fitting
from rig.fit.adequacy import FEWEST_HELD, Group
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit
from rig.parts.remainder import Mask
from rig.printed import SHOWN


def with_unit(value: float, unit: str) -> str:
    """A size in SI to three digits, per cent where it has no unit."""
    shown, scale = relative(unit)
    return f"{scale * value:.3g} {shown}"


def relative(unit: str) -> tuple[str, float]:
    """What an SI unit is called beside a size, and how many of it make one: per cent for no unit, else itself."""
    return SHOWN["1"] if unit == "1" else (unit, 1.0)


@dataclass(frozen=True)
class Place:
    """One channel in one kind of its rows, `where` in words: error ÷ noise there, over all rows and over those held
    out (NaN without any), and the error in `unit`, SI.
    """

    where: str
    ratio: float
    heldout: float = math.nan
    error: float = math.nan
    unit: str = ""

    @property
    def size(self) -> str:
        """The error with its unit, "" where it has none."""
        return with_unit(self.error, self.unit) if math.isfinite(self.error) else ""


@dataclass(frozen=True)
class Errors:
    """Of a model against everything: error ÷ noise over all rows, over those held out (NaN if too few are), and the
    place where it is furthest above its noise. `predicted` are the rows held out, as a fit without them says them.
    """

    error: float
    heldout: float
    worst: Place
    predicted: Fit | None = field(default=None, repr=False)

    def at(self, found: Fit, where: str) -> Place:
        """Another place of the same fit."""
        return _place(found, where, self.predicted)


def errors_of(evidence: Evidence, found: Fit) -> Errors:
    """The errors of a model that was fitted to all rows."""
    return errors_from(found, predicted_of(evidence, found))


def errors_from(found: Fit, predicted: Fit | None) -> Errors:
    """The same from the rows held out as they are predicted."""
    heldout = error_of(predicted) if predicted is not None and predicted.count >= FEWEST_HELD else math.nan
    return Errors(error_of(found), heldout, _place(found, worst_of(found)[0], predicted), predicted)


def predicted_of(evidence: Evidence, found: Fit) -> Fit | None:
    """The rows held out as the same model says them, fitted without them; None if none is."""
    out = heldout_rows(found)
    if not out.any():
        return None
    trained = fitting.fit(found.parts, found.state, use=evidence.training)
    left = fitting.residual(found.parts, trained.state, out)
    return replace(trained, left=left, use=out, chi2=fitting.squares(left))


def error_of(found: Fit) -> float:
    """√(χ²/n) over all rows that carry an observation."""
    return math.sqrt(found.chi2 / found.count)


def on_all_rows(found: Fit) -> Fit:
    """The same model fitted to all rows."""
    return found if found.use is None else fitting.fit(found.parts, found.state)


def chi2_dof(found: Fit) -> float:
    """χ² of rows and priors over their number less that of the parameters."""
    _, weights = fitting.prior_of(found.parts, found.state)
    freedom = found.count + int(np.count_nonzero(weights)) - found.layout.size
    return found.objective / max(freedom, 1)


def worst_of(found: Fit) -> tuple[str, float]:
    """Where the error is furthest above the noise, and its size there: one channel in one domain of its rows.

    An effect that lives in a few rows hardly shows in the error of all. ("", NaN) if there is no group.
    """
    one = adequacy.worst(found)
    return ("", math.nan) if one is None else (_words(one), one.ratio)


def error_at(found: Fit, where: str) -> float:
    """√(χ²/n) of the rows that `worst_of` named; NaN if the fit has none of that name."""
    here = [one for one in adequacy.groups(found) if _words(one) == where]
    count = sum(one.count for one in here)
    return math.sqrt(sum(one.chi2 for one in here) / count) if count else math.nan


def _words(one: Group) -> str:
    return f"{one.channel}, {one.domain}"


def _place(found: Fit, where: str, predicted: Fit | None) -> Place:
    ratio = error_at(found, where)
    noise, unit = _noise_at(found, where)
    heldout = math.nan if predicted is None else error_at(predicted, where)
    return Place(where, ratio, heldout, noise * ratio, unit)


def _noise_at(found: Fit, where: str) -> tuple[float, str]:
    """Rms of the noise of the rows of a place, SI, and their unit; (NaN, "") of what is no row of a part."""
    sums = [one for number in range(len(found.parts)) for one in _sums(found, number, where)]
    total = sum(count for _, count, _ in sums)
    return (math.sqrt(sum(square for square, _, _ in sums) / total), sums[0][2]) if total else (math.nan, "")


def _sums(found: Fit, number: int, where: str) -> Iterator[tuple[float, float, str]]:
    """Sum of variances of a place in a part, SI², over how many numbers, and their unit."""
    part, noise = found.parts[number], None
    used = found.rest(number).used.reshape(len(part.row_names), -1)
    for row, name in enumerate(part.row_names):
        for domain, mask in part.domains().items():
            if f"{name}, {domain}" == where:
                noise = part.noise() if noise is None else noise
                here = mask & used[row]
                yield float(np.sum(noise[row][here])), part.numbers_in(here), part.unit(name)


def heldout_rows(found: Fit) -> Mask:
    """Rows with an observation that a model is judged by, (rows,)."""
    return np.concatenate([part.held_out & part.counted for part in found.parts])
