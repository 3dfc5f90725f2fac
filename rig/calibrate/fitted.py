"""What the fitted model says of every channel, each experiment against its own reference, with a budget.

The model is fitted to the parts of one experiment (all sweeps, all turntable runs) with sensitivities free: a data
sheet says where the fit begins and not what is likely. The estimate errs by

    Δθ = N⁻¹(Jᵀ ε + Σ_k e_k w_k Δp_k),     N = JᵀJ + diag(w)

with whitened noise ε and what is wrong with each prior value p_k (weight w_k = u_k⁻²), so that its covariance falls
apart into the noise's share N⁻¹JᵀJN⁻¹ and one line N⁻¹e_k·w_k·u_k for every prior (JCGM 100 5.2).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from rig.fit import adequacy
from rig.fit.evidence import Evidence
from rig.fit.fit import NEGLIGIBLE, Fit, begin, fit, fitted, prior_of
from rig.model import Shares, Term
from rig.motion import Array
from rig.parts.part import Part
from rig.parts.remainder import Indices

KNOWN = 0.25  # relative: a sensitivity that noise leaves less certain is not determined
NEARBY = 1e-6  # of an angle or a share, over which a derivative is taken
WHOLE = 1.0 - 1e-6  # share of a parameter that the data must see


@dataclass(frozen=True)
class Assumed:
    """The model that a calibration stands on: effects beside the data sheet's, and where they were written down.

    `poles`: channels have output filters. `shared`: all of a quantity have one sensitivity. `name` is the model's file
    and `digest` its SHA-256, "" for the plain data sheet.
    """

    terms: tuple[Term, ...] = ()
    poles: bool = True
    shared: bool = False
    name: str = ""
    digest: str = ""

    @property
    def words(self) -> str:
        """`data sheet`, or with what it has beside that or lacks of it."""
        lacks = "" if self.poles else " without output filters"
        alike = ", one sensitivity for all axes" if self.shared else ""
        return " + ".join([f"data sheet{lacks}{alike}", *(term.key for term in self.terms)])

    @property
    def said(self) -> str:
        """The same with its file and the file's SHA-256, if it has one."""
        return f"{self.words} ({self.name}, SHA-256 {self.digest})" if self.name else self.words


FEWEST = 4  # rows whose ratio widens an uncertainty


@dataclass(frozen=True)
class Pull:
    """What one prior does to an estimate: name of the effect (or parameter), standard uncertainty, ∂estimate/∂prior."""

    name: str
    u: float
    coefficient: float


@dataclass(frozen=True)
class Estimate:
    """A value in SI; `u_noise` its standard uncertainty from noise alone; the priors' share line by line.

    `influence` is ∂value/∂(whitened row), (rows,).
    """

    value: float
    u_noise: float
    pulls: tuple[Pull, ...]
    influence: Array = field(repr=False)

    @property
    def u(self) -> float:
        """Standard uncertainty from noise and priors."""
        return math.hypot(self.u_noise, *(one.coefficient * one.u for one in self.pulls))

    @property
    def turned(self) -> Estimate:
        """The same with the other sign."""
        pulls = tuple(replace(one, coefficient=-one.coefficient) for one in self.pulls)
        return replace(self, value=-self.value, pulls=pulls, influence=-self.influence)


@dataclass(frozen=True)
class Experiment:
    """The model fitted to all parts of one experiment."""

    name: str
    fit: Fit

    @cached_property
    def worst(self) -> adequacy.Group | None:
        """The group of rows that the model misses most, if it misses any."""
        return next(iter(adequacy.standing(adequacy.groups(self.fit))), None)

    @cached_property
    def missed(self) -> tuple[adequacy.Group, ...]:
        """Groups of rows that the model misses, of rows enough for their ratio to say by how much."""
        standing = tuple(one for one in adequacy.standing(adequacy.groups(self.fit)) if one.count >= FEWEST)
        return (*standing, *adequacy.unsteady(self.fit))

    @cached_property
    def _weights(self) -> Array:
        return prior_of(self.fit.parts, self.fit.state)[1]

    @cached_property
    def _covariance(self) -> Array:
        return self.fit.covariance

    @cached_property
    def _seen(self) -> Array:
        """Share of every parameter that the data and priors see, (parameters,)."""
        size = np.sqrt(np.diag(self.fit.normal))
        there = size > 0.0
        scale = np.where(there, size, 1.0)
        values, vectors = np.linalg.eigh(self.fit.normal / np.outer(scale, scale))
        kept = values > NEGLIGIBLE * values[-1]
        return np.asarray(np.sum(vectors[:, kept] ** 2, axis=1) * there)

    def sensitivity(self, channel: str) -> Estimate | None:
        """V per SI unit; None if the parts do not determine it."""
        return self._scaled(channel, 0)

    def bandwidth(self, channel: str) -> Estimate | None:
        """Corner of the output filter, Hz; None if the model has none or the parts say no more than the data sheet."""
        if not self.fit.state.poles:
            return None
        return self._scaled(channel, 1)

    def offset(self, channel: str, parts: Sequence[int]) -> Estimate | None:
        """Zero output, V: generalised mean over some parts; None if none of them determines it."""
        there = [n for n in parts if channel in self.fit.parts[n].channels.names]
        there = [n for n in there if self._seen[self._own(n, channel)[2]] > WHOLE]
        rows = [int(self._own(n, channel)[2]) for n in there]
        if not rows:
            return None
        covariance = self._covariance[np.ix_(rows, rows)]
        weights = np.linalg.pinv(covariance, hermitian=True).sum(axis=0)
        weights = weights / weights.sum()
        values = [float(self.fit.state.zero[n][self.fit.parts[n].channels.names.index(channel)])
                  for n in there]  # fmt: skip
        direction = np.zeros(self.fit.layout.size)
        direction[rows] = weights
        return self._along(float(weights @ np.array(values)), direction)

    def _own(self, number: int, channel: str) -> Indices:
        part = self.fit.parts[number]
        return np.asarray(self.fit.layout.own(part, number)[part.channels.names.index(channel)])

    def own_axis(self, channel: str) -> Estimate | None:
        """V per SI unit of what acts along the channel's own axis, where the model says how the axes of a triad stand.

        The model's sensitivity is of one part of that: its axes are not unit vectors.
        """
        found, number = self._parameter(channel, 0), self._number(channel)
        if found is None or number is None:
            return None
        value, direction = found
        part = self.fit.parts[number]
        axis = int(part.channels.axis[part.channels.names.index(channel)])
        terms = self.fit.state.terms
        size = _length(terms, channel, axis)
        for n, (first, term) in enumerate(zip(self.fit.layout.terms, terms, strict=True)):
            for k, name in enumerate(fitted(term) if _mixes(term) else ()):
                moved = [term.moved(**{name: term.at[name] + sign * NEARBY}) for sign in (1.0, -1.0)]
                longer, shorter = (_length([*terms[:n], one, *terms[n + 1 :]], channel, axis) for one in moved)
                direction[first + k] = value * (longer - shorter) / (2.0 * NEARBY)
        direction[self._own(number, channel)[0]] *= size
        return self._known(self._along(value * size, direction))

    def _number(self, channel: str) -> int | None:
        """The first part that has it."""
        return next((n for n, p in enumerate(self.fit.parts) if channel in p.channels.names), None)

    def _scaled(self, channel: str, which: int) -> Estimate | None:
        found = self._parameter(channel, which)
        return None if found is None else self._known(self._along(*found))

    def _known(self, found: Estimate) -> Estimate | None:
        return found if 0.0 < found.u_noise < KNOWN * abs(found.value) else None

    def _parameter(self, channel: str, which: int) -> tuple[float, Array] | None:
        """Sensitivity or corner (`which` 0 or 1), and its derivatives by all parameters; None if nothing tells it."""
        number = self._number(channel)
        if number is None:
            return None
        part, row = self.fit.parts[number], int(self._own(number, channel)[which])
        c, local = part.channels.names.index(channel), self.fit.state.local(part, number)
        nominal = float(part.channels.sensitivity[c])
        value, slope = ((float(local.sensitivity[c]), nominal), (float(local.pole[c]), float(local.pole[c])))[which]
        if not math.isfinite(value) or self._seen[row] <= WHOLE:
            return None
        direction = np.zeros(self.fit.layout.size)
        direction[row] = slope
        return value, direction

    def _along(self, value: float, direction: Array) -> Estimate:
        """A combination of the parameters."""
        moved = self._covariance @ direction
        influence = np.zeros(len(self.fit.left))
        for block in self.fit.blocks:
            influence[block.rows] += block.matrix @ moved[block.columns]
        return Estimate(value, float(np.linalg.norm(influence)), tuple(self._pulls(moved)), influence)

    def _pulls(self, moved: Array) -> Iterator[Pull]:
        """Every prior with a share, those of the poles together."""
        weights, order = self._weights, self.fit.layout
        poles = np.arange(len(order.channels)) * 2 + 1
        if (share := float(np.sqrt(np.sum(moved[poles] ** 2 * weights[poles])))) > 0.0:
            yield Pull("output_filter", float(weights[poles].max() ** -0.5), share * float(weights[poles].max() ** 0.5))
        for first, term in zip(order.terms, self.fit.state.terms, strict=True):
            for k, name in enumerate(fitted(term)):
                if (weight := float(weights[first + k])) > 0.0:
                    several = len(fitted(term)) > 1
                    label = f"{term.effect.name} {name}" if several else term.effect.name
                    yield Pull(label, weight**-0.5, float(moved[first + k]) * weight)
        for number, first in enumerate(order.nuisances):
            extra = moved[first : first + self.fit.parts[number].extra.shape[1]]
            if len(extra) and (share := float(np.linalg.norm(extra))) > 0.0:
                part = self.fit.parts[number]
                yield Pull(f"{part.extra_title} of {part.name}", 1.0, share)

    def rows_of(self, number: int) -> slice:
        """Rows of a part."""
        offsets = self.fit.offsets()
        return slice(offsets[number], offsets[number + 1])


def experiments(evidence: Evidence, assumed: Assumed) -> dict[str, Experiment]:
    """The model fitted to each experiment of the evidence alone, by the experiment's name."""
    found = {}
    every = [part for part in evidence.parts if part.calibrates]
    for name in dict.fromkeys(part.experiment for part in every):
        parts = tuple(part for part in every if part.experiment == name)
        terms = [term for term in (*evidence.nuisances, *assumed.terms) if name in term.effect.places]
        start = begin(parts, terms, poles=assumed.poles, shared=assumed.shared, free=True)
        found[name] = Experiment(name, fit(parts, start))
    return found


def alone(part: Part, assumed: Assumed) -> tuple[Experiment, Assumed]:
    """The model fitted to one part alone, with what no data sheet states of it; and the model with that."""
    known = {term.effect.name for term in assumed.terms}
    assumed = replace(assumed, terms=(*assumed.terms, *(t for t in part.unstated() if t.effect.name not in known)))
    terms = [term for term in assumed.terms if part.acts(term.effect)]
    start = begin((part,), terms, poles=assumed.poles, shared=assumed.shared, free=True)
    return Experiment(part.experiment, fit((part,), start)), assumed


def _mixes(term: Term) -> bool:
    """Whether it gives accelerometers shares of other axes."""
    return term.on == "acceleration" and isinstance(term.effect.inverse(term.at), Shares)


def _length(terms: Sequence[Term], channel: str, axis: int) -> float:
    """How much more a channel shows of what acts along its own axis than of its part along the case's."""
    row = np.eye(3)
    for term in terms:
        shares = term.effect.inverse(term.at)
        if term.on == "acceleration" and isinstance(shares, Shares) and (not term.only or channel in term.only):
            row = (np.eye(3) + shares.own) @ row
    return float(np.linalg.norm(row[axis]))
