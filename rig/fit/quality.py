"""How well a fitted model does: its error against the noise, on what was fitted and on what was held out.

An error of one is noise and nothing else. Held-out rows (every third point or stretch) are predicted by a fit that has
not seen them, so an effect that only follows chance does not lower their error.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rig.fit import adequacy
from rig.fit import fit as fitting
from rig.fit.evidence import Evidence
from rig.fit.fit import Fit


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


def heldout_error(evidence: Evidence, found: Fit) -> float:
    """√(χ²/n) of the held-out rows, predicted by the same model fitted without them; NaN if nothing is held out."""
    out = heldout_rows(found)
    if not out.any():
        return math.nan
    trained = fitting.fit(found.parts, found.state, use=evidence.training)
    left = fitting.residual(found.parts, trained.state)[out]
    return math.sqrt(float(left @ left) / len(left))


def worst_of(found: Fit) -> tuple[str, float]:
    """Where the error is furthest above the noise, and its size there: one channel in one domain of its rows.

    An effect that lives in a few rows hardly shows in the error of all. ("", NaN) if there is no group.
    """
    one = adequacy.worst(found)
    return ("", math.nan) if one is None else (f"{one.channel}, {one.domain}", one.ratio)


def error_at(found: Fit, where: str) -> float:
    """√(χ²/n) of the rows that `worst_of` named; NaN if the fit has none of that name."""
    here = [one for one in adequacy.groups(found) if f"{one.channel}, {one.domain}" == where]
    count = sum(one.count for one in here)
    return math.sqrt(sum(one.chi2 for one in here) / count) if count else math.nan


def heldout_rows(found: Fit) -> NDArray[np.bool_]:
    """Rows with an observation that a model is judged by, (rows,)."""
    return np.concatenate([part.held_out & part.counted for part in found.parts])
