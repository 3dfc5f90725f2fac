"""A full cross-axis matrix: named, of its true size, and only as far as the record moves the axes concerned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import fast_bench
import numpy as np
import pytest
from imported_worlds import Array, Unit, evidence, motion

from rig.diagnose.conclusion import conclude
from rig.diagnose.diagnose import Choice, _behind, diagnose
from rig.fit import adequacy
from rig.fit.evidence import Evidence, evidence_of
from rig.fit.fit import unseen_of
from rig.model import Term
from rig.shelf import effect_of, nothing_of, shelf

SHARES = {"xy": 0.012, "xz": -0.02, "yx": 0.03, "yz": 0.008, "zx": -0.015, "zy": 0.022}
NOT_SEEN = "not seen in this data"


@dataclass(frozen=True)
class Mixed(Unit):
    """A device whose accelerometers feel the other axes: (3, 3) shares, row by row."""

    shares: tuple[tuple[float, ...], ...] = ((0.0, 0.0, 0.0),) * 3

    def shown(self, t: Array, rate: Callable[[Array], Array], force: Callable[[Array], Array], seed: int) -> Array:
        matrix = np.eye(3) + np.array(self.shares)
        return super().shown(t, rate, lambda at: matrix @ force(at), seed)


def thrown(**shares: float) -> Evidence:
    rows = tuple(tuple(shares.get(i + j, 0.0) for j in "xyz") for i in "xyz")
    return evidence(motion(Mixed(shares=rows), 3, seconds=30.0, rows=100.0))


def hidden(**parameters: Any) -> list[dict[str, Any]]:
    return [{"name": "cross_axis_matrix", "parameters": {"share": 1.0, **dict.fromkeys(SHARES, 0.0), **parameters}}]


def test_free_motion_tells_all_six_shares() -> None:
    found = diagnose(thrown(**SHARES))
    assert (found.verdict, found.named) == ("missing", ("cross_axis_matrix",))
    (step,) = found.steps
    assert step.taken.term.on == "acceleration"
    for name, true in SHARES.items():
        assert abs(step.taken.term.at[name] - true) < 4.0 * step.taken.u[name]
        assert 0.0 < step.taken.u[name] < 0.1 * abs(true)


def test_one_share_alike_on_all_axes_is_no_matrix() -> None:
    found = diagnose(thrown(xy=0.02, yz=0.02, zx=0.02))
    assert (found.verdict, found.named) == ("missing", ("cross_axis",))
    assert found.steps[0].taken.probability > 0.9


def test_what_contains_the_best_is_of_its_class_only_if_its_further_numbers_are_worth_it() -> None:
    best, wider, other = (
        Choice(nothing_of(effect_of(name), "rate"), {}, gain, merit, 0.5, "")
        for name, gain, merit in (
            ("cross_axis", 500.0, 484.0),
            ("cross_axis_matrix", 502.0, 461.0),
            ("non_orthogonality", 500.0, 474.0),
        )
    )
    assert _behind(wider, best) == 23.0  # it removes as much whatever is true
    assert _behind(best, wider) < 0.0
    assert _behind(other, best) == 0.0
    assert _behind(replace(wider, term=replace(wider.term, on="acceleration")), best) == -2.0


def test_a_sweep_along_x_says_the_shares_of_x_and_that_it_shows_no_others() -> None:
    world = fast_bench.world(8, hidden(**SHARES))
    document = {"procedure": "frequency_sweep", "axis": "x", "points": 5}
    found = conclude(evidence_of([fast_bench.measure(document, world)]), [], shelf())
    (one,) = (one for one in found.candidates if one.taken)
    assert one.effect == "cross_axis_matrix"
    for name, parameter in one.parameters.items():
        assert parameter.u is not None
        if name in ("yx", "zx"):
            assert abs(parameter.value - SHARES[name]) < 4.0 * parameter.u
        else:  # gravity along one of them is a part of the zero output
            assert parameter.text == NOT_SEEN
    said = [
        line for line in found.cannot_see if line.startswith("cross_axis_matrix (acceleration): nothing here shows")
    ]
    assert len(said) == 1
    assert said[0].partition("shows ")[2].startswith("xy, xz, yz, zy by itself;")


def test_poses_against_gravity_show_the_sum_of_two_shares_and_no_more() -> None:
    world = fast_bench.world(3, hidden(xy=0.004, yx=0.006))
    made = evidence_of([fast_bench.measure({"procedure": "tumble", "poses": 24, "record": "2 s"}, world)])
    fit = made.fitted([nothing_of(effect_of("cross_axis_matrix"), "acceleration")])
    assert adequacy.adequate(fit)
    (number,) = (n for n, term in enumerate(fit.state.terms) if term.effect.name == "cross_axis_matrix")
    at, u = fit.state.terms[number].at, fit.u(number)
    assert abs(at["xy"] - 0.010) < 4.0 * u["xy"] < 0.002
    for name in ("yx", "zx", "zy"):
        assert (at[name], u[name]) == (0.0, 0.0)


@pytest.mark.parametrize(("copy", "unseen"), [(0.0, [False] * 6), (1.0, [False] * 5 + [True])])
def test_a_column_that_those_before_it_make_up_shows_nothing(copy: float, unseen: list[bool]) -> None:
    columns = np.random.default_rng(1).normal(size=(40, 6))
    columns[:, 5] = copy * (columns[:, 0] - 2.0 * columns[:, 3]) + (1.0 - copy) * columns[:, 5]
    products = 1e6 * columns.T @ columns
    term = Term(effect_of("cross_axis_matrix"), "rate", dict.fromkeys(SHARES, 0.0))
    assert unseen_of(term, products, np.diag(products)).tolist() == unseen
    assert unseen_of(replace(term), products, 1e7 * np.diag(products)).all() is np.False_  # a step of it is told
