"""What other methods make of the same data: sparse regression by STLSQ (pysindy), the lasso, and forward selection.

All get what the program's own search begins with: the whitened rows that the data-sheet model leaves, and the columns
of every effect of the shelf at its most promising start, both without what the model's own parameters can take up. So
they compete on the choice alone, in the place where linear methods are at home. They are told that the noise is white
with a variance of one; the program has no better knowledge.
"""

from __future__ import annotations

import importlib.util
import math
import statistics
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import blind_worlds as worlds
import numpy as np
from blind_scores import share
from blind_worlds import Answer, Case
from numpy.typing import NDArray

from rig.diagnose import search
from rig.fit import fit as fitting
from rig.fit.evidence import evidence_of
from rig.fit.fit import Fit
from rig.model import Term
from rig.shelf import shelf as shelf_of

Array = NDArray[np.float64]
SEEN = 1e-3  # of a column's norm outside the span of the model, as in the program
PATH = np.geomspace(0.9, 1e-4, 40)  # penalties and thresholds, against the smallest that leaves nothing
ROUNDS, SETTLED = 300, 1e-6
MOST = 4  # effects, as in the program


@dataclass(frozen=True)
class Problem:
    """Columns of unit norm (rows, k) with the effect each belongs to, and the rows left (rows,), in sigmas."""

    names: tuple[str, ...]
    columns: Array
    left: Array

    @property
    def gram(self) -> Array:
        return np.asarray(self.columns.T @ self.columns)

    @property
    def target(self) -> Array:
        return np.asarray(self.columns.T @ self.left)

    def ranked(self, coefficients: Array) -> list[str]:
        """Effects with a coefficient, that with the largest part of the signal first."""
        size: dict[str, float] = {}
        for name, one in zip(self.names, coefficients.tolist(), strict=True):
            if one:
                size[name] = math.hypot(size.get(name, 0.0), one)
        return sorted(size, key=lambda name: -size[name])

    def bic(self, kept: NDArray[np.bool_]) -> float:
        """χ² with these columns refitted, less that with none, plus ln(rows) for each."""
        if not kept.any():
            return 0.0
        found = np.linalg.pinv(self.gram[np.ix_(kept, kept)], rcond=1e-10, hermitian=True) @ self.target[kept]
        return float(-(self.target[kept] @ found) + math.log(len(self.left)) * np.count_nonzero(kept))


def problem_of(found: Fit) -> Problem:
    """The choice that the search faces after this fit."""
    scored = search.scores(found, search.possible(shelf_of(), found))
    names, columns = [], []
    for score in scored:
        for column in outside(found, columns_of(found, score.start)).T:
            size = float(np.linalg.norm(column))
            if size > 0.0:
                names.append(score.term.effect.name)
                columns.append(column / size)
    counted = np.concatenate([part.counted for part in found.parts])
    return Problem(tuple(names), np.array(columns).T[counted], found.left[counted])


def columns_of(found: Fit, term: Term) -> Array:
    """Whitened change of the rows by each coordinate at a start, or by the start itself where it is not nothing."""
    blocks = []
    for number, part in enumerate(found.parts):
        local = found.state.local(part, number)
        blocks.append(fitting.term_columns(part, local, found.state.terms, term))
    return np.concatenate(blocks)


def outside(found: Fit, columns: Array) -> Array:
    """What of columns the model's own parameters cannot take up; columns with nothing left are zero."""
    inside = np.zeros((len(found.normal), columns.shape[1]))
    for block in found.blocks:
        inside[block.columns] += block.matrix.T @ columns[block.rows]
    taken = found.covariance @ inside
    rest = columns.copy()
    for block in found.blocks:
        rest[block.rows] -= block.matrix @ taken[block.columns]
    whole = np.linalg.norm(columns, axis=0)
    seen = np.linalg.norm(rest, axis=0) > SEEN * np.maximum(whole, 1e-300)
    return np.asarray(rest * (seen & np.isfinite(whole)))


def pysindy_there() -> bool:
    """Whether pysindy is installed."""
    return importlib.util.find_spec("pysindy") is not None


def stlsq(problem: Problem) -> list[str]:
    """Sequentially thresholded least squares of pysindy (Brunton 2016), the threshold by BIC.

    The rows are compressed by QR first, which changes no least-squares fit.
    """
    from pysindy.optimizers import STLSQ  # type: ignore[import-not-found,unused-ignore]

    q, r = np.linalg.qr(problem.columns)
    y = q.T @ problem.left
    largest = float(np.max(np.abs(problem.target), initial=0.0))
    best, least = np.zeros(len(problem.names)), 0.0
    for threshold in (largest * PATH).tolist():
        chosen = STLSQ(threshold=threshold, alpha=1e-6, max_iter=50, unbias=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # nothing above the threshold is an answer too
            found = np.asarray(chosen.fit(r, y[:, None]).coef_, np.float64).ravel()
        if (price := problem.bic(found != 0.0)) < least:
            best, least = found, price
    return problem.ranked(best)


def lasso(problem: Problem) -> list[str]:
    """Tibshirani's lasso (1996) by coordinate descent along a path of penalties, the penalty by BIC of the support."""
    gram, target = problem.gram, problem.target
    found = np.zeros(len(target))
    best, least = found, 0.0
    for penalty in (float(np.max(np.abs(target), initial=0.0)) * PATH).tolist():
        found = _descended(gram, target, found, penalty)
        if np.count_nonzero(found) > len(target) // 2:
            break
        if (price := problem.bic(found != 0.0)) < least:
            best, least = found.copy(), price
    return problem.ranked(best)


def _descended(gram: Array, target: Array, start: Array, penalty: float) -> Array:
    found = start.copy()
    for _ in range(ROUNDS):
        moved = 0.0
        for k in range(len(found)):
            pull = float(target[k] - gram[k] @ found + found[k])
            new = math.copysign(max(abs(pull) - penalty, 0.0), pull)
            moved, found[k] = max(moved, abs(new - found[k])), new
        if moved < SETTLED * penalty:
            break
    return found


def forward(problem: Problem) -> list[str]:
    """Forward selection of whole effects by BIC (Schwarz 1978)."""
    names = np.array(problem.names)
    kept, chosen, price = np.zeros(len(names), np.bool_), list[str](), 0.0
    while len(chosen) < MOST:
        left = [name for name in dict.fromkeys(problem.names) if name not in chosen]
        prices = {name: problem.bic(kept | (names == name)) for name in left}
        best = min(prices, key=lambda name: prices[name], default="")
        if not best or prices[best] >= price:
            break
        kept, price = kept | (names == best), prices[best]
        chosen.append(best)
    return chosen


METHODS: Mapping[str, Callable[[Problem], list[str]]] = {
    "pysindy STLSQ": stlsq, "lasso": lasso, "BIC forward selection": forward,
}  # fmt: skip


def compared(case: Case, folder: Path) -> None:
    """Have every method look at a world that the study knows, and write what it names."""
    answer, _ = worlds.unsealed(folder / "answers" / f"{case.id}.json")
    records = worlds.measured(worlds.world_of(answer), case.bench)
    problem = problem_of(evidence_of([records]).fitted())
    said = {method: named(problem) for method, named in METHODS.items()}
    worlds.write(folder / "peers" / f"{case.id}.json", said)


def table(pairs: Sequence[tuple[Answer, Mapping[str, Sequence[str]], Mapping[str, Any]]]) -> list[tuple[str, ...]]:
    """Head and rows: of every method the same scores as of the program, on the same worlds."""
    head = ("method", "exactly the hidden effect", "hidden effect named first", "effects named", "clean: one named")
    said = {"rig": [(answer, list(result["named"])) for answer, _, result in pairs]}
    for method in METHODS:
        said[method] = [(answer, list(names[method])) for answer, names, _ in pairs]
    rows: list[tuple[str, ...]] = [head]
    for method, all_ in said.items():
        hidden = [(answer.names, names) for answer, names in all_ if answer.hidden]
        clean = [names for answer, names in all_ if not answer.hidden]
        exact = share(sum(sorted(names) == sorted(truth) for truth, names in hidden), len(hidden))
        first = share(sum(names[:1] == list(truth) for truth, names in hidden), len(hidden))
        many = f"{statistics.fmean(len(names) for _, names in hidden):.1f}" if hidden else "no worlds"
        rows.append((method, exact, first, many, share(sum(map(bool, clean)), len(clean))))
    return rows
