"""Scores and whitened turntable rows: what is left out to be quick would have been zero."""

from __future__ import annotations

import fast_bench
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.fft import dct

from rig.diagnose import search
from rig.diagnose.diagnose import _has_numbers
from rig.fit import fit as fitting
from rig.fit.evidence import evidence_of
from rig.fit.fit import Fit
from rig.model import Channels, Coordinate, Effect, Motion, Parameter, Term, Values
from rig.motion import Array
from rig.parts.platter import Platter
from rig.shelf import shelf

TURNS = {"procedure": "turntable", "all": True}
CANDIDATES = (
    ("cubic", "rate"), ("delay", "acceleration"), ("axis_offset", "acceleration"), ("platen_tilt", None),
    ("motor_pickup", "rate"), ("supply_ratio", "rate"),
)  # fmt: skip


@pytest.fixture(scope="module")
def found() -> Fit:
    """A turntable run of a unit with nothing hidden, fitted."""
    return evidence_of([fast_bench.measure(TURNS, fast_bench.world(11, []))]).fitted()


def test_a_fit_has_columns_of_all_rows_that_count_and_the_others_leave_nothing(found: Fit) -> None:
    counted = np.concatenate([part.counted for part in found.parts])
    assert np.count_nonzero(~counted) > 0
    assert not found.left[~counted].any()
    rows = np.concatenate([block.rows for block in found.blocks])
    assert np.array_equal(np.sort(rows), np.flatnonzero(counted))


def plain(part: Platter, raw: Array) -> Array:
    """Whitened rows, (c, width): one channel and one stretch at a time."""
    data, rows = part.data, []
    for channel, one in enumerate(raw):
        means = np.array([one[begin:end].mean() for begin, end in data.stretches])
        scales = [scale[channel] for scale in part._scales]
        lines = [dct(one[b:e], norm="ortho")[1:] * s for (b, e), s in zip(data.stretches, scales, strict=True)]
        rows.append(np.concatenate([part._means[channel] @ means, *lines]))
    return np.array(rows)


@settings(max_examples=10, deadline=None)
@given(moved=st.lists(st.booleans(), min_size=9, max_size=9), seed=st.integers(0, 2**16))
def test_channels_whitened_together_come_out_as_each_stretch_alone(found: Fit, moved: list[bool], seed: int) -> None:
    part = found.parts[0]
    assert isinstance(part, Platter)
    raw = np.random.default_rng(seed).normal(size=part.data.observed.shape) * np.array(moved)[:, None]
    expected = plain(part, raw)
    got = part.whitened(raw).reshape(expected.shape)
    assert np.max(np.abs(got - expected)) <= 1e-11 * max(np.max(np.abs(expected)), 1.0)
    assert not got[~np.array(moved)].any()


@pytest.mark.parametrize(("name", "on"), CANDIDATES)
def test_a_score_is_the_decrease_that_all_rows_promise(found: Fit, name: str, on: str | None) -> None:
    (term,) = [t for t in search.possible(shelf(), found) if (t.effect.name, t.on) == (name, on)]
    (score,) = search.scores(found, [term])
    best = max(promised(found, term.moved(**start)) for start in term.effect.starts(found.parts[0].reference, term.on))
    assert score.gain == pytest.approx(best, rel=1e-6, abs=1e-6)


def promised(found: Fit, term: Term) -> float:
    """Decrease of χ² by least squares over every row, for a term that does nothing at this start."""
    part = found.parts[0]  # none of the candidates is noise
    local, terms = found.state.local(part, 0), found.state.terms
    model = np.zeros((part.rows, found.layout.size))
    for block in (one for one in found.blocks if one.rows[-1] < part.rows):
        model[np.ix_(block.rows, block.columns)] = block.matrix
    columns = fitting.term_columns(part, local, terms, term)
    inside, inverse = model.T @ columns, fitting.inverse(found.normal)
    outside = columns.T @ columns - inside.T @ inverse @ inside
    target = columns.T @ found.left[: part.rows] - inside.T @ inverse @ found.downhill
    return float(target @ np.linalg.solve(outside, target))


class Endless(Effect):
    """A term that has no value in any motion."""

    name = "endless"
    stage = "transducer"
    quantities = ("rate",)
    coordinates = (Coordinate("size", 1.0),)
    parameters = (Parameter("size", "1", (-1.0, 1.0), (0.1, 1.0)),)

    def felt(self, felt: Array, motion: Motion, channels: Channels, at: Values) -> Array:
        return np.full_like(felt, at["size"] * np.inf)


def test_a_term_without_a_value_in_these_records_gains_nothing_and_spoils_no_other(found: Fit) -> None:
    cubic = Term(shelf()["cubic"], "rate", {"coefficient": 0.0})
    with np.errstate(invalid="ignore"):
        made = search.scores(found, [Term(Endless(), "rate", {"size": 0.0}), cubic])
    assert {one.term.effect.name: one.gain for one in made}["endless"] == 0.0
    assert made[0].term.effect.name == "cubic"
    assert np.isfinite(made[0].gain)


def test_what_has_no_derivative_gets_no_share_of_an_inverse() -> None:
    normal = np.array([[4.0, np.nan, 1.0], [np.nan, np.nan, np.inf], [1.0, np.inf, 2.0]])
    found = fitting.inverse(normal)
    assert found[np.ix_([0, 2], [0, 2])] == pytest.approx(np.linalg.inv([[4.0, 1.0], [1.0, 2.0]]))
    assert not found[1].any()
    assert not found[:, 1].any()


def test_a_term_that_predicts_no_numbers_begins_no_pair(found: Fit) -> None:
    drift = Term(shelf()["warm_up"], "rate", {"shift": 1.0, "time_constant": -0.01})
    assert not _has_numbers(found, drift)
    assert _has_numbers(found, drift.moved(time_constant=300.0))
