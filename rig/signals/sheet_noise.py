"""Noise of sensors as their data sheets state it, and how far the bands of a spectrum move what they leave open.

A sheet states a white density N² before the output filter's pole, right to a tolerance, and flicker that is as strong
at a corner f_c somewhere between two frequencies:

    S(f) = N²·eᵃ·[W(f; p·eᵇ) + f_c·eᶜ/f · exp(−f/(f_e·eᵈ))] + rounding + what is added

with W the shape of sampled white noise behind one pole. a, b, c, d are what the sheet leaves open; d is how far up
flicker reaches, which no sheet states and which shows only where the white noise is no stronger. They are found from
bands, each with what is known of it beforehand, by as many Gauss–Newton steps for every model: what
is found is then a smooth function of what is added.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rig.signals.rest_spectrum import Bands

Array = NDArray[np.float64]
OPEN = 4  # what a sheet leaves open, of every channel: level, pole, corner, reach
POLE = 0.1  # standard uncertainties of logarithms: of a bandwidth
REACH, U_REACH = 100.0, 1.0  # Hz, to which flicker reaches, and of that
SHAPE = 0.01  # of a density: how well one pole and 1/f describe a sensor
STEPS, AGAIN = 12, 7  # of Gauss and Newton: from the sheet, and from there with what is added
LONGEST = 1.0  # of a step in a logarithm
SHOWN, CLEARLY = 25.0, 9.0  # χ² that a walk removes, and more than flicker would
GRID = np.geomspace(1e-3, 1e4, 57)  # Hz or Hz² of it, relative to the sheet's white density
COARSE = 6  # of its steps
LEAST = 0.02  # of the sheet's density: below it nothing can be taken away


@dataclass(frozen=True)
class Sheet:
    """What data sheets say of c channels, all (c,): `density` N² of the channel's unit squared per Hz, standard
    uncertainty `u_level` of its logarithm; `pole` Hz; `corner` Hz and `u_corner` of its logarithm; `rounding` unit²/Hz.
    """

    density: Array
    u_level: Array
    pole: Array
    corner: Array
    u_corner: Array
    rounding: Array

    @property
    def known(self) -> Array:
        """Standard uncertainties of what is open, (c, OPEN)."""
        whole = np.ones(len(self.density))
        return np.stack([self.u_level, POLE * whole, self.u_corner, U_REACH * whole], axis=1)

    def spectrum(self, f: Array, rate: float, at: Array) -> tuple[Array, Array]:
        """Density of every channel at `f` (b, k) where the open logarithms are `at` (c, OPEN), unit²/Hz (c, b, k), and
        its derivatives by them, (OPEN, c, b, k).
        """
        level, corner, reach = (_tall(np.exp(at[:, k]) * one) for k, one in
                                ((0, self.density), (2, self.corner), (3, np.full(len(at), REACH))))  # fmt: skip
        white, of_white = _white(f, _tall(self.pole * np.exp(at[:, 1])), rate)
        up = f / reach
        slow = level * corner / f * np.exp(-up)
        white, of_white = level * white, level * of_white
        derivatives = [white + slow, of_white, slow, slow * up]
        return white + slow + _tall(self.rounding), np.array(derivatives)


def _tall(values: Array) -> Array:
    return np.asarray(values[:, None, None])


def _white(f: Array, pole: Array, rate: float) -> tuple[Array, Array]:
    """Shape of sampled white noise behind one pole (a first-order autoregression), and its derivative by ln pole."""
    x = 2.0 * math.pi * pole / rate
    rho = np.exp(-x)
    distance = (1.0 - rho) ** 2 + 4.0 * rho * np.sin(math.pi * f / rate) ** 2
    shape = 0.5 * x * (1.0 - rho**2) / distance
    of_distance = 2.0 * x * rho * ((1.0 - rho) - 2.0 * np.sin(math.pi * f / rate) ** 2)
    relative = 1.0 + 2.0 * x * rho**2 / (1.0 - rho**2) - of_distance / distance
    return shape, shape * relative


@dataclass(frozen=True)
class Scatter:
    """Bands as normal deviates: cube roots of powers, whose scatter degrees of freedom `dof` tell, (b,).

    The cube root of a mean of squares is all but normal (Wilson and Hilferty 1931, PNAS 17, 684), and grows slowly
    enough for Gauss and Newton where a density is wrong by orders of magnitude.
    """

    power: Array
    dof: Array

    @classmethod
    def of(cls, found: Bands) -> Scatter:
        """With how well the shape of a density is known."""
        return cls(found.power, 2.0 / (2.0 / found.dof + SHAPE**2))

    @property
    def u(self) -> Array:
        """Relative standard deviation of a power, (b,)."""
        return np.sqrt(2.0 / self.dof)

    def deviates(self, density: Array) -> Array:
        """How far powers are above a density (c, b), in standard deviations."""
        known = 2.0 / (9.0 * self.dof)
        return np.asarray((np.cbrt(self.power / density) - (1.0 - known)) / np.sqrt(known))

    def slopes(self, density: Array) -> Array:
        """By how much a deviate falls with the logarithm of the density, (c, b)."""
        return np.asarray(np.cbrt(self.power / density) / 3.0 / np.sqrt(2.0 / (9.0 * self.dof)))


@dataclass(frozen=True)
class Levels:
    """Bands that tell what a sheet leaves open, of records at `rate` Hz."""

    sheet: Sheet
    rate: float
    found: Bands

    @cached_property
    def seen(self) -> Scatter:
        """The bands as deviates."""
        return Scatter.of(self.found)

    def start(self) -> Array:
        """What is open without anything added, (c, OPEN)."""
        nothing = np.zeros((len(self.sheet.density), *self.found.nodes.shape[:1]))
        at = np.zeros((len(self.sheet.density), OPEN))
        for _ in range(STEPS):
            at = self._step(at, nothing)
        return at

    def with_added(self, start: Array, added: Array) -> Array:
        """The same with mean densities added to the bands, (c, b) unit²/Hz."""
        at = start
        for _ in range(AGAIN if start.any() else STEPS):
            at = self._step(at, added)
        return at

    def walks(self, groups: NDArray[np.bool_], scale: Array) -> Array:
        """Random walk of every channel, unit²·Hz (c,): density q/f². None where records do not show it.

        Channels of a group (`groups` says which of two each is of) must show it together, and better than as much
        more flicker would explain: how noisy means are over minutes depends on it. One q for all of a group, times
        `scale` (c,), but for a channel that clearly has another: a single one tells it badly.
        """
        level = np.zeros(len(groups))
        if self.removed(2, GRID[::COARSE]).max(axis=0).sum() < 0.5 * SHOWN:
            return level
        walks, flickers = self.removed(2, GRID), self.removed(1, GRID)
        for group in (groups, ~groups):
            walk, flicker = (np.maximum(one.max(axis=0), 0.0)[group].sum() for one in (walks, flickers))
            if walk >= SHOWN and walk >= flicker + CLEARLY:
                level[group] = self._of_group(walks[:, group], scale[group], self.sheet.density[group])
        return level

    def _of_group(self, removed: Array, scale: Array, density: Array) -> Array:
        """Levels, unit²·Hz (g,), from what every level of the grid removes from every channel, (n, g)."""
        tried = np.geomspace((GRID[0] * density / scale).min(), (GRID[-1] * density / scale).max(), len(GRID))
        each = [np.interp(np.log(tried * s / d), np.log(GRID), one)
                for one, s, d in zip(removed.T, scale, density, strict=True)]  # fmt: skip
        common = int(np.sum(each, axis=0).argmax())
        own = removed.max(axis=0) - np.array(each)[:, common] > CLEARLY
        return np.asarray(np.where(own, GRID[removed.argmax(axis=0)] * density, tried[common] * scale))

    def removed(self, power: int, levels: Array, there: Array | float = 0.0) -> Array:
        """χ² that each of some levels of noise as a `power` of 1/f removes from every channel, (n, c).

        `levels` are relative to the sheet's white density; `there` is added already, (c, b) unit²/Hz.
        """
        start, shape = self.start(), (self.found.nodes**-power).mean(axis=-1)
        density = self.sheet.density
        bare = self._squares(start, np.zeros((len(density), len(shape))) + there)
        return np.array([bare - self._squares(start, np.outer(density * q, shape) + there) for q in levels])

    def _squares(self, start: Array, added: Array) -> Array:
        """χ² of every channel with what is open at its best, (c,)."""
        at = self.with_added(start, added)
        total = with_added(mean_density(self.sheet, self.rate, self.found, at), added)
        return np.asarray(np.sum(self.seen.deviates(total) ** 2, axis=1) + np.sum((at / self.sheet.known) ** 2, axis=1))

    def unsure(self, at: Array, added: Array, other: Bands, there: Array) -> Array:
        """How far deviates of other bands move by one standard deviation of what these leave open, (c, b, OPEN): the
        square of the matrix is their covariance. `added` to these and `there` to those, (c, b) unit²/Hz.
        """
        columns, _ = _slopes(self.sheet, self.rate, self.found, at, added)
        others, _ = _slopes(self.sheet, self.rate, other, at, there)
        root = np.linalg.cholesky(self._normal(columns))
        return np.asarray(np.swapaxes(np.linalg.solve(root, np.swapaxes(others, 1, 2)), 1, 2))

    def _normal(self, columns: Array) -> Array:
        """Normal matrix of what is open, with what is known of it beforehand, (c, OPEN, OPEN)."""
        weight = self.sheet.known**-2.0
        return np.asarray(np.einsum("cbi,cbj->cij", columns, columns) + weight[:, :, None] * np.eye(OPEN))

    def _step(self, at: Array, added: Array) -> Array:
        columns, left = _slopes(self.sheet, self.rate, self.found, at, added)
        downhill = np.einsum("cbi,cb->ci", columns, left) - self.sheet.known**-2.0 * at
        step = np.linalg.solve(self._normal(columns), downhill[..., None])[..., 0]
        return np.asarray(at + np.clip(step, -LONGEST, LONGEST))


def _slopes(sheet: Sheet, rate: float, found: Bands, at: Array, added: Array) -> tuple[Array, Array]:
    """By how much deviates of bands fall with what is open, (c, b, OPEN), and the deviates, (c, b)."""
    seen = Scatter.of(found)
    whole, slopes = sheet.spectrum(found.nodes, rate, at)
    total = with_added(whole.mean(axis=-1), added)
    return np.moveaxis(slopes.mean(axis=-1) / total * seen.slopes(total), 0, -1), seen.deviates(total)


def with_added(clean: Array, added: Array) -> Array:
    """A density with more of it, or less as far as there is any."""
    return np.maximum(clean + added, LEAST * clean)


def mean_density(sheet: Sheet, rate: float, found: Bands, at: Array) -> Array:
    """Mean density of the sheet's noise in every band, (c, b) unit²/Hz."""
    return np.asarray(sheet.spectrum(found.nodes, rate, at)[0].mean(axis=-1))
