"""Parameters that one record ties to each other are not stated as if each were known."""

from __future__ import annotations

import math

import imported_worlds as worlds
import numpy as np
import pytest
from imported_worlds import Unit

from rig.cli.repair import candidate_text
from rig.diagnose.conclusion import conclude
from rig.fit.parameters import tied
from rig.model import Term
from rig.repair import repair
from rig.repair.repair import Bench
from rig.shelf import shelf

RISE = math.radians(2.0)  # °/s over the record
SECONDS = 30.0


def drifting() -> Bench:
    """A log in which the gyros' zeros rise steadily: an exponential of any great time constant does as well."""
    log = worlds.rotation(Unit(), 3, seconds=SECONDS, channels="r")
    rows = log.tables[0].of("t") / SECONDS
    for channel in ("gyro_x", "gyro_y", "gyro_z"):
        log = worlds.changed(log, channel, lambda rate: rate + RISE * rows)
    return Bench(worlds.evidence(log), shelf(), 0.0)


def test_of_a_zero_that_rises_steadily_the_slope_is_known_and_neither_size_nor_time_constant() -> None:
    bench = drifting()
    (one,) = conclude(bench.evidence, [], bench.shelf).taken
    assert one.effect == "warm_up"
    assert one.probability <= 0.5  # a temperature that nobody logged, ageing: each rises steadily as well
    assert one.tied is not None
    assert one.tied.names == ("shift", "time_constant")
    assert one.tied.what == "shift/time_constant"
    slope = one.tied.together
    assert slope is not None
    assert slope.u is not None
    assert abs(-slope.value - RISE / SECONDS) < 3.0 * slope.u < RISE / SECONDS
    lines = candidate_text(one, nearest=False)
    assert not [line for line in lines if line.strip().startswith(("shift = ", "time_constant = "))]
    assert any("shift and time_constant are not known apart" in line for line in lines)
    written = one.as_json()["not_known_apart"]
    assert written["together"]["value"] == slope.value
    added = repair.added(bench, repair.new(bench, "datasheet"), "warm_up", "rate")
    assert any("not known apart" in said for said in added.remarks)


@pytest.mark.parametrize("correlation", [-0.999, 0.999])
def test_the_product_or_quotient_that_is_known_is_the_one_whose_uncertainty_is_least(correlation: float) -> None:
    term = Term(shelf()["warm_up"], "rate", {"shift": 2.0, "time_constant": 500.0})
    u = np.array([1.0, 250.0])
    covariance = np.outer(u, u) * np.array([[1.0, correlation], [correlation, 1.0]])
    made = tied(term, covariance)
    assert made is not None
    assert made.together is not None
    assert made.what == ("shift/time_constant" if correlation > 0.0 else "shift·time_constant")
    assert made.together.u == pytest.approx(abs(made.together.value) * math.sqrt(2 * 0.25 * 0.001), rel=1e-6)


def test_parameters_that_are_each_known_well_are_not_said_to_be_tied_however_they_correlate() -> None:
    term = Term(shelf()["warm_up"], "rate", {"shift": 2.0, "time_constant": 500.0})
    u = np.array([0.02, 5.0])
    assert tied(term, np.outer(u, u) * np.array([[1.0, 0.99], [0.99, 1.0]])) is None
    assert tied(term, np.diag([1.0, 250.0**2])) is None
