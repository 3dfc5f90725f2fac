"""Poses against gravity, and turns by known angles, as a model sees them: one number for every pose or turn.

Of a triad of accelerometers at rest only the magnitude of what it feels is known: local gravity g, along a direction
that nobody measured. Each pose therefore tells one number. What was felt is found from the three outputs by Newton's
method for every model anew, and the row is g·ln(|f|/g), which is |f| − g where they are close, in standard deviations.
That is what is left over, to first order in the noise, once the direction is chosen that fits best (variable
projection; Golub and Pereyra 1973). Unlike that it stays straight where a model is wrong by far more than the noise;
and as logarithms, rows move alike with a common sensitivity and with gravity, so that neither can pay for other faults.
Gyros feel nothing at rest (Earth's rate is left in their zeros) and the mean rate of a turn by a known angle.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from rig.errors import BadInput
from rig.model import Local, Term, volts
from rig.motion import Array, Grid, Motion, Response
from rig.parts.conditions import filled, logged
from rig.parts.part import STEP, Origin, Part
from rig.parts.pose_records import PoseRecords
from rig.parts.remainder import Cut, Indices, Mask
from rig.parts.whitening import Whitening
from rig.shelf import effect_of, nothing_of
from rig.signals.noise import NoiseModel

GRAVITY = "gravity"
TILT = math.radians(2.0)  # how well the axis of a turn is along that of the case, standard uncertainty of each angle
SETTLED = 1e-9  # m/s²: what was felt is found if it moves by less
STEPS_TRIED = 12  # between poses at which a step is tried
STEPS = 12
NEARBY = 1e-3  # m/s², over which a derivative of the outputs is taken
UPRIGHT = 0.8  # cosine, above which an axis counts as the upright one
PARAMETERS = 9  # of a triad: three sensitivities, three zeros, three angles between its axes
KNOWING = 0.8  # degrees of freedom, for every second of a pose, that tell how noisy its mean is (80 clean tumbles)
ALLOWANCE = 0.06


@dataclass(frozen=True)
class Still(Grid):
    """Instants that have nothing to do with each other, at each of which everything is constant."""

    def taken(self, signal: Array) -> Array:
        return signal

    def passed(self, taken: NDArray[np.inexact], response: Response) -> Array:
        """A constant signal passes with the response at zero frequency."""
        return np.asarray(taken * response(np.zeros(1))[..., :1].real)

    def leaked(self, observed: NDArray[np.inexact], corner: float) -> Array:
        """Nothing: it has been constant for ever."""
        return np.zeros(observed.shape)

    def plain(self, signal: Array) -> Array:
        return signal

    def each(self, values: Array) -> Array:
        return values

    def rise(self, signal: Array) -> Array:
        return np.zeros_like(signal)


@dataclass(frozen=True)
class Felt:
    """What a model says was felt: force m/s² (3, n), and the outputs (c, n) V that it makes of that."""

    force: Array
    volts: Array


class Poses(Part):
    """Poses and turns as a part of a fit. One nuisance: local gravity, within its uncertainty.

    Raises BadInput for accelerometers that are no triad of x, y and z.
    """

    experiment = "poses"
    drawing = "poses"
    extra_title = "local gravity"

    def __init__(self, data: PoseRecords) -> None:
        self.data, self.grid = data, Still()
        self.logged = logged(temperature=data.temperature, supply=data.supply)
        self._triad, self._gyros = _triad(data), data.channels.of("rate")
        names = (*((GRAVITY,) if len(self._triad) else ()), *(data.channels.names[c] for c in self._gyros))
        rates = np.array([name != GRAVITY for name in names])
        super().__init__(data.name, data.run, data.channels, data.observed.shape[1], row_names=names, row_rates=rates,
                         notes=data.notes)  # fmt: skip
        self._turned = np.any(data.turn != 0.0, axis=0)
        self._start = _unit(self._first(data.channels.sensitivity, self.zeros))
        self.blind = tuple(_blind(data, _different(self._start[:, ~self._turned]) if len(self._triad) else 0))
        self.extra = self._of_gravity()

    def _walking(self, levels: Sequence[float]) -> Self:
        begin, end = self.spans()
        more = [NoiseModel(1.0, 0.0, random_walk=q).covariance(begin, end) for q in levels]
        return type(self)(replace(self.data, covariance=self._covariance + np.array(more)))

    @property
    def zeros(self) -> Array:
        return super().zeros if self.data.zero is None else self.data.zero

    @property
    def stated(self) -> Array:
        """Numbers are the file's own: its sensitivities are what is stated, with their sign."""
        return self.channels.sensitivity

    def unstated(self) -> Iterator[Term]:
        """The angles between the axes, where there are attitudes enough to tell them."""
        if len(self._triad) and _different(self._start[:, ~self._turned]) >= PARAMETERS:
            yield nothing_of(effect_of("non_orthogonality"), "acceleration")

    @property
    def observed(self) -> Array:
        return self._table(np.zeros(self.width), self.data.observed)

    @cached_property
    def reference(self) -> Motion:
        """Known magnitude, along the direction that the data sheet's sensitivities show; the turns as stated."""
        return self._motion(self.data.gravity * self._start)

    def _motion(self, force: Array) -> Motion:
        """The motion with this force, m/s², (3, n)."""
        data = self.data
        rate = data.turn / data.seconds
        return Motion(
            grid=self.grid, place=self.experiment, force=force, rate=rate, turning=np.zeros_like(rate), up=_unit(force),
            gravity=data.gravity, temperature=filled("temperature", data.temperature),
            supply=filled("supply", data.supply),
            elapsed=data.time - (float(data.time.min()) if data.since is None else data.since),
        )  # fmt: skip

    def _first(self, sensitivity: Array, zero: Array) -> Array:
        """What the triad shows by sensitivities and zeros alone, m/s², (3, n); where it shows nothing, gravity along
        what is stated to be up, else along z."""
        usual = np.repeat(self.data.gravity * np.eye(3)[:, 2:], self.width, axis=1)
        if self.data.up is not None:
            usual = np.where(np.isfinite(self.data.up), self.data.gravity * self.data.up, usual)
        if not len(self._triad):
            return usual
        shown = ((self.data.observed - zero[:, None]) / sensitivity[:, None])[self._triad]
        return np.asarray(np.where(np.isfinite(shown).all(axis=0) & shown.any(axis=0), shown, usual))

    @cached_property
    def counted(self) -> Mask:
        """Gravity in poses, gyros in poses and turns, where there is an observation, (rows,)."""
        there = np.isfinite(self.data.observed) & (self._variance > 0.0)
        poses = [there[self._triad].all(axis=0) & ~self._turned] if len(self._triad) else []
        return np.concatenate([*poses, *there[self._gyros]])

    @cached_property
    def _variance(self) -> Array:
        """Noise, and in turns what is not known of angle and axis, V², (c, n)."""
        return np.asarray(self.data.variance + self._of_turns)

    @cached_property
    def _of_turns(self) -> Array:
        """What is not known of angle and axis of a turn, V², (c, n)."""
        data = self.data
        angle = np.linalg.norm(data.turn, axis=0)
        along = np.abs(data.turn) / np.where(angle > 0.0, angle, 1.0)
        own = data.u_turn**2 + (0.5 * TILT**2 * angle) ** 2
        square = np.where(self._turned, along**2 * own + (1.0 - along**2) * (TILT * angle) ** 2, 0.0) / data.seconds**2
        slope = self.channels.sensitivity * self.channels.rates
        return np.asarray(slope[:, None] ** 2 * square[self.channels.axis])

    @property
    def _covariance(self) -> Array:
        """Of the means' noise, V², (c, n, n)."""
        if self.data.covariance is None:
            return np.stack([np.diag(one) for one in self.data.variance])
        return self.data.covariance

    @cached_property
    def _whitening(self) -> Whitening:
        """What makes rows of the table of predictions: means of one channel wander together."""
        whole = self._covariance
        covariances = [whole[c] + np.diag(self._of_turns[c]) for c in self._gyros]
        if len(self._triad):
            slope = self._start / self.channels.sensitivity[self._triad][:, None]
            covariances.insert(0, np.einsum("ki,kij,kj->ij", slope, whole[self._triad], slope))
        return Whitening.of(covariances, self.counted.reshape(-1, self.width), self.data.held)

    def _volts(self, force: Array, local: Local, terms: Sequence[Term]) -> Array:
        return np.asarray(volts(self._motion(force), self.channels, local, terms), np.float64)

    def _felt(self, local: Local, terms: Sequence[Term]) -> Felt:
        """What a model says was felt, in all poses at once (Newton's method)."""
        force = self._first(local.sensitivity, local.zero)
        made = self._volts(force, local, terms)
        if not len(self._triad):
            return Felt(force, made)
        for _ in range(STEPS):
            near = [self._volts(force + NEARBY * one[:, None], local, terms) for one in np.eye(3)]
            inverse = _inverse([(one - made)[self._triad] / NEARBY for one in near])
            step = np.einsum("kan,an->kn", inverse, np.nan_to_num((self.data.observed - made)[self._triad]))
            force = force + step
            made = self._volts(force, local, terms)
            if not np.abs(step[:, self.counted[: self.width]]).max(initial=0.0) > SETTLED:
                break
        return Felt(force, made)

    def _table(self, gravity: Array, outputs: Array) -> Array:
        """The row of magnitudes (n,) above the outputs of the gyros among (c, n)."""
        first = gravity[None] if len(self._triad) else np.zeros((0, self.width))
        return np.concatenate([first, np.nan_to_num(outputs[self._gyros])])

    def raw(self, local: Local, terms: Sequence[Term], only: NDArray[np.intp] | None = None) -> Array:
        """Gravity above what was felt, as a logarithm, m/s², then the gyros' outputs, V, (names, n); always all."""
        found, g = self._felt(local, self.here(terms)), self.data.gravity
        return self._table(g * np.log(g / np.linalg.norm(found.force, axis=0)), found.volts)

    def whitened(self, raw: NDArray[np.inexact]) -> Array:
        table = np.where(self.counted.reshape(raw.shape), raw, 0.0)
        return np.asarray(self._whitening.whitened(np.asarray(table, np.float64)).reshape(-1))

    def residual(self, left: Array) -> Array:
        """What is left over, (rows,), as its table: g's logarithm, m/s², and the gyros' outputs, V, (names, n)."""
        return self._whitening.coloured(left.reshape(len(self.row_names), -1))

    def errors(self, left: Array) -> Array:
        table = np.where(self.counted, self.residual(left).reshape(-1), 0.0).reshape(len(self.row_names), -1)
        return np.asarray(np.sum((table / self._volts_each[:, None]) ** 2, axis=1))

    def in_deviations(self, row: int, shape: Array) -> Array:
        table = np.zeros((len(self.row_names), self.width))
        table[row] = shape * self._volts_each[row]
        return np.asarray(self.whitened(table).reshape(table.shape)[row])

    @cached_property
    def _volts_each(self) -> Array:
        """What a row of the table shows of one SI unit, (names,): gravity itself, volts of the gyros."""
        return np.array([*([1.0] if len(self._triad) else []), *self.channels.sensitivity[self._gyros]])

    def noise_like(self, row: int, random: np.random.Generator, count: int) -> Array:
        """Noise of the means, V, (count, 3, n), x, y and z: what is told of an accelerometer is of the whole triad."""
        drawn = random.standard_normal((len(self._triad), count, self.width))
        factors = np.linalg.cholesky(self._covariance[self._triad])
        return np.asarray(np.einsum("cij,cki->kcj", factors.transpose(0, 2, 1), drawn))

    def felt(self, row: int, drawn: Array, influence: Array) -> Array:
        """What an estimate with this influence (rows,) makes of such noise, to first order, (count,)."""
        slope = self._start / self.channels.sensitivity[self._triad][:, None]
        per_row = influence.reshape(len(self.row_names), -1)[0] @ self._whitening.inverse[0]
        return np.asarray(np.einsum("kcj,cj,j->k", drawn, slope, per_row))

    def spans(self) -> tuple[Array, Array]:
        """Begin and end of every mean, bench clock, s, (n,)."""
        half = 0.5 * self.data.seconds
        return self.data.time - half, self.data.time + half

    def apart(self, term: Term) -> Indices | None:
        """None: a magnitude belongs to three channels."""
        return None

    def own_columns(self, local: Local, terms: Sequence[Term], raw: NDArray[np.inexact]) -> list[Array]:
        """Derivatives of the rows by relative gain, log pole and zero output of every channel, three of (rows, c)."""
        apart = np.eye(len(self.channels.names))
        gains = [
            replace(local, sensitivity=local.sensitivity + STEP * self.channels.sensitivity * one) for one in apart
        ]
        width = STEP * np.abs(self.channels.sensitivity) * self.data.gravity  # a zero in V may be large or small
        zeros = [replace(local, zero=local.zero + width * one) for one in apart]
        gain = np.stack([self.whitened(self.raw(one, terms) - raw) for one in gains], axis=1) / STEP
        zero = np.stack([self.whitened(self.raw(one, terms) - raw) for one in zeros], axis=1) / width
        return [gain, np.zeros_like(gain), zero]

    def changes(self) -> Iterator[tuple[str, str, Array]]:
        """What a step or a trend of a sensitivity or a zero of the triad does to gravity in the course of the poses."""
        if not len(self._triad):
            return
        pole = np.full(len(self.channels.names), math.inf)
        local = Local(self.channels.sensitivity, pole, self.zeros)
        order = np.argsort(np.argsort(self.data.time, kind="stable"), kind="stable") / max(self.width - 1, 1)
        laws = [*((order > at).astype(np.float64) for at in np.linspace(0.0, 1.0, STEPS_TRIED + 2)[1:-1]), order]
        raw = self.raw(local, ())
        for c in self._triad:
            one = np.zeros(len(pole))
            one[c] = abs(float(self.channels.sensitivity[c]))
            gain = self.raw(replace(local, sensitivity=local.sensitivity + STEP * one), ()) - raw
            zero = self.raw(replace(local, zero=local.zero + STEP * self.data.gravity * one), ()) - raw
            for words, moved in (("sensitivity", gain), ("zero", zero)):
                columns = np.stack([self.whitened(moved * law) for law in laws], axis=1)
                yield GRAVITY, f"{words} of {self.channels.names[c]} in the course of time", columns / STEP

    def blocks(self) -> list[tuple[slice, NDArray[np.intp]]]:
        """All rows, all channels: a magnitude belongs to three of them."""
        return [(slice(0, self.rows), np.arange(len(self.channels.names)))]

    def _of_gravity(self) -> Array:
        """What one standard uncertainty of gravity moves, (rows, 1)."""
        table = np.zeros((len(self.row_names), self.width))
        if len(self._triad):
            table[0] = self.data.u_gravity
        return self.whitened(table)[:, None]

    @cached_property
    def held_out(self) -> Mask:
        return np.tile(self.data.held, len(self.row_names))

    def domains(self) -> Mapping[str, Mask]:
        found = {"poses": ~self._turned, "turns": self._turned}
        return {name: mask for name, mask in found.items() if mask.any()}

    def cuts(self) -> Sequence[Cut]:
        """By the axis that is upright, and by time."""
        found = []
        for axis in range(3):
            for sign, mark in ((1.0, "+"), (-1.0, "−")):
                found.append(Cut("attitude", f"{mark}{'xyz'[axis]} up", sign * self._start[axis] > UPRIGHT))
        between = np.abs(self._start).max(axis=0) <= UPRIGHT
        found.append(Cut("attitude", "no axis upright", between))
        order = np.argsort(np.argsort(self.data.time, kind="stable"), kind="stable")
        for place, words in enumerate(("early", "half-way", "late")):
            found.append(Cut("time", words, 3 * order // self.width == place))
        return [one for one in found if one.mask.any()]

    @cached_property
    def _of_magnitude(self) -> Array:
        """Variance of a magnitude by that of the triad's outputs and the data sheet, (m/s²)², (n,)."""
        slope = self._start / self.channels.sensitivity[self._triad][:, None]
        found = np.sum(slope**2 * self._variance[self._triad], axis=0)
        return np.asarray(np.where(found > 0.0, found, 1.0))

    @property
    def to_judge(self) -> str:
        return "more poses, twelve or more"

    def origin(self, name: str) -> Origin:
        return "at rest"

    def noise(self) -> Array:
        """Of a magnitude, (m/s²)², and of the means of the gyros, (rad/s)², (names, n)."""
        rates = self._variance[self._gyros] / self.channels.sensitivity[self._gyros][:, None] ** 2
        return np.concatenate([self._of_magnitude[None], rates] if len(self._triad) else [rates])

    @property
    def allowance(self) -> float:
        """Short poses tell the noise of a mean badly: most of it is slower than they are long."""
        seconds = float(np.sum(self.data.seconds[~self._turned]))
        return max(ALLOWANCE, math.sqrt(2.0 / max(KNOWING * seconds, 1.0)))

    def shapes(self, component: str) -> Mapping[str, Array]:
        """How an error of one axis, or of the angle between two, goes with the attitude, m/s²."""
        if component != "poses":
            return {}
        d, g = self._start, self.data.gravity
        single = {f"goes with what {name} feels": g * d[k] for k, name in enumerate("xyz")}
        square = {f"goes with the square of what {name} feels": g * d[k] ** 2 for k, name in enumerate("xyz")}
        pairs = ((0, 1), (1, 2), (2, 0))
        product = {f"goes with {'xyz'[i]} times {'xyz'[k]}": g * d[i] * d[k] for i, k in pairs}
        since = self.data.time - float(self.data.time.mean())
        return {**single, **square, **product, "drifts with time": since / max(float(np.abs(since).max()), 1e-9)}

    def title(self, name: str) -> str:
        return "magnitude of gravity" if name == GRAVITY else "gyros"

    def remarks(self, left: Array, local: Local, terms: Sequence[Term]) -> tuple[str, ...]:
        """How far the magnitude is off, and what every known turn integrates to with this model."""
        table = self.residual(left)
        said = [] if not len(self._triad) else [self._said_of_gravity(table[0])]
        for k in np.flatnonzero(self._turned).tolist():
            axis = int(np.abs(self.data.turn[:, k]).argmax())
            for row, c in enumerate(self._gyros, len(self.row_names) - len(self._gyros)):
                if self.channels.axis[c] == axis and self.counted.reshape(-1, self.width)[row, k]:
                    said.append(self._said_of_turn(k, axis, table[row, k], local.sensitivity[c]))
        return tuple(said)

    def _said_of_gravity(self, left: Array) -> str:
        used = self.counted[: self.width]
        above = self.data.gravity * np.expm1(left / self.data.gravity)
        rms = math.sqrt(float(np.mean(above[used] ** 2)))
        return f"magnitude less g: {rms:.5f} m/s² rms over {np.count_nonzero(used)} poses"

    def _said_of_turn(self, k: int, axis: int, volts_left: float, sensitivity: float) -> str:
        """What is left over is rate that the model does not expect."""
        stated = float(self.data.turn[axis, k])
        shown = stated + volts_left / sensitivity * float(self.data.seconds[k])
        known = f" ± {math.degrees(float(self.data.u_turn[k])):.2g}°" if self.data.u_turn[k] > 0.0 else ""
        return (
            f"{'xyz'[axis]} turn: integrates to {math.degrees(shown):.2f}° (reference {math.degrees(stated):g}°{known})"
        )


def _triad(data: PoseRecords) -> NDArray[np.intp]:
    """The accelerometers along x, y and z; none if there are none."""
    found = data.channels.of("acceleration")
    axes = data.channels.axis[found]
    if len(found) and sorted(axes.tolist()) != [0, 1, 2]:
        names = ", ".join("xyz"[axis] for axis in axes)
        raise BadInput(f"{data.run}: found accelerometers along {names}, wanted one along each of x, y and z")
    return np.asarray(found[np.argsort(axes)], np.intp)


def _different(direction: Array) -> int:
    """How many attitudes there are among these, (3, n), taking those as one that are close."""
    near = direction.T @ direction > math.cos(TILT)
    return int(np.count_nonzero(near.argmax(axis=1) == np.arange(len(near))))


def _blind(data: PoseRecords, attitudes: int) -> list[str]:
    """What such a record cannot show; `attitudes` of a triad, zero without one."""
    said = ["poses at rest: dynamics, delays and noise above the frequency of the poses are not looked at"]
    turned = np.any(data.turn != 0.0, axis=0)
    if attitudes:
        said.append(
            "a magnitude does not change if the whole triad is turned in its case: how the triad sits in the case "
            "cannot be seen; a pose against a level and a plumb line would show it"
        )
        if attitudes < PARAMETERS:
            said.append(
                f"{attitudes} attitudes are fewer than the {PARAMETERS} parameters of a triad: zeros, sensitivities "
                "and angles between axes cannot all be told apart; add poses on edges and corners"
            )
    axes = {int(np.abs(data.turn[:, k]).argmax()) for k in np.flatnonzero(turned)}
    still = ["xyz"[a] for a in data.channels.axis[data.channels.of("rate")] if int(a) not in axes]
    if still:
        said.append(
            f"no turn by a known angle about {', '.join(still)}: the gyros' sensitivity there; turn it by 360° "
            "against a stop"
        )
    return said


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=0))


def _inverse(columns: Sequence[Array]) -> Array:
    """Inverses of 3 × 3 matrices given by their columns, each (3, n): (3, 3, n)."""
    a, b, c = columns
    rows = np.stack([np.cross(b, c, axis=0), np.cross(c, a, axis=0), np.cross(a, b, axis=0)])
    with np.errstate(all="ignore"):  # a step too far makes one without an inverse, and is not taken
        return np.asarray(rows / np.sum(a * rows[0], axis=0))
